"""What configurations of a current are taken, and what a start and a stop begin with and leave."""

import math

import pytest

from tests.firmware.core.drive.current_loop import (
    OFF,
    OPEN,
    OVER,
    RAMPING,
    REFERENCE,
    SENSE,
    Drive,
    configure,
    running,
)


def test_a_limit_beyond_the_converter_trips_at_its_rails(core):
    _, lib = core
    for count, goes_on in ((1, False), (2, True), (4094, True), (4095, False)):
        loop, _ = configure(core, 1.0, over=100.0)
        lib.current_start(loop)
        assert (lib.current_sample(loop, True, 4095, count) != OVER) == goes_on, count


def test_a_start_forgets_the_line_of_the_drive_before(core):
    """The driver may be another one; what is known of the zero stays."""
    ffi, lib = core
    loop = running(core, sizes=True)
    zero = loop.zero
    lib.current_stop(loop)
    lib.current_start(loop)
    fresh, _ = configure(core, 10.0, sizes=True)
    lib.current_start(fresh)
    assert bytes(ffi.buffer(loop.line)) == bytes(ffi.buffer(fresh.line))
    assert (loop.reference, loop.measured_A, loop.dc_A, loop.target_A, loop.chips) == (0, 0.0, 0.0, 0.0, 0)
    assert loop.zero == zero


def test_a_start_begins_with_nothing_and_a_stop_leaves_nothing_asked(core):
    """Whatever the drive before has left."""
    _, lib = core
    loop = running(core)
    loop.headroom_lost = True
    lib.current_stop(loop)
    assert (loop.state, loop.reference, loop.headroom_lost) == (OFF, 0, False)
    assert [line.scale for line in loop.line] == [0, 0]
    assert lib.current_set_point(loop, 16384) == lib.current_set_point(loop, -16384) == 0
    loop.reference, loop.chips, loop.short_blocks = 7, 8, 9
    loop.measured_A, loop.dc_A, loop.target_A = 1.0, 2.0, 3.0
    loop.headroom_lost = loop.strayed = True
    lib.current_start(loop)
    assert (loop.state, loop.reference, loop.chips, loop.short_blocks) == (RAMPING, 0, 0, 0)
    assert (loop.measured_A, loop.dc_A, loop.target_A) == (0.0, 0.0, 0.0)
    assert (loop.headroom_lost, loop.strayed) == (False, False)


def test_off_and_stop(core):
    _, lib = core
    loop, _ = configure(core, 10.0)
    Drive(core, loop).run(500)
    lib.current_stop(loop)
    assert (loop.state, loop.reference, lib.current_set_point(loop, 16384)) == (OFF, 0, 0)
    assert lib.current_sample(loop, False, 0, 2048) == 0
    lib.current_start(loop)
    assert (loop.state, loop.reference, loop.target_A) == (RAMPING, 0, 0.0)


@pytest.mark.parametrize(
    "values",
    [
        {"amplitude": -1.0},
        {"amplitude": 16.0},
        {"amplitude": math.nan},
        {"amplitude": math.inf},
        {"amplitude": 1.0, "over": math.nan},
        {"amplitude": 1.0, "over": -1.0},
        {"amplitude": -1e-6},
        {"amplitude": 2047.01 * SENSE, "over": 100.0},
        {"amplitude": 1.0, "open_fraction": 1.0001},
        {"amplitude": 1.0, "open_fraction": -0.01},
        {"amplitude": 1.0, "open_fraction": math.nan},
        {"amplitude": 1.0, "sense": 0.0},
        {"amplitude": 1.0, "reference": 0.0},
        {"amplitude": 1.0, "sense": -SENSE},
        {"amplitude": 1.0, "reference": -REFERENCE},
        {"amplitude": 1.0, "sense": -SENSE, "reference": -REFERENCE},
        {"amplitude": 1.0, "reference": 1e-9},
        {"amplitude": 1.0, "reference": 0.99 * SENSE / 1024.0},
        {"amplitude": 1.0, "reference": 8.01 * SENSE},
        {"amplitude": 1.0, "reference": 0.1},
        {"amplitude": 1.0, "rms": -1.0},
        {"amplitude": 1.0, "rms": math.nan},
        {"amplitude": 1.0, "chips": 0.5},
    ],
)
def test_impossible_configurations_are_refused(core, values):
    assert not configure(core, **values)[1]


@pytest.mark.parametrize(
    "values",
    [
        {"amplitude": 0.0},
        {"amplitude": 2047.0 * SENSE, "over": 100.0},
        {"amplitude": 1.0, "open_fraction": 0.0},
        {"amplitude": 1.0, "open_fraction": 1.0},
        {"amplitude": 1.0, "reference": SENSE / 1024.0},
        {"amplitude": 1.0, "reference": 8.0 * SENSE},
    ],
)
def test_configurations_at_the_limits_are_taken(core, values):
    assert configure(core, **values)[1]


@pytest.mark.parametrize(("counts", "open_from"), [(3800.5, 3801), (4095.5, None), (65546.5, None)])
def test_a_reference_too_fine_for_the_least_of_an_open_coil_has_none(core, counts, open_from):
    """A quarter of the amplitude is more than a set-point has, or than sixteen bits hold; current flows backwards."""
    _, lib = core
    for asked in (1, 100, 3800, 3801, 4095):
        loop, done = configure(core, 4.0 * counts * SENSE / 200.0, over=100.0, reference=SENSE / 200.0)
        assert done
        lib.current_start(loop)
        is_open = open_from is not None and asked >= open_from
        assert lib.current_sample(loop, True, asked, 2048 - 5) == (OPEN if is_open else 0), asked


@pytest.mark.parametrize(
    "other",
    [{"sense": 2 * SENSE}, {"reference": REFERENCE / 2}, {"amplitude": 2.0}, {"open_fraction": 0.25}, {"sizes": True}],
)
def test_currents_are_alike_that_are_configured_alike(core, other):
    """However far one of them has come."""
    values = {"amplitude": 1.0}
    one, two, unlike = (configure(core, **(values | changed))[0] for changed in ({}, {}, other))
    Drive(core, one).run(100)
    alike = core[1].current_alike
    assert alike(one, two)
    assert alike(two, one)
    assert not alike(one, unlike)
    assert not alike(unlike, one)


def test_a_start_leaves_the_current_behind_it_alone(core):
    ffi, lib = core
    loops = ffi.new("current_t[2]")
    loops[0] = configure(core, 1.0)[0][0]
    behind = ffi.buffer(loops + 1)
    behind[:] = b"\x5a" * len(behind)
    lib.current_start(loops)
    assert loops[0].state == RAMPING
    assert bytes(behind) == b"\x5a" * len(behind)
