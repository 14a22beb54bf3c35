"""``goldfield nodes`` on the CAN bus and on the serial line of host boards, in virtual time."""

import json

import jsonschema
import pytest

from goldfield.cli import main
from goldfield.nodes import conversation as conversations
from goldfield.nodes import opening
from hil_sim.clib import ROOT
from hil_sim.rig import Rig
from hil_sim.scenario import load_scenario
from tests.firmware.host_rig import PIN_ENABLE
from tests.hil.rig_link import RigLink, RigSerialLink

BOOTED_S = 2.5


def schema(name):
    return json.loads((ROOT / f"docs/schema/{name}.schema.json").read_text())


@pytest.fixture(scope="module")
def rig():
    with Rig(load_scenario("prigge8can"), "host") as made:
        made.advance(BOOTED_S)
        yield made


@pytest.fixture
def nodes(rig, monkeypatch, capsys):
    """Return a function that runs the command on the rig's bus or serial line: exit code, stdout, stderr."""

    def run(*words, link=RigLink):
        monkeypatch.setattr(opening, "open_link", lambda *_: made)
        made = link(rig)
        monkeypatch.setattr(conversations, "time", made)
        option = "--can" if link is RigLink else "--port"
        code = main(["nodes", option, "socketcan:can0", *words])
        return (code, *capsys.readouterr())

    return run


def test_who_is_there(nodes):
    code, out, _ = nodes("--json")
    found = {line["node"]: line for line in map(json.loads, out.splitlines())}
    assert code == 0
    for line in found.values():
        jsonschema.validate(line, schema("node"))
    assert sorted(found) == [1, 2, 3, 4, 5, 6, 7, 8, 100]
    assert {found[node]["role"] for node in range(1, 9)} == {"beacon"}
    assert found[100]["role"] == "sensor"
    assert [node for node in found if found[node]["sync_master"]] == [1]
    for line in found.values():
        assert (line["state"], line["locked"], line["same_protocol"]) == ("running", True, True)
        assert line["last_reset"] == {
            **{"cause": "power_on", "uptime_s": 0, "stalled": [], "text": "", "crash": None},
            "counts": {"power_on": 1},
        }
    (drive,) = found[3]["drives"]
    assert drive["current_A"] == pytest.approx(10.0, rel=0.01)
    assert (drive["target_A"], drive["enabled"], drive["open_coil"]) == (10.0, True, False)


def test_the_table_fits_a_terminal_and_serial_shows_the_sensor_alone(nodes):
    code, out, _ = nodes()
    assert code == 0
    assert all(len(line) <= 80 for line in out.splitlines())
    assert "   1 beacon  running        0.1.0     10.00 of 10  locked\n     sync master\n" in out
    code, out, told = nodes(link=RigSerialLink)
    assert [line.split()[0] for line in out.splitlines()[1:] if not line.startswith("     ")] == ["100"]
    assert "its own board only" in told


@pytest.mark.parametrize("link", [RigLink, RigSerialLink])
def test_a_parameter_is_read_with_its_unit_and_range(nodes, link):
    assert nodes("get", "100", "alert_limit", link=link)[:2] == (0, "alert_limit = 0.5 m  (0 to 1000000 m)\n")
    assert nodes("get", "100", "code_list[3]", link=link)[1] == "code_list[3] = 5  (0 to 2048)\n"


def test_all_parameters_of_a_role_are_listed(nodes):
    _, out, _ = nodes("get", "3")
    assert "amplitude = 10 A  (0 to 15.9 A)\n" in out
    assert "calibration" not in out


def test_a_parameter_is_set_and_truly_acts(nodes, rig):
    code, out, _ = nodes("set", "3", "amplitude", "8")
    assert (code, out.splitlines()[0]) == (0, "amplitude = 8 A, was 10 A")
    rig.advance(2.0)
    assert abs(rig.coil_current_A(3)) == pytest.approx(8.0, rel=0.02)
    line = json.loads(nodes("set", "3", "amplitude", "10", "--json")[1])
    jsonschema.validate(line, schema("parameter"))
    assert (line["values"], line["before"], line["units"]) == ([10.0], [8.0], ["A"])
    nodes("set", "100", "code_list", "9", "8")
    assert nodes("get", "100", "code_list[1]")[1].startswith("code_list[1] = 8 ")
    nodes("set", "100", "code_list", "2", "3")


@pytest.mark.parametrize("link", [RigLink, RigSerialLink])
def test_a_board_is_told_by_its_unique_id_and_blinks(nodes, link):
    lines = [json.loads(line) for line in nodes("--json", link=link)[1].splitlines()]
    ids = [line["unique_ids"] for line in lines]
    assert all(len(own) == 1 for own in ids)
    assert len({own[0] for own in ids}) == len(lines)
    code, out, _ = nodes("identify", "100", "--for", "3", link=link)
    assert (code, out) == (0, "the LED of node 100 blinks for 3 s\n")


def test_a_reset_leaves_no_bridge_on_and_the_beacon_comes_back(nodes, rig):
    assert abs(rig.coil_current_A(5)) > 1.0
    rig.watch_pins()
    code, out, _ = nodes("reset", "5")
    assert (code, out) == (0, "node 5 has restarted\n")
    changes = rig.pin_changes(5)
    rig.watch_pins(False)
    levels = {int(pin): bool(level) for pin, level in zip(changes["pin"], changes["level"], strict=True)}
    assert levels[PIN_ENABLE] is False
    rig.advance(0.02)
    assert rig.coil_current_A(5) == pytest.approx(0.0, abs=0.01)
    rig.advance(6.0)
    drives = {line["node"]: line["drives"] for line in map(json.loads, nodes("--json")[1].splitlines())}
    assert drives[5][0]["current_A"] == pytest.approx(10.0, rel=0.02)


