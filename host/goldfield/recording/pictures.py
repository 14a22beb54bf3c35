"""The usual pictures of a run, on one page: track over plan, errors, residual of each beacon, rates and latency."""

from __future__ import annotations

import io
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from goldfield.errors import counted
from goldfield.foxglove.topics import FIELDS, LINE
from goldfield.recording.runs import Item
from goldfield.recording.tables import Column, PoseTable
from goldfield.site import Site
from goldfield.types import FloatArray, Pose, Status
from goldfield.view.coil_wires import wire_of
from goldfield.view.truth import Truth

SIZE_IN, DPI = (13.0, 9.5), 110
COLOURS = {
    Status.OK: "#1f77b4",
    Status.UNVERIFIED: "#e0a020",
    Status.WEAK: "#e07020",
    Status.AMBIGUOUS: "#9050c0",
    Status.INCONSISTENT: "#d03030",
    Status.FAILED: "#808080",
}
"""Colour of a pose in the track."""
COIL_COLOUR, SECOND_COLOUR = "#707070", "#b05090"
RATE_OVER_S = 1.0
"""Rates are those of spans of so long, s, or longer ones in a run of more than `MOST_SPANS`."""
MOST_SPANS = 4000
WIDE = 15.0
"""A largest value above so many medians is drawn in a logarithmic scale."""
NEAR = 0.06
"""Names of places that are nearer, as a share of the extent of all, would lie one on the other."""
ROOM = 0.07
"""Room above a coil for its name, as a share of the extent of all."""
MOST_NAMED = 12
"""Beacons that a legend has room for."""


@dataclass
class Errors:
    """Each pose beside the truth, in the order of the lines; NaN where the truth is silent."""

    position_m: list[float] = field(default_factory=list)
    attitude_rad: list[float] = field(default_factory=list)


def read(items: Iterable[Item], truth: Truth | None) -> tuple[PoseTable, Errors]:
    """Return the poses of a run and, with a truth, how far off each is."""
    poses, errors = PoseTable(), Errors()
    for item in items:
        if item.topic == FIELDS and truth is not None and item.record["t_s"] is not None:
            truth.follow(item.record["epoch"], item.record["t_s"])
        elif item.topic == LINE:
            poses.add(item)
            if truth is not None:
                error = truth.error_of(_pose(item.record))
                errors.position_m.append(error.position_m)
                errors.attitude_rad.append(error.attitude_rad)
    return poses, errors


def picture(name: str, poses: PoseTable, errors: Errors, site: Site | None) -> bytes:
    """Return the page as PNG.

    Parameters
    ----------
    name : str
        What stands above.
    poses : PoseTable
        One pose at least.
    errors : Errors
        Empty: the standard deviations that the poses tell are drawn instead.
    site : Site or None
        Its coils are drawn below the track.
    """
    from matplotlib.figure import Figure

    columns = poses.columns()
    figure = Figure(figsize=SIZE_IN, dpi=DPI, layout="constrained")
    grid = figure.subplot_mosaic([["plan", "plan", "side"], ["error", "error", "turn"], ["residual", "rate", "late"]])
    seconds = _seconds(columns)
    _track(grid["plan"], columns, site, (0, 1))
    _track(grid["side"], columns, site, (0, 2))
    _position_error(grid["error"], seconds, columns, errors)
    _attitude_error(grid["turn"], seconds, columns, errors)
    _residuals(grid["residual"], seconds, columns, poses.beacons)
    _rates(grid["rate"], seconds, columns)
    _latency(grid["late"], seconds, columns)
    figure.suptitle(f"{name}: {counted(len(poses), 'poses')}, {_share(columns['status'])}")
    file = io.BytesIO()
    figure.savefig(file, format="png")
    return file.getvalue()


def _seconds(columns: dict[str, Column]) -> FloatArray:
    """Return the times of the poses since the first; where the sensor's clock began again they go on."""
    steps = np.diff(columns["t_s"], prepend=columns["t_s"][:1])
    usual = float(np.median(steps[steps > 0.0])) if (steps > 0.0).any() else 0.0
    return np.asarray(np.cumsum(np.where(steps >= 0.0, steps, usual)))


