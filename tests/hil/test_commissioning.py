"""Host boards from the box, with numbers that collide, to poses by the commands of docs/boards.md, in virtual time."""

import json

import jsonschema
import numpy as np
import pytest

from goldfield import site as sites
from goldfield.cli import main
from goldfield.nodes import opening
from goldfield.sensor import dialogue as dialogues
from goldfield.sensor import session as sessions
from goldfield.sensor.pipeline import Sensor
from goldfield.types import Status
from hil_sim.clib import ROOT
from tests.hil.from_the_box import SHARED, benches, documented_commands, hall
from tests.hil.rig_link import RigLink

SENSOR_M = [0.9, 1.2, 0.8]


@pytest.fixture
def bench(monkeypatch, tmp_path):
    with benches(monkeypatch, tmp_path) as make:
        yield lambda beacons, sited=None: make(hall(beacons), sited)


def valid(lines, name):
    schema = json.loads((ROOT / f"docs/schema/{name}.schema.json").read_text())
    for line in lines:
        jsonschema.validate(line, schema)
    return lines


@pytest.mark.long
def test_twenty_boards_from_the_box_to_poses(bench, tmp_path, monkeypatch):
    made, site = bench(19), tmp_path / "room.toml"
    found = valid(made.lines("nodes", "boards"), "board")
    assert len({line["unique_id"] for line in found}) == 20
    assert {line["node"] for line in found} == set(SHARED)
    code, _, told = made.run("nodes", "reset", "7")
    assert (code, "name one of them with --id" in told) == (2, True)
    listed, numbers = found, {}
    for words in documented_commands():
        if words[:2] in (["nodes", "set"], ["nodes", "save"], ["nodes", "reset"]):
            words[2] = str(numbers["b1"])  # the wire is that of this board
        if words[:2] == ["nodes", "start"]:
            made.rig.advance(2.0)
            assert made.energised() == set()
        code, out, told = made.run(*[str(site) if word == "room.toml" else word for word in words])
        assert code == 0, (words, told)
        if words[:2] == ["nodes", "assign"]:
            listed = made.lines("nodes", "boards")
            numbers = made.numbers(listed)
            assert [line["node"] for line in listed] == list(range(1, 21))
            assert [line["role"] for line in listed] == 19 * ["beacon"] + ["sensor"]
            made.write_site(site, listed)
            code, out, _ = made.run("nodes", "start", "--all")
            assert code == 3  # nobody was commissioned
            code, out, _ = made.run("site", "check", str(site))
            assert (code, f"b1, node {numbers['b1']}: amplitude is 0, the site says 10" in out) == (3, True)
            assert made.run("site", "check", str(site), "--json")[1].count("\n") == out.count("\n")
        if words[:2] == ["nodes", "start"]:
            made.rig.advance(5.0)
            currents = {line["node"]: line["drives"][0]["current_A"] for line in made.lines("nodes") if line["drives"]}
            assert currents == {number: pytest.approx(10.0, rel=0.01) for number in numbers.values()}
    seen = next(name for name, number in numbers.items() if number == 3)
    assert out == f"sensor 20 sees node 3: code {int(seen[1:]) + 1} comes and goes\n"

    made.rig.advance(2.0)
    link = RigLink(made.rig)
    monkeypatch.setattr(sessions, "time", link)
    monkeypatch.setattr(dialogues, "time", link)
    epochs = Sensor(link, "hall", sites.load(site)).epochs()
    poses = [next(epochs).pose for _ in range(10)]
    assert [pose.status for pose in poses] == 10 * [Status.OK]
    assert max(np.linalg.norm(pose.position_m - SENSOR_M) for pose in poses) < 0.01


