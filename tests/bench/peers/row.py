"""A row of the table: one figure of goldfield, beside that of a peer, and the goal that it is to reach."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True)
class Goal:
    """What a row is to reach.

    Attributes
    ----------
    of : str
        ``ratio``, or ``ours``.
    at_least, at_most : float or None
    """

    of: str
    at_least: float | None = None
    at_most: float | None = None

    def met(self, value: float) -> bool:
        """Tell whether a value reaches it."""
        return (self.at_least is None or value >= self.at_least) and (self.at_most is None or value <= self.at_most)

    @property
    def text(self) -> str:
        """The goal in words."""
        side, value = ("at most", self.at_most) if self.at_least is None else ("at least", self.at_least)
        return f"{side} {value:,g}{' times' if self.of == 'ratio' else ''}"


@dataclass(frozen=True)
class Row:
    """One line of the table.

    Attributes
    ----------
    subject, what, unit : str
        The name that ``BENCH`` takes, what was measured, and the unit of both figures.
    ours : float
    peer : str
        What it is held against, with its version; empty where there is none.
    theirs : float or None
    ratio : float or None
        How many times as good ours is: median of paired rounds.
    quartiles : tuple of two floats, or None
        Quartiles of the same ratios.
    memory_MB, peer_memory_MB : float or None
        What the work of either adds to a process at its peak.
    goal : Goal or None
    """

    subject: str
    what: str
    unit: str
    ours: float
    peer: str = ""
    theirs: float | None = None
    ratio: float | None = None
    quartiles: tuple[float, float] | None = None
    memory_MB: float | None = None
    peer_memory_MB: float | None = None
    goal: Goal | None = None

    @property
    def met(self) -> bool | None:
        """Whether the goal is reached; None where there is none."""
        if self.goal is None:
            return None
        value = self.ratio if self.goal.of == "ratio" else self.ours
        return value is not None and self.goal.met(value)

    @property
    def name(self) -> tuple[str, str, str]:
        """What makes two rows of different runs the same: subject, what and the peer without its version."""
        return self.subject, self.what, " ".join(word for word in self.peer.split() if not word[0].isdigit())

    def as_dict(self) -> dict[str, Any]:
        """Return it as JSON has it, the goal in words and whether it is met beside."""
        told = {key: value for key, value in asdict(self).items() if value not in (None, "")}
        return told if self.goal is None else told | {"met": self.met}

    @classmethod
    def from_dict(cls, told: dict[str, Any]) -> Row:
        """Return a row that `as_dict` wrote."""
        values = {key: value for key, value in told.items() if key != "met"}
        if "goal" in values:
            values["goal"] = Goal(**values["goal"])
        if "quartiles" in values:
            low, high = values["quartiles"]
            values["quartiles"] = (low, high)
        return cls(**values)
