# The hot path of goldfield.locate in C; without it the host computes the same with NumPy, slower.
LOCATE_LIBRARY := $(BUILD)/libgf_locate.so
LOCATE_OBJECTS := $(patsubst %.c,$(BUILD)/%.o,$(wildcard host/goldfield/locate/kernel/*.c))
HOST_LIBRARIES += $(LOCATE_LIBRARY)

# Nothing here reads errno or floating-point traps; saying so lets the compiler work on two coils at a time.
$(LOCATE_OBJECTS): $(BUILD)/%.o: %.c $(BUILD)/host-tools.stamp
	@mkdir -p $(@D)
	@$(HOST_CC) $(HOST_CFLAGS) -O3 -fno-math-errno -fno-trapping-math -c $< -o $@

$(LOCATE_LIBRARY): $(LOCATE_OBJECTS)
	@echo "location: $@"
	@$(HOST_CC) -shared $^ -lm -o $@

-include $(LOCATE_OBJECTS:.o=.d)