@pytest.mark.long
def test_names_groups_copies_and_what_holds_over_a_reset(bench, tmp_path):
    made, site = bench(4, 3), tmp_path / "room.toml"
    made.lines("nodes", "assign", "--renew")
    listed = made.lines("nodes", "boards")
    numbers = made.numbers(listed)
    spare = next(line["node"] for line in listed if line["role"] == "beacon" and line["node"] not in numbers.values())
    for name, number in numbers.items():
        made.lines("nodes", "name", str(number), name)
    text = (ROOT / "docs/site_file.md").read_text()
    assert "whose name is the `id` of the beacon" in text
    made.write_site(site, listed)
    named = "\n".join(line for line in site.read_text().splitlines() if not line.startswith("board = "))
    site.write_text(named.replace('id = "b3"', 'id = "b3"\ngroup = 5'))
    (pushed,) = made.lines("site", "push", str(site))
    assert pushed["nodes"] == sorted([*numbers.values(), 5])
    assert made.lines("nodes", "set", str(numbers["b1"]), "sync_master", "1")
    made.lines("nodes", "save", str(numbers["b1"]))
    made.lines("nodes", "reset", str(numbers["b1"]))

    (copied,) = made.lines("nodes", "clone", str(numbers["b3"]), str(spare))
    assert copied["to"] == [spare]
    assert made.run("nodes", "get", str(spare), "amplitude")[1].startswith("amplitude = 10 A")
    assert made.run("nodes", "get", str(spare), "code")[1].startswith("code = 0 ")
    made.rig.advance(2.0)
    assert made.energised() == set()

    (started,) = made.lines("nodes", "start", "--group", "5", "--save")
    assert started["started"] == sorted([numbers["b3"], spare])
    made.rig.advance(5.0)
    assert made.energised() == {3, 4}
    made.lines("nodes", "reset", str(numbers["b3"]))
    made.rig.advance(5.0)
    assert made.energised() == {3}
    made.lines("nodes", "stop", "--group", "5")
    made.rig.advance(0.01)
    assert made.rig.coil_current_A(3) == pytest.approx(0.0, abs=0.01)
    by_number = {line["node"]: line for line in valid(made.lines("nodes", "boards"), "board")}
    assert [(by_number[n]["name"], by_number[n]["group"]) for n in (numbers["b1"], numbers["b3"])] == [
        ("b1", 0),
        ("b3", 5),
    ]
    assert not any(line["armed"] for line in by_number.values())

    made.lines("nodes", "set", str(numbers["b2"]), "amplitude", "8")
    code, out, told = made.run("site", "check", str(site), "--json")
    (line,) = valid([json.loads(line) for line in out.splitlines()], "difference")
    assert (code, line) == (
        3,
        {"beacon": "b2", "node": numbers["b2"], "parameter": "amplitude", "board": 8.0, "site": 10.0},
    )
    assert "1 value" in told
    made.lines("nodes", "name", str(numbers["b2"]), "other")
    code, _, told = made.run("site", "push", str(site))
    assert (code, 'beacon "b2": no board has the name "b2"' in told, "nothing was set" in told) == (3, True, True)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["nodes", "start"], "give one of these"),
        (["nodes", "stop", "3", "--all"], "give one of these"),
        (["nodes", "start", "--group", "0"], "give one from 1 to 255"),
        (["nodes", "number", "3", "4096"], "give one from 1 to 4095"),
        (["nodes", "name", "3", "seventeen letters"], "up to 16 characters"),
        (["nodes", "clone", "3", "3"], "cannot be copied to itself"),
        (["nodes", "assign", "--first", "0"], "give one from 1 to 4095"),
    ],
)
def test_what_cannot_be_meant_is_one_sentence(monkeypatch, capsys, words, said):
    class Silent(RigLink):
        def __init__(self):
            self.name, self.shared, self.listen_only, self.reconnects = "silent", True, False, False

        def send(self, identifier, data):
            raise AssertionError("nothing is to be sent")

    monkeypatch.setattr(opening, "open_link", lambda *_: Silent())
    code = main([*words, "--can", "a:b"])
    assert (code, said in capsys.readouterr().err) == (2, True)
