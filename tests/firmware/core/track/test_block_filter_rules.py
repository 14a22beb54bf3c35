"""The rules of the bank by themselves, both sides of each: what begins, follows, mixes, is refused and is kept."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from tests.firmware.core.track import dense
from tests.firmware.core.track.single import BLOCK_S, Bits, Kernel, cube, some_state
from tests.firmware.core.track.test_block_kalman import SD, some_covariance

MIX_S = float(np.float32(0.012))


def slot(agility):
    """Where the filter with an agility is: the greatest is the last, the others have every third of them."""
    return 3 if agility == 5 else agility % 3


def some_models(rng, least, probabilities):
    """Four filters that differ by fractions of their deviations, with agilities from the least on and the greatest."""
    state, covariance = some_state(rng), some_covariance(rng)
    models = []
    for agility, probability in zip((least, least + 1, least + 2, 5), probabilities, strict=True):
        own = state.moved(0.3 * SD * rng.normal(size=18))
        models.append(dense.Model(own, covariance * (1.0 + 0.3 * agility), probability, agility))
    return models


class Bank:
    """A bank that is set to any models."""

    def __init__(self, core, models, count=8, noise=0.02):
        self.ffi, self.lib = core
        self.coils, self.noise = cube(count), noise
        self.kernel = Kernel(core, self.coils, noise)
        self.filter, self.models = self.kernel.filter, models
        for model in models:
            one = self.filter.filters[slot(model.agility)]
            self.kernel.put(self.ffi.addressof(one), model.state, model.covariance, dense.AGILITIES[model.agility])
            one.probability = model.probability
        self.filter.best = slot(dense.likeliest(models).agility)
        self.filter.least = models[0].agility
        self.filter.refused = 0

    def check(self, models):
        """Compare all filters with models. The turn rate's part of the attitude's covariance is to first order."""
        for model in models:
            one = self.filter.filters[slot(model.agility)]
            sd = np.sqrt(np.diag(model.covariance))
            agility = dense.AGILITIES[model.agility]
            assert (one.acceleration2, one.turn2) == pytest.approx(np.square(agility), rel=1e-6)
            assert one.probability == pytest.approx(model.probability, abs=1e-5)
            assert np.abs(self.kernel.state(one.state).minus(model.state) / sd).max() < 1e-3
            assert np.abs((self.kernel.covariance(one) - model.covariance) / np.outer(sd, sd)).max() < 0.01


@pytest.mark.parametrize("least", [0, 1, 2])
@pytest.mark.parametrize(
    "probabilities",
    [
        (0.3, 0.29, 0.3, 0.11),  # Above 0.4 of much agility, by the two of them ...
        (0.3, 0.31, 0.3, 0.09),  # ... and below.
        (0.3, 0.3, 0.4, 0.0),
        (0.2, 0.2, 0.1, 0.5),
        (0.51, 0.2, 0.2, 0.09),  # Above 0.5 of the least ...
        (0.49, 0.22, 0.2, 0.09),  # ... and below.
        (0.5, 0.2, 0.2, 0.1),
    ],
)
def test_the_filters_follow_the_likeliest_and_mix(core, least, probabilities):
    models = some_models(np.random.default_rng(least), least, probabilities)
    bank = Bank(core, models)
    bank.lib.block_filter_predict(bank.filter, MIX_S)
    mixed = dense.mixed(models, MIX_S)
    bank.check(mixed_and_moved(mixed))
    assert bank.filter.least == min(model.agility for model in mixed)
    assert bank.filter.unmixed_s == 0.0


def mixed_and_moved(models, seconds=MIX_S):
    """Return the filters after mixing later, as they predict themselves."""
    later = []
    for model in models:
        state, covariance = dense.predicted(model.state, model.covariance, dense.AGILITIES[model.agility], seconds)
        later.append(replace(model, state=state, covariance=covariance))
    return later


def test_filters_are_mixed_after_twelve_milliseconds(core):
    """Whether in one step or in two, and then anew after as many."""
    for steps, mixes in (((0.01199,), 0), ((0.01201,), 1), ((0.007, 0.00501), 1), ((0.007, 0.00499), 0)):
        models = some_models(np.random.default_rng(3), 2, (0.4, 0.3, 0.2, 0.1))
        bank = Bank(core, models)
        for _ in range(2):
            for seconds in steps:
                bank.lib.block_filter_predict(bank.filter, seconds)
            assert (bank.filter.filters[slot(2)].probability != np.float32(0.4)) == (mixes == 1)
            assert bank.filter.unmixed_s == pytest.approx(0.0 if mixes else sum(steps), abs=1e-8)
            if not mixes:
                break


def test_what_memory_held_before_is_nothing_to_a_filter(core):
    """Nor is what was: a track that begins again is like the first."""
    ffi, lib = core
    kernel = Kernel(core, cube(8), 0.02)
    fresh, used = kernel.filter, ffi.new("block_filter_t *")
    ffi.buffer(used)[:] = b"\xff" * ffi.sizeof("block_filter_t")
    lib.block_filter_init(used, kernel.coils, 8, 0.02)
    assert bytes(ffi.buffer(used)) == bytes(ffi.buffer(fresh))
    assert (fresh.count, fresh.coils, fresh.measure.noise_uT) == (8, kernel.coils, np.float32(0.02))
    assert lib.block_filter_lost(fresh)
    before = bytes(ffi.buffer(fresh))
    lib.block_filter_predict(fresh, 0.1)  # Nothing happens without a track.
    kernel.fill(Bits(np.ones((10, 1023)), 8).words(0), np.zeros((9, 3)))
    assert not lib.block_filter_update(fresh, kernel.block, 0.1)
    assert bytes(ffi.buffer(fresh)) == before


def test_a_track_that_begins_again_is_like_the_first(fly):
    flight, again = fly(), fly()
    again.kernel.lib.block_filter_keep_slopes(again.kernel.filter, True)
    again.start()
    for _ in range(23):  # Not a multiple of four: some time is unmixed.
        again.step()
    for model in again.kernel.filter.filters:
        model.probability = 0.1
    again.kernel.filter.best, again.kernel.filter.least, again.kernel.filter.refused = 3, 0, 7
    assert again.kernel.filter.unmixed_s > 0.0
    assert again.kernel.filter.kept
    for one in (flight, again):
        one.start()
    ours, truth = again.kernel.filter, flight.kernel.filter
    ffi = flight.kernel.ffi
    assert bytes(ffi.buffer(ours.filters)) == bytes(ffi.buffer(truth.filters))
    for one in (ours, truth):
        assert (one.best, one.least, one.refused, one.kept) == (0, 2, 0, False)
        assert (one.unmixed_s, one.chi_square, one.freedom) == (0.0, 0.0, 0)
    for k, model in enumerate(truth.filters):
        assert model.probability == 0.25
        assert (model.acceleration2, model.turn2) == pytest.approx(np.square(dense.AGILITIES[(3, 4, 2, 5)[k]]))


def a_start(kernel, rng):
    """A start with correlations, and its covariances of position and turn."""
    start = kernel.ffi.new("block_start_t *")
    start.position_m, start.quaternion = [0.5, 0.7, 0.9], Rotation.random(random_state=rng).as_quat().tolist()
    factors = rng.normal(size=(2, 3, 3))
    covariances = [scale * q @ q.T for scale, q in zip((1e-4, 2e-4), factors, strict=True)]
    start.position_cov_m2, start.attitude_cov_rad2 = (c.tolist() for c in covariances)
    start.ambient_uT, start.ambient_sd_uT = [10.0, -20.0, 30.0], 3.0
    return start, covariances


def test_all_that_a_start_tells(core):
    """Its correlations too; nothing is known of velocity and turn rate but how large they may be, nor of the offset."""
    kernel = Kernel(core, cube(8), 0.02)
    start, covariances = a_start(kernel, np.random.default_rng(8))
    kernel.lib.block_filter_start(kernel.filter, start)
    expected = np.diag([0.0] * 6 + [9.0] * 3 + [16.0] * 3 + [25.0 + 9.0] * 3 + [25.0] * 3)
    expected[:3, :3], expected[3:6, 3:6] = (4.0 * covariance for covariance in covariances)
    for model in kernel.filter.filters:
        np.testing.assert_allclose(kernel.matrix(model.covariance), expected, rtol=1e-5)
        state = kernel.state(model.state)
        np.testing.assert_allclose(state.p, [0.5, 0.7, 0.9], rtol=1e-6)
        seen = Rotation.from_quat(list(start.quaternion)).apply([10.0, -20.0, 30.0])
        np.testing.assert_allclose(state.e, seen, atol=1e-4)
        for vector in (state.v, state.w, state.b):
            assert not vector.any()


@pytest.mark.parametrize(("seconds", "moving"), [(1.0, (False, False)), (0.02, (True, True))])
def test_a_shift_tells_of_the_motion_what_the_poses_time_does(core, seconds, moving):
    """Over a second less than at a start, in next to no time nothing more; filters are mixed when they would have."""
    models = some_models(np.random.default_rng(4), 2, (0.2, 0.5, 0.2, 0.1))
    bank = Bank(core, models)
    start, covariances = a_start(bank.kernel, np.random.default_rng(8))
    bank.filter.unmixed_s = 0.005
    now = bank.kernel.state(bank.filter.filters[slot(3)].state)
    measured = bytes(bank.ffi.buffer(bank.ffi.addressof(bank.filter.measure)))
    bank.lib.block_filter_shift(bank.filter, start.position_m, start.quaternion, start, seconds)
    expected = np.diag([0.0] * 6 + [9.0] * 3 + [16.0] * 3 + [25.0 + 9.0] * 3 + [25.0] * 3)
    expected[:3, :3], expected[3:6, 3:6] = (4.0 * covariance for covariance in covariances)
    for place, covariance, most, as_start in zip((6, 9), covariances, (9.0, 16.0), moving, strict=True):
        variance = (3.5 / seconds) ** 2 * np.trace(covariance)
        assert (variance > most) == as_start
        expected[place : place + 3, place : place + 3] = min(variance, most) * np.eye(3)
    for model in bank.filter.filters:
        assert np.abs(bank.kernel.state(model.state).minus(now)).max() < 1e-5  # The same pose: nowhere.
        np.testing.assert_allclose(bank.kernel.matrix(model.covariance), expected, rtol=1e-5)
    assert bank.filter.unmixed_s == np.float32(0.005)
    assert bytes(bank.ffi.buffer(bank.ffi.addressof(bank.filter.measure))) == measured


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("place", [(0, 0), (4, 1), (8, 2)])
def test_sums_of_a_microtesla_too_many_are_no_data(fly, sign, place):
    """Up to a tesla they are data that no filter believes."""
    for size, counted in ((0.99e6, True), (1e6, False), (1.01e6, False)):
        flight = fly()
        flight.start()
        data = flight.data()
        data[place] = sign * size
        assert not flight.put(data)
        assert flight.kernel.filter.refused == counted


def test_what_stands_behind_the_sums_of_a_block_is_no_part_of_it(fly):
    """They are of a block with more columns."""
    flight = fly()
    flight.start()
    flight.kernel.block.sums_uT[9] = [np.nan] * 3
    assert flight.step()


class Beside:
    """A bank of equal filters, and a block that a deviation of chosen size makes unlikely."""

    def __init__(self, core, family, size, swept=False, probabilities=(0.25,) * 4, apart=0.0):
        rng = np.random.default_rng(12)
        equal = some_models(rng, 2, probabilities)
        first = equal[0]
        models = [
            replace(model, covariance=first.covariance, state=first.state.moved(apart * k * SD))
            for k, model in enumerate(equal)
        ]
        self.bank, bits = Bank(core, models), Bits(family(10), 8)
        kernel = self.bank.kernel
        gram, moment = dense.products(bits.columns(50))
        at, reference = dense.sums(self.bank.coils, first.state, gram, moment), dense.likeliest(models).state
        self.data = at + size * gram @ rng.normal(size=at.shape)
        kernel.fill(bits.words(50), self.data)
        y, rows = dense.measured(self.bank.coils, reference, gram, moment, self.data, 0.02)
        y, rows = (y, rows) if swept else (y[:9], rows[:9])
        self.updated = [dense.updated(model.state, model.covariance, reference, y, rows) for model in models]
        self.update = kernel.lib.block_filter_update_swept if swept else kernel.lib.block_filter_update
        self.models, self.freedom = models, len(y)

    def take(self):
        """Take the block without any time before it."""
        return self.update(self.bank.filter, self.bank.kernel.block, 0.0)


@pytest.mark.parametrize("swept", [False, True])
def test_a_block_is_believed_up_to_one_of_a_hundred_thousand(core, gold_family, swept):
    _, _, small, _ = Beside(core, gold_family, 0.0, swept).updated[0]
    _, _, large, _ = Beside(core, gold_family, 1.0, swept).updated[0]
    assert small < 0.01
    for share, taken in ((0.98, True), (1.02, False)):
        limit = chi2.isf(1e-5, 12 if swept else 9)
        beside = Beside(core, gold_family, np.sqrt(share * limit / large), swept)
        _, _, chi_square, logarithm = beside.updated[0]
        assert chi_square == pytest.approx(share * limit, rel=0.003)
        beside.bank.filter.chi_square = 5.0
        assert beside.take() == taken
        filter_ = beside.bank.filter
        assert filter_.refused == (not taken)
        assert filter_.chi_square == pytest.approx(chi_square if taken else 5.0, rel=0.002)
        assert filter_.freedom == (beside.freedom if taken else 0)
        if taken:
            assert filter_.log_likelihood == pytest.approx(-0.5 * (chi_square + logarithm), abs=0.05)
        pose = beside.bank.ffi.new("block_pose_t *")
        beside.bank.lib.block_filter_output(filter_, 0.0, pose)
        assert (pose.chi_square, pose.freedom) == (filter_.chi_square, filter_.freedom)


@pytest.mark.parametrize("apart", [0.5, 1.5])
def test_filters_are_weighed_by_what_they_expected_of_a_block(core, gold_family, apart):
    """One that takes the block is enough for all of them, though the last one, and likeliest before, does not."""
    beside = Beside(core, gold_family, 0.03, probabilities=(0.05, 0.1, 0.15, 0.7), apart=apart)
    likelihoods = np.array([-0.5 * (chi_square + logarithm) for _, _, chi_square, logarithm in beside.updated])
    refused = [chi_square > chi2.isf(1e-5, 9) for _, _, chi_square, _ in beside.updated]
    assert beside.take()
    expected = dense.weighed(beside.models, likelihoods)
    filter_ = beside.bank.filter
    for model in expected:
        ours = filter_.filters[slot(model.agility)].probability
        assert ours == pytest.approx(model.probability, abs=0.02)
    likeliest = int(np.argmax([model.probability for model in expected]))
    assert filter_.best == slot(expected[likeliest].agility)
    assert filter_.chi_square == pytest.approx(beside.updated[likeliest][2], rel=0.01, abs=0.1)
    assert not refused[likeliest]
    assert refused[3] == (apart > 1.0)


class Still:
    """A sensor at rest whose slopes are kept; one of the filter's numbers is then set beside its limit."""

    def __init__(self, fly):
        self.flight = fly()
        place = self.flight.truth(0.0)
        self.flight.truth = lambda _: replace(place, v=np.zeros(3), w=np.zeros(3))
        self.flight.start()
        self.filter = self.flight.kernel.filter
        self.flight.kernel.lib.block_filter_keep_slopes(self.filter, True)
        for _ in range(30):
            assert self.flight.step()
        assert self.filter.measure.held
        self.best = self.filter.filters[self.filter.best]

    def variance(self, first):
        """Return the variance of a vector of the state, over its three axes."""
        return np.trace(self.flight.kernel.matrix(self.best.covariance)[first : first + 3, first : first + 3])

    def held(self):
        """Take a block at once and return whether its slopes were those that are kept."""
        data = self.flight.data()
        self.flight.kernel.fill(self.flight.bits.words(31 * self.flight.number), data)
        self.flight.update(self.filter, self.flight.kernel.block, 0.0)
        return self.filter.measure.held


