"""A site as the text of a site file: for beacons that an optimisation has placed."""

from __future__ import annotations

import json

import numpy as np

from goldfield.errors import UserError
from goldfield.site import Beacon, Site
from goldfield.types import FloatArray


def site_text(site: Site) -> str:
    """Return the text of a site file that says the same.

    Raises
    ------
    UserError
        If a coil is given by its wire, or beacons are not told apart by one Gold code each. Beacons of a lattice, which
        have no codes of their own, get one each; there must be so many.
    """
    if site.access != "cdma" or any(beacon.radius_m is None for beacon in site.beacons):
        raise UserError("only sites of circular coils with Gold codes can be written: change the file by hand")
    codes = [beacon.code for beacon in site.beacons]
    if len(set(codes)) < len(codes):
        codes = list(range(len(codes)))
    if not all(0 <= code <= site.chips + 1 for code in codes):
        raise UserError(f"{len(codes)} beacons are more than codes of degree {site.degree}: give a higher degree")
    head = [
        "[site]",
        f"name = {json.dumps(site.name, ensure_ascii=False)}",
        f"chip_period_s = {site.chip_period_s!r}",
        f"degree = {site.degree}",
        f"alert_limit_m = {site.alert_limit_m!r}",
        f"ambient_gradient_T_m = {site.ambient_gradient_T_m!r}",
    ]
    if site.half_space is not None:
        point, normal = _list(site.half_space.point_m), _list(site.half_space.normal)
        head.append(f"half_space = {{ point = {point}, normal = {normal} }}")
    sensor = site.sensor
    head += ["", "[sensor]", f"noise_T = {sensor.noise_T!r}"]
    head += [f"hum_T = {sensor.hum_T!r}", f"hum_Hz = {sensor.hum_Hz!r}"] if sensor.hum_T else []
    head += [f"gain_sd = {sensor.gain_sd!r}", f"axis_sd_rad = {sensor.axis_sd_rad!r}"]
    tables = [_beacon(beacon, code) for beacon, code in zip(site.beacons, codes, strict=True)]
    return "\n".join([*head, "", *tables])


def _beacon(beacon: Beacon, code: int) -> str:
    lines = [
        "[[beacon]]",
        f"id = {json.dumps(beacon.id, ensure_ascii=False)}",
        f"position_m = {_list(beacon.position_m)}",
        f"axis = {_list(beacon.axis)}",
        f"turns = {beacon.turns!r}",
        f"radius_m = {beacon.radius_m!r}",
        f"current_A = {beacon.current_A!r}",
        f"code = {code}",
    ]
    lines += [f"tau_s = {beacon.drive.tau_s!r}"] if beacon.drive.tau_s else []
    lines += [f"{key} = {getattr(beacon.survey, key)!r}" for key in ("position_sd_m", "axis_sd_rad", "current_sd")]
    return "\n".join([*lines, ""])


def _list(values: FloatArray) -> str:
    return f"[{', '.join(repr(float(value)) for value in np.asarray(values))}]"
