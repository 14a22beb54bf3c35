"""What a board's analog inputs lie at: most never change, and are answered without Python (``analog_pins.c``)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import cffi

from hil_sim.clib import load
from tests.objects import shared_library

MID_SCALE_V = 1.65
"""Nothing flows and no field is, and every thermistor is at 25 degC."""
FOREVER, NEVER = (1 << 63) - 1, -(1 << 63)

Source = Callable[[int], float | tuple[float, int]]
"""Volts of a pin at a time, ps; or they and a time: before it, the pin is not asked again."""
Pins = Mapping[int, float | Source]
"""By pin, its volts or their source."""


@cache
def _library() -> tuple[cffi.FFI, Any]:
    source = Path(__file__).with_suffix(".c")
    return load(shared_library(source), [str(source.with_suffix(".h"))])


class AnalogPins:
    """The analog inputs of one board.

    Parameters
    ----------
    pins : mapping
        What they lie at, or their sources; a pin that is not named lies at mid-scale.

    Attributes
    ----------
    sample, context : int
        Addresses: `board_edge_t`'s ``analog_in``, and what it wants as ``context``. They live as long as this does.
    """

    def __init__(self, pins: Pins) -> None:
        ffi, library = _library()
        self._sources: dict[int, Source] = {}
        self._ask = ffi.callback("double(const analog_pins_t *, unsigned, int64_t)", self._answer)
        self._table = ffi.new("analog_pins_t *", {"ask": self._ask})
        for pin, own in enumerate(self._table.pin):
            source = pins.get(pin, MID_SCALE_V)
            if callable(source):
                self._sources[pin] = source
            else:
                own.volts, own.until_ps = source, FOREVER
        self._asked = [self._table.pin[pin] for pin in self._sources]
        self.forget()
        self.sample, self.context = (int(ffi.cast("uintptr_t", it)) for it in (library.analog_pins_in, self._table))

    def forget(self) -> None:
        """Ask the sources anew: what they depend on may have changed."""
        for own in self._asked:
            own.until_ps = NEVER

    def _answer(self, _: Any, pin: int, time: int) -> float:
        answer = self._sources[pin](time)
        if not isinstance(answer, tuple):
            return answer
        own = self._table.pin[pin]
        own.volts, own.until_ps = answer
        return answer[0]
