"""``goldfield paper prigge``: ways to tell beacons apart, on equal terms; the patent's figures and coil rise."""

from __future__ import annotations

import argparse
import dataclasses
import math
from collections.abc import Sequence
from typing import Any

from goldfield.cli import options
from goldfield.cli.output import json_line
from goldfield.errors import UserError
from goldfield.site.drive import DEGREES

RISES = (0.1, 0.2, 0.3)

NULL_DB = -250.0
"""Rounding of a weighted sum of a thousand samples."""


def command(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        "prigge",
        help="TDMA, FDMA and CDMA side by side",
        description="Ways to tell beacons apart, compared at equal peak current and at equal average power: white "
        "noise, mains, impulses, the earth's field, spectrum, eddy currents; then the patent's example and coil rise. "
        "The figures are computed from the exact separation of each system, none is drawn at random.",
    )
    options.add(
        parser, "--beacons", metavar="N", kind=options.count, what="how many beacons share a cycle, default 100"
    )
    options.add(parser, "--degree", metavar="N", kind=options.count, what="2^N - 1 samples a cycle, default 10")
    options.add(parser, "--cycle", metavar="SECONDS", kind=options.seconds, what="duration of a cycle, default 0.1")
    options.add(parser, "--mains", metavar="HZ", kind=options.hertz, what="frequency of the mains, default 60")
    options.add(
        parser, "--figure", metavar="FILE", what="draw waveforms and spectra (FIG. 1 to 4) into a PNG, PDF or SVG"
    )
    options.add_json(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Print the tables, or one JSON object."""
    from hil_sim.papers.prigge import comparison  # heavy: only when it is wanted

    defaults = comparison.Setup()
    setup = comparison.Setup(
        beacons=arguments.beacons or defaults.beacons,
        degree=arguments.degree or defaults.degree,
        cycle_s=arguments.cycle or defaults.cycle_s,
        mains_Hz=arguments.mains or defaults.mains_Hz,
    )
    if setup.degree not in DEGREES:
        raise UserError(f"--degree is {setup.degree}; Gold codes exist here for {', '.join(map(str, DEGREES))}")
    if 2.0 * setup.mains_Hz * setup.chip_s >= 1.0:
        raise UserError(
            f"--mains {setup.mains_Hz:g} is above half the sample rate: give a longer code or a shorter cycle"
        )
    systems = comparison.systems(setup)
    plain, exact = comparison.patent_example()
    waves = comparison.figure_4(setup.conductor_chips / comparison.PATENT_FIGURE_4_HZ)
    rises = [comparison.coil_rise(tau) for tau in RISES]
    if arguments.figure:
        from hil_sim.papers.prigge.waveforms import draw

        draw(arguments.figure, waves)
    gain = systems[0].noise / systems[3].noise
    gain_power = gain * systems[3].peak / systems[0].peak
    if arguments.json:
        record = {
            "setup": dataclasses.asdict(setup),
            "systems": [dataclasses.asdict(system) | {"peak": system.peak} for system in systems],
            "gain_equal_peak": gain,
            "gain_equal_power": gain_power,
            "patent_example": {"plain": plain.tolist(), "exact": exact.tolist()},
            "figure_4": [{"signal": wave.name, "below": wave.below, "eddy": wave.eddy} for wave in waves],
            "coil_rise": [dataclasses.asdict(rise) for rise in rises],
        }
        print(json_line(record))
        return 0
    print(
        f"{setup.beacons} beacons, {setup.chips} samples in {setup.cycle_s:g} s, mains at {setup.mains_Hz:g} Hz "
        f"(columns {setup.mains_error_Hz:g} Hz off), conductor of tau = {setup.conductor_chips:g} chips"
    )
    _print_table(
        ("errors, equal peak current", "white noise", "most/least", "mains rms", "worst", "one sample", "earth"),
        [
            (
                system.system,
                f"{system.noise:.4f}",
                f"{system.noise_spread:.3f}",
                _decibel(system.mains_rms_dB),
                _decibel(system.mains_worst_dB),
                f"{system.impulse:.4f}",
                f"{system.earth:.3f}",
            )
            for system in systems
        ],
    )
    _print_table(
        ("equal average power", "peak", "white noise", "mains rms", "worst", "one sample"),
        [
            (
                system.system,
                f"{system.peak:.2f}",
                f"{system.noise / system.peak:.4f}",
                _decibel(system.mains_rms_dB, system.peak),
                _decibel(system.mains_worst_dB, system.peak),
                f"{system.impulse / system.peak:.4f}",
            )
            for system in systems
        ],
    )
    _print_table(
        ("the drive", "energy below chip rate", "chips with a change", "eddy error", "most/least"),
        [
            (
                system.system,
                f"{system.below_chip_rate:.1%}",
                f"{system.changes:.1%}",
                f"{system.eddy:.2%}",
                f"{system.eddy_spread:.3g}",
            )
            for system in systems
        ],
    )
    _print_table(
        ("FIG. 4, all at 1 kHz", "energy below 1 kHz", "eddy error"),
        [(wave.name, f"{wave.below:.1%}", f"{wave.eddy:.1%}") for wave in waves],
    )
    print(
        f"\nCDMA against TDMA without a quiet slot: {gain:.2f} at equal peak current, {gain_power:.2f} at equal power"
    )
    print(
        "the patent's 12, 6 and 1 mG: "
        + ", ".join(f"{value:.2f}" for value in plain)
        + " by plain correlation, "
        + ", ".join(f"{value:.4f}" for value in exact)
        + " by exact separation"
    )
    _print_table(
        ("coil rise, tau/T", "ignored", "at 2 m", "exact templates", "sharpened", "three lags, tau unknown"),
        [
            (
                f"{rise.tau_chips:g}",
                f"{rise.ignored:.4%}",
                f"{rise.range_m * 1e3:.2f} mm",
                f"{abs(rise.exact):.0e}",
                f"{abs(rise.sharp):.0e}",
                f"{rise.unknown:.5%}",
            )
            for rise in rises
        ],
    )
    return 0


def _print_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print an empty line and a table: first column to the left, the others to the right."""
    widths = [max(len(row[column]) for row in (header, *rows)) for column in range(len(header))]
    print()
    for row in (header, *rows):
        cells = [cell.rjust(width) for cell, width in zip(row[1:], widths[1:], strict=True)]
        print("  ".join([row[0].ljust(widths[0]), *cells]))


def _decibel(value: float, peak: float = 1.0) -> str:
    """Return decibels for a drive of this peak; what is below rounding is a null."""
    return "null" if value < NULL_DB else f"{value - 20.0 * math.log10(peak):+.1f} dB"
