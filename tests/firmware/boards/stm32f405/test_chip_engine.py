"""Chips, set-points, samples, coil currents and sync capture of the real driver in the emulator.

All against a plan known beforehand.
"""

import bisect
import itertools
import random
import re
import subprocess

import pytest

from tests.firmware.boards.stm32f405.chip_bench import (
    ANCHOR,
    BOARD,
    BRIDGES,
    CHIPS,
    DISABLED,
    EXCHANGE_SAMPLES,
    HANG_CURRENT,
    HANG_ONCE,
    HERE,
    LONG_BLOCKS,
    LOSE_SAMPLES,
    MASK_INTERRUPTS,
    OUTPUTS,
    PA0,
    PA1,
    PA6,
    PA7,
    PB0,
    PB1,
    PB12,
    PB13,
    PB14,
    PB15,
    PC4,
    PC6,
    RETRY,
    ROOT,
    SENSOR,
    SOFTWARE_FAULT,
    STALL,
    STOP_CHIPS,
    STOP_CURRENT,
    STOP_EDGES,
    STOP_EDGES_8,
    STOP_SET_POINTS,
    TICK_PS,
    Bench,
    drive,
    period,
    set_points,
)


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


@pytest.fixture
def bench(image):
    benches = []

    def make(mode, happens=0, **configuration):
        benches.append(Bench(image, mode, happens, **configuration))
        return benches[-1]

    yield make
    for b in benches:
        b.board.close()


def expected_levels(chip):
    first, second = drive(chip, 0), drive(chip, 1)
    return {PB13: first == 1, PB14: first == 2, PB0: second == 1, PB1: second == 2, PA7: chip % 100 == 7}


def edges_by_chip(bench):
    """Return {chip: {pin: level}} and (chip, pin, ticks behind the chip's start) of every edge on the planned pins."""
    result, offsets = {}, []
    for time_ps, pin, level in bench.edges:
        if pin in OUTPUTS:
            ticks = (time_ps - bench.zero_ps) / TICK_PS
            chip = bisect.bisect_right(bench.starts, ticks + 100) - 1
            result.setdefault(chip, {})[pin] = level
            offsets.append((chip, pin, ticks - bench.starts[chip]))
    return result, offsets


@pytest.mark.parametrize("mode", [0, MASK_INTERRUPTS])
def test_every_edge_of_every_chip(bench, mode):
    b = bench(mode)
    assert b.run(CHIPS), b.board.report()
    changes, offsets = edges_by_chip(b)
    for chip in range(3, CHIPS):  # The drive is enabled in chip 0 or 1.
        before, now = expected_levels(chip - 1), expected_levels(chip)
        assert changes.get(chip, {}) == {pin: level for pin, level in now.items() if before[pin] != level}, chip
    # Behind the timer by the same time in every chip, but for the tick by which slaves at half the clock may differ.
    for pins, jitter in (((PB13, PB14), 0.5), ((PB0, PB1), 0.5), ((PA7,), 2.5)):
        behind = [ticks for chip, pin, ticks in offsets if chip >= 3 and pin in pins]
        print(f"edges {min(behind):.1f} to {max(behind):.1f} ticks behind the chip's start")
        assert max(behind) - min(behind) < jitter
        assert min(behind) >= 0
        assert max(behind) < 40


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
    bridges = [ticks for chip, pin, ticks in edges_by_chip(b)[1] if chip >= 3 and pin in BRIDGES]
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
    assert result["monitors_wrong"] == 0
    assert result["monitors_right"] == result["currents_right"]
    assert result["edges_wrong"] == 0
    assert result["edges_right"] in ((0,) if mode == ANCHOR else (CHIPS, CHIPS + 1))
    assert result["middles_wrong"] == 0
    # The temperature, once a block, takes the middle's place where its interrupt comes late.
    lost = CHIPS // 31 + 1 if mode == MASK_INTERRUPTS else 1
    assert CHIPS - lost <= result["middles_right"] <= CHIPS
    assert result["plan_out_of_order"] == result["late_blocks"] == 0
    assert abs(result["temperature"] - 410) <= 10
    behind = min(ticks for chip, pin, ticks in edges_by_chip(b)[1] if chip >= 3 and pin in (PB13, PB14))
    early, late = (14240, 14500) if mode & ANCHOR else (15640, 15900)
    taken = {pin: [(c, t) for p, c, _, t in b.conversions if p == pin] for pin in (PA0, PC4)}
    assert taken[PA0] == taken[PC4]  # At one moment.
    assert [chip for chip, _ in taken[PA0][:CHIPS]] == list(range(CHIPS))
    assert all(early < ticks - behind < late - 12 * 8 for _, ticks in taken[PA0])
    middles = {pin: [(c, t) for p, c, t in b.middles if p == pin] for pin in (PA0, PC4)}
    assert middles[PA0] == middles[PC4]
    ends = dict(taken[PA0])
    shares = [middle / ends[chip] for chip, middle in middles[PA0] if chip < CHIPS]
    assert 2 / 5 < min(shares) <= max(shares) <= 1 / 2
    if mode != ANCHOR:  # From the moment behind the edge, too.
        edge = 4 * 168
        shares = [(middle - edge) / (ends[chip] - edge) for chip, middle in middles[PA0] if chip < CHIPS]
        assert 2 / 5 < min(shares) <= max(shares) <= 1 / 2


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


