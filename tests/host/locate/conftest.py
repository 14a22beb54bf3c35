"""The cube of eight beacons, and fields in it, of which tests of single steps are made."""

from __future__ import annotations

import numpy as np
import pytest

from goldfield.field import FieldModel
from goldfield.locate.fit import Measurements
from tests.bench import locate_trials as bench
from tests.host.locate.steps import SIGMA_T


@pytest.fixture(scope="module")
def site():
    return bench.prigge_cube(2e-8)


@pytest.fixture(scope="module")
def cube(site):
    return FieldModel(site.beacons)


@pytest.fixture(scope="module")
def run(site):
    rng = np.random.default_rng(71)
    return bench.trials(site, bench.cube_positions(rng, 4, 0.6), rng, sigma_T=SIGMA_T)


@pytest.fixture
def sound(run):
    return Measurements(run.field_T, run.sigma_T)
