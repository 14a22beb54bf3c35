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

# MISRA C:2012, as far as cppcheck's addon knows its rules, on the firmware but for its drivers. These rules are left out:
#   2.4 2.5 5.7 5.9   tags and macros that only some files use, internal names that several have: each file is a unit
#   8.9               a generated table stands in a header of its own
#   9.3 9.5           initialisers tell what is not zero
#   10.4 10.6 10.8    essential types: -Wconversion and -Wsign-conversion are errors
#   11.5 18.4         bytes and words of flash are reached by pointers; what is proven is that they stay within
#   12.1 12.3         parentheses around what binds more, and several names in one declaration
#   13.3 13.4 14.2    an increment or an assignment within an expression, also in the head of a loop
#   15.5 15.7         a return at once for what is refused, without a last else
#   17.7              memcpy's and memset's results
# In what is not proven (tests/proofs) these as well:
#   5.6 10.1 10.3 10.5 10.7 13.5   for the same reasons; clocks shift signed numbers down
#   8.7               what tests or the host's filter call
#   14.1              a loop that ends by a float also has a count
#   17.8              a parameter that is counted down
#   19.2              memory that two use one after the other
#   21.15 21.16       the bits of a float, and structures without gaps (asserted)
#   2.2 2.7 11.8 12.2 the addon misreads several names in one declaration, assembler, and a pointer in a constant
#                     structure, and does not see the range of what it shifts by
# A deviation from another rule stands on its line, with the reason.
MISRA_LEFT_OUT := 2.4 2.5 5.7 5.9 8.9 9.3 9.5 10.4 10.6 10.8 11.5 12.1 12.3 13.3 13.4 14.2 15.5 15.7 17.7 18.4
MISRA_UNPROVEN_LEFT_OUT := $(MISRA_LEFT_OUT) 2.2 2.7 5.6 8.7 10.1 10.3 10.5 10.7 11.8 12.2 13.5 14.1 17.8 19.2 21.15 21.16
MISRA_PROVEN := $(addprefix firmware/core/,boot/image.c boot/install.c boot/select.c link/frame.c link/queue.c link/parameters.c \
	link/parameter_set.c storage/store.c storage/crc32.c)
MISRA_UNPROVEN := $(filter-out $(MISRA_PROVEN),$(wildcard firmware/core/*/*.c firmware/services/*.c firmware/apps/*.c))
MISRA := $(LINT)/misra
# $(call misra,NAME,RULES LEFT OUT,SOURCES): from nothing each time, for what is kept of a header that has changed since is
# taken for a second one.
misra = rm -rf $(MISRA)/$(1); mkdir -p $(MISRA)/$(1); cppcheck -q -j 2 --cppcheck-build-dir=$(MISRA)/$(1) --std=c11 --addon=misra --inline-suppr \
	--suppress=missingIncludeSystem $(2:%=--suppress=misra-c2012-%) --error-exitcode=1 -Ifirmware -I$(PROTOCOL_OUT) $(3)

misra: $(PROTOCOL_HEADERS) $(BUILD)/lint-tools.stamp ## MISRA C:2012 on core, services and apps, but for the rules that tests/checks.mk leaves out
	@$(call misra,proven,$(MISRA_LEFT_OUT),$(MISRA_PROVEN))
	@$(call misra,unproven,$(MISRA_UNPROVEN_LEFT_OUT),$(MISRA_UNPROVEN))
	@echo "misra: clean"

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

check-static: check-format lint misra types docs ## Format, lint, types and documentation

check: check-static test-fast ## Before each commit: all of `make check-static`, and the fast tests

.PHONY: lint misra check-format format types check-static check
