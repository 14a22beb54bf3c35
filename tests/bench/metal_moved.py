"""How soon it is said that metal was moved: ``python -m tests.bench.metal_moved [--seeds N]``.

A room with three sheets is surveyed, its site exact, from a walk of 400 epochs at .2 mG (`metal_trials`). In a later,
slow walk of 60 s the first sheet is moved after 20 s. The epochs go through what `goldfield run` does with them, each
by itself and as a track. Told are, for each method, the time from the move to the first word on it (a status that is
not ``ok``, a beacon that is left out, or a finding), the rms error before the move, from the move to the word and
after, in mm, the part of the epochs after the move that say something, and how many said something before it.
"""

from __future__ import annotations

import argparse

import numpy as np

from goldfield.sensor.location import location
from goldfield.sensor.options import Method
from goldfield.site import Site
from goldfield.survey import Free, survey
from goldfield.types import Pose, Status
from tests.bench.metal_trials import MetalTrial, Move, metal_trial
from tests.command import whole_number

EPOCHS, BEFORE = 600, 200
"""Epochs of the later walk, ten a second, and the one before which the sheet is moved."""
MOVES = ((0.0, 0.0), (0.1, 0.0), (0.0, 0.1), (0.3, 0.0), (0.0, 0.3))
"""How far, m: into the room, along the wall."""


def says_something(pose: Pose) -> bool:
    """Tell whether a pose says that something is not as the site file has it."""
    return pose.status is Status.INCONSISTENT or bool(pose.excluded or pose.findings)


def followed(site: Site, method: Method, trial: MetalTrial) -> tuple[np.ndarray, np.ndarray]:
    """Return of each later epoch whether something was said, and the error of its pose, m."""
    locate = location(site, method)
    poses = [locate(fields, None) for fields in trial.later]
    said = np.array([says_something(pose) for pose in poses])
    where = np.array([pose.position_m for pose in poses])
    return said, np.linalg.norm(where - trial.later_m, axis=1)


def _rms_mm(error_m: np.ndarray) -> float:
    return 1e3 * float(np.sqrt(np.nanmean(error_m**2))) if len(error_m) else float("nan")


def main() -> None:
    """Print a row a move and method."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=whole_number(1), default=3)
    arguments = parser.parse_args()
    print("seed  in cm  along cm  method  first word s  before mm  till then mm  after mm  said %  false")
    for seed in range(11, 11 + arguments.seeds):
        site = None
        for inward_m, along_m in MOVES:
            trial = metal_trial("plates", seed, later=EPOCHS, move=Move(BEFORE, inward_m, along_m))
            if site is None:
                site = survey(trial.site, trial.data, frozenset({Free.FIELD})).site
            for method in (Method.EACH, Method.TRACK):
                said, error = followed(site, method, trial)
                first = int(np.argmax(said[BEFORE:])) if said[BEFORE:].any() else EPOCHS - BEFORE
                told = f"{0.1 * first:.1f}" if said[BEFORE:].any() else "never"
                print(
                    f"{seed:>4}  {100 * inward_m:>5.0f}  {100 * along_m:>8.0f}  {method.name.lower():<6}  {told:>12}  "
                    f"{_rms_mm(error[:BEFORE]):>9.2f}  {_rms_mm(error[BEFORE:][:first]):>12.2f}  "
                    f"{_rms_mm(error[BEFORE + first :]):>8.2f}  {100 * said[BEFORE:].mean():>6.1f}  "
                    f"{said[:BEFORE].sum():>5}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
