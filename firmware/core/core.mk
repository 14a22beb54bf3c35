# The hardware-free core. Boards compile CORE_SOURCES with their own compiler; build/libgf_core.so is the core alone, for its tests.
# What it takes from others, firmware/third_party, is compiled without our warnings.
THIRD_PARTY_SOURCES := $(wildcard firmware/third_party/*/*.c)
CORE_SOURCES := $(wildcard firmware/core/*/*.c) $(THIRD_PARTY_SOURCES)
CORE_OBJECTS := $(CORE_SOURCES:%.c=$(BUILD)/core/%.o)
HOST_LIBRARIES += $(BUILD)/libgf_core.so

$(BUILD)/libgf_core.so: $(CORE_OBJECTS)
	@$(HOST_CC) -shared -o $@ $^

$(THIRD_PARTY_SOURCES:%.c=$(BUILD)/core/%.o): private HOST_CFLAGS += -w

$(CORE_OBJECTS): $(BUILD)/core/%.o: %.c $(PROTOCOL_HEADERS)
	@mkdir -p $(@D)
	@$(HOST_CC) $(HOST_CFLAGS) -Ifirmware -I$(PROTOCOL_OUT) -c -o $@ $<

-include $(CORE_OBJECTS:.o=.d)
