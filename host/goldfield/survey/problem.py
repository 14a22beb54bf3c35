"""From site and measurements to the problem that an adjustment solves."""

from __future__ import annotations

import numpy as np

from goldfield.errors import UserError
from goldfield.field import FieldModel
from goldfield.site import Site
from goldfield.site.reading import ASSUMED_AXIS_SD_RAD, ASSUMED_GAIN_SD
from goldfield.survey.adjustment import ANCHOR_LEVER_SD_M, Problem
from goldfield.survey.checks import check_data, check_epochs, check_sensor
from goldfield.survey.constraints import Constraints
from goldfield.survey.data import AnchorFields, Free, SurveyData
from goldfield.survey.equations import Readings
from goldfield.survey.metal import MetalState
from goldfield.survey.parameters import TERMS, prior_of, start_of
from goldfield.types import Fields, FloatArray


def problem_of(site: Site, data: SurveyData, free: frozenset[Free], metal: MetalState | None = None) -> Problem:
    """Return everything that an adjustment takes as given; UserError if too little was measured."""
    check_sensor(site)
    check_data(site, data)
    row = {beacon.id: index for index, beacon in enumerate(site.beacons)}
    readings = _readings(data.epochs, row)
    anchors = _readings(tuple(anchor.fields for anchor in data.anchors), row, data.anchors)
    components = readings.count.sum() + anchors.count.sum()
    if components < 1:
        raise UserError("nothing was measured: give a table of fields, a recording, or anchors")
    check_epochs(readings)
    number = {fields.epoch: index for index, fields in enumerate(data.epochs)}
    point, weight = np.zeros((len(data.epochs), 3)), np.zeros((len(data.epochs), 3))
    for known in data.points:
        index = number[known.epoch]
        measured = np.isfinite(known.position_m)
        point[index, measured], weight[index, measured] = known.position_m[measured], 1.0 / known.sigma_m
    centre = np.array([beacon.position_m for beacon in site.beacons])
    low, high = centre.min(axis=0), centre.max(axis=0)
    size = float(np.linalg.norm(high - low)) + 10.0 * float(FieldModel(site.beacons).reach_m.max())
    prior = prior_of(site, free, start_of(site, 0, 0, metal), _size_of(readings))
    count = len(prior.sd)
    return Problem(
        site=site,
        axes=axes_of(site),
        prior=prior,
        readings=readings,
        point_m=point,
        point_weight=weight,
        room_m=0.5 * (low + high),
        room_sd_m=2.0 * size,
        constraints=Constraints(data.known, row, np.array([beacon.current_A for beacon in site.beacons]), count),
        anchors=anchors,
        anchor_rows=[row[anchor.beacon] for anchor in data.anchors],
        anchor_known=_anchor_known(data.anchors),
        anchor_sd=_anchor_sd(site, data.anchors),
        levers_told=np.array([anchor.lever_sd_m is not None for anchor in data.anchors], dtype=bool),
    )


def _anchor_known(anchors: tuple[AnchorFields, ...]) -> FloatArray:
    """Return what is known of terms and lever of each anchor's sensor, shape (a, 9)."""
    result = np.zeros((len(anchors), TERMS + 3))
    for row, anchor in zip(result, anchors, strict=True):
        row[TERMS:] = anchor.lever_m
    return result


def _anchor_sd(site: Site, anchors: tuple[AnchorFields, ...]) -> FloatArray:
    """Return how well that is known, shape (a, 9): the terms no better than a usual sensor's."""
    gain = max(site.sensor.gain_sd, ASSUMED_GAIN_SD)
    tilt = np.sqrt(2.0) * max(site.sensor.axis_sd_rad, ASSUMED_AXIS_SD_RAD)
    levers = [ANCHOR_LEVER_SD_M if anchor.lever_sd_m is None else anchor.lever_sd_m for anchor in anchors]
    terms = np.broadcast_to([gain, gain, gain, tilt, tilt, tilt], (len(anchors), TERMS))
    return np.hstack([terms, np.repeat(np.array(levers)[:, None], 3, axis=1)])


def axes_of(site: Site) -> FloatArray:
    """Return what the site says of the sensor's axes, shape (3, 3); an axis that the sensor does not have is one."""
    result = np.eye(3)
    if site.sensor.axes is not None:
        result[: len(site.sensor.axes)] = site.sensor.axes
    return result


def _size_of(readings: Readings) -> FloatArray:
    """Return the root of the mean square of each beacon's fields, shape (n,)."""
    measured = np.isfinite(readings.sigma_T).any(axis=2).sum(axis=0)
    return np.asarray(np.sqrt((readings.field_T**2).sum(axis=(0, 2)) / np.maximum(measured, 1)))


def _readings(epochs: tuple[Fields, ...], row: dict[str, int], anchors: tuple[AnchorFields, ...] = ()) -> Readings:
    """Put the fields in the order of the site's beacons; an anchor's own beacon is left out."""
    field = np.zeros((len(epochs), len(row), 3))
    sigma = np.full(field.shape, np.inf)
    for index, fields in enumerate(epochs):
        rows = [row[name] for name in fields.beacons]
        usable = np.isfinite(fields.field_T) & (np.isfinite(fields.sigma_T) & (fields.sigma_T > 0.0))[:, None]
        field[index, rows] = np.where(usable, fields.field_T, 0.0)
        sigma[index, rows] = np.where(usable, fields.sigma_T[:, None], np.inf)
    for index, anchor in enumerate(anchors):
        field[index, row[anchor.beacon]], sigma[index, row[anchor.beacon]] = 0.0, np.inf
    return Readings(field, sigma)
