"""States moved, told apart and let pass, against rotations of scipy."""

from dataclasses import fields

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.firmware.core.track.single import Kernel, some_state


def put(core, state):
    made = core[0].new("block_state_t *")
    Kernel.put_state(made, state)
    return made


def same(ours, truth):
    for field in fields(truth):
        np.testing.assert_allclose(getattr(ours, field.name), getattr(truth, field.name), rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("in_place", [False, True])
def test_a_state_is_moved_by_its_errors(core, in_place):
    rng = np.random.default_rng(3)
    state, errors = some_state(rng), rng.normal(size=18)
    before = put(core, state)
    after = before if in_place else core[0].new("block_state_t *")
    core[1].block_state_move(before, errors.tolist(), after)
    same(Kernel.state(after), state.moved(errors))


@pytest.mark.parametrize(
    ("angle", "least", "most"),
    [(0.0, 0.0, 0.0), (0.03, 0.0, 5e-6), (0.5, 0.0, 2e-6), (1.0, 1.5e-5, 2e-5), (2.0, 0.007, 0.008)],
)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_states_are_told_apart(core, angle, least, most, sign):
    """Angles are told as short as the header says; a quaternion's sign is that of chance."""
    rng = np.random.default_rng(4)
    errors, axis = rng.normal(size=18), np.array([0.6, -0.48, 0.64])
    errors[3:6] = angle * axis
    state = some_state(rng)
    one, other = put(core, state.moved(errors)), put(core, state)
    one.quaternion = (sign * np.array(list(one.quaternion))).tolist()
    told = core[0].new("float[18]")
    core[1].block_state_subtract(one, other, told)
    ours = np.array(list(told))
    rest = [*range(3), *range(6, 18)]
    np.testing.assert_allclose(ours[rest], errors[rest], rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(ours[3:6], (ours[3:6] @ axis) * axis, atol=4e-7)
    assert least * angle - 3e-7 <= angle - ours[3:6] @ axis <= most * angle + 3e-7


@pytest.mark.parametrize("seconds", [0.7, -0.2])
def test_time_passes(core, seconds):
    state, turn = some_state(np.random.default_rng(5)), core[0].new("float[3][3]")
    ours = put(core, state)
    core[1].block_state_advance(ours, seconds, turn)
    same(Kernel.state(ours), state.ahead(seconds))
    np.testing.assert_allclose(Kernel.matrix(turn), Rotation.from_rotvec(seconds * state.w).as_matrix(), atol=1e-6)
