"""``goldfield flash`` brings images to host boards with slots, over CAN and serial, and tells what becomes of each."""

from __future__ import annotations

import json
from dataclasses import replace

import jsonschema
import numpy as np
import pytest

from goldfield.link.access_key import AccessKey
from goldfield_protocol.rates import CAN_RATES
from hil_sim.clib import ROOT
from tests.firmware.core.boot import slots
from tests.firmware.core.boot.slots import BEACON as BEACON_ROLE
from tests.firmware.core.boot.slots import CODE, IS_CONFIRMED, NEW, OLD, OTHER_KEY, Choice, Node
from tests.firmware.core.storage.flash_cells import Torn
from tests.firmware.host_rig import PIN_ENABLE, SENSOR, Board, Coil, beacon
from tests.host.update.boards_on_a_link import BoardsLink, Seat, run
from tests.host.update.conftest import slot_bytes


@pytest.mark.parametrize("serial", [False, True], ids=["CAN", "serial"])
def test_a_board_takes_an_image_and_confirms_it(bench, update_file, monkeypatch, serial):
    link = bench(serial=serial)
    code, out, told = run(monkeypatch, link, "flash", update_file(), "9")
    (seat,) = link.seats
    assert (code, out) == (0, "node 9 runs sensor 1.0.1 in slot B, confirmed; it had 0.1.0\n"), told
    assert seat.choices == [Choice(0, False), Choice(1, True)]
    assert seat.node.state(1) == IS_CONFIRMED
    assert "sensor 1.0.1 for slot B, 1 board" in told


@pytest.mark.parametrize(
    ("serial", "bit_rate"),
    [(False, 1_000_000), (False, 500_000), (False, 125_000), (True, 2_000_000), (True, 460_800), (True, 115_200)],
)
def test_the_blocks_go_no_faster_than_the_link(bench, update_file, monkeypatch, serial, bit_rate):
    """No more than a burst of blocks and what belongs to a command ever waits for the link, in three pages."""
    monkeypatch.setattr(slots, "WORDS", 4500)
    random = np.random.default_rng(5)
    image = replace(NEW, code=(0x20002000, 0x08020201, *(int(one) for one in random.integers(0, 1 << 32, 4300))))
    link = bench(1 if serial else 2, serial=serial, bit_rate=bit_rate)
    code, out, told = run(monkeypatch, link, "flash", update_file(image), "--all")
    assert (code, out.count("confirmed")) == (0, len(link.seats)), told
    assert link.latest <= 40 * link.frame
    assert link.sent.count("UPDATE_DATA") < 1.1 * len(slot_bytes(image, 0)) // 8


@pytest.mark.parametrize("rate", [1, 3])
def test_boards_on_a_slower_bus_take_an_image_at_once(core, update_file, monkeypatch, rate):
    def make(number, unique):
        board = Board(SENSOR, {"node": number, "can_rate": rate}, unique_id=unique)
        board.operations.can_rate(board.handle, CAN_RATES[rate])
        return board

    seats = []
    for place in range(2):
        node = Node(core, seed=place + 1)
        node.confirmed(OLD, place, 7)
        seats.append(Seat(node, 9 + place, place, make))
    link = BoardsLink(seats, bit_rate=CAN_RATES[rate])
    code, out, told = run(monkeypatch, link, "flash", update_file(), "--all")
    assert code == 0, told
    assert out.count("confirmed") == 2
    assert [seat.choices for seat in seats] == [[Choice(slot, False), Choice(1 - slot, True)] for slot in (0, 1)]
    for seat in seats:
        seat.close()


