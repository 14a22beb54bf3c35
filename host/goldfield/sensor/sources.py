"""Opens where a sensor's messages come from; it imports little, so that a link is open before the rest is loaded."""

from __future__ import annotations

from goldfield.link.buses import LogSource, Source, open_can, open_port
from goldfield.link.recordings import CandumpReader
from goldfield.sensor.options import Options


def open_source(kind: str, where: str, options: Options) -> Source:
    """Open a source, with kind, place and options as for `goldfield.sensor.opening.open_sensor`.

    Raises
    ------
    UserError
        If it cannot be opened.
    """
    if kind == "log":
        return LogSource(CandumpReader(where))
    opened = open_port if kind == "port" else open_can
    source = opened(where, listen_only=options.listen_only, reconnect=options.reconnect, bit_rate=options.bit_rate)
    source.key = options.key
    return source
