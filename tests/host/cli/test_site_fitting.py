"""How many codes the sensors of a link are set to choose, where it does not carry all that are wanted."""

from __future__ import annotations

import argparse
from dataclasses import replace

import pytest

from goldfield.cli.site_actions import _fitting
from goldfield.link.budget import SHARE, Carrier, Link, load
from goldfield.nodes.commissioning import Board
from tests.host.planning.built import ceiling

SITE = ceiling(9, 9, spacing=4.5, height=2.7)
SMALL = ceiling(3, 3)


def boards(sensors):
    beacons = [Board(f"b{i}", i + 1, "beacon") for i in range(81)]
    return [*beacons, *(Board(f"s{i}", 100 + i, ("sensor", "anchor")[i % 2]) for i in range(sensors))]


def fitting(site, sensors, strongest=None, **link):
    return _fitting(
        argparse.Namespace(strongest=strongest, **{"can": None, "port": None, **link}), site, boards(sensors)
    )


def part(sensors, codes):
    """The part of CAN that so many sensors take."""
    return max(sensors, 1) * load(Link.CAN, Carrier.CYCLES, codes, SITE.chips, SITE.chip_period_s)


@pytest.mark.parametrize("given", [None, 16, 64])
def test_sensors_of_one_can_divide_it(capsys, given):
    reduced, wanted = [], given or 16
    for sensors in range(40):
        found = fitting(SITE, sensors, given, can="socketcan:can0")
        told = capsys.readouterr().err
        assert part(sensors, found) <= SHARE[Link.CAN]
        assert found == wanted or part(sensors, found + 1) > SHARE[Link.CAN]
        assert (f"sensors report {found} of the strongest codes, not {wanted}: " in told) == (found < wanted)
        reduced.append(found < wanted)
    assert reduced == sorted(reduced)
    assert 0 < sum(reduced) < 39


def test_a_serial_line_has_one_sensor(capsys):
    assert fitting(SITE, 39, 64, port="/dev/ttyUSB0") == 64
    assert capsys.readouterr().err == ""


def test_a_small_site_has_its_list(capsys):
    assert fitting(SMALL, 39, can="socketcan:can0") is None
    assert fitting(SMALL, 1, 3, can="socketcan:can0") == 3
    twice = replace(SMALL, shared_codes=True, beacons=tuple(replace(one, code=2) for one in SMALL.beacons))
    assert fitting(twice, 1, can="socketcan:can0") == 16
    assert capsys.readouterr().err == ""
