"""Host boards from the box, each on a serial port of its own and no bus between them, commissioned to poses."""

import json

import numpy as np
import pytest

from goldfield import site as sites
from goldfield.sensor import dialogue as dialogues
from goldfield.sensor import session as sessions
from goldfield.sensor.pipeline import Sensor
from goldfield.types import Status
from tests.hil.from_the_box import SHARED, benches, hall, place_of
from tests.hil.rig_link import RigSerialLink

SENSOR_M = [0.9, 1.2, 0.8]
SENSOR = 0


@pytest.fixture
def bench(monkeypatch, tmp_path):
    with benches(monkeypatch, tmp_path) as make:

        def without_a_bus(beacons, sited=None):
            made = make(hall(beacons), sited)
            made.rig.can_errors(0.5)
            return made

        yield without_a_bus


@pytest.mark.long
def test_boards_on_ports_of_their_own_from_the_box_to_poses(bench, tmp_path, monkeypatch):
    made, site = bench(8), tmp_path / "room.toml"
    ports = range(9)
    found = [made.lines("nodes", "boards", port=port) for port in ports]
    assert all(len(lines) == 1 for lines in found)  # Each port has its board, and no other.
    listed = [line for lines in found for line in lines]
    assert [place_of(bytes.fromhex(line["unique_id"])) for line in listed] == list(ports)
    assert {line["node"] for line in listed} == set(SHARED)  # Numbers collide, but not on one port.

    for port in ports:  # A board alone on its port keeps the number it has, unless it is told where to begin.
        assert made.lines("nodes", "assign", port=port)[0]["node"] == listed[port]["node"]
        (line,) = made.lines("nodes", "assign", "--renew", "--first", str(20 + port), port=port)
        assert line["node"] == 20 + port
    assert made.run("nodes", "number", "21", "31", port=1)[0] == 0
    assert made.run("nodes", "number", "31", "21", port=1)[0] == 0
    listed = [line for port in ports for line in made.lines("nodes", "boards", port=port)]
    assert [line["node"] for line in listed] == [20 + port for port in ports]
    assert made.run("nodes", "identify", "23", "--for", "1", port=3)[0] == 0
    assert made.run("nodes", "identify", "23", "--for", "1", port=4)[0] == 3  # It is on another port.
    assert made.run("nodes", "name", "22", "north wall", port=2)[0] == 0

    made.write_site(site, listed)
    code, out, told = made.run("nodes", "start", "--all", port=1)
    assert code == 3  # It was not commissioned.
    for port in ports:
        (pushed,) = made.lines("site", "push", str(site), port=port)
        assert pushed["nodes"] == [20 + port]
        code, out, told = made.run("site", "check", str(site), port=port)
        assert (code, out) == (0, "1 board is as the site says\n")
        assert f"{8 - (port > 0)} beacons have no board on this port" in told
    made.lines("nodes", "set", "23", "amplitude", "8", port=3)
    code, out, _ = made.run("site", "check", str(site), "--json", port=3)
    assert code == 3
    assert [json.loads(line)["parameter"] for line in out.splitlines()] == ["amplitude"]
    made.lines("site", "push", str(site), port=3)
    for words in (("set", "21", "sync_master", "1"), ("save", "21"), ("reset", "21")):
        made.lines("nodes", *words, port=1)
    made.rig.advance(2.0)
    assert made.energised() == set()

    for port in ports[1:]:
        assert made.lines("nodes", "start", "--all", "--save", port=port)[0]["started"] == [20 + port]
    made.rig.advance(5.0)
    assert made.energised() == set(ports[1:])
    (line,) = made.lines("nodes", "boards", port=2)
    assert (line["name"], line["armed"]) == ("north wall", True)

    link = RigSerialLink(made.rig, SENSOR)
    with monkeypatch.context() as of_session:
        of_session.setattr(sessions, "time", link)
        of_session.setattr(dialogues, "time", link)
        epochs = Sensor(link, "hall", sites.load(site)).epochs()
        poses = [next(epochs).pose for _ in range(10)]
    assert [pose.status for pose in poses] == 10 * [Status.OK]
    assert max(np.linalg.norm(pose.position_m - SENSOR_M) for pose in poses) < 0.01

    made.lines("nodes", "reset", "24", port=4)
    made.rig.advance(5.0)
    assert made.rig.coil_current_A(4) != pytest.approx(0.0, abs=1.0)  # What was saved holds over a reset.
    for port in ports[1:]:
        made.lines("nodes", "stop", "--all", port=port)
    made.rig.advance(0.01)
    assert all(made.rig.coil_current_A(port) == pytest.approx(0.0, abs=0.01) for port in ports[1:])


def test_a_board_that_is_not_of_the_site_is_not_set(bench, tmp_path):
    """A spare board on a port, and a site of the others; what a bus refuses as a whole stays refused there."""
    made, site = bench(3, 2), tmp_path / "room.toml"
    listed = [line for port in range(3) for line in made.lines("nodes", "boards", port=port)]
    made.write_site(site, listed)
    code, _, told = made.run("site", "push", str(site), port=3)
    assert (code, "nothing was set" in told) == (3, True)
    made.rig.can_errors(0.0)
    site.write_text(site.read_text().replace(listed[1]["unique_id"], "00" * 12))
    made.lines("nodes", "assign", "--renew")
    code, _, told = made.run("site", "push", str(site))
    assert (code, "nothing was set" in told) == (3, True)


def test_a_copy_goes_to_a_board_on_the_same_link(bench):
    made = bench(2)
    made.lines("nodes", "assign", "--renew", "--first", "20", port=1)
    made.lines("nodes", "assign", "--renew", "--first", "21", port=2)
    code, _, told = made.run("nodes", "clone", "20", "21", port=1)
    assert (code, "node 21" in told) == (3, True)
