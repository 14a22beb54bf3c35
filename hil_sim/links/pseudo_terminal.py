"""A board's serial port as a pseudo-terminal that another process opens like a real one."""

from __future__ import annotations

import os
import pty
import select
import tty

WAITING_LIMIT = 1 << 16
"""Bytes that wait for a slow reader when the bench does not; the oldest beyond that are lost, as in a real adapter."""


class PseudoTerminal:
    """The bench's end of a pseudo-terminal in raw mode.

    As long as nobody has `path` open, bytes go nowhere, as on a wire without a listener.

    Attributes
    ----------
    path : str
        Path of the device that the other process opens.
    lost : int
        Bytes lost because the reader was too slow.
    """

    def __init__(self) -> None:
        self._bench, other = pty.openpty()
        tty.setraw(other)
        self.path = os.ttyname(other)
        os.close(other)  # so that the bench can tell whether somebody has opened it
        os.set_blocking(self._bench, False)
        self._waiting = bytearray()
        self.lost = 0

    @property
    def opened(self) -> bool:
        """True while another process has it open."""
        return not self._poll(0, 0) & select.POLLHUP

    def _poll(self, events: int, milliseconds: int) -> int:
        poll = select.poll()
        poll.register(self._bench, events)
        return sum(found for _, found in poll.poll(milliseconds))

    def write(self, data: bytes, *, wait: bool) -> None:
        """Send bytes to the reader.

        Parameters
        ----------
        data : bytes
        wait : bool
            Wait for a slow reader; else at most `WAITING_LIMIT` bytes are kept for the next call.
        """
        if not self.opened:
            self._waiting.clear()
            return
        self._waiting += data
        while self._waiting:
            try:
                del self._waiting[: os.write(self._bench, self._waiting)]
            except BlockingIOError:
                if not wait:
                    break
                self._poll(select.POLLOUT, 100)
                if not self.opened:
                    self._waiting.clear()
        excess = len(self._waiting) - WAITING_LIMIT
        if excess > 0:
            del self._waiting[:excess]
            self.lost += excess

    def read(self) -> bytes:
        """Take what the other process has sent; empty if nothing, or nobody is there."""
        try:
            return os.read(self._bench, 4096)
        except OSError:  # nothing there yet (EAGAIN), or closed at the other end (EIO)
            return b""

    def close(self) -> None:
        """Take the terminal away."""
        os.close(self._bench)
