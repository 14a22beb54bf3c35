"""Epochs that repeat the fields of another one to the last digit: noise never does, so that they tell nothing new.

They come from a sensor or a log that is stuck, or from a table that holds a recording twice. Each would count as a
measurement of its own, and the covariance would be too small; so that they count once.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from goldfield.errors import UserError, counted
from goldfield.survey.data import SurveyData, SurveyResult


@dataclass(frozen=True, eq=False)
class CountedOnce:
    """Data without repeated epochs.

    Attributes
    ----------
    data : SurveyData
        With the first of each group of equal epochs, or the first of them at a known point.
    row : ndarray of int, shape (e,)
        The epoch of ``data`` that stands for each epoch that was given.
    """

    data: SurveyData
    row: NDArray[np.intp]

    def all_told(self, result: SurveyResult) -> SurveyResult:
        """Return a result of ``data`` with a pose of each epoch that was given, and a sentence on the repeated ones."""
        repeated = len(self.row) - len(self.data.epochs)
        if not repeated:
            return result
        line = (
            f"{counted(repeated, 'epochs have')} the very fields of another one, to the last digit, and did not count: "
            "check whether the sensor or its log was stuck, or a table holds a recording twice"
        )
        return replace(
            result,
            advice=(line, *result.advice),
            position_m=result.position_m[self.row],
            rotation=result.rotation[self.row],
        )


def counted_once(data: SurveyData) -> CountedOnce:
    """Leave repeated epochs out.

    Raises
    ------
    UserError
        If all of many epochs are the same.
    """
    marked = {point.epoch for point in data.points}
    first: dict[tuple[tuple[str, ...], bytes], int] = {}
    keys = [(fields.beacons, np.ascontiguousarray(fields.field_T).tobytes()) for fields in data.epochs]
    for index, key in enumerate(keys):
        kept = first.setdefault(key, index)
        if data.epochs[index].epoch in marked and data.epochs[kept].epoch not in marked:
            first[key] = index
    rows = sorted(first.values())
    if len(rows) == 1 < len(keys) and np.any(data.epochs[0].field_T != 0.0):
        raise UserError(
            f"all of {counted(len(keys), 'epochs')} have the same fields, to the last digit: check whether the sensor "
            "or its log was stuck, and walk through the room with it"
        )
    place = {row: index for index, row in enumerate(rows)}
    row = np.array([place[first[key]] for key in keys], dtype=np.intp)
    return CountedOnce(data.of_epochs(np.array(rows, dtype=np.intp)), row)
