"""The work of ``goldfield calibrate``: recordings in, calibrations out, to stdout, files and the board."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from goldfield import site as sites
from goldfield.calibration.coils import CoilCalibration, calibrate_coils
from goldfield.calibration.kept import KeptSensor, checked_id, corrected, keep, kept_before, load_kept
from goldfield.calibration.sensor import SensorCalibration, calibrate_sensor
from goldfield.calibration.turn import Turn, turn_of_fields, turn_of_reports
from goldfield.cli import board_calibration, link_options, options
from goldfield.cli.chips_file import read_cycles
from goldfield.cli.output import elements, json_line, number
from goldfield.cli.page_progress import TurnProgress
from goldfield.cli.page_shown import shown
from goldfield.errors import SystemFailure, UserError, tell
from goldfield.files.outputs import check_outputs, check_writable, write_file
from goldfield.link.reports import Report
from goldfield.sensor.fields_table import read_fields
from goldfield.sensor.opening import open_sensor
from goldfield.sensor.options import Options
from goldfield.site import Site
from goldfield.site.revision import BeaconRevision, SensorRevision, revised
from goldfield.types import FloatArray

BOARDS = ("port", "can")
"""Kinds of links at whose end a board is."""
LIVE_S = 60.0
PROGRESS_S = 10.0


def sensor(arguments: argparse.Namespace) -> int:
    """Calibrate a sensor."""
    path = options.required(arguments.site, "--site", "FILE")
    kind, where = ("fields", arguments.fields) if arguments.fields else link_options.chosen(arguments)
    live = kind in BOARDS
    if arguments.write and not live:
        raise UserError("--write needs the board: give --port or --can in place of a recording")
    if arguments.sensors and not live and not arguments.unique_id:
        raise UserError("--sensors needs --unique-id with a recording: goldfield nodes tells a board's")
    if not arguments.write:
        options.tell_idle(arguments, ("--accept-weak",), "a calibration that is not written to the board (--write)")
    if kind == "fields":
        options.tell_idle(arguments, ("--seconds", "--view"), "--fields")
    if live or not arguments.sensors:
        options.tell_idle(arguments, ("--unique-id",), "--port or --can" if live else "a recording without --sensors")
    unique_id = checked_id(arguments.unique_id) if arguments.unique_id else None
    recording = None if live else where
    inputs = {"--site": path, "the recording": recording, "--sensors": arguments.sensors}
    check_outputs({"--out": arguments.out}, inputs, force=arguments.force)
    check_writable(arguments.out, "the site file")
    check_writable(arguments.sensors, "the file of sensors")
    if arguments.sensors:
        kept_before(Path(arguments.sensors))  # a broken one is told before the sensor is turned or the board written
    site = sites.load(path)
    options.tell_assumed(site)
    with _page(arguments, kind, where, site) as page:
        if kind == "fields":
            node, turn = arguments.node, turn_of_fields(site, read_fields(site, where))
        else:
            node, turn = _record(arguments, kind, where, site, page)
        if page is not None:
            page.compute()
        found = calibrate_sensor(site, turn)
        refused = arguments.write and found.weak is not None and not arguments.accept_weak
        if refused:
            record = sensor_record(found) | {"written": False}
        else:
            record = _carried_out(arguments, kind, where, site, node, found, unique_id)
        print(json_line(record) if arguments.json else _sensor_text(found, record))
        if refused:
            raise SystemFailure(
                "the calibration is weak: neither the board nor a file was written; turn the sensor again as is said, "
                "or write it all the same with --accept-weak"
            )
        if page is not None:
            page.say(f"Done: {_summary(found)}")
    return 0


def _carried_out(
    arguments: argparse.Namespace,
    kind: str,
    where: str,
    site: Site,
    node: int | None,
    found: SensorCalibration,
    unique_id: str | None,
) -> dict[str, Any]:
    """Keep what was found, give it to the board and to the site file, as was asked for; return it as JSON."""
    record = sensor_record(found)
    before = None
    if kind in BOARDS and (arguments.write or arguments.sensors):
        before = board_calibration.read(kind, where, node, arguments.bit_rate)
        unique_id = before.unique_id
    if before is not None:
        record["unique_id"] = unique_id
        zero, matrix = corrected(before.zero, before.matrix, found.axes, found.offset_T)
        record["written"] = bool(arguments.write)
    if arguments.sensors and unique_id is not None:
        values = (None, None) if before is None else (zero, matrix)
        offset_T = np.full(3, np.nan) if found.offset_T is None else found.offset_T
        keep(Path(arguments.sensors), KeptSensor(unique_id, found.axes, offset_T, *_deviations(found), *values))
    if arguments.write and before is not None:  # only once the values are kept: a reset of the board loses them
        key = link_options.key(arguments)
        board_calibration.write(kind, where, before, zero, matrix, key, arguments.bit_rate)
        tell(f"board {before.unique_id}, node {before.node}, has the new calibration")
    if arguments.out:
        # What is written to the board needs no undoing by the host.
        axes = found.axes if not arguments.write else None if site.sensor.axes is None else np.eye(3)
        text = revised(Path(arguments.site), {}, SensorRevision(axes, *_deviations(found)))
        write_file(arguments.out, text.encode(), "the site file", force=arguments.force)
    return record


@contextmanager
def _page(arguments: argparse.Namespace, kind: str, where: str, site: Site) -> Iterator[TurnProgress | None]:
    """Serve the live page until the sensor is calibrated, if somebody asked for it."""
    if kind == "fields":
        yield None
        return
    with shown(arguments, site, where, live=kind in BOARDS) as page:
        yield None if page is None else TurnProgress(page, site.cycle_s, arguments.seconds or LIVE_S)


def _deviations(found: SensorCalibration) -> tuple[float, float]:
    return found.gain_sd, found.axis_sd_rad


def _record(
    arguments: argparse.Namespace, kind: str, where: str, site: Site, page: TurnProgress | None
) -> tuple[int | None, Turn]:
    live = kind in BOARDS
    seconds = arguments.seconds if arguments.seconds is not None else LIVE_S if live else None
    key, bit_rate = link_options.key(arguments), arguments.bit_rate
    choices = Options(node=arguments.node, seconds=seconds, key=key, bit_rate=bit_rate)
    with open_sensor(kind, where, site, choices, None if page is None else page.recorder) as opened:
        reports = opened.reports() if page is None else page.reports(opened)
        turn = turn_of_reports(site, _with_progress(reports, seconds if live else None))
        return opened.node, turn


def _with_progress(reports: Iterator[Report], seconds: float | None) -> Iterator[Report]:
    first: float | None = None
    told_s = 0.0
    for report in reports:
        if seconds is not None and np.isfinite(report.time_s):
            first = report.time_s if first is None else first
            if report.time_s - first >= told_s + PROGRESS_S:
                told_s += PROGRESS_S
                tell(f"{told_s:.0f} of {seconds:.0f} s: go on turning the sensor, each axis up, down and to all sides")
        yield report


def sensor_record(found: SensorCalibration) -> dict[str, Any]:
    """Return a sensor's calibration under the keys of ``goldfield calibrate sensor --json``."""
    return {
        "status": "ok" if found.weak is None else "weak",
        "reason": found.weak,
        "axes": [elements(row) for row in found.axes],
        "axes_sd": [elements(row) for row in found.axes_sd],
        "gain_sd": number(found.gain_sd),
        "relative_gain_sd": number(found.relative_sd),
        "axis_sd_rad": number(found.axis_sd_rad),
        "offset_T": None if found.offset_T is None else elements(found.offset_T),
        "offset_sd_T": None if found.offset_sd_T is None else elements(found.offset_sd_T),
        "earth_T": None if found.earth_T is None else number(found.earth_T),
        "residual": number(found.residual),
        "cycles": found.cycles,
        "used": found.used,
        "outliers": list(found.outliers),
    }


