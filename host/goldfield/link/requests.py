"""Requests to a board about one of its parameters, and what its answer, a ``PARAM_VALUE``, tells."""

from __future__ import annotations

from collections.abc import Mapping

from goldfield_protocol.messages import encode
from goldfield_protocol.parameters import Kind, find_id, label_of

ANSWER_S = 1.0
"""How long an answer is waited for. A board gives it within a few milliseconds; a simulated one may run slower than the
wall clock."""

UNKNOWN, OUT_OF_RANGE, LOCKED = 1, 2, 5
REFUSALS = {UNKNOWN: "unknown", OUT_OF_RANGE: "out of range", 3: "of the wrong kind", 4: "read-only", LOCKED: "locked"}
"""What a board says of a parameter, by the status of its answer; 0 is no refusal."""

Value = int | float


def read_request(node: int, parameter: int) -> tuple[int, bytes]:
    """Return identifier and data of the message that asks a node for a parameter, by its id."""
    return encode("PARAM_GET", {"reserved": 0}, node=node, index=parameter)


def set_request(node: int, parameter: int, value: Value, kind: Kind) -> tuple[int, bytes]:
    """Return identifier and data of the message that sets a parameter of a node, by its id."""
    return encode("PARAM_SET", {"kind": kind, f"value_{kind.name.lower()}": value}, node=node, index=parameter)


def value_of(answer: Mapping[str, float]) -> Value:
    """Return the value that the signals of an answer tell."""
    kind = Kind(int(answer["kind"]))
    value = answer[f"value_{kind.name.lower()}"]
    return float(value) if kind is Kind.FLOAT else int(value)


def refusal(answer: Mapping[str, float], parameter: int, value: Value | None = None) -> str | None:
    """Return what a board says against a request, to stand behind its name; None if it does not refuse.

    Parameters
    ----------
    answer : mapping of str to float
        Signals of its answer.
    parameter : int
        Id of the parameter.
    value : int or float, optional
        What was to be set; None: it was asked for.

    Examples
    --------
    >>> refusal({"status": 4}, 256, 3)
    'says that parameter code_list[0] = 3 is read-only'
    """
    status = int(answer["status"])
    if not status:
        return None
    given = "" if value is None else f" = {value}"
    found = find_id(parameter)
    behind = f" ({found[0].range_text})" if found is not None and status == OUT_OF_RANGE else ""
    why = REFUSALS.get(status, f"of status {status}")
    return f"says that parameter {label_of(parameter)}{given} is {why}{behind}"
