"""Feeds the hub: a sensor is opened, and opened again if its link fails; a recording is played at its own pace."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable

from goldfield.errors import SystemFailure, UserError, tell
from goldfield.link.buses import Source
from goldfield.page.hub import Hub, State
from goldfield.page.publishing import Publisher
from goldfield.sensor.opening import open_sensor
from goldfield.sensor.options import Options
from goldfield.sensor.pipeline import Epoch, Fix
from goldfield.site import Site

RETRY_S = 1.0
"""Wait before a link that failed is opened again, s."""


class Feed:
    """Reads one source for a hub, in the caller's thread.

    Parameters
    ----------
    hub : Hub
    kind, where : str
        The source, as for `open_sensor`.
    site : Site
    options : Options
    pace : float
        A recording is played so many times faster than it was made; 0: as fast as it can be computed.
    also : callable, optional
        Gets each item, too, when it is due; it does not wait.
    source : Source, optional
        The source, if it is open already; the feed closes it.
    """

    def __init__(
        self,
        hub: Hub,
        kind: str,
        where: str,
        site: Site,
        options: Options,
        pace: float = 1.0,
        also: Callable[[Epoch | Fix], None] | None = None,
        source: Source | None = None,
    ) -> None:
        self._hub = hub
        self._kind, self._where = kind, where
        self._site, self._options = site, options
        self._publisher = Publisher(hub, site, where)
        self._also = also
        self._told = ""
        self._source = source
        self._pacing = Pacing(pace if kind == "log" else 0.0)
        self.stopped = threading.Event()

    def run(self) -> None:
        """Feed the hub to the end of a recording, or of a live sensor until `stopped` is set or Ctrl-C.

        A live link that fails after its first epoch, or a sensor that is not heard, is tried again without end, and the
        page says so.

        Raises
        ------
        UserError
            If the source cannot be opened at first, or the recording holds nothing of use.
        """
        while not self.stopped.is_set():
            try:
                self._read()
            except (SystemFailure, UserError) as error:
                if self._kind == "log" or (isinstance(error, UserError) and not self._publisher.epochs):
                    raise
                self._tell(str(error))
                self.stopped.wait(RETRY_S)
            else:
                break
        self._hub.set_state(State.ENDED)

    def _tell(self, error: str) -> None:
        """Say that the link failed: on the page, and once on stderr."""
        self._hub.set_state(State.LOST, error)
        if error != self._told:
            tell(f"{error}; trying again")
        self._told = error

    def _read(self) -> None:
        source, self._source = self._source, None  # the second time it is opened anew
        recorder = self._publisher.recorder()
        with open_sensor(self._kind, self._where, self._site, self._options, recorder, source) as sensor:
            for item in sensor.stream():
                self._pacing.wait(item.pose.time_s, self.stopped)
                self._publisher.publish(item, sensor)
                if self._also is not None:
                    self._also(item)
                if self.stopped.is_set():
                    return


class Pacing:
    """Waits until what was recorded is due.

    Parameters
    ----------
    pace : float
        How many times faster than it was recorded; 0: nothing waits.
    """

    LONGEST_S = 5.0
    """A gap that is longer is not waited for: the sensor's clock began again, or nothing came."""

    def __init__(self, pace: float) -> None:
        self._pace = pace
        self._due_s = self._last_s = math.nan

    def wait(self, time_s: float, stopped: threading.Event) -> None:
        """Wait for what has this time on the sensor's clock, or until an event is set; NaN is due at once."""
        if not self._pace or math.isnan(time_s):
            return
        now_s, step_s = time.monotonic(), time_s - self._last_s
        self._last_s = time_s
        if not 0.0 <= step_s <= self.LONGEST_S:  # the first one, too
            self._due_s = now_s
            return
        self._due_s = max(self._due_s + step_s / self._pace, now_s - self.LONGEST_S)
        stopped.wait(max(0.0, self._due_s - now_s))
