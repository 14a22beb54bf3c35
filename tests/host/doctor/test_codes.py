"""What the doctor says of codes, where beacons share them and where they do not."""

from __future__ import annotations

import dataclasses

import can
import pytest

from goldfield import site as sites
from goldfield.doctor import boards
from goldfield.nodes.roster import Roster
from tests.host.fake_sensor import SITE, heartbeat

ROOM = sites.load(SITE)
SHARED = dataclasses.replace(
    ROOM,
    shared_codes=True,
    beacons=(*ROOM.beacons[:-1], dataclasses.replace(ROOM.beacons[-1], code=ROOM.beacons[1].code)),
)
"""The room, whose last beacon has the code of its second."""
FIRST, LAST = ROOM.beacons[1].id, ROOM.beacons[-1].id


def told(site, driven):
    """Return what is said of boards that drive these codes, node n the n-th."""
    roster = Roster()
    for node, code in enumerate(driven, start=1):
        identifier, data = heartbeat(node=node, role=0)
        roster.take(can.Message(arbitration_id=identifier, is_extended_id=True, data=data), 0.0)
        roster.nodes[node].parameters.update({boards.CODE: code, boards.WAVEFORM: boards.ONE_CODE})
    return [check for check in boards.codes(roster, site)]


@pytest.mark.parametrize("site", [ROOM, SHARED], ids=["own", "shared"])
def test_each_board_with_its_code_is_sound(site):
    (check,) = told(site, [beacon.code for beacon in site.beacons])
    assert check.text == (
        "each of 8 codes of the site is driven by one board"
        if site is ROOM
        else "each of 7 codes of the site is driven by as many boards as have it"
    )


def test_a_board_more_than_beacons_of_a_shared_code_is_told():
    code = ROOM.beacons[1].code
    (check,) = told(SHARED, [*(beacon.code for beacon in SHARED.beacons), code])
    assert check.text.startswith(f"nodes 2, 8 and 9 drive the code {code} of {FIRST}")


def test_a_board_less_than_beacons_of_a_shared_code_is_told():
    code = ROOM.beacons[1].code
    (check,) = told(SHARED, [beacon.code for beacon in SHARED.beacons[:-1]])
    assert check.text == f"the code {code} of {FIRST} and {LAST} is driven by 1 board only"
    assert check.beacons == (FIRST, LAST)
