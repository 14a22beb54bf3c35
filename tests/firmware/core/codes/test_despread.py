"""Despreading against the matrix product, bit for bit, with codes of every degree."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

DEGREES = (5, 6, 7, 9, 10, 11)
LOW, HIGH = -(2**15), 2**15 - 1


def despread(core, degree, samples, missing=()):
    """Correlations of all codes, shape (3, N + 2), and the struct. samples: shape (n, 3), fed from chip 0."""
    ffi, lib = core
    family = lib.gold_family(degree)
    state = ffi.new("despread_t *")
    ffi.buffer(state)[:] = b"\xa5" * ffi.sizeof("despread_t")  # Nothing may depend on what was there before.
    lib.despread_start(state, family)
    chip = ffi.new("int16_t[3]")
    for t, sample in enumerate(samples.tolist()):
        if t in missing:
            lib.despread_skip(state, 1)
        else:
            chip[0:3] = sample
            lib.despread_store(state, chip)
    lib.despread_transform(state)
    words = [lib.despread_word(family, code) for code in range(family.length + 2)]
    result = [[lib.despread_correlation(state, axis, word) for word in words] for axis in range(3)]
    return np.array(result, dtype=np.int64), state


def cases(chips):
    rng = np.random.default_rng(7)
    length = chips.shape[1]
    yield "uniform", rng.integers(LOW, HIGH, (length, 3), endpoint=True)
    yield "rails", rng.choice([LOW, HIGH], (length, 3))
    yield "lowest", np.full((length, 3), LOW)
    own = (5, length, length + 1)
    yield "one code at full scale", np.stack([np.where(chips[k] > 0, LOW, HIGH) for k in own], axis=1)
    impulse = np.zeros((length, 3), dtype=np.int64)
    impulse[[0, length // 2, length - 1], [0, 1, 2]] = LOW
    yield "impulses", impulse


@pytest.mark.parametrize("degree", DEGREES)
@pytest.mark.parametrize("index", range(5))
def test_equals_the_matrix_product(core, gold_family, degree, index):
    chips = gold_family(degree)
    name, samples = list(cases(chips))[index]
    correlation, state = despread(core, degree, samples)
    assert np.array_equal(correlation, (chips @ samples).T), name
    assert list(state.sum) == samples.sum(axis=0).tolist()
    assert state.missing == 0


@settings(max_examples=15)
@given(data=st.data())
def test_missing_samples_count_as_zero(core, gold_family, data):
    degree = data.draw(st.sampled_from(DEGREES))
    length = 2**degree - 1
    seed = data.draw(st.integers(0, 2**32 - 1))
    missing = data.draw(st.sets(st.integers(0, length - 1), max_size=50))
    fed = data.draw(st.integers(0, length))
    rng = np.random.default_rng(seed)
    samples = rng.integers(LOW, HIGH, (length, 3), endpoint=True)
    correlation, state = despread(core, degree, samples[:fed], missing)
    present = np.array([t < fed and t not in missing for t in range(length)])
    assert np.array_equal(correlation, (gold_family(degree) @ (samples * present[:, None])).T)
    assert state.missing == length - present.sum()


@pytest.mark.parametrize("degree", [7, 10])
def test_a_full_cycle_takes_no_more(core, gold_family, degree):
    chips = gold_family(degree)
    rng = np.random.default_rng(8)
    samples = rng.integers(LOW, HIGH, (chips.shape[1] + 100, 3), endpoint=True)
    correlation, _ = despread(core, degree, samples)
    assert np.array_equal(correlation, (chips @ samples[: chips.shape[1]]).T)


@pytest.mark.parametrize("degree", DEGREES)
def test_codes_that_do_not_exist_give_zero(core, degree):
    _, lib = core
    family = lib.gold_family(degree)
    _, state = despread(core, degree, np.full((family.length, 3), 100))
    none = lib.despread_word(family, family.length + 2)
    assert none == lib.despread_word(family, 2**32 - 1)
    assert lib.despread_correlation(state, 0, none) == 0
    for code in (1, family.length + 1):
        assert lib.despread_correlation(state, 2, lib.despread_word(family, code)) != 0
        assert lib.despread_correlation(state, 3, lib.despread_word(family, code)) == 0
    assert lib.despread_correlation(state, 0, 2048) == 0


@pytest.mark.parametrize("degree", DEGREES)
def test_words_follow_each_other(core, degree):
    _, lib = core
    family = lib.gold_family(degree)
    word = lib.despread_word(family, 0)
    for code in range(family.length):
        assert word == lib.despread_word(family, code)
        word = lib.gold_next_functional(family.v_taps, word)
    assert word == lib.despread_word(family, 0)
