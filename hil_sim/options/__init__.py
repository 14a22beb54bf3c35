"""The option that says how many cycles an instruction takes on emulated boards."""

from __future__ import annotations

import argparse
import math

from hil_sim import CYCLES_BY_CLASS, MOST_CYCLES


def add_cycles(parser: argparse.ArgumentParser) -> None:
    """Add ``--cycles-per-instruction`` to a command line; its value is a float or `hil_sim.CYCLES_BY_CLASS`."""
    parser.add_argument(
        "--cycles-per-instruction",
        type=cycles,
        default=1.0,
        metavar="X",
        help=f"cycles that an instruction takes on an emulated board, 1 (default) to {MOST_CYCLES:g}; "
        f"{CYCLES_BY_CLASS}: those of a Cortex-M4 by class of instruction, flash and buses counted",
    )


def cycles(text: str) -> float | str:
    """Parse the option's value.

    Raises
    ------
    argparse.ArgumentTypeError
        If it is neither a number in range nor ``m4``.
    """
    if text == CYCLES_BY_CLASS:
        return text
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 1.0 <= value <= MOST_CYCLES:
        raise argparse.ArgumentTypeError(
            f"'{text}' is no number of cycles per instruction: give 1 to {MOST_CYCLES:g}, or {CYCLES_BY_CLASS}"
        )
    return value