ALONG = np.array([2.0, -1.0, 2.0]) / 3.0
"""A direction of all axes."""


@pytest.mark.parametrize(("deviations", "held"), [(2.98, True), (3.02, False)])
def test_slopes_are_kept_within_three_deviations(fly, deviations, held):
    """Velocity; position, by those there and here; the field, by turns there and here and 5 uT."""
    still = Still(fly)
    still.best.state.velocity_m_s = (deviations * np.sqrt(still.variance(6)) * ALONG).tolist()
    assert still.held() == held
    still = Still(fly)
    still.filter.kept_m2 = 0.5 * still.variance(0)
    there = np.array(list(still.filter.measure.place.position_m))
    still.best.state.position_m = (there + deviations * np.sqrt(1.5 * still.variance(0)) * ALONG).tolist()
    assert still.held() == held
    still = Still(fly)
    still.filter.kept_rad2 = 0.02
    there = np.array(list(still.filter.measure.place.ambient_uT))
    across = np.cross(there, ALONG) / np.linalg.norm(np.cross(there, ALONG))
    turns = still.variance(3) + 0.02  # They move the field as it is then.
    away = deviations * np.sqrt((25.0 + turns * (there @ there)) / (1.0 - deviations**2 * turns))
    still.best.state.ambient_uT = (there + away * across).tolist()
    assert still.held() == held


