"""The current loop's looks before the end of a chip: behind its edge, and amid it."""

import math

import pytest

from tests.firmware.core.drive.current_loop import (
    EXCESS,
    FAULT,
    HOLDING,
    OPEN,
    OVER,
    RAMPING,
    SENSE,
    Drive,
    configure,
    running,
)


@pytest.mark.parametrize("driven", [True, False])
def test_over_current_is_seen_behind_an_edge_too(core, driven):
    """At any time, at the limit of 12 A, 1536 counts; and the drive then stays off."""
    _, lib = core
    set_point = 2560 if driven else 0
    for count, cause in ((2048 + 1537, OVER), (2048 - 1537, OVER), (0, OVER), (2048 + 1536, 0), (2048 - 1536, 0)):
        loop, _ = configure(core, 10.0, over=12.0)
        lib.current_start(loop)
        assert lib.current_sample(loop, True, 2560, 2048 + 1280) == 0
        assert lib.current_edge(loop, set_point, count) == cause, count
        assert loop.state == (FAULT if cause else RAMPING)
        assert lib.current_edge(loop, set_point, count) == cause, "it is told at each look"
    loop, _ = configure(core, 10.0, over=12.0)
    assert (lib.current_edge(loop, 0, 4094), loop.state) == (OVER, FAULT)


def test_a_fault_tells_its_cause_at_each_look_until_it_is_configured_anew(core):
    """Whoever missed it once, as by a skipped instruction, hears it again; the first cause stays."""
    _, lib = core
    loop = running(core)
    assert lib.current_sample(loop, True, 2560, 2048 + 1280) == 0
    assert lib.current_middle(loop, -2560, 2048 + 1280, 2048 + 1537) == OVER
    for _ in range(3):
        assert lib.current_sample(loop, True, 2560, 2048 + 1280) == OVER
        assert lib.current_sample(loop, False, 0, 2048) == OVER
        assert lib.current_edge(loop, 0, 2048) == OVER
        assert lib.current_middle(loop, 2560, 2048, 2048 - 1537) == OVER
        lib.current_stop(loop)
        lib.current_start(loop)
    assert lib.current_configure(loop, core[0].addressof(loop, "config"))
    assert lib.current_edge(loop, 0, 2048) == 0
    assert lib.current_sample(loop, False, 0, 2048) == 0


def test_a_fault_state_that_nobody_has_set_is_a_fault(core):
    """One bit makes it from 2, holding."""
    _, lib = core
    loop = running(core)
    loop.state = FAULT
    assert lib.current_edge(loop, 0, 2048) == EXCESS
    assert lib.current_middle(loop, 2560, 2048 + 1280, 2048 + 1280) == EXCESS
    assert lib.current_sample(loop, True, 2560, 2048 + 1280) == EXCESS


def test_the_first_chip_after_a_reset_may_carry_what_nobody_asked_for(core):
    """The coil was driven when the board was reset, and its current still falls; beyond the limit it is a fault."""
    _, lib = core
    count = 2048 + 1280
    loop, _ = configure(core, 10.0)
    assert lib.current_edge(loop, 0, count) == 0
    assert lib.current_sample(loop, False, 0, count) == 0
    assert lib.current_edge(loop, 0, count) == 0
    assert lib.current_sample(loop, False, 0, count) == EXCESS
    loop, _ = configure(core, 10.0)
    assert lib.current_edge(loop, 0, 4094) == OVER
    loop, _ = configure(core, 10.0)
    assert lib.current_sample(loop, False, 0, count) == 0
    assert lib.current_configure(loop, core[0].addressof(loop, "config"))  # A change of a parameter is no reset.
    assert lib.current_sample(loop, False, 0, count) == EXCESS


def test_behind_an_edge_excess_is_compared_with_the_two_chips_before(core):
    """One may have been stopped just before it was measured: its current then falls behind the edge."""
    _, lib = core
    loop = running(core)
    assert lib.current_sample(loop, True, 2560, 2048 + 1280) == 0
    assert lib.current_edge(loop, -2560, 2048 + 1000) == 0
    assert lib.current_sample(loop, False, 0, 2048 + 1280) == 0
    assert lib.current_edge(loop, 0, 2048 + 800) == 0
    assert lib.current_sample(loop, False, 0, 2048) == 0
    assert lib.current_edge(loop, 0, 2048 - 64) == 0
    assert lib.current_edge(loop, 0, 2048 - 65) == EXCESS


def test_behind_an_edge_nothing_is_learned(core):
    """Neither the mean square, nor the zero, nor the gain."""
    loop, _ = configure(core, 10.0, rms=8.0, chips=2000.0)
    drive = Drive(core, loop, noise=0.0)
    drive.run(1500)
    before = bytes(core[0].buffer(loop))
    for asked, count in ((2560, 2048 - 1280), (0, 2048 + 900), (-100, 2048)):
        assert core[1].current_edge(loop, asked, count) == 0
    assert bytes(core[0].buffer(loop)) == before


