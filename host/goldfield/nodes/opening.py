"""A live link opened by the kind and the place that the command line gives."""

from __future__ import annotations

from goldfield.link.buses import BusSource, open_can, open_port


def open_link(kind: str, where: str) -> BusSource:
    """Open a serial port, ``"port"``, or a CAN bus, ``"can"``; `UserError` if that fails."""
    return open_port(where) if kind == "port" else open_can(where)
