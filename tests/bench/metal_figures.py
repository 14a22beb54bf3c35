"""What learning the metal of a room gains: ``python -m tests.bench.metal_figures [--seeds N] [KIND ...]``.

Each room is surveyed from a walk of 400 epochs at .2 mG (`metal_trials`), once with an exact site and no known point,
once with a site 5 mm, .3 degree and .3 % off, ten known points and the beacons free too. Told is the median error of
200 later poses before and after; NEES/3 is their mean normalised square error per axis after the survey.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from goldfield.locate import Locator
from goldfield.site import Site
from goldfield.survey import Free, survey
from tests.bench.integrity_sites import EXACT, Errors
from tests.bench.metal_trials import MetalTrial, metal_trial

KINDS = ("plates", "beams", "spheres", "none")
ASTRAY = Errors(position_m=0.005, axis_rad=float(np.deg2rad(0.3)), current=0.003)
FREE = {
    "exact": frozenset({Free.FIELD}),
    "5 mm": frozenset({Free.FIELD, Free.POSITION, Free.AXIS, Free.CURRENT}),
}


def judged(site: Site, trial: MetalTrial) -> tuple[float, float, float]:
    """Return the median error, m, the mean NEES/3 of poses that did not fail, and the share of ``inconsistent``."""
    poses = Locator(site).locate_many(trial.later)
    error = np.array([pose.position_m - true for pose, true in zip(poses, trial.later_m, strict=True)])
    nees = [
        one @ np.linalg.solve(pose.position_cov_m2, one) / 3.0
        for pose, one in zip(poses, error, strict=True)
        if np.isfinite(one).all()
    ]
    wrong = float(np.mean([pose.status == "inconsistent" for pose in poses]))
    return float(np.nanmedian(np.linalg.norm(error, axis=1))), float(np.mean(nees)), wrong


def main() -> None:
    """Print a row a room."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kind", nargs="*", default=KINDS, choices=KINDS)
    parser.add_argument("--seeds", type=int, default=3)
    arguments = parser.parse_args()
    print("room      seed  site    metal's part  before mm  after mm  ratio  NEES/3  incon %  found          CPU s")
    for kind in arguments.kind:
        for seed in range(11, 11 + arguments.seeds):
            for name, free in FREE.items():
                exact = name == "exact"
                trial = metal_trial(kind, seed, points=0 if exact else 10, errors=EXACT if exact else ASTRAY)
                before = judged(trial.site, trial)
                start = time.process_time()
                result = survey(trial.site, trial.data, free)
                spent = time.process_time() - start
                after = judged(result.site, trial)
                metal = result.site.metal
                found = "none" if metal is None else f"degree {metal.degree}, {len(metal.body_m)} bodies"
                print(
                    f"{kind:<9} {seed:>4}  {name:<6}  {trial.share:>11.1%}  {1e3 * before[0]:>9.2f}  "
                    f"{1e3 * after[0]:>8.2f}  {before[0] / after[0]:>5.1f}  {after[1]:>6.2f}  {100 * after[2]:>7.1f}  "
                    f"{found:<18} {spent:>5.0f}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
