"""The experiments of Gietler, Ammari & Zangl: paths beside conductors, convergence from a poor guess, tables."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from goldfield.errors import UserError
from goldfield.field.conductor import Material, Parts, Response, ball, cuboid, respond
from goldfield.field.conductor.body import PIECES
from goldfield.field.conductor.interior import SKIN_RATIO, VolumeResponse
from goldfield.track.motion import Agility, State
from goldfield.types import FloatArray
from hil_sim.papers.gietler.tracker import EmitterBody, EmitterTracker, Noise, PlainFilter, euler_matrix
from hil_sim.world import boundary_elements as boundary
from hil_sim.world import emitter_world as world
from hil_sim.world.emitter_world import Path, Secondary
from hil_sim.world.sphere import Sphere

ComplexArray = NDArray[np.complex128]
MATERIALS = {"carbon": (1000.0, 1.0), "copper": (59.9e6, 1.0), "permeable": (1e5, 100.0)}
SPHERE_RADIUS_M = world.CUBE_EDGE_M * (0.75 / math.pi) ** (1.0 / 3.0)
"""The sphere with the cube's volume, around the same centre."""

CLEAR_M = 0.08
"""The sensor is never nearer to the conductor's centre."""

NEAR_M = 0.5
AGILITY = Agility(world.VELOCITY_SIGMA, world.RATE_SIGMA, 0.0)
VOLUME_PIECES = 9
"""A body that the field penetrates has three voxels a triangle, and a matrix over the voxels."""


