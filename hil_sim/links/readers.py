"""Whether somebody reads a bench, for one that stands still until then."""

from __future__ import annotations

import time
from collections.abc import Mapping

from hil_sim.links.pseudo_terminal import PseudoTerminal
from hil_sim.rig import Rig

LISTENER_S = 0.5
"""Wall time after which somebody who has a port open, and sends nothing, is taken for one who only listens."""


class Readers:
    """Those who have a serial port of the bench open and are ready to read.

    Who opens a serial port flushes it some time later, and loses what came in between. Goldfield's programs send a byte
    once they have done so; others are given `LISTENER_S`.

    Parameters
    ----------
    rig : Rig
        Gets what they send.
    terminals : mapping of int to PseudoTerminal
        The ports by board.
    """

    def __init__(self, rig: Rig, terminals: Mapping[int, PseudoTerminal]) -> None:
        self._rig, self._terminals = rig, terminals
        self._opened_s: float | None = None
        self._ready = False

    def ready(self) -> bool:
        """Tell whether one is there and ready; asked again, it stays so until all have closed their port."""
        if not any(terminal.opened for terminal in self._terminals.values()):
            self._opened_s, self._ready = None, False
        elif not self._ready:
            now_s = time.monotonic()
            self._opened_s = now_s if self._opened_s is None else self._opened_s
            self._ready = self._sent_something() or now_s - self._opened_s > LISTENER_S
        return self._ready

    def _sent_something(self) -> bool:
        sent = {board: terminal.read() for board, terminal in self._terminals.items()}
        for board, data in sent.items():
            self._rig.serial_write(data, board)
        return any(sent.values())
