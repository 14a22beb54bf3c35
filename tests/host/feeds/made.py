"""Poses and epochs made up for tests of feeds, with a covariance that differs in every direction."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

import goldfield
from goldfield.feeds.feed import Setting
from goldfield.feeds.stamped import StampedPose
from goldfield.link.reports import Report
from goldfield.sensor.pipeline import Epoch, Fix
from goldfield.types import Fields, Pose, Status
from goldfield.view.lines import Line
from tests.host.fake_sensor import SITE as SITE_FILE

SITE = goldfield.load_site(SITE_FILE)
UNIX_S = 1_700_000_000.25
POSITION_M = np.array([1.5, -0.25, 0.875])
ATTITUDE = Rotation.from_euler("ZYX", [2.0, -0.4, 0.7])
POSITION_COV_M2 = np.array([[4e-6, 1e-6, 0.0], [1e-6, 9e-6, -2e-6], [0.0, -2e-6, 16e-6]])
ATTITUDE_COV_RAD2 = np.array([[1e-4, 0.0, 3e-5], [0.0, 4e-4, 0.0], [3e-5, 0.0, 9e-4]])


def pose(epoch=7, time_s=0.75, status=Status.OK, **changes):
    made = Pose(
        epoch=epoch,
        time_s=time_s,
        position_m=POSITION_M,
        orientation_xyzw=ATTITUDE.as_quat(canonical=True),
        position_cov_m2=POSITION_COV_M2,
        attitude_cov_rad2=ATTITUDE_COV_RAD2,
        residual=1.25,
        status=status,
        used=("b1", "b2"),
        excluded=("b3",),
        reason=None,
        protection_m=0.125,
        residuals={"b1": 0.5, "b2": 1.5},
    )
    return replace(made, **changes)


def failed(epoch=7):
    return Pose.failed(Fields(epoch, 0.75, ("b1",), np.zeros((1, 3)), np.ones(1)), reason="no beacon was heard")


def stamped(pose_=None, unix_s=UNIX_S, *, live=True):
    return StampedPose(Line(pose_ or pose(), None, 2, unix_s), unix_s, live)


def fix(time_s, arrived_s=math.nan, **changes):
    return Fix(pose(time_s=time_s, **changes), arrived_s)


def epoch(number, arrived_s=math.nan, *, at_rate=False, lost=0):
    """An epoch in the middle of whose cycle the sensor's clock showed (number + 0.5) cycles."""
    time_s = (number + 0.5) * SITE.cycle_s
    fields = Fields(number, time_s, ("b1",), np.zeros((1, 3)), np.ones(1))
    report = Report(number, time_s=time_s, chips=1023, saturated=0, locked=True)
    made = pose(epoch=number, time_s=time_s)
    return Epoch(made, fields, report, lost, (), arrived_s=arrived_s, at_rate=at_rate)


def setting(clock=lambda: UNIX_S + 0.0625, **changes):
    return replace(Setting(SITE, clock=clock), **changes)
