"""The time of a measurement by the wall clock, from times on a sensor's own clock and times of arrival."""

from __future__ import annotations

import math
import time

from goldfield.sensor.pipeline import Epoch, Fix

DRIFT = 200e-6
"""Largest relative difference of the rates of a sensor's clock and the wall's: 100 ppm of a crystal, and as much for
a wall clock that is slewed."""
LONGEST_DELAY_S = 30.0
"""A measurement that seems older when it arrives tells that the wall clock was set; a program that a busy machine
stops for seconds tells nothing."""
BACK_S = 3.0
"""A sensor's clock that goes back by more has begun again; a pose may be late by the longest lag, 2 s."""
STEP_S = 0.01
"""A wall clock that gains or loses more on the steady clock was set: what slews it slews both."""
LOOK_S = 0.001
"""Longest time between the looks at two clocks whose difference is to tell something."""


def wall_s() -> float:
    """Return the time by the wall clock, s since 1970."""
    return time.time()


def steady_s() -> float:
    """Return the time by a clock that nobody sets and that does not stand still while the machine sleeps, s."""
    return time.clock_gettime(time.CLOCK_BOOTTIME)


class UnixTime:
    """Tells when a pose was measured, by the wall clock.

    No message tells how long it was on its way. The shortest delay that was seen counts as none, and may grow by
    `DRIFT` where the clocks drift apart: times are late by what the fastest message takes from the end of what it
    tells of to its arrival, about 2 ms on a serial line.

    Parameters
    ----------
    cycle_s : float
        Length of a code cycle: the message that ends a cycle is sent half of it after the cycle's middle.

    Examples
    --------
    >>> clock = UnixTime(cycle_s=0.1)
    >>> for ended_s, arrived_s in ((5.0, 105.0), (6.0, 106.3)):
    ...     clock.note(ended_s, arrived_s)
    >>> round(clock.at(6.0), 3)
    106.0
    """

    def __init__(self, cycle_s: float) -> None:
        self._cycle_s = cycle_s
        self._shift_s = math.inf
        self._latest_s = math.nan
        self._not_before_s, self._not_after_s = -math.inf, math.inf

    def unix_s(self, item: Epoch | Fix) -> float:
        """Return the time of the item's pose by the wall clock, s since 1970; NaN if nothing tells it."""
        if isinstance(item, Epoch):
            self.note(item.report.time_s + 0.5 * self._cycle_s, item.arrived_s)
        else:
            self.note(item.pose.time_s, item.arrived_s)
        return self.at(item.pose.time_s)

    def note(self, ended_s: float, arrived_s: float) -> None:
        """Take when a measurement ended by the sensor's clock, and arrived by the wall's; NaN tells nothing."""
        if not (math.isfinite(ended_s) and self._not_before_s <= arrived_s <= self._not_after_s):
            return
        shift_s = arrived_s - ended_s
        grown_s = self._shift_s + DRIFT * max(0.0, ended_s - self._latest_s)
        set_anew = not (ended_s >= self._latest_s - BACK_S and shift_s - grown_s < LONGEST_DELAY_S)
        self._shift_s = shift_s if set_anew else min(shift_s, grown_s)
        self._latest_s = ended_s if set_anew else max(ended_s, self._latest_s)

    def at(self, time_s: float) -> float:
        """Return a time of the sensor's clock by the wall's; NaN before anything was noted."""
        return time_s + self._shift_s if math.isfinite(self._shift_s) else math.nan

    def set_by(self, step_s: float, now_s: float) -> None:
        """Take that the wall clock was set by so much, forward or back, and shows a time now.

        What arrived before tells nothing any more: by the new time it would have come too early, or be yet to come.
        """
        self._shift_s += step_s
        self._not_before_s = now_s - 0.5 * step_s if step_s > 0.0 else -math.inf


class LiveUnixTime(UnixTime):
    """Tells when a pose was measured while it is, and notices when the wall clock is set.

    NTP sets that of a machine without a battery some seconds after its start, and a person sets any.
    """

    def __init__(self, cycle_s: float) -> None:
        super().__init__(cycle_s)
        self._ahead_s = math.nan
        """By how much the wall clock was ahead of the steady one."""

    def unix_s(self, item: Epoch | Fix) -> float:
        """Return the time of the item's pose, as `UnixTime.unix_s`."""
        before_s, now_s, after_s = steady_s(), wall_s(), steady_s()
        self._not_after_s = now_s + STEP_S
        if after_s - before_s < LOOK_S:
            step_s = now_s - before_s - self._ahead_s
            if not abs(step_s) <= STEP_S:  # the first look, too
                self._ahead_s = now_s - before_s
                if math.isfinite(step_s):
                    self.set_by(step_s, now_s)
        return super().unix_s(item)
