"""The moving emitters of Gietler, Ammari & Zangl: trajectories, and the fields that a fixed sensor measures of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

STEP_S = 0.1
VELOCITY_SIGMA = 0.01
RATE_SIGMA = 0.1
OFFSET_M = np.array([[0.0, 0.0, 0.0], [0.05, 0.05, 0.05], [-0.02, 0.03, 0.02]])
"""Places of the emitters from the first one, in the body's frame (p12, p13)."""

MOMENT_A_M2 = np.eye(3)[::-1].copy()
"""Moments, orthogonal: along z, y and x (section IV-A), 1 A m^2 (section III-C)."""

CUBE_EDGE_M = 0.05
CUBE_CENTRE_M = np.array([0.0, 0.0, -0.05])
"""Place of the conductor from the first emitter: [0, 0, 0.15] where that is at [0, 0, 0.2]."""

Secondary = Callable[[FloatArray, FloatArray, FloatArray], ComplexArray]
"""(points (n, 3), source (3,), moment (3,)) -> field that the conductor adds, A/m, (n, 3); all in the body's frame."""


@dataclass(frozen=True, eq=False)
class Path:
    """A trajectory in steps of `STEP_S`.

    Attributes
    ----------
    position_m : ndarray, shape (n, 3)
        Place of the first emitter; the sensor stands at the origin.
    angles_rad : ndarray, shape (n, 3)
        Angles about x, y, z: R = Rz Ry Rx.
    """

    position_m: FloatArray
    angles_rad: FloatArray

    @property
    def rotation(self) -> FloatArray:
        """Return the rotation from the body's frame to the sensor's, shape (n, 3, 3)."""
        return np.asarray(Rotation.from_euler("xyz", self.angles_rad).as_matrix())


def brownian(
    start: FloatArray,
    seconds: float,
    rng: np.random.Generator,
    clear_m: float = 0.0,
    clear_of_m: FloatArray | None = None,
) -> Path:
    """Return an integrated random walk, eq. (8), exact at the steps.

    Parameters
    ----------
    start : ndarray, shape (4, 3)
        Velocity, position, rates of the angles, angles.
    clear_m, clear_of_m : float, ndarray of shape (3,)
        Paths that bring this place of the body nearer to the sensor than this are drawn again.
    """
    count = round(seconds / STEP_S)
    while True:
        coupled = np.array([[STEP_S, STEP_S**2 / 2.0], [STEP_S**2 / 2.0, STEP_S**3 / 3.0]])
        shock = np.einsum("ij,njk->nik", np.linalg.cholesky(coupled), rng.standard_normal((count, 2, 6)))
        shock *= np.repeat([VELOCITY_SIGMA, RATE_SIGMA], 3)
        speed, place = np.concatenate([start[0], start[2]]), np.concatenate([start[1], start[3]])
        places = [place]
        for push, shift in shock:
            place = place + STEP_S * speed + shift
            speed = speed + push
            places.append(place)
        all_places = np.array(places)
        path = Path(all_places[:, :3], all_places[:, 3:])
        body = np.zeros(3) if clear_of_m is None else clear_of_m
        if np.linalg.norm(path.position_m + path.rotation @ body, axis=1).min() >= clear_m:
            return path


def helix(seconds: float = 80.0) -> Path:
    """Return the helix of eq. (33) as printed; its stated initial velocity and attitude differ from it."""
    t = STEP_S * np.arange(round(seconds / STEP_S) + 1)
    position = np.stack([0.6 * np.cos(0.2 * t), 0.6 * np.sin(0.2 * t), 0.01 * t], axis=1)
    return Path(position, np.stack([np.full_like(t, 0.1662), np.zeros_like(t), 0.02 * t], axis=1))


def measured(path: Path, secondary: Secondary | None, noise_A_m: float, rng: np.random.Generator) -> ComplexArray:
    """Return the fields at the sensor, shape (n, 3, 3), an emitter a row: dipoles, conductor, noise on both phases."""
    rotation = path.rotation
    point = np.einsum("nji,nj->ni", rotation, -path.position_m)
    fields = np.empty((len(point), 3, 3), dtype=np.complex128)
    for emitter, (offset, moment) in enumerate(zip(OFFSET_M, MOMENT_A_M2, strict=True)):
        field = dipole_field(point - offset, moment) + 0.0j
        if secondary is not None:
            field = field + secondary(point, offset, moment)
        fields[:, emitter] = np.einsum("nij,nj->ni", rotation, field)
    noise = rng.standard_normal((2, *fields.shape))
    return np.asarray(fields + noise_A_m * (noise[0] + 1.0j * noise[1]))


def dipole_field(offset_m: FloatArray, moment_A_m2: FloatArray) -> FloatArray:
    """Return H of a dipole, A/m, at offsets from it, shape (n, 3)."""
    distance = np.linalg.norm(offset_m, axis=1)[:, None]
    along = (offset_m @ moment_A_m2)[:, None] / distance**2
    return np.asarray((3.0 * along * offset_m - moment_A_m2) / (4.0 * np.pi * distance**3))
