"""Messages of ROS 2: their bytes, their frames and stamps, and their covariance against simulated fields.

No ROS is installed where these tests run: `tests.host.feeds.fake_ros` stands in for it. It checks types as ROS does,
and the package rosbags, which knows the definitions of the messages from ROS itself, makes and reads the CDR.
"""

import struct
import sys

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from goldfield import Fields, locate
from goldfield.errors import UserError
from goldfield.feeds.address import parse_address
from goldfield.feeds.opening import open_feed
from goldfield.feeds.ros2_messages import POSE, Frames, Messages
from goldfield.types import Explanation, Finding, Status
from tests.host.fake_sensor import POSITION_M, beacon_fields
from tests.host.feeds import fake_ros, made
from tests.host.feeds.made import ATTITUDE, SITE, UNIX_S, failed, pose, setting, stamped

SECONDS, NANOSECONDS = 1_700_000_000, 250_000_000


@pytest.fixture
def rclpy(monkeypatch):
    return fake_ros.install(monkeypatch)


def published(rclpy, *items, url="ros2:goldfield"):
    feed = open_feed(parse_address(url), setting())
    for item in items:
        feed.write(item)
    feed.close()
    node = rclpy.nodes[-1]
    assert node.destroyed
    assert not node.context.ok()
    return node


def test_two_feeds_have_a_node_each_and_none_ends_the_other(rclpy):
    first, second = (open_feed(parse_address(f"ros2:{prefix}"), setting()) for prefix in ("goldfield", "robot/field"))
    nodes = rclpy.nodes
    assert [node.name for node in nodes] == ["goldfield", "robot_field"]
    first.write(stamped())
    first.close()
    second.write(stamped())
    assert (nodes[0].destroyed, nodes[1].destroyed) == (True, False)
    assert [len(nodes[0].of("goldfield/pose")), len(nodes[1].of("robot/field/pose"))] == [1, 1]
    second.close()
    assert not any(node.context.ok() for node in nodes)


def test_the_nodes_of_the_program_itself_are_left_alone(rclpy):
    """The program has a node in the default context before the feed is opened."""
    rclpy.init(args=[])
    before = rclpy.create_node("robot", start_parameter_services=False)
    published(rclpy, stamped())
    assert rclpy.ok()
    assert not before.destroyed
    rclpy.shutdown()


def test_a_node_that_cannot_be_made_leaves_no_context_behind(rclpy, monkeypatch):
    made = []
    monkeypatch.setattr(rclpy, "create_node", lambda *_, context, **__: made.append(context) or 1 / 0)
    with pytest.raises(ZeroDivisionError):
        open_feed(parse_address("ros2:goldfield"), setting())
    assert [context.state for context in made] == ["down"]


def test_the_bytes_of_a_pose_are_those_of_cdr(rclpy):
    """Written out by hand: encapsulation, stamp, frame, and 43 doubles, each on a multiple of 8 behind the first 4."""
    (cdr,) = (cdr for topic, _, cdr in published(rclpy, stamped()).published if topic == "goldfield/pose")
    covariance = np.zeros((6, 6))
    covariance[:3, :3], covariance[3:, 3:] = made.POSITION_COV_M2, made.ATTITUDE_COV_RAD2
    head = b"\0\1\0\0" + struct.pack("<iI", SECONDS, NANOSECONDS) + struct.pack("<I", 4) + b"map\0"
    doubles = [*made.POSITION_M, *ATTITUDE.as_quat(canonical=True), *covariance.ravel()]
    assert cdr == head + struct.pack("<43d", *doubles)


def test_the_bytes_of_a_transform_are_those_of_cdr(rclpy):
    (cdr,) = (cdr for topic, _, cdr in published(rclpy, stamped()).published if topic == "/tf")
    head = struct.pack("<IiI", 1, SECONDS, NANOSECONDS) + struct.pack("<I", 4) + b"map\0"
    head += struct.pack("<I", 7) + b"sensor\0"
    head += bytes(-len(head) % 8)  # doubles begin on a multiple of 8 behind the encapsulation
    doubles = [*made.POSITION_M, *ATTITUDE.as_quat(canonical=True)]
    assert cdr == b"\0\1\0\0" + head + struct.pack("<7d", *doubles)


def test_a_transform_takes_points_of_the_board_to_the_room(rclpy):
    (message,) = published(rclpy, stamped()).of("/tf")
    (frame,) = message.transforms
    assert (frame.header.frame_id, frame.child_frame_id) == ("map", "sensor")
    q, p = frame.transform.rotation, frame.transform.translation
    turn = Rotation.from_quat([q.x, q.y, q.z, q.w])
    tip = turn.apply([0.1, 0.0, 0.0]) + np.array([p.x, p.y, p.z])
    # ATTITUDE is yaw 2.0, pitch -0.4, roll 0.7: its x axis points up by 0.4 and along the yaw (REP 103).
    assert np.allclose(
        tip - made.POSITION_M, 0.1 * np.array([np.cos(2.0) * np.cos(0.4), np.sin(2.0) * np.cos(0.4), np.sin(0.4)])
    )


def test_frames_and_topics_may_have_other_names(rclpy):
    node = published(rclpy, stamped(), url="ros2:/robot/field?map=world&sensor=imu_link")
    assert {topic for topic, *_ in node.published} == {"/robot/field/pose", "/tf", "/diagnostics"}
    assert node.of("/robot/field/pose")[0].header.frame_id == "world"
    assert node.of("/tf")[0].transforms[0].child_frame_id == "imu_link"