def _summary(found: SensorCalibration) -> str:
    """Return what was found in a sentence."""
    known = f"the gains are known to {1e2 * found.gain_sd:.2g} %, the axes to {1e3 * found.axis_sd_rad:.2g} mrad"
    return f"{known}." if found.weak is None else f"{known}; but it is weak: {found.weak}"


def _sensor_text(found: SensorCalibration, record: dict[str, Any]) -> str:
    def row(values: FloatArray) -> str:
        return " ".join(f"{value:10.6f}" for value in values)

    lines = [f"{found.used} of {found.cycles} cycles, residual {found.residual:.2f} of the noise"]
    lines.append(f"{'axis':<6} {'what it reads of a field':<32}   {'standard deviation':<32}")
    for name, axis, sd in zip("xyz", found.axes, found.axes_sd, strict=True):
        lines.append(f"{name:<6} {row(axis)}   {row(sd)}")
    if found.offset_T is not None and found.offset_sd_T is not None and found.earth_T is not None:
        values = " ".join(f"{value * 1e9:.1f}" for value in found.offset_T)
        lines.append(f"offset {values} nT, +-{found.offset_sd_T.max() * 1e9:.1f}; earth {found.earth_T * 1e6:.2f} uT")
    if found.weak is not None:
        lines.append(f"weak: {found.weak}")
    if record.get("written"):
        lines.append(f"written to board {record['unique_id']}: {board_calibration.HOLDS}")
    return "\n".join(lines)


