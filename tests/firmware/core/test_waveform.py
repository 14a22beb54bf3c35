"""What a beacon's bridge does, against Gold codes from SciPy, slices and cosines; and against the host's templates."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from goldfield.access.waveform import slot_template, tone_template

CODE, SLOT, TONE = range(3)
DEGREES = (5, 6, 7, 9, 10, 11)


def waveform(core, degree, kind, code=0, slots=1, slot=0, periods=1):
    """Two cycles of a waveform, or None if it is refused."""
    ffi, lib = core
    config = ffi.new("waveform_config_t *", [kind, code, slots, slot, periods])
    made = ffi.new("waveform_t *")
    if not lib.waveform_start(made, degree, config):
        assert bytes(ffi.buffer(made)) == bytes(ffi.sizeof(made[0]))  # untouched
        return None
    cycles = np.array([lib.waveform_next(made) for _ in range(2 * (2**degree - 1))]).reshape(2, -1)
    np.testing.assert_array_equal(cycles[0], cycles[1])
    return cycles[0]


@pytest.mark.parametrize("degree", DEGREES)
def test_codes(core, gold_family, degree):
    for code in (0, 3, 2**degree - 2, 2**degree - 1, 2**degree):
        np.testing.assert_array_equal(waveform(core, degree, CODE, code=code), gold_family(degree)[code])


@given(data=st.data(), degree=st.sampled_from(DEGREES))
def test_slots(core, data, degree):
    chips = 2**degree - 1
    slots = data.draw(st.integers(1, chips))
    slot = data.draw(st.integers(0, slots - 1))
    expected = [1 if slot <= t // (chips // slots) < slot + 1 else 0 for t in range(chips)]
    driven = waveform(core, degree, SLOT, slots=slots, slot=slot)
    np.testing.assert_array_equal(driven, expected)
    np.testing.assert_array_equal(driven, slot_template(chips, slots, slot))


@given(data=st.data(), degree=st.sampled_from(DEGREES))
def test_tones(core, data, degree):
    chips = 2**degree - 1
    periods = data.draw(st.integers(1, (chips - 1) // 2))
    driven = waveform(core, degree, TONE, periods=periods)
    np.testing.assert_array_equal(driven, np.sign(np.cos(2.0 * np.pi * periods * np.arange(chips) / chips)))
    np.testing.assert_array_equal(driven, tone_template(chips, periods, square=True))


@pytest.mark.parametrize(
    "wrong",
    [
        {"degree": 8, "kind": CODE},
        {"degree": 10, "kind": 3},
        {"degree": 10, "kind": CODE, "code": 1025},
        {"degree": 10, "kind": SLOT, "slots": 0},
        {"degree": 10, "kind": SLOT, "slots": 1024},
        {"degree": 10, "kind": SLOT, "slots": 9, "slot": 9},
        {"degree": 10, "kind": TONE, "periods": 0},
        {"degree": 10, "kind": TONE, "periods": 512},
        {"degree": 10, "kind": TONE, "periods": 2**32 - 1},
    ],
)
def test_what_does_not_exist_is_refused(core, wrong):
    assert waveform(core, **wrong) is None
