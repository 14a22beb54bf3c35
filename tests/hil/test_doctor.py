"""``goldfield doctor`` on host boards with one fault each: it names that fault alone, and nothing if all is sound.

The host sits on the CAN bus or on the sensor's serial line, in virtual time.
"""

import json

import can
import jsonschema
import numpy as np
import pytest

from goldfield import site as sites
from goldfield.cli import main
from goldfield.doctor import machine
from goldfield.doctor.checks import Fault, State
from goldfield.doctor.examination import Examination
from goldfield.nodes import conversation as conversations
from goldfield.sensor import dialogue as dialogues
from goldfield.sensor import session as sessions
from goldfield_protocol import encode
from goldfield_protocol.parameters import parse_page
from hil_sim.clib import ROOT
from hil_sim.rig import Rig
from hil_sim.scenario import load_scenario, site_toml
from tests.hil.rig_link import RigLink, RigSerialLink, altered_boards

BOOTED_S = 2.5
BUS, LINE = RigLink, RigSerialLink
BOTH = pytest.mark.parametrize("link", [BUS, LINE])
SCENARIO = (ROOT / "hil_sim/scenarios/prigge8.toml").read_text()


@pytest.fixture
def bench(monkeypatch, tmp_path):
    """Return a function that boots a bench, some of it not as its site file says, and puts the doctor's link on it.

    ``pages`` are changed parameters by board, 0 is the sensor; ``changed`` replaces text of the scenario that the site
    file does not know of; ``site`` does so in the site file.
    """
    rigs = []

    def make(link=BUS, *, pages=None, changed=None, site=None, sensor_ppm=None, off=(), name="prigge8"):
        site_file, scenario_file = tmp_path / "site.toml", tmp_path / "scenario.toml"
        scenario = load_scenario(name)
        site_file.write_text(replaced(site_toml(scenario), site))
        if changed is not None:
            scenario_file.write_text(replaced(SCENARIO, changed))
            scenario = load_scenario(str(scenario_file))
        rig = Rig(scenario, altered_boards(pages, sensor_ppm))
        rigs.append(rig)
        for number in off:
            rig.power_cycle(number, 1000.0)
        rig.advance(BOOTED_S)
        made = link(rig)
        monkeypatch.setattr(machine, "open_link", lambda *_: made)
        for module in (conversations, sessions, dialogues):
            monkeypatch.setattr(module, "time", made)
        return "port" if issubclass(link, LINE) else "can", site_file

    yield make
    for rig in rigs:
        rig.close()


def replaced(text, pair):
    if pair is not None:
        assert pair[0] in text
        text = text.replace(*pair)
    return text


def examined(bench_of):
    kind, site_file = bench_of
    return list(Examination(kind, "rig", sites.load(site_file)).checks())


def faults(checks):
    """The faults that were found, each with the boards and the beacons that it names."""
    return [(check.fault, check.nodes, check.beacons) for check in checks if check.fault is not None]


@pytest.mark.parametrize(("link", "name"), [(BUS, "prigge8"), (LINE, "prigge8"), (BUS, "prigge8can")])
def test_a_sound_bench_has_nothing_wrong(bench, link, name):
    checks = examined(bench(link, name=name))
    assert faults(checks) == []
    beacons = [check for check in checks if check.subject.startswith("beacon b")]
    assert [check.state for check in beacons] == [State.SOUND] * 8


def test_a_wrong_code_is_named_with_the_right_one(bench):
    checks = examined(bench(pages={3: {"code": 20}}))
    assert faults(checks) == [(Fault.CODE, (3,), ("b3",))]
    (check,) = (check for check in checks if check.fault)
    assert "drives the code 20" in check.text
    assert "goldfield nodes set 3 code 4" in check.advice


