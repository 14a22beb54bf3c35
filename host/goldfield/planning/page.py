"""The maps of a plan as one HTML page that needs nothing else: a map at any height, the figures as tables."""

from __future__ import annotations

import base64
import json
import math
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import NDArray

from goldfield.planning.floor import Floor
from goldfield.planning.grid import extent
from goldfield.planning.layers import LAYERS, MORE_LAYERS, Layer, shown
from goldfield.planning.maps import Maps

MOST_POINTS = 300_000
"""Points that a page holds: of more, every second or third along x and y is left."""

NONE, STEPS = 65535, 65534
"""Code of a point without a bound, and the largest of the others, which are logarithmic between least and most."""

Json = dict[str, Any]


def html(maps: Maps, floor: Floor | None = None) -> bytes:
    """Return the page; the same maps give the same page.

    Parameters
    ----------
    maps : Maps
    floor : Floor, optional
        Drawn beneath the maps.
    """
    template = files("goldfield.planning").joinpath("page.html").read_text(encoding="utf-8")
    data = json.dumps(_data(maps, floor), allow_nan=False, separators=(",", ":"))
    return template.replace("/*DATA*/", data.replace("<", "\\u003c")).encode()


def _data(maps: Maps, floor: Floor | None) -> Json:
    grid, figures = maps.grid, maps.figures
    every = max(1, math.ceil(math.sqrt(len(grid) / MOST_POINTS)))
    some = slice(None, None, every)
    x, y = grid.x_m[some], grid.y_m[some]
    marks = figures.ambiguous[some, some].astype(np.uint8) + 2 * figures.weak[some, some].astype(np.uint8)
    x0, x1, y0, y1 = extent(x, y)
    place = maps.beacon_position_m
    here = (place[:, 0] >= x0) & (place[:, 0] <= x1) & (place[:, 1] >= y0) & (place[:, 1] <= y1)
    return {
        "shape": marks.shape,
        "extent": [x0, x1, y0, y1],
        **{name: np.round(axis, 6).tolist() for name, axis in (("x", x), ("y", y), ("z", grid.z_m))},
        "layers": [_layer(layer, maps, some) for layer in (*LAYERS, *MORE_LAYERS)],
        "marks": _base64(marks),
        "beacons": np.round(place[here, :2], 3).tolist(),
        "floor": None if floor is None else _floor(floor),
        "about": _about(maps, every),
        "figures": _figures(maps),
        "heights": _heights(maps),
    }


def _layer(layer: Layer, maps: Maps, some: slice) -> Json:
    values = layer.values(maps.figures)
    bottom, top = layer.scale(maps.figures)
    finite = values[np.isfinite(values) & (values > 0.0)]
    least, most = (float(finite.min()), float(finite.max())) if len(finite) else (1.0, 1.0)
    most = max(most, 1.0001 * least)
    values = values[some, some]
    with np.errstate(all="ignore"):
        part = np.log(values / least) / math.log(most / least)
    code = np.where(np.isfinite(values), np.clip(np.nan_to_num(part), 0.0, 1.0) * STEPS, NONE).round()
    return {
        "title": layer.title,
        "unit": layer.unit,
        "least": least,
        "most": most,
        "bottom": bottom,
        "top": top,
        "codes": _base64(code.astype("<u2")),
    }


def _about(maps: Maps, every: int) -> str:
    summary = maps.summary()
    text = (
        f"{summary['beacons']} beacons, {summary['points']} points; the pose is ambiguous at "
        f"{100 * summary['ambiguous']:.3g} % of them, weak at {100 * summary['weak']:.3g} %. {summary['codes']} codes "
        "are enough."
    )
    return text if every == 1 else f"{text} The maps show one point of {every} along x and y; the figures are of all."


def _figures(maps: Maps) -> list[Json]:
    rows = []
    for layer in (*LAYERS, *MORE_LAYERS):
        values = np.sort(layer.values(maps.figures), axis=None)
        last = len(values) - 1
        chosen = [float(values[math.ceil(part * last)]) for part in (0.5, 0.95, 1.0)]
        rows.append({"title": layer.title, "unit": layer.unit, "values": [_finite(value) for value in chosen]})
    return rows


def _heights(maps: Maps) -> Json:
    """Return a table of each height: the maps as text."""
    names = ["height"]
    names += [f"{layer.title}, {which}, {layer.unit}" for layer in LAYERS for which in ("median", "worst")]
    names += ["ambiguous, %", "weak, %"]
    rows = []
    for k, z in enumerate(maps.grid.z_m):
        row = [f"{z:g} m"]
        for layer in LAYERS:
            values = layer.values(maps.figures)[:, :, k]
            row += [shown(float(np.median(values))), shown(float(values.max()))]
        row += [f"{100 * mark[:, :, k].mean():.3g}" for mark in (maps.figures.ambiguous, maps.figures.weak)]
        rows.append(row)
    return {"names": names, "rows": rows}


def _floor(floor: Floor) -> Json:
    source = f"data:{floor.kind};base64,{base64.b64encode(floor.data).decode()}"
    return {"source": source, "extent": list(floor.extent_m)}


def _base64(array: NDArray[Any]) -> str:
    return base64.b64encode(np.ascontiguousarray(array).tobytes()).decode()


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
