"""A crystal that stops and a supply that falls while a beacon drives its coil: the flashable image in the emulator."""

from itertools import pairwise

import pytest

from hil_sim.emulator.emulator import Configuration, Emulator
from tests.firmware.host_rig import MS, PIN_ENABLE, ROOT, SECOND, US, Coil, beacon

CHIP = 98 * US
XPSR, ADC_EXCEPTION = 16, 16 + 18  # emulator.h; RM0090, table 62
CLOCK_FALLBACK, CLOCK_COUNTER, DIPS_COUNTER = 5, 7, 18
SUPPLY_LOW = 9  # firmware/core/drive/cause.h
ROLES = ["beacon", "sensor", "anchor"]


@pytest.fixture
def driving():
    """A beacon that has driven its coil for a while."""
    page = {"node": 9, "code": 2, "amplitude": 5.0, "sync_master": 1}
    board = beacon(Coil(), parameters=page, emulated=True)
    board.run(1500 * MS)
    assert board.level[PIN_ENABLE]
    yield board
    board.close()


def counters(board):
    return {m.index: m.signals["value"] for m in board.messages("COUNTER")}


def test_a_crystal_that_stops_switches_the_coil_off_and_the_board_goes_on(driving):
    driving.emulator.crystal(False, 1500 * MS)
    driving.run(1500 * MS + 2 * CHIP)
    assert not driving.level[PIN_ENABLE]
    heard = len(driving.messages())
    driving.run(4 * SECOND)
    assert not driving.level[PIN_ENABLE]
    assert [t for t in driving.edges(PIN_ENABLE) if t > 1500 * MS] == []
    told = driving.messages()[heard:]
    beats = [m.signals["state"] for m in told if m.name == "HEARTBEAT"]
    assert len(beats) >= 2
    assert set(beats) == {CLOCK_FALLBACK}
    assert counters(driving)[CLOCK_COUNTER] == 1
    assert not any(m.name == "RESET_REPORT" for m in told)  # it did not restart
    assert all(not m.signals["enabled"] for m in told if m.name == "DRIVE_STATUS")


def test_a_board_that_lost_its_crystal_keeps_its_baud_rate(driving):
    driving.emulator.crystal(False, 1500 * MS)
    driving.run(1600 * MS)
    times = [t for t, _ in driving.serial]
    driving.run(3 * SECOND)
    late = [t for t, _ in driving.serial[len(times) :]]
    steps = [b - a for a, b in pairwise(late)]
    assert min(steps) == pytest.approx(5 * US, rel=1e-3)


def test_a_supply_that_falls_switches_the_coil_off_and_is_counted(driving):
    driving.emulator.supply(2.75, 1500 * MS)
    driving.emulator.supply(3.3, 1501 * MS)
    driving.run(1500 * MS + CHIP)
    assert not driving.level[PIN_ENABLE]
    driving.run(2500 * MS)
    assert counters(driving)[DIPS_COUNTER] == 1
    assert driving.messages("DRIVE_HEALTH")[-1].signals["cause"] == SUPPLY_LOW


def test_a_supply_that_falls_waits_for_no_handler(driving):
    """It falls as soon as a handler of the currents runs, which takes 2 us and more."""
    time = 1500 * MS
    while driving.emulator.register(XPSR) & 0x1FF != ADC_EXCEPTION:
        time += US // 4
        assert time < 1500 * MS + 2 * CHIP
        driving.run(time)
    driving.emulator.supply(2.75, time)
    driving.run(time + MS)
    [off] = driving.edges(PIN_ENABLE, False)
    assert 0 <= off - time <= US


def test_a_supply_within_its_tolerance_is_none_of_the_alarms_business(driving):
    driving.emulator.supply(3.3 * 0.95, 1500 * MS)
    driving.run(2500 * MS)
    assert driving.level[PIN_ENABLE]
    assert DIPS_COUNTER not in counters(driving)


@pytest.mark.parametrize("revision", [0x1000, 0x1001, 0x1003, 0x1007])
def test_every_revision_starts_without_a_violation(revision):
    heard = bytearray()
    with Emulator(
        ROOT / "build/firmware/sensor.elf",
        Configuration(revision=revision),
        uart_out=lambda uart, byte, time: heard.append(byte),
    ) as board:
        assert board.run(20 * MS), board.report()
    assert heard
