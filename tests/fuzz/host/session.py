"""A recording with its site, cycle by cycle to poses: whatever was on the link, finite poses or one sentence."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np

from goldfield import Site, Status, load_site, open_log
from tests.fuzz.host.judging import answered, written

MOST_BYTES = 12_000
SITE = Path(__file__).parents[2] / "host" / "prigge8_site.toml"


@cache
def site() -> Site:
    """Return the site of the recordings in the corpus."""
    return load_site(SITE)


def one_input(data: bytes) -> None:
    """Locate one recording."""
    path = written(data[:MOST_BYTES], ".log")

    def locate() -> None:
        with open_log(path, site=site()) as sensor:
            for epoch in sensor.epochs():
                pose = epoch.pose
                if pose.status is Status.OK:
                    assert np.isfinite(pose.position_m).all()
                    assert np.isfinite(pose.orientation_xyzw).all()
                    assert np.isfinite(pose.position_cov_m2).all()
                    assert np.isfinite(pose.attitude_cov_rad2).all()

    answered(locate)
