test: all $(BUILD)/qemu.stamp ## All tests but the slow ones
	@$(PYTHON) -m pytest -n 2 -m "not slow" -q
	@echo "end to end again, on host boards"
	@$(PYTHON) -m pytest tests/hil --rig host -q

test-wheel: all ## Build the wheel, install it alone and use it outside the tree
	@$(PYTHON) -m pytest tests/packaging -q -s

test-slow: all $(BUILD)/qemu.stamp ## The slow tests too
	@$(PYTHON) -m pytest -n 2 -q

# ---- static checks ----
LINT_INCLUDES := -Ifirmware -I$(PROTOCOL_OUT) -Ihil_sim
LINT_ARM := --target=arm-none-eabi $(STM32_CPU) -isystem /usr/lib/arm-none-eabi/include
LINT_SOURCES := $(filter-out firmware/boards/stm32f405/%,$(wildcard firmware/*/*.c firmware/*/*/*.c)) $(wildcard hil_sim/*/*.c hil_sim/*/*/*.c) \
	$(wildcard host/goldfield/locate/kernel/*.c)

lint: all ## ruff, mypy, clang-tidy, cppcheck
	@$(call need,clang-tidy,clang-tidy)
	@$(call need,cppcheck,cppcheck)
	@$(VENV)/bin/ruff check . && $(VENV)/bin/ruff format --check .
	@$(VENV)/bin/mypy
	@echo $(LINT_SOURCES) | xargs -n 4 -P 2 sh -c 'clang-tidy --quiet "$$@" -- -std=c11 -D_GNU_SOURCE $(LINT_INCLUDES) \
		-I$$($(PYTHON) -c "import unicorn, pathlib; print(pathlib.Path(unicorn.__file__).parent / \"include\")") 2>/dev/null' clang-tidy
	@clang-tidy --quiet $(wildcard firmware/boards/stm32f405/*.c) -- -std=c11 $(LINT_ARM) $(LINT_INCLUDES) 2>/dev/null
	@cppcheck --std=c11 --enable=warning,performance,portability --inline-suppr --suppress=missingIncludeSystem --error-exitcode=1 -q \
		$(LINT_INCLUDES) firmware hil_sim host/goldfield/locate/kernel
	@echo "lint: clean"

.PHONY: test test-wheel test-slow lint

figures: all ## Measure and print the figures of the whole chain (several minutes)
	@$(PYTHON) tests/bench/chain_figures.py

.PHONY: figures

bench: $(BUILD)/venv.stamp $(LOCATE_LIBRARY) ## Measure the host's speed: location single and batched beside SciPy, filter update, start-up
	@$(PYTHON) -m tests.bench.locate_figures speed
	@$(PYTHON) tests/bench/start_up.py

.PHONY: bench

location-map: $(BUILD)/venv.stamp ## Draw docs/location.png: error map, error against the bound, starts compared
	@$(PYTHON) tests/bench/locate_map.py

.PHONY: location-map

track-figures: $(BUILD)/venv.stamp ## Measure and print what is reached on a moving sensor (several minutes)
	@$(PYTHON) -m tests.bench.track_figures

.PHONY: track-figures

field-sync-figures: all ## Measure synchronisation by the field alone: cold starts by hundreds, a dropout (several minutes)
	@$(PYTHON) -m pytest tests/firmware/core/timing/test_acquire.py -k "thousand or hundreds" -q -s
	@$(PYTHON) -m pytest tests/hil/test_field_synchronisation.py -k "hundred or ten_seconds" -q -s
	@$(PYTHON) -m pytest tests/hil/test_field_synchronisation.py --rig host -k "hundred or ten_seconds" -q -s

.PHONY: field-sync-figures

can-sync-figures: all ## Measure timing over CAN without a sync wire: edges, hold-over, poses, 100 cold starts (several minutes)
	@$(PYTHON) -m tests.bench.can_timing_figures
	@$(PYTHON) -m tests.bench.can_timing_figures --boards host

.PHONY: can-sync-figures

readme-figures: all ## Compare each figure that README.md quotes with what the command beside it prints (half an hour)
	@$(PYTHON) -m tests.bench.readme_figures

.PHONY: readme-figures
