"""What a sensor that chooses its beacons gets out of a hall of 100: false and missed codes, and the error of poses.

``python -m tests.bench.strongest_figures`` prints the figures of ``docs/cli.md``. The choice is the firmware's own, on
cycles of the exact fields of loops and white noise; separation and location are the host's.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from typing import Any

import magpylib
import numpy as np
from scipy.spatial.transform import Rotation

from goldfield.access.epoch import EpochSeparator
from goldfield.access.gold import code_matrix
from goldfield.link.reports import Report
from goldfield.locate import locate
from goldfield.site import HalfSpace, Site
from goldfield.types import FloatArray, Pose, Status
from hil_sim import clib
from tests.bench.locate_trials import loop_beacon, site_of
from tests.command import whole_number

DEGREE, CHIPS = 10, 1023
NOISE_T = 2e-8
SPACING_M, HEIGHT_M, COUNT = 4.5, 2.7, 10
NINETY_NINE = 11.345
"""What chi square of three degrees of freedom exceeds in one of 100 cases."""
COUNT_T = 2e-4 * 2 / 4096 / 8
"""Tesla in a unit of a sample: an eighth of a count of a converter for +-2 G."""

HEADERS = ("core/codes/gold.h", "core/codes/despread.h", "core/codes/epoch.h", "core/codes/strongest.h")


class Board:
    """The part of the firmware that chooses codes."""

    def __init__(self) -> None:
        self._ffi, self._lib = clib.load("libgf_core.so", HEADERS)
        self._family: Any = self._lib.gold_family(DEGREE)
        self._state: Any = self._ffi.new("strongest_t *")
        self._despread: Any = self._ffi.new("despread_t *")
        self._selection: Any = self._ffi.new("epoch_selection_t *")
        self._lib.strongest_init(self._state, self._family, self._despread)
        self._words = [self._lib.despread_word(self._family, code) for code in range(CHIPS + 1)]
        self._chips = code_matrix(DEGREE, range(CHIPS + 1)).astype(np.float64)
        self.clear()

    def clear(self) -> None:
        """Forget what was chosen."""
        self._lib.strongest_clear(self._state, self._selection)

    def choose(self, samples: FloatArray, most: int) -> list[int]:
        """Return the codes that are chosen of a cycle of whole samples, shape (N, 3)."""
        words = np.zeros((3, 2048), dtype=np.int32)
        words[:, self._words] = np.rint(self._chips.T @ samples).astype(np.int32).T
        self._ffi.buffer(self._despread.words)[:] = words.tobytes()
        self._despread.sum[0:3] = np.rint(samples.sum(axis=0)).astype(int).tolist()
        self._lib.strongest_choose(self._state, self._despread, most, self._selection)
        return [self._selection.codes[i].code for i in range(self._selection.count)]


def lattice(count: int = COUNT) -> Site:
    """Return a hall with ``count`` squared beacons at its ceiling, all pointing up, with balanced codes."""
    sums = code_matrix(DEGREE, range(CHIPS)).sum(axis=0, dtype=np.int64)
    codes = np.flatnonzero(sums == -1)[: count**2]
    places = [(SPACING_M * (i % count), SPACING_M * (i // count), HEIGHT_M) for i in range(count**2)]
    beacons = [replace(loop_beacon(i, place), code=int(codes[i])) for i, place in enumerate(places)]
    below = HalfSpace(np.array([0.0, 0.0, HEIGHT_M]), np.array([0.0, 0.0, -1.0]))
    return site_of(beacons, below, NOISE_T)


def fields_of(site: Site, position_m: FloatArray, turn: Rotation) -> FloatArray:
    """Return the field of each beacon in the sensor's frame, T, by magpylib."""
    centres = np.array([beacon.position_m for beacon in site.beacons])
    coil = magpylib.current.Circle(diameter=0.298, current=190.0)
    return np.asarray(turn.inv().apply(coil.getB(position_m - centres)))


def report_of(samples: FloatArray, codes: list[int], chips: FloatArray) -> Report:
    """Return what a sensor reports of a cycle."""
    report = Report(0, 0.05, CHIPS, 0, len(codes), True, has_header=True)
    report.offset_T = samples.mean(axis=0) * COUNT_T
    report.correlation_T = {code: chips[:, code] @ samples / CHIPS * COUNT_T for code in codes}
    return report


