test: all $(BUILD)/qemu.stamp ## All tests but the slow ones
	@$(PYTHON) -m pytest -n 2 -m "not slow" -q

test-slow: all $(BUILD)/qemu.stamp ## The slow tests too
	@$(PYTHON) -m pytest -n 2 -q

lint: all ## ruff, mypy, clang-tidy, cppcheck
	@$(VENV)/bin/ruff check . && $(VENV)/bin/ruff format --check .
	@$(VENV)/bin/mypy

.PHONY: test test-slow lint

figures: all ## Measure and print the figures of the whole chain (several minutes)
	@$(PYTHON) tests/bench/chain_figures.py

.PHONY: figures
