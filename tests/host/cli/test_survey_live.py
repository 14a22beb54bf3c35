"""The walk of a live survey: when it ends, and what it tells on the way."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from goldfield.cli.survey_live import FIRST, MOST_EPOCHS, walk
from goldfield.errors import SystemFailure
from goldfield.survey import SurveyResult
from tests.bench.survey_trials import cube, fields_of

FIELDS = fields_of(("b0",), np.zeros((2000, 1, 3)), 1e-9)
SITE = cube().site


def result_of(deviation_m: float) -> SurveyResult:
    covariance = np.eye(48) * deviation_m**2 / 3.0
    return SurveyResult(SITE, {}, covariance, 10.0, 1.0, (), ("measure the distance from b0 to b1",))


class Surveys:
    """Surveys whose deviation is a function of the number of epochs."""

    def __init__(self, deviation_of):
        self.deviation_of = deviation_of
        self.looks: list[int] = []

    def __call__(self, epochs, most=None):
        assert most == MOST_EPOCHS
        self.looks.append(len(epochs))
        return result_of(self.deviation_of(len(epochs)))


def test_the_walk_ends_when_the_beacons_are_known_well_enough(capsys):
    surveys = Surveys(lambda count: 1.0 / count)
    epochs = walk(FIELDS, surveys, 0.005)
    assert len(epochs) == 225
    assert surveys.looks == [FIRST, 150, 225]
    told = capsys.readouterr().err
    assert "epoch 99: the beacons are known to 10 mm by 100 epochs" in told
    assert "measure the distance from b0 to b1" in told
    assert told.endswith("that is enough: 5 mm were asked for\n")


def test_the_walk_ends_when_walking_on_gains_little(capsys):
    surveys = Surveys(lambda count: 0.01 + 1.0 / count)
    epochs = walk(FIELDS, surveys, None)
    assert len(epochs) == surveys.looks[-1] < 1000
    ratio = (0.01 + 1.0 / surveys.looks[-1]) / (0.01 + 1.0 / surveys.looks[-2])
    assert ratio > 0.93
    assert "walking on in this way gains little" in capsys.readouterr().err


def test_what_does_not_fit_yet_is_told_and_the_walk_goes_on(capsys):
    def fails(epochs, most=None):
        raise SystemFailure("no survey fits the fields")

    assert len(walk(FIELDS, fails, None)) == len(FIELDS)
    assert "epoch 99: walk on: no survey fits the fields" in capsys.readouterr().err


def test_an_interrupt_ends_the_walk(capsys):
    def interrupted():
        yield from FIELDS[:30]
        raise KeyboardInterrupt

    assert len(walk(interrupted(), Surveys(float), None)) == 30
    assert "the walk ends with 30 epochs" in capsys.readouterr().err


def test_the_deviation_is_that_of_a_place():
    assert result_of(0.004).deviation_m == pytest.approx(0.004)
    assert replace(result_of(0.004), covariance=np.zeros((48, 48))).deviation_m == 0.0
