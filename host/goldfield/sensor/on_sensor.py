"""Poses that the sensor itself computed: what it must know for them, and its messages as `Pose`."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from goldfield.access.waveform import site_templates
from goldfield.field import FieldModel
from goldfield.link.reports import ON_SENSOR_POSE, Report
from goldfield.site import Site
from goldfield.types import Fields, Pose, Status
from goldfield_protocol.parameters import PARAMETERS

STATUS = (Status.OK, Status.AMBIGUOUS, Status.WEAK, Status.INCONSISTENT, Status.FAILED)
"""The statuses, in the order of their numbers in ``POSE_QUALITY``."""


def on_sensor_parameters(site: Site) -> Mapping[int, int | float]:
    """Return the parameters, by id, with which a sensor computes its pose on a site whose codes it reports.

    A coil given by its wire becomes the circle of its area, which is its field from a few diameters on. A coil that
    follows its code slowly becomes as much weaker as its part in the correlation is, so that the sensor need not know
    ``tau_s``; what it adds to the correlations with other codes, .2 % of it at .3 chips, stays.
    """
    model = FieldModel(site.beacons)
    ideal, risen = (np.asarray(site_templates(site, rise)) for rise in (False, True))
    gain = (ideal * (risen - risen.mean(axis=0))).sum(axis=0) / (ideal * (ideal - ideal.mean(axis=0))).sum(axis=0)
    rows: list[float] = []
    for beacon, centre, moment, part in zip(site.beacons, model.centre_m, model.moment_A_m2, gain, strict=True):
        size = float(np.linalg.norm(moment))
        area = size / abs(beacon.turns * beacon.current_A)
        rows += [*centre.tolist(), *(moment / size).tolist(), float(part) * size, float(np.sqrt(area / np.pi))]
    half = np.zeros(6)
    if site.half_space is not None:
        half = np.concatenate([site.half_space.point_m, site.half_space.normal])
    values: dict[str, list[int | float]] = {
        "noise": [float(site.sensor.noise_T)],
        "half_space": half.tolist(),
        "beacons": list(rows),
        "pose": [1],
    }
    return {
        PARAMETERS[name].identifier(element): value
        for name, elements in values.items()
        for element, value in enumerate(elements)
    }


def on_sensor_pose(site: Site, report: Report, fields: Fields) -> Pose:
    """Return the pose that came with a report; failed if some of its messages did not.

    The messages tell only the sum of the variances of position and that of attitude: each is shared out evenly over its
    three axes.

    Parameters
    ----------
    site : Site
    report : Report
    fields : Fields
        The fields of the same epoch.
    """
    if len(report.on_sensor_pose) < len(ON_SENSOR_POSE):
        return Pose.failed(fields, excluded=fields.beacons)
    position, attitude, quality = (report.on_sensor_pose[name] for name in ON_SENSOR_POSE)
    status = STATUS[int(quality["status"])] if int(quality["status"]) < len(STATUS) else Status.FAILED
    quaternion = np.array([attitude[axis] for axis in "xyzw"])
    size = float(np.linalg.norm(quaternion))
    if status is Status.FAILED or size < 0.5:
        return Pose.failed(fields, excluded=fields.beacons)
    used = int(quality["used"])
    names = tuple(beacon.id for beacon in site.beacons)
    return Pose(
        epoch=fields.epoch,
        time_s=fields.time_s,
        position_m=np.array([position[axis] for axis in "xyz"]),
        orientation_xyzw=quaternion / size,
        position_cov_m2=np.eye(3) * quality["sigma_position"] ** 2 / 3.0,
        attitude_cov_rad2=np.eye(3) * quality["sigma_attitude"] ** 2 / 3.0,
        residual=quality["residual"],
        status=status,
        used=names if used == len(names) else ("?",) * used,  # it tells how many, not which
    )
