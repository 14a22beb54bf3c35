"""Boards whose link, parameters and saved sets are struck: what is taken, what is kept, and what is told of it.

The truth is the table of parameters in the board's own RAM, and what the next start makes of its flash.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from goldfield_protocol import encode, encode_frame
from goldfield_protocol.parameters import PARAMETERS
from hil_sim.emulator.emulator import Emulator
from tests.firmware.host_rig import BEACON, MS, US, Board
from tests.firmware.services.access_host import KEY, START, words
from tests.firmware.services.saved_flash import DONE, DONE_RESTARTS, NAMED, answers, ask_to_save, put, save
from tests.image_faults.image import place_of
from tests.image_faults.workload import BEACON_IMAGE, NOTHING, SAID, WRONG, Seen, Verdict, told

NODE, OTHER_NODE, UNKNOWN_ID, RESET = 9, 5, 0xFFE, 2
OLD: dict[str, float] = {"code": 17, "over_current": 3.5, "survey__191": 0.25}
NEW: dict[str, float] = {"code": 23, "over_current": 4.5, "survey__191": 0.75}
Bytes = list[bytes]


def set_frame(name: str, value: float, node: int = NODE, kind: int | None = None, index: int | None = None) -> bytes:
    """Return the bytes of a PARAM_SET."""
    parameter = PARAMETERS[name]
    kind = parameter.kind if kind is None else kind
    signals = {"kind": kind, f"value_{('unsigned', 'signed', 'float')[kind]}": value}
    identifier = parameter.identifier(0) if index is None else index
    return encode_frame(*encode("PARAM_SET", signals, node=node, index=identifier))


def damaged(frame: bytes) -> bytes:
    """Return a frame one of whose bits has changed, and no zero has come."""
    place = next(i for i in range(6, len(frame)) if frame[i] not in (0, 1, 0x40))
    return frame[:place] + bytes([frame[place] ^ 0x40]) + frame[place + 1 :]


def command(index: int, board: int, argument: int = 0, node: int = NODE) -> bytes:
    """Return the bytes of a COMMAND."""
    return encode_frame(*encode("COMMAND", {"board": board, "argument": argument}, node=node, index=index))


def requests() -> Bytes:
    """Return what is sent to an open board: two changes that it takes, and much that it must not."""
    get = encode("PARAM_GET", {"reserved": 0}, node=NODE, index=PARAMETERS["over_current"].identifier(0))
    return [
        set_frame("over_current", 3.5),
        set_frame("code", 23),
        set_frame("over_current", 1e9),
        set_frame("amplitude", -1.0),
        set_frame("rms_current", 5, kind=0),
        set_frame("coil_hot", 99.0, node=OTHER_NODE),
        damaged(set_frame("supply_high", 77.0)),
        bytes([9, 1, 1, 1, 0]),
        bytes(40 * [0x11] + [0]),
        set_frame("open_coil", 0.5, index=UNKNOWN_ID),
        encode_frame(*get),
        command(RESET, NAMED + 1),
    ]


def requests_of_strangers() -> Bytes:
    """Return what is sent to a board with a key by somebody who has none: it takes nothing."""
    return [
        set_frame("over_current", 3.5),
        set_frame("code", 23),
        set_frame("access_key", 0),
        command(START, NAMED, 0),
        command(9, NAMED, 12),
        command(RESET, NAMED),
        set_frame("amplitude", 5.0),
    ]


def parameters_of(chip: Emulator) -> list[int]:
    """Return the bits of all parameters as they are in force."""
    place = place_of(BEACON_IMAGE, "beacon.node.parameters.bits")
    return list(struct.unpack(f"<{len(place) // 4}I", chip.memory(place.start, len(place))))


def intact(chip: Emulator) -> bool:
    """Whether the parameters' seal is that of their values, by the text of parameters.h and parameters.c."""
    seal = place_of(BEACON_IMAGE, "beacon.node.parameters.seal")
    values = parameters_of(chip)
    together = len(values)
    for place, value in enumerate(values):
        wide = value << place % 32
        together ^= wide & 0xFFFFFFFF | wide >> 32
    return together == int.from_bytes(chip.memory(seal.start, 4), "little")