def test_many_boards_in_both_slots_take_it_at_once_whatever_each_loses(bench, update_file, monkeypatch):
    """Each of six boards loses other blocks; those of an image are on the bus little more than once."""
    count = 6
    running = [place % 2 for place in range(count)]
    heard = set()

    def hears(name, index, place):
        first = (index, place) not in heard
        heard.add((index, place))
        return name != "UPDATE_DATA" or not (first and (index * 7 + place * 5) % 11 == 0)

    link = bench(count, running, hears=hears)
    code, out, told = run(monkeypatch, link, "flash", update_file(), "--all")
    assert code == 0, told
    assert out.count("confirmed") == count
    assert out.endswith("6 of 6 boards updated\n")
    for seat, slot in zip(link.seats, running, strict=True):
        assert seat.choices == [Choice(slot, False), Choice(1 - slot, True)]
    blocks = len(slot_bytes(NEW, 0)) // 8 - 8
    assert link.sent.count("UPDATE_DATA") < 4 * blocks  # Two images; One board after the other would be 6 and more.
    code, out, _ = run(monkeypatch, link, "flash", update_file(), "--all", "--json")
    lines = [json.loads(line) for line in out.splitlines()]
    schema = json.loads((ROOT / "docs/schema/update.schema.json").read_text())
    for line in lines:
        jsonschema.validate(line, schema)
    assert (code, len(lines), {line["updated"] for line in lines}) == (0, count, {True})


@pytest.mark.parametrize("deaf", [False, True])
def test_boards_that_miss_a_page_and_many_blocks(bench, update_file, monkeypatch, deaf):
    """Three pages. Board 0 misses each page's number once, or for good; a tenth of the blocks is lost everywhere."""
    monkeypatch.setattr(slots, "WORDS", 4500)
    random = np.random.default_rng(5)
    image = replace(NEW, code=(0x20002000, 0x08020201, *(int(one) for one in random.integers(0, 1 << 32, 4300))))
    told = []

    def hears(name, index, place):
        if name == "COMMAND" and index == 12 and place == 0:
            told.append(index)
            return not (len(told) > 2 if deaf else len(told) % 2)
        return name != "UPDATE_DATA" or random.random() > 0.1

    link = bench(3, hears=hears)
    code, out, said = run(monkeypatch, link, "flash", update_file(image), "--all")
    victim, *others = link.seats
    assert out.count("confirmed") == (2 if deaf else 3), said
    assert [seat.choices[-1] for seat in others] == 2 * [Choice(1, True)]
    blocks = len(slot_bytes(image, 0)) // 8
    print(f"{link.sent.count('UPDATE_DATA')} blocks sent of {blocks}, for three boards that lose a tenth each")
    assert link.sent.count("UPDATE_DATA") < 4 * blocks
    if deaf:
        assert (code, "node 9 does not answer any more, and keeps the image that it had" in said) == (3, True)
        link.advance(11.0)
        assert {choice.slot for choice in victim.choices} == {0}


