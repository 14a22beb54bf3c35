"""The table of poses and the summary of a run: what they say, and that they fit a terminal of 80 columns."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from goldfield.types import Explanation, Fields, Finding, Pose, Status
from goldfield.view.summary import Summary
from goldfield.view.terminal import WIDTH, PoseTable, roll_pitch_yaw_deg
from goldfield.view.truth import PoseError


def pose(epoch, status=Status.OK, **more):
    sd = np.diag([1e-4, 4e-4, 4e-4])  # the root of the sum is 3 cm
    turn = Rotation.from_euler("ZYX", [-179.9, -60.0, -179.9], degrees=True).as_quat()
    given = {"excluded": (), "reason": None, "protection_m": 0.2551} | more
    return Pose(epoch, 0.1 * epoch, np.array([-12.3456, 7.0, 0.25]), turn, sd, sd, 1.234, status, ("b1", "b3"), **given)


def moved(x):
    place = np.array([x, 0.0, 2.0])
    return Finding(Explanation.MOVED, ("b2",), f"b2 fits better at ({x:.3f}, 0, 2): measure its place", place)


def test_roll_pitch_yaw_against_scipy():
    for rotation in Rotation.random(50, rng=np.random.default_rng(3)):
        yaw, pitch, roll = rotation.as_euler("ZYX", degrees=True)
        np.testing.assert_allclose(roll_pitch_yaw_deg(rotation.as_quat()), [roll, pitch, yaw], atol=1e-9)


def test_a_line_has_deviation_and_protection_level_and_who_was_left_out():
    header, line = PoseTable().line(pose(7, excluded=("b2",))).splitlines()
    assert " ".join(header.split()) == "epoch x m y m z m roll pitch yaw sd cm n pl cm status"
    assert " ".join(line.split()) == "7 -12.346 7.000 0.250 -179.9 -60.0 -179.9 3.0 2 25.5 ok, no b2"


@pytest.mark.parametrize("table", [{}, {"times": True}, {"truth": True}])
def test_every_line_has_the_protection_level(table):
    """A dash where nothing is promised."""
    for level, text in ((0.2551, "25.5"), (np.inf, "-")):
        header, line = PoseTable(**table).line(replace(pose(7), protection_m=level)).splitlines()
        end = header.index("pl cm") + 5
        assert line[end - 5 : end].strip() == text


@pytest.mark.parametrize("status", list(Status))
def test_every_status_fits_80_columns(status):
    text = PoseTable().line(pose(123456, status, excluded=("a beacon with a name", "b2"), reason="why " * 40), lost=12)
    assert max(map(len, text.splitlines())) <= WIDTH
    assert text.count("why") == 40
    assert "no a beacon with a name b2, 12 lost" in " ".join(text.split())


def test_numbers_of_any_size_keep_their_columns():
    large = replace(
        pose(3),
        position_m=np.array([-12345.678, 9.87e15, -4e-9]),
        position_cov_m2=np.eye(3) * 1e70,
        protection_m=303.5221,
    )
    header, line = PoseTable().line(large).splitlines()
    assert line.split()[1:4] == ["-12346", "1e+16", "-0.000"]
    assert line.split()[7:10] == ["2e+37", "2", "30352"]
    assert line.index("30352") + 5 == header.index("pl cm") + 5


def test_with_the_truth_a_pose_fits_80_columns_too():
    table = PoseTable(truth=True)
    lines = table.line(pose(123456, Status.OK, excluded=("b2",)), PoseError(0.0123, 0.02)).splitlines()
    assert max(map(len, lines)) <= WIDTH
    assert lines[1].split()[8:10] == ["1.23", "1.15"]


def test_a_failed_pose_has_dashes():
    failed = Pose.failed(Fields(3, 0.3, (), np.zeros((0, 3)), np.zeros(0)))
    _, line, reason = PoseTable().line(failed).splitlines()
    assert line.split() == ["3", *"-------", "0", "-", "failed"]
    assert reason.strip() == "the fields give no pose"


def test_a_reason_is_told_when_it_changes():
    table = PoseTable()
    said = ["first", "first", None, "first", "second"]
    text = "\n".join(table.line(pose(i, Status.INCONSISTENT, reason=reason)) for i, reason in enumerate(said))
    assert text.split().count("first") == 2
    assert text.split().count("second") == 1


def test_the_header_comes_again():
    table = PoseTable()
    text = "\n".join(table.line(pose(i)) for i in range(60))
    assert text.count("status") == 3


def test_the_summary_counts_ok_poses_only():
    summary = Summary()
    summary.add(pose(0), PoseError(0.03, 0.3), lost=2)
    summary.add(pose(1), PoseError(0.04, 0.4))
    summary.add(pose(2, Status.FAILED), PoseError(9.0, 3.0))
    assert summary.text(truth=True).splitlines() == [
        "3 epochs: 2 ok, 1 failed",
        "the link: 2 messages lost",
        "rms error of 2 ok poses: position 3.54 cm, attitude 20.26 deg",
    ]
    assert Summary().text(truth=True).endswith("no ok pose could be compared with the truth")


def test_the_summary_tells_where_a_beacon_fits_better():
    """The median over the epochs: a single one may be far off."""
    summary = Summary()
    for x in (1.0, 1.01, 1.02, 9.0, 1.015):
        summary.add(pose(0, excluded=("b2",), findings=(moved(x),), reason="b2 was left out"))
    summary.add(pose(0))
    assert summary.text(truth=False).splitlines() == [
        "6 epochs: 6 ok",
        "b2 left out in 5 of 6: its position fits better at (1.015, 0.000, 2.000) m",
    ]


def test_the_summary_tells_what_is_wrong_with_the_whole_site():
    summary = Summary()
    text = "the fields fit with the sensor's axes mirrored: check the wiring of x, y and z, and of the coils"
    for _ in range(3):
        summary.add(pose(0, Status.INCONSISTENT, reason=text, findings=(Finding(Explanation.MIRRORED, (), text),)))
    lines = summary.text(truth=False).splitlines()
    assert lines[0] == "3 epochs: 3 inconsistent"
    assert " ".join(" ".join(lines[1:]).split()) == f"in 3 of 3: {text}"
    assert max(map(len, lines)) <= WIDTH


def test_the_summary_counts_what_boards_say_by_the_sentence_and_once_a_pose():
    """Two sentences of one kind were counted together: in 1947 of 1462, such as the last."""
    summary, twice, jumped = Summary(), "cycles come twice", "the numbers of the cycles jumped"
    both = tuple(Finding(Explanation.CLOCK, (), text) for text in (twice, jumped))
    silent = tuple(Finding(Explanation.BOARD, ("b1",), text) for text in ("b1 is silent", "no board of b1"))
    summary.add(pose(0, findings=both, reason="both"))
    summary.add(pose(1, findings=both[:1], reason=twice))
    summary.add(pose(2, findings=silent, reason="silent"))
    assert summary.text(truth=False).splitlines()[1:] == [
        f"in 2 of 3: {twice}",
        f"in 1 of 3: {jumped}",
        "in 1 of 3: no board of b1",
    ]


def test_the_summary_gives_an_example_of_reasons_that_differ():
    summary = Summary()
    for metres in (0.6, 0.7):
        summary.add(pose(0, Status.UNVERIFIED, reason=f"a fault of b1 could hide {metres} m"))
    summary.add(replace(pose(0), status=Status.WEAK, reason="far away"))
    assert summary.text(truth=False).splitlines()[1:] == [
        "unverified in 2 of 3, such as: a fault of b1 could hide 0.7 m",
        "weak in 1 of 3: far away",
    ]


def test_counters_are_told_if_they_are_not_zero():
    link = {"messages that came twice": 3, "corrupt frames": 0}
    summary = Summary(link=link, counters={"overrun": 2}, board_counters={7: {"resets": 1}}, dropped={"FILE": 4})
    assert summary.text(truth=False).splitlines()[1:] == [
        "the link: 3 messages that came twice",
        "the sensor counted since its reset: 2 overrun",
        "node 7 counted: 1 reset",
        "4 epochs were left out of FILE, which was too slow or not there",
    ]
