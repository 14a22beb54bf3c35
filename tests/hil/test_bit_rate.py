"""``goldfield nodes bit-rate`` on a bus of four host boards, by the command line and in virtual time."""

from __future__ import annotations

import io
import json
from contextlib import redirect_stderr, redirect_stdout

import pytest

from goldfield.cli import main
from goldfield.link.line import Line
from goldfield.nodes import conversation as conversations
from goldfield.nodes import opening
from goldfield.nodes.conversation import FLASH_FAILED, SAVE
from goldfield_protocol import decode, encode
from goldfield_protocol.parameters import PARAMETERS
from hil_sim.clib import ROOT
from hil_sim.rig import Frame, Rig
from hil_sim.scenario import load_scenario
from tests.hil.rig_link import RigLink, RigSerialLink

BOOTED_S = 2.5
CAN_RATE = PARAMETERS["can_rate"].first
NODES = [1, 2, 3, 100]


class Bus(RigLink):
    """The bus, of which one board may be deaf, or have a flash that is worn."""

    deaf = worn = None

    def send(self, identifier, data):
        message = decode(identifier, data)
        if (message.name, message.node, message.index) == ("COMMAND", self.worn, SAVE):
            answer = encode("COMMAND_ANSWER", {"status": FLASH_FAILED, "value": 0}, node=self.worn, index=SAVE)
            self._received.append(Frame(self.rig.now_s, 0, *answer))
        elif message.node != self.deaf:
            super().send(identifier, data)


@pytest.fixture
def bench(monkeypatch, tmp_path):
    """Return a rig of three beacons and a sensor, and what runs a command of nodes on its bus."""
    text = (ROOT / "hil_sim/scenarios/prigge8can.toml").read_text()
    beacons = text.split("[[beacon]]")
    path = tmp_path / "three.toml"
    path.write_text("[[beacon]]".join(beacons[:4]))
    with Rig(load_scenario(str(path)), "host") as rig:
        rig.advance(BOOTED_S)

        def run(*words, bit_rate=None, kind=Bus, **faults):
            link = kind(rig)
            link.line = Line(link.line.link, bit_rate or link.line.bit_rate)
            for name, node in faults.items():
                setattr(link, name, node)
            monkeypatch.setattr(opening, "open_link", lambda *_: link)
            monkeypatch.setattr(conversations, "time", link)
            out, told = io.StringIO(), io.StringIO()
            with redirect_stdout(out), redirect_stderr(told):
                code = main(["nodes", "--can", "socketcan:can0", *words])
            return code, out.getvalue(), told.getvalue()

        yield rig, run


def rates(run, bit_rate=1_000_000):
    """The values of can_rate that the boards tell."""
    told = [json.loads(run("get", str(node), "can_rate", "--json", bit_rate=bit_rate)[1]) for node in NODES]
    return [line["values"][0] for line in told]


def restarts(rig, run, bit_rate=1_000_000):
    lines = map(json.loads, run("--json", bit_rate=bit_rate)[1].splitlines())
    return {line["node"]: sum(line["last_reset"]["counts"].values()) for line in lines}


@pytest.mark.long
@pytest.mark.parametrize("bit_rate", [500_000, 125_000])
def test_a_bus_goes_to_another_rate_and_back(bench, bit_rate):
    rig, run = bench
    code, out, told = run("bit-rate", str(bit_rate), "--pause")
    assert (code, told) == (0, "")
    assert out == f"4 boards heard at {bit_rate} bit/s: 1, 2, 3 and 100\n"
    assert set(restarts(rig, run, bit_rate).values()) == {2}
    code, out, told = run("bit-rate", "1000000", "--pause", "--json", bit_rate=bit_rate)
    assert (code, told) == (0, "")
    assert json.loads(out) == {"bit_rate": 1_000_000, "before": bit_rate, "nodes": NODES, "heard": NODES}
    assert rates(run) == [0] * 4
    assert set(restarts(rig, run).values()) == {3}


@pytest.mark.long
def test_the_rate_that_it_is_is_saved_and_resets_nobody(bench):
    """But for the first save of a board, which erases its flash."""
    rig, run = bench
    for _ in range(2):
        assert run("bit-rate", "1e6", "--pause")[:2] == (0, "4 boards heard at 1000000 bit/s: 1, 2, 3 and 100\n")
        assert set(restarts(rig, run).values()) == {2}


@pytest.mark.long
@pytest.mark.parametrize(
    ("words", "faults", "said", "starts"),
    [
        (["--pause"], {"deaf": 2}, "node 2", 1),
        (["--pause"], {"worn": 3}, "node 3 could not write its flash", 3),
        ([], {}, "drives its coil", 1),
    ],
)
def test_if_one_board_does_not_go_none_does(bench, words, faults, said, starts):
    """The first save of a board has it restart: others than the worn one come back from the new rate."""
    rig, run = bench
    code, out, told = run("bit-rate", "500000", *words, **faults)
    assert (code, out) == (3, "")
    assert said in told
    assert "nothing was changed" in told
    assert rates(run) == [0] * 4
    assert restarts(rig, run) == {node: 1 if node == faults.get("worn") else starts for node in NODES}
    for node in NODES:
        rig.power_cycle(node if node != 100 else 0, 0.1)
    rig.advance(BOOTED_S)
    assert rates(run) == [0] * 4, "nobody has saved another rate"
    assert sorted(restarts(rig, run)) == NODES


@pytest.mark.long
def test_the_one_board_of_a_serial_line(bench):
    """The sensor goes to 115,200 baud; its bus keeps its rate, and the other boards theirs."""
    _, run = bench
    code, out, told = run("bit-rate", "115200", "--pause", "--json", kind=RigSerialLink)
    assert (code, told) == (0, "")
    assert json.loads(out) == {"bit_rate": 115_200, "before": 2_000_000, "nodes": [100], "heard": [100]}
    for name, value in (("serial_rate", 3), ("can_rate", 0)):
        assert json.loads(run("get", "100", name, "--json")[1])["values"] == [value]
    assert rates(run) == [0] * 4
