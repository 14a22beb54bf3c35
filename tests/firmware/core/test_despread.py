"""Despreading against the matrix product, bit for bit."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

CHIPS = 1023
LOW, HIGH = -(2**15), 2**15 - 1


def despread(core, samples, missing=()):
    """Correlations of all codes, shape (3, 1025), and the struct. samples: shape (n, 3), fed from chip 0."""
    ffi, lib = core
    state = ffi.new("despread_t *")
    ffi.buffer(state)[:] = b"\xa5" * ffi.sizeof("despread_t")  # Nothing may depend on what was there before.
    lib.despread_start(state)
    chip = ffi.new("int16_t[3]")
    for t, sample in enumerate(samples.tolist()):
        if t in missing:
            lib.despread_skip(state, 1)
        else:
            chip[0:3] = sample
            lib.despread_store(state, chip)
    lib.despread_transform(state)
    words = [lib.despread_word(code) for code in range(1025)]
    result = [[lib.despread_correlation(state, axis, code, words[code]) for code in range(1025)] for axis in range(3)]
    return np.array(result, dtype=np.int64), state


def cases(chips):
    rng = np.random.default_rng(7)
    yield "uniform", rng.integers(LOW, HIGH, (CHIPS, 3), endpoint=True)
    yield "rails", rng.choice([LOW, HIGH], (CHIPS, 3))
    yield "lowest", np.full((CHIPS, 3), LOW)
    yield "one code at full scale", np.stack([np.where(chips[k] > 0, LOW, HIGH) for k in (5, 1023, 1024)], axis=1)
    impulse = np.zeros((CHIPS, 3), dtype=np.int64)
    impulse[[0, 511, 1022], [0, 1, 2]] = LOW
    yield "impulses", impulse


@pytest.mark.parametrize("index", range(5))
def test_equals_the_matrix_product(core, gold_family, index):
    chips = gold_family(10)
    name, samples = list(cases(chips))[index]
    correlation, state = despread(core, samples)
    assert np.array_equal(correlation, (chips @ samples).T), name
    assert list(state.sum) == samples.sum(axis=0).tolist()
    assert state.missing == 0


@settings(max_examples=10, deadline=None)
@given(data=st.data())
def test_missing_samples_count_as_zero(core, gold_family, data):
    seed = data.draw(st.integers(0, 2**32 - 1))
    missing = data.draw(st.sets(st.integers(0, CHIPS - 1), max_size=50))
    fed = data.draw(st.integers(0, CHIPS))
    rng = np.random.default_rng(seed)
    samples = rng.integers(LOW, HIGH, (CHIPS, 3), endpoint=True)
    correlation, state = despread(core, samples[:fed], missing)
    present = np.array([t < fed and t not in missing for t in range(CHIPS)])
    assert np.array_equal(correlation, (gold_family(10) @ (samples * present[:, None])).T)
    assert state.missing == CHIPS - present.sum()


def test_a_full_cycle_takes_no_more(core, gold_family):
    rng = np.random.default_rng(8)
    samples = rng.integers(LOW, HIGH, (CHIPS + 100, 3), endpoint=True)
    correlation, _ = despread(core, samples)
    assert np.array_equal(correlation, (gold_family(10) @ samples[:CHIPS]).T)


def test_codes_that_do_not_exist_give_zero(core):
    _, lib = core
    _, state = despread(core, np.full((CHIPS, 3), 100))
    assert lib.despread_correlation(state, 0, 1025, 0) == 0
    assert lib.despread_correlation(state, 3, 1, lib.despread_word(1)) == 0
    assert lib.despread_correlation(state, 0, 1, 1024) == 0
    assert lib.despread_word(1023) == lib.despread_word(1024) == lib.despread_word(2**32 - 1) == 0


def test_words_follow_each_other(core):
    _, lib = core
    taps = lib.gold_family(10).v_taps
    word = lib.despread_word(0)
    for code in range(1023):
        assert word == lib.despread_word(code)
        word = lib.gold_next_functional(taps, word)
    assert word == lib.despread_word(0)
