"""The covariance of a pose with its terms of second order, by differences of magpylib's fields in double precision."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from goldfield.site.model import Survey
from tests.firmware.core.pose.explaining import Explaining, Place
from tests.firmware.core.pose.fault_truth import Truth, field_T

STEP = 1e-5


def near_a_coil(mixed_cube, beacons, sensor, offset_m=(0.25, 0.2, 0.35)):
    """A pose so far from a coil, whose field tells the range far better than the direction if it is near."""
    rows = [
        dataclasses.replace(b, survey=Survey(*(beacons * np.array([1e-3 * (1 + i % 3), 2e-3 * (1 + i % 2), 3e-3]))))
        for i, b in enumerate(mixed_cube.beacons)
    ]
    known = dataclasses.replace(mixed_cube.sensor, gain_sd=0.004 * sensor, axis_sd_rad=0.006 * sensor)
    site = dataclasses.replace(mixed_cube, beacons=tuple(rows), sensor=known)
    return Place(site, site.beacons[0].position_m + np.array(offset_m), Rotation.from_rotvec([0.4, -0.9, 1.7]))


def turned(vectors):
    """Turns by vectors, shape (n, 3), to second order: which of these it is counts where it is half a radian."""
    return Rotation.from_quat(np.hstack([0.5 * vectors, np.ones((len(vectors), 1))]))


class Covariance(Explaining):
    """A board with the true pose fitted, whose last beacon is not heard, and another noise for each of the others."""

    def __init__(self, core, place, sigma_T=1e-8, count=7):
        super().__init__(core, place)
        self.count = self.problem.count = count
        self.sigma_T = sigma_T * np.array([0.8, 1.0, 2.0, 0.5, 1.5, 1.0, 0.7, 1.0])
        for heard, sigma in zip(self.problem.heard, self.sigma_T, strict=False):
            heard.sigma_uT = 1e6 * sigma
        self.fit = self.start(self.ffi.new("pose_fit_t *"))
        self.lib.pose_fit(self.problem, 1, self.fit)
        for heard in self.problem.heard:
            heard.whitening = [3.0] * 6

    def told(self):
        """(whether there is one, the covariance); what lies behind it stays as it is."""
        table = self.ffi.new("float[7][6]", [[5.0] * 6] * 7)
        told = self.lib.pose_covariance(self.problem, self.fit, table)
        found = np.array([list(row) for row in table])
        assert (found[6] == 5.0).all()
        return bool(told), found[:6]

    def truth(self):
        """The covariance of the tangent alone, and that with the second order, without what the sensor leans alike."""
        site = dataclasses.replace(self.place.site, beacons=self.place.site.beacons[: self.count])
        fields = self.place.fields[: self.count]
        around = Truth.around(site, fields, self.sigma_T[: self.count], self.place.position, self.place.rotation)
        free = np.eye(3 * self.count) - around.sensor @ np.linalg.solve(
            np.eye(6) + around.sensor.T @ around.sensor, around.sensor.T
        )
        left = free @ around.rows
        information = around.rows.T @ left
        root = np.linalg.inv(np.linalg.cholesky(information).T)

        # One deviation along each axis of the ridge, both ways, and from there a small step along each, both ways.
        small = STEP * root / np.linalg.norm(root, axis=0)
        pairs = np.array([(s * a, t * b) for a in root.T for b in small.T for s in (1, -1) for t in (1, -1)])
        turn = turned(pairs[:, 1, 3:]) * turned(pairs[:, 0, 3:])
        position = self.place.position + pairs[:, :, :3].sum(axis=1)
        seen = np.stack([turn.inv().apply(field_T(b, position)) for b in site.beacons], axis=1)
        read = np.einsum("nij,pnj->pni", around.whitening, seen).reshape(6, 6, 2, 2, -1)
        bend = (read[:, :, 0, 0] - read[:, :, 0, 1] - read[:, :, 1, 0] + read[:, :, 1, 1]) / (4.0 * STEP)
        q = np.einsum("aim,i,mk->aik", bend, np.linalg.norm(root, axis=0), left @ root)
        q = 0.5 * (q + q.swapaxes(0, 1))
        mean = np.einsum("aak->k", q)
        inner = np.eye(6) + 0.25 * (np.outer(mean, mean) + 2.0 * np.einsum("aik,aim->km", q, q))
        return root @ root.T, root @ inner @ root.T


@pytest.mark.parametrize(("beacons", "sensor"), [(False, False), (True, False), (False, True), (True, True)])
@pytest.mark.parametrize(
    ("offset_m", "sigma_T", "rounding"),
    [
        ((0.25, 0.2, 0.35), 1e-9, 2e-3),
        ((0.25, 0.2, 0.35), 2e-7, 2e-2),
        ((0.6, 0.8, 0.7), 6e-7, 2e-3),
        ((0.9, 0.7, 0.8), 6e-7, 2e-3),
    ],
)
def test_a_covariance_of_second_order(core, mixed_cube, beacons, sensor, offset_m, sigma_T, rounding):
    board = Covariance(core, near_a_coil(mixed_cube, beacons, sensor, offset_m), sigma_T)
    told, found = board.told()
    assert told
    tangent, whole = board.truth()
    whole[3:, 3:] += 0.5 * (0.006 * sensor) ** 2 * np.eye(3)
    sd = np.sqrt(np.diag(whole))
    print((np.diag(whole) / np.diag(tangent)).round(3))
    assert found / np.outer(sd, sd) == pytest.approx(whole / np.outer(sd, sd), abs=rounding)


def test_what_tells_no_pose_has_no_covariance(core, mixed_cube):
    board = Covariance(core, near_a_coil(mixed_cube, False, False))
    board.fit.triangle.r[4][4] = 0.0
    assert not board.told()[0]


@pytest.mark.parametrize("unknown", range(6))
@pytest.mark.parametrize("share", [0.98, 1.02])
def test_a_variance_beyond_all_bounds_is_no_knowledge(core, mixed_cube, unknown, share):
    """1e12, of fields that noise hides, so that the triangle alone decides."""
    board = Covariance(core, near_a_coil(mixed_cube, False, False), 1e6)
    for row in range(6):
        board.fit.triangle.r[row] = [
            1e-6 / np.sqrt(share) if row == unknown == k else float(row == k) for k in range(7)
        ]
    assert board.told()[0] == (share < 1.0)


def test_what_is_no_number_is_no_knowledge(core, mixed_cube):
    board = Covariance(core, near_a_coil(mixed_cube, False, False))
    board.problem.heard[3].loop.centre_m = list(board.fit.position_m)
    board.problem.heard[3].loop.radius_m = 0.0
    assert not board.told()[0]
