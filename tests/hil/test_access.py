"""Boards with a key on a bench of host boards, by the command line and the pipeline, in virtual time."""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Iterator
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path

import pytest

from goldfield import site as sites
from goldfield.cli import main
from goldfield.link import access
from goldfield.link.access import KEY, Locked
from goldfield.link.access_key import load_key, make_key
from goldfield.link.requests import set_request
from goldfield.nodes import conversation as conversations
from goldfield.nodes import opening
from goldfield.sensor import dialogue as dialogues
from goldfield.sensor import session as sessions
from goldfield.sensor.pipeline import Sensor
from goldfield_protocol.parameters import PARAMETERS, Kind
from hil_sim.rig import Rig
from hil_sim.scenario import load_scenario
from hil_sim.scenario.site_file import site_toml
from tests.hil.rig_link import RigLink, RigSerialLink

BOOTED_S = 2.5
SENSOR = 100
GROUP = PARAMETERS["group"].first
PARAM_SET, COMMAND, ACCESS_MESSAGE = 0x0C, 0x1C, 0x13
LOCK = 17


class Line(RigLink):
    """The bus, with what the host has sent on it."""

    def __init__(self, rig: Rig) -> None:
        super().__init__(rig)
        self.sent: list[tuple[int, bytes]] = []

    def send(self, identifier: int, data: bytes) -> None:
        self.sent.append((identifier, data))
        super().send(identifier, data)

    def types(self) -> set[int]:
        return {identifier >> 24 & 0x1F for identifier, _ in self.sent}


@dataclass
class Bench:
    """A rig, and the command line on its bus."""

    rig: Rig
    monkeypatch: pytest.MonkeyPatch
    link: Line | None = None

    def use(self, link: RigLink) -> None:
        for module in (access, conversations, dialogues, sessions):
            self.monkeypatch.setattr(module, "time", link)

    def run(self, *words: str) -> tuple[int, str, str]:
        """Exit code, stdout and stderr of a command."""
        self.link = Line(self.rig)
        self.use(self.link)
        self.monkeypatch.setattr(opening, "open_link", lambda *_: self.link)
        out, told = io.StringIO(), io.StringIO()
        with redirect_stdout(out), redirect_stderr(told):
            code = main([*words, "--can", "socketcan:can0"])
        return code, out.getvalue(), told.getvalue()

    def done(self, *words: str) -> str:
        code, out, told = self.run(*words)
        assert code == 0, told
        return out

    def access(self) -> dict[int, str]:
        lines = [json.loads(line) for line in self.done("nodes", "boards", "--json").splitlines()]
        return {line["node"]: line["access"] for line in lines}


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> Iterator[Bench]:
    monkeypatch.delenv("GOLDFIELD_KEY", raising=False)
    with Rig(load_scenario("prigge8can"), "host") as rig:
        rig.advance(BOOTED_S)
        yield Bench(rig, monkeypatch)


@pytest.fixture
def keys(tmp_path: Path) -> Callable[[str], str]:
    def key(name: str) -> str:
        place = tmp_path / name
        return str(place) if place.exists() else make_key(place).file

    return key


def sensor_of(bench: Bench, link: RigLink, tmp_path: Path) -> Sensor:
    path = tmp_path / "room.toml"
    path.write_text(site_toml(load_scenario("prigge8can")))
    bench.use(link)
    return Sensor(link, "hall", sites.load(path))


@pytest.mark.long
def test_locked_boards_are_changed_with_their_key_only(bench: Bench, keys: Callable[[str], str]) -> None:
    own, other = keys("site.key"), keys("other.key")
    assert set(bench.access().values()) == {"open"}
    code, _, told = bench.run("nodes", "key", "set", "3", "100", "--key", own, "--pause")
    assert code == 0, told
    assert "in the clear" in told
    assert [node for node, state in bench.access().items() if state == "locked"] == [3, SENSOR]
    assert "locked" in bench.done("nodes")

    code, _, told = bench.run("nodes", "set", "3", "group", "4")
    assert (code, told.count("\n"), "give its site's key, --key FILE" in told) == (3, 1, True)
    code, _, told = bench.run("nodes", "set", "3", "group", "4", "--key", other)
    assert (code, f"node 3 has another key than that of {other}" in told) == (3, True)
    assert bench.done("nodes", "get", "3", "group").startswith("group = 0 ")
    assert bench.done("nodes", "set", "3", "group", "4", "--key", own).startswith("group = 4, was 0")
    assert bench.done("nodes", "set", "4", "group", "4").startswith("group = 4, was 0")  # The open ones are as before.
    code, _, told = bench.run("nodes", "set", "3", "group", "5")  # The command before has locked it behind itself.
    assert code == 3

    bench.done("nodes", "stop", "--all")
    code, _, told = bench.run("nodes", "start", "--group", "4")
    assert (code, "node 3 is locked" in told) == (3, True)
    bench.monkeypatch.setenv("GOLDFIELD_KEY", own)
    assert bench.done("nodes", "start", "--group", "4").startswith("2 boards started: 3, 4")
    bench.done("nodes", "reset", "3")
    bench.monkeypatch.delenv("GOLDFIELD_KEY")
    assert bench.run("nodes", "reset", "3")[0] == 3
    assert bench.access()[3] == "locked"


