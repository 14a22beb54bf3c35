"""Seeded rooms with metal: coupled sheets, beams as chains of iron balls, large balls; and walks in them.

No metal is of a kind that a survey fits: sheets are grids of current loops and large balls dipoles inside that make
the field on the surface right (`hil_sim.world`), a beam is a row of balls that magnetise each other. The coils' fields
are magpylib's.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import magpylib
import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator
from scipy.spatial.transform import Rotation

from goldfield.site import Site
from goldfield.survey.data import KnownPoint, SurveyData
from goldfield.types import Fields
from hil_sim.world.ball import Ball
from hil_sim.world.metal import Body, Metal
from hil_sim.world.sheet import Sheet
from tests.bench.integrity_coils import Coils
from tests.bench.integrity_sites import EXACT, Errors, told
from tests.bench.locate_trials import CHIPS
from tests.bench.survey_trials import POINT_SD_M, FloatArray, Room, cube, fields_of, walk

MU_0 = 4e-7 * np.pi
magnets: Any = magpylib  # it carries no types


class Loop:
    """A circular coil of magpylib, one ampere-turn."""

    def __init__(self, centre_m: FloatArray, axis: FloatArray, radius_m: float) -> None:
        turn = Rotation.align_vectors(axis[None], np.array([[0.0, 0.0, 1.0]]))[0]
        self._coil = magnets.current.Circle(diameter=2.0 * radius_m, current=1.0, position=centre_m, orientation=turn)

    def field_per_ampere(self, positions_m: FloatArray) -> FloatArray:
        """Return the field, shape (n, 3)."""
        return np.asarray(self._coil.getB(positions_m)).reshape(-1, 3)


class Beam:
    """A bar of iron as a row of balls, each a dipole in the field of all others; not a `Body`."""

    def __init__(self, start_m: FloatArray, end_m: FloatArray, radius_m: float) -> None:
        count = int(np.linalg.norm(end_m - start_m) / (2.2 * radius_m))
        self.place_m = start_m + np.linspace(0.0, 1.0, count)[:, None] * (end_m - start_m)
        polarisability = 4.0 * np.pi * radius_m**3 / MU_0
        others = _dipoles(self.place_m[:, None] - self.place_m)  # (to, from, 3, 3)
        others[np.arange(count), np.arange(count)] = 0.0
        system = np.eye(3 * count) - polarisability * others.transpose(0, 2, 1, 3).reshape(3 * count, 3 * count)
        self._answer = polarisability * np.linalg.inv(system)

    def added(self, loop: Loop, positions_m: FloatArray) -> FloatArray:
        """Return what the beam adds to a loop's field."""
        moments = (self._answer @ loop.field_per_ampere(self.place_m).ravel()).reshape(-1, 3)
        return np.asarray(np.einsum("ekij,kj->ei", _dipoles(positions_m[:, None] - self.place_m), moments))


def _dipoles(away_m: FloatArray) -> FloatArray:
    """Return the field by the moment, shape (..., 3, 3)."""
    distance = np.maximum(np.linalg.norm(away_m, axis=-1), 1e-9)[..., None, None]
    along = away_m[..., :, None] * away_m[..., None, :]
    return np.asarray(1e-7 * (3.0 * along / distance**5 - np.eye(3) / distance**3))


Added = Callable[[Loop, FloatArray], FloatArray]


def _of_bodies(bodies: list[Body]) -> Added:
    metal = Metal(bodies)

    def added(loop: Loop, positions_m: FloatArray) -> FloatArray:
        return metal.field(metal.strengths(loop), positions_m)

    return added


def _beside(rng: np.random.Generator, room: Room, side: int, gap_m: float) -> tuple[FloatArray, FloatArray]:
    """Return a place beside the beacons, behind one of four walls, and the direction inward."""
    places = np.array([beacon.position_m for beacon in room.site.beacons])
    low, high = places.min(axis=0), places.max(axis=0)
    axis, far = side % 2, side // 2 % 2
    place = low + (high - low) * rng.uniform(0.2, 0.8, 3)
    place[axis] = high[axis] + gap_m if far else low[axis] - gap_m
    inward = np.zeros(3)
    inward[axis] = -1.0 if far else 1.0
    return place, inward


