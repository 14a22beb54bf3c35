"""What is asked for: a site, the points, and the settings of the computation."""

from __future__ import annotations

from dataclasses import dataclass, field
from numbers import Integral, Real

from goldfield.errors import UserError, option
from goldfield.planning.grid import Grid
from goldfield.site import Site

MOST_DB = 1000.0
"""Largest ratio of two fields, in decibels; a number beyond some 6000 dB has no ratio that a computer represents."""


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

    def __post_init__(self) -> None:
        """Refuse what is no setting."""
        if not (_is_whole(self.best) and self.best >= 1):
            raise UserError(f"{option('best', self.best)} is no whole number of at least 1")
        if not (_is_real(self.truncation) and 0.0 <= self.truncation < 1.0):
            raise UserError(f"{option('truncation', self.truncation)} is no part of 0 to below 1")
        if not (_is_real(self.conflict_dB) and abs(self.conflict_dB) <= MOST_DB):
            raise UserError(
                f"{option('conflict_dB', self.conflict_dB)} is no ratio of fields: give {-MOST_DB:g} to {MOST_DB:g} dB"
            )


def _is_whole(value: object) -> bool:
    return isinstance(value, Integral) and not isinstance(value, bool)


def _is_real(value: object) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool)


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

    def __post_init__(self) -> None:
        """Refuse other types."""
        for name, value, kind in (
            ("site", self.site, Site),
            ("grid", self.grid, Grid),
            ("settings", self.settings, Settings),
        ):
            if not isinstance(value, kind):
                raise UserError(f"{name}= of Request is a {kind.__name__}, not {value!r:.60}")
