"""The simulated room that the options of ``goldfield paper zheng`` describe."""

from __future__ import annotations

import argparse

from goldfield.errors import UserError
from goldfield.site.rotating import RotatingSite
from hil_sim.papers.zheng import sites
from hil_sim.papers.zheng.room import Room, Setting


def room(arguments: argparse.Namespace, least_beacons: int) -> Room:
    """Open the room of the options.

    Raises
    ------
    UserError
        If the site is wrong or has too few beacons, or a value makes no sense.
    """
    site = sites.simulated(arguments, least_beacons)
    return Room(site, setting(arguments, site))


def setting(arguments: argparse.Namespace, site: RotatingSite) -> Setting:
    """Return the simulation's setting.

    Raises
    ------
    UserError
        If a value makes no sense.
    """
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