def test_a_robot_whose_sensor_has_another_parent_gets_no_transform(rclpy):
    node = published(rclpy, stamped(), url="ros2:goldfield?tf=no")
    assert {topic for topic, *_ in node.published} == {"goldfield/pose", "/diagnostics"}
    with pytest.raises(UserError, match="tf=maybe is neither yes nor no"):
        open_feed(parse_address("ros2:goldfield?tf=maybe"), setting())


@pytest.mark.parametrize("status", Status)
def test_only_poses_that_fit_are_published_and_the_others_are_told(rclpy, status):
    item = stamped(failed() if status is Status.FAILED else pose(status=status, reason="why it is not worth more"))
    node = published(rclpy, item)
    assert len(node.of("goldfield/pose")) == len(node.of("/tf")) == (status in (Status.OK, Status.UNVERIFIED))
    (message,) = node.of("/diagnostics")
    levels = {Status.OK: 0, Status.INCONSISTENT: 2, Status.FAILED: 2}
    assert message.status[0].level == levels.get(status, 1)
    assert message.status[0].message == item.pose.reason


def test_diagnostics_tell_of_the_pose_and_each_beacon(rclpy):
    finding = Finding(Explanation.DEAD, ("b3",), "b3 has no field: check its coil")
    node = published(rclpy, stamped(pose(findings=(finding,))))
    (message,) = node.of("/diagnostics")
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (SECONDS, NANOSECONDS)
    about_pose, *beacons = message.status
    assert {one.hardware_id for one in message.status} == {SITE.name}
    values = {pair.key: pair.value for pair in about_pose.values}
    assert values == {
        "status": "ok",
        "residual": "1.25",
        "protection_m": "0.125",
        "used": "b1 b2",
        "lost": "2",
        "latency_s": "0.0625",
    }
    assert [(one.name, one.level, one.message) for one in beacons] == [
        ("goldfield: beacon b1", 0, "used"),
        ("goldfield: beacon b2", 0, "used"),
        ("goldfield: beacon b3", 1, "b3 has no field: check its coil"),
    ]
    assert [beacons[0].values[0].key, beacons[0].values[0].value] == ["residual", "0.5"]


def test_diagnostics_come_once_a_second_even_if_the_clock_is_set_back(rclpy):
    times = [UNIX_S + 0.1 * number for number in range(25)] + [UNIX_S - 3600.0 + 0.1 * number for number in range(5)]
    node = published(rclpy, *(stamped(unix_s=time) for time in times))
    stamps = [message.header.stamp.sec for message in node.of("/diagnostics")]
    assert stamps == [SECONDS, SECONDS + 1, SECONDS + 2, SECONDS - 3600]
    assert len(node.of("goldfield/pose")) == 30


def test_without_ros_the_feed_is_refused(monkeypatch):
    monkeypatch.setitem(sys.modules, "rclpy", None)
    with pytest.raises(UserError, match=r"^feed=ros2:a: needs ROS 2 .*setup\.bash"):
        open_feed(parse_address("ros2:a"), setting())


SIGMA_T = 6e-9
POSES = 400
LEANING = Rotation.from_euler("xyz", [1.5, 0.1, 0.2])
"""Turned about x by nearly a right angle: a covariance in the board's axes would be another one."""


def test_the_covariance_is_that_of_simulated_fields():
    """Errors of position and of rotation about the fixed axes x, y, z of many noisy poses, as REP 103 words them."""
    clean_T = beacon_fields(POSITION_M, LEANING)
    names = tuple(beacon.id for beacon in SITE.beacons)
    noise_T = np.random.default_rng(14).normal(scale=SIGMA_T, size=(POSES, *clean_T.shape))
    found = [
        locate(SITE, Fields(number, 0.1 * number, names, clean_T + noise, np.full(len(names), SIGMA_T)))
        for number, noise in enumerate(noise_T)
    ]
    errors = np.array(
        [
            [
                *(one.position_m - POSITION_M),
                *(Rotation.from_quat(one.orientation_xyzw) * LEANING.inv()).as_euler("xyz"),  # small: fixed axes
            ]
            for one in found
        ]
    )
    messages = Messages(lambda name: fake_ros.STORE.types[name], Frames())
    cdr = fake_ros.STORE.serialize_cdr(messages.pose(stamped(found[0])), POSE)
    told = fake_ros.STORE.deserialize_cdr(cdr, POSE).pose.covariance.reshape(6, 6)
    for part in (slice(0, 3), slice(3, 6)):
        assert fits(errors[:, part], told[part, part])
    board = LEANING.as_matrix().T @ told[3:, 3:] @ LEANING.as_matrix()
    assert not fits(errors[:, 3:], board)
    assert not fits(errors[:, 3:], told[3:, 3:][::-1, ::-1])


def fits(errors, covariance):
    """Tell whether errors have a covariance: whitened by it, theirs has eigenvalues near 1."""
    whitened = np.linalg.solve(np.linalg.cholesky(covariance), errors.T)
    eigenvalues = np.linalg.eigvalsh(np.cov(whitened))
    return bool(eigenvalues.min() > 0.75 and eigenvalues.max() < 1.3)
