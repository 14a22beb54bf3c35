"""What a beacon drives in each chip: against Gold codes from SciPy, slices, sines; and against the host's templates."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from goldfield.access.waveform import code_template, slot_template, tone_template
from goldfield.site.drive import Code
from tests.firmware.core.edge_memory import at_the_edge

CODE, SLOT, TONE, ROTATING, SUPERPOSED = range(5)
DEGREES = (5, 6, 7, 9, 10, 11)
ONE = 16384
CODES_1023 = {  # Holds that fit a cycle of 1023 = 3 * 11 * 31 chips.
    5: (1, 3, 11, 33),
    10: (1,),
}


def levels(core, degree, kind, code=0, slots=1, slot=0, periods=1, codes=()):
    """Two cycles of a waveform as levels, shape (N, 2), or None if it is refused."""
    ffi, lib = core
    config = ffi.from_buffer("waveform_config_t *", at_the_edge(ffi.sizeof("waveform_config_t")))
    config[0] = [kind, code, slots, slot, periods, [list(c) for c in codes]]
    made = ffi.new("waveform_t *")
    if not lib.waveform_start(made, degree, config):
        assert bytes(ffi.buffer(made)) == bytes(ffi.sizeof(made[0]))  # untouched
        return None
    assert lib.waveform_channels(kind) == (2 if kind == ROTATING else 1)
    level = ffi.new("int16_t[2]", [77, 77])
    chips = []
    for _ in range(2 * (2**degree - 1)):
        lib.waveform_next(made, level)
        chips.append((level[0] / ONE, level[1] / ONE))
    cycles = np.array(chips).reshape(2, -1, 2)
    np.testing.assert_array_equal(cycles[0], cycles[1])
    return cycles[0]


def one_channel(core, *arguments, **options):
    driven = levels(core, *arguments, **options)
    assert not driven[:, 1].any()
    return driven[:, 0]


@pytest.mark.parametrize("degree", DEGREES)
def test_codes(core, gold_family, degree):
    for code in (0, 3, 2**degree - 2, 2**degree - 1, 2**degree):
        np.testing.assert_array_equal(one_channel(core, degree, CODE, code=code), gold_family(degree)[code])


@given(data=st.data(), degree=st.sampled_from(DEGREES))
def test_slots(core, data, degree):
    chips = 2**degree - 1
    slots = data.draw(st.integers(1, chips))
    slot = data.draw(st.integers(0, slots - 1))
    expected = [1 if slot <= t // (chips // slots) < slot + 1 else 0 for t in range(chips)]
    driven = one_channel(core, degree, SLOT, slots=slots, slot=slot)
    np.testing.assert_array_equal(driven, expected)
    np.testing.assert_array_equal(driven, slot_template(chips, slots, slot))


@given(data=st.data(), degree=st.sampled_from(DEGREES))
def test_tones(core, data, degree):
    chips = 2**degree - 1
    periods = data.draw(st.integers(1, (chips - 1) // 2))
    driven = one_channel(core, degree, TONE, periods=periods)
    np.testing.assert_array_equal(driven, np.sign(np.cos(2.0 * np.pi * periods * np.arange(chips) / chips)))
    np.testing.assert_array_equal(driven, tone_template(chips, periods, square=True))


@given(data=st.data(), degree=st.sampled_from(DEGREES))
def test_rotating(core, data, degree):
    chips = 2**degree - 1
    periods = data.draw(st.integers(1, (chips - 1) // 2))
    driven = levels(core, degree, ROTATING, periods=periods)
    turn = 2.0 * np.pi * periods * np.arange(chips) / chips
    assert np.abs(driven - np.stack([np.cos(turn), np.sin(turn)], axis=1)).max() <= 1.0 / ONE
    assert np.abs(driven[:, 0] - tone_template(chips, periods)).max() <= 1.0 / ONE


@pytest.mark.parametrize(("degree", "periods"), [(9, 1), (10, 1), (11, 1), (11, 511)])
def test_a_sinusoid_errs_by_its_rounding_alone(core, degree, periods):
    """Half a unit, and the 4e-6 by which the series errs."""
    chips = 2**degree - 1
    turn = 2.0 * np.pi * periods * np.arange(chips) / chips
    exact = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    assert np.abs(levels(core, degree, ROTATING, periods=periods) - exact).max() <= 0.5 / ONE + 4e-6


@st.composite
def fitting_codes(draw):
    """One to four codes, each with a length times hold that divides a cycle of 1023 chips."""
    degree = draw(st.sampled_from(sorted(CODES_1023)))
    length = 2**degree - 1
    return Code(
        degree=degree,
        index=draw(st.integers(0, length + 1)),
        offset=draw(st.integers(0, length - 1)),
        hold=draw(st.sampled_from(CODES_1023[degree])),
    )


def superposed(core, degree, codes):
    return one_channel(core, degree, SUPERPOSED, codes=[(c.degree, c.index, c.offset, c.hold) for c in codes])


@given(codes=st.lists(fitting_codes(), min_size=1, max_size=4))
def test_superposed_codes_are_the_hosts_template(core, codes):
    assert np.abs(superposed(core, 10, codes) - code_template(1023, codes)).max() < 1.0 / ONE


@given(codes=st.lists(fitting_codes(), min_size=1, max_size=4))
def test_superposed_codes_are_a_mean_of_gold_codes(core, gold_family, codes):
    expected = np.zeros(1023)
    for c in codes:
        own = gold_family(c.degree)[c.index]
        expected += [own[(t // c.hold + c.offset) % len(own)] for t in range(1023)]
    driven = superposed(core, 10, codes)
    assert np.abs(driven - expected / len(codes)).max() < 1.0 / ONE
    assert set(np.unique(driven * len(codes)).round(3)) <= set(range(-len(codes), len(codes) + 1))


@pytest.mark.parametrize(("degree", "hold"), [(6, 1), (9, 1), (11, 1), (5, 1)])
def test_one_superposed_code_is_that_code(core, gold_family, degree, hold):
    driven = superposed(core, degree, [Code(index=7, degree=degree, hold=hold)])
    np.testing.assert_array_equal(driven, gold_family(degree)[7])


def test_places_without_a_code_count_for_nothing(core):
    full = levels(core, 10, SUPERPOSED, codes=[(5, 4, 2, 3), (10, 9, 1, 1)])
    np.testing.assert_array_equal(
        full, levels(core, 10, SUPERPOSED, codes=[(0, 1, 2, 3), (5, 4, 2, 3), (0, 0, 0, 0), (10, 9, 1, 1)])
    )


@pytest.mark.parametrize(
    "wrong",
    [
        {"degree": 8, "kind": CODE},
        {"degree": 10, "kind": 5},
        {"degree": 10, "kind": CODE, "code": 1025},
        {"degree": 10, "kind": SLOT, "slots": 0},
        {"degree": 10, "kind": SLOT, "slots": 1024},
        {"degree": 10, "kind": SLOT, "slots": 9, "slot": 9},
        *({"degree": 10, "kind": kind, "periods": n} for kind in (TONE, ROTATING) for n in (0, 512, 2**32 - 1)),
        {"degree": 10, "kind": SUPERPOSED},
        *(
            {"degree": 10, "kind": SUPERPOSED, "codes": [(10, 3, 0, 1), code]}
            for code in [
                (8, 0, 0, 1),
                (5, 33, 0, 1),
                (5, 0, 31, 1),
                (5, 0, 0, 0),
                (5, 0, 0, 2),
                (7, 0, 0, 1),  # 127 does not divide 1023.
                (11, 0, 0, 1),
                (10, 0, 0, 2),
                (5, 0, 0, 2**31 + 1),
                (5, 0, 0, pow(31, -1, 2**32)),  # 31 times that is 1 in 32 bits.
            ]
        ),
    ],
)
def test_what_does_not_exist_is_refused(core, wrong):
    assert levels(core, **wrong) is None
