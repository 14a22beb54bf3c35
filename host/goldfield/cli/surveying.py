"""What ``goldfield survey`` does: it gathers what was measured, adjusts, writes the new site file, and reports."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from goldfield import site as sites
from goldfield.cli import link_options, options, survey_live
from goldfield.cli.output import json_line, number
from goldfield.cli.page_progress import SurveyProgress
from goldfield.cli.page_shown import shown
from goldfield.errors import Loudness, UserError, counted, loudness
from goldfield.files.outputs import check_outputs, check_writable, write_file
from goldfield.sensor.fields_table import read_fields
from goldfield.site import Site
from goldfield.site.metal import Metal, no_metal
from goldfield.site.revision import BeaconRevision, SensorRevision, revised
from goldfield.survey import Free, SurveyData, SurveyResult, procedure, survey
from goldfield.survey.data import AnchorFields, Known, MetalFound, Outlier, SensorPlace
from goldfield.survey.known_files import read_known, read_points
from goldfield.types import Fields

LINKS = ("port", "can", "log")
LIVE_OPTIONS = ("--node", "--seconds", "--enough", "--view")
"""Options of a survey that reads a sensor or a recording."""
MOST_OUTLIERS = 10
"""Lines on outliers in the table for people; those that follow each other with the same beacons share one."""


def make_survey(arguments: argparse.Namespace) -> int:
    """Survey, write the new site file, and print what was found."""
    path = options.required(arguments.site, "--site", "FILE")
    out = options.required(arguments.out, "--out", "NEW.toml")
    tables = [_named(text) for text in arguments.anchor]
    _check_anchors(tables)
    inputs = {"--site": path, "FIELDS.csv": arguments.fields, "--log": arguments.log}
    inputs |= {"--points": arguments.points, "--known": arguments.known}
    inputs |= {f"--anchor {name}": table for name, table in tables}
    check_outputs({"--out": out, "--map": arguments.map}, inputs, force=arguments.force)
    check_writable(out, "the new site file")
    if arguments.map:
        _check_map(arguments)
    site = sites.load(path)
    options.tell_doubts(site)
    told = read_known(arguments.known, site) if arguments.known else ()
    known = tuple(one for one in told if not isinstance(one, SensorPlace))
    anchors = _placed([_anchor(site, name, table) for name, table in tables], told)
    free = procedure.chosen_free(site, None if arguments.free is None else frozenset(map(Free, arguments.free)))

    def survey_of(epochs: Sequence[Fields], most: int | None = None) -> SurveyResult:
        points = read_points(arguments.points, epochs) if arguments.points else ()
        marked = {point.epoch for point in points}
        every = 1 if most is None else -(-len(epochs) // most)
        epochs = [fields for index, fields in enumerate(epochs) if index % every == 0 or fields.epoch in marked]
        with _progress(page) as told:
            return survey(site, SurveyData(tuple(epochs), points, known, anchors), free, told)

    with _page(arguments, site) as page:
        walk = _epochs(arguments, site, anchors, survey_of, page)
        result = survey_of(walk)
        text = revised(Path(path), *revisions(site, result), metal=_new_metal(site, result))
        try:
            write_file(out, text.encode(), "the new site file", force=arguments.force)
            if arguments.map:
                write_file(arguments.map, _residual_map(site, result, walk), "the residual map", force=arguments.force)
        finally:  # a walk must not be lost with a full disk
            print(json_line(record(result)) if arguments.json else table_of(site, result))
        if page is not None:
            page.say(f"Done: the beacons are known to {1e3 * result.deviation_m:.3g} mm; {out} is written.", result)
    return 0


@contextmanager
def _page(arguments: argparse.Namespace, site: Site) -> Iterator[SurveyProgress | None]:
    """Serve the live page, if a sensor or a recording is read and somebody asked for it."""
    if arguments.view is None or not any(getattr(arguments, kind) for kind in LINKS):
        yield None
        return
    kind, where = link_options.chosen(arguments)
    with shown(arguments, site, where, live=kind != "log") as page:
        yield None if page is None else SurveyProgress(page, arguments.enough)


def _check_map(arguments: argparse.Namespace) -> None:
    """Refuse, before the survey, a map that could not be written."""
    if not arguments.map.lower().endswith(".png"):
        raise UserError(f"--map {arguments.map}: the residual map is a picture: give a name that ends with .png")
    links = (arguments.fields, arguments.log, arguments.port, arguments.can)
    if not any(link is not None for link in links):
        raise UserError("--map draws the residuals of a walk, and there is none: give FIELDS.csv, --log or --port")
    check_writable(arguments.map, "the residual map")


def _residual_map(site: Site, result: SurveyResult, walk: Sequence[Fields]) -> bytes:
    """Return the picture of what the fields leave: without and with metal, else with the old and the new site."""
    from goldfield.survey.metal_picture import png  # heavy: only when something is drawn

    if result.metal is not None and result.site.metal is not None:
        return png(result.metal.without, result.site, walk, ("surveyed without metal", "surveyed with metal"))
    return png(site, result.site, walk, ("site file", "surveyed"))


def _named(text: str) -> tuple[str, str]:
    name, equals, table = text.partition("=")
    if not (name and equals and table):
        raise UserError(f"--anchor {text}: is no ID=FIELDS.csv: give the beacon's id and the table of its sensor")
    return name, table


def _check_anchors(tables: Sequence[tuple[str, str]]) -> None:
    """Refuse a beacon or a table that is given twice: it would count as two measurements."""
    for part in (0, 1):
        named = [table[part] for table in tables]
        twice = next((name for name in named if named.count(name) > 1), None)
        if twice is not None:
            raise UserError(f"--anchor names {twice} twice: give the table of each anchor's own sensor, once")


def _anchor(site: Site, name: str, path: str) -> AnchorFields:
    """Read what the sensor of an anchor measured, averaged over its epochs."""
    ids = [beacon.id for beacon in site.beacons]
    if name not in ids:
        raise UserError(f'--anchor {name}={path}: the site has no beacon "{name}"; it has {", ".join(ids)}')
    weight, total = np.zeros(len(ids)), np.zeros((len(ids), 3))
    for fields in read_fields(site, path):
        for beacon, field, sigma in zip(fields.beacons, fields.field_T, fields.sigma_T, strict=True):
            if np.isfinite(field).all():
                row = ids.index(beacon)
                weight[row] += sigma**-2
                total[row] += field * sigma**-2
    rows = np.flatnonzero(weight > 0.0)
    mean = total[rows] / weight[rows, None]
    return AnchorFields(name, Fields(0, 0.0, tuple(ids[row] for row in rows), mean, weight[rows] ** -0.5))


def _placed(anchors: Sequence[AnchorFields], told: Sequence[Known | SensorPlace]) -> tuple[AnchorFields, ...]:
    """Return the anchors with what was measured of where their sensors are."""
    places = {one.beacon: one for one in told if isinstance(one, SensorPlace)}
    unheard = places.keys() - {anchor.beacon for anchor in anchors}
    if unheard:
        name = sorted(unheard)[0]
        raise UserError(
            f"--known tells where the sensor of {name} is, and it measured nothing: give --anchor {name}=FILE"
        )
    return tuple(
        replace(one, lever_m=places[one.beacon].lever_m, lever_sd_m=places[one.beacon].sd_m)
        if one.beacon in places
        else one
        for one in anchors
    )


def _epochs(
    arguments: argparse.Namespace,
    site: Site,
    anchors: Sequence[AnchorFields],
    survey_of: survey_live.Survey,
    page: SurveyProgress | None,
) -> tuple[Fields, ...]:
    """Return the epochs of the table, the recording or the sensor; none if there are but anchors."""
    links = [kind for kind in LINKS if getattr(arguments, kind) is not None]
    if arguments.fields:
        if links:
            raise UserError(f"FIELDS.csv and --{links[0]} are both given: give one of them")
        options.tell_idle(arguments, LIVE_OPTIONS, "FIELDS.csv")
        return tuple(read_fields(site, arguments.fields))
    if not links and anchors:
        options.tell_idle(arguments, LIVE_OPTIONS, "--anchor alone")
        return ()
    if not links:
        raise UserError("nothing was measured: give FIELDS.csv, --log FILE, --port PATH or --anchor ID=FIELDS.csv")
    from goldfield.sensor.opening import open_sensor  # heavy: only when a sensor is read
    from goldfield.sensor.options import Options

    kind, where = link_options.chosen(arguments)
    if kind == "log":
        options.tell_idle(arguments, ("--enough",), "--log")
    choices = Options(
        node=arguments.node,
        seconds=arguments.seconds,
        key=link_options.key(arguments),
        bit_rate=arguments.bit_rate,
    )
    with open_sensor(kind, where, site, choices, None if page is None else page.recorder) as sensor:
        fields = sensor.fields() if page is None else page.fields(sensor)
        if not sensor.live:
            return tuple(fields)
        return survey_live.walk(
            fields, survey_of, arguments.enough, survey_live.on_stderr if page is None else page.say
        )


@contextmanager
def _progress(page: SurveyProgress | None) -> Iterator[procedure.Progress]:
    """Show what is being done: on stderr, if that is a terminal, and on the page, if there is one."""
    quiet = not sys.stderr.isatty() or loudness() is Loudness.QUIET
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True, disable=quiet) as bar:
        task = bar.add_task("survey", total=1.0)

        def told(what: str, part: float) -> None:
            bar.update(task, description=what, completed=part)
            if page is not None:
                page.compute(what, part)

        yield told


def revisions(site: Site, result: SurveyResult) -> tuple[dict[str, BeaconRevision], SensorRevision | None]:
    """Return what is new in the site file: what was estimated, with its deviations."""
    beacons = {}
    for old, new in zip(site.beacons, result.site.beacons, strict=True):
        beacons[old.id] = BeaconRevision(
            position_m=new.position_m if f"{old.id}.x_m" in result.parameters else None,
            axis=new.axis if f"{old.id}.axis_x" in result.parameters else None,
            current_A=new.current_A if new.current_A != old.current_A else None,
            survey=new.survey,
            metal_T_A=new.metal.harmonics_T_A if new.metal is not None and len(new.metal.harmonics_T_A) else None,
        )
    sensor = result.site.sensor
    gain, tilt = "sensor.gain_x" in result.parameters, "sensor.tilt_xy_rad" in result.parameters
    if sensor.axes is site.sensor.axes and sensor.lever_m is site.sensor.lever_m:
        return beacons, None
    return beacons, SensorRevision(
        axes=None if sensor.axes is site.sensor.axes else sensor.axes,
        lever_m=None if sensor.lever_m is site.sensor.lever_m else sensor.lever_m,
        gain_sd=sensor.gain_sd if gain else None,
        axis_sd_rad=sensor.axis_sd_rad if tilt else None,
    )


def _new_metal(site: Site, result: SurveyResult) -> Metal | None:
    """Return the metal that takes the place of what the site file says; None if that stays."""
    if result.site.metal is not None or site.metal is None:
        return result.site.metal
    return no_metal()


def record(result: SurveyResult) -> dict[str, Any]:
    """Return the result under the keys of ``goldfield survey --json``."""
    return {
        "residual_before": number(result.residual_before),
        "residual_after": number(result.residual_after),
        "parameters": {
            name: {"value": one.value, "sd": one.sd, "before": one.before} for name, one in result.parameters.items()
        },
        "outliers": [
            {"epoch": one.epoch, "beacons": list(one.beacons), "residual": number(one.residual)}
            for one in result.outliers
        ],
        "advice": list(result.advice),
        "metal": None if result.metal is None else _metal_record(result.site.metal, result.metal),
    }


def _metal_record(metal: Metal | None, found: MetalFound) -> dict[str, Any]:
    return {
        "degree": 0 if metal is None else metal.degree,
        "bodies_m": [] if metal is None else metal.body_m.tolist(),
        "sd_T_A": 0.0 if metal is None else metal.sd_T_A,
        "residual_without": number(found.residual_without),
        "residual_with": number(found.residual_with),
        "unseen_T": number(found.unseen_T),
    }


def _metal_lines(result: SurveyResult, found: MetalFound) -> list[str]:
    """Say what metal was found; or, as plainly, that it was looked for and is not told from noise."""
    metal = result.site.metal
    if metal is None:
        unseen = f"{1e9 * found.unseen_T:.2g} nT"
        lines = [
            "metal was looked for and not told from noise: the residual of epochs that were kept out is "
            f"{found.residual_without:.3g} without it (1: the noise alone), and no metal that was tried makes it less "
            f"by more than chance; metal that adds less than about {unseen} to a component would not have shown"
        ]
        if result.parameters:
            lines.append(
                "what such metal adds is then in the places, axes and currents that were found: believe changes of "
                "these only as far as metal can be ruled out, or survey with a steadier sensor or a longer walk"
            )
        return lines
    kept_out = f"the residual of epochs that were kept out is {found.residual_with:.3g}, without it "
    kept_out += f"{found.residual_without:.3g} (1: the noise alone)"
    count = len(metal.body_m)
    parts = ["a body"] if count == 1 else [f"{count} bodies"] if count else []
    parts += [f"polynomials of degree {metal.degree}"] if metal.degree else []
    return [f"metal was found, described by {' and '.join(parts)}", kept_out]


def table_of(site: Site, result: SurveyResult) -> str:
    """Return what was found for people: how far each beacon was off, how well it is known now, and what to do next."""
    lines = [
        f"{'beacon':<12}{'x_m':>10}{'y_m':>10}{'z_m':>10}{'sd_mm':>8}{'moved_mm':>10}{'turned_deg':>12}{'current':>10}"
    ]
    for old, new in zip(site.beacons, result.site.beacons, strict=True):
        moved = 1e3 * float(np.linalg.norm(new.position_m - old.position_m))
        turned = np.rad2deg(np.arccos(np.clip(old.axis @ new.axis, -1.0, 1.0)))
        place = "".join(f"{value:>10.4f}" for value in new.position_m)
        deviation = 1e3 * np.sqrt(3.0) * new.survey.position_sd_m
        ratio = 100.0 * (new.current_A / old.current_A - 1.0)
        lines.append(f"{old.id:<12}{place}{deviation:>8.2f}{moved:>10.1f}{turned:>12.2f}{ratio:>+9.2f}%")
    for name, one in result.parameters.items():
        if name.startswith("sensor."):
            lines.append(f"{name} = {one.value:.6g} +- {one.sd:.2g}")
    if result.metal is not None:
        lines += _metal_lines(result, result.metal)
    before = "" if np.isnan(result.residual_before) else f", {result.residual_before:.3g} before"
    lines.append(f"residual {result.residual_after:.3g}{before} (1: the noise alone)")
    lines += outlier_lines(result.outliers)
    return "\n".join([*lines, *result.advice])


def outlier_lines(outliers: Sequence[Outlier]) -> list[str]:
    """Name the outliers, a line for those of neighbouring epochs with the same beacons, and count what is over."""
    runs: list[list[Outlier]] = []
    for one in outliers:
        last = runs[-1][-1] if runs else None
        if last is not None and last.epoch + 1 == one.epoch and last.beacons == one.beacons:
            runs[-1].append(one)
        else:
            runs.append([one])
    lines = []
    for run in runs[:MOST_OUTLIERS]:
        of = f" of {', '.join(run[0].beacons)}" if run[0].beacons else ""
        which = f"epoch {run[0].epoch}" if len(run) == 1 else f"epochs {run[0].epoch} to {run[-1].epoch}"
        most = "" if len(run) == 1 else "up to "
        worst = max(one.residual for one in run)
        lines.append(f"{which}: the fields{of} do not agree (residual {most}{worst:.3g}): left out")
    over = sum(len(run) for run in runs[MOST_OUTLIERS:])
    if over:
        lines.append(f"and {counted(over, 'epochs')} more: left out")
    return lines
