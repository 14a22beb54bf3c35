"""What goes wrong while boards are commissioned changes no other board, energises none, and can be gone on with."""

from typing import ClassVar

import pytest

from goldfield.errors import SystemFailure, listed
from tests.hil import from_the_box
from tests.hil.from_the_box import benches, hall
from tests.hil.rig_link import RigLink

TWICE = "9"
"""The number that the second and the fifth board of a bench from the box share."""


@pytest.fixture
def bench(monkeypatch, tmp_path):
    with benches(monkeypatch, tmp_path) as make:
        yield lambda beacons: make(hall(beacons))


def numbered(made, site):
    """Give the boards their numbers, and write the site; returns the numbers of the beacons."""
    made.lines("nodes", "assign", "--renew")
    listed = made.lines("nodes", "boards")
    made.write_site(site, listed)
    return made.numbers(listed)


def parameter(made, node, name):
    (line,) = made.lines("nodes", "get", str(node), name)
    return line["values"]


@pytest.mark.long
def test_what_two_boards_with_one_number_would_both_take_is_refused(bench, tmp_path):
    made, site = bench(4), tmp_path / "room.toml"
    listed = made.lines("nodes", "boards")
    made.write_site(site, listed)
    twins = [line["unique_id"] for line in listed if line["node"] == int(TWICE)]
    assert len(twins) == 2
    for words in (["set", TWICE, "group", "5"], ["name", TWICE, "north", "--id", twins[0]]):
        code, _, told = made.run("nodes", *words)
        assert (code, all(one in told for one in twins), "goldfield nodes assign" in told) == (2, True, True)
    code, _, told = made.run("site", "push", str(site))
    assert (code, "shares its number" in told, "nothing was set" in told) == (3, True, True)
    code, out, _ = made.run("site", "check", str(site))
    assert (code, out.count(f"shares its number {TWICE} with another one")) == (3, 2)
    after = made.lines("nodes", "assign")  # This saves whatever they have been set to.
    for line in after:
        assert parameter(made, line["node"], "name") == [0, 0, 0, 0]
        if line["unique_id"] in twins:
            assert parameter(made, line["node"], "group") == [0]
            assert parameter(made, line["node"], "amplitude") == [0]
    assert made.energised() == set()


@pytest.mark.long
def test_what_cannot_be_saved_is_not_set(bench, tmp_path):
    """Boards that drive their coils do not save without --pause: then they are not to have it until a reset either."""
    made, site = bench(3), tmp_path / "room.toml"
    numbers = numbered(made, site)
    master, other = str(numbers["b1"]), str(numbers["b2"])
    for words in (("set", master, "sync_master", "1"), ("save", master), ("reset", master)):
        made.lines("nodes", *words)
    made.lines("site", "push", str(site), "--start")
    made.rig.advance(3.0)
    louder = tmp_path / "louder.toml"
    louder.write_text(site.read_text().replace("current_A = 10", "current_A = 8"))
    for words in (
        ["nodes", "number", other, "50"],
        ["nodes", "name", other, "north"],
        ["nodes", "clone", master, other],
        ["nodes", "assign", "--renew", "--first", "30"],
        ["site", "push", str(louder)],
    ):
        code, _, told = made.run(*words)
        assert (code, "theirs off with --pause, " in told, "; nothing was changed" in told) == (3, True, True), words
    assert {line["node"] for line in made.lines("nodes", "boards")} == {*numbers.values(), 4}
    assert parameter(made, other, "name") == [0, 0, 0, 0]
    assert made.lines("site", "check", str(site)) == []
    made.lines("nodes", "name", other, "north", "--pause")
    code, _, told = made.run("nodes", "name", master, "north", "--pause")
    assert (code, f"is that of node {other}" in told) == (2, True)


class Cut(RigLink):
    """A link that fails, or on which somebody presses Ctrl-C, when so many messages have gone; None: neither."""

    left: int | None = None
    failure: BaseException = KeyboardInterrupt()
    sent: ClassVar[list[tuple[int, int]]] = []
    """Type and index of what went."""

    def send(self, identifier, data):
        if Cut.left is not None:
            if Cut.left == 0:
                raise Cut.failure
            Cut.left -= 1
        Cut.sent.append((identifier >> 24, identifier >> 12 & 0xFFF))
        super().send(identifier, data)


PARAM_SET, SAVED, RESET = 0x0C, (0x1C, 5), (0x1C, 2)


@pytest.mark.long
@pytest.mark.parametrize("failure", [KeyboardInterrupt(), SystemFailure("the port is gone: plug it in again")])
def test_a_push_that_is_cut_off_anywhere_is_gone_on_with(bench, tmp_path, monkeypatch, failure):
    """In the list, among the values, the saves and the comparison: what is pushed again holds over a reset."""
    monkeypatch.setattr(from_the_box, "RigLink", Cut)
    monkeypatch.setattr(Cut, "failure", failure)
    made, site = bench(3), tmp_path / "room.toml"
    numbers = numbered(made, site)
    text, amps = site.read_text(), 8
    made.lines("site", "push", str(site))
    site.write_text(text.replace("current_A = 10", f"current_A = {amps}"))
    Cut.sent.clear()
    made.lines("site", "push", str(site))
    values = [place for place, (kind, _) in enumerate(Cut.sent) if kind == PARAM_SET]
    saves = [place for place, what in enumerate(Cut.sent) if what == SAVED]
    assert len(values) > len(numbers) < len(saves)
    begun = [*values[1:3], values[-1], *saves]  # Something was set before these.
    for messages in (0, 5, *begun, saves[-1] + 1, len(Cut.sent) - 1):
        amps = 18 - amps
        site.write_text(text.replace("current_A = 10", f"current_A = {amps}"))
        Cut.left = messages
        code, _, told = made.run("site", "push", str(site))
        assert (code, "Traceback" in told) == (130 if isinstance(failure, KeyboardInterrupt) else 3, False)
        assert ("push the site again" in told) == (messages in begun)
        Cut.left = None
        made.lines("site", "push", str(site))
        assert made.lines("site", "check", str(site)) == []
        made.lines("nodes", "reset", str(numbers["b3"]))  # It forgets what was not saved.
        assert made.lines("site", "check", str(site)) == []
    assert made.energised() == set()


@pytest.mark.long
def test_a_push_that_is_cut_off_tells_whom_to_restart(bench, tmp_path, monkeypatch):
    """A degree acts when the board restarts, and is told as it was set before that."""
    monkeypatch.setattr(from_the_box, "RigLink", Cut)
    made, site = bench(3), tmp_path / "room.toml"
    numbers = numbered(made, site)
    made.lines("site", "push", str(site))
    site.write_text(site.read_text().replace("degree = 10", "degree = 9"))
    Cut.sent.clear()
    made.lines("site", "push", str(site))
    reset = Cut.sent.index(RESET)
    site.write_text(site.read_text().replace("degree = 9", "degree = 10"))
    monkeypatch.setattr(Cut, "left", reset)
    code, _, told = made.run("site", "push", str(site))
    monkeypatch.setattr(Cut, "left", None)
    late = listed(sorted([*numbers.values(), 4]))
    assert (code, f"restart those whose degree changes, {late}, each with goldfield nodes reset" in told) == (130, True)
