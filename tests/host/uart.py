"""A board behind a serial adapter, on a pseudo-terminal: what is heard depends on the rate of either end."""

from __future__ import annotations

import os
import select
import termios
import threading
import tty

from goldfield_protocol import encode_frame
from tests.host.fake_sensor import heartbeat

RATES = {getattr(termios, f"B{rate}"): rate for rate in (115_200, 460_800, 921_600, 1_000_000, 2_000_000)}


def received(data, sent_baud, heard_baud):
    """What a UART hears at its own rate of bytes at another: the line's level in the middle of each of its bits."""
    line = [level for byte in data for level in (0, *((byte >> bit) & 1 for bit in range(8)), 1)] + [1] * int(
        10 * max(1.0, sent_baud / heard_baud) + 1
    )
    step, place, heard = sent_baud / heard_baud, 0.0, bytearray()
    while place < len(line) - 10 * step:
        if line[int(place)]:
            place += step / 16.0
            continue
        bits = [line[int(place + (bit + 1.5) * step)] for bit in range(8)]
        heard.append(sum(level << bit for bit, level in enumerate(bits)))
        place += 9.5 * step
    return bytes(heard)


class Uart:
    """A board behind an adapter that sends heartbeats at a rate of its own, whatever the port is set to.

    It knows the port's rate by the pseudo-terminal's settings, as an adapter does.
    """

    def __init__(self, baud):
        self._baud = baud
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.path = os.ttyname(self._slave)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._send, daemon=True)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._stop.set()
        self._thread.join()
        os.close(self._master)
        os.close(self._slave)

    def _send(self):
        frame = b"\0" + encode_frame(*heartbeat()) * 3
        while not self._stop.wait(0.01):
            baud = RATES.get(termios.tcgetattr(self._slave)[5], 9600)
            if select.select([], [self._master], [], 0.0)[1]:
                os.write(self._master, received(frame, self._baud, baud)[:200])
