"""Where a fit starts: points of a shell around the strongest coil, by magpylib's fields and scipy's attitudes."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.firmware.core.pose.fault_truth import field_T

PLACE, TURN = np.array([0.8, 1.3, 0.7]), Rotation.from_rotvec([0.4, -0.9, 1.7])
DIRECTIONS = 300


class Search:
    """Five coils of a site, from one of them on, with noise that counts, and one behind them that is not heard."""

    def __init__(self, core, site, first=0, radius_m=1e-3, sign=1.0, position=PLACE):
        self.ffi, self.lib = core
        rows = [site.beacons[(first + i) % 5] for i in range(5)]
        self.coils = [
            dataclasses.replace(b, radius_m=radius_m, current_A=sign * 1.3 / radius_m**2 * (1.0 + 0.1 * i))
            for i, b in enumerate(rows)
        ]
        self.fields_uT = 1e6 * TURN.inv().apply([field_T(b, position) for b in self.coils])
        self.magnitudes = np.linalg.norm(self.fields_uT, axis=1)
        self.sigmas = 0.3 * self.magnitudes * np.array([0.5, 2.0, 0.2, 1.0, 0.7])
        self.problem, self.found = self.ffi.new("pose_problem_t *"), self.ffi.new("pose_candidates_t *")
        self.problem.count = 5
        for heard, b, field, magnitude, sigma in zip(
            self.problem.heard, self.coils, self.fields_uT, self.magnitudes, self.sigmas, strict=False
        ):
            moment = b.turns * b.current_A * np.pi * b.radius_m**2
            heard.loop = (b.position_m.tolist(), b.axis.tolist(), 0.1 * moment, radius_m if radius_m > 0.01 else 0.0)
            heard.field_uT, heard.magnitude_uT, heard.sigma_uT = field.tolist(), magnitude, sigma
        behind = self.problem.heard[5]
        behind.loop, behind.field_uT = ([9.0, 9.0, 9.0], [1.0, 0.0, 0.0], 1e3, 0.0), [1e3, 0.0, 0.0]
        behind.magnitude_uT, behind.sigma_uT = 1e3, 1.0
        self.centre = self.coils[int(self.magnitudes.argmax())]

    def search(self, most=DIRECTIONS):
        """The candidates, position and loss, and how many calls it took."""
        self.lib.pose_search_begin(DIRECTIONS, self.found)
        calls = 1
        while not self.lib.pose_search(self.problem, most, self.found):
            calls += 1
        rows = list(self.found.candidates)[: self.found.count]
        return np.array([list(c.position_m) for c in rows]), np.array([c.loss for c in rows]), calls

    def best(self, points):
        """The best attitude at each point by singular values, a matrix, and its loss."""
        fields = 1e6 * np.stack([field_T(b, points) for b in self.coils], axis=1)
        weights = 1.0 / (self.sigmas**2 + (0.3 * self.magnitudes) ** 2)
        u, _, v = np.linalg.svd(np.einsum("i,pij,ik->pjk", weights, fields, self.fields_uT))
        u[:, :, 2] *= np.linalg.det(u @ v)[:, None]
        attitude = u @ v
        off = fields - np.einsum("pjk,ik->pij", attitude, self.fields_uT)
        return attitude, np.einsum("i,pij,pij->p", weights, off, off)

    def points(self):
        """Fibonacci's spiral on the shell where the strongest coil's field is as strong as measured."""
        i = np.arange(DIRECTIONS)
        z, angle = 1.0 - (2.0 * i + 1.0) / DIRECTIONS, np.pi * (3.0 - np.sqrt(5.0)) * i
        across = np.sqrt(1.0 - z**2)
        ways = np.stack([across * np.cos(angle), across * np.sin(angle), z], axis=1)
        low, high = np.full(DIRECTIONS, 0.02), np.full(DIRECTIONS, 50.0)
        for _ in range(27):
            middle = np.sqrt(low * high)
            there = np.linalg.norm(field_T(self.centre, self.centre.position_m + middle[:, None] * ways), axis=1)
            strong = 1e6 * there > self.magnitudes.max()
            low, high = np.where(strong, middle, low), np.where(strong, high, middle)
        return self.centre.position_m + low[:, None] * ways


def near(points, distance_m):
    """Whether points are neighbours of each other."""
    return np.linalg.norm(points[:, None] - points[None], axis=2) < distance_m


@pytest.mark.parametrize(("first", "sign", "most"), [(0, 1.0, 300), (1, -1.0, 70), (2, 1.0, 150), (3, 1.0, 299)])
def test_candidates_are_the_best_points_apart(core, mixed_cube, first, sign, most):
    board = Search(core, mixed_cube, first, sign=sign)
    position, loss, calls = board.search(most)
    assert calls == -(-DIRECTIONS // most)
    points = board.points()
    losses = board.best(points)[1]
    distance = np.linalg.norm(points - board.centre.position_m, axis=1)
    which = np.linalg.norm(position[:, None] - points[None], axis=2).argmin(axis=1)
    assert position == pytest.approx(points[which], abs=2e-5)
    assert loss == pytest.approx(losses[which], abs=2e-4)
    assert (np.diff(loss) >= 0.0).all()
    assert len(set(which)) == 6
    neighbours = near(points, 0.25 * distance)
    assert not (neighbours[np.ix_(which, which)] & ~np.eye(6, dtype=bool)).any()
    better = losses[None] < losses[:, None]
    missed = set(np.flatnonzero(~(neighbours & better).any(axis=1) & (losses < loss[-1]))) - set(which)
    assert not missed


def test_a_half_space_leaves_points_out(core, mixed_cube):
    """The place itself is on the other side: all others stay."""
    board = Search(core, mixed_cube)
    normal, points = np.array([0.6, 0.0, -0.8]), board.points()
    edge = PLACE + 0.3 * normal
    board.problem.normal, board.problem.point_m = normal.tolist(), edge.tolist()
    position, loss, _ = board.search()
    inside = (points - edge) @ normal >= 0.0
    assert 30 < inside.sum() < 270
    assert ((position - edge) @ normal > 0.0).all()
    assert loss[0] == pytest.approx(board.best(points[inside])[1].min(), abs=2e-4)


def test_the_attitude_of_a_candidate(core, mixed_cube):
    board = Search(core, mixed_cube)
    places = PLACE + np.array([[0.0, 0.0, 0.0], [0.1, -0.1, 0.2]])
    for place, best in zip(places.tolist(), Rotation.from_matrix(board.best(places)[0]), strict=True):
        quaternion = board.ffi.new("float[4]")
        board.lib.pose_search_attitude(board.problem, place, quaternion)
        assert (Rotation.from_quat(list(quaternion)) * best.inv()).magnitude() < 1e-3


@pytest.mark.parametrize("radii", [1.3, 2.5, 3.5])
def test_near_a_coil_the_shell_is_the_coils(core, mixed_cube, radii):
    """The dipole's from three radii on; nearer, one step from there by the cube root of magpylib's field."""
    way, radius_m = np.array([0.36, 0.48, 0.8]), 0.3
    board = Search(
        core, mixed_cube, radius_m=radius_m, position=mixed_cube.beacons[0].position_m + radii * radius_m * way
    )
    dipole = dataclasses.replace(board.centre, radius_m=1e-3, current_A=board.centre.current_A * (radius_m / 1e-3) ** 2)
    offsets, measured, seen = board.search()[0] - board.centre.position_m, board.magnitudes.max(), set()
    for offset in offsets:
        distance = np.linalg.norm(offset)
        far = (1e6 * np.linalg.norm(field_T(dipole, dipole.position_m + offset)) / measured) ** (1 / 3) * distance
        on_shell = dipole.position_m + far / distance * offset
        near_by = far * (1e6 * np.linalg.norm(field_T(board.centre, on_shell)) / measured) ** (1 / 3)
        assert distance == pytest.approx(near_by if far < 3.0 * radius_m else far, rel=1e-5)
        assert abs(near_by / far - 1.0) > 1e-4
        seen.add(bool(far < 3.0 * radius_m))
    assert seen == {radii < 3.0}
