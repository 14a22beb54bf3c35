"""A live link opened by the kind and the place that the command line gives."""

from __future__ import annotations

from goldfield.link.buses import BusSource, open_can, open_port


def open_link(kind: str, where: str, bit_rate: int | None = None) -> BusSource:
    """Open a serial port, ``"port"``, or a CAN bus, ``"can"``, as `goldfield.link.buses` does it."""
    return (open_port if kind == "port" else open_can)(where, bit_rate=bit_rate)
