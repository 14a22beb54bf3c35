"""Site files: a site of finite numbers that a locator can be made of, or one sentence."""

from __future__ import annotations

import numpy as np

from goldfield.locate import Locator
from goldfield.site import load
from tests.fuzz.host.judging import answered, written

MOST_BYTES = 8_000


def one_input(data: bytes) -> None:
    """Read one file, and make a locator of it."""
    path = written(data[:MOST_BYTES], ".toml")
    site = answered(lambda: load(path))
    if site is None:
        return
    assert site.beacons
    for beacon in site.beacons:
        assert np.isfinite(beacon.position_m).all()
        assert np.isfinite(beacon.axis).all()
        assert np.isfinite(beacon.current_A)
        assert beacon.current_A != 0
    answered(lambda: Locator(site))
