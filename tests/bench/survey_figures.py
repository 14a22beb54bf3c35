"""How near a survey comes to the truth, ten seeds each: ``python -m tests.bench.survey_figures [NAME ...]``.

A row tells the root of the mean square error of the beacons' places over all seeds, the bound (the covariance that the
survey claims), their ratio, the normalised square of all errors per degree of freedom, and how many surveys failed and
said so. Then for poses afterwards: their error with the surveyed site over that with the true one.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass

import numpy as np

from goldfield.errors import SystemFailure
from goldfield.survey import SurveyResult, survey
from tests.bench.integrity_sites import Errors
from tests.bench.survey_trials import ASTRAY, Room, Score, Trial, cube, lattice, score, trial

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


def attempt(case: Case, seed: int) -> tuple[Trial, SurveyResult | None]:
    """Make one survey; None if it fails and says so."""
    made = trial(
        case.room,
        seed,
        epochs=case.epochs,
        points=case.points,
        corrupted=case.corrupted,
        anchors=case.anchors,
        errors=case.errors,
    )
    try:
        return made, survey(made.site, made.data)
    except SystemFailure:
        return made, None


def summary(scores: list[Score]) -> tuple[float, float, float]:
    """Return rms and bound over all seeds, m, and the mean normalised square."""
    rms = float(np.sqrt(np.mean([one.rms_m**2 for one in scores])))
    bound = float(np.sqrt(np.mean([one.bound_m**2 for one in scores])))
    return rms, bound, float(np.mean([one.nees for one in scores]))


def main() -> None:
    """Print a row a case."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(CASES)}")
    parser.add_argument("--seeds", type=int, default=10)
    arguments = parser.parse_args()
    print(
        f"{'case':<24}{'rms_mm':>8}{'bound_mm':>10}{'ratio':>7}{'nees':>7}{'failed':>8}{'missed':>8}{'s':>7}",
        flush=True,
    )
    for name in arguments.names or CASES:
        scores, failed, missed, start = [], 0, 0, time.process_time()
        for seed in range(arguments.seeds):
            made, result = attempt(CASES[name], seed)
            if result is None:
                failed += 1
                continue
            scores.append(score(result, made))
            out = {outlier.epoch for outlier in result.outliers}
            missed += len(set(np.flatnonzero(made.corrupted).tolist()) - out)
        rms, bound, nees = summary(scores) if scores else (np.nan, np.nan, np.nan)
        spent = (time.process_time() - start) / arguments.seeds
        print(
            f"{name:<24}{1e3 * rms:>8.2f}{1e3 * bound:>10.2f}{rms / bound:>7.2f}{nees:>7.2f}{failed:>8}{missed:>8}"
            f"{spent:>7.1f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