def metal_of(kind: str, rng: np.random.Generator, room: Room, moved_m: tuple[float, float] = (0.0, 0.0)) -> Added:
    """Return the metal of a room: ``plates``, ``beams``, ``spheres`` or ``none``, 25 to 60 cm outside the beacons.

    The first of plates stands ``moved_m`` from where it would: so far into the room, and so far along its wall.
    """
    sides = rng.permutation(4)
    if kind == "none":
        return lambda loop, positions_m: np.zeros((len(positions_m), 3))
    if kind == "plates":
        sheets: list[Body] = []
        for side in sides[:3]:
            place, inward = _beside(rng, room, int(side), rng.uniform(0.25, 0.6))
            normal = inward + 0.2 * rng.normal(size=3)
            if not sheets:
                along = np.cross([0.0, 0.0, 1.0], inward)
                place = place + moved_m[0] * inward + moved_m[1] * along
            sheets.append(Sheet(place, normal / np.linalg.norm(normal), rng.uniform(0.7, 1.1)))
        return _of_bodies(sheets)
    if kind == "spheres":
        balls: list[Body] = []
        for side in sides[:3]:
            radius = rng.uniform(0.25, 0.4)
            place, _ = _beside(rng, room, int(side), radius + rng.uniform(0.25, 0.6))
            balls.append(Ball(place, radius, str(rng.choice(["conductor", "iron"]))))
        return _of_bodies(balls)
    assert kind == "beams"
    beams = []
    for side in sides[:2]:
        place, inward = _beside(rng, room, int(side), rng.uniform(0.3, 0.6))
        along = np.cross(inward, rng.normal(size=3))
        along *= rng.uniform(1.0, 1.5) / np.linalg.norm(along)
        beams.append(Beam(place - along, place + along, rng.uniform(0.05, 0.07)))
    return lambda loop, positions_m: sum((beam.added(loop, positions_m) for beam in beams), np.zeros(3))


@dataclass(frozen=True)
class MetalTrial:
    """A survey to be made in a room with metal, and epochs for judging it afterwards.

    Attributes
    ----------
    site : Site
        What the file says.
    data : SurveyData
        A walk, and known points in it.
    later : tuple of Fields
        Epochs anywhere in the walked room, with their true positions, shape (e, 3).
    share : float
        Median of the metal's part of a beacon's field.
    """

    site: Site
    data: SurveyData
    later: tuple[Fields, ...]
    later_m: FloatArray
    share: float


def _slow_walk(room: Room, rng: np.random.Generator, epochs: int) -> tuple[FloatArray, FloatArray]:
    """Return poses in the walked room at about 20 cm/s."""
    corners = max(epochs // 60, 4)
    time, knots = np.linspace(0.0, 1.0, epochs), np.linspace(0.0, 1.0, corners)
    path = PchipInterpolator(knots, room.low_m + (room.high_m - room.low_m) * rng.uniform(size=(corners, 3)))(time)
    turn = CubicSpline(knots, 1.2 * rng.normal(size=(corners, 3)))(time)
    return path, Rotation.from_rotvec(turn).as_matrix()


@dataclass(frozen=True)
class Move:
    """The first of the plates is moved before one of the later epochs: so far into the room, and along its wall."""

    before: int
    inward_m: float
    along_m: float


def metal_trial(
    kind: str,
    seed: int,
    *,
    epochs: int = 400,
    points: int = 0,
    errors: Errors = EXACT,
    later: int = 200,
    move: Move | None = None,
) -> MetalTrial:
    """Draw a room, a walk and later epochs.

    With a ``move`` the later walk is slow, so that a cycle's mean is the field of its middle, as trackers expect.
    """
    rng = np.random.default_rng([seed, *kind.encode()])
    room = cube()
    site = told(room.site, errors)
    coils = Coils.of(site, 1)
    coils = coils.moved(errors.position_m * rng.normal(size=coils.axis.shape))
    coils = coils.turned(errors.axis_rad * rng.normal(size=coils.axis.shape))
    coils = coils.scaled(np.exp(errors.current * rng.normal(size=coils.radius_m.shape)))
    loops = [Loop(*row) for row in zip(coils.position_m[0], coils.axis[0], coils.radius_m[0].tolist(), strict=True)]
    again = copy.deepcopy(rng)
    added = metal_of(kind, rng, room)
    position, rotation = walk(room, rng, epochs)
    which = np.linspace(0, epochs - 1, points).round().astype(int)
    known = tuple(
        KnownPoint(int(e), position[e] + POINT_SD_M * rng.normal(size=3), POINT_SD_M) for e in which if points
    )
    more, turns = walk(room, rng, max(later, 40)) if move is None else _slow_walk(room, rng, later)
    everywhere, attitude = np.vstack([position, more]), np.concatenate([rotation, turns])
    pure = np.stack([loop.field_per_ampere(everywhere) for loop in loops], axis=1)
    extra = np.stack([added(loop, everywhere) for loop in loops], axis=1)
    if move is not None:
        changed = metal_of(kind, again, room, (move.inward_m, move.along_m))
        after = slice(epochs + move.before, None)
        extra[after] = np.stack([changed(loop, everywhere[after]) for loop in loops], axis=1)
    field = coils.ampere_turns[0][:, None] * (pure + extra)
    sigma = float(site.sensor.noise_T / np.sqrt(CHIPS))
    seen = np.einsum("eji,enj->eni", attitude, field) + sigma * rng.normal(size=field.shape)
    names = tuple(beacon.id for beacon in site.beacons)
    share = float(np.median(np.linalg.norm(extra, axis=2) / np.linalg.norm(pure, axis=2)))
    return MetalTrial(
        site,
        SurveyData(fields_of(names, seen[:epochs], sigma), known),
        fields_of(names, seen[epochs:], sigma, first=epochs),
        more,
        share,
    )
