"""A site for tests of parts of the pose: eight coils that point anywhere, known exactly."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from goldfield import site as sites
from goldfield.site.model import Survey
from hil_sim.clib import ROOT
from tests.firmware.core.pose.explaining import Place


@pytest.fixture(scope="session")
def mixed_cube():
    """The cube with an axis of its own for each beacon, and no declared errors."""
    rng = np.random.default_rng(101)
    site = sites.load(ROOT / "host/sites/prigge8.toml")
    axes = rng.normal(size=(8, 3)) + np.array([0.0, 0.0, 2.0])
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    sure = Survey(0.0, 0.0, 0.0)
    rows = [dataclasses.replace(b, axis=a, survey=sure) for b, a in zip(site.beacons, axes, strict=True)]
    sensor = dataclasses.replace(site.sensor, gain_sd=0.0, axis_sd_rad=0.0)
    return dataclasses.replace(site, beacons=tuple(rows), sensor=sensor)


@pytest.fixture(scope="session")
def place(mixed_cube):
    """A pose among them, with its fields."""
    return Place(mixed_cube, [0.8, 1.3, 0.7], Rotation.from_rotvec([0.4, -0.9, 1.7]))
