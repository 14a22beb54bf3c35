"""What the block filter costs on a Cortex-M4: instructions, stack and memory, with the image's flags (Unicorn)."""

import struct

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hil_sim.clib import ROOT
from tests.firmware.core.track.dense import CHIP_S, State
from tests.firmware.core.track.single import BLOCK_S, CHIPS, Bits, cube, sampled
from tests.firmware.cortex_m4 import Machine, link

NOISE = 0.02  # .2 mG
CHIP_TICKS = 16422

HARNESS = """
#include "core/track/block_errors.h"
#include "core/track/block_filter.h"
#include "core/track/block_out.h"
#include "core/track/block_select.h"
loop_t coils[BLOCK_BEACONS];
uint32_t bits[BLOCK_BEACONS], count, lost, taken;
float sums[BLOCK_COLUMNS][3], chip_s, noise, covariance[6][6];
block_t block, other;
block_filter_t filter;
block_start_t start;
block_pose_t pose;
block_beacon_errors_t beacons[BLOCK_BEACONS];
block_site_errors_t errors = {beacons, 0.003f, 0.005f};
void begin(void) {
    block_filter_init(&filter, coils, count, noise);
    block_filter_start(&filter, &start);
    for (uint32_t i = 0; i < count; i++) beacons[i] = (block_beacon_errors_t){0.003f, 0.005f, 0.003f};
}
void keep(void) { block_filter_keep_slopes(&filter, true); }
uint32_t held;
void gram(void) { block_gram(bits, count, 31, chip_s, &block); }
void copy(void) { for (uint32_t i = 0; i <= count; i++) for (int k = 0; k < 3; k++) block.sums_uT[i][k] = sums[i][k]; }
void update(void) {
    taken = block_filter_update(&filter, &block, 31.0f * chip_s);
    lost = block_filter_lost(&filter);
    held = filter.measure.held;
}
void swept(void) { taken = block_filter_update_swept(&filter, &block, 31.0f * chip_s); }
void output(void) { block_filter_output(&filter, 15.0f * chip_s, &pose); }
void measure(void) { block_measure(&block, coils, &filter.measure); }
void predict(void) { block_kalman_predict(&filter.filters[0], 1e-3f); }
void leave_out(void) { other = block; block_leave_out(&other, 0); }
void separate(void) { other = block; block_separate(&other); }
block_select_t chosen;
void choose(void) { block_select(&chosen, coils, count, filter.filters[0].state.position_m, 0, false); }
void reduce(void) { block_select_reduce(&chosen, coils, count, bits, 31, &filter.filters[0].state, &block); }
void site_errors(void) { block_errors(&filter.measure, coils, count, &errors, covariance); }
"""

CALLS = (
    "gram",
    "update",
    "output",
    "measure",
    "predict",
    "leave_out",
    "separate",
    "site_errors",
    "sweep",
    "choose",
    "reduce",
)


@pytest.fixture(scope="module")
def machine(tmp_path_factory):
    directory = tmp_path_factory.mktemp("block")
    source, elf = directory / "harness.c", directory / "block.elf"
    source.write_text(HARNESS)
    core = [path for folder in ("pose", "math", "track") for path in (ROOT / "firmware/core" / folder).glob("*.c")]
    link(elf, [source, *sorted(core)], ["-O3", "-ffp-contract=fast", f"-I{ROOT / 'firmware'}"])
    return Machine(elf)


def pack(values):
    return np.asarray(values, dtype=np.float32).tobytes()


def fly(machine, family, beacons, blocks, rests=False):
    """Start at a moving pose and feed blocks; return the instructions of each, the most of each call, and the stack.

    If the sensor rests its slopes are kept.
    """
    rng = np.random.default_rng(beacons)
    coils, codes = cube(beacons), Bits(family(10), beacons)
    w, v = np.array([0.6, -0.5, 0.6]) * (not rests), np.array([0.5, -0.6, 0.3]) * (not rests)

    def path(t):
        rotation = Rotation.from_rotvec(t * w).as_matrix()
        return State(np.array([0.8, 1.0, 1.1]) + t * v, rotation, w, w, np.array([20.0, 5, -40]), 0 * w)

    table = np.column_stack([coils.centre, coils.axis, coils.k, coils.radius])
    machine.write("coils", pack(table))
    machine.write("count", struct.pack("<I", beacons))
    machine.write("chip_s", pack(CHIP_S))
    machine.write("noise", pack(NOISE))
    ambient = path(0.0).rotation.T @ path(0.0).e
    covariance = (1e-4 * np.eye(3)).ravel()
    machine.write("start", pack([*path(0.0).p, 0.0, 0.0, 0.0, 1.0, *covariance, *covariance, *ambient, 0.02]))
    machine.call("begin")
    if rests:
        machine.call("keep")
    blocks_total, most, stack, used = [], dict.fromkeys(CALLS, 0), 0, {}
    for number in range(1, blocks):
        chip = number * CHIPS
        machine.write("bits", struct.pack(f"<{beacons}I", *codes.words(chip)))
        machine.write("sums", pack(sampled(coils, codes.columns(chip), path, number * BLOCK_S, NOISE, rng)))
        machine.call("copy")
        total = 0
        for name in ("gram", "update", "output"):
            used[name], depth = machine.call(name)
            most[name] = max(most[name], used[name])
            total, stack = total + used[name], max(stack, depth)
        blocks_total.append(total)
        assert machine.word("taken")
        assert machine.word("held") == (rests and number > 1)
    most["sweep"] = machine.call("swept")[0] - used["update"]  # Neither of the two mixes.
    assert machine.word("taken")
    for name in ("measure", "predict", "leave_out", "separate", "site_errors", "choose", "reduce"):
        most[name] = machine.call(name)[0]
    return blocks_total, most, stack


@pytest.mark.parametrize(
    ("beacons", "plain", "mixing", "sweep"),
    [(8, 66_500, 77_500, 24_500), (16, 83_500, 95_000, 45_000), (32, 139_000, 151_000, 105_500)],
)
def test_a_block_within_what_the_headers_say(machine, gold_family, beacons, plain, mixing, sweep):
    """Each fourth block mixes the filters; with the sweep of the ambient field, as in the host, it takes more."""
    totals, most, stack = fly(machine, gold_family, beacons, 14)
    memory = {name: machine.symbols[name][1] for name in ("filter", "block", "pose")}
    print(f"{beacons} beacons: a block {np.median(totals):.0f}, with mixing {max(totals)}, mean {np.mean(totals):.0f}")
    print(f"  instructions at most {most}; stack {stack}; memory {memory}")
    assert np.median(totals) <= plain
    assert max(totals) <= mixing
    assert most["sweep"] <= sweep
    assert stack <= 3000
    assert beacons != 8 or 1.5 * np.mean(totals) <= 0.2 * CHIPS * CHIP_TICKS, "20 % of the time at 1.5 cycles each"


@pytest.mark.parametrize(("beacons", "more"), [(8, 100), (16, 1_400)])
def test_a_block_with_slopes_that_are_kept_takes_hardly_longer(machine, gold_family, beacons, more):
    """A sensor uses 16 beacons at most."""
    kept, _, _ = fly(machine, gold_family, beacons, 14, rests=True)
    anew, _, _ = fly(machine, gold_family, beacons, 14)
    print(f"{beacons} beacons: a block with slopes kept {np.median(kept):.0f}, taken anew {np.median(anew):.0f}")
    assert np.median(kept) <= np.median(anew) + more
    assert beacons != 8 or 1.5 * np.mean(kept) <= 0.2 * CHIPS * CHIP_TICKS, "20 % of the time at 1.5 cycles each"
