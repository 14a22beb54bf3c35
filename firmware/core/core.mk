# The hardware-free core. Boards compile CORE_SOURCES with their own compiler; build/libgf_core.so is the core alone, for its tests.
CORE_SOURCES := $(wildcard firmware/core/*.c)
CORE_HEADERS := $(wildcard firmware/core/*.h)
CORE_LIBRARY := $(BUILD)/libgf_core.so
