"""What may happen to a tracked sensor: starts in motion, lost blocks, impulses, a dead beacon, survey errors.

Each trial returns `Errors` of the block filter, on simulated samples. What matters most of them is how many poses were
said to be ``ok`` and were off by five deviations or by more than their protection level: `Errors.wrong`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from goldfield.site import Survey
from tests.bench.locate_trials import prigge_cube
from tests.bench.motion_trials import CHIPS
from tests.bench.rate_ways import follow
from tests.bench.rate_world import BLOCK_CHIPS, MOTIONS, World, motion_of

MOVING = tuple(name for name in MOTIONS if name != "still")
IMPULSE_T, IMPULSE_SHARE = 20e-6, 0.05
"""Size of an impulse in one sample, in a random direction, and the share of the blocks that have one."""
DEAD = (0.35, 0.65)
"""Parts of a run between which a beacon has no current."""


def starts(make, noise_T, count, seed=0):
    """Return for each of many starts the errors of the poses of its first 33 blocks; ``make(site)`` makes a filter.

    The sensor moves, at a random moment of a random motion, and the first block begins at any chip of the code.
    """
    site = prigge_cube(noise_T)
    world, result = World(site), []
    for number in range(count):
        rng = np.random.default_rng([seed, 11, number])
        motion = motion_of(MOVING[number % len(MOVING)], int(rng.integers(1 << 31)))
        first = int(rng.integers(CHIPS))
        times = world.times(first + 33 * BLOCK_CHIPS)
        position, rotation = motion.poses(times + rng.uniform(0.0, 100.0))
        result.append(follow(world.track(position, rotation, rng, noise_T), make(site), first))
    return result


def lost(errors, far_m):
    """Tell whether a start is lost: after 33 blocks there is no pose, or one that is far off, or off by five sigma."""
    last = errors.where(slice(-1, None))
    return not (last.distance_m[0] < far_m) or last.far[0]


def blocks_lost(lost_block, make, noise_T, name, seed, seconds):
    """Return the errors where some blocks never come; ``lost_block(number)`` tells which."""
    site = prigge_cube(noise_T)
    rng = np.random.default_rng([seed, 12])
    track = World(site).motion_track(motion_of(name, seed), seconds, rng, noise_T)
    return follow(track, make(site), lost=lost_block)


def impulses(make, noise_T, name, seed, seconds):
    """Return the errors where single samples are off by 20 uT."""
    site = prigge_cube(noise_T)
    rng = np.random.default_rng([seed, 13])
    track = World(site).motion_track(motion_of(name, seed), seconds, rng, noise_T)
    for begin in range(0, len(track.times_s) - BLOCK_CHIPS, BLOCK_CHIPS):
        if rng.uniform() < IMPULSE_SHARE:
            direction = rng.normal(size=3)
            direction *= IMPULSE_T / np.linalg.norm(direction)
            track.samples_T[begin + rng.integers(BLOCK_CHIPS)] += direction
    return follow(track, make(site))


def dead_beacon(make, noise_T, name, seed, seconds):
    """Return the errors where one of the beacons has no current for a while, and then again all of it."""
    site = prigge_cube(noise_T)
    world, rng = World(site), np.random.default_rng([seed, 14])
    motion = motion_of(name, seed)
    times = world.times(round(seconds / site.chip_period_s))
    strength = np.ones((len(times), len(site.beacons)))
    strength[(times > DEAD[0] * seconds) & (times < DEAD[1] * seconds), rng.integers(len(site.beacons))] = 0.0
    return follow(world.motion_track(motion, seconds, rng, noise_T, strength=strength), make(site))


def survey(deviation_m, make, noise_T, name, seed, seconds):
    """Return the errors where each coil stands off by a normal deviation, which the site declares."""
    declared = prigge_cube(noise_T)
    rng = np.random.default_rng([seed, 16])
    known = Survey(position_sd_m=deviation_m)
    site = replace(declared, beacons=tuple(replace(beacon, survey=known) for beacon in declared.beacons))
    true = [replace(beacon, position_m=beacon.position_m + deviation_m * rng.normal(size=3)) for beacon in site.beacons]
    track = World(site, true).motion_track(motion_of(name, seed), seconds, rng, noise_T)
    return follow(track, make(site))


def random_walks(make, world, walks, noise_T, seed):
    """Return for each of B random walks the errors of its blocks."""
    rng = np.random.default_rng([seed, 17])
    result = []
    for position, turns, ambient, offset in zip(
        walks.position_m, walks.rotation, walks.ambient_T, walks.offset_T, strict=True
    ):
        rotation = Rotation.from_matrix(turns)
        track = world.track(position, rotation, rng, noise_T, ambient_T=ambient, offset_T=offset)
        result.append(follow(track, make(world.site)))
    return result
