"""Messages of Foxglove, decoded by protobuf: places, frames, covariance, and the colours of coils."""

import math
from dataclasses import replace

import mcap.records
import numpy as np
import pytest
from mcap_protobuf.decoder import DecoderFactory
from scipy.spatial.transform import Rotation

from goldfield import load_site
from goldfield.foxglove.messages import log_message, pose_messages
from goldfield.foxglove.scene import COLOURS, SIGMAS, pose_scene, scene
from goldfield.types import Fields, Pose, Status
from goldfield.view.beacon_state import BeaconState
from tests.host.fake_sensor import SITE

UNIX_S = 1_700_000_000.125


def decoded(message):
    schema = message.get_schema()
    record = mcap.records.Schema(id=1, name=schema.name, encoding=schema.encoding, data=schema.data)
    return DecoderFactory().decoder_for("protobuf", record)(message.encode())


@pytest.fixture
def pose():
    spread = Rotation.from_euler("xyz", [0.3, 0.4, 0.5]).as_matrix()
    return Pose(
        epoch=7,
        time_s=12.5,
        position_m=np.array([0.5, -1.25, 2.0]),
        orientation_xyzw=Rotation.from_euler("z", 90, degrees=True).as_quat(),
        position_cov_m2=spread @ np.diag([1e-4, 4e-4, 9e-4]) @ spread.T,
        attitude_cov_rad2=np.diag([1e-6, 2e-6, 3e-6]),
        residual=1.1,
        status=Status.OK,
        used=("b1",),
        protection_m=0.25,
    )


def test_a_pose_has_its_place_its_frames_and_the_time_of_the_measurement(pose):
    messages = {topic: decoded(message) for topic, message in pose_messages(pose, UNIX_S)}
    assert set(messages) == {"/tf", "/goldfield/pose", "/goldfield/pose_covariance"}
    placed, (transform,) = messages["/goldfield/pose"], messages["/tf"].transforms
    assert (placed.frame_id, transform.parent_frame_id, transform.child_frame_id) == ("map", "map", "sensor")
    for stamp in (placed.timestamp, transform.timestamp, messages["/goldfield/pose_covariance"].timestamp):
        assert (stamp.seconds, stamp.nanos) == (1_700_000_000, 125_000_000)
    q, p = transform.rotation, transform.translation
    # B_site = R B_sensor: what points along the board's x points along y of the room.
    in_room = Rotation.from_quat([q.x, q.y, q.z, q.w]).apply([1.0, 0.0, 0.0])
    assert np.allclose(in_room, [0.0, 1.0, 0.0])
    assert (p.x, p.y, p.z) == tuple(pose.position_m)
    assert (placed.pose.position.x, placed.pose.orientation.w) == (p.x, q.w)


def test_the_covariance_is_row_by_row_place_first(pose):
    odometry = decoded(dict(pose_messages(pose, UNIX_S))["/goldfield/pose_covariance"])
    matrix = np.array(odometry.pose_covariance).reshape(6, 6)
    assert np.array_equal(matrix[:3, :3], pose.position_cov_m2)
    assert np.array_equal(matrix[3:, 3:], pose.attitude_cov_rad2)
    assert not matrix[:3, 3:].any()
    assert (odometry.frame_id, odometry.body_frame_id) == ("map", "sensor")


def test_an_unknown_covariance_is_zero_as_the_schema_says(pose):
    unknown = replace(pose, position_cov_m2=np.full((3, 3), np.inf))
    odometry = decoded(dict(pose_messages(unknown, UNIX_S))["/goldfield/pose_covariance"])
    assert not np.array(odometry.pose_covariance).reshape(6, 6)[:3, :3].any()
    (entity,) = decoded(pose_scene(unknown, UNIX_S)).entities
    assert len(entity.spheres) == 1


def test_a_pose_that_failed_is_told_in_words_alone():
    failed = Pose.failed(Fields(3, 0.3, ("b1",), np.zeros((1, 3)), np.ones(1)), reason="nothing was heard")
    assert pose_messages(failed, UNIX_S) == []
    assert pose_scene(failed, UNIX_S) is None
    said = decoded(log_message(failed, UNIX_S))
    assert (said.message, said.level) == ("failed: nothing was heard", 4)


def test_the_ellipsoid_has_the_axes_of_the_covariance(pose):
    (entity,) = decoded(pose_scene(pose, UNIX_S)).entities
    ellipsoid, protection = entity.spheres
    q, size = ellipsoid.pose.orientation, ellipsoid.size
    axes = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix() @ np.diag([size.x, size.y, size.z]) / (2.0 * SIGMAS)
    assert np.allclose(axes @ axes.T, pose.position_cov_m2)
    assert protection.size.x == pytest.approx(0.5)
    unbound = decoded(pose_scene(replace(pose, protection_m=math.inf), UNIX_S))
    assert len(unbound.entities[0].spheres) == 1


def test_the_scene_has_each_coil_where_it_is_in_the_colour_of_its_health():
    site = load_site(SITE)
    ids = [beacon.id for beacon in site.beacons]
    well = {"measured_T": 1e-6, "ratio": 1.04, "used": True}
    health = {
        "beacons": {name: well for name in ids}
        | {
            ids[1]: well | {"ratio": 1.06},
            ids[2]: well | {"used": False},
            ids[3]: well | {"measured_T": None, "used": False},
        }
    }
    entities = {one.id: one for one in decoded(scene(site, UNIX_S, health)).entities}
    assert set(entities) == {"site", *(f"beacon {name}" for name in ids)}
    states = [BeaconState.USED, BeaconState.STRENGTH_OFF, BeaconState.LEFT_OUT, BeaconState.NOT_HEARD]
    for beacon, state in zip(site.beacons, states, strict=False):
        entity = entities[f"beacon {beacon.id}"]
        (line,), (arrow,), (text,) = entity.lines, entity.arrows, entity.texts
        wanted = decoded(COLOURS[state])
        assert (line.color.r, line.color.g, line.color.b) == (wanted.r, wanted.g, wanted.b)
        wire = np.array([(p.x, p.y, p.z) for p in line.points])
        assert np.allclose((wire - beacon.position_m) @ beacon.axis, 0.0, atol=1e-12)
        assert np.allclose(np.linalg.norm(wire - beacon.position_m, axis=1), beacon.radius_m)
        q = arrow.pose.orientation
        assert np.allclose(Rotation.from_quat([q.x, q.y, q.z, q.w]).apply([1.0, 0.0, 0.0]), beacon.axis)
        assert text.text == beacon.id
    grey = {one.id: one for one in decoded(scene(site, UNIX_S)).entities}[f"beacon {ids[0]}"]
    assert grey.lines[0].color.r == decoded(COLOURS[BeaconState.UNKNOWN]).r


@pytest.mark.parametrize("axis", [(1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.6, -0.8)])
def test_an_arrow_points_along_any_axis(axis):
    site = load_site(SITE)
    turned = replace(site, beacons=(replace(site.beacons[0], axis=np.array(axis)), *site.beacons[1:]))
    entity = decoded(scene(turned, UNIX_S)).entities[1]
    q = entity.arrows[0].pose.orientation
    assert np.allclose(Rotation.from_quat([q.x, q.y, q.z, q.w]).apply([1.0, 0.0, 0.0]), axis)
