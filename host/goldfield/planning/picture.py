"""The maps of a plan as one picture: a row for each of some heights, a column for each of `LAYERS`."""

from __future__ import annotations

import io

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.image import AxesImage

from goldfield.planning.floor import Floor
from goldfield.planning.grid import extent
from goldfield.planning.layers import LAYERS, Layer, shown
from goldfield.planning.maps import Maps
from goldfield.types import FloatArray

MOST_HEIGHTS = 3
"""Heights that are drawn: the lowest, the middle and the highest of more."""

PANEL_IN = 4.2
"""Width of a map, inches."""

DOTS_PER_INCH = 110

TICKS = 5
"""Values that are written beside a scale."""


def png(maps: Maps, floor: Floor | None = None) -> bytes:
    """Return the picture as a PNG file; the same maps give the same picture.

    Parameters
    ----------
    maps : Maps
    floor : Floor, optional
        Drawn beneath.
    """
    heights = np.unique(np.linspace(0, len(maps.grid.z_m) - 1, MOST_HEIGHTS).round().astype(int))
    x0, x1, y0, y1 = extent(maps.grid.x_m, maps.grid.y_m)
    tall = PANEL_IN * min(max((y1 - y0) / (x1 - x0), 0.35), 2.0)
    size = (PANEL_IN * len(LAYERS), (tall + 0.7) * len(heights) + 1.2)
    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(len(heights), len(LAYERS), squeeze=False)
    for column, layer in enumerate(LAYERS):
        images = [_panel(panels[row, column], maps, layer, int(k), floor) for row, k in enumerate(heights)]
        label = f"{layer.title}, {layer.unit}"
        bar = figure.colorbar(
            images[0], ax=panels[:, column], label=label, location="bottom", aspect=30.0, fraction=0.05, extend="max"
        )
        low, high = layer.scale(maps.figures)
        ticks = np.geomspace(low, high, TICKS).tolist()
        bar.set_ticks(ticks, labels=[shown(tick) for tick in ticks])
        bar.ax.minorticks_off()
    figure.suptitle(title(maps), fontsize=9)
    buffer = io.BytesIO()
    figure.savefig(buffer, dpi=DOTS_PER_INCH, metadata={"Software": None})
    return buffer.getvalue()


def _panel(axes: Axes, maps: Maps, layer: Layer, height: int, floor: Floor | None) -> AxesImage:
    """Draw one map at one height."""
    grid, figures = maps.grid, maps.figures
    x0, x1, y0, y1 = extent(grid.x_m, grid.y_m)
    if floor is not None:
        left, low, right, high = floor.extent_m
        axes.imshow(floor.pixels(), extent=(left, right, low, high), origin="upper", interpolation="bilinear")
    low_value, high_value = layer.scale(figures)
    values = np.minimum(layer.values(figures)[:, :, height], high_value)
    image = axes.imshow(
        values.T,
        extent=(x0, x1, y0, y1),
        origin="lower",
        cmap="viridis_r",
        norm=LogNorm(low_value, high_value),
        alpha=1.0 if floor is None else 0.65,
        interpolation="nearest",
    )
    _hatch(axes, maps, height)
    here = _beacons_on(maps)
    size = float(np.clip(300.0 / max(1, len(here)), 0.4, 5.0))
    axes.plot(*here.T, "o", markersize=size, color="white", markeredgecolor="black", markeredgewidth=size / 6)
    axes.set(xlim=(x0, x1), ylim=(y0, y1), aspect="equal", xlabel="x, m", ylabel="y, m")
    axes.set_title(f"{layer.title}, z = {grid.z_m[height]:g} m", fontsize=9)
    return image


def _beacons_on(maps: Maps) -> FloatArray:
    """Return x and y of the beacons that are on the maps, m, shape (n, 2)."""
    x0, x1, y0, y1 = extent(maps.grid.x_m, maps.grid.y_m)
    place = maps.beacon_position_m[:, :2]
    return np.asarray(place[((place >= (x0, y0)) & (place <= (x1, y1))).all(axis=1)])


def _hatch(axes: Axes, maps: Maps, height: int) -> None:
    """Hatch where poses are ambiguous (lines) or weak (crosses)."""
    grid = maps.grid
    if min(len(grid.x_m), len(grid.y_m)) < 2:
        return
    for marked, pattern in ((maps.figures.ambiguous, "///"), (maps.figures.weak, "xxx")):
        layer = marked[:, :, height].astype(float)
        if layer.any():
            axes.contourf(grid.x_m, grid.y_m, layer.T, levels=[0.5, 1.5], colors="none", hatches=[pattern])


def title(maps: Maps) -> str:
    """Say in a line what the maps show, and whether the beacons are on them."""
    summary, on = maps.summary(), len(_beacons_on(maps))
    dots = "dots" if on == summary["beacons"] else f"dots: {on}, the others are outside of the map" if on else "outside"
    return (
        f"{summary['beacons']} beacons ({dots}), {summary['points']} points; "
        f"/ ambiguous {100 * summary['ambiguous']:.3g} %, x weak {100 * summary['weak']:.3g} %"
    )
