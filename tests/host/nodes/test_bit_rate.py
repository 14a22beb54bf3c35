"""All boards of a bus at another bit rate, or none: they save, restart, refuse and fall silent, in virtual time."""

from __future__ import annotations

import heapq
import itertools
import json

import can
import pytest

from goldfield.errors import UserError
from goldfield.link.access import board_of
from goldfield.link.line import RATES, Line, Link
from goldfield.nodes.conversation import COIL_ON, DONE, DONE_RESTARTS, FLASH_FAILED, IDENTITY, RESET, SAVE
from goldfield_protocol import decode, encode
from goldfield_protocol.parameters import PARAMETERS, Kind
from tests.host.fake_sensor import heartbeat
from tests.host.update.boards_on_a_link import MS, SECOND, BusSource, run

RATE_ID = {Link.CAN: PARAMETERS["can_rate"].first, Link.SERIAL: PARAMETERS["serial_rate"].first}
OLD, NEW = 1_000_000, 250_000
NEVER = ()


class Board:
    """What a board says of its rate; ``fails`` tells by the attempt which saves it refuses, and how."""

    def __init__(self, number, *, erases=False, saves=NEVER, deaf_to=NEVER, lost_at_reset=False, has_rate=True):
        self.number, self.unique_id = number, f"{number:024x}"
        self.erases, self.deaf_to, self.lost_at_reset, self.has_rate = erases, deaf_to, lost_at_reset, has_rate
        self.refusals = list(saves)
        self.value = self.saved = 0
        self.index, self.starts, self.lost = 0, 0, False

    def restart(self):
        self.value = self.index = self.saved
        self.starts += 1
        self.lost = self.lost_at_reset


class Bus(BusSource):
    """Takes the place of a `BusSource` and of the module `time`: boards are heard at their own rate only."""

    traffic = {}  # noqa: RUF012 - nothing is counted
    line = None

    def __init__(self, *boards, link=Link.CAN, fixed=False):
        self.name, self.shared = "bus", link is Link.CAN
        self.boards, self.fixed = boards, fixed
        self.line = Line(link, RATES[link][0])
        self.now, self._order = 0, itertools.count()
        self._due = []
        for place, board in enumerate(boards):
            self._at(place * MS, self._beat, board, 0)

    def monotonic(self):
        return self.now / SECOND

    def set_bit_rate(self, bit_rate):
        if self.fixed:
            raise UserError("the kernel runs can0: sudo ip link set can0 down")
        self.line = Line(self.line.link, bit_rate)

    def receive(self, timeout_s):
        until = self.now + max(1, round(timeout_s * SECOND))
        while self._due and self._due[0][0] <= until:
            self.now, _, act, arguments = heapq.heappop(self._due)
            message = act(*arguments)
            if message is not None:
                return can.Message(timestamp=self.monotonic(), arbitration_id=message[0], data=message[1])
        self.now = until
        return None

    def send(self, identifier, data):
        message = decode(identifier, data)
        for board in self.boards:
            if message.node in (0, board.number) and self._hears(board) and message.name not in board.deaf_to:
                self._take(board, message)

    def close(self):
        pass

    def _at(self, after, act, *arguments):
        heapq.heappush(self._due, (self.now + after, next(self._order), act, arguments))

    def _hears(self, board):
        return not board.lost and RATES[self.line.link][board.index] == self.line.bit_rate

    def _tell(self, board, message):
        return message if self._hears(board) else None

    def _beat(self, board, start):
        self._at(SECOND, self._beat, board, 3)
        return self._tell(board, heartbeat(board.number, state=start))

    def _restart(self, board):
        board.restart()
        return self._beat(board, 0) if not board.lost else None

    def _take(self, board, message):
        if message.name in ("PARAM_GET", "PARAM_SET"):
            rate = message.index == RATE_ID[self.line.link]
            if rate and message.name == "PARAM_SET":
                board.value = int(message.signals["value_unsigned"])
            value = board.value if rate else 0
            signals = {"status": 0 if board.has_rate or not rate else 1, "kind": Kind.UNSIGNED, "value_unsigned": value}
            answer = encode("PARAM_VALUE", signals, node=board.number, index=message.index)
            self._at(MS, self._tell, board, answer)
        elif message.index == IDENTITY:
            whole = bytes.fromhex(board.unique_id)
            for index, half in enumerate((whole[:6], whole[6:])):
                signals = {"tag": whole[-1], "half": int.from_bytes(half, "little")}
                self._at(MS, self._tell, board, encode("IDENTITY", signals, node=board.number, index=index))
        elif message.name == "COMMAND" and int(message.signals["board"]) == board_of(board.unique_id):
            self._command(board, message.index)

    def _command(self, board, command):
        status, after = DONE, MS
        if command == SAVE:
            refusal = board.refusals.pop(0) if board.refusals else DONE
            if refusal is None:
                return
            changes = refusal == DONE and board.saved != board.value
            restarts = changes and board.erases
            status, after = (DONE_RESTARTS, 250 * MS) if restarts else (refusal, MS)
            board.saved = board.value if refusal == DONE else board.saved
        answer = encode("COMMAND_ANSWER", {"status": status, "value": 0}, node=board.number, index=command)
        self._at(after, self._tell, board, answer)
        if command == RESET or status == DONE_RESTARTS:
            self._at(after + 50 * MS, self._restart, board)


