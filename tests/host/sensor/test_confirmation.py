"""What a single epoch leaves out, while many before fit nothing, waits for others to agree."""

from __future__ import annotations

import numpy as np
import pytest

from goldfield.sensor.confirmation import AGREEING, LATEST, UNEXPLAINED, Confirmation
from goldfield.types import Pose, Status

OK, UNVERIFIED, INCONSISTENT, FAILED = Status.OK, Status.UNVERIFIED, Status.INCONSISTENT, Status.FAILED


def pose(status=OK, excluded=(), reason=None):
    return Pose(
        epoch=0,
        time_s=0.0,
        position_m=np.zeros(3),
        orientation_xyzw=np.array([0.0, 0.0, 0.0, 1.0]),
        position_cov_m2=np.eye(3),
        attitude_cov_rad2=np.eye(3),
        residual=1.0,
        status=status,
        used=("b1", "b2", "b3"),
        excluded=excluded,
        reason=reason,
    )


def after(*before):
    """Return a confirmation that has seen poses."""
    confirmation = Confirmation()
    for one in before:
        confirmation.follow(one)
    return confirmation


@pytest.mark.parametrize("status", [OK, UNVERIFIED])
@pytest.mark.parametrize(("inconsistent", "believed"), [(UNEXPLAINED - 1, True), (UNEXPLAINED, False)])
def test_what_is_left_out_after_so_many_inconsistent_epochs(status, inconsistent, believed):
    confirmation = after(*[pose(INCONSISTENT)] * inconsistent)
    found = confirmation.follow(pose(status, ("b4",), "b4 left out"))
    assert found.status is (status if believed else INCONSISTENT)
    assert found.excluded == ("b4",)
    told = "b4 left out; no pose fitted in 3 or more of the latest 10 epochs: what is left out is to be confirmed"
    assert found.reason == ("b4 left out" if believed else told)


@pytest.mark.parametrize(("agreeing", "believed"), [(AGREEING - 1, False), (AGREEING, True)])
def test_epochs_that_agree_confirm(agreeing, believed):
    confirmation = after(*[pose(INCONSISTENT)] * UNEXPLAINED, *[pose(OK, ("b4", "b5"))] * agreeing)
    assert (confirmation.follow(pose(OK, ("b5", "b4"))).status is OK) == believed


def test_another_choice_confirms_nothing():
    confirmation = after(*[pose(INCONSISTENT)] * UNEXPLAINED, pose(OK, ("b4",)), pose(OK, ("b5",)))
    assert confirmation.follow(pose(OK, ("b5",))).status is INCONSISTENT
    assert confirmation.follow(pose(OK, ("b5",))).status is OK


def test_a_pose_that_rests_on_all_needs_no_confirmation():
    confirmation = after(*[pose(INCONSISTENT)] * LATEST)
    assert confirmation.follow(pose()).status is OK
    assert confirmation.follow(pose(FAILED, ("b4",))).status is FAILED


def test_what_is_long_past_is_forgotten():
    doubted = after(*[pose(INCONSISTENT)] * UNEXPLAINED, *[pose()] * (LATEST - UNEXPLAINED))
    assert doubted.follow(pose(OK, ("b4",))).status is INCONSISTENT
    past = after(*[pose(INCONSISTENT)] * UNEXPLAINED, *[pose()] * (LATEST - UNEXPLAINED + 1))
    assert past.follow(pose(OK, ("b4",))).status is OK


def test_what_it_holds_back_itself_does_not_count():
    """Else a beacon that died in a bad moment would never be left out."""
    confirmation = after(*[pose(INCONSISTENT)] * UNEXPLAINED)
    found = [confirmation.follow(pose(OK, ("b4",))).status for _ in range(20)]
    assert found == [INCONSISTENT] * AGREEING + [OK] * (20 - AGREEING)
