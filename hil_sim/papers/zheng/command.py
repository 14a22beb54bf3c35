"""``goldfield paper zheng``: dual-axis beacons; experiments of Zheng et al. 2022, survey of fingerprints, poses."""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np

from goldfield.cli.output import json_line
from hil_sim.papers.zheng import options, room_reports, survey


def command(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        "zheng",
        help="dual-axis (rotating-field) beacons: experiments, survey, poses",
        description="Beacons of two crossed coils driven with cosine and sine (Zheng et al. 2022).",
    )
    actions = parser.add_subparsers(title="actions", metavar="ACTION", required=True)
    table1 = actions.add_parser("table1", help="the paper's measured points, located by each method")
    options.add_json(table1)
    table1.set_defaults(run=run_table1)

    room_reports.add_actions(actions)
    survey.add_actions(actions)


def run_table1(arguments: argparse.Namespace) -> int:
    """Print a line a method."""
    from hil_sim.papers.zheng import table1

    table = table1.read()
    if not arguments.json:
        print(f"{'mean error, 7 points':38s} {'3-D m':>8} {'z known m':>10}")
    for score in table1.scores(table):
        known = None if score.error_known_height_m is None else float(score.error_known_height_m.mean())
        if arguments.json:
            record = {"method": score.method, "error_m": float(score.error_m.mean()), "error_known_height_m": known}
            print(json_line({**record, "each_m": score.error_m.tolist()}))
        else:
            print(f"{score.method:38s} {score.error_m.mean():8.3f} {'' if known is None else f'{known:10.3f}':>10}")
    if not arguments.json:
        angles = ", ".join(f"{angle:.2f}" for angle in np.abs(table.angle_deg).mean(axis=0))
        print(f"The paper prints {table1.PRINTED_MEAN_ERROR_M} m for its own. Its printed angles: mean {angles} deg.")
    return 0
