"""How near a survey comes to the truth, ten seeds each: ``python -m tests.bench.survey_figures [NAME ...]``.

A row tells the root of the mean square error of the beacons' places over all seeds, the bound (the covariance that the
survey claims), their ratio, the normalised square of all errors per degree of freedom, how many surveys failed and said
so, and how many corrupted epochs were not named. Then for poses afterwards, on the surveyed site: the root of the mean
square error of their places, its bound (by noise and by the covariance of the survey, `tests.bench.survey_poses`), the
ratio, and how many have no pose; and the seconds of the processor for a survey.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass, replace

import numpy as np

from goldfield.errors import SystemFailure
from goldfield.locate import Locator
from goldfield.survey import SurveyResult
from goldfield.survey.outcome import Solution
from goldfield.survey.parameters import default_free
from goldfield.survey.procedure import result_of, solve
from tests.bench.integrity_sites import Errors
from tests.bench.survey_poses import PoseScore, poses_afterwards
from tests.bench.survey_trials import ASTRAY, Room, Score, Trial, cube, lattice, score, trial
from tests.command import one_of, whole_number

CHAIN = Errors(position_m=0.01, axis_rad=np.deg2rad(1.0).item(), current=0.01, gain=0.01, sensor_axis_rad=0.01)
"""What the chain of the README has: 1 cm, 1 degree, 1 %, and 1 % of the sensor's gains."""


@dataclass(frozen=True)
class Case:
    """A kind of survey."""

    room: Room
    points: int = 10
    corrupted: float = 0.0
    anchors: bool = False
    epochs: int = 600
    errors: Errors = ASTRAY


CASES = {
    "cube-10": Case(cube()),
    "cube-4": Case(cube(), points=4),
    "lattice-10": Case(lattice()),
    "lattice-4": Case(lattice(), points=4),
    "cube-5%": Case(cube(), corrupted=0.05),
    "cube-20%": Case(cube(), corrupted=0.2),
    "lattice-20%": Case(lattice(), corrupted=0.2),
    "sensor": Case(cube(), errors=CHAIN),
    "anchors-alone": Case(cube(), points=0, epochs=0, anchors=True),
    "anchors-static": Case(cube(), epochs=10, anchors=True),
    "anchors-walk": Case(cube(), anchors=True),
    "lattice-anchors-static": Case(lattice(), epochs=10, anchors=True),
    "lattice-anchors-walk": Case(lattice(), anchors=True),
}


def made_of(case: Case, seed: int) -> Trial:
    """Draw what is to be surveyed."""
    return trial(
        case.room,
        seed,
        epochs=case.epochs,
        points=case.points,
        corrupted=case.corrupted,
        anchors=case.anchors,
        errors=case.errors,
    )


def attempt(made: Trial) -> tuple[Solution, SurveyResult] | None:
    """Make one survey; None if it fails and says so."""
    free = default_free(made.site)
    try:
        solution = solve(made.site, made.data, free)
    except SystemFailure:
        return None
    return solution, result_of(made.site, solution, made.data, free)


def summary(scores: list[Score]) -> tuple[float, float, float]:
    """Return rms and bound over all seeds, m, and the mean normalised square."""
    rms = float(np.sqrt(np.mean([one.rms_m**2 for one in scores])))
    bound = float(np.sqrt(np.mean([one.bound_m**2 for one in scores])))
    return rms, bound, float(np.mean([one.nees for one in scores]))


def main() -> None:
    """Print a row a case."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", type=one_of(CASES), metavar="NAME", help=f"of {', '.join(CASES)}")
    parser.add_argument("--seeds", type=whole_number(1), default=10)
    parser.add_argument("--epochs", type=whole_number(1), help="length of the walk, in place of the case's")
    arguments = parser.parse_args()
    print(
        f"{'case':<24}{'rms_mm':>8}{'bound_mm':>10}{'ratio':>7}{'nees':>7}{'failed':>8}{'missed':>8}"
        f"{'pose_mm':>9}{'bound_mm':>10}{'ratio':>7}{'lost':>6}{'s':>7}",
        flush=True,
    )
    for name in arguments.names or CASES:
        case = CASES[name] if arguments.epochs is None else replace(CASES[name], epochs=arguments.epochs)
        print(f"{name:<24}{row(case, arguments.seeds)}", flush=True)


def row(case: Case, seeds: int) -> str:
    """Return what all seeds of a case have come to."""
    scores: list[Score] = []
    poses: list[PoseScore] = []
    failed, missed, spent = 0, 0, 0.0
    for seed in range(seeds):
        made = made_of(case, seed)
        start = time.process_time()
        outcome = attempt(made)
        spent += time.process_time() - start
        if outcome is None:
            failed += 1
            continue
        solution, result = outcome
        scores.append(score(result, made))
        poses.append(poses_afterwards(case.room, made, solution, Locator(result.site), seed))
        out = {outlier.epoch for outlier in result.outliers}
        missed += len(set(np.flatnonzero(made.corrupted).tolist()) - out)
    rms, bound, nees = summary(scores) if scores else (np.nan, np.nan, np.nan)
    pose, least = (
        1e3 * float(np.sqrt(np.mean([getattr(one, name) for one in poses]))) if poses else np.nan
        for name in ("square_m2", "bound_m2")
    )
    return (
        f"{1e3 * rms:>8.2f}{1e3 * bound:>10.2f}{rms / bound:>7.2f}{nees:>7.2f}{failed:>8}{missed:>8}"
        f"{pose:>9.2f}{least:>10.2f}{pose / least:>7.2f}{sum(one.lost for one in poses):>6}{spent / seeds:>7.1f}"
    )


if __name__ == "__main__":
    main()
