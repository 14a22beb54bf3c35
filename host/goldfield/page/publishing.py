"""Puts what a sensor yields on the page: each epoch, each pose, and now and then the health of the boards."""

from __future__ import annotations

import can

from goldfield.page.hub import Hub, State
from goldfield.page.messages import Progress, epoch_message, fix_message, health_message, progress_message
from goldfield.sensor.pipeline import Epoch, Fix, Sensor
from goldfield.sensor.receiver import Recorder
from goldfield.site import Site
from goldfield.view.monitor import Monitor, RosterRecorder

HEALTH_EVERY_S = 0.5
"""Time of the sensor from one message of health to the next, s."""


class Publisher:
    """Publishes the items of one sensor in the order in which they come, in the thread that reads the sensor.

    It never waits: the hub keeps what a browser has not taken yet, and forgets the oldest of it.

    Parameters
    ----------
    hub : Hub
    site : Site
    name : str
        The link's name, or the recording's.

    Attributes
    ----------
    epochs : int
        How many epochs were published.
    """

    def __init__(self, hub: Hub, site: Site, name: str) -> None:
        self.epochs = 0
        self._hub = hub
        self._heard = RosterRecorder()
        self._monitor = Monitor(site, name, self._heard.roster)
        self._sensor: Sensor | None = None
        self._health_every = max(1, round(HEALTH_EVERY_S / site.cycle_s))

    def recorder(self, other: Recorder | None = None) -> Recorder:
        """Return what must record the sensor's link, so that the page knows the boards; it gives on to another one."""
        return self._heard if other is None else Both(self._heard, other)

    def publish(self, item: Epoch | Fix, sensor: Sensor) -> None:
        """Publish an epoch, or a pose at a time of its own."""
        if isinstance(item, Fix):
            self._hub.publish_fix(fix_message(item))
            return
        if self._sensor is not sensor:
            self._sensor = sensor
            self._hub.watch(lambda: sensor.gone)
        self._monitor.node = sensor.node
        self._monitor.add(item)
        self._hub.publish_epoch(epoch_message(item))
        if self.epochs % self._health_every == 0:
            self._hub.publish_health(health_message(self._monitor, self._heard.roster))
        self.epochs += 1

    def tell(self, progress: Progress, *, busy: bool = False) -> None:
        """Publish how far a survey or a calibration is; ``busy``: the sensor is not read while the host computes."""
        self._hub.publish_progress(progress_message(progress))
        if busy:
            self._hub.set_state(State.BUSY, "the host computes; the sensor is not read meanwhile")


class Both:
    """Records for two recorders."""

    def __init__(self, first: Recorder, second: Recorder) -> None:
        self._recorders = (first, second)

    def write(self, message: can.Message, /) -> None:
        """Give the next message to both."""
        for recorder in self._recorders:
            recorder.write(message)

    def close(self) -> None:
        """Close both."""
        for recorder in self._recorders:
            recorder.close()
