"""What the host computes of each block in C against the same in NumPy: equal to rounding, on the same numbers."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from goldfield.field import FieldModel
from goldfield.site import SensorSite, Survey
from goldfield.track.blocks import pair, rest, watch
from goldfield.track.blocks.bank import Estimate
from goldfield.track.blocks.consider import Considered
from goldfield.track.blocks.equations import SEPARABLE, BlockEquations
from goldfield.track.blocks.evenness import Limits, even_in_numpy
from goldfield.track.blocks.kernel import double
from goldfield.track.blocks.state import SIZE, Motion
from goldfield.track.blocks.update import reference
from goldfield.types import Block
from tests.bench.locate_trials import prigge_cube

NOISE_T = 2e-7
SITE = prigge_cube(NOISE_T)
MODEL = FieldModel(SITE.beacons)
EQUATIONS = BlockEquations(SITE)
UNITS = np.repeat([1e-2, 1e-2, 0.3, 0.5, 1e-6, 1e-6], 3)

pytestmark = pytest.mark.skipif(not double.ready(), reason="the library was not built: no compiler")


def motion_of(rng):
    return Motion(
        np.array([0.9, 1.2, 0.7]) + 0.2 * rng.normal(size=3),
        Rotation.random(rng=rng).as_matrix(),
        *(scale * rng.normal(size=3) for scale in (1.0, 2.0)),
        np.array([2e-5, 5e-6, -4e-5]),
        1e-6 * rng.normal(size=3),
    )


def covariance_of(rng):
    root = rng.normal(size=(SIZE, SIZE + 4)) * UNITS[:, None]
    return root @ root.T / SIZE


def forms_of(rng, count):
    """Blocks of noise that follow one another."""
    first = int(rng.integers(1023))
    places = [(first + 31 * number) % 1023 for number in range(count)]
    return [
        EQUATIONS.form(Block(0, place, 0.0, 31, 3e-5 + NOISE_T * rng.normal(size=(31, 3)), True)) for place in places
    ]


def in_numpy(monkeypatch):
    monkeypatch.setattr(double, "ready", lambda: False)


@pytest.mark.parametrize("seed", range(4))
def test_what_a_motion_leaves_of_a_block(seed, monkeypatch):
    rng = np.random.default_rng([31, seed])
    known, (form,) = Estimate(motion_of(rng), covariance_of(rng)), forms_of(rng, 1)
    ours = rest.left_by(MODEL, form, known, NOISE_T)
    in_numpy(monkeypatch)
    theirs = rest.left_by(MODEL, form, known, NOISE_T)
    for name in ("field_T", "slope_T_s", "jacobian"):
        found, expected = getattr(ours.around, name), getattr(theirs.around, name)
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max())
    np.testing.assert_allclose(ours.form.sums_T, theirs.form.sums_T, atol=1e-11 * np.abs(theirs.form.sums_T).max())
    np.testing.assert_allclose(ours.blur, theirs.blur, rtol=1e-11)
    np.testing.assert_allclose(ours.ambient_T, theirs.ambient_T, rtol=1e-11)


@pytest.mark.parametrize("out", [[], [2], [0, 5]])
@pytest.mark.parametrize("count", [4, 33])
def test_how_far_off_blocks_are(count, out, monkeypatch):
    rng = np.random.default_rng([32, count, len(out)])
    rests = [form.without(np.array(out, dtype=np.intp)) for form in forms_of(rng, count)]
    blurs = list(rng.uniform(0.0, 3.0, size=(count, len(MODEL))))
    cost, freedom = rest.cost_of(rests, blurs)
    in_numpy(monkeypatch)
    expected, mean = rest.cost_of(rests, blurs)
    assert cost == pytest.approx(expected, rel=1e-10)
    assert freedom == mean == 3 * (8 - len(out))


def test_blocks_that_do_not_tell_two_beacons_apart_are_left_to_numpy():
    rng = np.random.default_rng(33)
    forms = forms_of(rng, 4)
    alike = [replace(form, gram=form.gram.copy()) for form in forms]
    for form in alike:  # the second beacon sends what the first does
        form.gram[1], form.gram[:, 1] = form.gram[0], form.gram[:, 0]
        form.gram[1, 1] = form.gram[0, 0]
    sums, blur = np.array([form.sums_T for form in alike]), np.zeros(8)
    assert double.cost(np.array([form.gram for form in alike]), sums, blur, alike[0].weight, SEPARABLE) is None
    _, freedom = rest.cost_of(alike, [blur])
    assert freedom == 3 * 6
    for form in alike:
        form.gram[1, 1] += 0.2 * form.gram[0, 0]  # now it is told apart
    assert double.cost(np.array([form.gram for form in alike]), sums, blur, alike[0].weight, SEPARABLE) is not None


def windows_of(rng, out=(), size=0.0):
    """The sums of four windows, with fields of a symmetric distortion beside the noise."""
    watched = watch.Watch(Considered(SITE, EQUATIONS.cycle))
    motion = motion_of(rng)
    around = reference(MODEL, motion)
    for form in forms_of(rng, 32):
        bent = np.vstack([size * around.field_T[:-1] @ motion.rotation @ np.diag([1.0, -2.0, 1.0]), np.zeros(3)])
        seen = form.with_sums(form.sums_T + form.gram @ bent)
        watched.add(seen, rng.uniform(0.0, 2.0, size=8), around, np.array(out, dtype=np.intp))
    return watch._sums(watched._groups), around


@pytest.mark.parametrize("errors", [False, True])
@pytest.mark.parametrize("size", [0.0, 0.05, 0.3])
@pytest.mark.parametrize("out", [(), (2,)])
def test_the_sums_of_windows(errors, size, out):
    rng = np.random.default_rng([34, int(errors), int(100 * size), len(out)])
    sums, around = windows_of(rng, out, size)
    surveyed = replace(
        SITE,
        beacons=tuple(replace(beacon, survey=Survey(0.003, 0.005, 0.01)) for beacon in SITE.beacons),
        sensor=SensorSite(NOISE_T, gain_sd=0.002, axis_sd_rad=0.003),
    )
    effects = Considered(surveyed, EQUATIONS.cycle).effects(around.motion) if errors else None
    heard = np.array([row for row in range(8) if row not in out])
    given = sums, (heard, np.arange(3)), around, effects, NOISE_T**2 * np.eye(3)
    ours, theirs = watch._in_c(*given), watch.found_in_numpy(*given)
    assert len(ours) == len(theirs) == 4
    assert [one.alarm for one in ours] == [one.alarm for one in theirs]
    np.testing.assert_allclose([one.share for one in ours], [one.share for one in theirs], rtol=1e-6, atol=1e-9)
    if size == 0.3 and not errors:
        assert all(one.alarm for one in ours)


def test_windows_of_two_axes_and_those_that_tell_nothing():
    sums, around = windows_of(np.random.default_rng(35), size=0.1)
    for rows, axes in ((np.arange(8), [0, 1]), (np.arange(4), [0, 2]), (np.arange(3), [1, 2])):
        variance = NOISE_T**2 * (np.eye(len(axes)) + 0.1)
        given = (rows, np.array(axes)), around, None, variance
        ours, theirs = watch._in_c(sums, *given), watch.found_in_numpy(sums, *given)
        assert [one.alarm for one in ours] == [one.alarm for one in theirs]
        np.testing.assert_allclose([one.share for one in ours], [one.share for one in theirs], rtol=1e-6, atol=1e-9)
    broken = sums.copy()
    broken[1, :64] = 0.0
    broken[1, 64:72] = 0.0
    all_of_it = (np.arange(8), np.arange(3)), around, None, NOISE_T**2 * np.eye(3)
    assert len(watch._in_c(broken, *all_of_it)) == len(watch.found_in_numpy(broken, *all_of_it)) == 3


@pytest.mark.parametrize("seed", range(6))
def test_two_estimates_of_one_motion(seed):
    rng = np.random.default_rng([36, seed])
    motion, covariance = motion_of(rng), covariance_of(rng)
    known = Estimate(motion, covariance)
    alone = Estimate(motion.moved(UNITS * rng.normal(size=SIZE)), 1.5 * covariance + 0.1 * covariance_of(rng))
    ours, theirs = pair._apart(known, alone), pair.apart_in_numpy(known, alone)
    np.testing.assert_allclose(ours.error / UNITS, theirs.error / UNITS, rtol=1e-10, atol=1e-10)
    assert ours.distance2 == pytest.approx(theirs.distance2, rel=1e-9)
    for weight in (0.03, 0.5, 1.0):
        both, expected = pair._between(ours, weight), pair.between_in_numpy(theirs, weight)
        np.testing.assert_allclose(both.motion.minus(expected.motion) / UNITS, 0.0, atol=1e-10)
        scale = np.outer(UNITS, UNITS)
        np.testing.assert_allclose(both.covariance / scale, expected.covariance / scale, rtol=1e-10, atol=1e-10)


def test_estimates_that_are_far_apart_and_one_that_is_none():
    rng = np.random.default_rng(37)
    motion, covariance = motion_of(rng), covariance_of(rng)
    known = Estimate(motion, covariance)
    turned = Estimate(motion.moved(np.repeat([0.3, 0.7, 1.0, 1.0, 0.0, 0.0], 3)), covariance)
    ours, theirs = pair._apart(known, turned), pair.apart_in_numpy(known, turned)
    np.testing.assert_allclose(ours.error, theirs.error, rtol=1e-10)
    both, expected = pair._between(ours, 0.5), pair.between_in_numpy(theirs, 0.5)
    np.testing.assert_allclose(both.motion.rotation, expected.motion.rotation, atol=1e-9)
    with pytest.raises(np.linalg.LinAlgError):
        pair._apart(known, Estimate(motion, -covariance))


def test_changes_of_the_ambient_field():
    rng = np.random.default_rng(38)
    limits, motion, covariance = Limits(2e-6, 3e-6), motion_of(rng), 1e-2 * covariance_of(rng)
    ours, theirs = np.full(double.USUAL, np.nan), np.full(double.USUAL, np.nan)
    changed = 0
    for number in range(200):
        motion = motion.after(0.003).moved(0.03 * UNITS * rng.normal(size=SIZE))
        seen_T = motion.rotation.T @ np.array([2e-5, 5e-6, -4e-5]) + (6e-6 if 80 < number < 120 else 5e-7) * rng.normal(
            size=3
        )
        spread = covariance * (4.0 if number < 40 else 1.0)
        told = double.even(limits, motion, spread, seen_T, 0.003, ours)
        expected = even_in_numpy(limits, motion, spread, seen_T, 0.003, theirs)
        np.testing.assert_allclose(told, expected, rtol=1e-8, atol=1e-15)
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-18)
        changed += told[0] > 0.0
    assert 5 < changed < 100


def test_no_field_at_all_says_nothing():
    nothing, usual = np.zeros(3), np.full(double.USUAL, np.nan)
    motion = Motion(nothing, np.eye(3), nothing, nothing, nothing, nothing)
    for step in (double.even, even_in_numpy):
        usual[0] = np.nan
        assert step(Limits(2e-6, 3e-6), motion, np.zeros((SIZE, SIZE)), nothing, 0.003, usual) is None
        assert (usual == np.concatenate([nothing, np.eye(3).ravel(), np.zeros(9)])).all()
