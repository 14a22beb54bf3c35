"""The normal form of blocks, against sums written down here and codes from shift registers."""

from dataclasses import replace

import numpy as np
import pytest

from goldfield.errors import UserError
from goldfield.site import SensorSite
from goldfield.site.drive import NO_CODE, Code, Drive
from goldfield.track.blocks.equations import BlockEquations, NormalForm, separated
from goldfield.types import Block
from tests.bench.locate_trials import prigge_cube
from tests.bench.motion_trials import Room

SITE = prigge_cube(2e-7)
CODES = Room(SITE).codes.astype(float)
ONES = np.ones((1023, 1))
CHIP, CHIPS = 1010, 31
PLACE = (CHIP + np.arange(CHIPS)) % 1023
TAU = (np.arange(CHIPS) - 15.0) * SITE.chip_period_s
RNG = np.random.default_rng(1)
FIELD, SLOPE = 1e-6 * RNG.normal(size=(9, 3)), 1e-4 * RNG.normal(size=(9, 3))


def risen(tau_chips):
    """The currents of coils that follow slowly, chip by chip, from a cycle before on."""
    e, current, rows = np.exp(-1.0 / tau_chips), CODES[0], []
    for drive in np.concatenate([CODES, CODES]):
        current = e * current + (1.0 - e) * drive
        rows.append(current)
    return np.array(rows)[1023:]


def block(data, sampled):
    return Block(0, CHIP, 1.0, CHIPS, data, sampled)


def samples(templates):
    columns = np.hstack([templates, ONES])[PLACE]
    return columns @ FIELD + TAU[:, None] * (columns @ SLOPE)


SLOW = replace(SITE, beacons=tuple(replace(b, drive=Drive(tau_s=0.8 * SITE.chip_period_s)) for b in SITE.beacons))


def test_samples_are_summed_on_the_codes_across_the_end_of_a_cycle():
    form = BlockEquations(SITE).form(block(samples(CODES), True))
    columns = np.hstack([CODES, ONES])[PLACE]
    np.testing.assert_allclose(form.gram, columns.T @ columns, atol=1e-12)
    np.testing.assert_allclose(form.moment, columns.T @ (TAU[:, None] * columns), atol=1e-15)
    np.testing.assert_allclose(form.sums_T, columns.T @ samples(CODES), atol=1e-18)
    np.testing.assert_allclose(form.weight, np.eye(3) / 2e-7**2)
    assert form.end_s == pytest.approx(15 * SITE.chip_period_s)


def test_sums_from_the_wire_are_the_same_as_samples():
    equations = BlockEquations(SITE)
    of_samples = equations.form(block(samples(CODES), True))
    of_sums = equations.form(block(np.hstack([CODES, ONES])[PLACE].T @ samples(CODES), False))
    for name in ("sums_T", "gram", "moment", "weight"):
        whole = getattr(of_samples, name)
        np.testing.assert_allclose(getattr(of_sums, name), whole, rtol=1e-9, atol=1e-9 * np.abs(whole).max())


def test_sums_of_slow_coils_hold_fields_slopes_and_noise_as_the_form_says():
    equations, templates, codes = BlockEquations(SLOW), risen(0.8), np.hstack([CODES, ONES])[PLACE]
    form = equations.form(block(codes.T @ samples(templates), False))
    np.testing.assert_allclose(
        form.sums_T, form.gram @ FIELD + form.moment @ SLOPE, atol=1e-6 * np.abs(form.sums_T).max()
    )
    # Each sample's share of the sums: the covariance of white noise must be the gram matrix
    shares = [equations.form(block(np.repeat(codes[[t]].T, 3, axis=1), False)).sums_T[:, 0] for t in range(CHIPS)]
    np.testing.assert_allclose(np.transpose(shares) @ np.array(shares), form.gram, atol=1e-9)
    assert np.abs(form.gram - equations.form(block(samples(templates), True)).gram).max() > 1.0


def test_samples_of_slow_coils_are_summed_on_what_they_show():
    form, templates = BlockEquations(SLOW).form(block(samples(risen(0.8)), True)), np.hstack([risen(0.8), ONES])[PLACE]
    np.testing.assert_allclose(form.gram, templates.T @ templates, atol=1e-9)


