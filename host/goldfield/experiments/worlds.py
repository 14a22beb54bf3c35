"""Simulated worlds, which other packages offer: nothing in this package knows how they make their fields."""

from __future__ import annotations

from importlib.metadata import entry_points
from typing import Any, Protocol

import numpy as np

from goldfield.errors import SystemFailure
from goldfield.site.rotating import RotatingSite
from goldfield.types import FloatArray

WORLD_GROUP = "goldfield.worlds"


class RotatingWorld(Protocol):
    """A room with dual-axis beacons, of ``hil_sim.world.rotating_room``."""

    def field(self, position_m: FloatArray) -> FloatArray:
        """Amplitudes Bc and Bs in the site's frame, T, shape (e, n, 2, 3), at positions of shape (e, 3)."""

    def samples(
        self,
        position_m: FloatArray,
        rotation: FloatArray,
        time_s: FloatArray,
        noise_T: float,
        rng: np.random.Generator,
        drive: FloatArray | None = None,
    ) -> FloatArray:
        """Return samples, T, sensor's frame, shape (e, t, 3), at e poses at rest; factors (e, n) on the drive."""

    def thermal_drive(self, time_s: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Factor on each beacon's current over the hours after it was switched on, shape (t, n)."""


def rotating_world(site: RotatingSite) -> RotatingWorld:
    """Return the simulated room with a site's beacons.

    Raises
    ------
    SystemFailure
        If no installed package offers one.
    """
    room: RotatingWorld = _load("rotating")(site.beacons)
    return room


def world_module(name: str) -> Any:
    """Return a module of the simulated world: ``emitter``, ``sphere`` or ``boundary_elements``.

    Raises
    ------
    SystemFailure
        If no installed package offers it.
    """
    return _load(name)


def _load(name: str) -> Any:
    for entry_point in entry_points(group=WORLD_GROUP, name=name):
        try:
            return entry_point.load()
        except ImportError as error:
            raise SystemFailure(
                f"the simulated world {entry_point.value} cannot be loaded ({error}): "
                'install its packages with pip install "goldfield[sim]"'
            ) from error
    raise SystemFailure(
        f"no installed package offers a simulated world (entry point {name} of {WORLD_GROUP}): "
        "install goldfield again from its repository, with pip install -e ."
    )
