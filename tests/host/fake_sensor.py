"""A sensor made of messages: its reports from fields computed by magpylib, and a pseudo-terminal to talk through."""

from __future__ import annotations

import fcntl
import os
import re
import select
import struct
import termios
import threading
import tty
from pathlib import Path

import magpylib
import numpy as np
from scipy.spatial.transform import Rotation

from goldfield_protocol import FrameDecoder, Identifier, decode, encode, encode_frame, protocol_hash

SITE = Path(__file__).parent / "prigge8_site.toml"
NODE = 100
CODES = tuple(range(2, 10))
CYCLE_S = 1023 * 97.75e-6
POSITION_M = np.array([0.9, 1.2, 0.8])
ATTITUDE = Rotation.from_rotvec([0.3, -0.2, 1.1])
EARTH_T = np.array([2.0e-5, 0.0, -4.5e-5])
TOO_SLOW = re.compile(r"goldfield: the lines are more than 1 s late: .*\n")
"""What a command tells on a machine that does much else: no test depends on it."""
CORNERS_M = [(x, y, z) for z in (0.0, 1.78) for x in (0.0, 2.13) for y in (0.0, 2.13)]


def beacon_fields(position_m=POSITION_M, attitude=ATTITUDE):
    """Fields of the eight coils of prigge8 in the sensor's frame, shape (8, 3): true loops."""
    coils = [magpylib.current.Circle(diameter=0.298, current=190.0, position=corner) for corner in CORNERS_M]
    return np.array([attitude.inv().apply(coil.getB(position_m)) for coil in coils])


FIELDS_T = beacon_fields()


def gold_chips(code):
    """Chips of a shift code of degree 10, by two shift registers (IS-GPS-200), stage by stage."""

    def register(taps):
        stages, out = [1] * 10, []
        for _ in range(1023):
            out.append(stages[9])
            stages = [sum(stages[tap - 1] for tap in taps) % 2, *stages[:9]]
        return np.array(out)

    u, v = register((3, 10)), register((2, 3, 6, 8, 9, 10))
    return 1 - 2 * (u ^ v[(np.arange(1023) + code) % 1023])


CHIPS = np.array([gold_chips(code) for code in CODES]).T


def heartbeat(node=NODE, role=1, hash_=None, state=3):
    """A heartbeat as (identifier, data)."""
    signals = {"protocol_hash": protocol_hash() if hash_ is None else hash_, "role": role, "state": state}
    signals |= {"version_major": 0, "version_minor": 1, "version_patch": 0, "errors": 0}
    return encode("HEARTBEAT", signals, node=node)


def cycle_messages(cycle, seed=1, noise_T=2e-7, fields=None, codes=CODES, time_s=None):
    """What a sensor sends of one cycle, from 1023 noisy samples."""
    samples = cycle_samples(cycle, seed, noise_T, FIELDS_T if fields is None else fields)
    low = cycle % 16
    time_s = (cycle + 0.5) * CYCLE_S if time_s is None else time_s
    status = {
        "cycle_low": low,
        "chips": 1023,
        "saturated": 0,
        "fields": len(codes),
        "locked": 1,
        "phase": 0,
        "temperature": 25,
    }
    messages = [
        encode("EPOCH", {"cycle": cycle, "time": time_s}, node=NODE),
        encode("EPOCH_STATUS", status, node=NODE),
        encode("EPOCH_OFFSET", _vector(samples.mean(axis=0)) | {"cycle_low": low}, node=NODE),
    ]
    for place, code in enumerate(codes):
        correlation = CHIPS[:, place] @ samples / 1023
        messages.append(encode("FIELD", _vector(correlation) | {"cycle_low": low}, node=NODE, index=code))
    return messages


def cycle_samples(cycle, seed, noise_T, fields):
    """The samples of a cycle, T, shape (1023, 3)."""
    noise = np.random.default_rng([seed, cycle]).normal(scale=noise_T, size=(1023, 3))
    return CHIPS @ fields + ATTITUDE.inv().apply(EARTH_T) + noise


def block_messages(cycle, seed=1, noise_T=2e-7):
    """What a sensor sends of the 33 blocks of a cycle, a list for each; they are of the samples of `cycle_messages`."""
    samples = cycle_samples(cycle, seed, noise_T, FIELDS_T)
    blocks = []
    for number in range(33):
        part = slice(31 * number, 31 * (number + 1))
        low = {"block_low": (33 * cycle + number) % 16}
        plain = _vector(samples[part].mean(axis=0)) | low | {"cycle_low": cycle % 8}
        sums = CHIPS[part].T @ samples[part] / 31
        blocks.append(
            [encode("BLOCK", plain, node=NODE, index=31 * number)]
            + [encode("BLOCK_SUM", _vector(row) | low, node=NODE, index=c) for c, row in zip(CODES, sums, strict=True)]
        )
    return blocks