def test_slopes_that_are_taken_anew_are_kept_with_how_uncertain_they_are(fly):
    still = Still(fly)
    taken = still.filter.kept_m2, still.filter.kept_rad2
    assert still.held()
    assert (still.filter.kept_m2, still.filter.kept_rad2) == taken  # Though more is known by now.
    still.best.state.velocity_m_s = [9.0, 0.0, 0.0]
    position, turn = still.variance(0), still.variance(3)
    assert not still.held()
    assert (still.filter.kept_m2, still.filter.kept_rad2) == pytest.approx((position, turn), rel=1e-6)


def test_slopes_are_forgotten_when_none_are_to_be_kept(fly):
    still = Still(fly)
    for keep in (False, True):
        still.flight.kernel.lib.block_filter_keep_slopes(still.filter, keep)
    assert not still.held()
    assert still.held()
    still.flight.kernel.lib.block_filter_keep_slopes(still.filter, True)
    assert still.held()


def test_an_update_by_the_sweep_takes_slopes_anew(fly):
    """And keeps none."""
    still = Still(fly)
    plain = still.flight.update
    still.flight.update = still.flight.kernel.lib.block_filter_update_swept
    assert not still.held()
    assert not still.held()
    still.flight.update = plain
    assert not still.held()
    assert still.held()


