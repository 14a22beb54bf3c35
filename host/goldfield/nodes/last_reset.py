"""What a board tells of its last reset, from its ``RESET_REPORT`` messages, and the sentence that says it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from goldfield.errors import counted
from goldfield_protocol.messages import database

NAME = "RESET_REPORT"
ITEM_CAUSE, ITEM_COUNTS, ITEM_REGISTERS = 0, 1, 2
REGISTERS = ("pc", "lr", "sp", "cfsr", "hfsr", "address", *(f"stack_{i}" for i in range(8)))
"""What the items from `ITEM_REGISTERS` on are, in their order."""

_choices = database().get_message_by_name(NAME).get_signal_by_name("cause").choices
assert _choices is not None
CAUSES = tuple(str(name) for _, name in sorted(_choices.items()))
"""Causes of a reset, by their number."""

PARTS = ("blocks", "coil currents", "samples", "serial link")
"""Parts of the firmware that must move, by the bit of ``stalled``."""

CAUSE_WORDS = {
    "power_on": "powered on",
    "brown_out": "reset by a dip of its supply",
    "pin": "reset by its reset pin",
    "software": "reset on command",
    "watchdog": "reset by its watchdog",
    "window": "reset by its window watchdog",
    "low_power": "reset by a forbidden sleep",
}
COUNT_WORDS = {
    "brown_out": "by dips of the supply",
    "pin": "by the pin",
    "software": "on command",
    "watchdog": "by the watchdog",
    "window": "by the window watchdog",
    "low_power": "by forbidden sleep",
}

USAGE_FAULTS = {
    16: "an undefined instruction",
    17: "an invalid state of the processor",
    18: "an invalid return from an exception",
    19: "an instruction of a coprocessor that is off",
    24: "an unaligned access",
    25: "a division by zero",
}
"""Faults by their bit of CFSR (ARMv7-M Architecture Reference Manual, B3.2.15)."""
CFSR_MEMORY, CFSR_BUS = 0x000000FF, 0x0000FF00
CFSR_MMARVALID, CFSR_BFARVALID = 1 << 7, 1 << 15
"""The address of a memory or bus fault is known."""
NMI, FIRST_INTERRUPT = 2, 16


class Image(Protocol):
    """Where in the source an address of a board's program is."""

    def place(self, address: int) -> str | None:
        """Return file, line and function; None if the image has no code there."""


@dataclass(frozen=True)
class Crash:
    """The fault that a run ended with; addresses are 0 where the board does not know them."""

    exception: int
    stack_overflow: bool
    registers: Mapping[str, int]
    """Those of `REGISTERS` that arrived."""

    @property
    def fault(self) -> str:
        """What happened, in words."""
        status = self.registers.get("cfsr", 0)
        if self.stack_overflow:
            return "a stack overflow"
        if status & CFSR_MEMORY:
            return "a memory protection fault"
        if status & CFSR_BUS:
            return "a bus fault"
        for bit, words in USAGE_FAULTS.items():
            if status >> bit & 1:
                return words
        if self.exception >= FIRST_INTERRUPT:
            return f"interrupt {self.exception - FIRST_INTERRUPT}, which has no handler"
        return "a non-maskable interrupt" if self.exception == NMI else "a hard fault"


@dataclass(frozen=True)
class LastReset:
    """Why a board started, and how the run before ended.

    Attributes
    ----------
    cause : str
        One of `CAUSES`.
    uptime_s : int
        How long the board had run; 0: not known.
    stalled : tuple of str
        Those of `PARTS` that stood still when the watchdog struck.
    counts : dict of str to int
        Resets since power-on by their cause, as far as they were told.
    crash : Crash or None
    """

    cause: str
    uptime_s: int
    stalled: tuple[str, ...]
    counts: Mapping[str, int]
    crash: Crash | None

    @property
    def whole(self) -> bool:
        """Whether all has arrived that the board tells."""
        return bool(self.counts) and (self.crash is None or len(self.crash.registers) == len(REGISTERS))


