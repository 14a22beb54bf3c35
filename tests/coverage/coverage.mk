# Which lines the tests of the core and of the host run: gcov on the core, in its own library and in that of host boards, and coverage.py on the host.
COVERED := $(BUILD)/coverage
COVERED_CFLAGS := -std=c11 -w -g -fPIC $(HOSTBOARD_INCLUDES)
COVERED_COUNTED := -Og --coverage# -Og keeps every line one of its own; what is not ours is not counted, and quick.
COVERED_CORE := $(CORE_SOURCES:%.c=$(COVERED)/core/%.o)
COVERED_BOARD := $(HOSTBOARD_SOURCES:%.c=$(COVERED)/board/%.o) $(COVERED)/board/goldfield.o
COVERED_TESTS ?= tests/firmware/core tests/protocol tests/host tests/docs -m "not slow"

$(COVERED)/board/goldfield.o: $(PROTOCOL_OUT)/goldfield.c
	@mkdir -p $(@D)
	@$(HOST_CC) $(COVERED_CFLAGS) -O2 -c $< -o $@

$(COVERED_CORE): $(COVERED)/core/%.o: %.c $(PROTOCOL_HEADERS)
	@mkdir -p $(@D)
	@$(HOST_CC) $(COVERED_CFLAGS) $(COVERED_COUNTED) -MMD -MP -c $< -o $@

$(HOSTBOARD_SOURCES:%.c=$(COVERED)/board/%.o): $(COVERED)/board/%.o: %.c $(PROTOCOL_HEADERS)
	@mkdir -p $(@D)
	@$(HOST_CC) $(COVERED_CFLAGS) $(COVERED_COUNTED) -MMD -MP -c $< -o $@

-include $(COVERED_CORE:.o=.d) $(HOSTBOARD_SOURCES:%.c=$(COVERED)/board/%.d)

$(COVERED)/libgf_core.so: $(COVERED_CORE)
	@$(HOST_CC) -shared --coverage $^ -lm -o $@

$(COVERED)/libgf_hostboard.so: $(COVERED_BOARD)
	@$(HOST_CC) -shared --coverage -Wl,-Bsymbolic $^ -lm -o $@

$(THIRD_PARTY_SOURCES:%.c=$(COVERED)/core/%.o) $(THIRD_PARTY_SOURCES:%.c=$(COVERED)/board/%.o): private COVERED_COUNTED := -O2 -MMD

# One process: a worker of xdist that is ended takes the counts of gcov with it.
COVERED_PYTHON := GOLDFIELD_ROOT=$(CURDIR) OPENBLAS_NUM_THREADS=1 $(PYTHON) -m coverage

coverage: all $(BUILD)/qemu.stamp $(BUILD)/chromium.stamp $(BUILD)/mosquitto.stamp $(BUILD)/foxglove-reader.stamp $(COVERED)/libgf_core.so $(COVERED)/libgf_hostboard.so ## Lines of firmware/core and host that their tests run, by folder, held to 95 % each (half an hour)
	@find $(COVERED) -name '*.gcda' -delete; rm -rf $(COVERED)/host; mkdir -p $(COVERED)/host
	@GOLDFIELD_LIBRARIES=$(abspath $(COVERED)) $(COVERED_PYTHON) run --rcfile=tests/coverage/coverage.ini \
	  -m pytest -q --ignore=tests/packaging $(COVERED_TESTS) || echo "coverage: tests failed; the table is of what ran"
	@$(COVERED_PYTHON) combine -q --rcfile=tests/coverage/coverage.ini
	@$(COVERED_PYTHON) json -q --rcfile=tests/coverage/coverage.ini -o $(COVERED)/host.json
	@$(PYTHON) -m tests.coverage.report

coverage-report: $(BUILD)/venv.stamp ## The table of the last `make coverage` again
	@$(PYTHON) -m tests.coverage.report

.PHONY: coverage coverage-report
