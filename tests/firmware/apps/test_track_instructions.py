"""What the sensor's own track costs its processor: the objects of the image itself on a Cortex-M4 (Unicorn)."""

import struct
import subprocess

import magpylib
import numpy as np
import pytest
import unicorn
from scipy.spatial.transform import Rotation

from goldfield_protocol.parameters import build_page
from hil_sim.clib import ROOT
from tests.firmware.apps.test_app_instructions import FLAGS, HARNESS
from tests.firmware.apps.test_sensor_app import MATRIX, ZERO
from tests.firmware.cortex_m4 import Machine
from tests.firmware.host_rig import gold_chips

MORE = """
uint32_t edge_chip;
void call_sync(void) { events.sync(events.context, edge_chip, 0); }
void start_again(void) {
    (void)parameters_set(&sensor.node.parameters, PARAMETER_STREAM, (parameter_value_t){PARAMETER_UNSIGNED, 0});
    sensor.node.parameters_changed = true;
    sensor_step(&sensor);
}
void look(void) { count = (uint32_t)tracking.state; }
void blame(void) { count = tracking.suspect != POSE_NOBODY ? tracking.suspect : tracking.verdict.left_out; }
"""
CALLS = ("begin_sensor", "call_plan", "call_samples", "call_sync", "step_sensor", "start_again", "look", "blame")
CHIPS, BLOCK, TICKS = 1023, 31, 31 * 16422
POSITION, ATTITUDE = np.array([0.9, 1.2, 0.8]), Rotation.from_rotvec([0.3, -0.2, 1.1])
SEARCHES, FOLLOWS = 1, 2
NOBODY = 0xFFFFFFFF
SENSED = ("sense_blocks", "tracking_take")


@pytest.fixture(scope="module")
def elf(tmp_path_factory):
    directory = tmp_path_factory.mktemp("track")
    source, elf = directory / "harness.c", directory / "track.elf"
    source.write_text(HARNESS + MORE)
    built = ROOT / "build/firmware"
    objects = [
        path
        for folder in ("apps", "services", "core/*", "third_party/*")
        for path in sorted((built / "firmware").glob(f"{folder}/*.o"))
    ]
    objects.append(built / "protocol/goldfield.o")
    includes = [f"-I{ROOT / path}" for path in ("firmware", "build/protocol")]
    undefined = [f"-Wl,-u,{name}" for name in CALLS]
    command = ["arm-none-eabi-gcc", *FLAGS, *includes, source, *objects, *undefined, "-o", elf]
    subprocess.run(list(map(str, command)), check=True)
    return elf


