"""Gold codes against SciPy's sequences, IS-GPS-200's table and the theory of preferred pairs."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

DEGREES = (5, 6, 7, 9, 10, 11)

# IS-GPS-200, table 3-Ia: PRN, G2 delay in chips, first ten chips in octal.
GPS = [
    *[
        (1, 5, "1440"),
        (2, 6, "1620"),
        (3, 7, "1710"),
        (4, 8, "1744"),
        (5, 17, "1133"),
        (6, 18, "1455"),
        (7, 139, "1131"),
    ],
    *[(8, 140, "1454"), (9, 141, "1626"), (10, 251, "1504"), (11, 252, "1642"), (12, 254, "1750"), (17, 469, "1156")],
    *[(18, 470, "1467"), (23, 509, "1063"), (24, 512, "1706"), (29, 859, "1127"), (30, 860, "1453"), (32, 862, "1712")],
]


def bits(core, degree, code, first, count):
    ffi, lib = core
    generator = ffi.new("gold_generator_t *")
    assert lib.gold_start(generator, degree, code, first)
    return np.array([lib.gold_next(generator) for _ in range(count)])


@pytest.mark.parametrize("degree", DEGREES)
def test_family_equals_scipy(core, gold_family, degree):
    chips = gold_family(degree)
    length = chips.shape[1]
    codes = range(length + 2) if degree <= 7 else [0, 1, 2, length // 2, length - 1, length, length + 1]
    for code in codes:
        assert np.array_equal(1 - 2 * bits(core, degree, code, 0, length), chips[code])


@given(data=st.data())
def test_a_code_starts_at_any_chip(core, gold_family, data):
    degree = data.draw(st.sampled_from(DEGREES))
    chips = gold_family(degree)
    length = chips.shape[1]
    code = data.draw(st.integers(0, length + 1))
    first = data.draw(st.integers(0, 2**32 - 1))
    expected = chips[code][(first + np.arange(40)) % length]
    assert np.array_equal(1 - 2 * bits(core, degree, code, first, 40), expected)


@pytest.mark.parametrize(("prn", "delay", "octal"), GPS)
def test_gps_first_ten_chips(core, prn, delay, octal):
    first = bits(core, 10, 1023 - delay, 0, 10)
    assert f"{int(''.join(map(str, first)), 2):04o}" == octal, f"PRN {prn}"


@pytest.mark.parametrize("degree", DEGREES)
def test_pair_is_preferred(core, degree):
    length = 2**degree - 1
    u, v = (1 - 2 * bits(core, degree, code, 0, length) for code in (length, length + 1))
    correlation = np.rint(np.fft.ifft(np.fft.fft(u) * np.conj(np.fft.fft(v))).real).astype(int)
    t = 1 + 2 ** ((degree + 2) // 2)
    assert set(correlation) == {-t, -1, t - 2}
    for register in (u, v):  # Maximum length: ideal autocorrelation.
        auto = np.rint(np.fft.ifft(abs(np.fft.fft(register)) ** 2).real).astype(int)
        assert auto[0] == length
        assert set(auto[1:]) == {-1}


def test_balance_of_degree_10(core):
    _, lib = core
    sums = [lib.gold_sum(10, code) for code in range(1025)]
    values, counts = np.unique(sums, return_counts=True)
    assert dict(zip(values.tolist(), counts.tolist(), strict=True)) == {-65: 120, -1: 769, 63: 136}


def test_unknown_codes_are_refused(core):
    ffi, lib = core
    generator = ffi.new("gold_generator_t *")
    for degree in (0, 1, 4, 8, 12, 2**32 - 1):
        assert lib.gold_family(degree) == ffi.NULL
        assert not lib.gold_start(generator, degree, 0, 0)
    assert not lib.gold_start(generator, 10, 1025, 0)
    assert generator.family == ffi.NULL
    assert [lib.gold_sum(10, code) for code in (1024, 1025)] == [-1, 0]
    assert [lib.gold_sum(degree, 0) for degree in (7, 8)] == [15, 0]