def counters_of(chip: Emulator) -> list[int]:
    """Return the board's counters, which it tells each second."""
    place = place_of(BEACON_IMAGE, "beacon.node.counters")
    return list(struct.unpack(f"<{len(place) // 4}I", chip.memory(place.start, len(place))))


def known(chip: Emulator) -> None:
    """Look up where these lie, once and not in each trial."""
    intact(chip)
    counters_of(chip)


def quiet(page: dict[str, Any] | None = None, cells: bytes | None = None) -> Board:
    """Return a beacon without a current."""
    return Board(
        BEACON,
        {"node": NODE, **(page or {})},
        emulated=True,
        strict=False,
        stop_at_fault=False,
        cells=cells,
    )


def _again(seen: Seen, sound: Seen) -> Verdict | None:
    """Return the verdict if the board has fallen, which tells it all."""
    if not seen["running"]:
        return Verdict(SAID, "the processor locks up")
    if seen["resets"] > sound["resets"] or seen["crashed"]:
        return Verdict(SAID, "crash" if seen["crashed"] else "reset")
    return None


@dataclass
class Linked:
    """A board that gets frames, an upset in one of which strikes."""

    name: str
    frames: Callable[[], Bytes]
    page: dict[str, Any] = field(default_factory=dict)
    begin: int = 60 * MS
    image: Path = BEACON_IMAGE
    modules: tuple[str, ...] = ("parser",)

    def start(self) -> Board:
        """Return a board to which all frames are under way, a millisecond each."""
        board = quiet(self.page)
        known(board.emulator)
        for number, frame in enumerate(self.frames()):
            board.receive(frame, self.begin + 100 * US + number * MS)
        board.run(self.begin)
        assert intact(board.emulator), "the seal is another than that of parameters.c"
        self.before = parameters_of(board.emulator)
        return board

    def chip(self, bench: Board) -> Emulator:
        """Return the board's chip."""
        return bench.emulator

    def observe(self, bench: Board) -> Seen:
        """Let all frames be served."""
        end = self.begin + (len(self.frames()) + 8) * MS
        running = bench.emulator.run(end)
        changed = self._changed(bench)
        if not intact(bench.emulator):  # The next heartbeat looks at it.
            running = bench.emulator.run(end + 1200 * MS)
            changed = self._changed(bench)
        return {**told(bench, self.begin).as_seen(), "running": running, "changed": changed}

    def _changed(self, bench: Board) -> dict[str, int]:
        after = parameters_of(bench.emulator)
        return {str(i): new for i, (old, new) in enumerate(zip(self.before, after, strict=True)) if old != new}

    def judge(self, seen: Seen, sound: Seen) -> Verdict:
        """Judge by the parameters that are in force, then by what was answered."""
        told_otherwise = {value[0] for value in seen["values"] if value not in sound["values"] and value[1] == 0}
        for place, new in seen["changed"].items():
            if place in sound["changed"] and new != sound["changed"][place] and told_otherwise:
                return Verdict(SAID, f"the answer tells that parameter at {place} has become {new:#x}")
            if new != sound["changed"].get(place):
                return Verdict(WRONG, f"parameter at {place} has become {new:#x}")
        fallen = _again(seen, sound)
        if fallen is not None:
            return fallen
        if seen["values"] == sound["values"] and seen["changed"] != sound["changed"]:
            return Verdict(WRONG, "an answer tells of a change that is none")
        if (seen["values"], seen["answers"]) != (sound["values"], sound["answers"]):
            return Verdict(SAID, "answered otherwise, or not at all")
        return Verdict(NOTHING)


# ---- What is kept ----


@cache
def kept() -> bytes:
    """Return the flash of a board that has saved the old set, and not yet restarted from it."""
    board = quiet()
    assert save(board, 50 * MS, **OLD) in (DONE, DONE_RESTARTS)
    cells = board.emulator.cells()
    board.close()
    return cells


@cache
def started(cells: bytes | None) -> list[int]:
    """Return the parameters with which a board starts from its flash."""
    board = quiet(cells=cells)
    assert board.emulator.run(60 * MS)
    found = parameters_of(board.emulator)
    board.close()
    return found


