# Fuzzing: libFuzzer with the sanitizers on the core, atheris on the host. tests/fuzz/README.md tells what each target holds.
FUZZ := $(BUILD)/fuzz
FUZZ_CC := clang-14
FUZZ_SANITIZERS := address,undefined,float-cast-overflow
FUZZ_CFLAGS := -std=c11 -D_GNU_SOURCE -O2 -g -fno-sanitize-recover=all -Ifirmware -I$(PROTOCOL_OUT) -Itests/fuzz/core -MMD -MP
FUZZ_CORE := frames parameters store boot update sync pose board
FUZZ_HOST := frames logs mcap site tables scenario session
# Inputs of a short run, by target: a few seconds each. So it ends at the same input wherever it runs.
FUZZ_RUNS_CORE := frames=10000 parameters=2000 store=2000 boot=500 update=1000 sync=500 pose=150 board=150
FUZZ_RUNS_HOST := frames=500 logs=1000 mcap=500 site=500 tables=1000 scenario=100 session=40
FUZZ_SECONDS ?= 600
FUZZ_ONLY ?= $(FUZZ_CORE:%=core/%) $(FUZZ_HOST:%=host/%)
FUZZ_OPTIONS := -seed=1 -len_control=0 -rss_limit_mb=2048 -timeout=300 -print_final_stats=1
FUZZ_OBJECTS := $(CORE_SOURCES:%.c=$(FUZZ)/%.o) $(FUZZ)/protocol/goldfield.o
FUZZ_PROGRAMS := $(FUZZ_CORE:%=$(FUZZ)/bin/%)

$(FUZZ)/clang.stamp:
	@mkdir -p $(@D)
	@test -f "$$($(FUZZ_CC) -print-file-name=libclang_rt.fuzzer-$$(uname -m).a 2>/dev/null)" || $(call install,clang-14 libclang-rt-14-dev)
	@touch $@

$(FUZZ)/atheris.stamp: tests/fuzz/requirements.txt $(BUILD)/venv.stamp
	@mkdir -p $(@D)
	@$(call pip,install -r tests/fuzz/requirements.txt)
	@touch $@

# Others' code is looked through for memory errors, but not for new ways through it.
$(THIRD_PARTY_SOURCES:%.c=$(FUZZ)/%.o): $(FUZZ)/%.o: %.c $(FUZZ)/clang.stamp
	@mkdir -p $(@D)
	@$(FUZZ_CC) $(FUZZ_CFLAGS) -w -fsanitize=address -c $< -o $@

$(FUZZ)/protocol/goldfield.o: $(PROTOCOL_OUT)/goldfield.c $(FUZZ)/clang.stamp
	@mkdir -p $(@D)
	@$(FUZZ_CC) $(FUZZ_CFLAGS) -w -fsanitize=fuzzer-no-link,$(FUZZ_SANITIZERS) -c $< -o $@

$(FUZZ)/%.o: %.c $(PROTOCOL_HEADERS) $(FUZZ)/clang.stamp
	@mkdir -p $(@D)
	@$(FUZZ_CC) $(FUZZ_CFLAGS) -Wall -Wextra -Werror -fsanitize=fuzzer-no-link,$(FUZZ_SANITIZERS) -c $< -o $@

$(FUZZ_PROGRAMS): $(FUZZ)/bin/%: $(FUZZ)/tests/fuzz/core/%.o $(FUZZ_OBJECTS)
	@mkdir -p $(@D)
	@$(FUZZ_CC) -fsanitize=fuzzer,$(FUZZ_SANITIZERS) $^ -lm -o $@

# The board links applications and services beside the core.
FUZZ_BOARD_OBJECTS := $(patsubst %.c,$(FUZZ)/%.o,$(filter-out $(CORE_SOURCES),$(HOSTBOARD_SOURCES)))
$(FUZZ)/bin/board: $(FUZZ_BOARD_OBJECTS)

-include $(FUZZ_OBJECTS:.o=.d) $(FUZZ_BOARD_OBJECTS:.o=.d) $(FUZZ_CORE:%=$(FUZZ)/tests/fuzz/core/%.d)

# $(call fuzz,SIDE/TARGET,OPTIONS): one target, from its corpus on; what is new goes to build/fuzz/found. A line says how it went.
define fuzz
mkdir -p $(FUZZ)/found/$(1); \
$(if $(filter core/%,$(1)),$(FUZZ)/bin/$(notdir $(1)),OPENBLAS_NUM_THREADS=1 $(PYTHON) -m tests.fuzz.host $(notdir $(1))) \
  $(FUZZ_OPTIONS) -max_len=$(if $(filter core/%,$(1)),1000,4000) $(2) -artifact_prefix=$(FUZZ)/found/$(dir $(1))crash-$(notdir $(1))- $(FUZZ)/found/$(1) tests/fuzz/corpus/$(1) \
  >$(FUZZ)/found/$(1).log 2>&1 || { tail -40 $(FUZZ)/found/$(1).log; echo "fuzz: $(1): see $(FUZZ)/found/$(1).log and tests/fuzz/README.md"; exit 1; }; \
echo "fuzz: $(1): $$(sed -n 's/^Done \(.*\)/\1/p' $(FUZZ)/found/$(1).log), $$(grep -o 'cov: [0-9]*' $(FUZZ)/found/$(1).log | tail -1) edges"
endef

fuzz-build: $(FUZZ_PROGRAMS) $(FUZZ)/atheris.stamp all

fuzz: fuzz-build ## Fuzz each target for a fixed number of inputs: about two minutes
	@rm -rf $(FUZZ)/found
	@$(foreach run,$(FUZZ_RUNS_CORE),$(call fuzz,core/$(firstword $(subst =, ,$(run))),-runs=$(lastword $(subst =, ,$(run)))) && ) \
	  $(foreach run,$(FUZZ_RUNS_HOST),$(call fuzz,host/$(firstword $(subst =, ,$(run))),-runs=$(lastword $(subst =, ,$(run)))) && ) \
	  echo "fuzz: nothing found"

fuzz-long: fuzz-build ## Fuzz each target for FUZZ_SECONDS=600 (FUZZ_ONLY="core/store host/logs")
	@$(foreach target,$(FUZZ_ONLY),$(call fuzz,$(target),-max_total_time=$(FUZZ_SECONDS)) && ) echo "fuzz: nothing found"

# Inputs that were found and lead to something new, as few and short as they can be, become the corpus.
fuzz-keep: fuzz-build ## Merge what fuzz-long has found into tests/fuzz/corpus
	@$(foreach target,$(FUZZ_ONLY),$(PYTHON) -m tests.fuzz.keep $(target) && ) true

.PHONY: fuzz fuzz-build fuzz-long fuzz-keep
