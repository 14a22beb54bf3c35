"""Coils as people make them: what is measured of one, its sides or radius, turns and layers, becomes its wire.

Each wire is drawn in the coil's own frame: its centre at the origin, its axis along z, its current turning from x to y.
It returns to where it began: a link that never returns would be an open element of current.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from goldfield.files.toml_table import Table
from goldfield.site.plausible import MOST_POINTS, check_place, checked
from goldfield.types import FloatArray

PIECES = 32
"""Straight pieces of a round turn. Its radius is enlarged by .3 %, so that it has the area of the round one and, from
afar, its field."""


def wire_of(table: Table, doubts: list[str]) -> FloatArray:
    """Return the wire of a coil's shape in the coil's own frame, m, shape (n, 3); its last point is its first one.

    Parameters
    ----------
    table : Table
        A ``[[beacon]]`` with the key ``shape``, one of `SHAPES`, and what that one needs.
    doubts : list of str
        Gets a sentence for each unusual length.

    Raises
    ------
    UserError
        If a value is missing, out of range, or of no use for this shape.
    """
    shape = table.text("shape")
    if shape not in SHAPES:
        raise table.error("shape", f'is "{shape}"; shapes are {", ".join(SHAPES)}')
    draw, keys = SHAPES[shape]
    for key in (*SIZE_KEYS, "radius_m", "points_m"):
        if key in table and key not in keys:
            raise table.error(key, f"is no key of a {shape}, which has {', '.join(keys)}: leave it out")
    wire = draw(table, doubts)
    wire = np.concatenate([wire, wire[:1]])
    check_place(table, "shape", wire)
    return wire


def placed(wire_m: FloatArray, position_m: FloatArray, axis: FloatArray, angle_rad: float) -> FloatArray:
    """Return a wire in the site's frame, of one in the coil's own, both of shape (n, 3).

    The coil is turned about its axis by the angle first; then the smallest rotation takes its z to ``axis``.
    """
    return np.asarray(position_m + wire_m @ frame(axis, angle_rad).T)


def frame(axis: FloatArray, angle_rad: float) -> FloatArray:
    """Return the rotation matrix from a coil's own frame to the site's; see `placed`."""
    cosine, sine = math.cos(angle_rad), math.sin(angle_rad)
    about_z = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(smallest_rotation(np.array([0.0, 0.0, 1.0]), axis) @ about_z)


def angle_of(rotation: FloatArray) -> float:
    """Return the angle about its axis of a coil of which the rotation to the site's frame is known: inverse of `frame`.

    Examples
    --------
    >>> round(angle_of(frame(np.array([0.0, 0.6, 0.8]), 0.5)), 12)
    0.5
    """
    about_z = frame(rotation[:, 2], 0.0).T @ rotation
    return math.atan2(about_z[1, 0], about_z[0, 0])


def smallest_rotation(old: FloatArray, new: FloatArray) -> FloatArray:
    """Return the rotation matrix of the smallest angle that turns one unit vector into another.

    For opposite vectors it is half a turn about one of the axes at right angles to them; from z to -z about y.

    Parameters
    ----------
    old, new : ndarray, shape (3,)

    Examples
    --------
    >>> smallest_rotation(np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])) @ [1.0, 0.0, 0.0]
    array([ 0.,  0., -1.])
    """
    cosine = float(old @ new)
    if cosine > -0.5:
        x, y, z = np.cross(old, new)
        cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        return np.asarray(np.eye(3) + cross + cross @ cross / (1.0 + cosine))
    # Far apart: half a turn about an axis at right angles to the old one and near the plane of both, then the rest.
    away = new - cosine * old
    if np.linalg.norm(away) < 1e-8:
        away = np.eye(3)[np.argmin(np.abs(old))]
        away = away - (away @ old) * old
    normal = np.cross(old, away / np.linalg.norm(away))
    half = 2.0 * np.outer(normal, normal) / (normal @ normal) - np.eye(3)
    return np.asarray(smallest_rotation(-old, new) @ half)


def _rectangle(table: Table, doubts: list[str]) -> FloatArray:
    x, y = 0.5 * _sides(table, doubts)
    return np.array([[x, y, 0.0], [-x, y, 0.0], [-x, -y, 0.0], [x, -y, 0.0]])


def _square_spiral(table: Table, doubts: list[str]) -> FloatArray:
    """Draw sides at right angles, from outside inward, in the next layer outward again, and so on."""
    (turns, layers), pitch = _counts(table, 4), _length(table, "pitch_m", doubts)
    sides = _sides(table, doubts)
    if 2.0 * pitch * turns >= sides.min():
        raise table.error("turns", f"are {turns} with a pitch of {pitch:g} m: they do not fit into {sides.min():g} m")

    def inward(half_x: float, half_y: float) -> FloatArray:
        corners = [(half_x, half_y)]
        for turn in range(turns):
            x, y = half_x - turn * pitch, half_y - turn * pitch
            corners += [(-x, y), (-x, -y), (x, -y), (x, y - pitch)]
        return np.array(corners)

    x, y = 0.5 * sides
    # Mirrored at the diagonal and run through the other way, a spiral turns in the same sense again.
    return _layered(_heights(table, layers, doubts), inward(x, y), inward(y, x)[::-1, ::-1])


def _round_spiral(table: Table, doubts: list[str]) -> FloatArray:
    (turns, layers), pitch = _counts(table, PIECES), _length(table, "pitch_m", doubts)
    radius = _length(table, "radius_m", doubts)
    if pitch * turns >= radius:
        raise table.error("turns", f"are {turns} with a pitch of {pitch:g} m: they do not fit into {radius:g} m")
    turned = np.arange(turns * PIECES + 1) / PIECES
    inward, outward = (_round(turned, radius - pitch * steps) for steps in (turned, turned[::-1]))
    return _layered(_heights(table, layers, doubts), inward, outward)


def _layered(heights_m: FloatArray, inward: FloatArray, outward: FloatArray) -> FloatArray:
    """Stack flat layers, shape (n, 2) each: the first one runs inward, the next outward, and so on."""
    flat = [outward if layer % 2 else inward for layer in range(len(heights_m))]
    return np.concatenate([np.insert(part, 2, z, axis=1) for part, z in zip(flat, heights_m, strict=True)])


def _heights(table: Table, layers: int, doubts: list[str]) -> FloatArray:
    return np.asarray(_gap(table, layers, doubts) * (np.arange(layers) - 0.5 * (layers - 1)))


def _solenoid(table: Table, doubts: list[str]) -> FloatArray:
    """Wind a helix, the next layer about it back, and so on; the last end returns to the first straight."""
    turns, layers = _counts(table, PIECES)
    radius, length = _length(table, "radius_m", doubts), _length(table, "length_m", doubts)
    gap = _gap(table, layers, doubts)
    turned = np.arange(turns * PIECES + 1) / PIECES
    rising = length * (turned / turns - 0.5)
    windings = []
    for layer in range(layers):
        flat = _round(turned, np.full(len(turned), radius + layer * gap))
        windings.append(np.column_stack([flat, -rising if layer % 2 else rising]))
    return np.concatenate(windings)


def _round(turned: FloatArray, radius_m: FloatArray) -> FloatArray:
    """Return points, shape (n, 2), at angles in turns, such that the pieces between them enclose the arcs' area."""
    angle, piece = 2.0 * math.pi * turned, 2.0 * math.pi / PIECES
    enlarged = radius_m * math.sqrt(piece / math.sin(piece))
    return np.column_stack([enlarged * np.cos(angle), enlarged * np.sin(angle)])


