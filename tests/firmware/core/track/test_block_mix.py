"""The filters of the bank together: mixed, weighed, and what they say as one, against the textbook's sums."""

import numpy as np
import pytest

from tests.firmware.core.track.dense import Model, combined, predicted
from tests.firmware.core.track.single import Kernel, cube, some_state
from tests.firmware.core.track.test_block_kalman import some_covariance

AGILITIES = ((0.05, 0.08), (0.25, 0.3), (2.0, 0.5), (0.5, 4.0))
KEPT = np.tril(np.ones((18, 18), bool)) | np.kron(np.eye(3, dtype=bool), np.ones((6, 6), bool))
"""What is kept up of a covariance; all else is none."""


class Bank:
    """Four filters of different states, covariances, agilities and probabilities; what is not kept up is NaN."""

    def __init__(self, core, best=0, seed=1, probabilities=(0.1, 0.2, 0.3, 0.4)):
        self.ffi, self.lib = core
        self.kernel, rng = Kernel(core, cube(1), 0.02), np.random.default_rng(seed)
        base, self.best = some_state(rng), best
        self.models = []
        for k in range(4):
            covariance = some_covariance(rng)
            state = base.moved(np.linalg.cholesky(covariance) @ rng.normal(size=18))
            self.models.append(Model(state, covariance, probabilities[k], k))
        self.filters = self.ffi.new("block_kalman_t[5]")
        for filter_, model, agility in zip(self.filters, self.models, AGILITIES, strict=False):
            self.kernel.put(filter_, model.state, np.where(KEPT, model.covariance, np.nan), agility)
            filter_.probability = model.probability
        self.kernel.put(self.filters[4], base, np.full((18, 18), 7.25), (3.0, 5.0))
        self.filters[4].probability = np.nan  # It tells whatever it is multiplied by.
        self.beside = bytes(self.ffi.buffer(self.ffi.addressof(self.filters[4])))

    def check_beside(self):
        """What lies behind the four filters is as it was."""
        assert bytes(self.ffi.buffer(self.ffi.addressof(self.filters[4]))) == self.beside

    def weights(self):
        return np.array([model.probability for model in self.models])

    def agility(self):
        """What all filters expect together."""
        size = np.sqrt(self.weights() @ np.square(AGILITIES))
        return size[0], size[1]


def same(state, covariance, truth, truth_covariance, most=1e-5):
    """Compare to a thousandth of the standard deviations, and the covariances to so much of them."""
    sd = np.sqrt(np.diag(truth_covariance))
    assert np.abs(state.minus(truth)[: len(sd)] / sd).max() < 1e-3
    difference = np.abs((covariance - truth_covariance) / np.outer(sd, sd))
    assert difference[KEPT[: len(sd), : len(sd)]].max() < most


@pytest.mark.parametrize("best", [0, 3])
@pytest.mark.parametrize("change", [0.0, 0.008, 0.25])
def test_each_filter_becomes_what_those_say_that_it_may_have_been(core, best, change):
    bank = Bank(core, best)
    bank.lib.block_mix(bank.filters, best, change)
    bank.check_beside()
    for j, filter_ in enumerate(list(bank.filters)[:4]):
        shares = bank.weights() * np.where(np.arange(4) == j, 1.0 - 3.0 * change, change)
        truth, covariance = combined(bank.models, shares / shares.sum(), bank.models[best].state)
        same(Kernel.state(filter_.state), Kernel.matrix(filter_.covariance), truth, covariance)
        assert filter_.probability == pytest.approx(shares.sum(), rel=1e-6)
        assert (filter_.acceleration2, filter_.turn2) == pytest.approx(np.square(AGILITIES[j]), rel=1e-6)


def check_weighed(bank, likelihood):
    """Compare the probabilities after a block with those of the textbook, of which none is less than 1e-9."""
    together, most = bank.ffi.new("float *"), max(likelihood)
    told = bank.weights() * np.exp(np.array(likelihood) - most)
    best = bank.lib.block_mix_weigh(bank.filters, [*likelihood, 1e4], together)  # The last is nobody's.
    ours = [filter_.probability for filter_ in bank.filters][:4]
    np.testing.assert_allclose(ours, np.maximum(told / told.sum(), 1e-9), rtol=3e-6)
    assert together[0] == pytest.approx(most + np.log(told.sum()), rel=3e-7, abs=3e-7)
    assert best == int(np.argmax(told))
    bank.check_beside()


@pytest.mark.parametrize(
    "likelihood", [(-3.0, -2.0, -4.0, -1.0), (2.0, -1.0, 0.5, 1.0), (-400.0, -510.0, -500.0, -1e4)]
)
def test_probabilities_after_a_block(core, likelihood):
    for turn in range(4):
        check_weighed(Bank(core), np.roll(likelihood, turn))


def test_a_filter_that_is_next_to_impossible_can_come_back(core):
    targets = np.array([1.05e-9, 0.95e-9, 0.4, 0.6])
    for turn in range(4):
        bank = Bank(core)
        check_weighed(bank, np.log(np.roll(targets, turn) / bank.weights()))


@pytest.mark.parametrize(("probabilities", "first"), [((0.1, 0.4, 0.1, 0.4), 1), ((0.4, 0.4, 0.1, 0.1), 0)])
def test_the_first_of_equals_is_the_likeliest(core, probabilities, first):
    bank = Bank(core, probabilities=probabilities)
    assert bank.lib.block_mix_weigh(bank.filters, (-1.0,) * 4, core[0].new("float *")) == first


@pytest.mark.parametrize("best", [0, 3])
@pytest.mark.parametrize("seconds", [0.0, 0.0015, 0.2, -0.1])
def test_a_pose_is_what_all_say_together(core, best, seconds):
    bank, state, covariance = Bank(core, best), core[0].new("block_state_t *"), core[0].new("float[6][6]")
    bank.lib.block_mix_output(bank.filters, best, seconds, state, covariance)
    merged = combined(bank.models, bank.weights(), bank.models[best].state)
    truth, truth_covariance = predicted(*merged, bank.agility(), seconds)
    turn = 0.5 * abs(seconds) * np.linalg.norm(truth.w)  # Left out where the turn rate's part is taken to first order.
    same(Kernel.state(state), Kernel.matrix(covariance), truth, truth_covariance[:6, :6], 1e-5 + turn)


@pytest.mark.parametrize("best", [0, 3])
def test_the_bank_as_one_filter(core, best):
    bank, whole = Bank(core, best), core[0].new("block_kalman_t *")
    whole.acceleration2 = whole.turn2 = whole.probability = 7.0
    bank.lib.block_mix_whole(bank.filters, best, whole)
    merged = combined(bank.models, bank.weights(), bank.models[best].state)
    same(Kernel.state(whole.state), Kernel.matrix(whole.covariance), *merged)
    assert (whole.acceleration2, whole.turn2) == pytest.approx(np.square(bank.agility()), rel=1e-6)
    assert whole.probability == 1.0