@pytest.mark.parametrize(
    ("mode", "happens"), [(0, 0), (MASK_INTERRUPTS, 0), (SENSOR, 0), (0, LONG_BLOCKS), (SENSOR, LONG_BLOCKS)]
)
def test_sync_edges(bench, mode, happens):
    """The number of the chip and the tick are right wherever the edge lies, under block handlers of 3 chips, too."""
    b = bench(mode, happens)
    assert b.run(1), b.board.report()
    random.seed(7)
    truth = []
    for chip in (c for c in range(5, CHIPS - 20) if c % 31 == 0 or (c % 31 in (7, 15, 23) and c % 2)):
        # Around chip boundaries, around the middle, and anywhere.
        ticks = random.choice([-3, 0, 5, 30, 3990, 7950, 7990, 8010, 8090, random.randrange(16000), 16300])
        truth.append((b.starts[chip] + ticks, chip, ticks))
    for _, chip, ticks in truth:
        b.pulse(PC6, chip, ticks, 20_000_000)
    assert b.run(CHIPS), b.board.report()
    result = b.probe()
    assert result["late_blocks"] == 0
    edges = result["edges"]
    assert len(edges) == len(truth)
    late = [b.starts[chip] + ticks - true[0] for (chip, ticks), true in zip(edges, truth, strict=True)]
    assert all(ticks < period(chip, mode) for chip, ticks in edges)
    # The input filter's eight samples and the synchroniser; time zero a few instructions before the timer starts.
    assert min(late) > -20
    assert max(late) < 20
    assert max(late) - min(late) <= 2


def test_serial_input_under_long_handlers_loses_nothing(bench):
    """Bursts of 80 bytes, with an idle line before, while block handlers of 300 us hold everything up."""
    b = bench(0, LONG_BLOCKS)
    assert b.run(1), b.board.report()
    sent = 0
    for block in range(2, 42):
        start = b.zero_ps + round(block * 31 * 16415 * TICK_PS) + block * 120_000
        assert b.board.run(start), b.board.report()
        for i in range(80):
            b.board.uart_in(3, i, 2_000_000, start + (0 if i == 0 else 20 + 5 * i) * 1_000_000)
        sent += 80
    assert b.board.run(start + 5_000_000_000), b.board.report()
    result = b.probe()
    assert (result["received"], result["serial_overruns"]) == (sent, 0)


def test_a_plan_that_comes_a_block_late_is_counted_once(bench):
    b = bench(ANCHOR | STALL)
    assert b.run(CHIPS), b.board.report()
    result = b.probe()
    assert result["late_blocks"] == 1
    assert result["plan_out_of_order"] == result["samples_out_of_order"] == 0
    assert result["samples_wrong"] == 0
    changes, _ = edges_by_chip(b)
    for chip in itertools.chain(range(3, 20 * 31), range(21 * 31 + 1, CHIPS)):
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


def test_the_image_sets_the_pins_of_the_pinout(bench):
    """Each pin of pinout.md has its mode, its alternate function and its pull; no other pin is an output."""
    b = bench(0)
    assert b.run(1), b.board.report()
    ports = b.probe()["ports"]
    table = (ROOT / "firmware" / "boards" / "pinout.md").read_text()
    rows = re.findall(r"^\| P([A-C])(\d+) \| \w+ \| [\w, ]+ \| (.+) \| (\w+)(?: \(AF(\d+)\))? \|$", table, re.M)
    named = set()
    for letter, digits, signal, function, alternate in rows:
        port, number = "ABC".index(letter), int(digits)
        named.add((port, number))
        moder, pupdr, low, high = ports[port]
        mode = moder >> 2 * number & 3
        assert mode == (2 if alternate else 1 if function == "GPIO" else 3), (letter, number)
        if alternate:
            assert (high if number >= 8 else low) >> 4 * (number % 8) & 15 == int(alternate)
        if signal.endswith("pull-up"):
            assert pupdr >> 2 * number & 3 == 1
    for port in range(3):
        for number in range(16):
            if (port, number) not in named and (port, number) not in ((0, 13), (0, 14), (0, 15), (1, 3)):  # Debug port.
                assert ports[port][0] >> 2 * number & 3 == 0, (port, number)


def test_outputs_are_low_until_the_drive_is_enabled_and_enable_follows(bench):
    b = bench(DISABLED)
    assert b.run(50), b.board.report()
    assert not any(level for pin in (*BRIDGES, PB15) for _, _, level in b.levels(pin))
    assert any(level for _, _, level in b.levels(PA7)), "the sync wire does not ask for the drive"
    assert b.probe()["currents_right"] >= 49, "currents are measured with the drive off"


