"""The block filter in C behind NumPy arrays, and blocks to feed it with."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from goldfield.types import FloatArray
from tests.firmware.core.track.dense import CHIP_S, Coils, State, products

CHIPS = 31
BLOCK_S = CHIPS * CHIP_S


def cube(count: int = 8, side: float = 2.13) -> Coils:
    """Return coils on the corners of a cube and then anywhere around it; axes in all directions; 13 A m^2."""
    rng = np.random.default_rng(5)
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]) * side
    others = side * (0.5 + rng.uniform(0.6, 1.0, (32, 1)) * Rotation.random(32, random_state=6).apply([1.0, 0.0, 0.0]))
    centre = np.concatenate([corners, others])[:count]
    axis = Rotation.random(count, random_state=7).apply([0.0, 0.0, 1.0])
    return Coils(centre, axis, np.full(count, 1.3), np.full(count, 0.149))


def some_state(rng: np.random.Generator, side: float = 2.13, speed: float = 1.0) -> State:
    """Return a state inside the cube; speed in m/s and rad/s."""
    p = side * (0.5 + rng.uniform(-0.25, 0.25, 3))
    rotation = Rotation.random(random_state=rng).as_matrix()
    v, w = speed * rng.normal(size=(2, 3))
    return State(p, rotation, v, w, rng.normal(0.0, 25.0, 3), rng.normal(0.0, 2.0, 3))


class Bits:
    """The codes of some beacons, from the family of degree 10."""

    def __init__(self, family: FloatArray, count: int) -> None:
        self.codes = family[2 : 2 + count].T.astype(float)

    def columns(self, chip: int, chips: int = CHIPS) -> FloatArray:
        """Return the codes from a chip on, and a column of ones, shape (chips, n + 1)."""
        rows = self.codes[(chip + np.arange(chips)) % len(self.codes)]
        return np.column_stack([rows, np.ones(chips)])

    def words(self, chip: int, chips: int = CHIPS) -> list[int]:
        """Return the same as bits."""
        ones = self.columns(chip, chips)[:, :-1] < 0
        return [int(sum(1 << t for t in np.flatnonzero(column))) for column in ones.T]


class Kernel:
    """The C calls, with arrays in and out."""

    def __init__(self, core: tuple[Any, Any], coils: Coils, noise: float) -> None:
        self.ffi, self.lib = core
        self.coils = self.ffi.new("loop_t[]", max(len(coils.k), 1))
        for loop, c, a, k, r in zip(self.coils, coils.centre, coils.axis, coils.k, coils.radius, strict=True):
            loop.centre_m, loop.axis, loop.k_uT_m3, loop.radius_m = c.tolist(), a.tolist(), float(k), float(r)
        self.filter = self.ffi.new("block_filter_t *")
        self.block = self.ffi.new("block_t *")
        self.noise = noise
        self.lib.block_filter_init(self.filter, self.coils, len(coils.k), noise)

    def fill(self, words: list[int], data: FloatArray, chips: int = CHIPS) -> Any:
        """Make the block of codes and sums."""
        self.lib.block_gram(words, len(words), chips, CHIP_S, self.block)
        for row, values in zip(self.block.sums_uT, data, strict=False):
            row[0:3] = values.tolist()
        return self.block

    def put(self, kalman: Any, state: State, covariance: FloatArray, agility: tuple[float, float]) -> None:
        """Set one filter."""
        self.put_state(kalman.state, state)
        kalman.acceleration2, kalman.turn2 = (a**2 for a in agility)
        for row, values in zip(kalman.covariance, covariance, strict=True):
            row[0:18] = values.tolist()

    @staticmethod
    def put_state(to: Any, state: State) -> None:
        """Set a state."""
        to.position_m, to.velocity_m_s, to.rate_rad_s = state.p.tolist(), state.v.tolist(), state.w.tolist()
        to.quaternion = Rotation.from_matrix(state.rotation).as_quat().tolist()
        to.ambient_uT, to.offset_uT = state.e.tolist(), state.b.tolist()

    @staticmethod
    def state(of: Any) -> State:
        """Return a state."""
        names = ("position_m", "velocity_m_s", "rate_rad_s", "ambient_uT", "offset_uT")
        p, v, w, e, b = (np.array(list(getattr(of, name))) for name in names)
        return State(p, Rotation.from_quat(list(of.quaternion)).as_matrix(), v, w, e, b)

    @staticmethod
    def matrix(of: Any) -> FloatArray:
        """Return a matrix."""
        return np.array([list(row) for row in of])

    @classmethod
    def covariance(cls, kalman: Any) -> FloatArray:
        """Return the covariance of one filter, which is kept up on and below the diagonal."""
        lower = np.tril(cls.matrix(kalman.covariance))
        return np.asarray(lower + np.tril(lower, -1).T)


def matrices(kernel: Kernel) -> tuple[FloatArray, FloatArray]:
    """Return gram and moment matrix of the kernel's block."""
    count = kernel.block.columns
    return kernel.matrix(kernel.block.gram)[:count, :count], kernel.matrix(kernel.block.moment)[:count, :count]


def sampled(
    coils: Coils, columns: FloatArray, path: Any, middle_s: float, noise: float, rng: np.random.Generator
) -> FloatArray:
    """Return the sums of a block of noisy samples of a motion: path(t) is the state at a time, its offset included."""
    samples = []
    for t, row in enumerate(columns):
        state = path(middle_s + CHIP_S * (t - 0.5 * (len(columns) - 1)))
        samples.append(row[:-1] @ coils.field(state.p) @ state.rotation + state.rotation.T @ state.e + state.b)
    return columns.T @ (np.array(samples) + rng.normal(0.0, noise, (len(columns), 3)))


__all__ = ["BLOCK_S", "CHIPS", "Bits", "Kernel", "cube", "matrices", "products", "sampled", "some_state"]
