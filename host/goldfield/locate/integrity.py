"""What is done about an epoch whose fields do not agree with the site: a rival explanation, exclusion, or neither.

In this order:

1. The negated fields: if a pose fits them, the sensor's axes are mirrored or all coils reversed.
2. One beacon out, if five are heard, beside the explanations by the sensor: the better one is named.
3. Two beacons out, if seven are heard and neither explains the epoch.

Where the fields without one beacon are enough to show that no other pose fits them (`Constellation.sure`), the first is
left out, and the second looks for explanations by the sensor near the poses that are known: both need another pose.

A pose without a beacon is trusted only if the rest has a likely cost, if every other explanation costs
`exclusion.CLEAR` more, and if the rest passes the alarm. Everything else is inconsistent, with the reason.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from goldfield.locate import sentences
from goldfield.locate.beacon_faults import beacon_finding
from goldfield.locate.chances import chdtri, probability
from goldfield.locate.constellation import SECOND_EVALUATIONS, Constellation
from goldfield.locate.exclusion import (
    CLEAR,
    LEAST_FOR_ONE,
    LEAST_FOR_TWO,
    Subsets,
    searched_without_one,
    without_one,
    without_two,
)
from goldfield.locate.fault_statistics import FaultStatistics, alarm, fault_statistics
from goldfield.locate.fit import Fit, Measurements, stacked
from goldfield.locate.sensor_rivals import (
    BY_CHANCE,
    SensorRival,
    SensorRivals,
    mirrored,
    nearly_one_factor,
    sensor_rivals,
)
from goldfield.locate.solutions import Solutions
from goldfield.types import Explanation, Finding

SOUND_REST = 0.01
"""Without the beacons that were left out, a cost as large as the rest's must be likelier than this."""

MOST_ALIKE = 2
"""If more explanations than these fit about as well as the best, none is told."""

LEAST_FREEDOM = 3
"""Degrees of freedom that the rest must have, or it cannot be tested."""


@dataclass(frozen=True, eq=False)
class Verdict:
    """What became of an epoch that raised the alarm.

    Attributes
    ----------
    findings : tuple of Finding
        What explains the fields; several if they cannot be told apart.
    reason : str
    rest : Solutions or None
        Poses of the trusted rest if beacons were left out; else None and the epoch is inconsistent.
    left_out : ndarray of int
        Rows of the beacons that were left out.
    residuals : dict of int to float
        Their normalised residuals, by row.
    statistics : FaultStatistics or None
        Those of the pose of the rest.
    """

    findings: tuple[Finding, ...]
    reason: str
    rest: Solutions | None
    left_out: NDArray[np.intp]
    residuals: dict[int, float]
    statistics: FaultStatistics | None = None

    @property
    def unknown(self) -> bool:
        """True if nothing explains the epoch."""
        return [finding.kind for finding in self.findings] == [Explanation.UNKNOWN]


def explain(
    constellation: Constellation, measurements: Measurements, solutions: Solutions, names: Sequence[str]
) -> Verdict:
    """Explain one epoch that raised the alarm.

    Parameters
    ----------
    constellation : Constellation
        The beacons that were heard.
    measurements : Measurements
        The epoch, with its budget: if that ends nothing is explained.
    solutions : Solutions
        Poses with all beacons.
    names : sequence of str
        The beacons' ids.
    """
    heard = len(constellation.model)
    poses = solutions.best if not solutions.contested[0] else stacked([solutions.best, solutions.rival])
    ones = without_one(constellation, measurements, poses) if heard >= LEAST_FOR_ONE else None
    sure = ones is not None and _sure(constellation, measurements, ones)
    # With fewer than three axes the negated fields are those of a sensor that is turned round.
    if measurements.axes[0] == 3 and not sure:
        negated = mirrored(constellation, measurements, float(solutions.best.cost[0]), CLEAR)
        if negated is not None:
            return _inconsistent([negated], negated.text)
    if ones is None:
        return _few(constellation, measurements, solutions, heard)
    known = stacked([poses, ones.fit.take(np.arange(2))])
    rivals = sensor_rivals(constellation, measurements, known, anywhere=not sure)
    of_sensor = rivals.explaining
    if ones.hopeless and not of_sensor:
        ones = searched_without_one(constellation, measurements, ones)
    verdict = _without(constellation, measurements, ones, of_sensor, names)
    if verdict is None and heard >= LEAST_FOR_TWO:
        verdict = _without(
            constellation, measurements, without_two(constellation, measurements, ones), of_sensor, names
        )
    if measurements.budget is not None and measurements.budget.spent:
        return _unknown(sentences.NOT_EXPLAINED)  # whatever was found, something better may exist
    if verdict is None and of_sensor:
        verdict = _inconsistent([of_sensor[0].finding], of_sensor[0].finding.text)
    return verdict or _nearly(constellation, measurements, solutions, rivals) or _unknown(sentences.NOT_MENDED)


