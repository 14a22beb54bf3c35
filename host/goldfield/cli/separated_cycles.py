"""The work of ``goldfield separate``: cycles of raw samples in, the field of each beacon out."""

from __future__ import annotations

import argparse
from contextlib import AbstractContextManager, nullcontext
from typing import Any

import numpy as np

from goldfield import site as sites
from goldfield.access.cdma import Separation
from goldfield.access.nuisance import SEARCH_HZ
from goldfield.access.of_site import SiteAccess, SiteCycle
from goldfield.access.tones import ToneAccess
from goldfield.cli import options
from goldfield.cli.chips_file import read_cycles
from goldfield.cli.output import elements, json_line, number
from goldfield.errors import UserError, tell
from goldfield.files.inputs import name_of
from goldfield.files.outputs import check_outputs
from goldfield.sensor.fields_table import FieldsWriter
from goldfield.site import Site
from goldfield.types import Fields, FloatArray


def separate(arguments: argparse.Namespace) -> int:
    """Print a line for every cycle, or a table with ``--fields``, and return 0."""
    path = options.required(arguments.site, "--site", "FILE")
    inputs = {"--site": path, "SAMPLES.csv": arguments.samples}
    check_outputs({"--fields": arguments.fields}, inputs, force=arguments.force)
    site = sites.load(path)
    options.tell_doubts(site)
    _check_mains(site, arguments.mains, arguments.harmonics)
    try:
        access = _access(site, arguments)
    except UserError as error:
        raise UserError(f"{name_of(path)}: {error}") from error
    if not access.has_offset:
        tell(
            f"{name_of(path)}: every chip belongs to a beacon's slot, so the ambient field stays in the "
            "field of each beacon; leave one slot without a beacon to measure it"
        )
    told: set[str] = set()
    with _fields_writer(arguments) as writer:
        for number_of, chips in enumerate(read_cycles(site, arguments.samples)):
            if isinstance(access, ToneAccess):
                cycle = access.cycle(chips.samples_T, chips.reference)
                if chips.reference is not None:
                    _tell_unheard(site, number_of, cycle.phase_rad, told)
            else:
                cycle = access.cycle(chips.samples_T)
            if writer is not None:
                writer.write(_fields(site, number_of, cycle.separation))
            if arguments.json:
                print(json_line(cycle_record(site, number_of, cycle)))
            else:
                print(_table(site, number_of, cycle))
    return 0


def _tell_unheard(site: Site, number_of: int, phase_rad: FloatArray | None, told: set[str]) -> None:
    """Say, once a beacon, that the reference does not hold its tone, so that it has no field."""
    phases = np.zeros(len(site.beacons)) if phase_rad is None else phase_rad
    unheard = [
        beacon.id
        for beacon, phase in zip(site.beacons, phases, strict=True)
        if np.isnan(phase) and beacon.id not in told
    ]
    if unheard:
        told.update(unheard)
        tell(
            f"cycle {number_of}: reference does not hold the tone of {', '.join(unheard)}, which then has no field: "
            "check that channel and frequency_Hz"
        )


def _access(site: Site, arguments: argparse.Namespace) -> SiteAccess | ToneAccess:
    harmonics = arguments.harmonics or 1
    if all(beacon.drive.frequency_Hz is None for beacon in site.beacons):
        return SiteAccess(site, arguments.mains, harmonics, arguments.unknown_rise)
    if arguments.unknown_rise:
        raise UserError("--unknown-rise finds no coil's rise from tones of unknown phase: leave it out")
    return ToneAccess(site, arguments.mains, harmonics)


