"""Boards whose flash outlives them, what they save there, and a loss of power at any step of it.

``python -m tests.firmware.services.saved_flash ID ...`` runs cases again by the ids that a failing test prints.
"""

from __future__ import annotations

import sys
import zlib
from collections.abc import Iterator, Sequence
from typing import Any

from goldfield_protocol.parameters import PARAMETERS
from tests.firmware.core.storage.flash_cells import Cells, Torn
from tests.firmware.host_rig import BEACON, FFI, LIBRARY, MS, PIN_ENABLE, SECOND, Board

WORDS = 4096
"""Words of a slot: a sector of 16 KiB (RM0090, table 5)."""
SAVE, SAVES_A_SLOT = 5, 4
DONE, REFUSED, COIL_ON, FLASH_FAILED, DONE_RESTARTS = 0, 2, 3, 4, 5
UNIQUE = bytes(range(12))
NAMED = int.from_bytes(UNIQUE[:6], "little") ^ int.from_bytes(UNIQUE[6:], "little")
Step = tuple[int, int | None, int]
"""Slot, word (None: the slot is erased) and value."""


class SavedFlash:
    """The two slots of a board's flash, with all that is done to them.

    Parameters
    ----------
    seed : int or str, optional
        Seed of what happens by chance when the power is lost.
    """

    def __init__(self, seed: int | str = 1) -> None:
        self.memory = [FFI.new("uint32_t[]", WORDS) for _ in range(2)]
        self.cells = Cells(self.memory, WORDS, seed)
        self.steps: list[Step] = []
        self.enabled: list[bool] = []
        """Whether the bridges of the board were on at each step."""
        self.cut: int | None = None
        self.torn = Torn.NOT
        self.lost = False
        self._board: Board | None = None
        self._keep = [
            FFI.callback("bool(void *, uint32_t, uint32_t, uint32_t)", lambda _, s, i, v: self._step(s, i, v)),
            FFI.callback("bool(void *, uint32_t)", lambda _, s: self._step(s, None, 0)),
        ]

    def board(self, role: int = BEACON, parameters: Any = None, **options: Any) -> Board:
        """Return a board with this flash that gets its power now."""
        self.cells.start()
        self.lost = False
        made = Board(role, {"node": 9} if parameters is None else parameters, **options)
        self.attach(made)
        return made

    def attach(self, board: Board) -> None:
        """Give a board this flash."""
        program, erase = self._keep
        flash = FFI.new("host_flash_t *", {"slot": self.memory, "program": program, "erase": erase})
        LIBRARY.host_board_flash(board.handle, flash)
        self._board = board

    def _step(self, slot: int, index: int | None, value: int) -> bool:
        assert self._board is not None
        assert not self.lost, "a board without power touches its flash"
        if len(self.steps) == self.cut:
            self.lost = True
            self.cells.tear(self.torn, slot, index, value)
            return False
        self.steps.append((slot, index, value))
        self.enabled.append(bool(self._board.level.get(PIN_ENABLE)))
        self.carry_out((slot, index, value))
        return True

    def carry_out(self, step: Step) -> None:
        """Do one step to the cells."""
        slot, index, value = step
        if index is None:
            self.cells.erase(slot)
        else:
            self.cells.program(slot, index, value)


def bits(name: str, value: float) -> int:
    """Return the 32 bits of a parameter's value."""
    return int.from_bytes(PARAMETERS[name].pack(value), "little")


def put(board: Board, time: int, to: int = 9, **values: float) -> int:
    """Set parameters, a millisecond each; return when that is done. A name may end in ``__`` and an element."""
    for name, value in values.items():
        plain, _, element = name.partition("__")
        parameter = PARAMETERS[plain]
        kind = ("unsigned", "signed", "float")[parameter.kind]
        identifier = parameter.identifier(int(element or 0))
        board.send_serial("PARAM_SET", {"kind": parameter.kind, f"value_{kind}": value}, to, identifier, time)
        time += MS
    return time


def ask_to_save(board: Board, time: int, *, node: int = 9, named: int = NAMED, pause: bool = False) -> None:
    """Ask a board to save its parameters."""
    board.send_serial("COMMAND", {"board": named, "argument": int(pause)}, node, SAVE, time)


def answers(board: Board) -> list[int]:
    """What became of the saves so far."""
    return [int(m.signals["status"]) for m in board.messages("COMMAND_ANSWER") if m.index == SAVE]


