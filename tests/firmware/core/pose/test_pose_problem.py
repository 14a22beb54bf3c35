"""What a pose is computed from: which beacons are heard, and how site and fields stand in the problem."""

import numpy as np
import pytest
from scipy.stats import chi2

MOST = 64
NAN = float("nan")


class Site:
    """Some beacons with fields, all of whose numbers differ; beacon 2 is the strongest."""

    def __init__(self, core, count=5):
        self.ffi, self.lib = core
        rng = np.random.default_rng(3)
        self.site, self.problem = self.ffi.new("pose_site_t *"), self.ffi.new("pose_problem_t *")
        self.fields = self.ffi.new("pose_field_t[]", MOST + 2)
        self.site.count = count
        self.position, self.axis = rng.normal(size=(MOST, 3)), rng.normal(size=(MOST, 3))
        self.moment, self.radius = rng.uniform(-9.0, 9.0, MOST), rng.uniform(0.1, 0.2, MOST)
        self.field_T, self.sigma_T = rng.uniform(0.1, 0.5, (MOST + 2, 3)) * 1e-6, rng.uniform(1e-9, 2e-9, MOST + 2)
        self.field_T[2] *= -9.0
        self.rows = range(count)
        for i, row in enumerate(self.site.beacons):
            row.position_m, row.axis = self.position[i].tolist(), self.axis[i].tolist()
            row.moment_A_m2, row.radius_m = self.moment[i], self.radius[i]
        for i, row in enumerate(self.fields):
            row.field_T, row.sigma_T = self.field_T[i].tolist(), self.sigma_T[i]
        self.site.half_space_point_m, self.site.half_space_normal = [1.0, -2.0, 3.0], [0.6, 0.0, 0.8]
        self.site.alert_limit_m, self.site.gain_sd, self.site.axis_sd_rad = 0.7, 0.02, 0.03

    def built(self):
        """The problem and the rows that it has heard; whatever stood there before."""
        size = self.ffi.sizeof("pose_problem_t")
        self.ffi.memmove(self.problem, b"\x55" * size, size)
        self.problem.exact_beacons = False
        self.lib.pose_problem(self.site, self.fields, self.problem)
        return self.problem, [self.problem.heard[i].row for i in range(self.problem.count)]


def test_the_numbers_of_site_and_fields(core):
    board = Site(core)
    sds = np.random.default_rng(4).uniform(0.001, 0.01, (5, 3))
    for row, (position_sd, axis_sd, current_sd) in zip(board.site.beacons, sds.tolist(), strict=False):
        row.position_sd_m, row.axis_sd_rad, row.current_sd = position_sd, axis_sd, current_sd
    problem, rows = board.built()
    assert rows == [0, 1, 2, 3, 4]
    assert list(problem.origin_m) == pytest.approx(board.position[2], rel=1e-6)
    for i, heard in enumerate(list(problem.heard)[:5]):
        field_uT = 1e6 * board.field_T[i]
        assert list(heard.loop.centre_m) == pytest.approx(board.position[i] - board.position[2], abs=1e-6)
        assert list(heard.loop.axis) == pytest.approx(board.axis[i] / np.linalg.norm(board.axis[i]), abs=1e-6)
        assert (heard.loop.k_uT_m3, heard.loop.radius_m) == pytest.approx((0.1 * board.moment[i], board.radius[i]))
        assert list(heard.field_uT) == pytest.approx(field_uT, rel=1e-6)
        assert heard.magnitude_uT == pytest.approx(np.linalg.norm(field_uT), rel=1e-6)
        assert heard.sigma_uT == pytest.approx(1e6 * board.sigma_T[i], rel=1e-6)
        assert (heard.position_sd_m, heard.axis_sd_rad, heard.current_sd) == pytest.approx(sds[i], rel=1e-6)
    assert list(problem.point_m) == pytest.approx([1.0, -2.0, 3.0] - board.position[2], abs=1e-6)
    assert list(problem.normal) == pytest.approx([0.6, 0.0, 0.8])
    assert (problem.alert_limit_m, problem.gain_sd, problem.axis_sd_rad) == pytest.approx((0.7, 0.02, 0.03))


@pytest.mark.parametrize(
    ("name", "value", "heard"),
    [
        ("axis", [0.0, 0.0, 0.0], False),
        ("axis", [NAN, 0.0, 1.0], False),
        ("moment_A_m2", 0.0, False),
        ("moment_A_m2", -1.0, True),
        ("sigma_T", 0.0, False),
        ("sigma_T", -1e-9, False),
        ("sigma_T", NAN, False),
        ("sigma_T", 0.95e9, True),
        ("sigma_T", 1.05e9, False),
        ("field_T", [0.0, 0.0, 0.0], False),
        ("field_T", [0.0, NAN, 0.0], False),
        ("field_T", [0.0, float("inf"), 0.0], False),
        ("field_T", [0.57e9, 0.76e9, 0.0], True),
        ("field_T", [0.63e9, 0.84e9, 0.0], False),
    ],
)
@pytest.mark.parametrize("row", [0, 4])
def test_what_counts_as_heard(core, name, value, heard, row):
    """All else is, in its order; the greatest field is 1e15 uT."""
    board = Site(core)
    setattr(board.fields[row] if name.endswith("_T") else board.site.beacons[row], name, value)
    assert board.built()[1] == [i for i in range(5) if heard or i != row]


