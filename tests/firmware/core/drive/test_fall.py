"""The watch over the fall of a coil's current, fed by the simulator's coil, and at its own thresholds."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from hil_sim import clib

NONE, EXCESS = 0, 5
SENSE_A, SUPPLY_V = 0.0078125, 0.0390625
CHIP_PS, EARLY_PS, LATE_PS = 97_750_000, 4 * 10**6, 95 * 10**6
AMPLITUDE_A = 10.0
INDUCTANCE_H = 1.9e-4


def codes(chip: int) -> int:
    return 1 if chip * 7919 % 13 < 6 else -1


def slots(chip: int) -> int:
    """One slot of nine of a short cycle."""
    return int(chip % 90 < 10)


class Plant:
    """The simulator's coil and driver, sampled as a board does, its watch behind it.

    The board believes in `AMPLITUDE_A`: what the driver makes of it is its own affair.
    """

    def __init__(self, core, *, level=codes, seed=1, **changes):
        self.core, (self.ffi, self.lib) = core, clib.load("build/libgf_rig.so", ["world/coil.h"])
        values = dict(
            inductance_H=INDUCTANCE_H,
            resistance_Ohm=0.15,
            supply_V=120.0,
            reference_A_per_V=1.0,
            sense_V_per_A=0.103125,
            ambient_degC=20.0,
            shorted_fraction=0.1,
            shorted_coupling=0.9,
            gain=1.0,
        )
        values |= changes
        self.set_point_A = AMPLITUDE_A * values.pop("gain")
        self.config = values
        self.coil = self.ffi.new("coil_t *")
        self.lib.coil_init(self.coil, self.ffi.new("coil_config_t *", values))
        self.lib.coil_reference(self.coil, self.set_point_A, 0)
        self.lib.coil_enable(self.coil, True, 0)
        self.watch, self.chip = core[0].new("fall_t *"), 0
        self.ended = self.supplied = 0
        self.level, self.rng = level, np.random.default_rng(seed)

    def count(self, time_ps):
        """The sense's count, with a noise of .02 A, four times the scenarios'."""
        return round((self.lib.coil_current(self.coil, time_ps) + float(self.rng.normal(0.0, 0.02))) / SENSE_A)

    def run(self, chips):
        """Go on for some chips; return how many there were until the watch spoke, or None."""
        for number in range(1, chips + 1):
            start, level = (self.chip + 1) * CHIP_PS, self.level(self.chip)
            self.chip += 1
            self.lib.coil_input(self.coil, 1, level > 0, start)
            self.lib.coil_input(self.coil, 2, level < 0, start)
            seen = self.core[0].new("fall_edge_t *")
            seen.before, seen.wanted = self.ended, round(level * AMPLITUDE_A / SENSE_A)
            seen.came, seen.supply = self.count(start + EARLY_PS), self.supplied
            if self.core[1].fall_edge(self.watch, seen) == EXCESS:
                return number
            self.ended = self.count(start + LATE_PS)
            self.supplied = round(self.lib.coil_bus(self.coil, start + LATE_PS) / SUPPLY_V)
        return None

    def short(self):
        self.lib.coil_fault(self.coil, self.lib.COIL_SHORTED, True, (self.chip + 1) * CHIP_PS - 1000)

    def supply(self, volts):
        self.lib.coil_supply(self.coil, volts, (self.chip + 1) * CHIP_PS - 1000)


def falls(level, first):
    """How many chips from one on it takes until the current has fallen twice."""
    turns = (chip for chip in itertools.count(first) if level(chip - 1) != 0 and level(chip) != level(chip - 1))
    next(turns)
    return next(turns) - first + 1


CIRCUITS = {
    "cold": {"ambient_degC": 0.0},
    "hot": {"ambient_degC": 60.0},
    "driver's gain": {"gain": 1.05},
    "driver's gain, less": {"gain": 0.95},
    "more inductance": {"inductance_H": 1.2 * INDUCTANCE_H},
    "less inductance": {"inductance_H": 0.8 * INDUCTANCE_H},
    "less supply": {"supply_V": 96.0},
    "a weak supply": {"source_Ohm": 1.5},
    "dead time": {"dead_time_s": 3.3e-7},
    "a late driver": {"driver_delay_s": 5e-7, "asymmetry": 0.02, "dc_error_A": 0.1},
}
SHORTS = [(0.5, 0.9), (0.1, 0.9), (1 / 19, 0.8), (0.1, 0.7)]


@pytest.mark.parametrize("level", [codes, slots])
@pytest.mark.parametrize("name", CIRCUITS)
def test_shorted_turns_are_told_in_two_falls_and_nothing_before(core, name, level):
    """Half the turns, a tenth, and one of nineteen."""
    for share, coupling in SHORTS:
        plant = Plant(core, level=level, shorted_fraction=share, shorted_coupling=coupling, **CIRCUITS[name])
        assert plant.run(2000) is None
        assert plant.watch.learned == 16
        plant.short()
        expected = falls(level, plant.chip)
        assert plant.run(300) == expected


def test_nothing_trips_as_the_coil_warms_up_while_its_supply_sags_and_returns(core):
    """0 to over 60 degC, 20 % of supply gone and back at a chip's edge: learned at either supply."""
    for first, then in ((120.0, 96.0), (96.0, 120.0)):
        plant = Plant(
            core,
            supply_V=first,
            ambient_degC=0.0,
            thermal_resistance_K_per_W=5.0,
            heat_capacity_J_per_K=0.05,
        )
        for volts in (first, then) * 5:
            plant.supply(volts)
            assert plant.run(1000) is None
        assert plant.lib.coil_temperature(plant.coil, (plant.chip + 1) * CHIP_PS) > 60.0
        plant.short()
        assert plant.run(20) is not None


