"""The site that the options ``--site`` and ``--beacons`` name: the paper's room, a room of its kind, or boards."""

from __future__ import annotations

import argparse
from importlib.resources import as_file, files

from goldfield import site as sites
from goldfield.errors import UserError
from goldfield.site import dual_axis
from goldfield.site import rotating as rotating_site
from goldfield.site.dual_axis import DualAxisSite
from goldfield.site.rotating import RotatingSite


def simulated(arguments: argparse.Namespace, least_beacons: int) -> RotatingSite:
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