def test_a_coil_of_no_radius_is_a_dipole(core):
    board = Site(core)
    board.site.beacons[1].radius_m = -0.1
    assert board.built()[0].heard[1].loop.radius_m == 0.0


@pytest.mark.parametrize("count", [0, 63, 64, 65])
def test_no_more_beacons_than_the_site_has(core, count):
    """What lies behind the last is no beacon, however many are said to be there."""
    assert Site(core, count).built()[1] == list(range(min(count, MOST)))


def test_nothing_heard(core):
    problem, rows = Site(core, 0).built()
    assert rows == []
    assert list(problem.origin_m) == [0.0, 0.0, 0.0]
    assert list(problem.point_m) == [1.0, -2.0, 3.0]


def test_one_faint_beacon_is_the_origin(core):
    board = Site(core, 1)
    board.fields[0].field_T = [1e-12, 0.0, 0.0]
    assert list(board.built()[0].origin_m) == pytest.approx(board.position[0], rel=1e-6)


@pytest.mark.parametrize("name", ["position_sd_m", "axis_sd_rad", "current_sd"])
@pytest.mark.parametrize("row", [None, 0, 2, 4, 5])
def test_beacons_are_exact_unless_one_that_is_heard_is_not(core, name, row):
    board = Site(core, 6)
    board.fields[5].sigma_T = 0.0
    if row is not None:
        setattr(board.site.beacons[row], name, 1e-6)
    assert board.built()[0].exact_beacons == (row in (None, 5))


@pytest.mark.parametrize("count", [3, 8])
def test_degrees_of_freedom(core, count):
    board = Site(core, count)
    assert board.lib.pose_problem_freedom(board.built()[0]) == 3 * count - 6


@pytest.mark.parametrize(("count", "much"), [(3, 1.03), (8, 1.01), (40, 1.003)])
def test_fields_beyond_noise(core, count, much):
    """One of a million; the limit by Wilson and Hilferty is too great by so much. All beacons tell alike."""
    board = Site(core, count + 1)
    problem, _ = board.built()
    problem.count = count
    low, high = 0.9, 1.1
    for _ in range(15):
        share = 0.5 * (low + high)
        for heard in list(problem.heard)[: count + 1]:
            heard.sigma_uT = heard.magnitude_uT / np.sqrt(share * chi2.isf(1e-6, 3 * count) / count)
        audible = board.lib.pose_problem_audible(problem)
        low, high = (low, share) if audible else (share, high)
    assert 1.0 < share < much


def test_inside_the_half_space(core):
    board = Site(core)
    problem, _ = board.built()
    edge, normal = np.array(list(problem.point_m)), np.array([0.6, 0.0, 0.8])
    for way, inside in ((0.01, True), (-0.01, False)):
        place = edge + way * normal + [0.8, 5.0, -0.6]
        assert board.lib.pose_problem_inside(problem, place.tolist()) == inside
    problem.normal = [0.0, 0.0, 0.0]
    assert board.lib.pose_problem_inside(problem, [9.0, -9.0, 9.0])


@pytest.mark.parametrize("row", [0, 1, 4, 5])
def test_the_nearest_beacon(core, row):
    """Among those that are heard: the one behind them is not."""
    board = Site(core, 6)
    problem, _ = board.built()
    place = board.position[row] - board.position[2] + [0.01, 0.02, -0.02]
    problem.count = 5
    centres = board.position[:5] - board.position[2]
    nearest2 = ((centres - place) ** 2).sum(axis=1).min()
    assert board.lib.pose_problem_nearest2(problem, place.tolist()) == pytest.approx(nearest2, rel=1e-4)


def fields_of(problem, count):
    return np.array([list(h.field_uT) for h in list(problem.heard)[:count]])


def test_fields_reversed_and_scaled(core):
    """Those of beacons that are heard, and nothing but these; a second reversal restores them."""
    board = Site(core, 6)
    problem, _ = board.built()
    problem.count = 5
    fields, magnitudes = fields_of(problem, 6), [h.magnitude_uT for h in problem.heard]
    board.lib.pose_problem_negate(problem)
    assert np.array_equal(fields_of(problem, 6), np.vstack([-fields[:5], fields[5:]]))
    board.lib.pose_problem_negate(problem)
    assert np.array_equal(fields_of(problem, 6), fields)
    board.lib.pose_problem_scale(problem, board.ffi.new("float[4]", [2.0, -4.0, 0.5, 7.0]))
    assert np.array_equal(fields_of(problem, 6), np.vstack([fields[:5] * [2.0, -4.0, 0.5], fields[5:]]))
    assert [h.magnitude_uT for h in problem.heard] == magnitudes


@pytest.mark.parametrize("place", [0, 3, 4])
def test_a_beacon_left_out_and_put_back(core, place):
    board = Site(core)
    problem, rows = board.built()
    board.lib.pose_problem_leave_out(problem, place, True)
    left = [problem.heard[i].row for i in range(5)]
    assert problem.count == 4
    assert sorted(left[:4]) == [i for i in rows if i != place]
    assert left[4] == place
    board.lib.pose_problem_leave_out(problem, place, False)
    assert problem.count == 5
    assert [problem.heard[i].row for i in range(5)] == rows
