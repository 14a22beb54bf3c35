"""The sensors' motion among the coils, handed to the hot loop window by window, and anew at every event."""

from __future__ import annotations

import math
from bisect import bisect_right
from typing import Any

import numpy as np

from goldfield.errors import SystemFailure, UserError
from hil_sim.scenario import Scenario
from hil_sim.scenario.events import Event
from hil_sim.world import path
from hil_sim.world.metal import BesideMetal, Metal, Source

WINDOW_S = 1.0
"""Length of a window, whole quanta: the windows are the same whatever slices of time the rig is run in."""
WINDOW_PS = round(WINDOW_S * 1e12)
OVERLAP_S = 0.001
"""A window reaches so far beyond its ends: a converter may look a few microseconds ahead."""
EVENT_STEP_PS = 10**9
"""Events happen at whole milliseconds, which are whole quanta."""


def event_ps(event: Event) -> int:
    """Return the virtual time at which an event happens, ps: a whole millisecond."""
    return whole_ps(event.time_s)


def whole_ps(time_s: float) -> int:
    """Return the whole millisecond next to a virtual time, ps."""
    return round(time_s * 1e12 / EVENT_STEP_PS) * EVENT_STEP_PS


class PathWindows:
    """Computes the path of each sensor for the window that the rig is in, and hands it over; the first one at once.

    Parameters
    ----------
    ffi, library
        The rig's library, opened by cffi.
    rig
        The ``rig_t *`` that takes the paths.
    scenario : Scenario

    Raises
    ------
    UserError
        If a sensor comes too near to a coil, or moves too fast to be followed.
    SystemFailure
        If there is not enough memory.
    """

    def __init__(self, ffi: Any, library: Any, rig: Any, scenario: Scenario) -> None:
        self._ffi, self._library, self._rig = ffi, library, rig
        self._scenario = scenario
        ends_s = [time_s for magnet in scenario.magnets for time_s in (magnet.start_s, magnet.stop_s)]
        finite_s = [time_s for time_s in ends_s if 0.0 < time_s < math.inf]
        self._events_ps = sorted({*map(event_ps, scenario.events), *map(whole_ps, finite_s)})
        self._window, self._happened = -1, -1
        self.enter(0)

    def enter(self, now_ps: int) -> int:
        """See that the rig has the window of a virtual time; return when that ends or something happens, ps."""
        window = now_ps // WINDOW_PS
        happened = bisect_right(self._events_ps, now_ps)
        if (window, happened) != (self._window, self._happened):
            self._hand_over(window, happened)
            self._window, self._happened = window, happened
        return min([(window + 1) * WINDOW_PS, *self._events_ps[happened:]])

    def _hand_over(self, window: int, happened: int) -> None:
        """Hand over the motion of one window after some events; a sensor at rest keeps its own until the next one."""
        start_s, stop_s = window * WINDOW_S - OVERLAP_S, (window + 1) * WINDOW_S + OVERLAP_S
        if happened != self._happened:
            time_s = (self._events_ps[happened - 1] + EVENT_STEP_PS // 2) * 1e-12 if happened else -math.inf
            self._now = self._scenario.at(time_s)
            self._magnets = [magnet for magnet in self._scenario.magnets if magnet.present(max(time_s, 0.0))]
            self._coils: list[Source] = [coil for beacon in self._now.beacons for coil in beacon.coils]
            if bodies := self._scenario.metal_at(time_s):
                metal = Metal(bodies)
                self._coils = [BesideMetal(coil, metal) for coil in self._coils]
        for board in range(1 + len(self._now.beacons)):
            if self._now.front_end(board) is None:
                continue
            motion = self._now.motion_of(board)
            still = motion.still and all(magnet.still for magnet in self._magnets)
            if still and happened == self._happened:
                continue
            try:
                self._set(board, path.compute(self._coils, motion, start_s, stop_s, self._magnets))
            except path.PathError as error:
                whose = "" if board == 0 else f" {self._scenario.board_name(board)}:"
                raise UserError(f"scenario {self._scenario.name}:{whose} {error}") from error

    def _set(self, board: int, computed: path.Path) -> None:
        coefficients = np.ascontiguousarray(computed.coefficients)
        handed = self._ffi.new("path_t *")
        handed.start_ps, handed.interval_ps = round(computed.start_s * 1e12), round(computed.interval_s * 1e12)
        handed.intervals, handed.columns = coefficients.shape[:2]
        handed.coefficients = self._ffi.from_buffer("double[]", coefficients)
        if not self._library.rig_set_path(self._rig, board, handed):
            raise SystemFailure("the rig refused a sensor's path: not enough memory")
