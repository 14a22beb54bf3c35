"""A body that answers exactly, and the rounds of location beside one, with a locator that only reads the fields."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.constants import mu_0
from scipy.spatial.transform import Rotation

from goldfield.field.conductor import Material, ball
from goldfield.locate.own_body import ROUNDS, SETTLED_M, SETTLED_RAD, OwnBody, locate_beside
from goldfield.types import Fields, Pose, Status
from hil_sim.world.sphere import Sphere
from tests.bench import locate_trials as bench

NAMES = ("b0", "b1", "b2")


class Superconductor:
    """A ball that keeps all fields out at once, by the exact series, in the place of a `Conductor`."""

    def __init__(self, centre_m, radius_m):
        self.centre_m, self.sphere = centre_m, Sphere(centre_m, radius_m, np.inf)

    def body(self, pieces):
        return ball(self.centre_m, self.sphere.radius_m, Material(1.0), pieces)

    def responses(self, frequency_Hz):
        return [SimpleNamespace(parts=self._parts) for _ in frequency_Hz]

    def _parts(self, source_m, moment_A_m2):
        return SimpleNamespace(
            field=lambda point: self.sphere.secondary(point, source_m[:, None], moment_A_m2[:, None], 1.0)
        )


@pytest.mark.parametrize("size", [1.0, 40.0])
def test_a_body_adds_its_exact_answer_whatever_its_size(size):
    """Two balls and coils of any distance from half a metre on, all of them larger or smaller."""
    rng = np.random.default_rng(12)
    away = rng.normal(size=(8, 3))
    away *= size * np.geomspace(0.7, 3.0, 8)[:, None] / np.linalg.norm(away, axis=1)[:, None]
    site = bench.site_of([bench.loop_beacon(i, away[i], rng.normal(size=3), radius=0.02) for i in range(8)])
    balls = [Superconductor(size * np.array(centre), 0.1 * size) for centre in ([0.02, 0.0, -0.2], [-0.1, 0.15, 0.1])]
    turn, place = Rotation.from_rotvec([0.3, -0.2, 0.5]).as_matrix(), 0.05 * size * np.ones(3)
    source = np.array([beacon.position_m - place for beacon in site.beacons]) @ turn
    moment = np.array([b.turns * b.current_A * np.pi * b.radius_m**2 * b.axis for b in site.beacons]) @ turn
    truth = mu_0 * sum(one.sphere.secondary(np.zeros(3), source, moment, 1.0).real for one in balls)
    error = np.linalg.norm(OwnBody(site, balls).secondary(place, turn) - truth, axis=1)
    assert (error < 0.02 * np.linalg.norm(truth, axis=1)).all()


class Reader:
    """A locator that reads the position in the field of b0 and a rotation vector in that of b1."""

    def __init__(self, axes=None, fail_at=None):
        self.site = SimpleNamespace(
            beacons=[SimpleNamespace(id=name) for name in NAMES], sensor=SimpleNamespace(axes=axes)
        )
        self.fail_at, self.calls = fail_at, []

    def locate(self, fields):
        self.calls.append(fields.field_T)
        if len(self.calls) == self.fail_at:
            return Pose.failed(fields)
        of = dict(zip(fields.beacons, fields.field_T, strict=True))
        quaternion = Rotation.from_rotvec(of["b1"]).as_quat()
        return Pose(0, 0.0, of["b0"], quaternion, np.eye(3), np.eye(3), 1.0, Status.OK, NAMES)


def beside(locator, adds, fields):
    return locate_beside(locator, SimpleNamespace(secondary=adds), fields)


def constant(shift=0.0, turn=0.0):
    """A body that adds the same everywhere: the first round moves the pose by just that and the next by nothing."""
    return lambda position, rotation: np.array([[-shift, 0.0, 0.0], [0.0, -turn, 0.0], [0.0, 0.0, 0.0]])


def at_home():
    return Fields(0, 0.0, NAMES, np.zeros((3, 3)), np.ones(3))


@pytest.mark.parametrize(
    ("shift", "turn", "rounds"),
    [
        (0.97 * SETTLED_M, 0.97 * SETTLED_RAD, 1),
        (SETTLED_M, 0.0, 2),
        (1.03 * SETTLED_M, 0.0, 2),
        (0.0, 1.03 * SETTLED_RAD, 2),
        (10.0 * SETTLED_M, 10.0 * SETTLED_RAD, 2),
    ],
)
def test_a_round_that_moves_the_pose_by_next_to_nothing_is_the_last(shift, turn, rounds):
    locator = Reader()
    pose = beside(locator, constant(shift, turn), at_home())
    assert pose.status is Status.OK
    assert len(locator.calls) == 1 + rounds
    np.testing.assert_allclose(pose.position_m, [shift, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(Rotation.from_quat(pose.orientation_xyzw).as_rotvec(), [0.0, turn, 0.0], atol=1e-12)


def test_what_moves_far_from_the_origin_settles_as_well():
    """A fifth of the place and of the turn is added: each round leaves a fifth of the error, of the other sign."""
    place, turn = np.array([3.0, -2.0, 1.0]), np.array([0.3, 0.0, -0.2])

    def adds(position, rotation):
        return np.stack([0.2 * position, 0.2 * Rotation.from_matrix(rotation).as_rotvec(), np.zeros(3)])

    locator = Reader()
    measured = Fields(0, 0.0, NAMES, np.stack([1.2 * place, 1.2 * turn, np.ones(3)]), np.ones(3))
    pose = beside(locator, adds, measured)
    assert pose.status is Status.OK
    np.testing.assert_allclose(pose.position_m, place, atol=SETTLED_M)
    np.testing.assert_allclose(Rotation.from_quat(pose.orientation_xyzw).as_rotvec(), turn, atol=SETTLED_RAD)
    np.testing.assert_array_equal(measured.field_T[0], 1.2 * place)  # what was measured stays


def test_what_never_settles_is_inconsistent():
    locator = Reader()
    pose = beside(
        locator,
        lambda position, rotation: 0.95 * np.stack([position] * 3) * [[1.0], [0.0], [0.0]],
        Fields(0, 0.0, NAMES, np.ones((3, 3)) * [[1.0], [0.0], [0.0]], np.ones(3)),
    )
    assert pose.status is Status.INCONSISTENT
    assert len(locator.calls) == 1 + ROUNDS


@pytest.mark.parametrize("fail_at", [1, 2])
def test_no_round_follows_where_there_is_no_pose(fail_at):
    locator = Reader(fail_at=fail_at)
    assert beside(locator, constant(shift=1.0), at_home()).status is Status.FAILED
    assert len(locator.calls) == fail_at


def test_beacons_in_any_order_and_strangers_and_the_axes_of_the_sensor():
    """Two axes read -y and x of the frame that the body is known in; what a stranger is heard with stays."""
    axes = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0]])
    added = np.arange(1.0, 10.0).reshape(3, 3) * [[0.0], [0.0], [1.0]]
    fields = Fields(
        0, 0.0, ("b2", "stranger", "b1", "b0"), np.full((4, 3), 20.0) * [[1.0], [1.0], [0.0], [0.0]], np.ones(4)
    )
    locator = Reader(axes)
    assert beside(locator, lambda position, rotation: added, fields).status is Status.OK
    for seen in locator.calls[1:]:
        np.testing.assert_array_equal(seen[0], [20.0 + 8.0, 20.0 - 7.0, 20.0])
        np.testing.assert_array_equal(seen[1:], fields.field_T[1:])
