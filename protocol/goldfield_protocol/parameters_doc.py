"""The page ``docs/parameters.md``, written from ``parameters.toml``.

``python -m goldfield_protocol.parameters_doc docs/parameters.md`` writes it; without a file it is printed.
"""

from __future__ import annotations

import sys
from pathlib import Path

from goldfield_protocol.table import COUNTERS, PARAMETERS, Parameter

_HEAD = """# Parameters and counters

<!-- Written by python -m goldfield_protocol.parameters_doc docs/parameters.md from parameters.toml; change that. -->

A parameter is a number that a user may set on a board: at once with `PARAM_SET` over a link, or for good in the
parameter page (`make flash ROLE=beacon NODE=3 CODE=17 AMPLITUDE=10`: the names in capitals). Both ends of a range are
allowed. A board answers a value outside of it with `out_of_range` and keeps the old one, and the page builder refuses
it. A change acts at once, or at the next start of the board where the table says so. A board keeps the parameters of
all roles, so that one page fits every board, and does nothing with those of other roles. Below, a cycle has
N = 2^degree - 1 chips. Messages and the layout of the page: [`protocol/framing.md`](../protocol/framing.md).

## Parameters

| id | name | kind | unit | range | default | used by | change acts | meaning |
| --- | --- | --- | --- | --- | --- | --- | --- | --- |
"""

_COUNTERS = """
## Counters

Each counts events since the board's reset and stops at its maximum. Once a second a `COUNTER` message tells each that
is not zero, and the sum of all is in `HEARTBEAT.errors`.

| index | name | counted on | what is counted |
| --- | --- | --- | --- |
"""


def page() -> str:
    """Return the page."""
    rows = "".join(_row(parameter) for parameter in PARAMETERS.values())
    counted = "".join(f"| {c.index} | {c.name} | {_roles(c.roles)} | {c.text} |\n" for c in COUNTERS)
    return _HEAD + rows + _COUNTERS + counted


def _row(parameter: Parameter) -> str:
    span = f"{parameter.low:.7g} to {parameter.high:.7g}"
    if parameter.excluded is not None:
        span += f", not {parameter.excluded}"
    cells = [
        _ids(parameter),
        f"`{parameter.name}`",
        parameter.kind.name.lower(),
        _listed(parameter.units),
        span,
        _listed(tuple(f"{value:.7g}" for value in parameter.default)),
        _roles(parameter.roles),
        "at start" if parameter.at_start else "at once",
        parameter.text,
    ]
    return f"| {' | '.join(cells)} |\n"


def _ids(parameter: Parameter) -> str:
    last = parameter.group - 1
    if parameter.rows > 1:
        return f"{parameter.first} + {parameter.stride} i + 0..{last}, i = 0..{parameter.rows - 1}"
    return f"{parameter.first}..{parameter.first + last}" if last else str(parameter.first)


def _listed(values: tuple[str, ...]) -> str:
    """Return a value that all elements share once, and different ones in their order."""
    return values[0] if len(set(values)) == 1 else ", ".join(value or "1" for value in values)


def _roles(roles: tuple[str, ...]) -> str:
    return "all" if len(roles) == 3 else ", ".join(roles)


if __name__ == "__main__":
    if len(sys.argv) == 2:
        Path(sys.argv[1]).write_text(page(), encoding="utf-8")
    else:
        sys.stdout.write(page())
