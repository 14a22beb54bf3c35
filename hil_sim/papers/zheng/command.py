"""``goldfield paper zheng``: dual-axis beacons; experiments in a simulated room, survey of fingerprints, poses."""

from __future__ import annotations

import argparse
from typing import Any

from goldfield.cli.options import add_force, add_json, count, finite
from hil_sim.papers.actions import action
from hil_sim.papers.zheng.columns import COLUMNS_HELP

ALGORITHMS = ("ellipse", "axes", "lines", "regions", "nearest", "local")
"""Names of the algorithms: ours, with all components and with the ellipse's axes alone; the paper's 1 with global lines
and with those of regions; its 2; its 3 as intended."""


def command(subparsers: Any) -> None:
    """Add the subcommand to ``goldfield paper``."""
    parser = subparsers.add_parser(
        "zheng",
        help="dual-axis (rotating-field) beacons: experiments, survey, poses",
        description="Beacons of two crossed coils driven with cosine and sine (Zheng et al. 2022).",
    )
    actions = parser.add_subparsers(title="actions", metavar="ACTION", required=True)
    table1 = actions.add_parser("table1", help="the paper's measured points, located by each method")
    add_json(table1)
    table1.set_defaults(run=action("zheng.table1:run"))
    _add_experiments(actions)
    _add_survey(actions)
    _add_locate(actions)
    _add_simulate(actions)


def _add_experiments(actions: Any) -> None:
    """Add what repeats the paper's figures in a simulated room."""
    compare = actions.add_parser("compare", help="the algorithms in a simulated room (figs 7 and 8)")
    _add_room(compare, runs=200, beacons=3)
    compare.add_argument(
        "--tilt-deg", type=positive, default=90.0, metavar="D", help="largest tilt of the turned sensors"
    )
    compare.set_defaults(run=action("zheng.room_reports:run_compare"))

    reach = actions.add_parser("range", help="error of one beacon's direction over the distance (fig 6)")
    _add_room(reach, runs=400, beacons=1)
    reach.add_argument("--polar-deg", type=positive, default=45.0, metavar="D", help="angle from the beacon's z")
    reach.add_argument("--limit-deg", type=positive, default=5.0, metavar="D", help="what still counts")
    reach.set_defaults(run=action("zheng.room_reports:run_range"))

    beacons = actions.add_parser("beacons", help="three and more beacons (fig 11)")
    _add_room(beacons, runs=200, beacons=6)
    beacons.set_defaults(run=action("zheng.room_reports:run_beacons"))

    stability = actions.add_parser("stability", help="48 h with a drive that drifts with temperature (figs 9 and 10)")
    _add_room(stability, runs=20, beacons=3)
    stability.add_argument("--hours", type=positive, default=48.0, metavar="H", help="of one run; default 48")
    stability.add_argument(
        "--ageing-per-day",
        type=finite,
        default=0.0,
        metavar="X",
        help="steady relative loss of current, to see a trend",
    )
    stability.set_defaults(run=action("zheng.room_reports:run_stability"))


def _add_survey(actions: Any) -> None:
    survey = actions.add_parser(
        "survey",
        help="a map of fingerprints from samples at known places",
        description=f"Writes a map of fingerprints. SAMPLES: {COLUMNS_HELP}; here the places are needed.",
    )
    survey.add_argument("samples", metavar="SAMPLES.csv")
    survey.add_argument("--map", required=True, metavar="MAP.csv", help="to write: point,x_m,y_m,z_m,beacon,strength_T")
    add_force(survey)
    _add_separation(survey)
    _add_site(survey)
    survey.set_defaults(run=action("zheng.survey:run"))


def _add_locate(actions: Any) -> None:
    locate = actions.add_parser(
        "locate",
        help="poses from samples, with or without a map",
        description=f"A pose a window. SAMPLES: {COLUMNS_HELP}; where they have places, errors are shown.",
    )
    locate.add_argument("samples", metavar="SAMPLES.csv")
    locate.add_argument("--map", metavar="MAP.csv", help="of goldfield paper zheng survey; ellipse and axes need none")
    locate.add_argument("--algorithm", choices=ALGORITHMS, default="ellipse", help="default ellipse: all components")
    _add_separation(locate)
    _add_site(locate)
    add_json(locate)
    locate.set_defaults(run=action("zheng.locate:run"))


def _add_simulate(actions: Any) -> None:
    simulate = actions.add_parser(
        "simulate", help="samples of a simulated room", description="Writes samples to try survey and locate with."
    )
    simulate.add_argument("samples", metavar="SAMPLES.csv", help="to write")
    kind = simulate.add_mutually_exclusive_group(required=True)
    kind.add_argument("--grid", action="store_true", help="level, at the places of a survey, every 0.5 m")
    kind.add_argument("--targets", type=count, metavar="N", help="at random places")
    add_force(simulate)
    simulate.add_argument("--tilt-deg", type=positive, metavar="D", help="turned, tilted up to so much")
    _add_site(simulate)
    _add_world(simulate)
    simulate.set_defaults(run=action("zheng.simulate:run"))


def _add_room(parser: argparse.ArgumentParser, *, runs: int, beacons: int) -> None:
    _add_site(parser, beacons)
    _add_world(parser)
    parser.add_argument("--runs", type=count, default=runs, metavar="N", help=f"places, or repetitions; default {runs}")
    parser.add_argument("--figure", metavar="FILE.png", help="also draw it")
    add_force(parser)
    add_json(parser)


def _add_site(parser: argparse.ArgumentParser, beacons: int | None = None) -> None:
    """Add ``--site`` and ``--beacons``; ``beacons``: how many of the site's first ones, None for all."""
    parser.add_argument(
        "--site",
        metavar="FILE",
        help="site file of dual-axis beacons or of boards (TOML); default: the paper's room, zheng6.toml",
    )
    parser.add_argument(
        "--beacons",
        type=count,
        default=beacons,
        metavar="N",
        help=f"only the first N of the site; default {'all' if beacons is None else beacons}",
    )


def _add_world(parser: argparse.ArgumentParser) -> None:
    """Add what a simulated room needs to know."""
    parser.add_argument("--seed", type=int, default=1, help="of every random number; default 1")
    parser.add_argument("--noise-nT", type=finite, metavar="N", help="of a sample; default: the site's")
    parser.add_argument("--window", type=positive, default=1.0, metavar="S", help="seconds of samples; default 1")
    parser.add_argument("--rate", type=positive, default=200.0, metavar="HZ", help="samples a second; default 200")
    parser.add_argument(
        "--box",
        type=finite,
        nargs=6,
        default=[0.0, 6.0, 0.0, 4.5, 0.5, 0.5],
        metavar=("X0", "X1", "Y0", "Y1", "Z0", "Z1"),
        help="where sensors and fingerprints are, m; default 0 6 0 4.5 .5 .5 (the paper's points are at z = .5)",
    )


def _add_separation(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--separation",
        choices=("least-squares", "fft"),
        default="least-squares",
        help="least-squares (default) takes any window; fft, the paper's, only whole periods of every beacon",
    )


def positive(text: str) -> float:
    """Parse a finite number greater than zero, for argparse."""
    value = finite(text)
    if value <= 0.0:
        raise argparse.ArgumentTypeError(f"{text} is not greater than zero")
    return value