def _sides(table: Table, doubts: list[str]) -> FloatArray:
    sides = table.numbers("sides_m")
    if len(sides) != 2 or (sides <= 0.0).any():
        raise table.error("sides_m", "must be two lengths above zero, along the coil's own x and y")
    for side in sides.tolist():
        checked(table, "sides_m", side, doubts)
    return sides


def _length(table: Table, key: str, doubts: list[str]) -> float:
    return checked(table, key, table.positive(key), doubts)


def _gap(table: Table, layers: int, doubts: list[str]) -> float:
    return _length(table, "layer_pitch_m", doubts) if layers > 1 or "layer_pitch_m" in table else 0.0


def _counts(table: Table, pieces: int) -> tuple[int, int]:
    """Return the turns of a layer and the layers, of a wire with so many straight pieces a turn."""
    most = MOST_POINTS // pieces - 1
    turns, layers = table.number("turns"), table.number("layers") if "layers" in table else 1.0
    for key, count in (("turns", turns), ("layers", layers)):
        if not (count.is_integer() and count >= 1.0):
            raise table.error(key, f"is {count:g}; a wire that is drawn turn by turn has whole ones, 1 or more")
    if turns * layers > most:
        raise table.error(
            "turns",
            f"are {turns * layers:g} with all layers; at most {most} are drawn: give a circle of the same area by "
            "radius_m and turns without a shape, or fewer turns and a larger current_A",
        )
    return int(turns), int(layers)


Draw = Callable[[Table, list[str]], FloatArray]
LAYER_KEYS = ("turns", "layers", "layer_pitch_m")
SHAPES: dict[str, tuple[Draw, tuple[str, ...]]] = {
    "rectangle": (_rectangle, ("sides_m", "turns")),
    "square_spiral": (_square_spiral, ("sides_m", "pitch_m", *LAYER_KEYS)),
    "round_spiral": (_round_spiral, ("radius_m", "pitch_m", *LAYER_KEYS)),
    "solenoid": (_solenoid, ("radius_m", "length_m", *LAYER_KEYS)),
}
"""What draws each shape, and the keys that it has beside its place and direction."""

SIZE_KEYS = ("sides_m", "pitch_m", "length_m", "layers", "layer_pitch_m")
SHAPE_KEYS = ("shape", "angle_rad", *SIZE_KEYS)
"""Keys that only a coil with a shape has."""
