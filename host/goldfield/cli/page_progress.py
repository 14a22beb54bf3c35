"""What the live page tells of a survey and of a calibration: how far they are, and what is still to be done."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from goldfield.errors import tell
from goldfield.link.reports import Report
from goldfield.locate.rotations import matrix_of
from goldfield.page.messages import Progress, Row
from goldfield.page.publishing import Publisher
from goldfield.sensor.pipeline import Epoch, Sensor
from goldfield.survey import SurveyResult
from goldfield.types import Fields, Pose

NEAR = np.cos(np.deg2rad(40.0))
"""An axis points up or down if it is no further off than 40 degrees; with a corner up, no axis does."""
TELL_EVERY_S = 0.5
"""Time of the sensor from one message of a turning to the next, s."""
ENOUGH_S = 3.0
"""So long each axis is to point up, and down, s: of a minute's turning less than a third is asked for."""


class SurveyProgress:
    """Tells the page, and stderr, of a survey: each epoch, each look on the way, and what is computed at the end.

    Parameters
    ----------
    page : Publisher
    enough_m : float or None
        Deviation of the beacons that is enough, m.

    Attributes
    ----------
    recorder : Recorder
        What must record the sensor's link.
    """

    def __init__(self, page: Publisher, enough_m: float | None) -> None:
        self._page = page
        self._enough_m = enough_m
        self.recorder = page.recorder()
        self._text = "The walk begins: carry the sensor to where it will be used."
        self._rows: tuple[Row, ...] = ()
        page.tell(self._progress(None))

    def fields(self, sensor: Sensor) -> Iterator[Fields]:
        """Yield what `Sensor.fields` yields, and publish every epoch on the way."""
        for epoch in sensor.epochs():
            self._page.publish(epoch, sensor)
            if len(epoch.fields.beacons) and not epoch.notes:
                yield epoch.fields

    def say(self, text: str, result: SurveyResult | None = None) -> None:
        """Tell what a look has found, or that the walk or the whole survey has an end."""
        tell(text)
        self._text = f"{text[:1].upper()}{text[1:]}{'' if text.endswith('.') else '.'}"
        if result is not None:
            self._rows = tuple(self._row(beacon.id, beacon.survey.position_sd_m) for beacon in result.site.beacons)
        self._page.tell(self._progress(None))

    def compute(self, what: str, share: float) -> None:
        """Tell what is being computed while the sensor is not read."""
        progress = self._progress(share)
        self._page.tell(Progress(progress.task, f"{progress.text} Now: {what}.", share, progress.rows), busy=True)

    def _progress(self, share: float | None) -> Progress:
        return Progress("survey", self._text, share, self._rows)

    def _row(self, name: str, sd_m: float) -> Row:
        place_m = float(np.sqrt(3.0) * sd_m)
        share = None if self._enough_m is None else min(1.0, self._enough_m / max(place_m, 1e-9))
        return Row(name, f"{1e3 * place_m:.3g} mm", share)


class TurnProgress:
    """Tells the page how far the sensor was turned: for how long each of its axes has pointed up and down.

    Parameters
    ----------
    page : Publisher
    cycle_s : float
    seconds : float
        How long the turning takes.

    Attributes
    ----------
    recorder : Recorder
        What must record the sensor's link.
    """

    SIDES = tuple(f"{axis} {way}" for axis in "xyz" for way in ("up", "down"))

    def __init__(self, page: Publisher, cycle_s: float, seconds: float) -> None:
        self._page = page
        self._cycle_s = cycle_s
        self._seconds = seconds
        self._cycles = np.zeros(len(self.SIDES), dtype=np.int64)
        self._begun_s = self._told_s = math.nan
        self.recorder = page.recorder()
        self._tell(0.0)

    def reports(self, sensor: Sensor) -> Iterator[Report]:
        """Yield what `Sensor.reports` yields, and publish every epoch on the way."""
        for epoch in sensor.epochs():
            self._page.publish(epoch, sensor)
            self._take(epoch)
            yield epoch.report

    def _take(self, epoch: Epoch) -> None:
        side = upward(epoch.pose)
        if side is not None:
            self._cycles[side] += 1
        time_s = epoch.report.time_s
        if math.isnan(time_s):
            return
        if math.isnan(self._begun_s):
            self._begun_s = time_s
        if not time_s < self._told_s + TELL_EVERY_S:  # the first one, too
            self._told_s = time_s
            self._tell(min(1.0, (time_s - self._begun_s + self._cycle_s) / self._seconds))

    def compute(self) -> None:
        """Tell that the turning is at its end, and the sensor is not read while its calibration is computed."""
        self.say("The turning is at its end; the calibration is computed.", busy=True)

    def say(self, text: str, *, busy: bool = False) -> None:
        """Tell what comes after the turning."""
        self._page.tell(Progress("calibration", text, 1.0, self._rows()), busy=busy)

    def _tell(self, share: float) -> None:
        least = ENOUGH_S / self._cycle_s
        missing = [name for name, cycles in zip(self.SIDES, self._cycles, strict=True) if cycles < least]
        text = (
            f"Turn the sensor slowly; still to come: {', '.join(missing)}."
            if missing
            else "Every side was seen: go on."
        )
        self._page.tell(Progress("calibration", text, share, self._rows()))

    def _rows(self) -> list[Row]:
        """Return for how long each side has been up."""
        shown_s = self._cycles * self._cycle_s
        return [
            Row(name, f"{time_s:.1f} s", min(1.0, float(time_s) / ENOUGH_S))
            for name, time_s in zip(self.SIDES, shown_s, strict=True)
        ]


def upward(pose: Pose) -> int | None:
    """Return which side of a sensor is up in the site, as a place in `TurnProgress.SIDES`; None if none is."""
    if not np.isfinite(pose.orientation_xyzw).all():
        return None
    up = matrix_of(pose.orientation_xyzw)[2]
    axis = int(np.argmax(np.abs(up)))
    return 2 * axis + int(up[axis] < 0.0) if abs(up[axis]) >= NEAR else None
