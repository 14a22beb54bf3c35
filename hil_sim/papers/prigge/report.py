"""What ``goldfield paper prigge`` prints: the comparison as tables, or as one JSON object."""

from __future__ import annotations

import argparse
import dataclasses
import math
from collections.abc import Sequence
from typing import Any

from goldfield.cli.output import json_line
from goldfield.errors import UserError
from goldfield.site.drive import DEGREES
from goldfield.types import FloatArray
from hil_sim.papers.prigge import comparison, waveforms
from hil_sim.papers.prigge.comparison import Figures, Rise, Setup, Waveform

RISES = (0.1, 0.2, 0.3)
"""Time constants of the coils, in chips, whose errors are shown."""

NULL_DB = -250.0
"""A level below this is the rounding of a weighted sum of a thousand samples, and is shown as a null."""


@dataclasses.dataclass(frozen=True, eq=False)
class Report:
    """All figures of the comparison.

    Attributes
    ----------
    setup : Setup
    systems : list of Figures
    plain_mG, exact_mG : ndarray, shape (3,)
        The patent's example by plain correlation and by exact separation.
    waves : list of Waveform
        The signals of FIG. 4.
    rises : list of Rise
        One for each of `RISES`.
    """

    setup: Setup
    systems: list[Figures]
    plain_mG: FloatArray
    exact_mG: FloatArray
    waves: list[Waveform]
    rises: list[Rise]

    @property
    def gain(self) -> float:
        """Noise of TDMA without a quiet slot over that of CDMA, at equal peak current."""
        return self.systems[0].noise / self.systems[3].noise

    @property
    def gain_power(self) -> float:
        """The same gain at equal average power."""
        return self.gain * self.systems[3].peak / self.systems[0].peak


def run(arguments: argparse.Namespace) -> int:
    """Print the tables, or one JSON object."""
    setup = _setup(arguments)
    systems = comparison.systems(setup)
    plain, exact = comparison.patent_example()
    waves = comparison.figure_4(setup.conductor_chips / comparison.PATENT_FIGURE_4_HZ)
    report = Report(setup, systems, plain, exact, waves, [comparison.coil_rise(tau) for tau in RISES])
    if arguments.figure:
        waveforms.draw(arguments.figure, waves)
    if arguments.json:
        print(json_line(_record(report)))
    else:
        _print_systems(report)
        _print_signals(report)
    return 0


def _setup(arguments: argparse.Namespace) -> Setup:
    """Return the setup of the options.

    Raises
    ------
    UserError
        If there are no codes of the degree, or the mains cannot be sampled.
    """
    defaults = Setup()
    setup = Setup(
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
    return setup


def _record(report: Report) -> dict[str, Any]:
    return {
        "setup": dataclasses.asdict(report.setup),
        "systems": [dataclasses.asdict(system) | {"peak": system.peak} for system in report.systems],
        "gain_equal_peak": report.gain,
        "gain_equal_power": report.gain_power,
        "patent_example": {"plain": report.plain_mG.tolist(), "exact": report.exact_mG.tolist()},
        "figure_4": [{"signal": wave.name, "below": wave.below, "eddy": wave.eddy} for wave in report.waves],
        "coil_rise": [dataclasses.asdict(rise) for rise in report.rises],
    }


def _print_systems(report: Report) -> None:
    """Print what each system makes of disturbances, at equal peak and at equal power, and its drive."""
    setup, systems = report.setup, report.systems
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


def _print_signals(report: Report) -> None:
    """Print the patent's FIG. 4, the gain that it claims, its example, and what coil rise does to that."""
    _print_table(
        ("FIG. 4, all at 1 kHz", "energy below 1 kHz", "eddy error"),
        [(wave.name, f"{wave.below:.1%}", f"{wave.eddy:.1%}") for wave in report.waves],
    )
    print(
        f"\nCDMA against TDMA without a quiet slot: {report.gain:.2f} at equal peak current, "
        f"{report.gain_power:.2f} at equal power"
    )
    print(
        "the patent's 12, 6 and 1 mG: "
        + ", ".join(f"{value:.2f}" for value in report.plain_mG)
        + " by plain correlation, "
        + ", ".join(f"{value:.4f}" for value in report.exact_mG)
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
            for rise in report.rises
        ],
    )


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
