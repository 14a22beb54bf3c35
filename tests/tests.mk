# The wheel has a target of its own. There are three workers for two processors, as many tests wait; each computes on one
# processor: OpenBLAS would start two threads in each. Who has nothing left to do takes half of what another has: the
# tests of a file, which share what they set up, mostly stay together. Where the environment forbids Python to keep what
# it compiled, as those of containers do, each worker and each program that a test starts would compile all of it again.
PYTEST := PYTHONDONTWRITEBYTECODE= OPENBLAS_NUM_THREADS=1 $(PYTHON) -m pytest -n 3 --dist worksteal -q --ignore=tests/packaging

TOOLS := $(addprefix $(BUILD)/,$(addsuffix .stamp,qemu ngspice chromium mosquitto foxglove-reader frama-c))

# Fast and long tests are one run: while some wait, for a browser, a broker or a process, others compute.
test: test-not-slow test-host-boards ## All tests but the slow ones

test-wheel: all ## Build the wheel, install it alone and use it outside the tree
	@$(PYTHON) -m pytest tests/packaging -q -s

test-wheels: wheels ## Install the wheels of `make wheels` where there is no compiler, that for aarch64 in QEMU's user mode
	@$(call need,qemu-aarch64-static,qemu-user-static)
	@test -x $(BUILD)/arm64/root/usr/bin/python3.11 || $(PYTHON) tests/packaging/arm64_root.py $(BUILD)/arm64/root
	@$(PYTHON) -m pytest tests/packaging/test_portable_wheels.py tests/packaging/test_headless.py -q -s

test-fast: all $(BUILD)/qemu.stamp ## The tests that take little time: four minutes in all
	@$(PYTEST) -m "not slow and not long"

test-not-slow: all $(TOOLS)
	@$(PYTEST) -m "not slow"

test-host-boards: all ## End to end on host boards what depends on the boards, also what is slow on emulated ones
	@$(PYTEST) tests/hil --goldfield-rig host -m both_boards

test-slow: all $(TOOLS) ## All tests, the slow ones too
	@$(PYTEST)

COSTS ?= tests -m "not slow"
test-costs: all $(BUILD)/qemu.stamp ## The dearest tests by processor time (COSTS="tests/host -m long")
	@$(PYTEST) -p tests.bench.cpu_costs $(COSTS)

.PHONY: test test-not-slow test-wheel test-wheels test-fast test-host-boards test-slow test-costs

many-benches: all ## Two, then four benches beside a garbage sender for a minute each
	@$(PYTHON) -m pytest tests/hil/test_many_benches.py -m slow -q -s

.PHONY: many-benches

figures: all ## Measure and print the figures of the whole chain (several minutes)
	@$(PYTHON) tests/bench/chain_figures.py

.PHONY: figures