START = np.array([[0.01, 0.0, -0.005], [0.2, -0.2, 0.3], [0.0, 0.0, 0.0], [0.02, -0.05, 0.5 * math.pi]])
GUESS = np.array([[0.0, 0.0, 0.0], [0.05, -0.1, 0.4], [0.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""Section III-C: velocity, position, rates, angles; the start's third angle is garbled, pi/2 is the hard reading."""

GUESS_DEVIATIONS = np.array([0.3, 1.0, 0.1, 0.3])
START_BESIDE = np.array([[0.001, 0.001, 0.001], [0.0, 0.0, 0.2], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
"""Section IV-C."""

WIDENED = 0.02
"""Part of the field that is added to the noise in a filter's covariance, the old remedy against nonlinearity."""

MISTRUSTED = 0.2
"""The same for a base model that is told how wrong it is beside metal."""

KNOWN_DEVIATIONS = np.array([0.01, 0.05, 0.02, 0.1])


@dataclass(frozen=True, eq=False)
class Track:
    """Errors along a path.

    Attributes
    ----------
    range_m, error_m, turn_rad : ndarray, shape (n,)
        Distance of the first emitter from the sensor, and errors of its position and of the attitude.
    position_m : ndarray, shape (n, 3)
        Estimated.
    """

    range_m: FloatArray
    error_m: FloatArray
    turn_rad: FloatArray
    position_m: FloatArray

    def rms(self, within_m: float = math.inf) -> tuple[float, float]:
        """Root mean square errors of position and attitude where the range is at most so much; NaN if nowhere."""
        near = self.range_m <= within_m
        if not near.any():
            return math.nan, math.nan
        return float(np.sqrt(np.mean(self.error_m[near] ** 2))), float(np.sqrt(np.mean(self.turn_rad[near] ** 2)))


def follow(path: Path, fields: ComplexArray, tracker: EmitterTracker | PlainFilter) -> Track:
    """Let a filter follow the fields of a path."""
    rotations = path.rotation
    position = np.empty_like(path.position_m)
    turn = np.empty(len(position))
    with np.errstate(all="ignore"):  # the plain filter may run away
        for step, field in enumerate(fields):
            if step:
                tracker.predict(world.STEP_S)
            state = tracker.update(field)
            position[step] = state.position_m
            turn[step] = np.arccos(np.clip(0.5 * (np.trace(rotations[step].T @ state.rotation) - 1.0), -1.0, 1.0))
    error = np.linalg.norm(position - path.position_m, axis=1)
    return Track(np.linalg.norm(path.position_m, axis=1), error, turn, position)


def true_conductor(shape: str, material: str, frequency_Hz: float) -> Secondary:
    """Return the reference solution of a body under the emitters.

    Raises
    ------
    UserError
        There is none: of the cube only copper's, which is taken for a perfect conductor.
    """
    conductivity, permeability = MATERIALS[material]
    if shape == "sphere":
        sphere = Sphere(world.CUBE_CENTRE_M, SPHERE_RADIUS_M, conductivity, permeability)
        return lambda point, source, moment: sphere.secondary(point, source, moment, frequency_Hz)
    if material != "copper":
        raise UserError(
            f"there is no reference solution of a cube of {material}: take --body sphere, or --material copper, which "
            "is taken for a perfect conductor"
        )
    cube = boundary.BoundaryElements(
        boundary.cube_surface(world.CUBE_CENTRE_M, world.CUBE_EDGE_M), boundary.PERFECT_CONDUCTOR
    )
    return lambda point, source, moment: cube.secondary(point, source, moment).astype(np.complex128)


def host_response(shape: str, conductivity_S_m: float, permeability: float, frequency_Hz: float) -> Response:
    """Return the host's model of the same body."""
    material = Material(conductivity_S_m, permeability)
    thin = material.skin_depth_m(frequency_Hz) < world.CUBE_EDGE_M / 2.0 / SKIN_RATIO
    pieces = PIECES if thin else VOLUME_PIECES
    if shape == "sphere":
        return respond(ball(world.CUBE_CENTRE_M, SPHERE_RADIUS_M, material, pieces), frequency_Hz)
    return respond(cuboid(world.CUBE_CENTRE_M, np.full(3, world.CUBE_EDGE_M), material, pieces), frequency_Hz)


Model = tuple[EmitterBody, float]
"""Emitters with what is known of their conductor, and the relative error that the filter allows for."""


def models(shape: str, material: str, frequency_Hz: float) -> dict[str, Model]:
    """Return the models that are compared, by name."""
    base = EmitterBody(world.OFFSET_M, world.MOMENT_A_M2)
    trusted = Noise().model
    return {
        "base": (base, trusted),
        "base, mistrusted": (base, MISTRUSTED),
        "extended": (extended_body(shape, material, frequency_Hz), trusted),
    }


def extended_body(shape: str, material: str, frequency_Hz: float) -> EmitterBody:
    """Return the emitters with the host's model of the conductor."""
    conductivity, permeability = MATERIALS[material]
    if shape == "cube":
        conductivity = math.inf  # as its reference solution
    response = host_response(shape, conductivity, permeability, frequency_Hz)
    return EmitterBody(world.OFFSET_M, world.MOMENT_A_M2, response.parts(world.OFFSET_M, world.MOMENT_A_M2))


def beside_conductor(
    truth: Secondary, models: dict[str, Model], noise_A_m: float, seed: int, helix: bool = False
) -> tuple[Path, dict[str, Track]]:
    """Track one path with several models; the start is known, as in section IV-C."""
    rng = np.random.default_rng(seed)
    path = world.helix() if helix else world.brownian(START_BESIDE, 20.0, rng, CLEAR_M, world.CUBE_CENTRE_M)
    fields = world.measured(path, truth, noise_A_m, rng)
    agility = Agility(0.05, world.RATE_SIGMA, 0.0) if helix else AGILITY  # the helix turns at 0.024 m/s^2
    speed = (path.position_m[1] - path.position_m[0]) / world.STEP_S
    start = State(path.position_m[0], path.rotation[0], speed, np.zeros(3), np.zeros(3))
    tracks = {}
    for name, (body, error) in models.items():
        tracker = EmitterTracker(body, start, KNOWN_DEVIATIONS, agility, Noise(noise_A_m, error))
        tracks[name] = follow(path, fields, tracker)
    return path, tracks


def converged(track: Track) -> bool:
    """Tell whether the last five seconds are right: 5 % of the range and 0.1 rad."""
    last = slice(-round(5.0 / world.STEP_S), None)
    return bool((track.error_m[last] < 0.05 * track.range_m[last]).all() and (track.turn_rad[last] < 0.1).all())


def from_poor_guess(noise_A_m: float, seed: int) -> dict[str, Track]:
    """Track a path in air from the paper's initial guess: iterated filter, plain one, plain one told of more noise."""
    rng = np.random.default_rng(seed)
    path = world.brownian(START, 20.0, rng)
    fields = world.measured(path, None, noise_A_m, rng)
    body, noise = EmitterBody(world.OFFSET_M, world.MOMENT_A_M2), Noise(noise_A_m, 0.0)
    guess = State(GUESS[1], euler_matrix(GUESS[3]), GUESS[0], GUESS[2], np.zeros(3))
    return {
        "iterated": follow(path, fields, EmitterTracker(body, guess, GUESS_DEVIATIONS, AGILITY, noise)),
        "plain": follow(path, fields, PlainFilter(body, GUESS, GUESS_DEVIATIONS, AGILITY, noise)),
        "plain, noise widened": follow(
            path, fields, PlainFilter(body, GUESS, GUESS_DEVIATIONS, AGILITY, Noise(noise_A_m, WIDENED))
        ),
    }


@dataclass(frozen=True)
class FormulaError:
    """Largest relative errors of ways to compute a sphere's field, over emitters and points; NaN: does not apply.

    Attributes
    ----------
    skin_depths : float
        Radius over skin depth.
    host : float
        The host's model.
    given : float
        The explicit formula fed with the exact interior field.
    first_order : float
        The explicit formula fed with the currents that the emitters alone would drive.
    share : float
        The secondary field over the emitter's own, the largest.
    """

    skin_depths: float
    host: float
    given: float
    first_order: float
    share: float


POINTS_M = np.array([[0.05, 0.05, 0.0], [0.0, 0.0, -0.2], [0.3, 0.0, -0.1], [-0.2, 0.2, 0.1]])
"""Where fields are compared, from the first emitter: the paper's point of observation first."""


def formula_error(conductivity_S_m: float, permeability: float, frequency_Hz: float) -> FormulaError:
    """Compare the explicit formula with the exact series of the sphere, at the paper's geometry."""
    sphere = Sphere(world.CUBE_CENTRE_M, SPHERE_RADIUS_M, conductivity_S_m, permeability)
    emitters = list(zip(world.OFFSET_M, world.MOMENT_A_M2, strict=True))
    exact = np.array([sphere.secondary(POINTS_M, o, m, frequency_Hz) for o, m in emitters])
    size = np.linalg.norm(exact, axis=-1)

    def worst(parts: Parts) -> float:
        return float((np.linalg.norm(parts.field(POINTS_M) - exact, axis=-1) / size).max())

    response = host_response("sphere", conductivity_S_m, permeability, frequency_Hz)
    first_order = math.nan
    if permeability == 1.0:
        body = ball(world.CUBE_CENTRE_M, SPHERE_RADIUS_M, response.body.material, VOLUME_PIECES)
        first = VolumeResponse(body, frequency_Hz, first_order=True)
        first_order = worst(first.parts(world.OFFSET_M, world.MOMENT_A_M2))
    # The voxels of a perfect ball: the flat triangles' corners at the true radius would leave out its outermost skin.
    voxel, volume = ball(world.CUBE_CENTRE_M, SPHERE_RADIUS_M, response.body.material, 8).voxels(24)
    arm = voxel - world.CUBE_CENTRE_M
    radius = np.linalg.norm(arm.reshape(24, -1, 3), axis=2)
    node = 0.5 * (np.polynomial.legendre.leggauss(24)[0] + 1.0)
    place = world.CUBE_CENTRE_M + arm * (SPHERE_RADIUS_M * node[:, None] / radius).reshape(-1, 1)
    interior = [sphere.interior(place, o, m, frequency_Hz, 30) for o, m in emitters]
    field, curl = (np.stack(kind) for kind in zip(*interior, strict=True))
    given = worst(Parts.of_interior(place, volume, field, curl, permeability))
    own = [world.dipole_field(POINTS_M - o, m) for o, m in emitters]
    share = float((size / np.linalg.norm(own, axis=-1)).max())
    depths = SPHERE_RADIUS_M / response.body.material.skin_depth_m(frequency_Hz)
    return FormulaError(depths, worst(response.parts(world.OFFSET_M, world.MOMENT_A_M2)), given, first_order, share)


PRINTED = {
    "copper": np.array(
        [[230.310, 217.780, -123.660], [17.742, 4.450, -4.174], [-19.831, -10.634, -25.090]], dtype=complex
    ),
    "permeable": np.array(
        [
            [-248.620 + 91.751j, -245.780 + 88.301j, 379.540 - 71.226j],
            [13.957 + 8.412j, -228.560 + 2.317j, -1.376 - 2.981j],
            [-86.642 - 10.840j, 57.967 - 6.754j, -398.010 - 11.367j],
        ]
    ),
}
"""The finite-element rows of Tables I and II, taken for mA/m (printed mT): an emitter a row."""

TABLE_MOMENT_A_M2 = 0.01


def table(material: str, frequency_Hz: float) -> dict[str, ComplexArray]:
    """Return the secondary field of the paper's cube at its point of observation, mA/m, shape (3, 3), by name.

    The imaginary parts have the paper's sign: exp(-i omega t).
    """
    moment = TABLE_MOMENT_A_M2 * world.MOMENT_A_M2
    result = {"printed": PRINTED[material]}
    parts = host_response("cube", *MATERIALS[material], frequency_Hz).parts(world.OFFSET_M, moment)
    result["explicit formula"] = 1e3 * parts.field(POINTS_M[:1])[:, 0].conj()
    permeability = MATERIALS[material][1]
    cube = boundary.BoundaryElements(
        boundary.cube_surface(world.CUBE_CENTRE_M, world.CUBE_EDGE_M),
        boundary.PERFECT_CONDUCTOR if permeability == 1.0 else permeability,
    )
    solved = [cube.secondary(POINTS_M[:1], o, m)[0] for o, m in zip(world.OFFSET_M, moment, strict=True)]
    name = "boundary elements, perfect conductor" if permeability == 1.0 else "boundary elements, static"
    result[name] = 1e3 * np.array(solved, dtype=complex)
    return result


def agreement(a: ComplexArray, b: ComplexArray) -> tuple[float, complex]:
    """Return the ratio of lengths |b|/|a| and the complex cosine between two vectors, shape (3,)."""
    lengths = float(np.linalg.norm(a)), float(np.linalg.norm(b))
    return lengths[1] / lengths[0], complex(np.vdot(a, b) / (lengths[0] * lengths[1]))
