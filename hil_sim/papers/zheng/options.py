"""Options that the actions of ``goldfield paper zheng`` share."""

from __future__ import annotations

import argparse
from importlib.resources import as_file, files
from typing import TYPE_CHECKING

from goldfield import site as sites
from goldfield.cli.options import add_json, finite
from goldfield.errors import UserError
from goldfield.site import dual_axis
from goldfield.site import rotating as rotating_site
from goldfield.site.dual_axis import DualAxisSite
from goldfield.site.rotating import RotatingSite

if TYPE_CHECKING:
    from hil_sim.papers.zheng.room import Setting

__all__ = [
    "add_json",
    "add_site",
    "add_world",
    "count",
    "dual_axis_beacons",
    "finite",
    "measured_site",
    "positive",
    "setting",
    "site",
]


def add_site(parser: argparse.ArgumentParser, beacons: int | None = None) -> None:
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


def add_world(parser: argparse.ArgumentParser) -> None:
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


def site(arguments: argparse.Namespace, least_beacons: int) -> RotatingSite:
    """Load the site of the options for an experiment in a simulated room.

    Raises
    ------
    UserError
        If it is wrong, has too few beacons, or is a site of boards.
    """
    loaded = measured_site(arguments, least_beacons)
    if isinstance(loaded, DualAxisSite):
        raise UserError(
            f"{arguments.site}: is a site of boards (it has [site]), but the simulated room takes dual-axis beacons "
            "without: goldfield hil simulates boards"
        )
    return loaded


def measured_site(arguments: argparse.Namespace, least_beacons: int) -> RotatingSite | DualAxisSite:
    """Load the site of the options: of dual-axis beacons, or of boards that drive them in pairs.

    Raises
    ------
    UserError
        If it is wrong or has too few beacons.
    """
    loaded: RotatingSite | DualAxisSite
    if arguments.site is None:
        with as_file(files("hil_sim.papers.zheng") / "data" / "zheng6.toml") as path:
            loaded = rotating_site.load(path)
    elif rotating_site.is_of_boards(arguments.site):
        of_boards = sites.load(arguments.site)
        try:
            loaded = dual_axis.of_site(of_boards)
        except UserError as error:
            raise UserError(f"{arguments.site}: {error}") from error
    else:
        loaded = rotating_site.load(arguments.site)
    available = len(dual_axis_beacons(loaded).beacons)
    wanted = available if arguments.beacons is None else arguments.beacons
    if wanted > available:
        raise UserError(f"--beacons is {wanted}: the site has only {available}")
    if wanted < least_beacons:
        raise UserError(
            f"this needs at least {least_beacons} beacons, not {wanted}: raise --beacons or extend the site"
        )
    return loaded.first(wanted)


def dual_axis_beacons(site: RotatingSite | DualAxisSite) -> RotatingSite:
    """Return the dual-axis beacons of a site of either kind."""
    return site.rotating if isinstance(site, DualAxisSite) else site


def setting(arguments: argparse.Namespace, site: RotatingSite) -> Setting:
    """Return the simulation's setting.

    Raises
    ------
    UserError
        If a value makes no sense.
    """
    from hil_sim.papers.zheng.room import Setting

    x0, x1, y0, y1, z0, z1 = arguments.box
    if x0 > x1 or y0 > y1 or z0 > z1:
        raise UserError("--box: each first number must not exceed the second, as in --box 0 6 0 4.5 .5 .5")
    if arguments.window * arguments.rate > 1e5:
        raise UserError(f"--window {arguments.window:g} s at {arguments.rate:g} Hz: more than 100,000 samples a window")
    if arguments.seed < 0:
        raise UserError(f"--seed is {arguments.seed}: give a whole number of at least 0")
    if arguments.noise_nT is not None and arguments.noise_nT < 0.0:
        raise UserError(f"--noise-nT is {arguments.noise_nT:g}: give a number of at least 0")
    noise_T = site.noise_T if arguments.noise_nT is None else 1e-9 * arguments.noise_nT
    return Setting(arguments.window, arguments.rate, noise_T, arguments.seed, (x0, y0, z0), (x1, y1, z1))


def positive(text: str) -> float:
    """Parse a finite number greater than zero, for argparse."""
    value = finite(text)
    if value <= 0.0:
        raise argparse.ArgumentTypeError(f"{text} is not greater than zero")
    return value


def count(text: str) -> int:
    """Parse a whole number from 1 to 100,000, for argparse."""
    if not (text.isascii() and text.isdigit() and 1 <= int(text) <= 100_000):
        raise argparse.ArgumentTypeError(f"{text} is no whole number from 1 to 100000")
    return int(text)