# Peers that only the bench has. What this machine cannot have is told, and its rows are left out.
$(BUILD)/bench/peers.stamp: tests/bench/peers/requirements.txt $(BUILD)/venv.stamp
	@rm -rf $(@D)/cmsis; mkdir -p $(@D)/cmsis
	@( $(call pip,install --no-deps $$(grep gtsam $<)) ) || echo "bench: GTSAM is left out"
	@( $(call pip,download --no-deps --no-binary :all: --no-build-isolation -d $(@D)/cmsis $$(grep cmsisdsp $<)) ) && \
	  tar -xzf $(@D)/cmsis/*.tar.gz -C $(@D)/cmsis || echo "bench: CMSIS-DSP is left out, and despreading with it"
	@touch $@

BENCH ?=
bench: all $(BUILD)/qemu.stamp $(BUILD)/bench/peers.stamp ## Speed and memory beside CMSIS-DSP, cantools, NumPy, SciPy, GTSAM, QEMU: one table (a quarter of an hour; BENCH="decode location")
	@OPENBLAS_NUM_THREADS=1 $(PYTHON) -m tests.bench.peers $(BENCH)

bench-compare: $(BUILD)/venv.stamp ## What differs between the last run of the bench, the one before and the one that is kept
	@$(PYTHON) -m tests.bench.peers --compare

bench-keep: $(BUILD)/venv.stamp ## Keep the last run of the bench and write its table into docs/comparison.md
	@$(PYTHON) -m tests.bench.peers --keep

command-costs: all ## Measure start-up, each subcommand's time and memory, and location beside an earlier version
	@$(PYTHON) -m tests.bench.locate_figures elsewhere
	@$(PYTHON) -m tests.bench.locate_before
	@$(PYTHON) tests/bench/start_up.py
	@$(PYTHON) -m tests.bench.command_costs

.PHONY: bench bench-compare bench-keep command-costs

location-map: $(BUILD)/venv.stamp ## Draw docs/location.png: error map, error against the bound, starts compared
	@$(PYTHON) tests/bench/locate_map.py

.PHONY: location-map

drive-figures: all ## Measure how exact a beacon's current is, by waveform and error of its driver (DRIVE="--hours 1": does it trip?)
	@$(PYTHON) -m tests.bench.drive_figures $(DRIVE)

.PHONY: drive-figures

DEADLINES ?=
deadline-figures: all ## Measure each interrupt beside its deadline, and what a board does when it misses it (minutes; DEADLINES="sensor")
	@$(PYTHON) -m tests.bench.deadline_figures $(DEADLINES)

.PHONY: deadline-figures

protections: all ## Let each protection of a drive act a hundred times on the image, at random phases; print how soon (half an hour)
	@$(PYTHON) -m pytest -q -s -m slow tests/firmware/services/test_protection.py tests/firmware/services/test_protection_on_the_image.py \
		tests/firmware/boards/stm32f405/test_protection_in_hardware.py tests/hil/test_coil_faults.py

.PHONY: protections

LONG_RUN ?=
long-run: all ## Run a beacon and a sensor, emulated, for an hour of their time: no deadline missed (an hour; LONG_RUN="--hours 0.1")
	@OPENBLAS_NUM_THREADS=1 $(PYTHON) -m tests.bench.long_run $(LONG_RUN)

.PHONY: long-run

DAY ?=
day-run: all ## A day of host boards with drift, faults and motion: poses, counters, memory (hours; DAY="--hours 0.5")
	@OPENBLAS_NUM_THREADS=1 $(PYTHON) -m tests.bench.day_run $(DAY)

.PHONY: day-run

track-figures: $(BUILD)/venv.stamp ## Measure and print what is reached on a moving sensor (several minutes)
	@$(PYTHON) -m tests.bench.track_figures

.PHONY: track-figures

calibration-figures: all ## Measure what calibrating a sensor by hand reaches (ten minutes; CALIBRATION="--seeds 3")
	@$(PYTHON) -m tests.bench.calibration_figures $(CALIBRATION)

.PHONY: calibration-figures

field-sync-figures: all ## Measure synchronisation by the field alone: cold starts by hundreds, a dropout (several minutes)
	@$(PYTHON) -m pytest tests/firmware/core/timing/test_acquire.py -k "thousand or hundreds" -q -s
	@$(PYTHON) -m pytest tests/hil/test_field_synchronisation.py -k "hundred or ten_seconds" -q -s
	@$(PYTHON) -m pytest tests/hil/test_field_synchronisation.py --goldfield-rig host -k "hundred or ten_seconds" -q -s

.PHONY: field-sync-figures

HOLD ?=
hold-over-figures: all ## Measure chip edges without the sync wire while crystals drift, and what boards state of them (2 minutes; HOLD="--seeds 3")
	@OPENBLAS_NUM_THREADS=1 $(PYTHON) -m tests.bench.hold_over_figures $(HOLD)

.PHONY: hold-over-figures

can-sync-figures: all ## Measure timing over CAN without a sync wire: edges, hold-over, poses, 100 cold starts (several minutes)
	@$(PYTHON) -m tests.bench.can_timing_figures
	@$(PYTHON) -m tests.bench.can_timing_figures --boards host

.PHONY: can-sync-figures

code-figures: $(BUILD)/venv.stamp ## Plan the codes of 500 to 2,000 beacons: interference, its bound, time (minutes; CODES="--beacons 900")
	@$(PYTHON) -m tests.bench.code_figures $(CODES)

.PHONY: code-figures

building-figures: all ## A thousand host beacons and a sensor that walks 200 m among them: poses, hand-over, speed (an hour; BUILDING="--metres 10")
	@OPENBLAS_NUM_THREADS=1 $(PYTHON) -m tests.bench.building_figures $(BUILDING)

.PHONY: building-figures

commissioning-figures: all ## Take a hundred host boards from the box to poses by the commands of docs/boards.md, timed (minutes)
	@$(PYTHON) -m tests.bench.commissioning_figures

.PHONY: commissioning-figures

CAMPAIGN ?=
campaign: all ## Let every kind of fault strike host boards, and hold each pose to the truth (hours; goes on where it was stopped; CAMPAIGN="--seeds 2")
	@$(PYTHON) -m tests.campaign $(CAMPAIGN)

.PHONY: campaign

IMAGE_FAULTS ?=
image-faults: all ## Skip each instruction of the protecting code once, flip registers, on the images; judge by current, flash and parameters (hours; goes on where it was stopped; IMAGE_FAULTS="--every 20")
	@OPENBLAS_NUM_THREADS=1 $(PYTHON) -m tests.image_faults $(IMAGE_FAULTS)

.PHONY: image-faults

readme-figures: all ## Compare each figure that README.md and some pages quote with what a command prints (an hour)
	@$(PYTHON) -m tests.bench.readme_figures

.PHONY: readme-figures

SURVEYS ?=
survey-figures: $(BUILD)/venv.stamp $(LOCATE_LIBRARY) ## Measure how near a survey comes to the truth (long; SURVEYS="cube-10 --seeds 3")
	@$(PYTHON) -m tests.bench.survey_figures $(SURVEYS)

.PHONY: survey-figures

INTEGRITY ?=
integrity-figures: $(BUILD)/venv.stamp $(LOCATE_LIBRARY) ## Measure when the locator is wrong and says so (long; INTEGRITY="halls --poses 200 --seed 2")
	@$(PYTHON) -m tests.bench.integrity_figures $(INTEGRITY)

.PHONY: integrity-figures

PLAN ?=
plan-figures: $(BUILD)/venv.stamp ## Measure a plan of 1,000 beacons and 10^6 points: time, memory, cores, Dask (long; PLAN="--points 20000")
	@$(PYTHON) -m tests.bench.plan_figures $(PLAN)

plan-map: $(BUILD)/venv.stamp ## Draw docs/plan.png: what a plan of a hall looks like
	@$(PYTHON) -m tests.bench.plan_map

.PHONY: plan-figures plan-map

new-room-picture: all ## Run the commands of docs/new_room.md and draw docs/new_room.png (three minutes)
	@$(PYTHON) -m tests.bench.new_room_picture

.PHONY: new-room-picture

page-picture: all $(BUILD)/chromium.stamp ## Draw docs/live_page.png: the live page in a browser without a screen
	@$(PYTHON) -m tests.bench.page_picture

.PHONY: page-picture

how-it-works-pictures: all ## Draw docs/how_codes.png and how_poses.png from a simulated bench
	@OPENBLAS_NUM_THREADS=1 $(PYTHON) -m tests.bench.how_it_works_pictures

.PHONY: how-it-works-pictures

METAL ?=
metal-figures: $(BUILD)/venv.stamp $(LOCATE_LIBRARY) ## Measure what learning the metal of a room gains (ten minutes; METAL="plates --seeds 1")
	@$(PYTHON) -m tests.bench.metal_figures $(METAL)
	@$(PYTHON) -m tests.bench.metal_moved

.PHONY: metal-figures

circuit-figures: all $(BUILD)/ngspice.stamp ## Measure the reference circuit in ngspice beside the plant: docs/hardware/figures.md and edges.png (minutes)
	@OPENBLAS_NUM_THREADS=1 $(PYTHON) -m tests.bench.circuit_figures

circuit-diagrams: $(BUILD)/venv.stamp ## Draw the reference circuit: docs/hardware/driver.svg and sensor.svg
	@$(PYTHON) -m tests.bench.circuit_diagrams

.PHONY: circuit-figures circuit-diagrams

RATE ?=
rate-figures: all ## Measure poses from blocks of chips beside one fix a cycle (half an hour; RATE="accuracy --boards host")
	@OPENBLAS_NUM_THREADS=1 $(PYTHON) -m tests.bench.rate_figures $(RATE)

.PHONY: rate-figures

# The whole chain on host boards under the sanitizers. Python itself is not built with them, so their library comes first.
SANITIZED := $(BUILD)/sanitized
SANITIZED_TESTS ?= tests/hil tests/firmware/services/test_node.py tests/firmware/services/test_storage.py tests/firmware/apps/test_beacon_app.py
SANITIZE := -std=c11 -w -O1 -g -fPIC -D_GNU_SOURCE -fsanitize=address,undefined,float-cast-overflow -fno-sanitize-recover=all \
	-fno-omit-frame-pointer -shared

$(SANITIZED)/libgf_hostboard.so: $(HOSTBOARD_OBJECTS)
	@mkdir -p $(@D)
	@$(HOST_CC) $(SANITIZE) $(HOSTBOARD_INCLUDES) -Wl,-Bsymbolic $(HOSTBOARD_SOURCES) $(PROTOCOL_OUT)/goldfield.c -lm -o $@

$(SANITIZED)/libgf_rig.so: $(RIG_OBJECTS)
	@mkdir -p $(@D)
	@$(HOST_CC) $(SANITIZE) -pthread -Ihil_sim -Ifirmware $(RIG_SOURCES) -lm -o $@

test-sanitized: all $(SANITIZED)/libgf_hostboard.so $(SANITIZED)/libgf_rig.so ## End to end on host boards under the address and undefined-behaviour sanitizers
	@rm -rf $(SANITIZED)/reports && mkdir -p $(SANITIZED)/reports
	@GOLDFIELD_LIBRARIES=$(abspath $(SANITIZED)) OPENBLAS_NUM_THREADS=1 \
	  ASAN_OPTIONS=detect_leaks=0:log_path=$(abspath $(SANITIZED))/reports/report UBSAN_OPTIONS=print_stacktrace=1 \
	  LD_PRELOAD="$$($(HOST_CC) -print-file-name=libasan.so) $$($(HOST_CC) -print-file-name=libubsan.so)" \
	  $(PYTHON) -m pytest -q $(SANITIZED_TESTS) --goldfield-rig host -m "both_boards or (not simulated_bench and not slow)" || \
	  { cat $(SANITIZED)/reports/* 2>/dev/null; exit 1; }
	@test -z "$$(ls $(SANITIZED)/reports)" || { cat $(SANITIZED)/reports/*; exit 1; }
	@echo "sanitizers: nothing found"

.PHONY: test-sanitized

MUTANTS ?=
mutants: all ## How many small changes of the core and the locator their tests notice (hours; MUTANTS="--files link/* --sample 200 --seed 1")
	@status=0; for part in core locator; do \
	  OPENBLAS_NUM_THREADS=1 $(PYTHON) -m tests.mutants.run $$part $(MUTANTS) || status=1; done; exit $$status

.PHONY: mutants
