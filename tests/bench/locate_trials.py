"""Sites and seeded measurements for the figures of the locator; fields by magpylib, independent of the host's model."""

from __future__ import annotations

from dataclasses import dataclass

import magpylib
import numpy as np
from scipy.spatial.transform import Rotation

from goldfield.locate.least_squares import minimise
from goldfield.locate.uncertainty import cramer_rao_bound
from goldfield.site import Beacon, HalfSpace, SensorSite, Site, area_vector
from goldfield.types import Fields

CHIPS = 1023


def site_of(beacons, half_space=None, noise_T=2e-7):
    return Site("trial", 97.75e-6, 10, half_space, SensorSite(noise_T), tuple(beacons))


def loop_beacon(index, position, axis=(0.0, 0.0, 1.0), turns=19.0, radius=0.149, current=10.0):
    axis = np.asarray(axis, dtype=float)
    place = np.asarray(position, dtype=float)
    return Beacon(f"b{index}", place, axis / np.linalg.norm(axis), turns, radius, None, current, index + 2)


def prigge_cube(noise_T=2e-7, keep=range(8)):
    """Prigge and How's experiment: eight coils at the corners of 2.13 x 2.13 x 1.78 m, all pointing up."""
    corners = [(x, y, z) for z in (0.0, 1.78) for x in (0.0, 2.13) for y in (0.0, 2.13)]
    return site_of([loop_beacon(i, corners[i]) for i in keep], noise_T=noise_T)


def ceiling_lattice(noise_T=2e-8, half_space=True):
    """Coils every 4.5 m on a ceiling at 2.7 m, all pointing up; 5 x 5 of them, a sensor hears eight."""
    beacons = [loop_beacon(5 * i + j, (4.5 * i, 4.5 * j, 2.7)) for i in range(5) for j in range(5)]
    below = HalfSpace(np.array([0.0, 0.0, 2.7]), np.array([0.0, 0.0, -1.0])) if half_space else None
    return site_of(beacons, below, noise_T)


def square_spiral(centre, side=0.07, turns=10, pitch=0.0025):
    """The wire of a square spiral of a printed board, from outside inward."""
    half = side / 2 - pitch * np.arange(4 * turns + 1) / 4
    corner = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])
    xy = half[:, None] * corner[np.arange(4 * turns + 1) % 4]
    return np.column_stack([xy, np.zeros(len(xy))]) + np.asarray(centre)


