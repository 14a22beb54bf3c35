"""Links between the rig and the host in virtual time, on which frames and bytes can be spoilt."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import can
import numpy as np

from goldfield_protocol import FrameDecoder
from hil_sim.rig import Frame, Rig
from tests.hil.rig_link import RigLink, RigSerialLink

Spoil = Callable[[Any], Any]
Tick = Callable[[], None]


class CanLink(RigLink):
    """The host's adapter on the bus; ``spoil`` takes the frames of a look and returns those that the host gets.

    ``tick`` is called before each look, also while the host waits. ``latest_s`` is when the message came that the host
    got last, on the serial line the end of the look.
    """

    def __init__(self, rig: Rig, tick: Tick) -> None:
        self.spoil: Spoil = sound
        self.latest_s = 0.0
        self._tick = tick
        super().__init__(rig)  # type: ignore[no-untyped-call]

    def receive(self, timeout_s: float) -> can.Message | None:
        """Return the next message; None: none came in time."""
        return _noted(self, super().receive(timeout_s))  # type: ignore[no-untyped-call]

    def _frames(self) -> list[Frame]:
        self._tick()
        return list(self.spoil(super()._frames()))  # type: ignore[no-untyped-call]


class SerialLink(RigSerialLink):
    """The sensor's serial line; as `CanLink`, with the bytes of a look in place of its frames."""

    def __init__(self, rig: Rig, tick: Tick) -> None:
        self.spoil: Spoil = sound
        self.latest_s = 0.0
        self._tick = tick
        super().__init__(rig)  # type: ignore[no-untyped-call]

    @property
    def decoder(self) -> FrameDecoder:
        """What takes the bytes apart, with its counts."""
        return self._decoder  # type: ignore[no-any-return]

    def receive(self, timeout_s: float) -> can.Message | None:
        """Return the next message; None: none came in time."""
        return _noted(self, super().receive(timeout_s))  # type: ignore[no-untyped-call]

    def _frames(self) -> list[Frame]:
        self._tick()
        data = self.spoil(self.rig.serial_read())
        return [Frame(self.rig.now_s, 0, frame.identifier, frame.data) for frame in self._decoder.feed(data)]


def _noted(link: CanLink | SerialLink, message: can.Message | None) -> can.Message | None:
    if message is not None:
        link.latest_s = message.timestamp
    return message


def flipped(share: float, random: np.random.Generator) -> Spoil:
    """Return what flips a random bit in a share of the bytes."""

    def spoil(data: bytes) -> bytes:
        found = np.frombuffer(data, np.uint8).copy()
        hit = random.random(len(found)) < share
        found[hit] ^= np.left_shift(1, random.integers(0, 8, int(hit.sum()))).astype(np.uint8)
        return found.tobytes()

    return spoil


def thinned(share: float, random: np.random.Generator) -> Spoil:
    """Return what loses a share of the bytes, or of the frames."""

    def spoil(data: Any) -> Any:
        kept = random.random(len(data)) >= share
        if isinstance(data, bytes):
            return np.frombuffer(data, np.uint8)[kept].tobytes()
        return [one for one, keep in zip(data, kept, strict=True) if keep]

    return spoil


def doubled(data: Any) -> Any:
    """Return every frame twice, or every byte."""
    if isinstance(data, bytes):
        return np.repeat(np.frombuffer(data, np.uint8), 2).tobytes()
    return [frame for frame in data for _ in range(2)]


def noisy(count: int, random: np.random.Generator) -> Spoil:
    """Return what puts so many random bytes before those of each look."""
    return lambda data: random.bytes(count) + data


def sound(data: Any) -> Any:
    """Return what came."""
    return data


def silent(data: Any) -> Any:
    """Return nothing of the same kind."""
    return data[:0]