def test_a_block_of_other_columns_is_refused_without_being_counted(fly):
    flight = fly()
    flight.start()
    data, words = flight.data(), flight.bits.words(31)
    for count in (7, 8):
        block = flight.kernel.fill(words[:count], data[[*range(count), 8]])
        assert flight.update(flight.kernel.filter, block, 0.0) == (count == 8)
        assert flight.kernel.filter.refused == 0


def test_other_coils_have_fields_of_their_own_at_once(fly):
    """Where slopes are kept, too, and whichever has a column now."""
    still = Still(fly)
    flight, order = still.flight, [3, 1, 7, 0, 5]
    data, words = flight.data(), flight.bits.words(31 * flight.number)
    used = flight.kernel.ffi.new("loop_t[5]", [flight.kernel.coils[i] for i in order])
    flight.kernel.lib.block_filter_coils(still.filter, used, 5)
    kernel = Kernel((flight.kernel.ffi, flight.kernel.lib), cube(5), 0.02)
    kernel.fill([words[i] for i in order], np.zeros((0, 3)))
    gram, moment = kernel.matrix(kernel.block.gram)[:6, :6], kernel.matrix(kernel.block.moment)[:6, :6]
    coils = flight.coils
    chosen = dense.Coils(coils.centre[order], coils.axis[order], coils.k[order], coils.radius[order])
    data = dense.sums(chosen, flight.truth(0.0), gram, moment)
    kernel.fill([words[i] for i in order], data)
    assert flight.update(still.filter, kernel.block, BLOCK_S)
    assert still.filter.measure.held
    place = np.array(list(still.filter.measure.place.position_m))
    ours = np.array([list(model.field_uT) for model in still.filter.measure.model])[:5]
    np.testing.assert_allclose(ours, chosen.field(place), rtol=1e-4, atol=1e-5)
