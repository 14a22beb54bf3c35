"""How the cost of decoding, separation and location grows from 8 beacons to 1,000: each size beside 8, in turns."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from goldfield.access.cdma import Separator
from goldfield.locate import Locator
from goldfield.planning.code_plan import usable_codes
from goldfield.site import HalfSpace
from goldfield.types import Fields
from goldfield_protocol import decode
from tests.bench import locate_trials as trials
from tests.bench.peers.bench import Bench
from tests.bench.peers.decode import frames
from tests.bench.peers.row import Row

SUBJECT = "growth"
SIZES = (8, 100, 1000)
HEARD = 16
"""Codes that a sensor in a building reports, the strongest."""
SPACING_M, HEIGHT_M = 4.5, 2.7
CYCLES = 12


def decoding(beacons: int) -> Callable[[], Any]:
    """Return a task: the messages of a cycle in which every beacon is reported."""
    some = frames(("EPOCH", "EPOCH_STATUS", "EPOCH_OFFSET", *["FIELD"] * beacons))
    return lambda: [decode(identifier, data) for identifier, data in some]


def separating(beacons: int) -> Callable[[], Any]:
    """Return a task: the exact fields of a cycle of which the sums of every code were reported."""
    codes, rng = tuple(usable_codes(10)[0][:beacons]), np.random.default_rng(beacons)
    separator = Separator(10, codes, 2e-7)
    sums, mean = rng.normal(scale=1e-6, size=(beacons, 3)), np.full(3, 1e-5)
    missing = np.zeros(beacons)
    return lambda: separator.from_correlations(sums, mean, missing)


def locating(beacons: int) -> Callable[[], Any]:
    """Return a task: poses of a sensor under a ceiling of so many beacons, from the strongest of them."""
    rng = np.random.default_rng(beacons)
    columns = int(np.ceil(np.sqrt(1.6 * beacons)))
    places = [(SPACING_M * (i % columns), SPACING_M * (i // columns), HEIGHT_M) for i in range(beacons)]
    below = HalfSpace(np.array([0.0, 0.0, HEIGHT_M]), np.array([0.0, 0.0, -1.0]))
    site = trials.site_of([trials.loop_beacon(i, place) for i, place in enumerate(places)], below, 2e-8)
    middle = np.array(places)[:, :2].mean(axis=0)
    at = np.column_stack([middle + rng.uniform(-2.0, 2.0, (CYCLES, 2)), rng.uniform(0.8, 1.6, CYCLES)])
    near = np.argsort(((np.array(places)[None] - at[:, None]) ** 2).sum(axis=2), axis=1)[:, :HEARD]
    locator, epochs = Locator(site), []
    for number, (position, rows) in enumerate(zip(at, near, strict=True)):
        rows = np.sort(rows)
        few = trials.site_of([site.beacons[row] for row in rows], below, 2e-8)
        run = trials.trials(few, position[None], rng)
        names = tuple(site.beacons[row].id for row in rows)
        epochs.append(Fields(number, 0.1 * number, names, run.field_T[0], run.sigma_T[0]))
    found = np.array([locator.locate(epoch).position_m for epoch in epochs])
    assert (np.linalg.norm(found - at, axis=1) < 0.2).mean() > 0.7, found - at
    return lambda: [locator.locate(epoch) for epoch in epochs]


def rows(bench: Bench) -> list[Row]:
    """Return the rows of the subject; the peer is the same work with 8 beacons."""
    found = []
    for what, make, work in (
        ("decoding of a cycle", decoding, 1),
        ("separation of a cycle", separating, 1),
        (f"a pose from the {HEARD} strongest of them", locating, CYCLES),
    ):
        least = make(SIZES[0])
        for size in SIZES[1:]:
            row = bench.pair(SUBJECT, f"{what}, {size:,} beacons", make(size), "8 beacons", least, work=work)
            found.append(row)
    return found