def _sure(constellation: Constellation, measurements: Measurements, ones: Subsets) -> bool:
    """Tell whether the fields without the likeliest beacon fit its pose, and can fit no other."""
    thinned = measurements.without(np.arange(len(constellation.model))[None] == ones.left_out[0])
    best = ones.fit.take(np.array([0]))
    return bool(probability(best.cost, thinned.freedom)[0] > SOUND_REST and constellation.sure(thinned, best)[0])


def _few(constellation: Constellation, measurements: Measurements, solutions: Solutions, heard: int) -> Verdict:
    """Explain an epoch with too few beacons to leave one out."""
    rivals = sensor_rivals(constellation, measurements, solutions.best)
    of_sensor = rivals.explaining
    if of_sensor and of_sensor[0].score + CLEAR < solutions.best.cost[0]:
        return _inconsistent([of_sensor[0].finding], of_sensor[0].finding.text)
    return _nearly(constellation, measurements, solutions, rivals) or _unknown(sentences.too_few(heard))


def _nearly(
    constellation: Constellation, measurements: Measurements, solutions: Solutions, rivals: SensorRivals
) -> Verdict | None:
    """Tell of one factor that explains most of the fields."""
    finding = nearly_one_factor(constellation, measurements, solutions.best, rivals.factor)
    return None if finding is None else _inconsistent([finding], finding.text)


def _without(
    constellation: Constellation,
    measurements: Measurements,
    subsets: Subsets,
    of_sensor: list[SensorRival],
    names: Sequence[str],
) -> Verdict | None:
    """Judge the best subset of beacons; None if it explains nothing, or less than the sensor does."""
    left_out, cost = subsets.left_out[0], float(subsets.fit.cost[0])
    kept = np.delete(np.arange(len(constellation.model)), left_out)
    rest, thinned = constellation.subset(kept), measurements.of_beacons(kept)
    freedom = thinned.freedom
    if freedom[0] < LEAST_FREEDOM or not probability(np.array([cost]), freedom)[0] > SOUND_REST:
        return None
    removed = float(measurements.measured[0, left_out].sum())
    score = cost + float(chdtri(removed, BY_CHANCE / len(subsets.left_out)))
    if of_sensor and of_sensor[0].score < score - CLEAR:
        return None
    others = _others_alike(subsets)
    sensor_alike = [rival.finding for rival in of_sensor[:1] if rival.score < score + CLEAR]
    if len(others) + len(sensor_alike) > MOST_ALIKE:
        likelier = bool(of_sensor) and of_sensor[0].score < score
        return None if likelier else _unknown(sentences.NOT_CLEAR)
    alike = [*_findings(constellation, measurements, subsets, others, names)[0], *sensor_alike]
    without = dict.fromkeys(left_out.tolist(), 0)
    if alike:
        alike = [*_findings(constellation, measurements, subsets, without, names)[0], *alike]
        return _inconsistent(alike, sentences.not_sure([finding.text for finding in alike]))
    best = subsets.fit.take(np.array([0]))
    solutions = _at_least(rest.solve(thinned, SECOND_EVALUATIONS, known=best), best)
    statistics = fault_statistics(rest.model, thinned, solutions.best)
    if alarm(thinned, solutions.best.cost, statistics)[0]:
        return None
    findings, residuals = _findings(constellation, measurements, subsets, without, names)
    reason = sentences.left_out([finding.text for finding in findings])
    return Verdict(tuple(findings), reason, solutions, left_out, residuals, statistics)


def _at_least(solutions: Solutions, fit: Fit) -> Solutions:
    """Put in the pose that exclusion found, should the search have missed it."""
    if fit.cost[0] < solutions.best.cost[0] - 1.0:
        solutions.best.put(np.array([0]), fit)
    return solutions


def _others_alike(subsets: Subsets) -> dict[int, int]:
    """Return the beacons that subsets lack which fit about as well as the best, and the first such subset of each."""
    others = np.flatnonzero(subsets.fit.cost[1:] < subsets.fit.cost[0] + CLEAR) + 1
    found: dict[int, int] = {}
    for which in others.tolist():
        for row in subsets.left_out[which].tolist():
            if row not in subsets.left_out[0]:
                found.setdefault(row, which)
    return found


def _findings(
    constellation: Constellation,
    measurements: Measurements,
    subsets: Subsets,
    without: Mapping[int, int],
    names: Sequence[str],
) -> tuple[list[Finding], dict[int, float]]:
    """Name what is wrong with beacons, given with the subset without them; their normalised residuals by row."""
    findings, residuals = [], {}
    for row, which in without.items():
        fit = subsets.fit.take(np.array([which]))
        finding, residuals[row] = beacon_finding(constellation.model, measurements, fit, row, names[row])
        findings.append(finding)
    return findings, residuals


def _inconsistent(findings: Sequence[Finding], reason: str) -> Verdict:
    return Verdict(tuple(findings), reason, None, np.array([], dtype=np.intp), {})


def _unknown(reason: str) -> Verdict:
    return _inconsistent([Finding(Explanation.UNKNOWN, (), reason)], reason)