def _track(axes: Any, columns: dict[str, Column], site: Site | None, plane: tuple[int, int]) -> None:
    across, up = plane
    beacons = [] if site is None else site.beacons
    wires_m = {beacon.id: wire_of(beacon)[:, [across, up]] for beacon in beacons}
    for wire_m in wires_m.values():
        axes.plot(*wire_m.T, color=COIL_COLOUR, linewidth=1.5)
    places_m = {beacon.id: beacon.position_m[[across, up]] for beacon in beacons}
    for place_m, ids in labels(places_m):
        top_m = max(float(wires_m[name][:, 1].max()) for name in ids)
        axes.annotate(", ".join(ids), (place_m[0], top_m), (0, 2), textcoords="offset points", fontsize=7, ha="center")
        axes.update_datalim([(place_m[0], top_m + ROOM * _extent_m(places_m))])
    place_m = columns["position_m"]
    axes.plot(place_m[:, across], place_m[:, up], color="#b0c8e0", linewidth=0.8, zorder=1)
    for status, colour in COLOURS.items():
        of = (columns["status"] == status.value) & np.isfinite(place_m).all(axis=1)
        if of.any():
            axes.scatter(place_m[of, across], place_m[of, up], s=6, color=colour, label=status.value, zorder=2)
    known = np.flatnonzero(np.isfinite(place_m).all(axis=1))
    if len(known):
        for row, marker, label in ((known[0], "^", "first"), (known[-1], "s", "last")):
            axes.plot(*place_m[row, [across, up]], marker, color="black", markersize=6, label=label, zorder=3)
        axes.legend(fontsize=7, loc="best")
    axes.set_aspect("equal", adjustable="datalim")
    _label(axes, "plan" if up == 1 else "from the side", f"{'xyz'[across]} / m", f"{'xyz'[up]} / m")


def labels(places_m: Mapping[str, FloatArray]) -> list[tuple[FloatArray, list[str]]]:
    """Return where names stand, and which: those of places that lie too near for two names share one label.

    Examples
    --------
    >>> labels({"b1": np.zeros(2), "b2": np.array([0.01, 0.0]), "b3": np.array([2.0, 1.0])})
    [(array([0., 0.]), ['b1', 'b2']), (array([2., 1.]), ['b3'])]
    """
    near_m = NEAR * _extent_m(places_m)
    found: list[tuple[FloatArray, list[str]]] = []
    for name, place_m in places_m.items():
        together = next((ids for other_m, ids in found if np.abs(other_m - place_m).max() <= near_m), None)
        if together is None:
            found.append((place_m, [name]))
        else:
            together.append(name)
    return found


def _extent_m(places_m: Mapping[str, FloatArray]) -> float:
    return float(np.ptp(list(places_m.values()), axis=0).max()) if places_m else 0.0


def _position_error(axes: Any, seconds: FloatArray, columns: dict[str, Column], errors: Errors) -> None:
    deviation_m = np.sqrt(np.trace(columns["position_cov_m2"], axis1=1, axis2=2))
    if errors.position_m:
        axes.plot(seconds, 1e3 * np.array(errors.position_m), ".", markersize=3, label="error", color="#1f77b4")
    axes.plot(seconds, 1e3 * deviation_m, color=SECOND_COLOUR, linewidth=1.0, label="standard deviation")
    if np.isfinite(columns["protection_m"]).any():
        axes.plot(seconds, 1e3 * columns["protection_m"], color="#e0a020", linewidth=1.0, label="protection level")
    _scaled(axes)
    axes.legend(fontsize=7)
    title = "position" if errors.position_m else "position: no truth given"
    if errors.position_m:
        title += f": error {_figure(1e3 * _rms(errors.position_m))} mm rms"
    _label(axes, title, "s", "mm")


def _attitude_error(axes: Any, seconds: FloatArray, columns: dict[str, Column], errors: Errors) -> None:
    deviation_rad = np.sqrt(np.trace(columns["attitude_cov_rad2"], axis1=1, axis2=2))
    if errors.attitude_rad:
        axes.plot(seconds, np.degrees(errors.attitude_rad), ".", markersize=3, label="error", color="#1f77b4")
    axes.plot(seconds, np.degrees(deviation_rad), color=SECOND_COLOUR, linewidth=1.0, label="standard deviation")
    _scaled(axes)
    axes.legend(fontsize=7)
    title = "attitude"
    if errors.attitude_rad:
        title += f": error {_figure(math.degrees(_rms(errors.attitude_rad)))} deg rms"
    _label(axes, title, "s", "deg")


