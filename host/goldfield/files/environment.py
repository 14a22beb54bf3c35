"""Switches in the environment, which all commands understand alike."""

from __future__ import annotations

import os

OFF = ("", "0", "no", "false", "off")
"""What leaves a switch off, in capitals or not; anything else turns it on."""


def switched_on(variable: str) -> bool:
    """Return whether an environment variable is set, and to none of the words of `OFF`.

    Examples
    --------
    >>> switched_on("GOLDFIELD_A_NAME_THAT_NOBODY_SETS")
    False
    """
    return os.environ.get(variable, "").strip().lower() not in OFF
