"""What a `Verdict` does to the fields that go into the location, and to the pose that comes out of it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from goldfield.sensor.verdict import Verdict
from goldfield.types import Fields, Pose, Status

GRAVITY = tuple(Status)
"""The statuses; each is worse than those before it."""


def amended_fields(fields: Fields, verdict: Verdict) -> Fields:
    """Return the fields that count, as they would be with the currents of the site.

    A beacon's field is in proportion to its current: one that was made by 1.1 times the site's is divided by 1.1, and
    so is its sigma.
    """
    kept = [row for row, name in enumerate(fields.beacons) if name not in verdict.out]
    if len(kept) == len(fields.beacons) and not verdict.ratio:
        return fields
    names = tuple(fields.beacons[row] for row in kept)
    ratio = np.array([verdict.ratio.get(name, 1.0) for name in names])
    return replace(
        fields,
        beacons=names,
        field_T=fields.field_T[kept] / ratio[:, np.newaxis],
        sigma_T=fields.sigma_T[kept] / ratio,
    )


def amended_pose(pose: Pose, verdict: Verdict, *, used_all: bool = False) -> Pose:
    """Return the pose with what the boards say of it; its status only gets worse.

    Parameters
    ----------
    pose : Pose
    verdict : Verdict
    used_all : bool, optional
        The pose was not made of the amended fields, as one that the sensor computed itself: where a beacon ought to
        have been left out, or has another current, it is unverified at best.
    """
    if not (verdict.findings or verdict.out):
        return pose
    least = Status.OK
    if verdict.inconsistent:
        least = Status.INCONSISTENT
    elif used_all and (verdict.out or verdict.ratio):
        least = Status.UNVERIFIED
    doubted = least is not Status.OK and pose.status is not Status.FAILED
    out = () if used_all else tuple(name for name in verdict.out if name not in pose.excluded)
    told = [finding.text for finding in verdict.findings]
    return replace(
        pose,
        status=max(pose.status, least, key=GRAVITY.index),
        excluded=(*pose.excluded, *out),
        protection_m=math.inf if doubted else pose.protection_m,
        reason="; ".join([*told, pose.reason] if pose.reason else told),
        findings=(*verdict.findings, *pose.findings),
    )
