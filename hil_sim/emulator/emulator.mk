# The emulator: one shared library on the libunicorn of the Python wheel (headers and library come with it). The loader
# finds that library beside this one: through the link below in a checkout, in the neighbouring package in a wheel.
EMULATOR_LIBRARY := $(BUILD)/libgf_emulator.so
EMULATOR_SOURCES := $(wildcard hil_sim/emulator/*.c hil_sim/emulator/peripherals/*.c)
EMULATOR_RUN_PATH := $$ORIGIN/unicorn/lib:$$ORIGIN/../../unicorn/lib
EMULATOR_OBJECTS := $(EMULATOR_SOURCES:%.c=$(BUILD)/%.o)
UNICORN_LINKS := $(BUILD)/unicorn
HOST_LIBRARIES += $(EMULATOR_LIBRARY)

# Links to the wheel's directories, so that make need not ask Python each time it parses this.
$(UNICORN_LINKS)/stamp: $(BUILD)/venv.stamp
	@mkdir -p $(@D)
	@package=$$($(PYTHON) -c 'import pathlib, unicorn; print(pathlib.Path(unicorn.__file__).parent)') && \
	  ln -sfn $$package/include $(@D)/include && ln -sfn $$package/lib $(@D)/lib
	@touch $@

$(EMULATOR_OBJECTS): $(BUILD)/%.o: %.c $(UNICORN_LINKS)/stamp
	@mkdir -p $(@D)
	@$(HOST_CC) $(HOST_CFLAGS) -Ihil_sim -Ifirmware -isystem $(UNICORN_LINKS)/include -c $< -o $@

$(EMULATOR_LIBRARY): $(EMULATOR_OBJECTS) hil_sim/emulator/exports.map
	@echo "emulator: $@"
	@$(HOST_CC) -shared -Wl,-Bsymbolic -Wl,--version-script=hil_sim/emulator/exports.map -o $@ $(EMULATOR_OBJECTS) \
		-L$(UNICORN_LINKS)/lib -l:libunicorn.so.2 -Wl,-rpath,'$(EMULATOR_RUN_PATH)' -lm

-include $(EMULATOR_OBJECTS:.o=.d)