@pytest.mark.parametrize(("node", "code", "beacons"), [(3, 3, ("b2", "b3")), (3, 5, ("b4", "b3"))])
def test_a_code_that_two_boards_drive_is_blamed_on_neither(bench, node, code, beacons):
    """What they say does not tell which of the two is wrong, the one of the smaller number or the other."""
    checks = examined(bench(pages={node: {"code": code}}))
    assert faults(checks) == [(Fault.CODE, (min(node, code - 1), max(node, code - 1)), beacons)]
    (check,) = (check for check in checks if check.fault)
    assert "and no board drives the code 4 of b3" in check.text
    assert "goldfield nodes identify" in check.advice
    assert "goldfield nodes set NODE code 4" in check.advice


def test_a_site_file_of_another_degree_is_one_fault(bench):
    checks = examined(bench(site=("degree = 10", "degree = 9")))
    assert faults(checks) == [(Fault.SITE, (*range(1, 9), 100), ())]


def test_a_wrong_code_seen_from_a_serial_line_is_a_beacon_without_a_field(bench):
    checks = examined(bench(LINE, pages={3: {"code": 20}}))
    assert faults(checks) == [(Fault.OFF, (), ("b3",))]
    assert any("its board drives the code 4" in check.advice for check in checks)


@BOTH
def test_a_reversed_coil(bench, link):
    b3 = "position_m = [2.13, 0.00, 0.00]\n"
    checks = examined(bench(link, changed=(b3, f"{b3}axis = [0.0, 0.0, -1.0]\n")))
    assert faults(checks) == [(Fault.REVERSED, (), ("b3",))]


@BOTH
def test_a_beacon_that_is_off(bench, link):
    assert faults(examined(bench(link, off=(3,)))) == [(Fault.OFF, (), ("b3",))]


def test_a_beacon_of_no_amplitude(bench):
    checks = examined(bench(pages={3: {"amplitude": 0.0}}))
    assert faults(checks) == [(Fault.OFF, (3,), ("b3",))]
    (found,) = [check for check in checks if check.fault is Fault.OFF]
    assert "has an amplitude of 0 A" in found.text
    assert found.advice.startswith("goldfield nodes set 3 amplitude 10;")
    assert found.advice.endswith("then goldfield nodes start 3 --save")


def test_a_board_that_is_not_armed_is_to_be_started(bench):
    checks = examined(bench(pages={3: {"armed": 0}}))
    assert faults(checks) == [(Fault.OFF, (3,), ("b3",))]
    (found,) = [check for check in checks if check.fault is Fault.OFF]
    assert (found.text, found.advice) == ("node 3 (b3) is not armed: its coil is off", "goldfield nodes start 3 --save")


@BOTH
@pytest.mark.parametrize("kind", ["swapped", "reversed"])
def test_swapped_and_reversed_axes(bench, link, kind):
    matrix = np.array(parse_page(_sensor_page())["calibration"]).reshape(3, 3)
    matrix = matrix[[1, 0, 2]] if kind == "swapped" else matrix * np.array([[1.0], [-1.0], [1.0]])
    checks = examined(bench(link, pages={0: {"calibration": matrix.ravel().tolist()}}))
    assert faults(checks) == [(Fault.AXES, (), ())]


def _sensor_page():
    from hil_sim.scenario import parameter_page

    return parameter_page(load_scenario("prigge8"), 0)


class OtherFirmware(RigLink):
    """One board's heartbeats tell another protocol."""

    node = 3

    def receive(self, timeout_s):
        raw = super().receive(timeout_s)
        if raw is not None and raw.arbitration_id >> 24 == 0x08 and raw.arbitration_id & 0xFFF == self.node:
            raw = can.Message(
                timestamp=raw.timestamp, arbitration_id=raw.arbitration_id, data=b"\x01\x02\x03\x04" + raw.data[4:]
            )
        return raw


class OtherSensorFirmware(OtherFirmware):
    node = 100


