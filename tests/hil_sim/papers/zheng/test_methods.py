"""Positions and attitudes in the fields of dual-axis beacons, against magpylib's loops."""

import magpylib
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from goldfield.errors import UserError
from goldfield.site.rotating import DualAxisBeacon, RotatingSite
from hil_sim.papers.zheng.methods import map_file
from hil_sim.papers.zheng.methods.attitude import attitude_from_normals, printed_angles, yaw_only_attitude
from hil_sim.papers.zheng.methods.ellipse import locate_by_ellipse, position_from_axes
from hil_sim.papers.zheng.methods.field_ellipse import rms_strength
from hil_sim.papers.zheng.methods.fingerprint import FingerprintMap, LineLocator, nearest_neighbours
from hil_sim.papers.zheng.methods.lines import Lines, fit_lines
from hil_sim.papers.zheng.methods.trilateration import trilaterate

PLACES = np.array([[0.0, 0.0, 0.0], [6.20, 0.54, 0.0], [3.20, 4.28, 0.0]])


LEVEL = Rotation.identity()


def beacon(number, place, frame=LEVEL, radius=0.23):
    x, y, _ = frame.as_matrix().T
    return DualAxisBeacon(f"m{number}", np.array(place), x, y, 55.0, radius, 8.0, 25.0 + number)


FLOOR = RotatingSite(3e-9, tuple(beacon(number, place) for number, place in enumerate(PLACES)))


def fields(site, position, rotation=None):
    """Bc and Bs of magpylib's loops in the sensor's frame."""
    result = np.empty((len(position), len(site.beacons), 2, 3))
    for place, one in enumerate(site.beacons):
        for axis, normal in enumerate((one.x_axis, one.y_axis)):
            turn = Rotation.align_vectors(normal[None], [[0, 0, 1.0]])[0]
            loop = magpylib.current.Circle(
                current=one.turns * one.current_A, diameter=2 * one.radius_m, position=one.position_m, orientation=turn
            )
            result[:, place, axis] = loop.getB(position)
    return result if rotation is None else np.einsum("eji,enkj->enki", rotation, result)


def places(seed, count=60, heights=(0.4, 2.0)):
    rng = np.random.default_rng(seed)
    box = rng.uniform([0, 0, heights[0]], [6, 4.5, heights[1]], (4 * count, 3))
    clear = (np.linalg.norm(box[:, None] - PLACES, axis=2) > 0.92).all(axis=1)
    return box[clear][:count]


def angle_deg(rotation, truth):
    return np.degrees((Rotation.from_matrix(rotation) * Rotation.from_matrix(truth).inv()).magnitude())


def test_lines_are_found_again():
    lines = Lines(np.array([-2.9, -3.1]), np.array([9.3, 8.7]))
    range_m = np.random.default_rng(1).uniform(1, 8, (30, 2))
    strength = 1e-9 * np.exp(lines.slope * np.log(range_m) + lines.intercept)
    fitted = fit_lines(range_m, strength)
    np.testing.assert_allclose(fitted.slope, lines.slope, rtol=1e-9)
    np.testing.assert_allclose(fitted.intercept, lines.intercept, rtol=1e-9)
    np.testing.assert_allclose(lines.ranges(strength), range_m, rtol=1e-9)


@pytest.mark.parametrize("known_height", [False, True])
def test_trilateration_is_exact_with_exact_ranges(known_height):
    truth = places(2)
    range_m = np.linalg.norm(truth[:, None] - PLACES, axis=2)
    found = trilaterate(PLACES, range_m, z_m=truth[:, 2] if known_height else None)
    np.testing.assert_allclose(found, truth, atol=1e-5)


def test_trilateration_chooses_the_side_it_is_told():
    truth = places(3) * [1, 1, -1]
    range_m = np.linalg.norm(truth[:, None] - PLACES, axis=2)
    np.testing.assert_allclose(trilaterate(PLACES, range_m, np.array([0, 0, -1.0])), truth, atol=1e-5)


def grid_map(spacing=0.5):
    x, y = np.meshgrid(np.arange(0, 6.1, spacing), np.arange(0, 4.6, spacing), indexing="ij")
    grid = np.stack([x.ravel(), y.ravel(), np.full(x.size, 0.5)], axis=1)
    grid = grid[(np.linalg.norm(grid[:, None] - PLACES, axis=2) > 0.92).all(axis=1)]
    return FingerprintMap(("m0", "m1", "m2"), grid, rms_strength(fields(FLOOR, grid)))


