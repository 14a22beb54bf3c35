"""The parts that are proven, as ``parts.toml`` tells them."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path

HERE = Path(__file__).parent


@dataclass(frozen=True)
class Run:
    """One analysis: where it begins, how many turns of a loop are told apart, and how many states in a function."""

    entry: str
    unroll: int
    states: dict[str, int]


@dataclass(frozen=True)
class Wrap:
    """Sums in a function that may wrap: each is in a line that holds one of ``what``."""

    function: str
    what: tuple[str, ...]


@dataclass(frozen=True)
class Part:
    """What is proven together.

    Attributes
    ----------
    sources : tuple of str
        What is proven, below ``firmware``.
    harness : str
        Its states and calls, in ``harnesses``; it includes the first source itself if it needs what is private there.
    stands_in : tuple of str
        What replaces a source of others, in ``harnesses``.
    prefix : str
        A header in front of each source, or nothing.
    assumes : tuple of str
        What is assumed.
    turns : tuple of str
        Functions whose loops' turns the harness counts.
    ends : tuple of str
        Functions whose loops are argued to end.
    """

    name: str
    sources: tuple[str, ...]
    harness: str
    stands_in: tuple[str, ...]
    prefix: str
    assumes: tuple[str, ...]
    runs: tuple[Run, ...]
    wraps: tuple[Wrap, ...]
    turns: tuple[str, ...]
    ends: tuple[str, ...]


def read_parts() -> list[Part]:
    """Return the parts in the order of the file."""
    parts = tomllib.loads((HERE / "parts.toml").read_text())["part"]
    return [
        Part(
            name=part["name"],
            sources=tuple(part["sources"]),
            harness=part["harness"],
            stands_in=tuple(part.get("stands_in", ())),
            prefix=part.get("prefix", ""),
            assumes=tuple(part["assumes"]),
            runs=tuple(Run(run["entry"], run.get("unroll", 0), run["states"]) for run in part["runs"]),
            wraps=tuple(Wrap(wrap["function"], tuple(wrap["what"])) for wrap in part.get("wraps", ())),
            turns=tuple(part.get("turns", ())),
            ends=tuple(end["function"] for end in part.get("ends", ())),
        )
        for part in parts
    ]
