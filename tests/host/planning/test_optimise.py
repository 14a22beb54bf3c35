"""Optimisation: better than a lattice of the same power, never worse, no constraint broken, exact gradients."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from goldfield import load_site
from goldfield.errors import UserError
from goldfield.planning import Grid, Request
from goldfield.planning.objective import Objective, moved
from goldfield.planning.optimise import figure_of, optimise
from goldfield.planning.optimise_file import Region, Wishes, load
from goldfield.planning.site_text import site_text
from goldfield.site import load as load_file
from tests.host.planning.built import SENSOR, beacon, ceiling, cube, site_of

CEILING = Region(np.array([0.0, 0.0, 2.7]), np.array([5.0, 5.0, 2.7]))
GRID = Grid.of_box(np.array([0.0, 0.0, 0.6]), np.array([5.0, 5.0, 1.6]), 1.0)


def lattice():
    """Return a regular lattice as one would hang it: each beacon in the middle of its part of the ceiling."""
    site = ceiling(3, 3, spacing=5.0 / 3.0, height=2.7)
    middle = np.array([5.0 / 6.0, 5.0 / 6.0, 0.0])
    return replace(site, beacons=tuple(replace(one, position_m=one.position_m + middle) for one in site.beacons))


def wishes(free=("position",), **changes):
    return replace(Wishes(free, "worst", None, 1.0, np.inf, (CEILING,)), **changes)


def power(site):
    return sum(one.current_A**2 for one in site.beacons)


@pytest.mark.parametrize(("parameter", "index"), [(0, 1), (2, 4), (3, 0), (5, 7), (6, 3)])
def test_gradients_are_the_slopes_of_the_objective(parameter, index):
    site = lattice()
    site = replace(site, beacons=tuple(moved(one, 3, 0.1 * i) for i, one in enumerate(site.beacons)))
    objective = Objective(site, GRID.points(GRID.tiles()[0]))
    _, gradient = objective.with_gradient(site.beacons)
    sides = []
    for step in (1e-3, -1e-3):
        beacons = list(site.beacons)
        beacons[index] = moved(beacons[index], parameter, step)
        sides.append(objective.with_gradient(beacons)[0])
    assert gradient[index, parameter] == pytest.approx((sides[0] - sides[1]) / 2e-3, rel=1e-3, abs=1e-9)


@pytest.mark.parametrize(
    ("start", "free", "gain"),
    [
        (lattice(), ("position",), 0.3),
        (lattice(), ("position", "axis", "current"), 0.3),
        (ceiling(3, 3, spacing=2.5, height=2.7), ("position", "axis", "current"), 0.08),
    ],
    ids=["places", "all", "all, from the lattice with the least worst bound"],
)
def test_the_worst_bound_is_clearly_better_than_a_lattices_of_the_same_power(start, free, gain):
    outcome = optimise(Request(start, GRID), wishes(free))
    assert outcome.figure_after_m < (1.0 - gain) * outcome.figure_before_m
    assert figure_of(outcome.after, wishes()) == outcome.figure_after_m
    assert power(outcome.site) <= power(start) * (1.0 + 1e-12)
    assert all(CEILING.contains(one.position_m) for one in outcome.site.beacons)
    assert all(np.linalg.norm(one.axis) == pytest.approx(1.0) for one in outcome.site.beacons)
    if "current" not in free:
        assert [one.current_A for one in outcome.site.beacons] == [one.current_A for one in start.beacons]


def test_it_is_never_worse_where_nothing_can_be_gained():
    start = lattice()
    stuck = tuple(Region(one.position_m, one.position_m) for one in start.beacons)
    outcome = optimise(Request(start, GRID), wishes(regions=stuck))
    assert outcome.figure_after_m == outcome.figure_before_m
    assert outcome.site is start


def test_it_ends_at_its_target():
    start = lattice()
    figure = figure_of(optimise(Request(start, GRID), wishes(target_m=1.0)).before, wishes())
    assert optimise(Request(start, GRID), wishes(target_m=1.001 * figure)).site is start
    assert optimise(Request(start, GRID), wishes(target_m=0.999 * figure)).figure_after_m <= 0.999 * figure


def test_currents_keep_their_limits():
    start = lattice()
    outcome = optimise(Request(start, GRID), wishes(("current",), power=0.8, most_current_A=11.0))
    assert power(outcome.site) <= 0.8 * power(start) * (1.0 + 1e-12)
    assert max(one.current_A for one in outcome.site.beacons) <= 11.0


@pytest.mark.parametrize(
    ("site", "changes", "words"),
    [
        (cube(), {}, r'beacon "b0" is in no \[\[region\]\]'),
        (lattice(), {"most_current_A": 9.0}, "more current than most_current_A"),
        (lattice(), {"power": 0.5}, "no current may change"),
    ],
)
def test_a_start_that_breaks_a_constraint_is_refused(site, changes, words):
    with pytest.raises(UserError, match=words):
        optimise(Request(site, GRID), wishes(**changes))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('[optimise]\nfree = ["places"]\n[[region]]\nlow_m=[0,0,0]\nhigh_m=[1,1,1]',
         r'2: \[optimise\]: free has "places"'),
        ('[optimise]\nfigure = "best"\n[[region]]\nlow_m=[0,0,0]\nhigh_m=[1,1,1]', r'figure is "best": it must be p95'),
        ("[optimise]\n[[region]]\nlow_m=[0,0,1]\nhigh_m=[1,1,0]", r":4: \[\[region\]\] 1: high_m is below low_m"),
        ("[optimise]\n", "region is missing"),
        ("[optimise]\ntarget_m = 0\n", r"target_m is 0; it must be greater"),
        ("[optimise]\npower = 1e-300\n[[region]]\nlow_m=[0,0,0]\nhigh_m=[1,1,1]", r"power is 1e-300: .* 1e-4 to 1e4"),
        ("[optimise]\npower = 1e5\n[[region]]\nlow_m=[0,0,0]\nhigh_m=[1,1,1]", r"power is 100000: give the sum"),
    ],
)  # fmt: skip
def test_files_that_make_no_sense_are_refused(tmp_path, text, words):
    path = tmp_path / "wishes.toml"
    path.write_text(text)
    with pytest.raises(UserError, match=words):
        load(path)


def test_a_written_site_is_the_same_when_it_is_read(tmp_path):
    site = replace(ceiling(2, 3), name='a "hall"', alert_limit_m=0.2, ambient_gradient_T_m=2e-5)
    path = tmp_path / "site.toml"
    path.write_text(site_text(site))
    read = load_file(path)
    assert read is not site
    assert (read.name, read.alert_limit_m, vars(read.sensor), read.assumed) == (site.name, 0.2, vars(site.sensor), ())
    assert read.ambient_gradient_T_m == 2e-5
    assert read.half_space.normal.tolist() == site.half_space.normal.tolist()
    for one, other in zip(read.beacons, site.beacons, strict=True):
        assert (one.id, one.code, one.turns, one.radius_m) == (other.id, other.code, other.turns, other.radius_m)
        assert (one.current_A, one.survey) == (other.current_A, other.survey)
        assert one.position_m.tolist() == other.position_m.tolist()
        assert one.axis.tolist() == other.axis.tolist()


def test_beacons_without_codes_of_their_own_get_some_while_they_last(tmp_path):
    alike = [replace(beacon(i, (i, 0.0, 0.0)), code=0) for i in range(34)]
    path = tmp_path / "site.toml"
    path.write_text(site_text(replace(site_of(alike[:33], SENSOR), degree=5)))
    assert sorted(load_site(path).codes) == list(range(33))
    with pytest.raises(UserError, match="34 beacons are more than codes of degree 5"):
        site_text(replace(site_of(alike, SENSOR), degree=5))
