"""Table 1 of Zheng et al. 2022: its measured strengths, located by each method that needs no more than strengths."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from importlib.resources import as_file, files

import numpy as np

from goldfield.cli.output import json_line
from goldfield.files.csv_table import read_table
from goldfield.types import FloatArray
from hil_sim.papers.zheng.methods.fingerprint import FingerprintMap, LineLocator, nearest_neighbours
from hil_sim.papers.zheng.methods.lines import NANOTESLA, Lines
from hil_sim.papers.zheng.methods.trilateration import trilaterate

BEACON_M = np.array([[0.0, 0.0, 0.0], [6.20, 0.54, 0.0], [3.20, 4.28, 0.0]])
PRINTED_LINES = Lines(np.array([-2.995, -3.001, -3.005]), np.array([9.353, 9.217, 9.057]))
PRINTED_MEAN_ERROR_M = 0.108
POINT, STRENGTH = ("x_m", "y_m", "z_m"), ("ln_b1", "ln_b2", "ln_b3")
ESTIMATE, ANGLES = ("est_x_m", "est_y_m", "est_z_m"), ("att_psi_deg", "att_gamma_deg", "att_lambda_deg")


@dataclass(frozen=True, eq=False)
class Table1:
    """The measured table.

    Attributes
    ----------
    position_m, strength_T, estimate_m, angle_deg : ndarray, shape (7, 3)
        True points; strength of each beacon; what the paper estimated of position and of the angles. The true angles
        are 0.
    """

    position_m: FloatArray
    strength_T: FloatArray
    estimate_m: FloatArray
    angle_deg: FloatArray


@dataclass(frozen=True, eq=False)
class Score:
    """How well a method locates the table's points.

    Attributes
    ----------
    method : str
    error_m : ndarray, shape (7,)
        Errors of the position in space.
    error_known_height_m : ndarray, shape (7,), or None
        The same errors when the method is given the true height.
    """

    method: str
    error_m: FloatArray
    error_known_height_m: FloatArray | None = None


def read() -> Table1:
    """Read the table that comes with this package."""
    with as_file(files("hil_sim.papers.zheng") / "data" / "zheng2022_table1.csv") as path:
        rows = list(read_table(path, POINT + STRENGTH + ESTIMATE + ANGLES))

    def columns(names: tuple[str, ...]) -> FloatArray:
        return np.array([[row.number(name) for name in names] for row in rows])

    return Table1(columns(POINT), np.exp(columns(STRENGTH)) * NANOTESLA, columns(ESTIMATE), columns(ANGLES))


def scores(table: Table1) -> list[Score]:
    """Score the paper's estimates and the methods; a leave-one-out map holds the other six points."""
    truth, z = table.position_m, table.position_m[:, 2]
    by_lines = PRINTED_LINES.ranges(table.strength_T)
    local, local_known, neighbours = [], [], []
    for point in range(len(truth)):
        others = FingerprintMap(("1", "2", "3"), truth, table.strength_T).without(point)
        locator = LineLocator(BEACON_M, others)
        here = table.strength_T[point : point + 1]
        # Six points of one height cannot tell slope from intercept: the printed slopes, the intercepts left out.
        local.append(locator.by_local_lines(here, slope=PRINTED_LINES.slope)[0])
        local_known.append(locator.by_local_lines(here, z[point : point + 1], PRINTED_LINES.slope)[0])
        neighbours.append(nearest_neighbours(others, here)[0])

    def error(estimate: FloatArray | list[FloatArray]) -> FloatArray:
        return np.asarray(np.linalg.norm(np.asarray(estimate) - truth, axis=1))

    return [
        Score("the paper's own estimates", error(table.estimate_m)),
        Score(
            "eqn 17 with the printed lines",
            error(trilaterate(BEACON_M, by_lines)),
            error(trilaterate(BEACON_M, by_lines, z_m=z)),
        ),
        Score("local lines, leave one out", error(local), error(local_known)),
        Score("4 nearest fingerprints, leave one out", error(neighbours)),
    ]


def run(arguments: argparse.Namespace) -> int:
    """Print a line a method."""
    table = read()
    if not arguments.json:
        print(f"{'mean error, 7 points':38s} {'3-D m':>8} {'z known m':>10}")
    for score in scores(table):
        known = None if score.error_known_height_m is None else float(score.error_known_height_m.mean())
        if arguments.json:
            record = {"method": score.method, "error_m": float(score.error_m.mean()), "error_known_height_m": known}
            print(json_line({**record, "each_m": score.error_m.tolist()}))
        else:
            print(f"{score.method:38s} {score.error_m.mean():8.3f} {'' if known is None else f'{known:10.3f}':>10}")
    if not arguments.json:
        angles = ", ".join(f"{angle:.2f}" for angle in np.abs(table.angle_deg).mean(axis=0))
        print(f"The paper prints {PRINTED_MEAN_ERROR_M} m for its own. Its printed angles: mean {angles} deg.")
    return 0
