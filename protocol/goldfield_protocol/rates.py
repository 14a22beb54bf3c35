"""The bit rates of the links: what the parameters ``can_rate`` and ``serial_rate`` choose from.

The firmware has the same numbers in the generated ``link_rates.h``.
"""

from __future__ import annotations

CAN_RATES = (1_000_000, 500_000, 250_000, 125_000)
"""Bits a second on CAN, by the value of ``can_rate``."""

SERIAL_RATES = (2_000_000, 921_600, 460_800, 115_200)
"""Baud on serial, by the value of ``serial_rate``."""