def test_missing_samples_and_axes_are_left_out():
    data = samples(CODES)
    data[3, 1], data[:, 2] = np.nan, np.nan
    form = BlockEquations(SITE).form(block(data, True))
    left = np.delete(np.hstack([CODES, ONES])[PLACE], 3, axis=0)
    np.testing.assert_allclose(form.gram, left.T @ left, atol=1e-12)
    np.testing.assert_allclose(form.sums_T[:, :2], left.T @ np.delete(data, 3, axis=0)[:, :2], atol=1e-18)
    assert form.weight[2].tolist() == [0.0, 0.0, 0.0]
    assert not form.sums_T[:, 2].any()
    assert form.axes.tolist() == [True, True, False]
    assert BlockEquations(SITE).form(block(np.full((31, 3), np.nan), True)) is None


def test_axes_that_differ_give_components_and_their_weight():
    axes, ratio = np.array([[1.0, 0.1, 0.0], [0.0, -0.9, 0.2], [0.05, 0.0, 1.1]]), np.array([1.0, 0.5, 1.3])
    site = replace(SITE, sensor=SensorSite(2e-7, axes=axes, noise_ratio=ratio))
    equations = BlockEquations(site)
    form = equations.form(block(samples(CODES) @ axes.T, True))
    np.testing.assert_allclose(form.sums_T, BlockEquations(SITE).form(block(samples(CODES), True)).sums_T, atol=1e-15)
    inverse = np.linalg.inv(axes)
    np.testing.assert_allclose(np.linalg.inv(form.weight), (inverse * (2e-7 * ratio) ** 2) @ inverse.T, rtol=1e-9)
    np.testing.assert_allclose(equations.readings(FIELD, form.axes), FIELD @ axes.T)


def test_a_beacon_left_out_is_one_whose_field_may_be_anything():
    form = BlockEquations(SITE).form(block(samples(CODES), True))
    left = form.without(np.array([2, 5]))
    assert not left.gram[[2, 5]].any()
    assert not left.sums_T[[2, 5]].any()
    wild = FIELD.copy()
    wild[[2, 5]] += 1e-3
    other = NormalForm(
        form.sums_T + form.gram @ (wild - FIELD), form.gram, form.moment, form.ramp, form.weight, 0.0, form.axes
    )
    np.testing.assert_allclose(other.without(np.array([2, 5])).sums_T, left.sums_T, atol=1e-15)
    kept = np.delete(np.arange(9), [2, 5])
    whole = np.linalg.inv(form.gram)[np.ix_(kept, kept)]
    np.testing.assert_allclose(np.linalg.inv(left.gram[np.ix_(kept, kept)]), whole, rtol=1e-9, atol=1e-12)


def test_blocks_are_separated_beside_an_ambient_field_of_each():
    equations, forms = BlockEquations(SITE), []
    for chip in (0, 31, 62):
        columns = np.hstack([CODES, ONES])[chip : chip + 31]
        field = FIELD.copy()
        field[8] = 1e-5 * chip
        forms.append(equations.form(Block(0, chip, 1.0, 31, columns @ field, True)))
    found = separated(forms)
    np.testing.assert_allclose(found.field_T, FIELD[:8], atol=1e-15)
    assert (found.deviation > 1.0 / np.sqrt(93.0)).all()
    assert (found.deviation < 1.3 / np.sqrt(93.0)).all()


def test_beacons_that_a_block_does_not_tell_apart_have_no_field():
    slots = [Drive(slot=k) for k in range(8)]
    beacons = tuple(replace(b, drive=d, code=NO_CODE) for b, d in zip(SITE.beacons, slots, strict=True))
    site = replace(SITE, beacons=beacons, access="tdma", slots=9)
    for chip, heard in ((890, [7]), (100, []), (10, [])):  # slot 7 and a quiet one; two that add up to a constant; one
        found = separated([BlockEquations(site).form(Block(0, chip, 1.0, 31, np.ones((31, 3)), True))])
        assert np.flatnonzero(np.isfinite(found.field_T).all(axis=1)).tolist() == heard