def test_a_fault_of_the_drivers_switches_off_in_hardware_and_is_a_level(bench):
    b = bench(RETRY)
    assert b.run(100), b.board.report()
    assert b.levels(PB15)[-1][2]
    before = b.board.now_ps
    b.fault(True)
    assert b.run(200), b.board.report()
    off = [time for time, pin, level in b.edges if pin == PB15 and not level and time >= before]
    assert len(off) == 1
    assert off[0] - before < 1e12 / 168e6 * 2, "no instruction comes between"
    assert not [1 for time, pin, level in b.edges if pin in (*BRIDGES, PB15) and level and time > off[0]]
    result = b.probe()
    assert (result["fault_driver"], result["fault_stale"]) == (1, 0), "it is told once, however long it lasts"
    assert result["fault_line"] == 1
    assert result["refused"] >= 2
    assert result["enabled"] == 1
    b.fault(False)
    assert b.run(300), b.board.report()
    result = b.probe()
    assert result["enabled"] == 2
    assert result["fault_line"] == 0
    assert b.levels(PB15)[-1][2]
    b.fault(True)
    assert b.run(400), b.board.report()
    assert b.probe()["fault_driver"] == 2


@pytest.mark.parametrize("pins", [(PB12,), (PA6,)])
def test_either_break_input_alone_switches_both_bridges_off(bench, pins):
    b = bench(0)
    assert b.run(100), b.board.report()
    b.fault(True, pins)
    assert b.run(104), b.board.report()
    assert not b.levels(PB15)[-1][2]
    assert not [1 for pin in BRIDGES for chip, _, level in b.levels(pin) if level and chip > 101]
    assert b.probe()["fault_driver"] == 1


def test_a_fault_before_the_start_is_told_and_keeps_the_drive_off(bench):
    b = bench(RETRY)
    b.fault(True)
    assert b.run(100), b.board.report()
    result = b.probe()
    assert (result["fault_driver"], result["enabled"]) == (1, 0)
    assert not any(level for pin in (*BRIDGES, PB15) for _, _, level in b.levels(pin))


@pytest.mark.parametrize("happens", [STOP_CURRENT, STOP_EDGES, STOP_EDGES_8, STOP_SET_POINTS, STOP_CHIPS, HANG_CURRENT])
@pytest.mark.parametrize("mode", [0, ANCHOR])
def test_what_stands_still_is_off_within_two_chips(bench, mode, happens):
    b = bench(mode, happens, strict=False)
    b.run(9 * 31)  # The plan of block 10 is made when block 9 begins.
    assert b.levels(PB15)[-1][2]
    b.board.run(b.board.now_ps + 25 * 100_000_000)
    chip, ticks, level = b.levels(PB15)[-1]
    assert not level
    assert chip + ticks / 16422 - b.probe()["happened"] < 4, "two chips behind the last current that was in step"
    expected = 0 if happens == HANG_CURRENT else 1
    assert b.probe()["fault_stale"] == expected, "told, unless the one to tell hangs"


def test_nothing_is_told_of_a_drive_that_is_off(bench):
    b = bench(DISABLED, STOP_CURRENT, strict=False)
    assert b.run(400), b.board.report()
    result = b.probe()
    assert result["fault_driver"] == result["fault_stale"] == result["fault_clock"] == 0


def test_a_drive_that_is_enabled_without_currents_is_off_after_two_chips(bench):
    b = bench(RETRY, STOP_CURRENT, strict=False)
    assert b.run(330), b.board.report()
    result = b.probe()
    assert result["fault_stale"] >= 2
    edges = [(chip + ticks / 16422, level) for chip, ticks, level in b.levels(PB15) if chip > 9 * 31]
    on = [off - on for (on, up), (off, _) in itertools.pairwise(edges) if up]
    assert len(on) >= 1
    assert max(on) < 2.2


def test_a_trip_of_the_board_tells_its_cause(bench):
    b = bench(0, SOFTWARE_FAULT)
    assert b.run(9 * 31 + 2), b.board.report()
    result = b.probe()
    assert (result["fault_driver"], result["fault_stale"], result["fault_clock"]) == (0, 0, 1)
    assert not b.levels(PB15)[-1][2]


@pytest.mark.parametrize("mode", [SENSOR, ANCHOR])
def test_exchanged_axes_are_noticed(bench, mode):
    b = bench(mode, EXCHANGE_SAMPLES)
    assert b.run(CHIPS), b.board.report()
    result = b.probe()
    assert result["converter_overruns"] == 1
    assert result["samples_wrong"] == 0
    assert 1 <= result["blocks_lost"] <= 3
    assert result["samples_right"] == (result["sampled"] - result["blocks_lost"]) * 31 * 24
