# goldfield: `make run` shows the main job, `make test` runs the tests. Both do all set-up on a fresh Debian or Ubuntu machine.
SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
.DELETE_ON_ERROR:
.DEFAULT_GOAL := help

BUILD := build
VENV := .venv
PYTHON := $(VENV)/bin/python
NPM := PATH="$(abspath $(VENV))/bin:$$PATH" npm# Of the wheel of Node.js that requirements.txt pins: Debian's is too old.
SECONDS ?= 20
SUDO := $(if $(filter 0,$(shell id -u)),,sudo)

C_STANDARD := -std=c11 -Wall -Wextra -Wconversion -Wsign-conversion -Wshadow -Werror
HOST_CC := gcc
HOST_CFLAGS := $(C_STANDARD) -O2 -g -fPIC -MMD -MP
HOST_LIBRARIES :=

help: ## This list
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 16

include protocol/protocol.mk
include firmware/core/core.mk
include firmware/boards/stm32f405/board.mk
include firmware/boards/host/board.mk
include host/goldfield/locate/locate.mk
include host/goldfield/page/page.mk
include host/packaging/wheels.mk
include hil_sim/emulator/emulator.mk
include hil_sim/rig/rig.mk
include tests/tests.mk
include tests/fuzz/fuzz.mk
include tests/coverage/coverage.mk
include tests/proofs/proofs.mk
include tests/checks.mk
include docs/docs.mk

# ---- set-up ----
# $(call install,PACKAGES): Debian packages, through apt. Who else holds its lock, as a new machine's own updates do, is waited for.
APT := $(SUDO) DEBIAN_FRONTEND=noninteractive apt-get -qq -o DPkg::Lock::Timeout=600
define install
{ echo "installing $(1) with apt"; $(APT) update >$(BUILD)/apt.log 2>&1 && $(APT) install -y $(1) >>$(BUILD)/apt.log 2>&1 || \
  { tail -5 $(BUILD)/apt.log; echo "could not install $(1): see $(BUILD)/apt.log, or install it by hand"; exit 1; }; }
endef
# $(call need,COMMAND,PACKAGES): install packages if a command is missing.
define need
command -v $(1) >/dev/null || $(call install,$(2))
endef
# $(call pip,ARGUMENTS): pip's own words go to a file, and are shown only if it fails.
define pip
CFLAGS="$(C_STANDARD)" $(PYTHON) -m pip --disable-pip-version-check --no-input $(1) >$(BUILD)/pip.log 2>&1 || \
  { tail -20 $(BUILD)/pip.log; echo "pip failed: all of its words are in $(BUILD)/pip.log"; exit 1; }
endef

$(BUILD)/host-tools.stamp:
	@mkdir -p $(BUILD)
	@$(call need,$(HOST_CC),gcc libc6-dev)
	@$(call need,python3,python3)
	@python3 -c 'import venv, ensurepip' 2>/dev/null || $(call install,python3-venv)
	@touch $@

$(BUILD)/arm-tools.stamp:
	@mkdir -p $(BUILD)
	@$(call need,arm-none-eabi-gcc,gcc-arm-none-eabi libnewlib-arm-none-eabi)
	@touch $@

$(BUILD)/qemu.stamp:
	@mkdir -p $(BUILD)
	@$(call need,qemu-system-arm,qemu-system-arm)
	@touch $@

$(BUILD)/ngspice.stamp:
	@mkdir -p $(BUILD)
	@$(call need,ngspice,ngspice)
	@touch $@

$(BUILD)/chromium.stamp:
	@mkdir -p $(BUILD)
	@$(call need,chromium,chromium)
	@touch $@

# A broker for tests alone, and what makes its certificates: one that was not there before is not left running as a service.
$(BUILD)/mosquitto.stamp:
	@mkdir -p $(BUILD)
	@command -v mosquitto >/dev/null || test -x /usr/sbin/mosquitto || { $(call install,mosquitto); \
	  $(SUDO) systemctl disable --now mosquitto >/dev/null 2>&1 || true; }
	@$(call need,openssl,openssl)
	@touch $@

# The reader of recordings that Foxglove is made of, in JavaScript; `npm ci` takes exactly what package-lock.json names.
FOXGLOVE_READER := tests/host/recording/foxglove_reader
$(BUILD)/foxglove-reader.stamp: $(wildcard $(FOXGLOVE_READER)/*) $(BUILD)/venv.stamp
	@mkdir -p $(BUILD)/foxglove-reader
	@cp $(FOXGLOVE_READER)/* $(BUILD)/foxglove-reader
	@(cd $(BUILD)/foxglove-reader && $(NPM) ci --ignore-scripts --no-audit --no-fund) >$(BUILD)/foxglove-reader/npm.log 2>&1 || \
	  { tail -5 $(BUILD)/foxglove-reader/npm.log; echo "npm failed: all of its words are in $(BUILD)/foxglove-reader/npm.log"; exit 1; }
	@touch $@

$(BUILD)/venv.stamp: requirements.txt pyproject.toml setup.py $(BUILD)/host-tools.stamp
	@echo "Python environment: $(VENV) (pinned packages)"
	@python3 -c 'import sys; sys.exit("goldfield needs Python 3.11 or newer; python3 here is " + sys.version.split()[0]) if sys.version_info < (3, 11) else None'
	@test -x $(PYTHON) || python3 -m venv $(VENV)
	@$(call pip,install -r requirements.txt)
	@$(call pip,install --no-deps --no-build-isolation -e .)
	@touch $@

setup: $(BUILD)/venv.stamp $(BUILD)/arm-tools.stamp ## Python environment and cross compiler

# ---- the main job ----
all: setup $(PROTOCOL_HEADERS) $(FIRMWARE_IMAGES) $(HOST_LIBRARIES) page ## Everything that runs: images, host boards, simulator

run: all ## Main job: emulated boards, real image, poses beside the truth (SECONDS=20)
	@$(PYTHON) -m hil_sim.demo --seconds $(or $(SECONDS),20)

wheel: all ## Everything as one file for pip, in build/dist: host, simulator and the ARM images
	@rm -rf $(BUILD)/dist
	@GOLDFIELD_PARTS=$(abspath $(BUILD)) $(call pip,wheel --no-deps --no-build-isolation --wheel-dir $(BUILD)/dist .)
	@du -h $(BUILD)/dist/*.whl

clean: ## Remove what was built (not the Python environment)
	rm -rf $(BUILD) $(LOCATE_LIBRARY) $(BANK_LIBRARY) $(dir $(PAGE))

.PHONY: help setup all run wheel clean
