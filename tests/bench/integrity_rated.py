"""Table of the integrity figures: errors beyond the protection level of a track by blocks, 330 poses a second.

The sensor is at rest in the cube. The worst fault of the worst beacon in the worst direction, as in
`integrity_adversary`, adds so much to the cost of one cycle; it is there from the first block on, or begins in the
middle. A lasting fault that draws the track is what such a track knows least of.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from goldfield.site import Site
from goldfield.track.blocks import BlockFilter
from goldfield.types import Block
from tests.bench.integrity_adversary import worst_faults
from tests.bench.integrity_coils import Coils, attitudes
from tests.bench.integrity_outcome import Outcome, joined, outcome_of
from tests.bench.integrity_run import Run
from tests.bench.integrity_sites import cube, sigma_of
from tests.bench.integrity_tables import Column, Table, largest, progress
from tests.bench.locate_trials import Trials, cube_positions
from tests.bench.motion_trials import CHIPS, EARTH_T, gold_chips

CHIPS_A_BLOCK = 31
BLOCKS = 4 * CHIPS // CHIPS_A_BLOCK
SIZES = (0.0, 3.0, 5.0, 8.0, 12.0)


@dataclass(frozen=True)
class Rest:
    """A sensor at rest: fields of the beacons and the ambient field in its frame, and what a fault adds, T."""

    position_m: np.ndarray
    field_T: np.ndarray
    ambient_T: np.ndarray
    fault_T: np.ndarray

    def followed(self, site: Site, begins: int, rng: np.random.Generator) -> Outcome:
        """Return what becomes of the poses of `BLOCKS` blocks; the fault is there from such a block on."""
        codes = np.stack([gold_chips(beacon.code) for beacon in site.beacons], axis=1).astype(float)
        first = int(rng.integers(CHIPS))
        chips = codes[(first + np.arange(BLOCKS * CHIPS_A_BLOCK)) % CHIPS]
        samples = chips @ self.field_T + self.ambient_T + site.sensor.noise_T * rng.normal(size=(len(chips), 3))
        faulty = slice(begins * CHIPS_A_BLOCK, None)
        samples[faulty] += chips[faulty] @ self.fault_T
        track, poses = BlockFilter(site), []
        for part in np.split(samples, BLOCKS):
            last = first + CHIPS_A_BLOCK
            block = Block(first // CHIPS, first % CHIPS, last * site.chip_period_s, CHIPS_A_BLOCK, part, sampled=True)
            pose = track.update(block)
            assert pose is not None  # blocks hold data
            poses.append(pose)
            first = last
        return outcome_of(poses, np.tile(self.position_m, (BLOCKS, 1)))


def tracks(run: Run, noise_T: float, size: float, begins: int, count: int) -> Outcome:
    """Follow so many sensors at rest, each with its worst fault."""
    true, rng = cube(noise_T), run.rng("rated", noise_T, size, begins)
    position, rotation = cube_positions(rng, count), attitudes(rng, count)
    field = np.einsum("eki,enk->eni", rotation, Coils.of(true, count).field(position))
    sigma = np.full(field.shape[:2], sigma_of(true))
    fault, _ = worst_faults(true, Trials(position, rotation, field, sigma))
    ambient = EARTH_T @ rotation
    site = run.told(true)
    return joined(
        Rest(position[e], field[e], ambient[e], size * fault[e]).followed(site, begins, rng) for e in range(count)
    )


def rated(run: Run) -> None:
    """Print how often poses of a track by blocks are beyond their protection level."""
    count = max(run.poses // 20, 1)
    table = Table(
        "A track by blocks of a sensor at rest, 8 beacons, 330 poses a second, four cycles a track",
        "size: root of the cost that the worst fault adds to a cycle; from: block of the track with which it\n"
        "begins; said: poses that are `ok` or `unverified`; >PL: of these, error above protection_m; tracks:\n"
        "with such a pose; err/PL: largest",
        (
            Column("site", -12),
            Column("size", 5),
            Column("from", 5),
            Column("tracks", 7),
            Column("said", 8),
            Column(">PL", 6),
            Column("share", 8),
            Column("tracks", 7),
            Column("err/PL", 7, 2),
        ),
    )
    rows = [(noise_T, size, begins) for noise_T in (2e-7, 2e-8) for begins in (0, BLOCKS // 2) for size in SIZES]
    for noise_T, size, begins in progress([row for row in rows if row[1] or not row[2]], "rated"):
        outcome = tracks(run, noise_T, size, begins, count)
        beyond = outcome.unprotected
        said = int(outcome.passed.sum())
        table.row(
            f"cube {noise_T * 1e7:g} mG",
            f"{size:g}",
            begins,
            count,
            said,
            int(beyond.sum()),
            f"{beyond.sum() / max(said, 1):.1e}",
            int(beyond.reshape(count, -1).any(axis=1).sum()),
            largest((outcome.error_m / outcome.protection_m)[outcome.passed]),
        )