def flipped(offset):
    def change(data):
        data[offset] ^= 4
        data[len(data) // 2 + offset] ^= 4

    return change


@pytest.mark.parametrize(
    ("image", "options", "code", "words"),
    [
        (NEW, {"change": flipped(4 * CODE + 5)}, 2, "its CRC is wrong: bits of it have changed"),
        (NEW, {"change": flipped(64 + 5)}, 3, "node 9 refuses the signature, and keeps the image"),
        (NEW, {"key": OTHER_KEY}, 3, "node 9 refuses the signature, and keeps the image"),
        (replace(NEW, board=2), {}, 3, "node 9 is another kind of board than the image is for"),
        (replace(NEW, role=0), {}, 2, "holds images of beacon, and node 9 is a sensor"),
        (replace(NEW, version=OLD.version - 1), {}, 3, "node 9 runs a newer version than the image has"),
        (replace(NEW, magic=1), {}, 2, "holds no image for a board: it has no image's header"),
    ],
    ids=["a bit", "a bit of the signature", "signer", "board", "role", "older", "no image"],
)
def test_each_wrong_image_is_refused_with_its_own_sentence(
    bench, update_file, monkeypatch, image, options, code, words
):
    link = bench()
    (seat,) = link.seats
    got, out, told = run(monkeypatch, link, "flash", update_file(image, **options), "9")
    assert (got, out) == (code, "")
    assert words in told
    link.advance(11.0)
    assert {choice.slot for choice in seat.choices} == {0}
    assert seat.node.state(0) == IS_CONFIRMED


def test_a_version_that_is_older_than_the_heartbeat_tells_is_refused_before_anything_is_erased(
    bench, update_file, monkeypatch
):
    link = bench()
    (seat,) = link.seats
    older = update_file(replace(NEW, version=0x000009))
    code, _, told = run(monkeypatch, link, "flash", older, "9")
    assert (code, seat.node.steps) == (3, 0)
    assert "node 9 runs a newer version than the image has" in told
    code, out, _ = run(monkeypatch, link, "flash", older, "9", "--force")
    assert (code, seat.choices[-1]) == (0, Choice(1, True))
    assert "runs sensor 0.0.9 in slot B" in out


def test_a_board_without_a_key_is_told_what_to_do(bench, update_file, monkeypatch):
    link = bench(prepare=lambda node: node.forget_key())
    code, out, told = run(monkeypatch, link, "flash", update_file(), "--role", "sensor")
    assert (code, out) == (3, "")
    assert "node 9 has no key by which it could judge an image: program it once with a probe, make flash KEY=" in told
    assert link.seats[0].node.steps == 0


@pytest.fixture
def locked(core, monkeypatch):
    """Make a link to sensors with a key, and run ``goldfield flash`` on it."""
    made = []

    def keyed(number, unique):
        return Board(SENSOR, {"node": number, "access_key": AccessKey(KEY, "").words}, unique_id=unique)

    def make(count, *words):
        for place in range(count):
            node = Node(core, seed=place + 1)
            node.confirmed(OLD, place % 2, 7)
            made.append(Seat(node, 9 + place, place, keyed))
        return BoardsLink(made), run(monkeypatch, BoardsLink(made), "flash", *words)

    yield make
    for seat in made:
        seat.close()


KEY = bytes(range(1, 17))


def key_file(tmp_path, key):
    path = tmp_path / "site.key"
    path.touch(mode=0o600)
    path.write_text(key.hex() + "\n")
    return str(path)


def test_locked_boards_are_updated_by_who_has_their_key(locked, update_file, tmp_path):
    link, (code, out, told) = locked(3, update_file(), "--all", "--key", key_file(tmp_path, KEY))
    assert code == 0, told
    assert out.splitlines()[-1] == "3 of 3 boards updated"
    assert [seat.node.state(1 - seat.place % 2) for seat in link.seats] == [IS_CONFIRMED] * 3


@pytest.mark.parametrize(
    ("key", "sentence"), [(None, "node 9 is locked"), (bytes(15) + b"\1", "node 9 has another key than")]
)
def test_a_locked_board_keeps_its_image_from_who_has_no_key(locked, update_file, tmp_path, key, sentence):
    words = [] if key is None else ["--key", key_file(tmp_path, key)]
    link, (code, out, told) = locked(1, update_file(), "9", *words)
    assert code == 3
    assert out == ""
    assert sentence in told, told
    assert link.seats[0].choices == [Choice(0, False)]


def test_a_board_on_trial_gets_the_time_to_confirm_its_image(bench, update_file, monkeypatch):
    link = bench(prepare=lambda node: node.update(NEW, 0))
    assert link.seats[0].choices == [Choice(1, True)]
    code, out, _ = run(monkeypatch, link, "flash", update_file(), "9")
    assert (code, out) == (0, "node 9 runs sensor 1.0.1 in slot A, confirmed; it had 0.1.0\n")
    assert link.seats[0].choices == [Choice(1, True), Choice(0, True)]


def test_a_board_of_another_protocol_is_updated(bench, update_file, monkeypatch):
    link = bench()
    link.foreign = True
    code, out, told = run(monkeypatch, link, "flash", update_file(), "9")
    assert (code, out) == (0, "node 9 runs sensor 1.0.1 in slot B, confirmed; it had 0.1.0\n"), told


def test_a_coil_that_is_driven_is_switched_off_only_if_it_may_be(core, update_file, monkeypatch):
    old, new = (replace(image, role=BEACON_ROLE) for image in (OLD, NEW))
    node = Node(core)
    node.confirmed(old, 0, 7)
    parameters = {"sync_master": 1, "amplitude": 5.0}
    seat = Seat(node, 9, 0, lambda n, unique: beacon(Coil(), parameters={"node": n, **parameters}, unique_id=unique))
    link = BoardsLink([seat])
    link.advance(1.5)
    code, out, told = run(monkeypatch, link, "flash", update_file(new), "9")
    assert (code, out, node.steps) == (3, "", 0)
    assert "node 9 drives its coil, which is off during an update: let boards switch theirs off with --pause" in told
    driven = seat.life.board
    assert driven.level[PIN_ENABLE] is True
    enabled = seat.life.enabled
    code, out, told = run(monkeypatch, link, "flash", update_file(new), "9", "--pause")
    assert code == 0, told
    assert len(enabled) > 30
    assert not any(enabled)
    link.advance(1.5)
    assert seat.life.board.level[PIN_ENABLE] is True
    seat.close()


def test_a_lost_link_within_the_blocks_leaves_the_image_that_ran(bench, update_file, monkeypatch):
    """Ctrl-C after any number of blocks: the board comes back to its image, and an update asked for again succeeds."""
    link = bench(2)
    link.interrupt_at = 30
    code, out, told = run(monkeypatch, link, "flash", update_file(), "--all")
    assert (code, out) == (130, "")
    assert "broken off: each board restarts within 15 s into the image that it had" in told
    link.advance(11.0)
    assert [seat.choices for seat in link.seats] == 2 * [[Choice(0, False), Choice(0, False)]]
    link.interrupt_at = 2 * 30
    assert run(monkeypatch, link, "flash", update_file(), "--all")[0] == 130
    assert run(monkeypatch, link, "flash", update_file(), "--all")[0] == 0  # At once: it begins anew.
    assert all(seat.choices[-1] == Choice(1, True) for seat in link.seats)


@pytest.mark.parametrize("step", [1, 20, -1])
def test_a_loss_of_power_of_one_of_two_boards_is_told_and_the_other_is_updated(bench, update_file, monkeypatch, step):
    whole = bench()
    run(monkeypatch, whole, "flash", update_file(), "9")
    link = bench(2)
    victim, other = link.seats
    victim.node.cut, victim.node.torn = step % whole.seats[0].node.steps, Torn.MIXED
    code, out, told = run(monkeypatch, link, "flash", update_file(), "--all")
    assert other.choices[-1] == Choice(1, True)
    assert "node 10 runs sensor 1.0.1 in slot B, confirmed" in out
    assert (code, "not updated: 1 node, 9" in told) in [(3, True), (0, False)]
    link.advance(11.0)
    code, out, told = run(monkeypatch, link, "flash", update_file(), "9")
    assert (code, victim.node.state(victim.choices[-1].slot)) == (0, IS_CONFIRMED), told


def test_a_new_image_that_fails_is_told(bench, update_file, monkeypatch):
    """It hangs: nothing is heard of it, and the next start brings the image before back."""
    link = bench()
    (seat,) = link.seats
    seat.hangs_in = 1
    code, out, told = run(monkeypatch, link, "flash", update_file(), "9")
    assert (code, out) == (3, "")
    assert "node 9 went back to the image that it had, as the new one did not confirm itself" in told
    assert seat.choices == [Choice(0, False), Choice(1, True), Choice(0, False)]


@pytest.mark.parametrize(
    ("words", "code", "sentence"),
    [
        ([], 2, "flash takes numbers of nodes, --role ROLE or --all"),
        (["9", "--all"], 2, "flash takes numbers of nodes, --role ROLE or --all"),
        (["12"], 3, "node 12 does not answer"),
        (["--role", "beacon"], 3, "no beacon is on the link"),
    ],
)
def test_who_is_not_there_is_told(bench, update_file, monkeypatch, words, code, sentence):
    link = bench()
    got, out, told = run(monkeypatch, link, "flash", update_file(), *words)
    assert (got, out) == (code, "")
    assert sentence in told
    assert link.seats[0].node.steps == 0
