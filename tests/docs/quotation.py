"""Whether a line that a page quotes is one that a command prints: the same words, and nearly the same numbers."""

from __future__ import annotations

import re
from collections.abc import Iterable

from tests.docs.walkthrough import Step

PART, LAST_DIGITS = 0.2, 10.0
"""A quoted number may differ by this part, or by so many units of its last digit: a run starts at another moment."""
NUMBER = re.compile(r"[+-]?\d+(?:\.\d+)?")


def agrees(quoted: str, printed: str) -> bool:
    """Tell whether two lines have the same words, and numbers that are nearly the same, as far as ``...`` if it has."""
    if quoted.endswith(" ..."):
        quoted = quoted.removesuffix(" ...").rstrip(",;:")
        printed = " ".join(printed.split()[: len(quoted.split())]).rstrip(",;:")
    if _words(quoted) != _words(printed):
        return False
    for ours, theirs in zip(NUMBER.findall(quoted), NUMBER.findall(printed), strict=True):
        unit = 10.0 ** -len(ours.partition(".")[2])
        if abs(float(ours) - float(theirs)) > max(PART * abs(float(ours)), LAST_DIGITS * unit):
            return False
    return True


def not_printed(done: Iterable[Step]) -> list[str]:
    """Return each quoted line that its command did not print, behind that command."""
    return [
        f"{step.command}\n    {line}"
        for step in done
        for line in step.quoted
        if not any(agrees(line, printed) for printed in step.printed.splitlines())
    ]


def _words(line: str) -> list[str]:
    return NUMBER.sub(" # ", line).split()
