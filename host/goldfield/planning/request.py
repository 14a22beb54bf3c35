"""What is asked for: a site, the points, and the settings of the computation."""

from __future__ import annotations

from dataclasses import dataclass, field

from goldfield.planning.grid import Grid
from goldfield.site import Site


@dataclass(frozen=True)
class Settings:
    """Settings of a plan.

    Attributes
    ----------
    best : int
        Size of the best-K set: the beacons that have the largest part in the position.
    truncation : float
        Largest permitted truncation error: beacons from far are left out as long as the standard deviations are by
        no more than this part too large; 0 takes every beacon everywhere.
    conflict_dB : float
        Two beacons may share a code if, wherever one of them belongs to the best-K set, the other's field is weaker
        than its own by at least this much.
    """

    best: int = 8
    truncation: float = 0.01
    conflict_dB: float = 40.0


@dataclass(frozen=True, eq=False)
class Request:
    """A plan that is to be computed; it can be sent to other processes and machines.

    Attributes
    ----------
    site : Site
    grid : Grid
    settings : Settings
    """

    site: Site
    grid: Grid
    settings: Settings = field(default_factory=Settings)
