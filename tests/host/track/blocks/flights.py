"""Sensors in motion among magpylib's coils, block by block: paths, samples, blocks and errors of poses."""

from __future__ import annotations

from dataclasses import dataclass

import magpylib
import numpy as np
from scipy.spatial.transform import Rotation

from goldfield.types import Block
from tests.bench.motion_trials import EARTH_T, Flight

CHIPS, BLOCK = 1023, 31
MIDDLE_M = np.array([1.065, 1.065, 0.89])


def tumbling(rng, sizes, frequencies, turn_sizes, middle=MIDDLE_M):
    """A path of one sine an axis, of position (m) and of rotation vector (rad), each with a random phase."""
    phases = rng.uniform(0.0, 2.0 * np.pi, (2, 3))
    attitude = Rotation.random(rng=rng)
    sizes, turn_sizes = np.asarray(sizes), np.asarray(turn_sizes)
    omega = 2.0 * np.pi * np.asarray(frequencies)

    def position(times):
        return middle + sizes * np.sin(np.outer(times, omega) + phases[0])

    def rotation(times):
        return Rotation.from_rotvec(turn_sizes * np.sin(np.outer(times, omega[::-1]) + phases[1])) * attitude

    return Flight(position, rotation)


def still(rng):
    middle = MIDDLE_M + rng.uniform(-0.4, 0.4, 3)
    attitude = Rotation.random(rng=rng)
    return Flight(
        lambda t: np.tile(middle, (len(t), 1)),
        lambda t: Rotation.from_matrix(np.tile(attitude.as_matrix(), (len(t), 1, 1))),
    )


def hand(rng):
    """A hand that shakes at 2 Hz: .9 m/s and 11 m/s^2 at most an axis, 20 degrees."""
    return tumbling(rng, (0.07, 0.05, 0.06), (2.0, 1.9, 2.1), (0.3, 0.35, 0.25), MIDDLE_M + rng.uniform(-0.3, 0.3, 3))


def drone(rng):
    """A drone that flies bends of .7 m at 3 m/s in the mean."""
    return tumbling(rng, (0.7, 0.7, 0.35), (0.55, 0.75, 0.65), (0.4, 0.4, 1.5))


@dataclass
class Stream:
    """Samples of a sensor from the first chip of cycle 0 on, shape (count, 3), and where it was."""

    site: object
    flight: Flight
    samples: np.ndarray

    def blocks(self, first=0, chips=BLOCK, codes=None):
        """Return the blocks of so many chips each from a chip on; with codes, shape (N, c + 1), their sums."""
        period, cycle = self.site.chip_period_s, self.site.chips
        blocks = []
        for begin in range(first, len(self.samples) - chips + 1, chips):
            data = self.samples[begin : begin + chips]
            if codes is not None:
                data = codes[(begin + np.arange(chips)) % cycle].T @ data
            blocks.append(Block(begin // cycle, begin % cycle, (begin + chips) * period, chips, data, codes is None))
        return blocks

    def errors(self, poses):
        """Return errors of position and attitude at the poses' own times, shapes (k, 3)."""
        position, rotation = self.flight.poses(np.array([pose.time_s for pose in poses]))
        told = Rotation.from_quat([pose.orientation_xyzw for pose in poses])
        return np.array([pose.position_m for pose in poses]) - position, (told * rotation.inv()).as_rotvec()


def streamed(room, flight, seconds, noise_T, rng, earth_T=EARTH_T, drives=None, fields=None):
    """Sample a flight; ``drives``, shape (N, n), in place of codes; ``fields(position)`` adds to the ambient field."""
    site = room.site
    drives = room.codes if drives is None else drives
    count = int(seconds / site.chip_period_s)
    samples = np.empty((count, 3))
    for begin in range(0, count, 4 * CHIPS):
        chip = np.arange(begin, min(begin + 4 * CHIPS, count))
        position, rotation = flight.poses((chip + 1) * site.chip_period_s)
        field = magpylib.getB(room.coils, position, squeeze=False)[:, 0, 0]
        total = np.einsum("tn,ntc->tc", drives[chip % len(drives)], field) + earth_T
        if fields is not None:
            total = total + fields(position)
        samples[chip] = rotation.inv().apply(total)
    return Stream(site, flight, samples + noise_T * rng.normal(size=samples.shape))
