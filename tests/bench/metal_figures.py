"""What learning the metal of a room gains: ``python -m tests.bench.metal_figures [--seeds N] [KIND ...]``.

Each room is surveyed from a walk of 400 epochs at .2 mG (`metal_trials`), once with an exact site and no known point,
once with a site 5 mm, .3 degree and .3 % off, ten known points and the beacons free too. Told is the median error of
200 later poses before and after; NEES/3 is the mean normalised square error per axis after the survey of those poses
that are ``ok``, of which the share is told: the later walk leaves the surveyed room here and there.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass

import numpy as np

from goldfield.locate import Locator
from goldfield.site import Site
from goldfield.survey import Free, survey
from goldfield.types import Status
from tests.bench.integrity_sites import EXACT, Errors
from tests.bench.metal_trials import MetalTrial, metal_trial
from tests.command import one_of, whole_number

KINDS = ("plates", "beams", "spheres", "none")
ASTRAY = Errors(position_m=0.005, axis_rad=float(np.deg2rad(0.3)), current=0.003)
FREE = {
    "exact": frozenset({Free.FIELD}),
    "5 mm": frozenset({Free.FIELD, Free.POSITION, Free.AXIS, Free.CURRENT}),
}


@dataclass(frozen=True)
class Judged:
    """Later poses beside the truth: their median error, m; mean NEES/3 of those that are ``ok``; shares of statuses."""

    median_m: float
    nees: float
    sound: float
    wrong: float


def judged(site: Site, trial: MetalTrial) -> Judged:
    """Locate the later epochs of a trial and compare them with the truth."""
    poses = Locator(site).locate_many(trial.later)
    error = np.array([pose.position_m - true for pose, true in zip(poses, trial.later_m, strict=True)])
    nees = [
        one @ np.linalg.solve(pose.position_cov_m2, one) / 3.0
        for pose, one in zip(poses, error, strict=True)
        if pose.status is Status.OK
    ]
    return Judged(
        float(np.nanmedian(np.linalg.norm(error, axis=1))),
        float(np.mean(nees)) if nees else float("nan"),
        len(nees) / len(poses),
        float(np.mean([pose.status is Status.INCONSISTENT for pose in poses])),
    )


def main() -> None:
    """Print a row a room."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "kind", nargs="*", type=one_of(KINDS), metavar="KIND", help=f"of {', '.join(KINDS)}; default: all"
    )
    parser.add_argument("--seeds", type=whole_number(1), default=3)
    arguments = parser.parse_args()
    unknown = set(arguments.kind) - set(KINDS)
    if unknown:
        parser.error(f"{', '.join(sorted(unknown))}: none of {', '.join(KINDS)}")
    print("room      seed  site    metal's part  before mm  after mm  ratio  NEES/3  ok %  incon %  found", end="")
    print("                CPU s")
    for kind in arguments.kind or KINDS:
        squares: dict[str, list[float]] = {name: [] for name in FREE}
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
                squares[name].append(after.nees)
                print(
                    f"{kind:<9} {seed:>4}  {name:<6}  {trial.share:>11.1%}  {1e3 * before.median_m:>9.2f}  "
                    f"{1e3 * after.median_m:>8.2f}  {before.median_m / after.median_m:>5.1f}  {after.nees:>6.2f}  "
                    f"{100 * after.sound:>4.0f}  {100 * after.wrong:>7.1f}  {found:<19} {spent:>5.0f}",
                    flush=True,
                )
        for name, some in squares.items():
            print(f"{kind:<9} mean  {name:<6}  NEES/3 {np.mean(some):.2f}", flush=True)


if __name__ == "__main__":
    main()
