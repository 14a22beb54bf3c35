"""The least error that any filter can have of a sensor that moves by known white noise: a dense Riccati recursion.

It takes every sample by itself, at the truth, with derivatives of magpylib's fields by differences: no blocks, no sums,
no templates, nothing of the filter whose errors are held against it.
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


def _noise(period_s, agility, block_s, ambient_walk):
    """Return what a chip adds to the covariance, shape (18, 18).

    Ambient field and offset take a step of ``block_s`` where a block begins, and none in it: at each chip the ambient
    field's walk would be larger than the noise of 0.2 mG.
    """
    added = np.zeros((18, 18))
    eye = np.eye(3)
    for place, rate, white in ((slice(0, 3), slice(6, 9), agility[0]), (slice(3, 6), slice(9, 12), agility[1])):
        added[place, place] = white**2 * period_s**3 / 3.0 * eye
        added[place, rate] = added[rate, place] = white**2 * period_s**2 / 2.0 * eye
        added[rate, rate] = white**2 * period_s * eye
    added[12:15, 12:15] = ambient_walk**2 * block_s * eye
    added[15:18, 15:18] = OFFSET_WALK**2 * block_s * eye
    return added


def riccati(world, walks, noise_T, agility, ambient_walk=AMBIENT_WALK, offset_sd_T=OFFSET_SD_T):
    """Return the least covariance of the pose at the end of each block, shape (B, blocks, 6, 6).

    Parameters
    ----------
    world : World
    walks : Walks
        B paths.
    noise_T : float
    agility : (float, float)
        White acceleration, m/s^2 and rad/s^2 per root hertz.
    ambient_walk : float
        T per root second.
    offset_sd_T : float
        What is unknown of the sensor's offset at first, each axis.
    """
    runs, count = walks.position_m.shape[:2]
    seen = np.stack(
        [
            sample_derivatives(world, position, rotation, ambient)
            for position, rotation, ambient in zip(walks.position_m, walks.rotation, walks.ambient_T, strict=True)
        ]
    )
    period_s = world.site.chip_period_s
    within, between = (_noise(period_s, agility, step_s, ambient_walk) for step_s in (0.0, BLOCK_CHIPS * period_s))
    covariance = np.tile(np.diag(np.repeat((*VAGUE, offset_sd_T), 3) ** 2), (runs, 1, 1))
    onward = np.tile(np.eye(18), (runs, 1, 1))
    onward[:, 0:3, 6:9] = onward[:, 3:6, 9:12] = period_s * np.eye(3)
    result = []
    for chip in range(count):
        if chip:
            turn = walks.rotation[:, chip] @ np.swapaxes(walks.rotation[:, chip - 1], 1, 2)
            onward[:, 3:6, 3:6] = turn
            covariance = onward @ covariance @ np.swapaxes(onward, 1, 2) + (within if chip % BLOCK_CHIPS else between)
        row = seen[:, chip]
        across = covariance @ np.swapaxes(row, 1, 2)
        innovation = row @ across + noise_T**2 * np.eye(3)
        covariance = covariance - across @ np.linalg.solve(innovation, np.swapaxes(across, 1, 2))
        if chip % BLOCK_CHIPS == BLOCK_CHIPS - 1:
            covariance = 0.5 * (covariance + np.swapaxes(covariance, 1, 2))
            result.append(covariance[:, :6, :6])
    return np.stack(result, axis=1)