class Sensor:
    """A sensor that stands among coils on the walls of a room of 2.5 m, and its sync wire."""

    def __init__(self, elf, beacons, **parameters):
        self.machine = Machine(elf)
        rng = np.random.default_rng(beacons)
        centres = rng.uniform(0.0, 2.5, (beacons, 3))
        centres[np.arange(beacons), np.arange(beacons) % 3] = np.where(np.arange(beacons) % 6 < 3, 0.0, 2.5)
        axes = rng.normal(size=(beacons, 3))
        axes /= np.linalg.norm(axes, axis=1)[:, None]
        codes = list(range(2, 2 + beacons))
        moment = 190.0 * np.pi * 0.149**2
        rows = [[*centre, *axis, moment, 0.149] for centre, axis in zip(centres, axes, strict=True)]
        coils = [
            magpylib.current.Circle(
                diameter=0.298, current=190.0, position=centre, orientation=Rotation.align_vectors(axis, [0, 0, 1])[0]
            )
            for centre, axis in zip(centres, axes, strict=True)
        ]
        fields = ATTITUDE.inv().apply([coil.getB(POSITION) for coil in coils] + [np.array([2e-5, 0.0, -4.5e-5])])
        chips = np.array([*(gold_chips(code) for code in codes), np.ones(CHIPS)]).T
        clean = (chips @ fields) @ np.linalg.inv(MATRIX).T + ZERO
        self.fields, self.chips = fields, chips
        self.noise_counts = rng.normal(0.0, 2e-7, (16 * CHIPS, 3)) @ np.linalg.inv(MATRIX).T
        self.clean = clean
        values = {
            "node": 100,
            "code_count": beacons,
            "code_list": codes,
            "pose": 1,
            "pose_blocks": 1,
            "beacons": [float(x) for row in rows for x in row],
            "calibration": [float(x) for x in MATRIX.ravel()],
            **{f"zero_{axis}": float(zero) for axis, zero in zip("xyz", ZERO, strict=True)},
        }
        self.machine.write("page", build_page(values | parameters))
        self.machine.call("begin_sensor")
        self.blocks = 0
        for _ in range(2):
            self.machine.call("call_plan")

    def sample(self):
        """The interrupts of the next block: instructions of samples and plan."""
        chips = np.arange(self.blocks * BLOCK, (self.blocks + 1) * BLOCK)
        for chip in chips[chips % CHIPS == 0]:
            self.machine.write("edge_chip", struct.pack("<I", chip))
            self.machine.call("call_sync")
        counts = self.clean[chips % CHIPS] + self.noise_counts[chips % len(self.noise_counts)]
        bursts = np.repeat(counts[:, None, :], 8, axis=1) + np.arange(8)[None, :, None] / 8.0
        self.machine.write("samples", np.clip(np.floor(bursts), 1, 4094).astype("<u2").tobytes())
        self.blocks += 1
        return self.machine.call("call_samples")[0] + self.machine.call("call_plan")[0]

    def step(self):
        return self.machine.call("step_sensor")[0]

    def silence(self, row):
        """From now on a beacon has no field."""
        self.clean = self.clean - np.outer(self.chips[:, row], self.fields[row]) @ np.linalg.inv(MATRIX).T

    @property
    def blamed(self):
        """The row of the beacon that is not believed, or `NOBODY`."""
        self.machine.call("blame")
        return self.machine.word("count")

    @property
    def state(self):
        self.machine.call("look")
        return self.machine.word("count")

    def follow(self):
        """Run until there is a track, and 2 cycles more."""
        while self.state != FOLLOWS:
            assert self.blocks < 500
            self.sample()
            self.step()
        for _ in range(66):
            self.sample()
            self.step()


@pytest.mark.parametrize(("beacons", "most"), [(8, 114_000), (16, 153_000), (32, 175_000)])
def test_share_of_the_processor_with_a_pose_of_each_block(elf, beacons, most):
    """A cycle of interrupts and main: what tracking.h says of all that a sensor does, of a block's 509,000 ticks."""
    sensor = Sensor(elf, beacons)
    sensor.follow()
    interrupts, main = [], []
    for _ in range(33):
        interrupts.append(sensor.sample())
        main.append(sensor.step())
        while (more := sensor.step()) > 1000:
            main[-1] += more
    assert sensor.state == FOLLOWS
    mean = (sum(interrupts) + sum(main)) / 33
    shares = " ".join(f"{100.0 * mean * cycles / TICKS:.0f} %" for cycles in (1.0, 1.5, 2.5))
    print(f"{beacons} beacons: interrupts {max(interrupts)}, main for a block {int(np.median(main))}, ", end="")
    print(f"at a cycle's end {max(main)}, mean of all {mean:.0f}, of the time at 1, 1.5, 2.5 {shares}")
    assert mean <= most


