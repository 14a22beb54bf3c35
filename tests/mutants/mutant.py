"""What a mutant is: a small change of one place of a source, told in words that outlive changes of other lines."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, replace


@dataclass(frozen=True)
class Mutant:
    """One change that a build can be asked to behave by.

    Attributes
    ----------
    number : int
        What selects it at run time, from 1, in this state of the sources.
    file, function, line : str, str, int
        Where it is.
    what : str
        The changed expression or statement, and what becomes of it. With file and function it is the mutant's name.
    real : bool or None
        Whether it exists only where real numbers (or only where integers) meet; None: always.
    """

    number: int
    file: str
    function: str
    line: int
    what: str
    real: bool | None = None

    @property
    def name(self) -> str:
        """Name that `survivors.toml` and the results know it by."""
        return f"{self.file}: {self.function}: {self.what}"


def shortened(text: str, most: int = 90) -> str:
    """Return the text of a piece of source in one line, its middle left out if it is long."""
    line = " ".join(text.split())
    half = (most - 5) // 2
    return line if len(line) <= most else f"{line[:half]} ... {line[-half:]}"


def with_distinct_names(mutants: Iterable[Mutant]) -> list[Mutant]:
    """Return mutants of which the second of a name is told from the first by ``(2)``, and so on."""
    seen: Counter[str] = Counter()
    distinct = []
    for mutant in mutants:
        seen[mutant.name] += 1
        count = seen[mutant.name]
        distinct.append(mutant if count == 1 else replace(mutant, what=f"{mutant.what} ({count})"))
    return distinct
