"""The cycle in which a coil goes off, which no pose fits.

Codes cancel each other over whole cycles. Of a coil that goes off after a part f of one the rest is missing: its own
field comes out as f of what it was, and each other field is off by sqrt(f (1 - f) / N) of it, the deviation of a sum of
chips that ends early. That is more than the noise, and there is no beacon without which the others agree.

It is told by the field of the cycle before. With the other fields' deviations so much wider, and without the coil, the
cycle has a pose whose uncertainty is honest. It is ``weak``, as one cycle alone does not prove that this is what
happened; the next one tells whether the beacon is dead. As with any beacon that is left out, five must be heard: three
fit nearly every pose. Where another loses as much, as with coils of one supply, or what is left is as much as the
site says at that pose, it is another fault, and the cycle stays ``inconsistent``.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from goldfield.access.motion_repair import is_next
from goldfield.field import FieldModel
from goldfield.locate import locate
from goldfield.locate.exclusion import LEAST_FOR_ONE
from goldfield.locate.rotations import matrix_of
from goldfield.locate.sensor_axes import axes_of
from goldfield.site import Site
from goldfield.track.continuity import joined
from goldfield.types import Explanation, Fields, Finding, FloatArray, Pose, Status

CLEAR_SIGMAS = 5.0
"""Standard deviations of its noise by which a field must have become less: by chance one of eight beacons does so in
one of 500 pairs of cycles."""
ALIKE = 0.2
"""Largest part of the field before by which what is left may differ from a multiple of it, as by motion."""
TOGETHER = 0.5
"""Largest part of the loss that another beacon may have lost, too, as by motion: coils of one supply lose alike."""
BY_SITE = 0.5
"""Least part of the loss that must be one against the site's field at the pose without it, too: a sensor that walks
away loses as much of a sound beacon's field, which is as the site says there."""
TRUSTED = (Status.OK, Status.UNVERIFIED, Status.WEAK)


class Stopping:
    """Follows the fields of one sensor.

    Parameters
    ----------
    site : Site
    """

    def __init__(self, site: Site) -> None:
        self._site = site
        self._row = {beacon.id: row for row, beacon in enumerate(site.beacons)}
        self._model = FieldModel(site.beacons)
        self._axes = axes_of(site.sensor)
        self._before: Fields | None = None

    def follow(self, fields: Fields, pose: Pose) -> Pose:
        """Return the pose of the next cycle: a ``weak`` one where the fields say that one coil went off amid it.

        Parameters
        ----------
        fields : Fields
            Those of the cycle, as they were located.
        pose : Pose
            What `locate` makes of them.
        """
        before, self._before = self._before, fields if pose.status in TRUSTED else None
        if pose.status is not Status.INCONSISTENT or before is None or len(fields.beacons) < LEAST_FOR_ONE:
            return pose
        if not is_next(self._site, fields, before):
            return pose
        gone = _largest_loss(fields, before)
        if gone is None:
            return pose
        name, was_T, part = gone
        leak_T = was_T * math.sqrt(part * (1.0 - part) / self._site.chips)
        rest = _without(fields, name, leak_T)
        if name not in self._row or _most_lost(rest, before) > TOGETHER * (1.0 - part):
            return pose
        one = locate(self._site, rest)
        if one.status not in TRUSTED or one.excluded or len(one.used) < LEAST_FOR_ONE - 1:
            return pose
        if 1.0 - self._part_there(fields, name, one) < BY_SITE * (1.0 - part):
            return pose
        text = f"{name} went off after {part:.0%} of this cycle, or has as much of its current".replace("%", " %")
        return replace(
            one,
            status=Status.WEAK,
            excluded=(name,),
            reason=joined(text, one.reason),
            protection_m=math.inf,
            findings=(Finding(Explanation.CURRENT, (name,), text, factor=part), *one.findings),
        )

    def _part_there(self, fields: Fields, name: str, pose: Pose) -> float:
        """Return a beacon's field as a part of what the site says at a pose."""
        now = fields.field_T[fields.beacons.index(name)]
        if self._axes is not None:
            now = self._axes.components(now)
        by_site = self._model.field(pose.position_m)[self._row[name]] @ matrix_of(pose.orientation_xyzw)
        return float(now @ by_site / (by_site @ by_site))


def _without(fields: Fields, name: str, leak_T: float) -> Fields:
    """Return the fields of the others, with what that of one leaves in them in their sigma."""
    others = np.array([other != name for other in fields.beacons])
    return replace(
        fields,
        beacons=tuple(other for other in fields.beacons if other != name),
        field_T=fields.field_T[others],
        sigma_T=np.hypot(fields.sigma_T[others], leak_T),
    )


def _largest_loss(fields: Fields, before: Fields) -> tuple[str, float, float] | None:
    """Return whose field is less by most, what it was, T, and which part is left; None if none is clearly less."""
    losses = _losses(fields, before)
    return max(losses, key=lambda loss: (1.0 - loss[2]) * loss[1], default=None)


def _most_lost(fields: Fields, before: Fields) -> float:
    """Return the largest part that a field has lost, 0 if none is clearly less."""
    return max((1.0 - part for *_, part in _losses(fields, before)), default=0.0)


def _losses(fields: Fields, before: Fields) -> list[tuple[str, float, float]]:
    """Return which fields are clearly less, what they were, T, and which part of each is left."""
    earlier = dict(zip(before.beacons, before.field_T, strict=True))
    losses = []
    for row, name in enumerate(fields.beacons):
        part = _part_left(earlier.get(name, np.full(3, np.nan)), fields.field_T[row], float(fields.sigma_T[row]))
        if part is not None:
            losses.append((name, float(np.linalg.norm(earlier[name])), part))
    return losses


def _part_left(was: FloatArray, now: FloatArray, sigma_T: float) -> float | None:
    """Return which part of a field is left, 0 to 1; None if it is not clearly less, or another one."""
    size2 = float(was @ was)
    if not (math.isfinite(size2) and np.isfinite(now).all() and size2 > 0.0):
        return None
    part = float(now @ was) / size2
    size_T, across_T = math.sqrt(size2), float(np.linalg.norm(now - part * was))
    if (1.0 - part) * size_T < CLEAR_SIGMAS * sigma_T or part < 0.0 or across_T > ALIKE * size_T + 3.0 * sigma_T:
        return None
    return part
