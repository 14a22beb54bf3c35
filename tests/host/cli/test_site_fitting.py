"""How many codes the sensors of a link are set to choose, where it does not carry all that are wanted."""

from __future__ import annotations

from dataclasses import replace

import pytest

from goldfield.cli.site_actions import _fitting
from goldfield.errors import SystemFailure
from goldfield.link.budget import SHARE, Carrier, load
from goldfield.link.line import FASTEST, RATES, Line, Link
from goldfield.nodes.commissioning import Board
from tests.host.planning.built import ceiling

SITE = ceiling(9, 9, spacing=4.5, height=2.7)
SMALL = ceiling(3, 3)
CAN = FASTEST[Link.CAN]


def boards(sensors):
    beacons = [Board(f"b{i}", i + 1, "beacon") for i in range(81)]
    return [*beacons, *(Board(f"s{i}", 100 + i, ("sensor", "anchor")[i % 2]) for i in range(sensors))]


def fitting(site, sensors, strongest=None, line=CAN):
    return _fitting(line, strongest, site, boards(sensors))


def part(sensors, codes, line):
    """The part of CAN that so many sensors take."""
    return max(sensors, 1) * load(line, Carrier.CYCLES, codes, SITE.chips, SITE.chip_period_s)


@pytest.mark.parametrize("rate", RATES[Link.CAN])
@pytest.mark.parametrize("given", [None, 16, 64])
def test_sensors_of_one_can_divide_it(capsys, given, rate):
    reduced, wanted, line = [], given or 16, Line(Link.CAN, rate)
    for sensors in range(40):
        if part(sensors, 1, line) > SHARE[Link.CAN]:
            with pytest.raises(SystemFailure, match="nothing was set"):
                fitting(SITE, sensors, given, line)
            continue
        found = fitting(SITE, sensors, given, line)
        told = capsys.readouterr().err
        assert part(sensors, found, line) <= SHARE[Link.CAN]
        assert found == wanted or part(sensors, found + 1, line) > SHARE[Link.CAN]
        assert (f"sensors report {found} of the strongest codes, not {wanted}: " in told) == (found < wanted)
        assert (f"75 % of {line}\n" in told) == (found < wanted)
        reduced.append(found < wanted)
    assert reduced == sorted(reduced)
    assert 0 < sum(reduced) < 39


def test_a_serial_line_has_one_sensor(capsys):
    assert fitting(SITE, 39, 64, FASTEST[Link.SERIAL]) == 64
    assert fitting(SITE, 39, 61, Line(Link.SERIAL, 115_200)) == 61
    assert capsys.readouterr().err == ""
    assert fitting(SITE, 39, 62, Line(Link.SERIAL, 115_200)) == 61
    assert "of serial at 115,200 baud" in capsys.readouterr().err


def test_a_small_site_has_its_list(capsys):
    assert fitting(SMALL, 39) is None
    assert fitting(SMALL, 1, 3) == 3
    twice = replace(SMALL, shared_codes=True, beacons=tuple(replace(one, code=2) for one in SMALL.beacons))
    assert fitting(twice, 1) == 16
    assert capsys.readouterr().err == ""