@pytest.mark.parametrize(("link", "role"), [(OtherFirmware, "beacon"), (OtherSensorFirmware, "sensor")])
def test_other_firmware(bench, link, role):
    checks = examined(bench(link))
    assert (Fault.FIRMWARE, (link.node,), ()) in faults(checks)
    (check,) = (check for check in checks if check.fault is Fault.FIRMWARE)
    assert "speaks protocol 0x04030201" in check.text
    assert f"make flash ROLE={role} NODE={link.node}" in check.advice


@BOTH
def test_a_clock_that_is_not_locked(bench, link):
    checks = examined(bench(link, sensor_ppm=400.0))
    assert faults(checks) == [(Fault.CLOCK, (100,), ())]
    assert any(check.state is State.UNJUDGED and check.subject == "beacons" for check in checks)


def test_the_site_file_of_another_room_by_its_codes(bench):
    lines = [f"code = {code}\n" for code in range(2, 10)]
    kind, site_file = bench()
    text = site_file.read_text()
    for code, line in enumerate(lines, start=40):
        assert line in text
        text = text.replace(line, f"code = {code}\n")
    site_file.write_text(text)
    (fault,) = faults(examined((kind, site_file)))
    assert fault[0] is Fault.SITE
    assert len(fault[2]) == 8


@BOTH
def test_the_site_file_of_another_room_by_its_places(bench, link):
    checks = examined(bench(link, site=("2.13", "3.4")))
    assert {fault for fault, _, _ in faults(checks)} == {Fault.SITE}


@BOTH
def test_a_low_current(bench, link):
    checks = examined(bench(link, pages={3: {"amplitude": 8.0}}))
    assert faults(checks) == [(Fault.CURRENT, (3,) if link is BUS else (), ("b3",))]


def test_a_second_master(bench):
    assert faults(examined(bench(pages={2: {"sync_master": 1}}))) == [(Fault.MASTERS, (1, 2), ())]


class SecondHost(RigLink):
    """Another host sets the sensor's code list once a second of virtual time."""

    def receive(self, timeout_s):
        if self.rig.now_s > getattr(self, "next_s", 0.0):
            self.next_s = self.rig.now_s + 1.0
            self.rig.can_write(*encode("PARAM_SET", {"kind": 0, "value_unsigned": 40}, node=100, index=256))
        return super().receive(timeout_s)


def test_a_second_host(bench):
    found = faults(examined(bench(SecondHost)))
    assert (Fault.HOSTS, (100,), ()) in found
    assert {fault for fault, _, _ in found} == {Fault.HOSTS}


def test_nobody_there(bench, monkeypatch):
    kind, site_file = bench()
    monkeypatch.setattr(Rig, "can_read", lambda _: [])
    assert [fault for fault, _, _ in faults(examined((kind, site_file)))] == [Fault.LINK]


@pytest.mark.parametrize(("pages", "code"), [(None, 0), ({3: {"amplitude": 8.0}}, 3)])
def test_the_exit_code_tells_and_json_is_as_its_schema_says(bench, pages, code, capsys):
    _, site_file = bench(pages=pages)
    words = ["doctor", "--can", "socketcan:can0", "--site", str(site_file), "--json"]
    assert main(words) == code
    schema = json.loads((ROOT / "docs/schema/check.schema.json").read_text())
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    for line in lines:
        jsonschema.validate(line, schema)
    assert [line["fault"] for line in lines if line["fault"]] == ([] if code == 0 else ["current"])


def test_the_words_fit_a_terminal(bench, capsys):
    _, site_file = bench(pages={3: {"code": 20}})
    assert main(["doctor", "--can", "socketcan:can0", "--site", str(site_file)]) == 3
    out = capsys.readouterr().out
    assert all(len(line) <= 80 for line in out.splitlines())
    assert "  !!  codes: node 3 drives the code 20" in out
    assert out.splitlines()[-1] == "1 thing is wrong"


@pytest.mark.parametrize(
    "words", [["doctor"], ["doctor", "--port", "x"], ["doctor", "--port", "x", "--site", "nowhere"]]
)
def test_bad_usage(words, capsys):
    assert main(words) == 2
    assert capsys.readouterr().err.count("\n") == 1