def _vector(values):
    return dict(zip("xyz", map(float, values), strict=True))


def candump(messages_by_time):
    """Lines of a candump log of (time, (identifier, data)) pairs."""
    return "".join(f"({t:.6f}) can0 {i:08X}#{d.hex().upper()}\n" for t, (i, d) in messages_by_time)


def log_of(cycles, before=()):
    """A log: these messages, then the cycles."""
    lines = [(0.0, message) for message in before]
    for cycle in cycles:
        lines += [((cycle + 1) * CYCLE_S + i * 1e-4, m) for i, m in enumerate(cycle_messages(cycle))]
    return candump(lines)


class PtySensor:
    """A sensor on a pseudo-terminal, in a thread: heartbeats until it is configured, then some cycles.

    Parameters
    ----------
    cycles : sequence of int
        Sent once ``code_count`` and the code list are as wanted.
    deaf : int
        How many requests it leaves unanswered.
    hang_up : bool
        Close the line after the cycles, once the host has read them: what it has not read goes with the line.
    fields_of : callable, optional
        Returns the fields of a cycle, as `beacon_fields` does; None: the sensor stands still.
    """

    def __init__(
        self, cycles, *, deaf=0, hang_up=False, hash_=None, garbage=b"", parameters=None, refuse=0, fields_of=None
    ):
        self.master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self.master, False)
        self.path = os.ttyname(self._slave)
        self.parameters = {5: 0, **{256 + i: 0 for i in range(64)}} if parameters is None else parameters
        self.parameters.setdefault(28, 10)
        self.parameters.setdefault(46, 0)
        self.requests = []
        self._cycles, self._deaf, self._hang_up, self._garbage = list(cycles), deaf, hang_up, garbage
        self._hash, self._refuse, self._fields_of = hash_, refuse, fields_of
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)

    def __enter__(self):
        self._thread.start()
        return self

    def restart(self, cycles):
        """Forget everything, as a reset does, and say so."""
        self.parameters.update({number: 0 for number in self.parameters if number != 28})
        self.requests.clear()
        self._cycles = list(cycles)
        self._send(heartbeat(state=0))

    def __exit__(self, *_):
        self._stop.set()
        self._thread.join()
        for descriptor in (self.master, self._slave):
            if descriptor is not None:
                os.close(descriptor)

    def _serve(self):
        decoder = FrameDecoder()
        while not self._stop.is_set():
            if not self._heard(decoder, 0.02) and not self._configured() and not self.requests:
                self._send(heartbeat(hash_=self._hash))
            if self._configured() and self._cycles:
                self._write(self._garbage)
                cycle = self._cycles.pop(0)
                for message in cycle_messages(cycle, fields=self._fields_of and self._fields_of(cycle)):
                    self._send(message)
                if not self._cycles and self._hang_up:
                    self._wait_until_read()
                    os.close(self._slave)
                    os.close(self.master)
                    self.master = self._slave = None
                    return
        while self._heard(decoder, 0.0):  # what the host said last
            pass

    def _heard(self, decoder, seconds):
        """Answer what the host says within some time; tell whether it said anything."""
        ready, _, _ = select.select([self.master], [], [], seconds)
        if ready:
            for frame in decoder.feed(os.read(self.master, 4096)):
                self._answer(frame)
        return bool(ready)

    def _wait_until_read(self):
        """Wait until nothing has waited for the host for some time, or until the test is over."""
        quiet = 0
        while quiet < 10 and not self._stop.wait(0.02):
            waiting = struct.unpack("i", fcntl.ioctl(self._slave, termios.FIONREAD, bytes(4)))[0]
            quiet = 0 if waiting else quiet + 1

    def _configured(self):
        wanted = [len(CODES), *CODES]
        have = [self.parameters[5], *(self.parameters[256 + i] for i in range(len(CODES)))]
        # Only when the host has asked at all: the bus must be listening.
        return bool(self.requests) and have == wanted and self.requests[-1] in ("get 5", "set 5")

    def _answer(self, frame):
        identifier = Identifier.unpack(frame.identifier)
        message = decode(frame.identifier, frame.data)
        if self._deaf:
            self._deaf -= 1
            return
        if message.name == "PARAM_SET":
            self.requests.append(f"set {identifier.index}")
            if not self._refuse:
                self.parameters[identifier.index] = int(message.signals["value_unsigned"])
        else:
            self.requests.append(f"get {identifier.index}")
        value = {"kind": 0, "status": self._refuse, "value_unsigned": self.parameters[identifier.index]}
        self._send(encode("PARAM_VALUE", value, node=NODE, index=identifier.index))

    def _send(self, message):
        self._write(encode_frame(*message))

    def _write(self, data):
        """Write to the end, or until the test is over: a host that does not read any more must not hold the thread."""
        while data and not self._stop.is_set():
            if select.select([], [self.master], [], 0.02)[1]:
                data = data[os.write(self.master, data) :]