@pytest.mark.slow
def test_a_silent_beacon_is_found_although_it_is_the_weakest_of_32(elf):
    """It is used only in turn, for two of 18 cycles, until it does not agree with the site."""
    sensor = Sensor(elf, 32)
    sensor.follow()
    row = int(np.argmin(np.linalg.norm(sensor.fields[:-1], axis=1)))
    assert sensor.blamed == NOBODY
    sensor.silence(row)
    begun, blamed = sensor.blocks, []
    while row not in blamed and sensor.blocks - begun < 22 * 33:
        sensor.sample()
        while sensor.step() > 1000:
            pass
        assert sensor.state == FOLLOWS
        blamed.append(sensor.blamed)
    print(f"after {len(blamed)} blocks; blamed: {sorted(set(blamed))}")
    assert set(blamed) == {NOBODY, row}


@pytest.mark.parametrize(("beacons", "most"), [(8, 230_000), (16, 430_000), (32, 820_000)])
def test_slices_of_a_start(elf, beacons, most):
    sensor = Sensor(elf, beacons)
    sensor.follow()
    sensor.machine.call("start_again")
    sensor.machine.write("asked_us", struct.pack("<I", 2000))
    slices, searching = [], False
    for _ in range(12):
        sensor.sample()
        for _ in range(6):
            slices.append(sensor.step())
            searching = searching or sensor.state == SEARCHES
        if searching and sensor.state == FOLLOWS:
            break
    assert sensor.state == FOLLOWS
    print(f"{beacons} beacons: slices of a start at most {max(slices)}, in all {sum(slices)}")
    assert max(slices) <= most


class Turns:
    """When the steps of a turn begin, us after the beginning of their part of the turn, as the board's clock says."""

    def __init__(self, machine, part, step):
        self.machine, self.turns = machine, []
        self._begin_us = 0
        for name, note in ((part, self._begin), (step, self._step)):
            address = machine.symbols[name][0] & ~1
            machine.unicorn.hook_add(unicorn.UC_HOOK_CODE, note, begin=address, end=address)
        machine.unicorn.ctl_flush_tb()  # What was translated before does not know of the hooks.

    def _now_us(self):
        return struct.unpack("<Q", self.machine.unicorn.mem_read(self.machine.symbols["hal"][0], 8))[0]

    def _begin(self, *_):
        self._begin_us = self._now_us()
        self.turns.append([])

    def _step(self, *_):
        self.turns[-1].append(self._now_us() - self._begin_us)


def test_no_step_of_a_pose_begins_after_2_ms_of_a_turn(elf):
    """A clock on which everything takes long: the steps of a start, and the poses of blocks that wait."""
    sensor = Sensor(elf, 8)
    sensor.follow()
    steps, blocks = (Turns(sensor.machine, *names) for names in (("sense_spare", "pose_step"), SENSED))
    asked_us, late_us = 350, 2000 + 2 * 350
    sensor.machine.write("asked_us", struct.pack("<I", asked_us))
    for _ in range(6):
        sensor.sample()
    for _ in range(3):
        sensor.step()
    full = [turn for turn in blocks.turns if turn]
    assert sum(map(len, full)) == 6
    assert len(full[0]) < 6
    assert 1000 < max(full[0]) < late_us
    sensor.machine.call("start_again")
    while sensor.state != SEARCHES:
        sensor.sample()
        sensor.step()
    while sensor.state == SEARCHES:
        sensor.step()
    ends = [max(turn) for turn in steps.turns if turn]
    assert len(ends) > 2
    assert max(ends) < late_us
    assert np.median(ends) > 1000


def test_a_step_of_a_pose_leaves_the_next_block_free(elf):
    """While blocks are sent, steps begin only soon after one; a cycle is located all the same."""
    sensor = Sensor(elf, 8, pose_blocks=0, blocks=1)
    for _ in range(5 * 33):
        sensor.sample()
        sensor.step()
    steps = Turns(sensor.machine, "blocks_step", "pose_step")
    sensor.machine.write("asked_us", struct.pack("<I", 250))  # A step is over when it is too late for another.
    for _ in range(3 * 33):
        sensor.sample()
        for _ in range(3):
            sensor.step()
    assert sum(map(len, steps.turns)) >= 4  # Two for each cycle.
    assert max(map(len, steps.turns)) == 1