def walk(site: Site, poses: int, limits: tuple[int, ...], seed: int = 1) -> dict[int, list[tuple[FloatArray, Pose]]]:
    """Return the true position and the pose of each place, by the most codes; 0: the list of all."""
    rng, board = np.random.default_rng(seed), Board()
    chips = code_matrix(DEGREE, range(CHIPS + 1)).astype(np.float64)
    separator, columns = EpochSeparator(site), chips[:, list(site.codes)]
    found: dict[int, list[tuple[FloatArray, Pose]]] = {most: [] for most in limits}
    edge = SPACING_M * (int(np.sqrt(len(site.beacons))) - 1)
    for _ in range(poses):
        position = np.array([*rng.uniform(SPACING_M, edge - SPACING_M, 2), rng.uniform(0.3, 2.0)])
        turn = Rotation.random(random_state=rng)
        tesla = columns @ fields_of(site, position, turn) + [2e-5, 0.0, -4.5e-5]
        samples = np.rint((tesla + rng.normal(0.0, NOISE_T, tesla.shape)) / COUNT_T)
        for most in limits:
            board.clear()
            for _ in range(2):
                chosen = board.choose(samples, most) if most else list(site.codes)
            fields = separator.fields(report_of(samples, chosen, chips), most)
            found[most].append((position, locate(site, fields)))
    return found


def false_and_missed(cycles: int, seed: int = 2) -> tuple[int, dict[float, tuple[float, float]]]:
    """Return the codes that came of noise alone, and how often a beacon of so many s enters, and has stayed in."""
    rng, board = np.random.default_rng(seed), Board()
    chips = code_matrix(DEGREE, [512])[:, 0].astype(np.float64)
    sigma = 100.0

    def cycle(size: float) -> FloatArray:
        samples = rng.normal(0.0, sigma, (CHIPS, 3))
        samples[:, 0] += chips * size * sigma / np.sqrt(CHIPS)
        return np.rint(samples)

    wrong, heard = 0, {}
    for _ in range(cycles):
        wrong += len(board.choose(cycle(0.0), 64))
    for size in (3.0, 4.0, 5.0, 5.55, 6.0, 7.0, 8.7):
        entered = stayed = 0
        for _ in range(cycles // 10):
            board.clear()
            entered += 512 in board.choose(cycle(size), 64)
            board.choose(cycle(25.0), 64)
            stayed += 512 in board.choose(cycle(size), 64)
        heard[size] = (10 * entered / cycles, 10 * stayed / cycles)
    return wrong, heard


def main(given: list[str] | None = None) -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench.strongest_figures", description=__doc__)
    parser.add_argument(
        "--poses", type=whole_number(1), default=400, metavar="N", help="places in the hall (default 400)"
    )
    parser.add_argument(
        "--cycles", type=whole_number(2), default=5000, metavar="N", help="cycles of noise (default 5000)"
    )
    options = parser.parse_args(given)
    limits = (0, 6, 7, 8, 10, 12, 16, 24)
    found = walk(lattice(), options.poses, limits)
    heads = ("K", "codes used, median", "rms error, cm", "median, cm", "95 %, cm", "not `ok`", "beyond 99 %")
    print(f"| {' | '.join(heads)} |\n|{' --- |' * len(heads)}")
    for most in limits:
        poses = [(truth, pose) for truth, pose in found[most] if pose.status is not Status.FAILED]
        off = np.array([pose.position_m - truth for truth, pose in poses])
        errors = 100.0 * np.linalg.norm(off, axis=1)
        ratio = [d @ np.linalg.solve(pose.position_cov_m2, d) for d, (_, pose) in zip(off, poses, strict=True)]
        bad = len(found[most]) - sum(pose.status is Status.OK for _, pose in poses)
        cells = (
            str(most or "list of 100"),
            f"{np.median([len(pose.used) for _, pose in poses]):.0f}",
            f"{np.sqrt(np.mean(errors**2)):.2f}",
            f"{np.median(errors):.2f}",
            f"{np.quantile(errors, 0.95):.2f}",
            f"{bad} of {options.poses}",
            f"{100.0 * np.mean(np.array(ratio) > NINETY_NINE):.1f} %",
        )
        print(f"| {' | '.join(cells)} |")
    wrong, heard = false_and_missed(options.cycles)
    print(f"\nnoise alone: {wrong} false codes in {options.cycles} cycles")
    for size, (entered, stayed) in heard.items():
        print(f"a beacon of {size:g} s: enters in {entered:.1%} of cycles, stays in {stayed:.1%}")


if __name__ == "__main__":
    main()