def spiral_board(half_space=True, noise_T=25e-9, current=1.0):
    """Eight 70 mm square spiral coils side by side in one plane, 4 x 2."""
    beacons = []
    for index in range(8):
        wire = square_spiral(((index % 4) * 0.08, (index // 4) * 0.08, 0.0))
        area = area_vector(wire)
        axis = area / np.linalg.norm(area)
        beacons.append(Beacon(f"s{index}", wire.mean(axis=0), axis, 1.0, None, wire, current, index + 2))
    above = HalfSpace(np.zeros(3), np.array([0.0, 0.0, 1.0])) if half_space else None
    return site_of(beacons, above, noise_T)


def magpylib_fields(site, position):
    """Fields of all beacons at all positions, shape (e, n, 3), tesla, in the site's frame."""
    coils = []
    for beacon in site.beacons:
        current = beacon.turns * beacon.current_A
        if beacon.points_m is not None:
            coils.append(magpylib.current.Polyline(current=current, vertices=beacon.points_m))
        else:
            turn = Rotation.align_vectors(beacon.axis[None], [[0.0, 0.0, 1.0]])[0]
            coils.append(
                magpylib.current.Circle(
                    diameter=2 * beacon.radius_m, current=current, position=beacon.position_m, orientation=turn
                )
            )
    return magpylib.getB(coils, position, squeeze=False)[:, 0, 0].swapaxes(0, 1)


@dataclass(frozen=True)
class Trials:
    """True poses and what the sensor measured there."""

    position_m: np.ndarray
    rotation: np.ndarray
    field_T: np.ndarray
    sigma_T: np.ndarray


def trials(site, position, rng, sigma_T=None, axes=(0, 1, 2)):
    """Measure at positions with uniform random attitude; axes tells which of the sensor's axes there are."""
    count = len(position)
    rotation = Rotation.random(count, rng=rng).as_matrix()
    truth = magpylib_fields(site, position)
    sigma = site.sensor.noise_T / np.sqrt(CHIPS) if sigma_T is None else sigma_T
    field = np.einsum("eki,enk->eni", rotation, truth) + sigma * rng.normal(size=truth.shape)
    missing = [axis for axis in range(3) if axis not in axes]
    field[:, :, missing] = np.nan
    return Trials(position, rotation, field, np.full(truth.shape[:2], sigma))


def cube_positions(rng, count, size=1.0):
    """Uniform in the cube of `prigge_cube`, enlarged about its middle so that its edges are `size` times as long."""
    edges = np.array([2.13, 2.13, 1.78])
    return edges / 2 + size * edges * rng.uniform(-0.5, 0.5, size=(count, 3))


def lattice_positions(rng, count):
    """Around the middle of `ceiling_lattice`, 0.3 to 2 m high."""
    return np.array([9.0, 9.0, 0.0]) + rng.uniform([-2.25, -2.25, 0.3], [2.25, 2.25, 2.0], size=(count, 3))


def nearest_only(site, run, count=8):
    """Keep the strongest beacons of each epoch, as a sensor that reports only eight would; others become NaN."""
    magnitude = np.linalg.norm(np.nan_to_num(run.field_T), axis=2)
    rank = np.argsort(np.argsort(-magnitude, axis=1), axis=1)
    field = np.where((rank < count)[:, :, None], run.field_T, np.nan)
    return Trials(run.position_m, run.rotation, field, run.sigma_T)


def normalised_error(error, covariance):
    """Mean normalised error squared per axis; scaled so that no digits are lost."""
    scale = 1.0 / np.sqrt(np.einsum("ekk->ek", covariance))
    scaled = covariance * scale[:, :, None] * scale[:, None, :]
    return (
        np.einsum("ek,ek->e", error * scale, np.linalg.solve(scaled, (error * scale)[:, :, None])[:, :, 0])
        / error.shape[1]
    )


def turn_error(truth, estimate):
    """Rotation vectors, shape (e, 3), from estimated to true attitudes, in the site's frame."""
    return Rotation.from_matrix(truth @ estimate.swapaxes(1, 2)).as_rotvec()


FAULTS = ("polarity", "code", "dead", "moved", "current", "saturated")


def with_fault(kind, site, run, rng, row):
    """Let one beacon, given by its row, be not as the site says; the measured noise stays the same."""
    truth = np.einsum("eki,enk->eni", run.rotation, magpylib_fields(site, run.position_m))
    noise = run.field_T - truth
    beacon = site.beacons[row]
    if kind == "polarity":
        truth[:, row] *= -1.0
    elif kind == "code":  # the beacon sends the code of nobody: its own correlates with noise and its leakage, -1/1023
        truth[:, row] *= -1.0 / CHIPS
    elif kind == "dead":
        truth[:, row] = 0.0
    elif kind == "moved":
        step = rng.normal(size=3)
        place = beacon.position_m + 0.2 * step / np.linalg.norm(step)
        moved = site_of(
            [Beacon(beacon.id, place, beacon.axis, beacon.turns, beacon.radius_m, None, beacon.current_A, 2)]
        )
        truth[:, row] = np.einsum("eki,ek->ei", run.rotation, magpylib_fields(moved, run.position_m)[:, 0])
    elif kind == "current":
        truth[:, row] *= rng.choice([0.5, 1.5])
    elif kind == "saturated":  # the converter clips what the beacon adds on each axis at half the largest component
        limit = 0.5 * np.abs(truth[:, row]).max(axis=1, keepdims=True)
        truth[:, row] = np.clip(truth[:, row], -limit, limit)
    else:
        raise ValueError(kind)
    return Trials(run.position_m, run.rotation, truth + noise, run.sigma_T)


def fields_of(site, run):
    """The epochs of a run as the host's type; ids of all beacons, also of those that are NaN."""
    names = tuple(beacon.id for beacon in site.beacons)
    return [Fields(i, 0.1 * i, names, run.field_T[i], run.sigma_T[i]) for i in range(len(run.field_T))]


def bound_of(site, run, without=None):
    """Cramer-Rao bound of the position at the true poses, root of the sum of variances, shape (e,)."""
    sigma = np.where(np.isfinite(run.field_T), run.sigma_T[:, :, None], np.inf)
    if without is not None:
        sigma[:, without] = np.inf
    bound = cramer_rao_bound(site, run.position_m, run.rotation, sigma_T=sigma)
    return np.sqrt(np.einsum("ekk->e", bound[:, :3, :3]))


def board_positions(rng, count, height=0.07):
    """Return random positions over `spiral_board`, at one height."""
    return np.column_stack([rng.uniform([-0.035, -0.035], [0.275, 0.115], size=(count, 2)), np.full(count, height)])


def full_magnitudes(model, magnitude_T, sigma_T, known, start_m):
    """Positions, shape (e, 3), by a fit of the magnitudes themselves: the patent's second step (its eqns 6 and 7)."""
    weight = np.where(known, 1.0 / sigma_T, 0.0)

    def evaluate(state, rows):
        field, gradient = model.evaluate(state[0].T)
        modelled = np.sqrt((field * field).sum(axis=0))
        slope = ((field[:, None] * gradient).sum(axis=0) / modelled).swapaxes(0, 1)
        w = weight[rows]
        return (magnitude_T[rows] - modelled) * w, slope * w[:, None]

    def move(state, step):
        return (state[0] + step,)

    return minimise(evaluate, move, (start_m,), iterations=25, tolerance=1e-4).state[0]
