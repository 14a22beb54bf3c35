"""The walk of a live survey: it is surveyed on the way, and told when walking on gains little."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Protocol

import numpy as np

from goldfield.errors import SystemFailure, UserError, counted, tell
from goldfield.survey import SurveyResult
from goldfield.types import Fields

FIRST, GROWTH = 100, 1.5
"""Epochs before the first look, ten seconds, and by what they grow from one to the next."""
MOST_EPOCHS = 300
"""Epochs of a look on the way: they are taken evenly, so that it takes a second or two."""
GAINED = 0.93
"""Walking on is worth while as long as a look leaves less than this part of the deviation of the one before."""


class Survey(Protocol):
    """A survey of epochs, or of at most so many of them beside those at known points."""

    def __call__(self, epochs: Sequence[Fields], most: int | None = None) -> SurveyResult:
        """Survey."""
        ...


class Say(Protocol):
    """Tells a sentence, and the survey that it is about."""

    def __call__(self, text: str, result: SurveyResult | None = None) -> None:
        """Tell."""
        ...


def on_stderr(text: str, result: SurveyResult | None = None) -> None:
    """Tell a sentence on stderr."""
    tell(text)


def walk(fields: Iterable[Fields], survey: Survey, enough_m: float | None, say: Say = on_stderr) -> tuple[Fields, ...]:
    """Gather epochs until the beacons are known well enough, walking on gains little, or Ctrl-C.

    Parameters
    ----------
    fields : iterable of Fields
        From a sensor.
    survey : Survey
        It may fail as long as too little was measured, or known points are still to be written down: that is told.
    enough_m : float or None
        Deviation of the beacons that is enough, m; None: as good as walking makes it.
    say : Say, optional
        Gets what is told.
    """
    epochs: list[Fields] = []
    due, before = FIRST, np.inf
    try:
        for one in fields:
            epochs.append(one)
            if len(epochs) < due:
                continue
            due = round(GROWTH * due)
            now = _look(epochs, survey, say)
            if enough_m is not None and now <= enough_m:
                say(f"that is enough: {1e3 * enough_m:g} mm were asked for")
                break
            if enough_m is None and np.isfinite(now) and now > GAINED * before:
                say("that is enough: walking on in this way gains little")
                break
            before = now
    except KeyboardInterrupt:
        say(f"the walk ends with {counted(len(epochs), 'epochs')}")
    return tuple(epochs)


def _look(epochs: Sequence[Fields], survey: Survey, say: Say) -> float:
    """Survey what there is, tell it, and return the beacons' deviation; infinite if nothing fits yet."""
    last = epochs[-1].epoch
    try:
        result = survey(epochs, MOST_EPOCHS)
    except (SystemFailure, UserError) as error:
        say(f"epoch {last}: walk on: {error}")
        return np.inf
    now = result.deviation_m
    left_out = f", {counted(len(result.outliers), 'epochs left out')}" if result.outliers else ""
    known = f"the beacons are known to {1e3 * now:.3g} mm by {counted(len(epochs), 'epochs')}{left_out}"
    say(f"epoch {last}: {known}", result)
    if result.advice:
        say(result.advice[-1])
    return now
