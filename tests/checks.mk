# Static checks: the look of the text, ruff, clang-tidy and cppcheck for what is likely wrong, mypy for types.
LINT := $(BUILD)/lint
LINT_INCLUDES := -Ifirmware -Ihost/goldfield/locate/kernel -I$(PROTOCOL_OUT) -Ihil_sim -isystem $(UNICORN_LINKS)/include
LINT_HOST_FLAGS := -std=c11 -D_GNU_SOURCE $(LINT_INCLUDES)
LINT_ARM_FLAGS := -std=c11 --target=arm-none-eabi $(STM32_CPU) -isystem /usr/lib/arm-none-eabi/include $(LINT_INCLUDES)
LINT_SOURCES := $(filter-out firmware/third_party/%,$(wildcard firmware/*/*.c firmware/*/*/*.c $(STM32)/boot/*.c hil_sim/*/*.c hil_sim/*/*/*.c host/goldfield/locate/kernel/*.c host/goldfield/track/blocks/kernel/*.c))
LINT_STAMPS := $(LINT_SOURCES:%.c=$(LINT)/%.tidy)

$(BUILD)/lint-tools.stamp:
	@mkdir -p $(BUILD)
	@$(call need,clang-format,clang-format)
	@$(call need,clang-tidy,clang-tidy)
	@$(call need,cppcheck,cppcheck)
	@touch $@

# $(call tidy,FLAGS): clang-tidy finds nothing in $<. The stamp and its list of headers let unchanged files alone.
define tidy
mkdir -p $(@D)
clang-tidy --quiet $< -- $(1) 2>$(@:.tidy=.log) || { grep -v generated $(@:.tidy=.log); exit 1; }
$(HOST_CC) -MM -MP -MT $@ -MF $(@:.tidy=.d) -std=c11 $(LINT_INCLUDES) $<
touch $@
endef

$(LINT)/%.tidy: %.c .clang-tidy hil_sim/.clang-tidy
	@$(call tidy,$(LINT_HOST_FLAGS))

$(LINT)/firmware/boards/stm32f405/%.tidy: firmware/boards/stm32f405/%.c .clang-tidy
	@$(call tidy,$(LINT_ARM_FLAGS))

-include $(LINT_STAMPS:.tidy=.d)

lint: all $(BUILD)/lint-tools.stamp ## Likely mistakes: ruff, clang-tidy, cppcheck
	@$(VENV)/bin/ruff check -q .
	@$(MAKE) --no-print-directory -s -j 2 --output-sync=target $(LINT_STAMPS)
	@mkdir -p $(LINT)/cppcheck
	@cppcheck -q -j 2 --cppcheck-build-dir=$(LINT)/cppcheck --std=c11 --enable=warning,performance,portability --inline-suppr \
		-i firmware/third_party --suppress=missingIncludeSystem --error-exitcode=1 -Ifirmware -I$(PROTOCOL_OUT) -Ihil_sim firmware hil_sim host/goldfield/locate/kernel host/goldfield/track/blocks/kernel
	@echo "lint: clean"

check-format: $(BUILD)/venv.stamp $(BUILD)/lint-tools.stamp ## Whether Python and C have the look that `make format` gives
	@$(VENV)/bin/ruff format -q --check . || { echo "run 'make format'"; exit 1; }
	@git ls-files '*.c' '*.h' ':!firmware/third_party' | xargs clang-format --dry-run --Werror || { echo "run 'make format'"; exit 1; }
	@echo "format: clean"

format: $(BUILD)/venv.stamp $(BUILD)/lint-tools.stamp ## Give Python and C their look
	@$(VENV)/bin/ruff check -q --select I --fix .
	@$(VENV)/bin/ruff format -q .
	@git ls-files '*.c' '*.h' ':!firmware/third_party' | xargs clang-format -i

types: $(BUILD)/venv.stamp ## mypy
	@$(PYTHON) -m mypy

check: check-format lint types docs test-fast ## Before each commit: format, lint, types, documentation and the fast tests

.PHONY: lint check-format format types check
