"""Chips, set-points, samples, coil currents and sync capture of the real driver in the emulator.

All against a plan known beforehand. Time zero is the moment the LED pin falls, which the driver does together with the
start of the chip timer.
"""

import bisect
import itertools
import random
import struct
import subprocess
from pathlib import Path

import pytest

from hil_sim import clib
from hil_sim.emulator.emulator import LIBRARY, Configuration, Emulator

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[3]
BOARD = "firmware/boards/stm32f405"
SENSOR, MASK_INTERRUPTS, STALL, LOSE_SAMPLES, HANG_ONCE, ANCHOR = 1, 2, 4, 8, 16, 32
PA0, PA1, PA6, PA10, PC4, PC5, PC6, PC7, PC8, PC12 = 0, 1, 6, 10, 36, 37, 38, 39, 40, 44
TICK_PS = 1e12 / 168e6
FIELDS = (
    *("hal", "mode", "planned", "plan_out_of_order", "samples_right", "samples_wrong", "blocks_lost"),
    *("samples_out_of_order", "sampled", "currents_right", "currents_wrong", "syncs"),
)
COUNTERS = ("serial_overruns", "can_errors", "can_overruns", "late_blocks", "converter_overruns", "watchdog_resets")
CHIPS = 700


@pytest.fixture(scope="module")
def image(tmp_path_factory):
    path = tmp_path_factory.mktemp("probe") / "probe.elf"
    objects = sorted((ROOT / "build" / "firmware" / BOARD).glob("*.o"))
    assert objects, "the board is not built: run make firmware"
    cpu = ["-mcpu=cortex-m4", "-mthumb", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard", "-O2", "-std=c11", "-Wall"]
    link = ["-nostartfiles", "--specs=nano.specs", "-Wl,--gc-sections", "-T", str(ROOT / BOARD / "stm32f405.ld")]
    include = [f"-I{ROOT / 'firmware'}"]
    subprocess.run(
        ["arm-none-eabi-gcc", *cpu, *include, str(HERE / "chip_probe.c"), *map(str, objects), *link, "-o", str(path)],
        check=True,
    )
    return path


def period(chip, mode):
    return 16422 if mode & STALL else 16350 + chip * 37 % 131


def drive(chip, channel):
    mixed = chip * 2654435761 % 2**32
    return (mixed >> 8 & 0xFF) % 3 if channel else (mixed >> 16) % 3


def set_points(chip):
    return [min(chip * 29 % 4200, 4095), chip * 53 % 4096]


class Bench:
    """A board with the probe image; every conversion's volts tell chip, number in the chip, and axis."""

    def __init__(self, image, mode, **configuration):
        self.mode = mode
        self.starts = [0, *itertools.accumulate(period(c, mode) for c in range(CHIPS + 200))]
        self.zero_ps = None
        self.edges = []  # (time, pin, level) since the start
        self.analog = ([], [])  # (time, counts) of each channel
        self.conversions = []  # (pin, chip, number in the chip, ticks since the chip's start)
        self._ffi, _ = clib.load(LIBRARY, ["emulator/emulator.h"])
        edge = self._ffi.new("board_edge_t *")
        self._keep = [
            edge,
            self._ffi.callback("void(void *, unsigned, bool, int64_t)", self._pin_out),
            self._ffi.callback("double(void *, unsigned, int64_t)", self._analog_in),
            self._ffi.callback("void(void *, unsigned, double, int64_t)", self._analog_out),
        ]
        edge.pin_out, edge.analog_in, edge.analog_out = self._keep[1:]
        self.board = Emulator(
            image,
            Configuration(**configuration),
            edge=int(self._ffi.cast("uintptr_t", edge)),
            parameter_page=bytes([mode]) + bytes(1023),
        )

    def _pin_out(self, _, pin, level, time_ps):
        if pin == PC12 and not level:
            self.zero_ps = time_ps
        if self.zero_ps is not None:
            self.edges.append((time_ps, pin, bool(level)))

    def _analog_out(self, _, channel, volts, time_ps):
        self.analog[channel - 1].append((time_ps, round(volts / 3.3 * 4096)))

    def _analog_in(self, _, pin, time_ps):
        if self.zero_ps is None:
            return 1.65
        ticks = (time_ps - self.zero_ps) / TICK_PS
        chip = bisect.bisect_right(self.starts, ticks) - 1
        ticks -= self.starts[chip]
        if ticks < 14000:  # Converted beside the temperature, for nobody.
            return 0.0
        number = sum(1 for p, c, *_ in self.conversions[-60:] if (p, c) == (pin, chip))
        if pin == PA1 + 2 and ticks < 14500:  # Beside an anchor's currents.
            return 0.0
        self.conversions.append((pin, chip, number, ticks))
        if pin == PA6:
            return ((chip * 8 * 5) % 4000 + 70.25) * 3.3 / 4096
        axis = max(pin - PA1, 0)
        return (((chip * 8 + number) * 5 + axis * 1000) % 4000 + 50.25) * 3.3 / 4096

    def run(self, chips):
        """Run to a little behind the start of a chip; the chip engine starts within 20 ms."""
        step = 0
        while self.zero_ps is None and step < 400:
            step += 1
            assert self.board.run(step * 50_000_000), self.board.report()
        assert self.zero_ps is not None
        end = self.zero_ps + int((self.starts[chips] + 1000) * TICK_PS)
        return self.board.run(end)

    def probe(self):
        address = self.board.symbols["probe"]
        words = struct.unpack("<12I", self.board.memory(address, 48))
        result = dict(zip(FIELDS, words, strict=True))
        syncs = struct.unpack("<128I", self.board.memory(address + 48, 512))
        result["edges"] = list(zip(syncs[:64], syncs[64:], strict=True))[: result["syncs"]]
        result |= zip(COUNTERS, struct.unpack("<6I", self.board.memory(address + 560, 24)), strict=True)
        result["temperature"] = struct.unpack("<i", self.board.memory(address + 584, 4))[0]
        return result


@pytest.fixture
def bench(image):
    benches = []

    def make(mode, **configuration):
        benches.append(Bench(image, mode, **configuration))
        return benches[-1]

    yield make
    for b in benches:
        b.board.close()


def expected_levels(chip):
    first, second = drive(chip, 0), drive(chip, 1)
    return {PC6: first == 1, PC7: first == 2, PC4: second == 1, PC5: second == 2, PC8: chip % 100 == 7}


def edges_by_chip(bench):
    """Return {chip: {pin: level}} and the ticks behind the chip's start of every edge on the planned pins."""
    result, offsets = {}, []
    for time_ps, pin, level in bench.edges:
        if pin in (PC4, PC5, PC6, PC7, PC8):
            ticks = (time_ps - bench.zero_ps) / TICK_PS
            chip = bisect.bisect_right(bench.starts, ticks + 100) - 1
            result.setdefault(chip, {})[pin] = level
            offsets.append((chip, ticks - bench.starts[chip]))
    return result, offsets


@pytest.mark.parametrize("mode", [0, MASK_INTERRUPTS])
def test_every_edge_of_every_chip(bench, mode):
    b = bench(mode)
    assert b.run(CHIPS), b.board.report()
    changes, offsets = edges_by_chip(b)
    for chip in range(1, CHIPS):
        before, now = expected_levels(chip - 1), expected_levels(chip)
        assert changes.get(chip, {}) == {pin: level for pin, level in now.items() if before[pin] != level}, chip
    # Behind the timer by the same time in every chip: no jitter against the board's own clock.
    behind = [ticks for chip, ticks in offsets if chip >= 1]
    assert max(behind) - min(behind) < 1.0
    assert 0 <= min(behind) < 40


@pytest.mark.parametrize("mode", [0, MASK_INTERRUPTS, ANCHOR])
def test_every_set_point_changes_with_its_chip(bench, mode):
    b = bench(mode)
    assert b.run(CHIPS), b.board.report()
    behind = []
    for channel in range(2):
        truth = {
            c: set_points(c)[channel]
            for c in range(CHIPS)
            if c == 0 or set_points(c)[channel] != set_points(c - 1)[channel]
        }
        seen = {}
        for time_ps, count in b.analog[channel]:
            ticks = (time_ps - b.zero_ps) / TICK_PS
            chip = bisect.bisect_right(b.starts, ticks) - 1
            seen[max(chip, 0)] = count  # That of chip 0 is there before the start.
            if chip >= 0:
                behind.append(ticks - b.starts[chip])
        assert {c: n for c, n in seen.items() if c < CHIPS} == truth
    bridges = [ticks for chip, ticks in edges_by_chip(b)[1] if chip >= 1]
    print(
        f"bridges {max(bridges):.1f}, set-points {min(behind):.1f} to {max(behind):.1f} ticks behind the chip's start"
    )
    assert max(behind) - min(behind) < 4.0  # The DAC's clock has four ticks.
    assert all(abs(ticks - max(bridges)) < 17 for ticks in behind)  # 0.1 us


@pytest.mark.parametrize("mode", [0, MASK_INTERRUPTS, ANCHOR])
def test_currents_belong_to_their_chip(bench, mode):
    b = bench(mode, temperature_degc=41.0)
    assert b.run(CHIPS), b.board.report()
    result = b.probe()
    assert result["currents_wrong"] == 0
    assert result["currents_right"] in (CHIPS - 1, CHIPS)
    assert result["plan_out_of_order"] == result["late_blocks"] == 0
    assert abs(result["temperature"] - 410) <= 10
    early, late = (14240, 14540) if mode & ANCHOR else (15640, 15900)
    taken = {pin: [(c, t) for p, c, _, t in b.conversions if p == pin] for pin in (PA0, PA6)}
    assert taken[PA0] == taken[PA6]  # At one moment.
    assert [chip for chip, _ in taken[PA0][:CHIPS]] == list(range(CHIPS))
    assert all(early < ticks < late - 12 * 8 for _, ticks in taken[PA0])


@pytest.mark.parametrize("mode", [SENSOR, SENSOR | MASK_INTERRUPTS, ANCHOR, ANCHOR | MASK_INTERRUPTS])
def test_samples_belong_to_their_chip(bench, mode):
    b = bench(mode, temperature_degc=41.0)
    assert b.run(CHIPS), b.board.report()
    result = b.probe()
    assert result["samples_wrong"] == result["blocks_lost"] == result["converter_overruns"] == 0
    assert result["samples_right"] == CHIPS // 31 * 31 * 24
    assert result["samples_out_of_order"] == result["late_blocks"] == 0
    assert abs(result["temperature"] - 410) <= 10
    for axis in range(3):
        taken = [(chip, number, ticks) for pin, chip, number, ticks in b.conversions if pin == PA1 + axis]
        assert [t[:2] for t in taken[: CHIPS * 8]] == [(c, i) for c in range(CHIPS) for i in range(8)]
        # The last conversion ends, 12 converter cycles behind its sampling, at most 1 us before the nominal chip end.
        ends = [ticks + 12 * 8 for _, number, ticks in taken if number == 7]
        assert min(ends) >= 16422 - 168
        assert max(ends) <= 16422


@pytest.mark.parametrize("mode", [0, MASK_INTERRUPTS, SENSOR])
def test_sync_edges(bench, mode):
    b = bench(mode)
    assert b.run(1), b.board.report()
    random.seed(7)
    truth = []
    for chip in range(5, 5 + 60 * 11, 11):
        # Around chip boundaries, around count 4000 and 8000 where the driver changes its mind, and anywhere.
        ticks = random.choice([-3, 0, 5, 30, 3990, 4010, 7990, 8010, random.randrange(16000), 16300])
        truth.append(b.starts[chip] + ticks)
        time_ps = b.zero_ps + round(truth[-1] * TICK_PS)
        assert b.board.run(time_ps - 1_000_000), b.board.report()
        b.board.pin_in(PA10, True, time_ps)
        b.board.pin_in(PA10, False, time_ps + 90_000_000)
    assert b.run(CHIPS), b.board.report()
    edges = b.probe()["edges"]
    assert len(edges) == len(truth)
    late = [b.starts[chip] + ticks - true for (chip, ticks), true in zip(edges, truth, strict=True)]
    assert all(ticks < period(chip, mode) for chip, ticks in edges)
    # The input filter's eight samples and the synchroniser; time zero a few instructions before the timer starts.
    assert min(late) > -20
    assert max(late) < 20
    assert max(late) - min(late) <= 2


def test_a_plan_that_comes_a_block_late_is_counted_once(bench):
    b = bench(SENSOR | STALL)
    assert b.run(CHIPS), b.board.report()
    result = b.probe()
    assert result["late_blocks"] == 1
    assert result["plan_out_of_order"] == result["samples_out_of_order"] == 0
    assert result["samples_wrong"] == 0
    changes, _ = edges_by_chip(b)
    for chip in itertools.chain(range(1, 20 * 31), range(21 * 31 + 1, CHIPS)):
        before, now = expected_levels(chip - 1), expected_levels(chip)
        assert changes.get(chip, {}) == {pin: level for pin, level in now.items() if before[pin] != level}, chip


def test_lost_samples_are_marked_and_counted_and_come_back_in_step(bench):
    b = bench(SENSOR | LOSE_SAMPLES, strict=False)
    assert b.run(CHIPS), b.board.report()
    result = b.probe()
    assert result["converter_overruns"] == 1
    assert result["samples_wrong"] == 0
    assert 1 <= result["blocks_lost"] <= 4
    assert result["samples_right"] == (result["sampled"] - result["blocks_lost"]) * 31 * 24


def test_a_watchdog_reset_is_told(bench):
    b = bench(HANG_ONCE)
    assert b.board.run(400_000_000_000), b.board.report()
    assert b.probe()["watchdog_resets"] == 0
    assert b.board.run(700_000_000_000), b.board.report()
    assert b.probe()["watchdog_resets"] == 1
