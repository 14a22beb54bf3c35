"""The least error that any filter can have of a sensor that moves by known white noise: a dense Riccati recursion.

It works at the truth, with derivatives of magpylib's fields by differences and codes from shift registers: it shares
nothing with the filter whose errors are held against it. `LeastError.of_sums` is the bound of any filter that has the
sums of a block with the codes and without; `LeastError.of_samples` that of one that has every sample by itself.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from tests.bench.rate_world import AMBIENT_WALK, BLOCK_CHIPS, OFFSET_WALK

STEP_M, STEP_RAD = 1e-4, 1e-5
VAGUE = (1.0, 1.0, 3.0, 4.0, 1e-4)
"""Standard deviations before the first sample: position (m), attitude, velocity, turn rate, ambient field (T)."""
OFFSET_SD_T = 5e-6


def sample_derivatives(world, position_m, rotation, ambient_T):
    """Return the derivatives of the samples of one path, shape (n, 3, 18)."""
    count = len(position_m)
    codes = world.chips(count)

    def seen(position):
        return np.einsum("tn,tnc->tc", codes, world.fields(position))

    to_sensor = np.swapaxes(rotation, 1, 2)
    result = np.zeros((count, 3, 18))
    total = seen(position_m) + ambient_T
    for axis, step in enumerate(np.eye(3)):
        slope = (seen(position_m + STEP_M * step) - seen(position_m - STEP_M * step)) / (2.0 * STEP_M)
        result[:, :, axis] = np.einsum("tij,tj->ti", to_sensor, slope)
        turned = [Rotation.from_rotvec(sign * STEP_RAD * step).inv().apply(total) for sign in (1.0, -1.0)]
        slope = (turned[0] - turned[1]) / (2.0 * STEP_RAD)
        result[:, :, 3 + axis] = np.einsum("tij,tj->ti", to_sensor, slope)
    result[:, :, 12:15] = to_sensor
    result[:, :, 15:18] = np.eye(3)
    return result


def _noise(seconds, agility, step_s, ambient_walk):
    """Return what time adds to the covariance, shape (18, 18); ambient field and offset take a step of ``step_s``."""
    added = np.zeros((18, 18))
    eye = np.eye(3)
    for place, rate, white in ((slice(0, 3), slice(6, 9), agility[0]), (slice(3, 6), slice(9, 12), agility[1])):
        added[place, place] = white**2 * seconds**3 / 3.0 * eye
        added[place, rate] = added[rate, place] = white**2 * seconds**2 / 2.0 * eye
        added[rate, rate] = white**2 * seconds * eye
    added[12:15, 12:15] = ambient_walk**2 * step_s * eye
    added[15:18, 15:18] = OFFSET_WALK**2 * step_s * eye
    return added


def _onward(seconds, turn):
    """Return how errors go on over a time in which the attitude turned by matrices, shape (B, 3, 3): (B, 18, 18)."""
    result = np.tile(np.eye(18), (len(turn), 1, 1))
    result[:, 0:3, 6:9] = result[:, 3:6, 9:12] = seconds * np.eye(3)
    result[:, 3:6, 3:6] = turn
    return result


def _updated(covariance, seen, noise):
    """Return covariances, shape (B, 18, 18), after data that see the state by matrices, shape (B, m, 18)."""
    across = covariance @ np.swapaxes(seen, 1, 2)
    covariance = covariance - across @ np.linalg.solve(seen @ across + noise, np.swapaxes(across, 1, 2))
    return 0.5 * (covariance + np.swapaxes(covariance, 1, 2))


class LeastError:
    """The least covariances along random walks.

    Parameters
    ----------
    world : World
    walks : Walks
        B paths.
    noise_T : float
    agility : (float, float)
        White acceleration, m/s^2 and rad/s^2 per root hertz.
    ambient_walk : float
        T per root second; ambient field and offset take a step where a block begins and none in it: at each chip the
        ambient field's walk would be larger than the noise of 0.2 mG.
    offset_sd_T : float
        What is unknown of the sensor's offset at first, each axis.
    """

    def __init__(self, world, walks, noise_T, agility, ambient_walk=AMBIENT_WALK, offset_sd_T=OFFSET_SD_T):
        self._walks, self._noise_T, self._agility, self._ambient_walk = walks, noise_T, agility, ambient_walk
        self._period_s = world.site.chip_period_s
        runs, self._count = walks.position_m.shape[:2]
        paths = zip(walks.position_m, walks.rotation, walks.ambient_T, strict=True)
        self._seen = np.stack([sample_derivatives(world, *path) for path in paths])
        self._columns = np.hstack([world.chips(self._count), np.ones((self._count, 1))])
        self._start = np.tile(np.diag(np.repeat((*VAGUE, offset_sd_T), 3) ** 2), (runs, 1, 1))

    def _turn(self, before, after):
        """Return by how much the sensors turned between two chips, shape (B, 3, 3)."""
        return self._walks.rotation[:, after] @ np.swapaxes(self._walks.rotation[:, before], 1, 2)

    def of_samples(self):
        """Return the least covariance of the pose at the end of each block if all samples are known: (B, blocks, 6, 6).

        The recursion takes one sample after the other, with the walk of the motion between them.
        """
        steps = [
            _noise(self._period_s, self._agility, step_s, self._ambient_walk)
            for step_s in (BLOCK_CHIPS * self._period_s, *[0.0] * (BLOCK_CHIPS - 1))
        ]
        covariance, result = self._start, []
        for chip in range(self._count):
            if chip:
                onward = _onward(self._period_s, self._turn(chip - 1, chip))
                covariance = onward @ covariance @ np.swapaxes(onward, 1, 2) + steps[chip % BLOCK_CHIPS]
            covariance = _updated(covariance, self._seen[:, chip], self._noise_T**2 * np.eye(3))
            if chip % BLOCK_CHIPS == BLOCK_CHIPS - 1:
                result.append(covariance[:, :6, :6])
        return np.stack(result, axis=1)

    def of_sums(self):
        """Return the same if only the sums of each block are known: those with the codes, and the plain one.

        Within a block the motion is uniform; the state is that of its middle, foretold to its end.
        """
        middle = BLOCK_CHIPS // 2
        block_s, rest_s = BLOCK_CHIPS * self._period_s, (BLOCK_CHIPS - 1 - middle) * self._period_s
        between = _noise(block_s, self._agility, block_s, self._ambient_walk)
        after = _noise(rest_s, self._agility, 0.0, self._ambient_walk)
        covariance, result = self._start, []
        for begin in range(0, self._count - BLOCK_CHIPS + 1, BLOCK_CHIPS):
            if begin:
                onward = _onward(block_s, self._turn(begin - BLOCK_CHIPS + middle, begin + middle))
                covariance = onward @ covariance @ np.swapaxes(onward, 1, 2) + between
            covariance = _updated(covariance, *self._sums(begin, begin + middle))
            onward = _onward(rest_s, self._turn(begin + middle, begin + BLOCK_CHIPS - 1))
            result.append((onward @ covariance @ np.swapaxes(onward, 1, 2) + after)[:, :6, :6])
        return np.stack(result, axis=1)

    def _sums(self, begin, middle):
        """Return what independent sums of a block see of the state at its middle, shape (B, m, 18), and their noise."""
        columns = self._columns[begin : begin + BLOCK_CHIPS]
        columns = columns @ np.linalg.inv(np.linalg.cholesky(columns.T @ columns)).T  # sums of independent noise
        seen = 0.0
        for chip, row in enumerate(columns, start=begin):
            at_chip = self._seen[:, chip] @ _onward((chip - middle) * self._period_s, self._turn(middle, chip))
            seen = seen + row[None, :, None, None] * at_chip[:, None]
        seen = seen.reshape(len(seen), -1, 18)
        return seen, self._noise_T**2 * np.eye(seen.shape[1])