@pytest.mark.long
def test_a_key_is_replaced_and_removed_by_who_knows_it(bench: Bench, keys: Callable[[str], str]) -> None:
    own, other = keys("site.key"), keys("other.key")
    bench.done("nodes", "key", "set", "3", "--key", own, "--pause")
    bench.done("nodes", "key", "set", "3", "--key", own, "--pause")  # It has it already.
    for words in (("set", "3", "--key", other, "--pause"), ("remove", "3", "--key", other, "--pause")):
        code, _, told = bench.run("nodes", "key", *words)
        assert (code, "has another key" in told) == (3, True)
    bench.rig.advance(1.0)
    bench.done("nodes", "key", "set", "3", "--old", own, "--key", other, "--pause")
    assert bench.run("nodes", "set", "3", "group", "4", "--key", own)[0] == 3
    bench.rig.advance(1.0)
    bench.done("nodes", "set", "3", "group", "4", "--key", other)
    assert bench.done("nodes", "key", "remove", "3", "--key", other, "--pause").startswith("1 board is open")
    assert bench.access()[3] == "open"
    bench.done("nodes", "set", "3", "group", "5")


@pytest.mark.long
def test_neither_a_copy_nor_a_read_takes_the_key_along(bench: Bench, keys: Callable[[str], str]) -> None:
    own = keys("site.key")
    bench.done("nodes", "key", "set", "3", "--key", own, "--pause")
    assert bench.done("nodes", "get", "3", "access_key").startswith("access_key is set")
    code, _, told = bench.run("nodes", "set", "3", "access_key", "1", "--key", own)
    assert (code, "is secret" in told) == (2, True)
    bench.done("nodes", "clone", "3", "4", "--pause")
    bench.done("nodes", "clone", "5", "3", "--pause", "--key", own)
    found = bench.access()
    assert (found[3], found[4]) == ("locked", "open")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("set",), "takes numbers of nodes or --all"),
        (("set", "3", "--all"), "takes numbers of nodes or --all"),
        (("set", "3"), "no key is given: give its file with --key FILE"),
        (("remove", "--all"), "no key is given"),
        (("set", "3", "--key", "nowhere"), "nowhere: there is no such key"),
    ],
)
def test_what_is_wrong_with_a_command_is_told_before_a_board_is_asked(
    bench: Bench, words: tuple[str, ...], said: str
) -> None:
    code, _, told = bench.run("nodes", "key", *words)
    assert (code, said in told) == (2, True)
    assert bench.link is None or not bench.link.sent


@pytest.mark.long
def test_a_locked_sensor_that_is_set_up_is_read_without_its_key(
    bench: Bench, keys: Callable[[str], str], tmp_path: Path
) -> None:
    bench.done("nodes", "key", "set", str(SENSOR), "--key", keys("site.key"))
    link = Line(bench.rig)
    epochs = sensor_of(bench, link, tmp_path).epochs()
    assert len([next(epochs) for _ in range(3)]) == 3
    assert PARAM_SET not in link.types()


@pytest.mark.long
@pytest.mark.parametrize("line", ["bus", "serial"])
def test_a_locked_sensor_is_set_with_its_key_and_locked_again(
    bench: Bench, keys: Callable[[str], str], tmp_path: Path, line: str
) -> None:
    own, other = load_key(keys("site.key")), load_key(keys("other.key"))
    bench.done("nodes", "set", str(SENSOR), "code_list", "999")
    bench.done("nodes", "key", "set", str(SENSOR), "--key", own.file)

    def opened() -> RigLink:
        return Line(bench.rig) if line == "bus" else RigSerialLink(bench.rig)

    for key, said in ((None, "give its site's key, key=FILE"), (other, "has another key")):
        link = opened()
        link.key = key
        with pytest.raises(Locked, match=said):
            next(sensor_of(bench, link, tmp_path).epochs())
    bench.rig.advance(1.0)
    link = opened()
    link.key = own
    epochs = sensor_of(bench, link, tmp_path).epochs()
    assert len([next(epochs) for _ in range(3)]) == 3
    link.send(*set_request(SENSOR, GROUP, 9, Kind.UNSIGNED))
    bench.rig.advance(0.1)
    assert bench.done("nodes", "get", str(SENSOR), "group").startswith("group = 0 ")


@pytest.mark.long
def test_the_key_is_on_the_bus_only_when_it_is_set(bench: Bench, keys: Callable[[str], str]) -> None:
    own = load_key(keys("site.key"))
    bench.done("nodes", "key", "set", "3", "--key", own.file, "--pause")
    words = {word.to_bytes(4, "little") for word in own.words}

    def shown() -> set[bytes]:
        assert bench.link is not None
        return {word for _, data in bench.link.sent for word in words if word in data}

    assert shown() == words
    bench.done("nodes", "set", "3", "group", "4", "--key", own.file)
    assert shown() == set()
    assert bench.link is not None
    identifiers = [identifier for identifier, _ in bench.link.sent]
    assert identifiers[-1] == COMMAND << 24 | LOCK << 12
    assert ACCESS_MESSAGE << 24 | 1 << 12 | 3 in identifiers
    assert not any(KEY.first <= (i >> 12 & 0xFFF) < KEY.first + 4 for i in identifiers if i >> 24 == PARAM_SET)
