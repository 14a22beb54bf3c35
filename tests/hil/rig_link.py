"""A simulated bench as a live link in virtual time: the host's adapter on the rig's CAN bus."""

from __future__ import annotations

import dataclasses
from collections import deque

import can

from goldfield.link.buses import BusSource
from goldfield.link.line import FASTEST, Line, Link
from goldfield_protocol import FrameDecoder, encode_frame
from goldfield_protocol.parameters import build_page, parse_page
from hil_sim.rig import Frame
from hil_sim.rig.boards import factory

STEP_S = 0.02


class RigLink(BusSource):
    """Takes the place of a `BusSource` on a rig's bus and, by its `monotonic`, of the module `time`.

    Parameters
    ----------
    rig : Rig
        It runs on while somebody listens.
    others : sequence of (Rig, int)
        Further rigs in step with the first, each with a node whose messages are on the bus, too.
    """

    traffic = {}  # noqa: RUF012 - nothing is counted
    line = FASTEST[Link.CAN]

    def __init__(self, rig, others=()):
        self.name = "rig"
        self.rig = rig
        self._others = others
        self._received = deque()
        self.read()

    def monotonic(self):
        return self.rig.now_s

    def read(self):
        """Throw away what was on the bus so far."""
        self._frames()
        self._received.clear()

    def receive(self, timeout_s):
        until_s = self.rig.now_s + timeout_s
        while not self._received and self.rig.now_s < until_s:
            for rig in (self.rig, *(rig for rig, _ in self._others)):
                rig.advance(STEP_S)
            self._received.extend(sorted(self._frames(), key=lambda frame: frame.time_s))
        if not self._received:
            return None
        frame = self._received.popleft()
        return can.Message(timestamp=frame.time_s, arbitration_id=frame.identifier, data=frame.data)

    def send(self, identifier, data):
        self.rig.can_write(identifier, data)

    def set_bit_rate(self, bit_rate):
        self.line = Line(self.line.link, bit_rate)
        self.rig.can_rate(bit_rate)
        self.read()

    def close(self):
        pass

    def _frames(self):
        frames = self.rig.can_read()
        for rig, node in self._others:
            frames += [frame for frame in rig.can_read() if frame.identifier & 0xFFF == node]
        return frames


class RigSerialLink(RigLink):
    """The serial line of a board, the sensor's if not told, in place of the bus."""

    line = FASTEST[Link.SERIAL]

    def set_bit_rate(self, bit_rate):
        """The rig hears a line at any rate; what it sends has that of the scenario."""
        self.line = Line(Link.SERIAL, bit_rate)

    def __init__(self, rig, board=0):
        self._decoder = FrameDecoder()
        self._board = board
        super().__init__(rig)

    def send(self, identifier, data):
        self.rig.serial_write(encode_frame(identifier, data), self._board)

    def _frames(self):
        return [
            Frame(self.rig.now_s, self._board, frame.identifier, frame.data)
            for frame in self._decoder.feed(self.rig.serial_read(self._board))
        ]


def altered_boards(pages=None, sensor_ppm=None):
    """Return what makes host boards of which some differ from the scenario.

    ``pages`` maps the place of a board (0 is the sensor) to parameters that its page has in place of the scenario's;
    ``sensor_ppm`` is the deviation of the sensor's crystal.
    """
    host_boards = factory("host")

    def board(spec, edge):
        number = int.from_bytes(spec.unique_id[8:], "little")
        if number in (pages or {}):
            page = build_page({**parse_page(spec.parameter_page), **pages[number]})
            spec = dataclasses.replace(spec, parameter_page=page)
        if number == 0 and sensor_ppm is not None:
            spec = dataclasses.replace(spec, clock=dataclasses.replace(spec.clock, crystal_ppm=sensor_ppm))
        return host_boards(spec, edge)

    return board