def save(board: Board, begin: int, **values: float) -> int:
    """Set parameters and save them; return the answer."""
    told = len(answers(board))
    ask_to_save(board, put(board, begin, **values) + MS)
    board.run(begin + SECOND // 2)
    [status] = answers(board)[told:]
    return status


def in_force(board: Board, names: Sequence[str], time: int, node: int = 9) -> tuple[float, ...]:
    """Return parameters of a board, which is asked for them from a time on."""
    told = len(board.messages("PARAM_VALUE"))
    identifiers = []
    for place, name in enumerate(names):
        plain, _, element = name.partition("__")
        identifiers.append(PARAMETERS[plain].identifier(int(element or 0)))
        board.send_serial("PARAM_GET", {"reserved": 0}, node, identifiers[-1], time + place * MS)
    board.run(time + (len(names) + 20) * MS)  # What a cycle reports may come first.
    messages = board.messages("PARAM_VALUE")[told:]
    assert [m.index for m in messages] == identifiers
    return tuple(next(v for k, v in m.signals.items() if k.startswith("value")) for m in messages)


def counted(board: Board) -> dict[int, int]:
    """The counters that a board has told."""
    return {m.index: int(m.signals["value"]) for m in board.messages("COUNTER")}


def record(words: Sequence[int], sequence: int) -> list[int]:
    """Return a record of the store as another hand builds it, by the text of store.h."""
    body = [0x47520000 | len(words), sequence, *words]
    crc = zlib.crc32(b"".join(word.to_bytes(4, "little") for word in body))
    return [*body, crc, 0x5AC3A53C, 0x3CA5C35A]


HEAD = [0x47465331, 1, 0xFFFFFFFE, 0x2D5A1E69]
"""A slot that was erased once."""


# ---- A loss of power at every step ----

NAMES = ("node", "code", "over_current", "calibration__8", "survey__191", "pose_blocks")
"""Parameters from the begin of a set to its end, each of which differs from one set to the next."""
SETS = [(9, 7 + n, 2.0 + n / 2, (1 + n) / 1024, (1 + n) / 64, 3 + n) for n in range(12)]
KINDS = {"first": 0, "appended": 1, "full": SAVES_A_SLOT, "again": 2 * SAVES_A_SLOT}
"""How many sets a board has saved before the one in which the power goes: into blank flash, behind others, into the
other slot, which was blank, and into one that holds older sets."""


class Saving:
    """A board that saves sets, and for one of them all that it does to the flash.

    Parameters
    ----------
    kind : str
        One of `KINDS`.
    """

    def __init__(self, kind: str) -> None:
        self.kind = kind
        self.before = KINDS[kind]
        flash = SavedFlash()
        for number in range(self.before + 1):
            if number == self.before:
                self._memory = [list(slot[0:WORDS]) for slot in flash.memory]
                flash.steps.clear()
            board = flash.board()
            assert save(board, 20 * MS, **dict(zip(NAMES, SETS[number], strict=True))) in (DONE, DONE_RESTARTS)
            board.close()
        self.steps = flash.steps
        old = None if self.before == 0 else SETS[self.before - 1]
        self.sets = (old if old is not None else DEFAULTS, SETS[self.before])
        """The old set and the new one."""

    def flash_at(self, step: int, seed: int | str) -> SavedFlash:
        """Return the flash as it is when a step begins."""
        flash = SavedFlash(seed)
        for slot, words in zip(flash.memory, self._memory, strict=True):
            slot[0:WORDS] = words
        for done in self.steps[:step]:
            flash.carry_out(done)
        return flash


def _defaults() -> tuple[float, ...]:
    board = Board(BEACON, {"node": 9})
    found = in_force(board, NAMES, 5 * MS)
    board.close()
    return found


DEFAULTS = _defaults()


def boot(flash: SavedFlash, cut: int | None = None) -> tuple[float, ...] | None:
    """Start a board, whose power may go at a step of its start, and return its parameters; None: the power went."""
    flash.steps.clear()
    flash.cut = cut
    board = flash.board()
    found = None
    board.run(2 * MS)
    if not flash.lost:
        found = in_force(board, NAMES, 5 * MS)
    board.close()
    flash.cut = None
    return found


def case_id(kind: str, torn: Torn, step: int, seed: int) -> str:
    """Return what runs a case again."""
    return f"{kind}:{torn.name}:{step}:{seed}"


def run_case(saving: Saving, torn: Torn, step: int, seed: int) -> None:
    """Lose the power in a step of a save, then again in each step of the mending, until none is left.

    Raises
    ------
    AssertionError
        If a board has neither the old set nor the new one, or does not keep what it has started with, or does not save.
    """
    name = case_id(saving.kind, torn, step, seed)
    again = f"case {name}: python -m tests.firmware.services.saved_flash {name}"
    flash = saving.flash_at(step, name)
    flash.cells.tear(torn, *saving.steps[step])
    torn_flash, cut = flash, 0
    while True:
        flash = SavedFlash(f"{name}:{cut}")
        torn_flash.cells.copy_to(flash.cells)
        flash.torn = torn
        first = boot(flash, cut)
        assert first is None or first in saving.sets, again
        found = boot(flash)
        assert found in saving.sets, f"{again} (the power goes again at step {cut} of the mending)"
        assert boot(flash) == found, again
        if first is not None:
            break
        cut += 1
        assert cut < 20, again
    assert found == first, again
    board = flash.board()
    assert save(board, 20 * MS, **dict(zip(NAMES, SETS[-1], strict=True))) in (DONE, DONE_RESTARTS), again
    board.close()
    assert boot(flash) == SETS[-1], again


def telling_steps(saving: Saving) -> Iterator[int]:
    """Yield the steps of a save at which something else begins: each erasure, head, first and last words."""
    last = len(saving.steps)
    yield from sorted({*range(min(12, last)), *range(max(0, last - 6), last), last // 2})


def main(ids: Sequence[str]) -> int:
    """Run cases by their ids; return the exit code."""
    for one in ids:
        kind, torn, step, seed = one.split(":")
        run_case(Saving(kind), Torn[torn], int(step), int(seed))
        print(f"{one}: the old set or the new one is there")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
