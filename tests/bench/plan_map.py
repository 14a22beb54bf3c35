"""Draw docs/plan.png: ``make plan-map``. A ceiling lattice with an aisle where three beacons are missing."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from goldfield.planning import Grid, Request, plan
from goldfield.planning.picture import png
from tests.host.planning.built import ceiling

PICTURE = Path(__file__).resolve().parents[2] / "docs" / "plan.png"


def main():
    """Plan and draw."""
    site = ceiling(5, 4, spacing=4.5)
    missing = ([9.0, 4.5], [9.0, 9.0], [13.5, 9.0])
    left = [one for one in site.beacons if one.position_m[:2].tolist() not in missing]
    grid = Grid.of_box(np.array([0.0, 0.0, 0.5]), np.array([18.0, 13.5, 2.0]), 0.25)
    maps = plan(Request(replace(site, beacons=tuple(left)), grid), workers=2)
    PICTURE.write_bytes(png(maps))
    print(f"wrote docs/{PICTURE.name}: {maps.summary()}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
