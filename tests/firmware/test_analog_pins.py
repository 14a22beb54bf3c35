"""Analog inputs that are answered without Python: what is known, what is asked, and when it is asked again."""

from __future__ import annotations

from typing import Any

import cffi
import pytest

from tests.firmware.analog_pins import MID_SCALE_V, AnalogPins, Pins

FFI = cffi.FFI()


def sampled(inputs: AnalogPins, pin: int, time: int) -> float:
    """Sample as a board does, through the edge."""
    sample: Any = FFI.cast("double(*)(void *, unsigned, int64_t)", inputs.sample)
    return float(sample(FFI.cast("void *", inputs.context), pin, time))


def test_a_pin_lies_at_its_volts_and_one_that_is_not_named_at_mid_scale() -> None:
    inputs = AnalogPins({3: 0.25})
    assert [sampled(inputs, pin, time) for pin in (3, 4) for time in (-5, 0, 10**15)] == [0.25] * 3 + [MID_SCALE_V] * 3


@pytest.mark.parametrize(("kept", "asked"), [(False, [10, 19, 20, 21]), (True, [10, 20])])
def test_a_source_is_asked_at_each_sample_or_again_when_its_answer_ends(kept: bool, asked: list[int]) -> None:
    seen: list[int] = []

    def source(time: int) -> float | tuple[float, int]:
        seen.append(time)
        return (time / 8, time + 10) if kept else time / 8

    pins: Pins = {7: source}
    inputs = AnalogPins(pins)
    told = [sampled(inputs, 7, time) for time in (10, 19, 20, 21)]
    assert seen == asked
    assert told == ([1.25, 1.25, 2.5, 2.5] if kept else [1.25, 2.375, 2.5, 2.625])


def test_an_answer_is_forgotten() -> None:
    answers = iter([(1.0, 100), (2.0, 100)])
    inputs = AnalogPins({0: lambda time: next(answers), 1: 3.0})
    assert [sampled(inputs, 0, 5), sampled(inputs, 0, 6)] == [1.0, 1.0]
    inputs.forget()
    assert [sampled(inputs, 0, 7), sampled(inputs, 1, 7)] == [2.0, 3.0]