def _check_mains(site: Site, mains_Hz: float | None, harmonics: int | None) -> None:
    """Check that a hum and its multiples can be told from what samples at the chips' rate alias them to.

    Raises
    ------
    UserError
        If one is at half the chips' rate or above, or they leave too few chips for the beacons.
    """
    if mains_Hz is None:
        if harmonics is not None:
            raise UserError("--harmonics is given without --mains: give the frequency of the mains too")
        return
    half_Hz = 0.5 / site.chip_period_s
    if mains_Hz + SEARCH_HZ >= half_Hz:
        raise UserError(
            f"--mains {mains_Hz:g}: is not below {half_Hz:g} Hz, half the rate of the chips: samples cannot tell it"
        )
    most = min(int(half_Hz / (mains_Hz + SEARCH_HZ)), (site.chips - 1 - len(site.beacons)) // 2)
    if harmonics is not None and harmonics > most:
        raise UserError(
            f"--harmonics {harmonics}: with --mains {mains_Hz:g} and {site.chips} chips of {site.chip_period_s:g} s at "
            f"most {max(most, 1)} can be taken out"
        )


def _fields_writer(arguments: argparse.Namespace) -> AbstractContextManager[FieldsWriter | None]:
    """Return the table of ``--fields``, which is there when all cycles are in it; None if it is not asked for."""
    if not arguments.fields:
        return nullcontext()
    return FieldsWriter(arguments.fields, live=False, force=arguments.force)


def _fields(site: Site, number_of: int, separation: Separation) -> Fields:
    """Fields of the beacons that were measured, at mid-cycle counted from the table's begin."""
    measured = np.isfinite(separation.sigma_T)
    return Fields(
        epoch=number_of,
        time_s=(number_of + 0.5) * site.cycle_s,
        beacons=tuple(beacon.id for beacon, seen in zip(site.beacons, measured, strict=True) if seen),
        field_T=separation.field_T[measured],
        sigma_T=separation.sigma_T[measured],
    )


def cycle_record(site: Site, number_of: int, cycle: SiteCycle) -> dict[str, Any]:
    """Return a separated cycle under the keys of ``goldfield separate --json``.

    ``mains_Hz`` and each beacon's ``tau_s`` are there if they were asked for, ``phase_rad`` if it was unknown.
    """
    separation = cycle.separation
    record: dict[str, Any] = {"cycle": number_of, "offset_T": elements(separation.offset_T)}
    if cycle.mains_Hz is not None:
        record["mains_Hz"] = cycle.mains_Hz
    record["fields"] = [
        {"beacon": beacon.id, "b_T": elements(field), "sigma_T": number(sigma)}
        for beacon, field, sigma in zip(site.beacons, separation.field_T, separation.sigma_T, strict=True)
    ]
    if cycle.tau_s is not None:
        for entry, tau in zip(record["fields"], cycle.tau_s, strict=True):
            entry["tau_s"] = number(tau)
    if cycle.phase_rad is not None:
        for entry, phase in zip(record["fields"], cycle.phase_rad, strict=True):
            entry["phase_rad"] = number(phase)
    return record


def _table(site: Site, number_of: int, cycle: SiteCycle) -> str:
    separation: Separation = cycle.separation

    def components(vector: FloatArray) -> str:
        return " ".join(f"{value * 1e9:12.3f}" if np.isfinite(value) else f"{'-':>12}" for value in vector)

    width = max(8, *(len(beacon.id) for beacon in site.beacons))
    head = f"cycle {number_of}" + ("" if cycle.mains_Hz is None else f" (mains at {cycle.mains_Hz:.3f} Hz taken out)")
    tau_us = [""] * len(site.beacons) if cycle.tau_s is None else [f" {tau * 1e6:9.2f}" for tau in cycle.tau_s]
    tau_head = "" if cycle.tau_s is None else f" {'tau/us':>9}"
    lines = [head, f"  {'nT':<{width}} {'x':>12} {'y':>12} {'z':>12} {'sigma':>10}{tau_head}"]
    lines.append(f"  {'offset':<{width}} {components(separation.offset_T)}")
    rows = zip(site.beacons, separation.field_T, separation.sigma_T, tau_us, strict=True)
    for beacon, field, sigma, tau in rows:
        lines.append(f"  {beacon.id:<{width}} {components(field)} {sigma * 1e9:10.3f}{tau}")
    return "\n".join(lines)