@dataclass
class Saved:
    """A board that saves a set, behind others or into flash that it has to erase, and starts from it."""

    name: str
    appended: bool
    begin: int = 106 * MS
    image: Path = BEACON_IMAGE
    modules: tuple[str, ...] = ("parser", "storage")

    def start(self) -> Board:
        """Return a board that has the new set in force and is about to save it."""
        self.old = started(kept() if self.appended else None)
        board = quiet(cells=kept() if self.appended else None)
        board.run(100 * MS)
        known(board.emulator)
        put(board, 100 * MS, **NEW)
        ask_to_save(board, self.begin + 100 * US)
        return board

    def chip(self, bench: Board) -> Emulator:
        """Return the board's chip."""
        return bench.emulator

    def observe(self, bench: Board) -> Seen:
        """Let the board save, take its power, and start another one from its flash."""
        wanted = parameters_of(bench.emulator)
        running, end = True, self.begin
        while running and not answers_of(bench) and end < self.begin + 900 * MS:
            end += 20 * MS
            running = bench.emulator.run(end)
        said = told(bench, self.begin)
        again = quiet(cells=bench.emulator.cells())
        runs_again = again.emulator.run(60 * MS)
        found = parameters_of(again.emulator)
        return {
            **said.as_seen(),
            "running": running and runs_again,
            "old": found == self.old,
            "new": found == wanted,
            "counted": sum(counters_of(again.emulator)),
            "end_ps": end,
        }

    def judge(self, seen: Seen, sound: Seen) -> Verdict:
        """Judge by the set from which the next start is made, then by what was answered."""
        if not seen["old"] and not seen["new"]:
            return Verdict(SAID if seen["counted"] > 0 else WRONG, "the next start has neither the old nor the new set")
        fallen = _again(seen, sound)
        if fallen is not None:
            return fallen
        if not seen["new"] and seen["answers"] == sound["answers"]:
            return Verdict(WRONG, "the answer tells of a set that is not there")
        return Verdict(NOTHING if seen["answers"] == sound["answers"] else SAID, str(seen["answers"]))


def answers_of(board: Board) -> list[int]:
    """Return what became of the save so far; a board that talks nonsense has answered nothing."""
    try:
        return answers(board)
    except AssertionError:
        return []


@dataclass
class Started:
    """A board that starts from a saved set."""

    name: str = "load"
    begin: int = 0
    image: Path = BEACON_IMAGE
    modules: tuple[str, ...] = ("parser", "storage")

    def start(self) -> Board:
        """Return the board as it gets its power."""
        started(kept())
        board = quiet(cells=kept())
        known(board.emulator)
        return board

    def chip(self, bench: Board) -> Emulator:
        """Return the board's chip."""
        return bench.emulator

    def observe(self, bench: Board) -> Seen:
        """Run until it has long started, or until the watchdog has struck one that has said nothing."""
        running = bench.emulator.run(60 * MS)
        if running and not told(bench).messages:
            running = bench.emulator.run(1600 * MS)
        found = parameters_of(bench.emulator)
        differ = [i for i, (a, b) in enumerate(zip(found, started(kept()), strict=True)) if a != b]
        return {
            **told(bench).as_seen(),
            "running": running,
            "differ": differ[:8],
            "counted": sum(counters_of(bench.emulator)),
        }

    def judge(self, seen: Seen, sound: Seen) -> Verdict:
        """Judge by the parameters that are in force."""
        fallen = _again(seen, sound)
        if fallen is not None:
            return fallen
        if seen["messages"] == 0:
            return Verdict(SAID, "silence: it does not start")
        if seen["differ"]:
            return Verdict(SAID if seen["counted"] > 0 else WRONG, f"parameters at {seen['differ']} are others")
        return Verdict(NOTHING)


def linked() -> list[Linked | Saved | Started]:
    """Return the workloads of the link and of the flash."""
    return [
        Linked("frames", requests),
        Linked("locked", requests_of_strangers, {"access_key": words(KEY)}),
        Saved("save", appended=True),
        Saved("erase", appended=False),
        Started(),
    ]
