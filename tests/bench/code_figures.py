"""How well and how fast codes are planned: lattices of 500 to 2,000 beacons, 4.5 m from each other.

``python -m tests.bench.code_figures`` prints a line a lattice: what goldfield site codes prints, and what it took.
"""

from __future__ import annotations

import argparse
import math
import time

import numpy as np

from goldfield.planning.code_plan import planned
from goldfield.planning.grid import Grid
from tests.command import real_number, whole_number
from tests.host.planning.built import ceiling

SPACING_M, STRONGEST = 4.5, 16


def line(beacons: int, step_m: float, height_m: float) -> str:
    """Return the figures of a lattice of about so many beacons."""
    side = math.ceil(math.sqrt(beacons))
    site = ceiling(side, math.ceil(beacons / side), spacing=SPACING_M, height=height_m)
    place = np.array([one.position_m for one in site.beacons])
    low, high = place.min(axis=0), place.max(axis=0)
    grid = Grid.of_box(np.array([*low[:2], 0.5]), np.array([*high[:2], 2.0]), step_m)
    begin_s = time.process_time()
    plan = planned(site, grid, STRONGEST)
    cells = [
        str(len(site.beacons)),
        str(len(np.unique(plan.code))),
        str(plan.places),
        *(_decibels(ratio) for ratio in (plan.interference.same, plan.bound)),
        *(_decibels(ratio) for ratio in (plan.interference.leak, plan.interference.total)),
        str(plan.alike),
        f"{plan.seconds:.0f}",
        f"{time.process_time() - begin_s:.0f}",
    ]
    return f"| {' | '.join(cells)} |"


def _decibels(ratio: float) -> str:
    return f"{20.0 * math.log10(ratio):.1f}" if ratio > 0.0 else "-"


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--beacons", type=whole_number(1), nargs="+", default=[500, 1000, 2000])
    parser.add_argument("--step", type=real_number(0.1), default=1.5, help="distance of the places, m (default 1.5)")
    parser.add_argument("--height", type=real_number(0.5), default=4.5, help="of the ceiling, m (default 4.5)")
    arguments = parser.parse_args()
    heads = (
        "beacons",
        "codes",
        "places",
        "same code, dB",
        "its bound",
        "other codes",
        "worst of all",
        "alike",
        "s",
        "s of CPU",
    )
    print(f"| {' | '.join(heads)} |\n|{' --- |' * len(heads)}")
    for beacons in arguments.beacons:
        print(line(beacons, arguments.step, arguments.height), flush=True)


if __name__ == "__main__":
    main()