def coils(arguments: argparse.Namespace) -> int:
    """Calibrate the coils."""
    path = options.required(arguments.site, "--site", "FILE")
    inputs = {"--site": path, "SAMPLES.csv": arguments.samples}
    check_outputs({"--out": arguments.out}, inputs, force=arguments.force)
    check_writable(arguments.out, "the site file")
    site = sites.load(path)
    options.tell_doubts(site)
    cycles = list(read_cycles(site, arguments.samples))
    places = [cycle.place_m for cycle in cycles if cycle.place_m is not None]
    if any((place != places[0]).any() for place in places):
        raise UserError(f"{arguments.samples}: the sensor stood in several places: give the cycles of one")
    place = np.array(arguments.at) if arguments.at else places[0] if places else None
    found = calibrate_coils(site, np.array([cycle.samples_T for cycle in cycles]), place)
    if arguments.out:
        revisions = {coil.beacon: _revision(site, coil) for coil in found}
        write_file(arguments.out, revised(Path(path), revisions).encode(), "the site file", force=arguments.force)
    if arguments.json:
        for coil in found:
            print(json_line(coil_record(coil)))
    else:
        print(_coils_text(found))
    return 0


def _revision(site: Site, coil: CoilCalibration) -> BeaconRevision:
    """Return what is new of a beacon: a time constant that is seen, or none if the file has one, and the polarity."""
    beacon = site.beacon(coil.beacon)
    tau_s = coil.tau_s if coil.tau_s or beacon.drive.tau_s else None
    return BeaconRevision(current_A=-beacon.current_A if coil.reversed else None, tau_s=tau_s)


def coil_record(coil: CoilCalibration) -> dict[str, Any]:
    """Return a coil's calibration under the keys of ``goldfield calibrate coils --json``."""
    return {
        "beacon": coil.beacon,
        "b_T": elements(coil.field_T),
        "tau_s": number(coil.tau_s),
        "tau_sd_s": None if coil.tau_sd_s is None else number(coil.tau_sd_s),
        "tau_below_s": number(coil.tau_below_s),
        "reversed": coil.reversed,
    }


def _coils_text(found: list[CoilCalibration]) -> str:
    width = max(6, *(len(coil.beacon) for coil in found))
    lines = [f"{'beacon':<{width}} {'tau/us':>10} {'+-':>8}  polarity"]
    for coil in found:
        tau = (
            f"{coil.tau_s * 1e6:10.2f} {coil.tau_sd_s * 1e6:8.2f}"
            if coil.tau_sd_s is not None
            else f"{f'< {coil.tau_below_s * 1e6:.2f}':>10} {'':>8}"
        )
        polarity = {None: "not known: give --at", True: "reversed", False: "as the site says"}[coil.reversed]
        lines.append(f"{coil.beacon:<{width}} {tau}  {polarity}")
    return "\n".join(lines)


def restore(arguments: argparse.Namespace) -> int:
    """Give a board what was kept of it."""
    kind, where = link_options.chosen(arguments)
    kept = load_kept(Path(arguments.sensors))
    board = board_calibration.read(kind, where, arguments.node, arguments.bit_rate)
    found = kept.get(board.unique_id)
    if found is None or found.zero is None or found.calibration is None:
        raise UserError(
            f"{arguments.sensors}: has no values for the board {board.unique_id} (node {board.node}): calibrate it"
        )
    key = link_options.key(arguments)
    board_calibration.write(kind, where, board, found.zero, found.calibration, key, arguments.bit_rate)
    print(f"written to board {board.unique_id}, node {board.node}: {board_calibration.HOLDS}")
    return 0


ACTIONS: dict[str, Callable[[argparse.Namespace], int]] = {"sensor": sensor, "coils": coils, "restore": restore}