def test_another_board_is_not_reset(nodes):
    code, _, told = nodes("reset", "5", "--id", "0" * 24)
    assert code == 2
    assert "name one of them with --id" in told


def test_a_sensor_saves_and_restarts_only_where_flash_was_erased(nodes, rig):
    assert nodes("set", "100", "gain_sd", "0.01")[0] == 0
    code, out, _ = nodes("save", "100", "--json")
    told = json.loads(out)
    assert (code, told["node"], told["saved"], told["restarted"]) == (0, 100, True, True)
    assert nodes("set", "100", "gain_sd", "0.02")[0] == 0
    code, out, _ = nodes("save", "100")
    assert (code, out) == (0, "node 100 has saved all its parameters\n")
    assert nodes("reset", "100")[0] == 0
    assert "gain_sd = 0.02" in nodes("get", "100", "gain_sd")[1]


def test_a_beacon_that_drives_saves_only_if_it_may_pause(nodes, rig):
    rig.watch_pins()
    code, _, told = nodes("save", "5")
    assert code == 3
    assert "node 5 drives its coil, and its processor stands still for each word that it saves" in told
    assert "goldfield nodes save 5 --pause" in told
    assert PIN_ENABLE not in rig.pin_changes(5)["pin"]
    code, out, _ = nodes("save", "5", "--pause")
    assert (code, out) == (
        0,
        "node 5 has saved all its parameters, and has restarted, as it had to erase flash for them\n",
    )
    rig.advance(2.0)
    changes = rig.pin_changes(5)
    rig.watch_pins(False)
    enables = [bool(level) for pin, level in zip(changes["pin"], changes["level"], strict=True) if pin == PIN_ENABLE]
    assert enables == [False, True]
    _, out, _ = nodes("--json")
    assert {line["node"]: line["state"] for line in map(json.loads, out.splitlines())}[5] == "running"


@pytest.mark.parametrize(
    ("status", "said"),
    [
        (2, "node 5 saves nothing, as it is about to restart: wait until it has, and try again"),
        (4, "node 5 could not write its flash, and keeps what it had saved before"),
        (1, "node 5 refuses the command: flash it with this version's firmware"),
    ],
)
def test_what_keeps_a_board_from_saving_is_one_sentence(nodes, monkeypatch, status, said):
    real = conversations.Conversation.wait

    def wait(self, take, seconds):
        def changed(message):
            if message.name == "COMMAND_ANSWER":
                message.signals["status"] = status
            return take(message)

        return real(self, changed, seconds)

    monkeypatch.setattr(conversations.Conversation, "wait", wait)
    code, _, told = nodes("save", "5", "--pause")
    assert code == 3
    assert said in told


def test_a_beacon_that_was_switched_off_says_why_and_drives_again_when_it_is_cleared(nodes, rig):
    rig.fault(4, "driver")
    rig.advance(1.5)
    _, out, _ = nodes()
    told = " ".join(out.split())
    assert "channel 0 is off: the driver pulled its fault pin; when that is mended: goldfield nodes clear 4" in told
    code, _, told = nodes("clear", "4")
    assert code == 3
    assert "node 4 keeps its drive off, as the cause lasts" in told
    nodes("set", "4", "amplitude", "10")
    assert rig.coil_current_A(4) == 0.0
    rig.fault(4, "driver", active=False)
    rig.advance(0.1)
    code, out, _ = nodes("clear", "4")
    assert (code, out) == (0, "node 4 may drive again: after repeated faults it waits a while before it does\n")
    rig.advance(1.5)
    (line,) = [line for line in map(json.loads, nodes("--json")[1].splitlines()) if line["node"] == 4]
    jsonschema.validate(line, schema("node"))
    assert line["health"][0]["cause"] == "none"
    assert line["drives"][0]["enabled"]


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (("set", "3", "amplitude", "16"), 2, "amplitude is 16 A; it must be 0 to 15.9 A"),
        (("set", "3", "amplitude", "1", "2"), 2, "got 2 values; it takes 1 at most"),
        (("get", "3", "amplitud"), 2, "nearest is 'amplitude'"),
        (("get", "77", "amplitude"), 3, "node 77 does not answer"),
        (("get", "77"), 3, "node 77 was not heard"),
    ],
)
def test_what_cannot_be_done_is_one_sentence(nodes, words, code, said):
    done, out, told = nodes(*words)
    assert (done, out) == (code, "")
    assert said in told
    assert told.count("\n") == 1


def test_nobody_there(nodes, rig, monkeypatch):
    monkeypatch.setattr(rig, "can_read", list)
    code, _, told = nodes()
    assert code == 3
    assert "no node was heard" in told


@pytest.mark.parametrize("words", [["nodes"], ["nodes", "--port", "x", "--can", "a:b"], ["nodes", "--port", ""]])
def test_one_link_must_be_given(words, capsys):
    assert main(words) == 2
    assert "--port" in capsys.readouterr().err
