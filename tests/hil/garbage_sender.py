"""A program that throws datagrams at CAN channels, as a stranger or a broken program of the machine does.

``python garbage_sender.py GROUP:PORT ...`` throws ten rounds a second, until its stdin is closed; then it prints how
many datagrams it has thrown at each channel.
"""

from __future__ import annotations

import contextlib
import select
import socket
import sys

import numpy as np

PYTHON_CAN = ("239.74.163.2", 43113)
"""Group and port that every python-can program of ``udp_multicast`` shares, and benches once did."""
AT_A_CHANNEL = 3
"""Datagrams that each channel gets in a round."""


class GarbageSender:
    """Throws at channels of the loopback interface, and beside them.

    Attributes
    ----------
    thrown : int
        Datagrams thrown at each channel, none of which is a frame.
    """

    def __init__(self, channels):
        self._channels = [(group, int(port)) for group, port in (channel.split(":") for channel in channels)]
        self._random = np.random.default_rng(1)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 0)
        self.thrown = 0

    def throw(self):
        """Throw one round."""
        self._through("0.0.0.0")
        with contextlib.suppress(OSError):  # where there is no network
            self._socket.sendto(b"hello", PYTHON_CAN)
        self._through("127.0.0.1")
        for _, port in self._channels:
            self._socket.sendto(bytes(16), ("127.0.0.1", port))  # to the port alone: not to the channel
        for channel in self._channels:
            for datagram in (b"hello", self._random.bytes(40), self._random.bytes(int(self._random.integers(16)))):
                self._socket.sendto(datagram, channel)
        self.thrown += AT_A_CHANNEL

    def _through(self, interface):
        self._socket.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(interface))


def main(channels):
    sender = GarbageSender(channels)
    while not select.select([sys.stdin], [], [], 0.1)[0]:
        sender.throw()
    print(sender.thrown, flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
