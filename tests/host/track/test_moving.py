"""What linear processing makes of a moving sensor's samples; samples by magpylib and shift registers."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from goldfield.access import Separator
from goldfield.access.moving import Cycle, DriftSeparator, Reduction, sample_times, separation_weights
from goldfield.errors import UserError
from tests.bench.locate_trials import prigge_cube
from tests.bench.motion_trials import CHIPS, Room, gold_chips, straight

SITE = prigge_cube()
CODES = SITE.codes


def flight(speed=1.0, rate=1.0):
    attitude = Rotation.from_rotvec([0.3, -0.2, 1.1])
    return straight(
        np.array([0.9, 1.2, 0.8]), attitude, speed * np.array([0.6, 0.0, 0.8]), rate * np.array([0.0, 0.8, 0.6])
    )


def quiet_samples(speed=1.0, rate=1.0):
    return Room(SITE).samples(flight(speed, rate), 0.0, 0.0, np.random.default_rng(0))


def true_fields(flight, times):
    """Fields in the sensor's frame, shape (n, t, 3), read from noiseless samples of a world with a single coil."""
    position, rotation = flight.poses(times)
    return np.stack([rotation.inv().apply(coil.getB(position)) for coil in Room(SITE).coils])


def test_the_sample_times_end_with_the_cycle():
    times = sample_times(1023)
    assert times[-1] == pytest.approx(0.5)
    assert times[0] == pytest.approx(1 / 1023 - 0.5)


def test_ramp_and_curve_of_the_ambient_field_are_taken_out():
    rng = np.random.default_rng(1)
    fields = rng.normal(size=(8, 3)) * 1e-6
    times = sample_times(CHIPS)
    chips = np.stack([gold_chips(code) for code in CODES], axis=1)
    sweep = np.array([3e-5, -2e-5, 4e-5]) + np.outer(times, [5e-6, 1e-6, -4e-6]) + np.outer(times**2, [2e-7, 0, 1e-7])
    samples = chips @ fields + sweep
    separation = DriftSeparator(10, CODES, 2e-7).from_samples(samples)
    np.testing.assert_allclose(separation.field_T, fields, atol=1e-17)
    np.testing.assert_allclose(separation.offset_T, [3e-5, -2e-5, 4e-5], rtol=1e-9)
    plain = Separator(10, CODES, 2e-7).from_samples(samples)
    assert np.abs(plain.field_T - fields).max() > 1e-8
    np.testing.assert_allclose(separation.sigma_T, plain.sigma_T, rtol=5e-3)


def test_an_axis_with_a_missing_sample_is_not_measured():
    samples = quiet_samples()
    samples[5, 1] = np.nan
    separation = DriftSeparator(10, CODES, 2e-7).from_samples(samples)
    assert np.isnan(separation.field_T[:, 1]).all()
    assert np.isfinite(separation.field_T[:, [0, 2]]).all()
    assert np.isfinite(separation.sigma_T).all()


def test_dependent_codes_are_refused():
    with pytest.raises(UserError, match="cannot be separated"):
        separation_weights(5, range(33), 2)
    with pytest.raises(UserError, match="cannot be separated"):
        separation_weights(10, [3, 4, 3])


@pytest.mark.parametrize("drift", [0, 2])
def test_nodes_and_weights_give_the_separated_fields_of_a_moving_sensor(drift):
    """Least squares on the samples themselves, against the small matrix on the true fields at three moments."""
    cycle = Cycle(10, CODES, 3)
    moments = SITE.cycle_s * cycle.times
    fields = true_fields(flight(), moments)
    _, rotation = flight().poses(moments)
    ambient = rotation.inv().apply(np.array([2.0e-5, 0.0, -4.5e-5]))
    at_nodes = np.concatenate([fields, ambient[None]]).reshape(-1, 3)
    weights = separation_weights(10, CODES, drift)
    chips = np.stack([gold_chips(code) for code in CODES], axis=1)
    columns = np.hstack([chips, (2.0 * sample_times(CHIPS)[:, None]) ** np.arange(drift + 1)])
    separated = np.linalg.lstsq(columns, quiet_samples(), rcond=None)[0][: len(CODES)]
    np.testing.assert_allclose((cycle.seen(weights) @ at_nodes)[:-1], separated, atol=2e-11)
    still = np.abs(true_fields(flight(), np.zeros(1))[:, 0] - separated).max()
    assert still > 1e-9 * (20 if drift == 0 else 1)


def test_a_reduction_keeps_what_the_fields_do_and_makes_the_noise_white():
    cycle = Cycle(10, CODES, 7)
    reduction = Reduction(cycle, 2e-7)
    moments = SITE.cycle_s * cycle.times
    _, rotation = flight().poses(moments)
    ambient = rotation.inv().apply(np.array([2.0e-5, 0.0, -4.5e-5]))
    at_nodes = np.concatenate([true_fields(flight(), moments), ambient[None]]).reshape(-1, 3)
    numbers = reduction.numbers(quiet_samples())
    np.testing.assert_allclose(numbers, reduction.seen @ at_nodes, atol=3e-3)
    unit = reduction.numbers(np.eye(CHIPS))
    covariance = unit @ unit.T * 2e-7**2
    np.testing.assert_allclose(covariance, np.eye(len(numbers)), atol=1e-9)
