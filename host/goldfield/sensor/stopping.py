"""The cycle in which a coil goes off, which no pose fits.

Codes cancel each other over whole cycles. Of a coil that goes off after a part f of one the rest is missing: its own
field comes out as f of what it was, and each other field is off by sqrt(f (1 - f) / N) of it, the deviation of a sum of
chips that ends early. That is more than the noise, and there is no beacon without which the others agree.

It is told by the field of the cycle before. With the other fields' deviations so much wider, and without the coil, the
cycle has a pose whose uncertainty is honest. It is ``weak``, as one cycle alone does not prove that this is what
happened; the next one tells whether the beacon is dead. As with any beacon that is left out, five must be heard: three
fit nearly every pose.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from goldfield.locate import locate
from goldfield.locate.exclusion import LEAST_FOR_ONE
from goldfield.site import Site
from goldfield.track.continuity import joined
from goldfield.types import Explanation, Fields, Finding, FloatArray, Pose, Status

STEP_TOLERANCE = 0.25
"""Largest part of a cycle by which the time between two neighbours differs from one."""
CLEAR_SIGMAS = 5.0
"""Standard deviations of its noise by which a field must have become less: by chance one of eight beacons does so in
one of 500 pairs of cycles."""
ALIKE = 0.2
"""Largest part of the field before by which what is left may differ from a multiple of it, as by motion."""
TRUSTED = (Status.OK, Status.UNVERIFIED, Status.WEAK)


class Stopping:
    """Follows the fields of one sensor.

    Parameters
    ----------
    site : Site
    """

    def __init__(self, site: Site) -> None:
        self._site = site
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
        if not abs((fields.time_s - before.time_s) / self._site.cycle_s - 1.0) < STEP_TOLERANCE:
            return pose
        gone = _largest_loss(fields, before)
        if gone is None:
            return pose
        row, was_T, part = gone
        name, others = fields.beacons[row], np.arange(len(fields.beacons)) != row
        leak_T = was_T * math.sqrt(part * (1.0 - part) / self._site.chips)
        rest = replace(
            fields,
            beacons=tuple(other for other in fields.beacons if other != name),
            field_T=fields.field_T[others],
            sigma_T=np.hypot(fields.sigma_T[others], leak_T),
        )
        one = locate(self._site, rest)
        if one.status not in TRUSTED or one.excluded:
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


def _largest_loss(fields: Fields, before: Fields) -> tuple[int, float, float] | None:
    """Return the row of the field that is less by most, what it was, T, and which part is left; None if none is less.

    Where a coil goes off others may seem to lose something, too: what its chips that are missing leave in them.
    """
    earlier = dict(zip(before.beacons, before.field_T, strict=True))
    losses = []
    for row, name in enumerate(fields.beacons):
        part = _part_left(earlier.get(name, np.full(3, np.nan)), fields.field_T[row], float(fields.sigma_T[row]))
        if part is not None:
            was_T = float(np.linalg.norm(earlier[name]))
            losses.append(((1.0 - part) * was_T, row, was_T, part))
    return max(losses)[1:] if losses else None


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
