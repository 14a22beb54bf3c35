"""What a line of a run, or the fields of a cycle, must be, whoever wrote the file: its readers rely on it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from goldfield.types import Status

NUMBERS = ("t_s", "unix_s", "latency_s", "residual", "protection_m", "lost", "chips", "saturated", "locked")
"""Keys of a line that are one number each, or null; so is `epoch`, which is always known."""
TEXTS = ("reason", "used", "excluded")
"""Keys that are text, or ids of beacons."""
MATRICES: dict[str, tuple[int, ...]] = {
    "position_m": (3,),
    "orientation_xyzw": (4,),
    "position_cov_m2": (3, 3),
    "attitude_cov_rad2": (3, 3),
}
"""Keys that are arrays, and their shapes."""
NEEDED = ("epoch", "t_s", "position_m", "orientation_xyzw", "status")
"""Keys without which a line is none."""
LARGEST = 1e100
"""No number of a line is as large; the square of one that is smaller is a number, too."""
STATUSES = sorted(status.value for status in Status)


def check_line(record: Any) -> dict[str, Any]:
    """Return a line of ``goldfield run --json``, which may have further keys.

    Raises
    ------
    ValueError
        With what is wrong, as the end of a sentence.

    Examples
    --------
    >>> check_line({"epoch": 1, "t_s": 0.1, "position_m": [1, 2], "orientation_xyzw": None, "status": "ok"})
    Traceback (most recent call last):
    ValueError: position_m is not 3 numbers
    """
    line = _with_keys(record, NEEDED)
    _check(line, ("epoch",), _is_whole, "a whole number")
    _check(line, NUMBERS, _is_number_or_none, "a number")
    _check(line, TEXTS, _is_text, "text")
    if line["status"] not in STATUSES:
        raise ValueError(f"status is none of {', '.join(STATUSES)}")
    for key, shape in MATRICES.items():
        value = line.get(key)
        if value is not None and not _has_shape(value, shape):
            raise ValueError(f"{key} is not {' times '.join(map(str, shape))} numbers")
    if (line["position_m"] is None) != (line["orientation_xyzw"] is None):
        raise ValueError("one of position_m and orientation_xyzw is null")
    if line["orientation_xyzw"] is not None and not any(line["orientation_xyzw"]):
        raise ValueError("orientation_xyzw is 0")
    beacons = line.get("beacons", {})
    if not isinstance(beacons, dict) or not all(map(_is_number_or_none, beacons.values())):
        raise ValueError("beacons is not a number for each id")
    return line


def check_fields(record: Any) -> dict[str, Any]:
    """Return the separated fields of a cycle, as a recording holds them; raise as `check_line` does."""
    cycle = _with_keys(record, ("epoch", "t_s", "fields"))
    _check(cycle, ("epoch",), _is_whole, "a whole number")
    _check(cycle, ("t_s",), _is_number_or_none, "a number")
    fields = cycle["fields"]
    if not isinstance(fields, list) or not all(map(_is_field, fields)):
        raise ValueError("fields is not a list of beacon, b_T of 3 numbers, and sigma_T")
    return cycle


def _with_keys(record: Any, needed: tuple[str, ...]) -> dict[str, Any]:
    if not isinstance(record, dict) or not record.keys() >= set(needed):
        raise ValueError("keys are missing")
    return record


def _check(record: dict[str, Any], keys: tuple[str, ...], right: Callable[[Any], bool], what: str) -> None:
    for key in keys:
        if not right(record.get(key)):
            raise ValueError(f"{key} is not {what}")


def _is_whole(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and abs(value) < 2**53


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and -LARGEST < value < LARGEST


def _is_number_or_none(value: Any) -> bool:
    return value is None or _is_number(value)


def _is_text(value: Any) -> bool:
    ids = value if isinstance(value, list) else []
    return value is None or (isinstance(value, (str, list)) and all(isinstance(one, str) for one in ids))


def _has_shape(value: Any, shape: tuple[int, ...]) -> bool:
    if not shape:
        return _is_number(value)
    return isinstance(value, list) and len(value) == shape[0] and all(_has_shape(one, shape[1:]) for one in value)


def _is_field(field: Any) -> bool:
    return (
        isinstance(field, dict)
        and isinstance(field.get("beacon"), str)
        and isinstance(field.get("b_T"), list)
        and len(field["b_T"]) == 3
        and all(map(_is_number_or_none, [*field["b_T"], field.get("sigma_T")]))
    )
