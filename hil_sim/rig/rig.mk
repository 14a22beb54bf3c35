# The rig's hot loop: world, CAN bus, serial lines and lock-step, one shared library.
RIG_LIBRARY := $(BUILD)/libgf_rig.so
RIG_SOURCES := $(wildcard hil_sim/world/*.c hil_sim/rig/*.c)
RIG_OBJECTS := $(RIG_SOURCES:%.c=$(BUILD)/%.o)
HOST_LIBRARIES += $(RIG_LIBRARY)

$(RIG_OBJECTS): $(BUILD)/%.o: %.c $(BUILD)/host-tools.stamp
	@mkdir -p $(@D)
	@$(HOST_CC) $(HOST_CFLAGS) -pthread -Ihil_sim -Ifirmware -c $< -o $@

$(RIG_LIBRARY): $(RIG_OBJECTS)
	@echo "simulator: $@"
	@$(HOST_CC) -shared -pthread $^ -lm -o $@

-include $(RIG_OBJECTS:.o=.d)
