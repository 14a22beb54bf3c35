"""A moving sensor's samples, chip by chip, with the truth beside them: for the figures of the block filter.

Coils are magpylib's, codes come from shift registers; nothing of the host's models is in the samples.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from goldfield.types import Block
from hil_sim.world.roaming import Roaming, Shake
from tests.bench.locate_trials import magpylib_fields
from tests.bench.motion_trials import CHIPS, EARTH_T, gold_chips

BLOCK_CHIPS = 31
LOW_M, HIGH_M = np.array([0.35, 0.35, 0.3]), np.array([1.78, 1.78, 1.48])
"""The box in which the sensor moves: `prigge_cube` without a margin, so that it stays 0.5 m from the coils' centres."""
SHAKE_MARGIN_M = 0.1

MOTIONS = {
    "still": (0.0, 0.0, Shake()),
    "0.5 m/s, 0.5 rad/s": (0.5, 0.5, Shake()),
    "1 m/s, 1 rad/s": (1.0, 1.0, Shake()),
    "hand, 2 Hz": (0.3, 0.5, Shake(2.0, 0.1, 0.3)),
    "drone, 3 m/s": (3.0, 1.0, Shake()),
}
"""Speed, turn rate and shaking of each motion that the figures are told of."""


def motion_of(name, seed):
    """Return a motion of `MOTIONS` inside the cube; ``still`` stands at another place for each seed."""
    speed, rate, shake = MOTIONS[name]
    margin = SHAKE_MARGIN_M if shake.size_m else 0.0
    return Roaming(seed, LOW_M + margin, HIGH_M - margin, speed, rate, shake)


@dataclass(frozen=True, eq=False)
class Track:
    """Samples of a sensor and where it was at each of them, the end of its chip.

    Attributes
    ----------
    site : Site
        What the host is told of the beacons.
    samples_T : ndarray, shape (n, 3)
        The first is that of chip 0 of the first cycle.
    times_s : ndarray, shape (n,)
        On the sensor's clock.
    position_m : ndarray, shape (n, 3)
    rotation : Rotation
        The n attitudes.
    first_cycle : int
    """

    site: object
    samples_T: object
    times_s: object
    position_m: object
    rotation: object
    first_cycle: int = 0

    def blocks(self, first=0):
        """Yield the index of its last chip and the block for each whole block from a chip on."""
        for begin in range(first, len(self.times_s) - BLOCK_CHIPS + 1, BLOCK_CHIPS):
            last = begin + BLOCK_CHIPS - 1
            yield (
                last,
                Block(
                    self.first_cycle + begin // CHIPS,
                    begin % CHIPS,
                    float(self.times_s[last]),
                    BLOCK_CHIPS,
                    self.samples_T[begin : last + 1],
                    sampled=True,
                ),
            )


class World:
    """Coils of a site and their codes.

    Parameters
    ----------
    site : Site
    beacons : sequence of Beacon, optional
        The coils that are really there, if they are not as the site says.
    """

    def __init__(self, site, beacons=None):
        self.site = site
        self.true = site if beacons is None else replace(site, beacons=tuple(beacons))
        self.codes = np.stack([gold_chips(beacon.code) for beacon in site.beacons], axis=1).astype(np.float64)

    def times(self, count):
        """Return the times of samples, shape (n,): that of chip 0 of cycle 0 is one chip after zero."""
        return (np.arange(count) + 1.0) * self.site.chip_period_s

    def fields(self, position_m):
        """Return the fields of all coils at the places of successive samples, shape (n, beacons, 3), site's frame."""
        return magpylib_fields(self.true, position_m)

    def chips(self, count):
        """Return the codes of the first chips as columns, shape (n, beacons)."""
        return np.resize(self.codes, (count, self.codes.shape[1]))

    def track(self, position_m, rotation, rng, noise_T, ambient_T=EARTH_T, offset_T=0.0, strength=1.0, fields=None):
        """Return the samples on a path.

        ``ambient_T`` and ``offset_T`` may have a row for each sample. ``strength``, shape (n, beacons), is that of
        each coil's current; ``fields`` stands for those of `fields` where something else is in the room.
        """
        count = len(position_m)
        fields = self.fields(position_m) if fields is None else fields
        total = np.einsum("tn,tnc->tc", self.chips(count) * strength, fields) + ambient_T
        samples = rotation.inv().apply(total) + offset_T + noise_T * rng.normal(size=(count, 3))
        return Track(self.site, samples, self.times(count), position_m, rotation)

    def motion_track(self, motion, seconds, rng, noise_T, **others):
        """Return the samples of a `hil_sim.world.motion.Motion`; see `track`."""
        position, rotation = motion.poses(self.times(round(seconds / self.site.chip_period_s)))
        return self.track(position, rotation, rng, noise_T, **others)


@dataclass(frozen=True, eq=False)
class Walks:
    """Random walks of everything in a filter's state, as its model has them; B runs of n samples.

    Attributes
    ----------
    position_m, rotation : ndarray, shape (B, n, 3) and (B, n, 3, 3)
    ambient_T, offset_T : ndarray, shape (B, n, 3)
    """

    position_m: object
    rotation: object
    ambient_T: object
    offset_T: object


AMBIENT_WALK, OFFSET_WALK = 5e-6, 2e-8
"""Walks of the ambient field and of the sensor's offset, T per root second (docs/blocks.md)."""


def matched_walks(rng, runs, count, period_s, agility):
    """Return white acceleration and angular acceleration of an agility, in paths that stay in the box.

    Ambient field and offset change where a block begins: within one they are constant, as the filter has them.
    A path starts somewhere in the middle, at a speed such that it stays; one that leaves is drawn again.
    """
    white, turning = agility
    found = []
    while len(found) < runs:
        start = rng.uniform(LOW_M + 0.3, HIGH_M - 0.3)
        velocity = 0.5 * rng.normal(size=3)
        position = start + _twice_summed(rng, count, period_s, white, velocity)
        if np.all((position > LOW_M) & (position < HIGH_M)):
            found.append(position)
    rotation = np.empty((runs, count, 3, 3))
    for run in range(runs):
        angle = _twice_summed(rng, count, period_s, turning, rng.normal(size=3))
        steps = Rotation.from_rotvec(np.diff(angle, axis=0)).as_matrix()
        rotation[run, 0] = Rotation.random(rng=rng).as_matrix()
        for k, step in enumerate(steps):
            rotation[run, k + 1] = step @ rotation[run, k]
    blocks = -(-count // BLOCK_CHIPS)
    walk = np.sqrt(BLOCK_CHIPS * period_s) * np.cumsum(rng.normal(size=(2, runs, blocks, 3)), axis=2)
    walk = np.repeat(walk, BLOCK_CHIPS, axis=2)[:, :, :count]
    return Walks(np.array(found), rotation, EARTH_T + AMBIENT_WALK * walk[0], OFFSET_WALK * walk[1])


def _twice_summed(rng, count, period_s, white, velocity):
    """Return twice integrated white noise with a first velocity, shape (n, 3): exact at the samples."""
    first, second = white * rng.normal(size=(2, count, 3))
    steps = np.sqrt(period_s) * first
    velocities = velocity + np.vstack([np.zeros((1, 3)), np.cumsum(steps, axis=0)[:-1]])
    moved = period_s * velocities + period_s**1.5 * (first / 2.0 + second / np.sqrt(12.0))
    return np.cumsum(moved, axis=0)