def test_sites_and_blocks_that_cannot_be_followed_are_refused_in_words():
    lever = replace(SITE, sensor=replace(SITE.sensor, lever_m=np.eye(3) * 0.01))
    with pytest.raises(UserError, match=r"lever_m: locate whole cycles"):
        BlockEquations(lever)
    tone = replace(SITE.beacons[0], drive=Drive(frequency_Hz=50.0), code=NO_CODE)
    with pytest.raises(UserError, match="phases of its tones are unknown"):
        BlockEquations(replace(SITE, beacons=(tone,), access="fdma"))
    superposed = replace(SITE.beacons[0], code=NO_CODE, drive=Drive(codes=(Code(2, 10), Code(3, 10))))
    with pytest.raises(UserError, match='beacon "b0" of the site "trial" has no plain code'):
        BlockEquations(replace(SITE, beacons=(superposed, *SITE.beacons[1:]))).form(block(np.zeros((9, 3)), False))
    with pytest.raises(UserError, match=r"shape \(30, 3\): 31 chips need \(31, 3\), samples"):
        BlockEquations(SITE).form(block(np.zeros((30, 3)), True))
    with pytest.raises(UserError, match="chip= of Block is 1023: the cycle has the chips 0 to 1022"):
        BlockEquations(SITE).form(Block(0, 1023, 1.0, 31, np.zeros((31, 3)), True))


def test_beacons_alone_are_what_the_sums_tell_beside_any_line_of_the_ambient_field():
    """Samples from which has been taken what a line makes of their sums: its part that the columns span."""
    form = BlockEquations(SITE).form(block(samples(CODES), True)).beacons_alone
    columns = CODES[PLACE]
    spanned, _ = np.linalg.qr(np.column_stack([columns, np.ones(CHIPS)]))
    line, _ = np.linalg.qr(np.column_stack([np.ones(CHIPS), spanned @ (spanned.T @ TAU)]))
    rest = columns - line @ (line.T @ columns)
    np.testing.assert_allclose(form.gram[:-1, :-1], rest.T @ rest, atol=1e-9)
    np.testing.assert_allclose(form.moment[:-1, :-1], rest.T @ (TAU[:, None] * columns), atol=1e-12)
    np.testing.assert_allclose(form.sums_T[:-1], rest.T @ samples(CODES), atol=1e-16)
    for zeros in (form.gram[-1], form.moment[:, -1], form.sums_T[-1], form.ramp):
        assert not zeros.any()


def test_what_is_kept_of_beacons_alone_goes_with_the_matrices_that_it_is_of():
    """A site's block that comes again takes what is known of its chips; one without a beacon is another."""
    equations = BlockEquations(SITE)
    for form in (equations.form(block(samples(CODES), True)), equations.form(block(2.0 * samples(CODES), True))):
        for changed in (form, form.without(np.array([1])), form.scaled(np.full(CODES.shape[1], 0.5))):
            one, other = changed.beacons_alone, replace(changed, alone=None).beacons_alone
            for name in ("gram", "moment", "sums_T"):
                assert getattr(one, name).tolist() == getattr(other, name).tolist()


def test_beacons_alone_do_not_feel_the_ambient_field():
    drifting = samples(CODES) + np.outer(1.0 + 300.0 * TAU, [2e-5, -5e-6, 4e-5])
    one, other = (BlockEquations(SITE).form(block(data, True)).beacons_alone for data in (samples(CODES), drifting))
    np.testing.assert_allclose(one.sums_T, other.sums_T, atol=1e-17)


def test_a_block_of_one_chip_tells_nothing_beside_the_ambient_field():
    data = np.hstack([CODES, ONES])[:1] @ FIELD
    form = BlockEquations(SITE).form(Block(0, 0, 1.0, 1, data, True)).beacons_alone
    np.testing.assert_allclose(form.gram, 0.0, atol=1e-12)
    np.testing.assert_allclose(form.sums_T, 0.0, atol=1e-18)