def changed(monkeypatch, bus, *words):
    """What the command says, of boards that run on behind it."""
    said = run(monkeypatch, bus, "nodes", "bit-rate", *words)
    until = bus.now + SECOND
    while bus.now < until:
        bus.receive(0.1)
    return said


@pytest.mark.parametrize("new", RATES[Link.CAN][1:])
@pytest.mark.parametrize("erasing", [(), (2,), (1, 2, 3, 4)])
def test_all_boards_go_to_the_new_rate(monkeypatch, new, erasing):
    bus = Bus(*(Board(number, erases=number in erasing) for number in (4, 1, 3, 2)))
    code, out, told = changed(monkeypatch, bus, str(new))
    assert (code, out, told) == (0, f"4 boards heard at {new} bit/s: 1, 2, 3 and 4\n", "")
    for board in bus.boards:
        assert (RATES[Link.CAN][board.index], board.saved, board.starts) == (new, board.index, 1)


def test_a_hundred_boards_of_which_some_erase(monkeypatch):
    bus = Bus(*(Board(number, erases=number % 4 == 0) for number in range(1, 101)))
    assert changed(monkeypatch, bus, str(NEW))[0] == 0
    assert {(board.index, board.starts) for board in bus.boards} == {(2, 1)}


def test_the_one_board_of_a_serial_line(monkeypatch):
    bus = Bus(Board(7), link=Link.SERIAL)
    code, out, _ = changed(monkeypatch, bus, "115200", "--json")
    assert code == 0
    assert json.loads(out) == {"bit_rate": 115_200, "before": 2_000_000, "nodes": [7], "heard": [7]}


def test_the_rate_that_there_is(monkeypatch):
    bus = Bus(Board(1), Board(2))
    assert changed(monkeypatch, bus, str(OLD))[:2] == (0, "2 boards heard at 1000000 bit/s: 1 and 2\n")
    assert [board.starts for board in bus.boards] == [0, 0]


BAD = {
    "refuses the coil": ({"saves": [COIL_ON]}, "drives its coil"),
    "worn": ({"saves": [FLASH_FAILED]}, "could not write its flash"),
    "silent at the save": ({"saves": [None] * 3}, "does not answer"),
    "silent at the set": ({"deaf_to": ("PARAM_SET",)}, "did not answer when can_rate was to be set"),
    "silent at the read": ({"deaf_to": ("PARAM_GET",)}, "does not answer"),
    "old firmware": ({"has_rate": False}, "has no other rate: flash it"),
}


@pytest.mark.parametrize("erasing", [(), (1,), (1, 3, 4)])
@pytest.mark.parametrize(("how", "said"), BAD.values(), ids=BAD)
def test_one_board_that_does_not_go_keeps_all(monkeypatch, how, said, erasing):
    """Boards that have restarted at the new rate by then are fetched back from there."""
    others = [Board(number, erases=number in erasing) for number in (1, 3, 4)]
    bus = Bus(*others, Board(2, **how))
    code, out, told = changed(monkeypatch, bus, str(NEW))
    assert (code, out) == (3, "")
    assert "node 2 " in told
    assert said in told
    assert told.endswith("; nothing was changed\n")
    for board in bus.boards:
        assert (board.index, board.value, board.saved) == (0, 0, 0)
    assert bus.line.bit_rate == OLD


def test_a_board_that_is_gone_amid_the_save_is_said_to_be_uncertain(monkeypatch):
    bus = Bus(Board(1), Board(2, saves=[None] * 9))
    code, _, told = changed(monkeypatch, bus, str(NEW))
    assert code == 3
    assert "1 node, 2, may speak at 250000 bit/s after the next reset: look for them there, and set all back" in told
    assert (bus.boards[0].saved, bus.boards[0].value) == (0, 0)


def test_a_board_that_does_not_take_its_old_rate_back_is_said_to_be_uncertain(monkeypatch):
    """It is not asked to save again, which would only keep the new one."""
    bus = Bus(Board(1), Board(2, saves=[FLASH_FAILED]))
    take = bus._take

    def deaf(board, message):
        if not (board.number == 1 and board.saved and message.name == "PARAM_SET"):
            take(board, message)

    monkeypatch.setattr(bus, "_take", deaf)
    code, _, told = changed(monkeypatch, bus, str(NEW))
    assert code == 3
    assert "1 node, 1, may speak at 250000 bit/s after the next reset" in told
    assert [board.value for board in bus.boards] == [2, 0]


