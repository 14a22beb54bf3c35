"""What a survey cannot start from: a sensor that it does not model, and epochs from which nothing follows."""

from __future__ import annotations

from collections.abc import Set

import numpy as np

from goldfield.errors import UserError, counted
from goldfield.site import Site
from goldfield.survey.anchor_tables import check_anchor_tables
from goldfield.survey.data import Distance, Free, Place, SurveyData
from goldfield.survey.equations import Readings

LEAST_STRENGTH = 5.0
"""Strongest field of an epoch over its noise, root mean square of its axes, below which the epoch tells next to
nothing; noise alone makes 3 with a thousand beacons."""


def check_arguments(site: object, data: object, free: object) -> None:
    """Refuse arguments of other types than `survey` takes."""
    if not isinstance(site, Site):
        raise UserError(f"survey() takes a Site, not {site!r:.60}: goldfield.load_site(path) returns one")
    if not isinstance(data, SurveyData):
        raise UserError(f"survey() takes the measurements as a SurveyData, not {data!r:.60}")
    if free is not None and not (isinstance(free, Set | list | tuple) and all(isinstance(one, Free) for one in free)):
        raise UserError(f"free= of survey() is a set of Free, such as {{Free.POSITION}}, not {free!r:.60}")


def check_sensor(site: Site) -> None:
    """Refuse a sensor that a survey does not model: one of fewer than three axes."""
    if site.sensor.axes is not None and len(site.sensor.axes) < 3:
        raise UserError(
            f"site {site.name}: [sensor] axes has {counted(len(site.sensor.axes), 'rows')}: a survey takes a sensor "
            "of three axes"
        )


def check_data(site: Site, data: SurveyData) -> None:
    """Refuse points and known values of what is not there, or with a deviation that is none."""
    ids = {beacon.id for beacon in site.beacons}
    named = [anchor.beacon for anchor in data.anchors]
    for known in data.known:
        named += known.beacons if isinstance(known, Distance) else [known.beacon]
        sd = known.sd_m if isinstance(known, Distance | Place) else getattr(known, "sd_rad", getattr(known, "sd", 0.0))
        if not (np.isfinite(sd) and sd > 0.0):
            raise UserError(f"known= of SurveyData has a deviation of {sd:g}: give one greater than zero")
    unknown = next((name for name in named if name not in ids), None)
    if unknown is not None:
        raise UserError(f'known= or anchors= of SurveyData name "{unknown}", which the site does not have')
    check_anchor_tables(site, data.anchors)
    epochs = {fields.epoch for fields in data.epochs}
    for point in data.points:
        if point.epoch not in epochs:
            raise UserError(f"points= of SurveyData name epoch {point.epoch}, which is not among epochs=")
        if np.shape(point.position_m) != (3,) or not (np.isfinite(point.sigma_m) and point.sigma_m > 0.0):
            raise UserError(
                f"points= of SurveyData: that of epoch {point.epoch} needs three coordinates, and a sigma_m above zero"
            )


def check_epochs(readings: Readings) -> None:
    """Refuse epochs of too few beacons, or of nothing but noise; none at all are no concern of this check."""
    measured = np.isfinite(readings.sigma_T)
    if not len(measured):
        return
    if not (readings.count > 6.0).any():
        heard = int(measured.any(axis=2).sum(axis=1).max())
        raise UserError(
            f"no epoch has the fields of more than {counted(heard, 'beacons')}: a pose alone takes two, so that a "
            "survey takes three or more at once"
        )
    strength = np.where(measured, readings.field_T / readings.sigma_T, 0.0)
    if not np.median(np.sqrt((strength**2).mean(axis=2)).max(axis=1)) > LEAST_STRENGTH:
        raise UserError(
            "the fields of most epochs do not stand out of their noise: check that the beacons run, that fields are "
            "in tesla, and sigma_T"
        )
