# The applications on a board in memory: build/libgf_hostboard.so, for the simulator and for tests.
HOSTBOARD_SOURCES := $(CORE_SOURCES) $(wildcard firmware/services/*.c firmware/apps/*.c firmware/boards/host/*.c)
HOSTBOARD_INCLUDES := -Ifirmware -I$(PROTOCOL_OUT)
HOSTBOARD_OBJECTS := $(patsubst %.c,$(BUILD)/hostboard/%.o,$(HOSTBOARD_SOURCES)) $(BUILD)/hostboard/protocol/goldfield.o
HOSTBOARD_LIBRARY := $(BUILD)/libgf_hostboard.so

$(BUILD)/hostboard/protocol/goldfield.o: $(PROTOCOL_OUT)/goldfield.c
	@mkdir -p $(@D)
	@$(HOST_CC) $(HOST_CFLAGS) -c $< -o $@

$(THIRD_PARTY_SOURCES:%.c=$(BUILD)/hostboard/%.o): private HOST_CFLAGS += -w

$(BUILD)/hostboard/%.o: %.c $(PROTOCOL_HEADERS)
	@mkdir -p $(@D)
	@$(HOST_CC) $(HOST_CFLAGS) $(HOSTBOARD_INCLUDES) -c $< -o $@

$(HOSTBOARD_LIBRARY): $(HOSTBOARD_OBJECTS)
	@echo "host board: $@"
	@$(HOST_CC) -shared -Wl,-Bsymbolic $^ -lm -o $@

HOST_LIBRARIES += $(HOSTBOARD_LIBRARY)

-include $(HOSTBOARD_OBJECTS:.o=.d)
