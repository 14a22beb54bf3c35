"""CSV tables of fields and of chips: every cell is a number of a sane size, or one sentence says what is wrong.

The first byte says which table it is.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np

from goldfield import load_site, read_fields
from goldfield.cli.chips_file import read_cycles
from goldfield.site import Site
from tests.fuzz.host.judging import answered, written

MOST_BYTES = 8_000
SITE = """
[site]
name = "two"
chip_period_s = 9.775e-5
degree = 5
[sensor]
noise_T = 2e-7
[[beacon]]
id = "a"
code = 3
position_m = [0, 0, 0]
axis = [0, 0, 1]
turns = 100
radius_m = 0.1
current_A = 1.0
[[beacon]]
id = 7
code = 5
position_m = [1, 0, 0]
axis = [1, 0, 0]
turns = 100
radius_m = 0.1
current_A = 1.0
"""


@cache
def site() -> Site:
    """Return a site of short cycles, with both kinds of ids."""
    return load_site(written(SITE.encode(), ".toml"))


def one_input(data: bytes) -> None:
    """Read one table."""
    path = written(data[1:MOST_BYTES], ".csv")
    answered(lambda: (chips if data[:1] == b"c" else fields)(path))


def fields(path: Path) -> None:
    """Read a table of fields."""
    for epoch in read_fields(site(), path):
        assert epoch.field_T.shape == (len(epoch.beacons), 3)
        assert 0 < len(epoch.beacons) <= len(site().beacons)
        assert not np.isinf(epoch.field_T).any()
        assert not np.isinf(epoch.sigma_T).any()


def chips(path: Path) -> None:
    """Read a table of chips."""
    for cycle in read_cycles(site(), str(path)):
        assert cycle.samples_T.shape == (31, 3)
        assert not np.isinf(cycle.samples_T).any()
