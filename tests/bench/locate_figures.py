"""Prints the figures of the locator from seeded runs: ``python -m tests.bench.locate_figures [cube] [board] ...``.

Fields by magpylib, attitude uniform random, no prior. A failure is an error above max(1 cm, 8 bounds) (maths.md, 3).
"""

from __future__ import annotations

import argparse
import time
from collections import Counter

import numpy as np
from scipy.spatial.transform import Rotation

from goldfield.field import FieldModel
from goldfield.locate import Locator
from goldfield.locate.starts import simple_magnitudes
from goldfield.locate.wahba import wahba
from goldfield.types import Status
from tests.bench import locate_speed
from tests.bench import locate_trials as bench
from tests.command import one_of, real_number


def judged(site, run):
    """Locate a run; the poses and its figures."""
    began = time.perf_counter()
    poses = Locator(site).locate_many(bench.fields_of(site, run))
    spent = time.perf_counter() - began
    error = np.array([pose.position_m for pose in poses]) - run.position_m
    size, bound = np.linalg.norm(error, axis=1), bench.bound_of(site, run)
    failed = ~(size <= np.maximum(0.01, 8 * bound))
    turn = bench.turn_error(run.rotation, Rotation.from_quat([p.orientation_xyzw for p in poses]).as_matrix())
    good = ~failed
    attitude = np.array([pose.attitude_cov_rad2 for pose in poses])
    position = np.array([pose.position_cov_m2 for pose in poses])
    figures = {
        "poses": len(poses),
        "failures": int(failed.sum()),
        "bound_median_mm": 1e3 * float(np.median(bound)),
        "rms_error_over_bound": float(np.sqrt(np.mean((size[good] / bound[good]) ** 2))),
        "normalised_error_position": float(bench.normalised_error(error, position)[good].mean()),
        "normalised_error_attitude": float(bench.normalised_error(turn, attitude)[good].mean()),
        "us_per_pose": 1e6 * spent / len(poses),
        "status": dict(Counter(str(pose.status) for pose in poses)),
        "excluded": sum(bool(pose.excluded) for pose in poses),
    }
    return poses, failed, figures


def show(title, figures):
    """Print one line."""
    cells = (f"{key} {value:.4g}" if isinstance(value, float) else f"{key} {value}" for key, value in figures.items())
    print(f"{title}: " + ", ".join(cells), flush=True)


def cube(scale=1.0):
    """Prigge and How's cube at 2 mG inside, at 1.5 and 2 times its size, and at 0.2 mG."""
    result = {}
    for noise, size, count in ((2e-7, 1.0, 20_000), (2e-7, 1.5, 10_000), (2e-7, 2.0, 10_000), (2e-8, 1.0, 10_000)):
        site, rng = bench.prigge_cube(noise), np.random.default_rng(101)
        run = bench.trials(site, bench.cube_positions(rng, int(scale * count), size), rng)
        figures = judged(site, run)[2]
        result[noise, size] = figures
        show(f"cube {noise * 1e7:g} mG, size {size:g}", figures)
    return result


def lattice(scale=1.0):
    """Ceiling lattice at 0.2 mG, with and without a half-space."""
    result = {}
    for half_space in (True, False):
        site, rng = bench.ceiling_lattice(half_space=half_space), np.random.default_rng(102)
        run = bench.trials(site, bench.lattice_positions(rng, int(scale * 10_000)), rng)
        poses, _, figures = judged(site, bench.nearest_only(site, run))
        if not half_space:
            figures["mirror_reported"] = sum(p.alternative is not None for p in poses)
            figures.pop("failures")
        result[half_space] = figures
        show(f"lattice 0.2 mG, half_space {half_space}", figures)
    return result


def board(scale=1.0):
    """Eight spiral coils in a plane, a sensor with one axis 7 cm above, 25 nT of noise a sample."""
    site, rng = bench.spiral_board(), np.random.default_rng(103)
    run = bench.trials(site, bench.board_positions(rng, int(scale * 1000)), rng, axes=(2,))
    figures = judged(site, run)[2]
    figures.pop("normalised_error_attitude")  # the free turn is no error
    show("spiral board, one axis", figures)
    return figures


