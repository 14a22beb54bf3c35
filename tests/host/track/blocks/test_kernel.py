"""The bank in C against the bank in NumPy: the same blocks into both."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from goldfield import site as sites
from goldfield.access.gold import code_matrix
from goldfield.errors import UserError
from goldfield.field import FieldModel
from goldfield.track.blocks import kernel
from goldfield.track.blocks.bank import Bank, Start
from goldfield.track.blocks.equations import NormalForm, ramp_of
from goldfield.track.blocks.kernel import double
from hil_sim.clib import ROOT

CHIP_S, CHIPS, NOISE_T = 0.1 / 1023, 31, 2e-8
BLOCK_S = CHIPS * CHIP_S

pytestmark = pytest.mark.skipif(not double.ready(), reason="the library was not built: no compiler")


@pytest.fixture(scope="module")
def model():
    return FieldModel(sites.load(ROOT / "host/sites/prigge8.toml").beacons)


def pose(time_s):
    turn = 2.0 * np.pi * np.array([time_s, 1.1 * time_s + 1.0, 0.9 * time_s + 2.0])
    return np.array([1.0, 1.1, 0.9]) + 0.16 * np.sin(turn), Rotation.from_rotvec(0.3 * np.cos(turn)).as_matrix()


def blocks(model, count, seed=1):
    """Blocks of noisy samples of a hand's motion, from the one at 1 BLOCK_S on."""
    rng, ambient = np.random.default_rng(seed), np.array([2e-5, 5e-6, -4e-5])
    codes = code_matrix(10, range(2, 2 + len(model))).astype(float)
    tau = CHIP_S * (np.arange(CHIPS) - 15)
    for number in range(1, count + 1):
        columns = np.column_stack([codes[(31 * number + np.arange(CHIPS)) % 1023], np.ones(CHIPS)])
        samples = []
        for t, row in zip(tau, columns, strict=True):
            position, rotation = pose(number * BLOCK_S + t)
            field, _ = model.evaluate(position)
            samples.append(rotation.T @ (field @ row[:-1] + ambient))
        data = np.array(samples) + rng.normal(0.0, NOISE_T, (CHIPS, 3))
        gram, moment = columns.T @ columns, columns.T @ (tau[:, None] * columns)
        yield NormalForm(
            columns.T @ data,
            gram,
            moment,
            ramp_of(gram, moment),
            np.eye(3) / NOISE_T**2,
            15 * CHIP_S,
            np.ones(3, dtype=bool),
        )


def started(*banks):
    position, rotation = pose(0.0)
    ambient = np.array([2e-5, 5e-6, -4e-5])
    turned = Rotation.from_rotvec([0.004, -0.003, 0.002]).as_matrix() @ rotation
    for bank in banks:
        bank.start(Start(position + 0.003, turned, 4e-5 * np.eye(6), ambient, 25e-12 * np.eye(3)))
    return banks


def test_the_poses_are_those_of_numpy(model):
    numpy, c = started(Bank(model), kernel.CBank(model))
    worst = 0.0
    for number, form in enumerate(blocks(model, 120)):
        if number == 60:  # an impulse, which all filters refuse
            form = replace(form, sums_T=form.sums_T + 1e-3)
        taken = numpy.update(form, BLOCK_S)
        assert c.update(form, BLOCK_S) == taken == (number != 60)
        assert c.refused == numpy.refused
        for seconds in (0.0, 15 * CHIP_S):
            ours, theirs = c.output(seconds), numpy.output(seconds)
            sd = np.sqrt(np.diag(theirs.covariance))
            worst = max(worst, np.abs(ours.motion.minus(theirs.motion) / sd).max())
            assert np.abs((ours.covariance - theirs.covariance) / np.outer(sd, sd)).max() < 0.03
        np.testing.assert_allclose(c.agility, numpy.agility, rtol=0.03)
        assert c.mismatch == pytest.approx(numpy.mismatch, abs=0.3)
    print(f"largest difference of the states: {worst:.4f} standard deviations")
    assert worst < 0.03
    position, _ = pose(120 * BLOCK_S)
    assert np.linalg.norm(c.output().motion.position_m - position) < 0.015


def test_time_without_a_block(model):
    numpy, c = started(Bank(model), kernel.CBank(model))
    forms = list(blocks(model, 20))
    for form in forms[:10]:
        assert numpy.update(form, BLOCK_S) == c.update(form, BLOCK_S) is True
    for bank in (numpy, c):
        bank.predict(3 * BLOCK_S)
        assert bank.update(forms[13], BLOCK_S)
    sd = np.sqrt(np.diag(numpy.output().covariance))
    assert np.abs(c.output().motion.minus(numpy.output().motion) / sd).max() < 0.03


def test_an_axis_without_data_is_passed_over(model):
    (c,) = started(kernel.CBank(model))
    first, second = blocks(model, 2)
    assert c.update(first, BLOCK_S)
    known = c.output(BLOCK_S)
    assert not c.update(replace(second, weight=np.diag([1.0, 1.0, 0.0]) / NOISE_T**2), BLOCK_S)
    assert c.refused == 0
    np.testing.assert_allclose(c.output().motion.position_m, known.motion.position_m, atol=1e-5)
    assert kernel.noise_of(second) == pytest.approx(NOISE_T)
    assert kernel.noise_of(replace(second, weight=np.diag([1.0, 1.0, 1.1]) / NOISE_T**2)) is None


def test_other_coils_are_refused(model):
    assert kernel.serves(model)
    beacons = sites.load(ROOT / "host/sites/prigge8.toml").beacons
    many = FieldModel(tuple(replace(beacons[i % 8], id=f"b{i}") for i in range(33)))
    assert kernel.serves(FieldModel(tuple(replace(beacons[i % 8], id=f"b{i}") for i in range(32))))
    assert not kernel.serves(many)
    with pytest.raises(UserError, match="1 to 32 circular coils without metal"):
        kernel.CBank(many)


def test_numpy_goes_on_with_a_track(model):
    """An axis of the sensor saturates: the rest of the track is that of NumPy, without a jump."""
    numpy, c = started(Bank(model), kernel.CBank(model))
    for number, form in enumerate(blocks(model, 40)):
        if number == 20:
            c = c.in_numpy()
        if number >= 20:
            form = replace(
                form,
                sums_T=form.sums_T * [1.0, 1.0, 0.0],
                weight=np.diag([1.0, 1.0, 0.0]) / NOISE_T**2,
                axes=np.array([True, True, False]),
            )
        assert numpy.update(form, BLOCK_S)
        assert c.update(form, BLOCK_S)
    position, _ = pose(40 * BLOCK_S)
    assert np.linalg.norm(c.output().motion.position_m - numpy.output().motion.position_m) < 0.003
    assert np.linalg.norm(c.output().motion.position_m - position) < 0.015
    assert c.mismatch == pytest.approx(numpy.mismatch, abs=10.0)
