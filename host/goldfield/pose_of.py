"""A pose for every epoch, whatever happens."""

from __future__ import annotations

import os
import sys
import traceback

import numpy as np

from goldfield.locate import locate
from goldfield.poses import Fields, Pose, Status
from goldfield.site import Site


def pose_of(site: Site, fields: Fields) -> Pose:
    """Locate; a defect in doing so costs this epoch and is told on stderr, not the run."""
    try:
        return locate(site, fields)
    except Exception as error:
        if os.environ.get("GOLDFIELD_DEBUG") == "1":
            traceback.print_exc()
        print(
            f"goldfield: epoch {fields.epoch}: location failed unexpectedly ({type(error).__name__}: {error}): "
            "please report it",
            file=sys.stderr,
        )
        return failed_pose(fields)


def failed_pose(fields: Fields) -> Pose:
    """Return a pose that says nothing but that there is none."""
    return Pose(
        epoch=fields.epoch,
        time_s=fields.time_s,
        position_m=np.full(3, np.nan),
        orientation_xyzw=np.full(4, np.nan),
        position_cov_m2=np.full((3, 3), np.nan),
        attitude_cov_rad2=np.full((3, 3), np.nan),
        residual=float("nan"),
        status=Status.FAILED,
        used=(),
        excluded=fields.beacons,
    )