# ---- Amid a chip ----


def held(core, open_fraction=0.5):
    """A drive that holds 10 A, with what it asks for and what comes of it, counts."""
    loop, _ = configure(core, 10.0, open_fraction=open_fraction)
    Drive(core, loop, noise=0.0).run(2047)
    assert loop.state == HOLDING
    return loop, 2560, 1280


@pytest.mark.parametrize("sign", [1, -1])
def test_amid_a_chip_the_current_is_there_if_it_was_there_before(core, sign):
    """Half of 10 A, 640 counts: what began there, or beyond, may not be below it."""
    _, lib = core
    for start in (1280, 1000, 640):
        for came, cause in ((1280, 0), (640, 0), (639, OPEN), (0, OPEN), (-1280, OPEN)):
            loop, asked, _ = held(core)
            assert lib.current_middle(loop, sign * asked, 2048 + sign * start, 2048 + sign * came) == cause, came
            assert loop.state == (FAULT if cause else HOLDING)
            assert cause == 0 or lib.current_middle(loop, sign * asked, 2048, 2048) == OPEN, "it is told at each look"


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("start", [-1280, -600, 0, 320])
def test_amid_a_chip_a_current_on_its_way_has_done_three_eighths(core, sign, start):
    _, lib = core
    least = start + math.ceil((640 - start) * 3 / 8)
    for came, cause in ((640, 0), (least + 1, 0), (least - 1, OPEN), (start, OPEN)):
        loop, asked, _ = held(core)
        assert lib.current_middle(loop, sign * asked, 2048 + sign * start, 2048 + sign * came) == cause, came


@pytest.mark.parametrize("slow", [0.1, 0.5, 1.0, 3.0])
@pytest.mark.parametrize("share", [0.41, 0.45, 0.5])
def test_a_slow_coil_that_is_there_at_the_end_is_not_open_amid_the_chip(core, slow, share):
    """A coil of any time constant that just reaches half of what is asked, 5 A, when the chip ends, from -10 A."""
    _, lib = core
    for start_A in (-10.0, -5.0, 0.0, 4.0):
        done = (1.0 - math.exp(-share / slow)) / (1.0 - math.exp(-1.0 / slow))  # Share of the way to the chip's end.
        came_A = start_A + done * (5.0 - start_A)
        loop, asked, _ = held(core)
        counts = [2048 + round(ampere / SENSE) for ampere in (start_A, came_A, 5.0)]
        assert lib.current_middle(loop, asked, counts[0], counts[1]) == 0
        assert lib.current_sample(loop, True, asked, counts[2]) == 0
    loop, asked, _ = held(core)
    assert lib.current_sample(loop, True, asked, counts[2] - 8) == OPEN, "it was just enough"


def test_amid_a_chip_nobody_looks_for_an_open_coil_where_the_end_does_not(core):
    """A chip that asks for little, one that is not driven, the protection switched off, and a drive that is off."""
    ffi, lib = core
    loop, asked, _ = held(core)
    quarter = asked // 4
    assert lib.current_middle(loop, quarter, 2048, 2048) == lib.current_middle(loop, -quarter, 2048, 2048) == 0
    assert lib.current_middle(loop, 0, 2048, 2048) == 0
    assert lib.current_middle(loop, quarter + 1, 2048, 2048) == OPEN
    loop, asked, _ = held(core, open_fraction=0.0)
    assert lib.current_middle(loop, asked, 2048, 2048) == 0
    loop, asked, _ = held(core)
    assert lib.current_configure(loop, ffi.addressof(loop, "config"))
    assert lib.current_middle(loop, asked, 2048, 2048) == 0


@pytest.mark.parametrize("driven", [True, False])
def test_over_current_and_excess_are_seen_amid_a_chip(core, driven):
    _, lib = core
    for came, cause in ((1537, OVER), (-1537, OVER), (-2048, OVER), (1536, 0)):
        loop, asked, _ = held(core)
        assert lib.current_middle(loop, asked if driven else 0, 2048 + 1280, 2048 + came) == cause
    loop, _ = configure(core, 2.0)
    Drive(core, loop, noise=0.0).run(2047)
    most = math.floor(1.375 * 256 + 64)
    assert lib.current_middle(loop, 512, 2048 + 256, 2048 + most) == 0
    assert lib.current_middle(loop, 512, 2048 + 256, 2048 + most + 1) == EXCESS


def test_amid_a_chip_nothing_is_learned(core):
    loop, asked, _ = held(core)
    before = bytes(core[0].buffer(loop))
    for set_point, start, came in ((asked, -1280, 1200), (-asked, 0, -900), (0, 1280, 3), (asked, 1280, 700)):
        assert core[1].current_middle(loop, set_point, 2048 + start, 2048 + came) == 0
    assert bytes(core[0].buffer(loop)) == before