def test_nearest_neighbours_know_a_fingerprint_and_weigh_by_distance():
    fingerprints = grid_map()
    for logarithmic in (False, True):
        found = nearest_neighbours(fingerprints, fingerprints.strength_T[10:20], logarithmic=logarithmic)
        np.testing.assert_allclose(found, fingerprints.position_m[10:20], atol=1e-6)
    small = FingerprintMap(("a",), np.arange(12.0).reshape(4, 3), np.array([[1.0], [2.0], [4.0], [8.0]]))
    weight = 1 / np.array([2.0, 1.0, 1.0, 5.0])
    np.testing.assert_allclose(
        nearest_neighbours(small, np.array([[3.0]]))[0], weight / weight.sum() @ small.position_m, rtol=1e-12
    )


def test_each_kind_of_line_is_better_than_the_coarser_one():
    fingerprints, truth = grid_map(), places(4, heights=(0.5, 0.5))
    locator = LineLocator(PLACES, fingerprints)
    strength = rms_strength(fields(FLOOR, truth))
    errors = [
        np.linalg.norm(locate(strength) - truth, axis=1).mean()
        for locate in (locator.by_global_lines, locator.by_region_lines, locator.by_local_lines)
    ]
    assert errors[0] < 0.1
    assert errors[1] < errors[0]
    assert errors[2] < errors[0]
    dense = LineLocator(PLACES, grid_map(0.1)).by_local_lines(strength)
    assert np.linalg.norm(dense - truth, axis=1).mean() < 0.4 * errors[2]


def test_local_lines_give_a_fingerprint_where_the_printed_equation_gives_20_m():
    fingerprints = grid_map()
    k, b = -3.0, 9.35
    same = fingerprints.strength_T[0, 0] * 1e9
    assert np.exp((np.log(same) - np.log(same) - b) / k) == pytest.approx(22.6, abs=0.1)  # eqn 28, ln F^j = ln F_i
    place, strength = fingerprints.position_m[30:31], fingerprints.strength_T[30:31]
    one = FingerprintMap(fingerprints.beacons, np.repeat(place, 4, axis=0), np.repeat(strength, 4, axis=0))
    found = LineLocator(PLACES, one).by_local_lines(one.strength_T[:1], slope=np.full(3, k))
    np.testing.assert_allclose(found, one.position_m[:1], atol=1e-5)


def test_the_printed_attitude_holds_for_yaw_and_fails_with_two_degrees_of_tilt():
    far = RotatingSite(3e-9, tuple(beacon(n, place, radius=0.001) for n, place in enumerate(PLACES)))  # dipoles
    truth = places(5, heights=(0.5, 0.5))
    yaw = Rotation.from_euler("z", np.linspace(-170, 170, len(truth))[:, None], degrees=True).as_matrix()
    angles = printed_angles(yaw_only_attitude(PLACES, truth, fields(far, truth, yaw)))
    np.testing.assert_allclose(angles, printed_angles(yaw.swapaxes(1, 2)), atol=1e-4)
    tilt = Rotation.from_euler("y", 2.0, degrees=True).as_matrix() @ yaw
    u, _, vt = np.linalg.svd(yaw_only_attitude(PLACES, truth, fields(far, truth, tilt)))
    u[:, :, 2] *= np.linalg.det(u @ vt)[:, None]
    assert 8.0 < angle_deg(u @ vt, tilt.swapaxes(1, 2)).mean() < 25.0  # 14 degrees for 2
    assert angle_deg(attitude_from_normals(far, truth, fields(far, truth, tilt)), tilt).max() < 0.01


def test_wahba_on_the_normals_holds_for_any_attitude():
    truth = places(6)
    rotation = Rotation.random(len(truth), rng=np.random.default_rng(6)).as_matrix()
    found = attitude_from_normals(FLOOR, truth, fields(FLOOR, truth, rotation))
    assert angle_deg(found, rotation).max() < 3.0  # the size of the coils is left out
    assert np.median(angle_deg(found, rotation)) < 0.3


WALLS = RotatingSite(
    3e-9,
    (
        beacon(0, [0, 0, 3.0], Rotation.from_rotvec([np.pi, 0, 0])),
        beacon(1, [6, 0, 3.0], Rotation.from_rotvec([2.8, 0.3, 0.1])),
        beacon(2, [3, 4.5, 2.8], Rotation.from_rotvec([0.2, -2.9, 0.4])),
    ),
)