def last_reset(items: Mapping[int, Mapping[str, float]]) -> LastReset | None:
    """Return what the messages tell, by their item; None without item 0, or with a cause that does not exist."""
    first = items.get(ITEM_CAUSE)
    if first is None or int(first["cause"]) >= len(CAUSES):
        return None
    counts = items.get(ITEM_COUNTS, {})
    crash = None
    if first["crashed"]:
        told = {name: items.get(ITEM_REGISTERS + i) for i, name in enumerate(REGISTERS)}
        registers = {name: int(signals[name]) for name, signals in told.items() if signals is not None}
        crash = Crash(int(first["exception"]), bool(first["stack_overflow"]), registers)
    stalled = int(first["stalled"])
    return LastReset(
        cause=CAUSES[int(first["cause"])],
        uptime_s=int(first["uptime"]),
        stalled=tuple(part for bit, part in enumerate(PARTS) if stalled >> bit & 1),
        counts={c: int(counts[f"resets_{c}"]) for c in CAUSES if counts.get(f"resets_{c}")},
        crash=crash,
    )


def duration(seconds: int) -> str:
    """Return a time as its two largest units.

    Examples
    --------
    >>> duration(11520), duration(59), duration(61), duration(200000)
    ('3 h 12 min', '59 s', '1 min 1 s', '2 d 7 h')
    """
    days, hours, minutes = seconds // 86400, seconds // 3600 % 24, seconds // 60 % 60
    units = [(days, "d"), (hours, "h"), (minutes, "min"), (seconds % 60, "s")]
    first = next((i for i, (value, _) in enumerate(units) if value), len(units) - 1)
    return " ".join(f"{value} {unit}" for value, unit in units[first : first + 2] if value or unit == units[first][1])


def words_of(reset: LastReset, image: Image | None = None) -> list[str]:
    """Return the sentences that say why a board started; none for a board whose power just came on.

    Examples
    --------
    >>> crash = Crash(5, False, {"pc": 0x080012A4, "cfsr": 0x8200, "address": 0x30000000})
    >>> words_of(LastReset("watchdog", 11520, (), {"power_on": 1, "watchdog": 1}, crash))[0]
    'reset by its watchdog after 3 h 12 min; before that a bus fault at 0x080012a4, on address 0x30000000'
    """
    if reset.cause == "power_on" and reset.crash is None:
        return []
    text = CAUSE_WORDS[reset.cause] + (f" after {duration(reset.uptime_s)}" if reset.uptime_s else "")
    if reset.crash is not None:
        text += f"; before that {_crash_words(reset.crash, image)}"
    elif reset.stalled:
        text += f"; before that no longer alive: {', '.join(reset.stalled)}"
    elif reset.cause == "watchdog":
        text += "; before that its main loop hung"
    words = [text]
    counts = {cause: n for cause, n in reset.counts.items() if cause != "power_on"}
    if sum(counts.values()) > 1:
        told = ", ".join(f"{n} {COUNT_WORDS[cause]}" for cause, n in counts.items())
        words.append(f"{counted(sum(counts.values()), 'resets')} since power-on: {told}")
    return words


def _crash_words(crash: Crash, image: Image | None) -> str:
    text, pc = crash.fault, crash.registers.get("pc", 0)
    if pc:
        place = None if image is None else image.place(pc & ~1)
        text += f" at {pc:#010x}" + (f" ({place})" if place else "")
    if crash.stack_overflow:
        return text + ("" if pc or image is None else _latest_calls(crash, image))
    known = crash.registers.get("cfsr", 0) & (CFSR_MMARVALID | CFSR_BFARVALID)
    return text + (f", on address {crash.registers.get('address', 0):#010x}" if known else "")


def _latest_calls(crash: Crash, image: Image) -> str:
    """Return where the latest calls of a stack that ran over return to, which tells whose they are."""
    held = (crash.registers.get(f"stack_{i}", 0) for i in range(8))
    calls = dict.fromkeys(place for word in held if word & 1 and (place := image.place(word & ~1)))
    return f" below {', '.join(calls)}" if calls else ""
