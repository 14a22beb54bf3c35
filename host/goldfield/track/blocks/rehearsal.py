"""A rehearsal: what follows a live sensor is used once before the sensor's first block is there.

The first block of a process takes some 40 ms for what is done once only: C types are read, tables of chi-square made,
modules imported at their first use. Those that come meanwhile wait, too.
"""

from __future__ import annotations

import contextlib

import numpy as np

from goldfield.access.gold import code_matrix
from goldfield.field import FieldModel
from goldfield.site import Site
from goldfield.site.drive import NO_CODE
from goldfield.track.blocks.equations import ALL, BlockEquations
from goldfield.track.blocks.filter import BlockFilter
from goldfield.types import Block, FloatArray, Pose

CHIPS = 31
"""Chips of a block."""

CYCLES = 1.3
"""So many cycles are followed: one is judged, and its verdict holds before the end."""

OUTSIDE: FloatArray = np.array([0.1, 0.2, 0.3])
"""Where the sensor is, from the middle of the coils, over how far they are apart: not where all their fields are the
same."""

BESIDE_M: FloatArray = np.array([0.15, 0.25, 0.4])
"""Where a sensor is whose track begins vaguely, from the first coil."""

BEGINNING = 8
"""So many blocks are taken there."""

AMBIENT_T: FloatArray = np.array([2e-5, 0.0, -4e-5])


def rehearse(site: Site) -> list[Pose | None]:
    """Follow a sensor that is not there, at rest in two places, and return the poses: nothing is left of it but speed.

    Sites that no block filter can follow give none.
    """
    poses: list[Pose | None] = []
    with contextlib.suppress(Exception):  # what is wrong with a site is told with a block that is there
        model, equations, rng = FieldModel(site.beacons), BlockEquations(site), np.random.default_rng(1)
        apart_m = np.ptp(model.centre_m, axis=0).max() or 1.0
        middle = model.centre_m.mean(axis=0) + apart_m * OUTSIDE
        whole = int(CYCLES * site.chips / CHIPS)
        for position, count in ((model.centre_m[0] + BESIDE_M, BEGINNING), (middle, whole)):
            field = model.evaluate(position)[0].T
            track = BlockFilter(site)
            poses += [track.update(_block(site, equations, field, number, rng)) for number in range(count)]
    return poses


def _block(site: Site, equations: BlockEquations, field_T: FloatArray, number: int, rng: np.random.Generator) -> Block:
    """Return a block of a sensor at rest, whose axes are the site's, as a link carries it if it can."""
    cycle, chip = divmod(number * CHIPS, site.chips)
    end_s = (number + 1) * CHIPS * site.chip_period_s
    place = (chip + np.arange(CHIPS)) % site.chips
    samples = equations.columns[place] @ np.vstack([field_T, AMBIENT_T])
    samples += site.sensor.noise_T * rng.standard_normal(samples.shape)
    samples = equations.readings(samples, ALL)
    if any(beacon.code == NO_CODE for beacon in site.beacons):
        return Block(cycle, chip, end_s, CHIPS, samples, sampled=True)
    codes = np.hstack([code_matrix(site.degree, site.codes), np.ones((site.chips, 1))])[place]
    return Block(cycle, chip, end_s, CHIPS, codes.T @ samples)
