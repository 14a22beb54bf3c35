"""Whether what an anchor measured was given for the right anchor, and where its sensor is: told by strengths of fields.

Strengths do not depend on how a sensor is turned. They are compared with those at the place of each beacon, which the
site file knows to some decimetres. The strength of an anchor's own field, which no survey uses, tells how far from its
coil the sensor stands: a dipole's is once to twice m mu0/(4 pi r^3).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from goldfield.errors import UserError
from goldfield.field import FieldModel
from goldfield.site import Site
from goldfield.survey.data import AnchorFields
from goldfield.types import FloatArray

MISFIT = 0.7
"""Root of the mean square logarithm of measured over modelled strengths, from which on a table does not fit its
anchor: a factor of two. A beacon 20 cm and 10 degrees off, two metres away, makes 0.35."""
ELSEWHERE = 0.4
"""It is that of another anchor if its misfit there is less than this part of it."""
LEAST = 3
"""Strengths that must be compared."""
FAR_M = 0.3
"""A sensor that stands at least so far from its coil is not beside its centre, as one that nobody has told is taken to.
A sensor of 0.2 mT that its own coil of 13 A m^2 overdrives seems to be 0.19 m away."""
SLACK, OUTSIDE = 1.25, 2.0
"""A distance that was told fits the strength up to this factor; from so many radii of the coil on it is compared."""


def check_anchor_tables(site: Site, anchors: tuple[AnchorFields, ...]) -> None:
    """Refuse a table that fits at another beacon than at its own."""
    if not anchors:
        return
    places = np.array([beacon.position_m for beacon in site.beacons])
    with np.errstate(all="ignore"):  # in the middle of a coil, whose own field is not compared
        modelled = np.linalg.norm(FieldModel(site.beacons).field(places), axis=2)
    row = {beacon.id: index for index, beacon in enumerate(site.beacons)}
    for anchor in anchors:
        own = row[anchor.beacon]
        misfit = _misfits(anchor, own, modelled, row)
        best = int(np.argmin(misfit))
        if misfit[own] > MISFIT and misfit[best] < ELSEWHERE * misfit[own]:
            raise UserError(
                f"the fields of the anchor {anchor.beacon} are those of a sensor at {site.beacons[best].id}: give each "
                "anchor the table of its own sensor"
            )


def _misfits(anchor: AnchorFields, own: int, modelled: FloatArray, row: dict[str, int]) -> FloatArray:
    """Return how badly the strengths fit at the place of each beacon, shape (n,); infinite if too few tell."""
    measured = np.full(len(modelled), np.nan)
    for name, field, sigma in zip(anchor.fields.beacons, anchor.fields.field_T, anchor.fields.sigma_T, strict=True):
        size = float(np.linalg.norm(field))
        if np.isfinite(size) and size > 3.0 * sigma:
            measured[row[name]] = size
    measured[own] = np.nan
    result = np.full(len(modelled), np.inf)
    for place, strength in enumerate(modelled):
        told = np.isfinite(measured) & (np.arange(len(measured)) != place)
        if told.sum() >= LEAST:
            result[place] = np.sqrt(np.mean(np.log(measured[told] / strength[told]) ** 2))
    return result


def sensors_elsewhere(site: Site, anchors: tuple[AnchorFields, ...]) -> Iterator[str]:
    """Say of which anchors the sensor hears its own coil from elsewhere than it is thought to stand."""
    model = FieldModel(site.beacons)
    row = {beacon.id: index for index, beacon in enumerate(site.beacons)}
    for anchor in anchors:
        if anchor.beacon not in anchor.fields.beacons:
            continue
        heard = float(np.linalg.norm(anchor.fields.field_T[anchor.fields.beacons.index(anchor.beacon)]))
        if not heard > 0.0:
            continue
        own = row[anchor.beacon]
        least = float(np.cbrt(1e-7 * np.linalg.norm(model.moment_A_m2[own]) / heard))
        most, told = float(np.cbrt(2.0)) * least, float(np.linalg.norm(anchor.lever_m))
        away = f"{least:.2g} to {most:.2g} m"
        hears = f"the sensor of the anchor {anchor.beacon} hears its own coil as if it stood {away} from it"
        if anchor.lever_sd_m is None and least > FAR_M:
            yield (
                f"{hears}, and is taken to stand a few centimetres from its centre: measure its place and give sensor "
                "with --known"
            )
        far = told > OUTSIDE * model.reach_m[own]
        if anchor.lever_sd_m is not None and far and not least / SLACK <= told <= SLACK * most:
            yield f"{hears}, and sensor in --known has {told:.2g} m: check it"