@pytest.mark.parametrize("site", [FLOOR, WALLS], ids=["floor", "oblique on the ceiling"])
def test_all_components_give_the_pose_of_any_attitude_exactly(site):
    truth = places(7, heights=(0.5, 1.8))
    rotation = Rotation.random(len(truth), rng=np.random.default_rng(7)).as_matrix()
    fit = locate_by_ellipse(site, fields(site, truth, rotation), np.full(3, 1e-10))
    assert np.linalg.norm(fit.position_m - truth, axis=1).max() < 1e-6
    assert angle_deg(fit.rotation, rotation).max() < 1e-4
    assert fit.cost.max() < 1e-3


def test_the_semi_axes_alone_are_exact_for_dipoles():
    small = RotatingSite(3e-9, tuple(beacon(n, place, radius=0.001) for n, place in enumerate(PLACES)))
    truth = places(8)
    found = position_from_axes(small, fields(small, truth), np.full(3, 1e-13))
    assert np.linalg.norm(found - truth, axis=1).max() < 1e-3


def test_five_millimetres_and_one_degree_at_3_nT():
    rng = np.random.default_rng(9)
    truth = places(9, 200)
    azimuth, tilt = rng.uniform(0, 2 * np.pi, 200), np.radians(rng.uniform(0, 90, 200))
    axis = np.stack([np.cos(azimuth), np.sin(azimuth), 0 * azimuth], axis=1)
    rotation = Rotation.from_rotvec(tilt[:, None] * axis).as_matrix()
    sigma = 3e-9 * np.sqrt(2 / 200)  # of a component, after 200 samples of 3 nT
    noisy = fields(FLOOR, truth, rotation) + sigma * rng.normal(size=(200, 3, 2, 3))
    fit = locate_by_ellipse(FLOOR, noisy, np.full(3, sigma))
    assert np.linalg.norm(fit.position_m - truth, axis=1).mean() < 0.005
    assert angle_deg(fit.rotation, rotation).max() < 1.0
    # The fit's own uncertainty is the spread of its errors: sum of squares over 18 - 6 degrees of freedom.
    assert fit.cost.mean() == pytest.approx(12.0, abs=1.5)
    error = np.concatenate([fit.position_m - truth, np.zeros((200, 3))], axis=1)
    variance = np.linalg.inv(fit.information)[:, :3, :3].trace(axis1=1, axis2=2)
    assert (error**2).sum() / variance.sum() == pytest.approx(1.0, abs=0.3)


def test_a_map_survives_its_file(tmp_path):
    fingerprints = grid_map()
    map_file.save(fingerprints, tmp_path / "map.csv")
    loaded = map_file.load(tmp_path / "map.csv", fingerprints.beacons)
    np.testing.assert_array_equal(loaded.position_m, fingerprints.position_m)
    np.testing.assert_array_equal(loaded.strength_T, fingerprints.strength_T)
    turned = map_file.load(tmp_path / "map.csv", fingerprints.beacons[::-1])
    np.testing.assert_array_equal(turned.strength_T, fingerprints.strength_T[:, ::-1])


GOOD_MAP = [f"{p},{p}.0,{p * p}.0,0.5,{b},{1e-6 / (p + 1)!r}" for p in range(4) for b in ("m0", "m1")]


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (lambda rows: rows[:-1], r"map.csv:8: point 3 has no row for the beacon \"m1\""),
        (lambda rows: rows[:-2], "has 3 points; the algorithms need at least 4"),
        (lambda rows: [*rows, rows[-1]], r"map.csv:10: beacon \"m1\" comes twice at point 3"),
        (lambda rows: [*rows, "4,0,0,0,m9,1e-7"], 'map.csv:10: beacon "m9" is not in the site: it has m0, m1'),
        (lambda rows: [*rows[:-1], "3,9,9,9,m1,1e-7"], "map.csv:9: point 3 stands elsewhere"),
        (lambda rows: [*rows[:-1], rows[-1].rpartition(",")[0] + ",-1"], "map.csv:9: strength_T is -1; it must be"),
        (lambda rows: [*rows[:-1], rows[-1].rpartition(",")[0] + ",x"], 'map.csv:9: strength_T is "x", not a number'),
    ],
)
def test_a_wrong_map_is_told_with_its_line(tmp_path, edit, message):
    path = tmp_path / "map.csv"
    path.write_text("\n".join([",".join(map_file.COLUMNS), *edit(GOOD_MAP)]))
    with pytest.raises(UserError, match=message):
        map_file.load(path, ("m0", "m1"))