def edge(core, watch, before, wanted, came, supply=3000):
    return core[1].fall_edge(watch, core[0].new("fall_edge_t *", [before, wanted, came, supply]))


def learned(core, fall=400, supply=3000):
    """A watch that knows a coil."""
    watch = core[0].new("fall_t *")
    for sign in (1, -1) * 8:
        assert edge(core, watch, sign * 1280, -sign * 1280, sign * (1280 - fall), supply) == NONE
    assert watch.learned == 16
    return watch


@pytest.mark.parametrize(("fall", "cause"), [(639, NONE), (641, EXCESS)])
@pytest.mark.parametrize("share", [1.0, 0.8])
def test_one_and_six_tenths_of_the_learned_rate_is_too_fast(core, fall, cause, share):
    """640 of 400 counts at 3000 of supply; at less supply so much less."""
    watch = learned(core)
    fall = round(fall * share)
    found = [edge(core, watch, 1280, -1280, 1280 - fall, int(3000 * share))]
    found.append(edge(core, watch, -1280, 1280, fall - 1280, int(3000 * share)))
    assert found == [NONE, cause]


def test_one_fall_is_no_short_nor_are_two_with_a_slow_one_between(core):
    watch = learned(core)
    for _ in range(5):
        assert edge(core, watch, 1280, -1280, -1280) == NONE
        assert edge(core, watch, -1280, 1280, 400 - 1280) == NONE
    assert edge(core, watch, 1280, -1280, -1280) == NONE
    assert edge(core, watch, -1280, -1280, -1280) == NONE  # No fall: it says nothing,
    assert edge(core, watch, -1280, 1280, 1280) == EXCESS  # and does not end the row.


@pytest.mark.parametrize("wanted", [700, 1280])
def test_what_does_not_fall_or_is_not_known_is_no_fall(core, wanted):
    watch = learned(core)
    for _ in range(5):
        assert edge(core, watch, 1280, wanted, -1280) == NONE
        assert edge(core, watch, 1280, -1280, -1280, supply=0) == NONE
        assert edge(core, watch, 127, -1280, -1280) == NONE
    assert watch.fast == 0


@pytest.mark.parametrize(("size", "told"), [(398, False), (402, True)])
def test_a_way_that_a_short_could_not_be_told_by_is_left_aside(core, size, told):
    """A short needs 640 counts, and a quarter more to be told from what has arrived: 400 down and 400 beyond."""
    watch = learned(core)
    found = [edge(core, watch, size, -size, -size), edge(core, watch, -size, size, size)]
    assert found == [NONE, EXCESS if told else NONE]


def test_a_coil_that_arrives_at_once_is_not_learned(core):
    """Shorted from the start, or a small amplitude: it is not watched, and nothing trips."""
    plant = Plant(core, level=codes)
    plant.short()
    assert plant.run(500) is None
    assert plant.watch.learned == 0


@pytest.mark.parametrize(("fall", "count"), [(-1, 0), (0, 0), (1, 1), (1279, 1), (1280, 0), (1281, 0)])
def test_a_fall_that_is_learned_is_on_its_way(core, fall, count):
    """None at all and the wrong way are not learned, nor is half of a way of 2560 counts or more."""
    for sign in (1, -1):
        watch = core[0].new("fall_t *")
        assert edge(core, watch, sign * 1280, -sign * 1280, sign * (1280 - fall)) == NONE
        assert watch.learned == count


@pytest.mark.parametrize(("before", "count"), [(127, 0), (128, 1), (-127, 0), (-128, 1)])
def test_the_least_current_that_is_looked_at(core, before, count):
    watch = core[0].new("fall_t *")
    edge(core, watch, before, -before, before - (10 if before > 0 else -10))
    assert watch.learned == count


def test_a_current_that_is_to_end_falls(core):
    watch = core[0].new("fall_t *")
    edge(core, watch, 1280, 0, 1200)
    assert watch.learned == 1


def test_the_rate_is_the_mean_of_the_first_sixteen(core):
    watch = core[0].new("fall_t *")
    falls = [100 + 40 * i for i in range(17)]
    for fall in falls:
        edge(core, watch, 1280, -1280, 1280 - fall, 2000 + fall)
    expected = np.mean([fall / (2000 + fall) for fall in falls[:16]])
    assert (watch.learned, watch.rate) == (16, pytest.approx(expected, rel=1e-6))


def test_each_short_is_told_by_two_falls_of_its_own(core):
    watch = learned(core)
    assert [edge(core, watch, 1280, -1280, -1280) for _ in range(4)] == [NONE, EXCESS, NONE, EXCESS]