def _residuals(axes: Any, seconds: FloatArray, columns: dict[str, Column], beacons: list[str]) -> None:
    worst: list[int] = np.argsort([-_rms(column) for column in columns["residuals"].T]).tolist() if beacons else []
    for rank, number in enumerate(worst):
        label = beacons[number] if rank < MOST_NAMED else None
        axes.plot(seconds, columns["residuals"][:, number], linewidth=0.7, label=label)
    axes.plot(seconds, columns["residual"], color="black", linewidth=1.0, label="all")
    axes.axhline(1.0, color="#b0b0b0", linewidth=0.8)
    _scaled(axes)
    axes.legend(fontsize=6, ncol=2)
    _label(axes, "residual of each beacon, 1 if all is well", "s", "")


def _rates(axes: Any, seconds: FloatArray, columns: dict[str, Column]) -> None:
    latest = float(np.nanmax(seconds, initial=0.0))
    span_s = max(RATE_OVER_S, latest / MOST_SPANS)
    edges = span_s * np.arange(max(2, math.ceil(latest / span_s) + 1))
    counts, _ = np.histogram(seconds[np.isfinite(seconds)], edges)
    good, _ = np.histogram(seconds[np.isfinite(seconds) & (columns["status"] == Status.OK.value)], edges)
    lost, _ = np.histogram(seconds, edges, weights=np.nan_to_num(columns["lost"]))
    axes.stairs(counts / span_s, edges, label="poses", color="#1f77b4", linewidth=2.0)
    axes.stairs(good / span_s, edges, label="ok", color="#30a060", fill=True, alpha=0.3)
    axes.stairs(lost / span_s, edges, label="messages lost", color="#d03030")
    axes.set_ylim(bottom=0.0)
    axes.legend(fontsize=7)
    _label(axes, "rates", "s", "1/s")


def _latency(axes: Any, seconds: FloatArray, columns: dict[str, Column]) -> None:
    arrived_ms, made_ms = 1e3 * (columns["arrived_s"] - columns["unix_s"]), 1e3 * columns["latency_s"]
    known = [(v, label, c) for v, label, c in ((arrived_ms, "arrival", "#1f77b4"), (made_ms, "pose", SECOND_COLOUR))]
    known = [one for one in known if np.isfinite(one[0]).any()]
    for values, label, colour in known:
        axes.plot(seconds, values, ".", markersize=2, label=label, color=colour)
    if known:
        axes.legend(fontsize=7)
        axes.set_ylim(bottom=0.0)
    else:
        axes.text(0.5, 0.5, "not told by this run", ha="center", va="center", transform=axes.transAxes)
    _label(axes, "latency, from the time of the pose", "s", "ms")


def _label(axes: Any, title: str, across: str, up: str) -> None:
    axes.set_title(title, fontsize=9)
    axes.set_xlabel(across, fontsize=8)
    axes.set_ylabel(up, fontsize=8)
    axes.tick_params(labelsize=7)
    axes.grid(alpha=0.25)


def _scaled(axes: Any) -> None:
    """Draw from 0 on, or if a few values are far above the others in a logarithmic scale."""
    drawn = np.concatenate([np.ravel(line.get_ydata()) for line in axes.get_lines()] or [np.zeros(0)]).astype(float)
    positive = drawn[np.isfinite(drawn) & (drawn > 0.0)]
    if len(positive) and positive.max() > WIDE * np.median(positive):
        axes.set_yscale("log")
        axes.yaxis.set_major_formatter("{x:g}")
        axes.yaxis.set_minor_formatter("")
    elif len(positive):
        axes.set_ylim(0.0, 1.08 * positive.max())  # matplotlib would lay a constant on the frame
    else:
        axes.set_ylim(bottom=0.0)


def _share(statuses: Column) -> str:
    names, counts = np.unique(statuses, return_counts=True)
    return ", ".join(f"{count} {name}" for name, count in sorted(zip(names, counts, strict=True), key=lambda x: -x[1]))


def _rms(values: Any) -> float:
    finite = np.asarray(values)[np.isfinite(values)]
    return math.sqrt(float(np.mean(finite**2))) if len(finite) else math.nan


def _figure(value: float) -> str:
    return f"{value:.3g}"


def _pose(record: dict[str, Any]) -> Pose:
    """Return what the truth asks of a pose."""
    nothing = np.full((3, 3), np.nan)
    located = record["position_m"] is not None
    return Pose(
        epoch=record["epoch"],
        time_s=math.nan if record["t_s"] is None else record["t_s"],
        position_m=np.array(record["position_m"]) if located else np.full(3, np.nan),
        orientation_xyzw=np.array(record["orientation_xyzw"]) if located else np.full(4, np.nan),
        position_cov_m2=nothing,
        attitude_cov_rad2=nothing,
        residual=math.nan,
        status=Status(record["status"]),
        used=(),
    )