def test_boards_that_restarted_behind_an_interface_that_is_the_kernels_are_named(monkeypatch):
    bus = Bus(Board(1, erases=True), Board(2, saves=[FLASH_FAILED]), fixed=True)
    code, _, told = changed(monkeypatch, bus, str(NEW))
    assert code == 3
    assert "1 node, 1, may speak at 250000 bit/s" in told
    assert [board.index for board in bus.boards] == [2, 0]


def interrupt(monkeypatch, bus, command, *counts):
    """Let those of the requests that give a command, counted from 1, be interrupted."""
    send, given = bus.send, itertools.count(1)

    def interrupted(identifier, data):
        message = decode(identifier, data)
        if (message.name, message.index) == ("COMMAND", command) and next(given) in counts:
            raise KeyboardInterrupt
        send(identifier, data)

    monkeypatch.setattr(bus, "send", interrupted)


def test_an_interrupt_changes_nothing(monkeypatch):
    bus = Bus(Board(1), Board(2))
    interrupt(monkeypatch, bus, SAVE, 2)
    code, _, told = changed(monkeypatch, bus, str(NEW))
    assert code == 130
    assert "broken off; nothing was changed" in told
    assert {(board.value, board.saved, board.starts) for board in bus.boards} == {(0, 0, 0)}


def test_a_second_interrupt_tells_who_may_be_at_another_rate(monkeypatch):
    bus = Bus(Board(1), Board(2))
    interrupt(monkeypatch, bus, SAVE, 2, 3)
    code, _, told = changed(monkeypatch, bus, str(NEW))
    assert code == 130
    assert "broken off; 2 nodes, 1 and 2, may speak at 250000 bit/s after the next reset" in told
    assert [board.saved for board in bus.boards] == [2, 0]


def test_an_interrupt_amid_the_reset_says_that_all_have_saved(monkeypatch):
    bus = Bus(Board(1), Board(2))
    interrupt(monkeypatch, bus, RESET, 2)
    code, _, told = changed(monkeypatch, bus, str(NEW))
    assert code == 130
    assert "broken off; all boards have saved 250000 bit/s: power them off and on" in told
    assert [board.saved for board in bus.boards] == [2, 2]
    assert [board.starts for board in bus.boards] == [1, 0]


def test_a_kernels_interface_is_the_users_to_set(monkeypatch):
    bus = Bus(Board(1), Board(2), fixed=True)
    code, out, told = changed(monkeypatch, bus, str(NEW), "--json")
    assert code == 0
    assert json.loads(out) == {"bit_rate": NEW, "before": OLD, "nodes": [1, 2], "heard": None}
    assert (
        "2 boards were reset, and speak at 250000 bit/s now; the kernel runs can0: sudo ip link set can0 down" in told
    )
    assert [board.index for board in bus.boards] == [2, 2]


def test_a_board_that_does_not_come_back_is_named(monkeypatch):
    bus = Bus(Board(1), Board(2, lost_at_reset=True), Board(3))
    code, out, told = changed(monkeypatch, bus, str(NEW))
    assert (code, out) == (3, "2 boards heard at 250000 bit/s: 1 and 3\n")
    assert "1 node, 2, not heard since the reset: all boards have saved 250000 bit/s: power them off and on" in told


def test_two_boards_of_one_number_are_no_place_to_begin(monkeypatch):
    other = Board(1)
    other.unique_id = f"{9:024x}"
    bus = Bus(Board(1), other)
    code, _, told = changed(monkeypatch, bus, str(NEW))
    assert code == 2
    assert "node 1 is two boards" in told
    assert {board.value for board in bus.boards} == {0}


@pytest.mark.parametrize("rate", RATES[Link.CAN])
def test_a_virtual_link_cannot_follow_its_boards(monkeypatch, rate):
    """A simulated bench keeps the rates of its scenario: all its boards were lost, and said to need their power."""
    bus = Bus(Board(1), Board(2))
    bus.virtual = True
    code, out, told = changed(monkeypatch, bus, str(rate))
    assert (code, out) == (2, "")
    assert "begin the bench anew with others in its [links]; nothing was changed" in told
    assert {(board.value, board.saved, board.starts) for board in bus.boards} == {(0, 0, 0)}


@pytest.mark.parametrize("rate", ["0", "-1", "1e9", "123456", "115200"])
def test_a_rate_that_no_board_has(monkeypatch, rate):
    bus = Bus(Board(1))
    code, out, told = run(monkeypatch, bus, "nodes", "bit-rate", rate)
    assert (code, out) == (2, "")
    assert told.endswith("boards speak on CAN at 1000000, 500000, 250000 or 125000 bit/s\n")
    assert bus.boards[0].value == 0