def steps(scale=1.0):
    """The sources' steps and ours, on the same epochs: rms and median of the position error, share within 1 m."""
    site, rng = bench.prigge_cube(), np.random.default_rng(104)
    run = bench.trials(site, bench.cube_positions(rng, int(scale * 5000)), rng)
    model = FieldModel(site.beacons)
    magnitude = np.linalg.norm(run.field_T, axis=2)
    known = np.ones(magnitude.shape, dtype=bool)
    simple = simple_magnitudes(model, magnitude, run.sigma_T, known, weighted=False)
    full = bench.full_magnitudes(model, magnitude, run.sigma_T, known, simple)
    poses = judged(site, run)[0]
    ours = np.array([pose.position_m for pose in poses])
    table = {}
    for name, position in (("simple magnitudes", simple), ("full magnitudes", full), ("ours", ours)):
        error = np.linalg.norm(position - run.position_m, axis=1)
        if name == "ours":
            rotation = Rotation.from_quat([pose.orientation_xyzw for pose in poses]).as_matrix()
        else:
            rotation = wahba(model.field(position), run.field_T, 1.0 / run.sigma_T**2)
        turn = np.degrees(np.linalg.norm(bench.turn_error(run.rotation, rotation), axis=1))
        near = error < np.maximum(0.01, 8 * bench.bound_of(site, run))
        table[name] = {
            "median_cm": 100 * float(np.median(error)),
            "rms_cm_of_the_nearer_95_percent": 100
            * float(np.sqrt(np.mean(np.sort(error)[: int(0.95 * len(error))] ** 2))),
            "within_8_bounds_percent": 100 * float(near.mean()),
            "wahba_or_fitted_attitude_median_deg": float(np.median(turn)),
        }
        show(name, table[name])
    return table


def faults(scale=1.0):
    """One bad beacon of eight, each kind of fault, and false alarms.

    The effect of a fault on the position is how far it moves the pose that trusts every beacon, the noise being the
    same: a position that is three bounds off by noise alone is no fault, and nothing can detect it. What is detected of
    the epochs whose whole error, noise included, is above three bounds is shown beside it.
    """
    site, rng = bench.prigge_cube(), np.random.default_rng(105)
    locator, result = Locator(site), {}
    for kind in bench.FAULTS:
        effect, error, detected, right, ratio = [], [], [], [], []
        for row in range(8):
            run = bench.trials(site, bench.cube_positions(rng, int(scale * 125)), rng)
            bad = bench.with_fault(kind, site, run, rng, row)
            bound = bench.bound_of(site, run)
            trusting = locator.fit_all(bench.fields_of(site, bad))
            sound = locator.fit_all(bench.fields_of(site, run))
            effect.extend(np.linalg.norm(trusting - sound, axis=1) / bound)
            error.extend(np.linalg.norm(trusting - run.position_m, axis=1) / bound)
            poses = locator.locate_many(bench.fields_of(site, bad))
            after = np.linalg.norm(np.array([pose.position_m for pose in poses]) - run.position_m, axis=1)
            ratio.extend(after / bench.bound_of(site, run, without=row))
            detected.extend(bool(p.excluded) or p.status in (Status.INCONSISTENT, Status.FAILED) for p in poses)
            right.extend(p.excluded == (site.beacons[row].id,) for p in poses)
        large, wide, hit, exact, over = (
            np.array(effect) > 3.0,
            np.array(error) > 3.0,
            np.array(detected),
            np.array(right),
            np.array(ratio),
        )
        result[kind] = {
            "trials": len(large),
            "effect_above_3_bounds": int(large.sum()),
            "detected_of_these_percent": 100 * float(hit[large].mean()),
            "error_above_3_bounds": int(wide.sum()),
            "detected_of_those_percent": 100 * float(hit[wide].mean()),
            "right_one_excluded_percent": 100 * float(exact[large].mean()),
            "error_after_exclusion_over_7_beacon_bound": float(np.sqrt(np.mean(over[exact] ** 2))),
        }
        show(f"fault {kind}", result[kind])
    run = bench.trials(site, bench.cube_positions(rng, int(scale * 20_000)), rng)
    poses = locator.locate_many(bench.fields_of(site, run))
    alarms = sum(bool(pose.excluded) or pose.status is Status.INCONSISTENT for pose in poses)
    result["false alarms"] = {"epochs": len(poses), "alarms": alarms}
    show("no fault", result["false alarms"])
    return result


def elsewhere(scale=1.0):
    """Epochs one by one that need a search or an explanation: five beacons, and eight with one at fault."""
    result = locate_speed.elsewhere(scale)
    for name, figures in result.items():
        show(f"speed, {name}", figures)
    return result


FIGURES = {
    "cube": cube,
    "lattice": lattice,
    "board": board,
    "steps": steps,
    "faults": faults,
    "elsewhere": elsewhere,
}


def main() -> None:
    """Print what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "figures", nargs="*", metavar="NAME", type=one_of(FIGURES), help=f"of {', '.join(FIGURES)}; default: all"
    )
    parser.add_argument("--scale", type=real_number(0.001), default=1.0, help="part of the full number of trials")
    arguments = parser.parse_args()
    for name in arguments.figures or FIGURES:
        FIGURES[name](arguments.scale)


if __name__ == "__main__":
    main()
