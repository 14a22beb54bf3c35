"""What no pose explains of the fields of a walk, drawn in plan view: before and after, by place and by beacon.

A residual is what is left of a beacon's field at the pose that fits an epoch best, over its standard deviation: 1 is
noise alone. Poses are fitted anew with each of two sites, beacons and metal taken as exact.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PathCollection
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from scipy.spatial import ConvexHull

from goldfield.field import FieldModel
from goldfield.locate.constellation import Constellation
from goldfield.site import Site
from goldfield.survey.data import SurveyData
from goldfield.survey.parameters import start_of
from goldfield.survey.problem import problem_of
from goldfield.survey.starts import located, measurements_of
from goldfield.types import Fields, FloatArray

SCALE = (0.7, 7.0)
"""Residuals at the ends of the scale of colours."""
TICKS = (0.7, 1.0, 2.0, 4.0, 7.0)
PANEL_IN, DOTS_PER_INCH = 5.2, 110
BEACON_SIZE = (230.0, 60.0)
"""Areas of the lowest and the highest beacon, points^2: one above another is seen inside it."""


@dataclass(frozen=True, eq=False)
class Residuals:
    """Residuals of e epochs.

    Attributes
    ----------
    position_m : ndarray, shape (e, 3)
        Best poses; NaN where there is none.
    of_field : ndarray, shape (e, n)
        Root of the mean square over the components of each beacon's field; NaN where not measured.
    """

    position_m: FloatArray
    of_field: FloatArray

    @property
    def of_epoch(self) -> FloatArray:
        """Root of the mean square over the beacons, shape (e,)."""
        return _rms(self.of_field, 1)

    @property
    def of_beacon(self) -> FloatArray:
        """Root of the mean square over the epochs, shape (n,)."""
        return _rms(self.of_field, 0)


def residuals(site: Site, epochs: Sequence[Fields]) -> Residuals:
    """Return what the best poses leave of the fields of epochs."""
    problem = problem_of(site, SurveyData(tuple(epochs)), frozenset())
    measurements = measurements_of(problem, start_of(site, len(epochs), 0), 0.0)
    model = FieldModel(site.beacons)
    fit = located(Constellation(model, site.half_space), measurements)
    found = np.isfinite(fit.cost)
    position = np.where(found[:, None], fit.position_m, np.nan)
    field = model.field(np.where(found[:, None], fit.position_m, 0.0))
    left = measurements.field_T - np.einsum("eji,enj->eni", fit.rotation, field)
    count = 3.0 * measurements.known.sum(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        per_freedom = np.sqrt(count / np.where(found & (count > 6.0), count - 6.0, np.nan))
    size = _rms(left / measurements.sigma_T[..., None], 2) * per_freedom[:, None]
    return Residuals(position, size)


def png(before: Site, after: Site, epochs: Sequence[Fields], titles: tuple[str, str] = ("before", "after")) -> bytes:
    """Return the picture as a PNG file; the same sites and epochs give the same picture.

    Parameters
    ----------
    before, after : Site
        With the same beacons.
    epochs : sequence of Fields
    titles : pair of str
        What the two are.
    """
    both = [residuals(site, epochs) for site in (before, after)]
    places = both[1].position_m
    figure = Figure(figsize=(2.0 * PANEL_IN, PANEL_IN + 2.6), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplot_mosaic([["before", "after"], ["bars", "bars"]], height_ratios=[2.6, 1.0])
    for name, site, one, title in zip(("before", "after"), (before, after), both, titles, strict=True):
        dots = _plan(panels[name], site, one, places)
        panels[name].set_title(f"{title}: {_rms(one.of_epoch, 0):.2f}", fontsize=10)
    _alike(panels["before"], panels["after"])
    bar = figure.colorbar(
        dots, ax=[panels["before"], panels["after"]], label="residual (1: noise alone)", extend="both"
    )
    bar.set_ticks(list(TICKS), labels=[f"{tick:g}" for tick in TICKS])
    bar.ax.minorticks_off()
    _bars(panels["bars"], [beacon.id for beacon in after.beacons], both, titles)
    buffer = io.BytesIO()
    figure.savefig(buffer, dpi=DOTS_PER_INCH, metadata={"Software": None})
    return buffer.getvalue()


def _plan(axes: Axes, site: Site, one: Residuals, place_m: FloatArray) -> PathCollection:
    """Draw the epochs where they were, the beacons, and the metal: its bodies and the room in which it was learned."""
    style: dict[str, Any] = {"cmap": "viridis", "norm": LogNorm(*SCALE)}
    dots = axes.scatter(place_m[:, 0], place_m[:, 1], c=one.of_epoch, s=14.0, linewidths=0.0, **style)
    beacons = np.array([beacon.position_m for beacon in site.beacons])
    low, high = beacons[:, 2].min(), beacons[:, 2].max()
    share = (beacons[:, 2] - low) / max(high - low, 1e-9)
    order = np.argsort(share, kind="stable")
    size = (BEACON_SIZE[0] + share * (BEACON_SIZE[1] - BEACON_SIZE[0]))[order]
    axes.scatter(
        beacons[order, 0],
        beacons[order, 1],
        c=one.of_beacon[order],
        s=size,
        marker="s",
        edgecolors="black",
        linewidths=0.8,
        **style,
    )
    for place, name in _labels(site):
        axes.annotate(name, place, xytext=(0.0, 9.0), textcoords="offset points", ha="center", fontsize=7)
    if site.metal is not None:
        if len(site.metal.walked_m):
            outline = ConvexHull(site.metal.walked_m[:, :2])
            corners = site.metal.walked_m[outline.vertices, :2]
            axes.fill(*corners.T, fill=False, edgecolor="grey", linestyle=":", label="surveyed room")
        if len(site.metal.body_m):
            axes.scatter(*site.metal.body_m[:, :2].T, marker="x", color="tab:red", label="bodies of metal")
        axes.legend(fontsize=7, loc="best")
    axes.set_aspect("equal")
    axes.set_xlabel("x, m")
    axes.set_ylabel("y, m")
    return dots


def _alike(*panels: Axes) -> None:
    """Let panels show the same part of the room."""
    low = np.min([[axes.get_xlim()[0], axes.get_ylim()[0]] for axes in panels], axis=0)
    high = np.max([[axes.get_xlim()[1], axes.get_ylim()[1]] for axes in panels], axis=0)
    for axes in panels:
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))


def _labels(site: Site) -> list[tuple[tuple[float, float], str]]:
    """Return the names of beacons that stand one above another together, with where they stand."""
    groups: dict[tuple[float, float], list[str]] = {}
    for beacon in site.beacons:
        x, y = beacon.position_m[:2].tolist()
        near = next((key for key in groups if np.hypot(key[0] - x, key[1] - y) < 0.1), (x, y))
        groups.setdefault(near, []).append(beacon.id)
    return [(place, ", ".join(names)) for place, names in groups.items()]


def _bars(axes: Axes, names: Sequence[str], both: Sequence[Residuals], titles: tuple[str, str]) -> None:
    """Draw the residuals of the beacons side by side."""
    at = np.arange(len(names))
    for shift, one, title, colour in zip((-0.2, 0.2), both, titles, ("tab:orange", "tab:blue"), strict=True):
        axes.bar(at + shift, one.of_beacon, 0.4, label=title, color=colour)
    axes.axhline(1.0, color="black", linewidth=0.8)
    axes.set_xticks(at, names, fontsize=7, rotation=90 if len(names) > 16 else 0)
    axes.set_ylabel("residual")
    axes.set_ylim(bottom=0.0)
    axes.legend(fontsize=7)


def _rms(values: FloatArray, axis: int) -> FloatArray:
    """Return the root of the mean square of what is known along an axis; NaN where nothing is."""
    known = np.isfinite(values)
    total = np.where(known, values, 0.0) ** 2
    count = known.sum(axis=axis)
    return np.asarray(np.sqrt(total.sum(axis=axis) / np.where(count > 0, count, np.nan)))
