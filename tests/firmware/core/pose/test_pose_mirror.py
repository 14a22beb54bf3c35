"""Images of a pose: magpylib's fields there are the same."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.firmware.core.pose.fault_truth import field_T

NORMAL = np.array([2.0, -3.0, 6.0]) / 7.0
ACROSS = np.array([[6.0, 2.0, -1.0], [0.0, 2.0, 1.0]]) / [[np.sqrt(41.0)], [np.sqrt(5.0)]]
AMID = np.array([0.7, -0.4, 1.1])


def problem_of(core, centres, axes):
    problem = core[0].new("pose_problem_t *")
    problem.count = len(centres)
    behind = [[50.0, -60.0, 70.0]], [[0.6, 0.8, 0.0]]  # As one that was left out lies there.
    places, ways = np.vstack([centres, behind[0]]), np.vstack([axes, behind[1]])
    for heard, centre, axis in zip(problem.heard, places, ways, strict=False):
        heard.loop.centre_m, heard.loop.axis = centre.tolist(), axis.tolist()
    return problem


def plane_of(core, problem):
    """(whether there is one, point, normal, square of the extent); whatever stood there before."""
    ffi, lib = core
    point, normal, extent2 = ffi.new("float[4]", [7.0] * 4), ffi.new("float[4]", [7.0] * 4), ffi.new("float *", 7.0)
    flat = lib.pose_mirror_plane(problem, point, normal, extent2)
    assert (point[3], normal[3]) == (7.0, 7.0)
    return bool(flat), np.array(list(point))[:3], np.array(list(normal))[:3], extent2[0]


@pytest.mark.parametrize("signs", [[1, 1, 1, 1], [-1, 1, 1, -1], [1, -1, -1, -1]])
def test_the_plane_of_coils_of_either_sense(core, signs):
    """Its normal is on the side of the first one's axis; the extent is that of the farthest coil, the third."""
    places = np.array([[1.0, 0.2], [-1.0, 0.5], [0.3, -3.0], [-0.5, 2.0]])
    centres = AMID + (places - places.mean(axis=0)) @ ACROSS
    flat, point, normal, extent2 = plane_of(core, problem_of(core, centres, np.outer(signs, NORMAL)))
    assert flat
    assert normal == pytest.approx(signs[0] * NORMAL, abs=1e-6)
    assert point == pytest.approx(AMID, abs=1e-6)
    assert extent2 == pytest.approx(np.sum((centres - AMID) ** 2, axis=1).max(), rel=1e-5)


@pytest.mark.parametrize("extent_m", [0.4, 5.0])
@pytest.mark.parametrize(("height", "lean", "flat"), [(0.245, 0.245, True), (0.255, 0.0, False), (0.0, 0.255, False)])
def test_flat_is_a_quarter_of_any_extent(core, extent_m, height, lean, flat):
    """One coil alone is the farthest, the highest and the one that leans most, wherever it stands among four."""
    along = np.sqrt(1.0 - height**2)
    third = [-along / 3.0, 0.0, -height / 3.0]
    places = np.array([[along, 0.0, height], third, third, third]) + np.outer([0.0, 0.5, -0.5, 0.0], [0.0, 1.0, 0.0])
    tilts = np.outer([lean, -lean / 3.0, -lean / 3.0, -lean / 3.0], [1.0, 0.0])
    axes = tilts @ ACROSS + np.sqrt(1.0 - (tilts**2).sum(axis=1))[:, None] * NORMAL
    centres = AMID + extent_m * places @ np.vstack([ACROSS, NORMAL])
    for shift in range(4):
        problem = problem_of(core, np.roll(centres, shift, axis=0), np.roll(axes, shift, axis=0))
        assert plane_of(core, problem)[0] == flat


def test_the_normal_is_the_mean_of_all_axes(core):
    """Each turned to the side of the first one's."""
    tilts = np.array([[0.1, 0.0], [0.0, 0.2], [-0.05, -0.1]])
    axes = tilts @ ACROSS + np.sqrt(1.0 - (tilts**2).sum(axis=1))[:, None] * NORMAL
    mean = axes.sum(axis=0) / np.linalg.norm(axes.sum(axis=0))
    signs = np.array([[1.0], [-1.0], [1.0]])
    assert plane_of(core, problem_of(core, np.eye(3), signs * axes))[2] == pytest.approx(mean, abs=1e-6)


@pytest.mark.parametrize(("distance", "far"), [(3.99, False), (4.01, True)])
def test_an_image_by_the_point_is_tried_from_four_extents_on(core, distance, far):
    _, lib = core
    assert lib.pose_mirror_is_far([1.0, 2.0, 3.0], 0.25, [1.0, 2.0 + 0.3 * distance, 3.0 - 0.4 * distance]) == far


def test_an_axis_at_a_right_angle_to_the_first_counts_as_it_is(core):
    axes = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]])
    flat, _, normal, _ = plane_of(core, problem_of(core, np.eye(3), axes))
    assert not flat
    assert normal == pytest.approx(np.array([1.0, 1.0, -1.0]) / np.sqrt(3.0), abs=1e-6)


def image_of(core, reflect):
    """A pose and its image: positions and attitudes."""
    ffi, lib = core
    position, turn = AMID + np.array([0.5, 0.9, -1.3]), Rotation.from_rotvec([0.4, -0.9, 1.7])
    fit, image = ffi.new("pose_fit_t *"), ffi.new("pose_fit_t *")
    fit.position_m, fit.quaternion = position.tolist(), turn.as_quat().tolist()
    if reflect:
        lib.pose_mirror_reflect(AMID.tolist(), NORMAL.tolist(), fit, image)
    else:
        lib.pose_mirror_across(AMID.tolist(), fit, image)
        lib.pose_mirror_across(AMID.tolist(), fit, fit)  # The image may be the pose itself.
        assert (list(fit.position_m), list(fit.quaternion)) == (list(image.position_m), list(image.quaternion))
    there = Rotation.from_quat(list(image.quaternion))
    assert np.linalg.norm(list(image.quaternion)) == pytest.approx(1.0, abs=1e-6)
    return (position, turn), (np.array(list(image.position_m)), there)


@pytest.mark.parametrize("reflect", [True, False])
def test_the_fields_of_an_image_are_the_same(core, mixed_cube, reflect):
    """They are those of coils in the plane that point across it, or at the point, whatever way they point."""
    here, there = image_of(core, reflect)
    assert np.linalg.norm(here[0] - there[0]) > 0.5
    coils = [
        dataclasses.replace(mixed_cube.beacons[i], position_m=AMID + reflect * place @ ACROSS, axis=axis)
        for i, (place, axis) in enumerate(
            zip(
                np.array([[0.3, 0.2], [-1.0, 0.4], [0.1, -0.8]]),
                [NORMAL, -NORMAL, NORMAL] if reflect else [NORMAL, ACROSS[0], ACROSS[1]],
                strict=True,
            )
        )
    ]
    for coil in coils:
        fields = [turn.inv().apply(field_T(coil, place)) for place, turn in (here, there)]
        assert fields[1] == pytest.approx(fields[0], abs=1e-5 * np.linalg.norm(fields[0]))
