"""Sites that share codes, or have more beacons than a list of codes holds, written to host boards and verified."""

import json
import os

import numpy as np
import pytest

from goldfield import site as sites
from goldfield.cli import main
from goldfield.sensor import dialogue as dialogues
from goldfield.sensor import session as sessions
from goldfield.sensor.options import Options
from goldfield.sensor.pipeline import Sensor
from goldfield.types import Status
from tests.hil.from_the_box import benches, hall
from tests.hil.rig_link import RigLink

SENSOR_M = [0.9, 1.2, 0.8]


@pytest.fixture
def bench(monkeypatch, tmp_path):
    with benches(monkeypatch, tmp_path) as make:
        yield lambda beacons: make(hall(beacons, sited=beacons))


def commissioned(made, site):
    """Give the boards their numbers, and write the site; returns the numbers of the beacons, and the sensor's."""
    made.lines("nodes", "assign", "--renew")
    listed = made.lines("nodes", "boards")
    made.write_site(site, listed)
    return made.numbers(listed), next(line["node"] for line in listed if line["role"] == "sensor")


def value(made, node, parameter):
    (line,) = made.lines("nodes", "get", str(node), parameter)
    return line["values"][0]


@pytest.mark.long
def test_planned_and_shared_codes_are_written_and_verified(bench, tmp_path, capsys):
    """The last three of twelve beacons share the codes of the first three."""
    made, site, coded = bench(12), tmp_path / "room.toml", tmp_path / "coded.toml"
    numbers, sensor = commissioned(made, site)
    box = ["--box", "0", "0", "0.5", "4", "3", "1.2", "--step", "0.5"]
    assert main(["site", "codes", str(site), *box, "--out", str(coded), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["codes"] == 12
    beacons = sites.load(coded).beacons
    text = coded.read_text().replace("[site]", "[site]\nshared_codes = true", 1)
    for far, near in zip(beacons[9:], beacons[:3], strict=True):
        text = text.replace(f"code = {far.code}\n", f"code = {near.code}\n")
    coded.write_text(text)
    shared = {beacon.id: beacon.code for beacon in sites.load(coded).beacons}
    assert len(set(shared.values())) == 9
    assert made.run("site", "check", str(coded))[0] == 3
    with os.fdopen(os.open("/dev/full", os.O_WRONLY), "w", buffering=1) as full:
        code, _, told = made.run("site", "push", str(coded), "--strongest", "6", into=full)
    assert (code, "the output cannot be written: No space left on device" in told) == (3, True)
    assert (
        made.lines("site", "check", str(coded), "--strongest", "6") == []
    )  # all the same the boards are set, and saved
    (pushed,) = made.lines("site", "push", str(coded), "--strongest", "6")
    assert pushed["nodes"] == sorted([*numbers.values(), sensor])
    assert {name: value(made, node, "code") for name, node in numbers.items()} == shared
    assert value(made, sensor, "strongest") == 6
    assert made.lines("site", "check", str(coded), "--strongest", "6") == []
    code, out, told = made.run("site", "check", str(coded), "--json")
    (line,) = [json.loads(one) for one in out.splitlines()]
    assert (code, line["parameter"], line["board"], line["site"]) == (3, "strongest", 6, 16)
    assert "1 value" in told
    code, _, told = made.run("site", "push", str(coded), "--strongest", "65")
    assert (code, "chooses 1 to 64 codes of degree 10" in told) == (2, True)


@pytest.mark.slow
def test_more_beacons_than_a_list_holds(bench, tmp_path, monkeypatch):
    """All are set, verified and started, and a sensor that chooses is located among them."""
    made, site = bench(66), tmp_path / "room.toml"
    numbers, sensor = commissioned(made, site)
    master = str(numbers["b1"])  # the wire is that of this board
    for words in (("set", master, "sync_master", "1"), ("save", master), ("reset", master)):
        made.lines("nodes", *words)
    (pushed,) = made.lines("site", "push", str(site), "--start")
    assert pushed["nodes"] == sorted([*numbers.values(), sensor])
    assert made.lines("site", "check", str(site)) == []
    assert {name: value(made, numbers[name], "code") for name in ("b1", "b65", "b66")} == {
        "b1": 2,
        "b65": 66,
        "b66": 67,
    }
    assert value(made, sensor, "strongest") == 16
    made.rig.advance(5.0)
    link = RigLink(made.rig)
    monkeypatch.setattr(sessions, "time", link)
    monkeypatch.setattr(dialogues, "time", link)
    epochs = Sensor(link, "hall", sites.load(site), Options(strongest=16)).epochs()
    poses = [next(epochs).pose for _ in range(5)]
    assert [pose.status for pose in poses[1:]] == 4 * [Status.OK]
    assert max(np.linalg.norm(pose.position_m - SENSOR_M) for pose in poses[1:]) < 0.01
    made.lines("nodes", "set", str(numbers["b66"]), "code", "500")
    code, out, _ = made.run("site", "check", str(site))
    assert (code, out) == (3, f"b66, node {numbers['b66']}: code is 500, the site says 67\n")
