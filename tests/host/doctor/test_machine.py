"""The doctor before any board is heard: installation, permission, port, and a line at another rate."""

from __future__ import annotations

import os
import select
import stat
import termios
import threading
import tty

import pytest

from goldfield import site as sites
from goldfield.doctor import machine
from goldfield.doctor.checks import Fault, State
from goldfield.doctor.examination import Examination
from goldfield.nodes import conversation as conversations
from goldfield_protocol import encode_frame
from tests.host.fake_sensor import SITE, heartbeat

RATES = {termios.B115200: 115_200, termios.B921600: 921_600, termios.B1000000: 1_000_000, termios.B2000000: 2_000_000}


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


def test_the_line_at_its_own_rate_is_heard_as_it_is():
    data = bytes(range(1, 200))
    assert received(data, 2_000_000, 2_000_000) == data
    assert received(data, 115_200, 2_000_000) != data


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


def fault_of(path, kind="port"):
    checks = list(Examination(kind, path, sites.load(SITE)).checks())
    (check,) = (check for check in checks if check.fault is not None)
    assert check.advice
    return check


@pytest.fixture
def impatient(monkeypatch):
    monkeypatch.setattr("goldfield.doctor.examination.LISTEN_S", 0.5)
    monkeypatch.setattr(machine, "RATE_S", 2.0)
    monkeypatch.setattr(conversations.Conversation.listen, "__defaults__", (0.5, 0.5))


@pytest.mark.parametrize("baud", machine.OTHER_RATES[:2])
def test_a_wrong_baud_rate_is_named(baud, impatient, monkeypatch):
    monkeypatch.setattr(machine, "BYTES_S", 10.0)
    with Uart(baud) as board:
        check = fault_of(board.path)
    assert check.fault is Fault.BAUD
    assert f"are right at {baud} baud" in check.text
    assert "2000000 baud" in check.advice


def test_a_line_that_is_right_at_no_rate_is_no_sensors(impatient, monkeypatch):
    monkeypatch.setattr(machine, "RATE_S", 0.05)
    monkeypatch.setattr(machine, "BYTES_S", 10.0)
    with Uart(3_000_000) as board:
        check = fault_of(board.path)
    assert check.fault is Fault.BAUD
    assert "at any other rate" in check.text


def test_a_silent_port(impatient):
    master, slave = os.openpty()
    check = fault_of(os.ttyname(slave))
    assert (check.fault, "no board is heard" in check.text) == (Fault.LINK, True)
    assert "TX and RX" in check.advice
    os.close(master)
    os.close(slave)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can become another user")
def test_no_permission():
    master, slave = os.openpty()
    path = os.ttyname(slave)
    os.chmod(path, stat.S_IRUSR | stat.S_IWUSR | stat.S_IRGRP | stat.S_IWGRP)  # noqa: PTH101
    groups = os.getgroups()
    os.setgroups([])
    os.setegid(65534)
    os.seteuid(65534)
    try:
        check = machine.permission("port", path)
    finally:
        os.seteuid(0)
        os.setegid(0)
        os.setgroups(groups)
    assert check is not None
    assert check.fault is Fault.PERMISSION
    assert check.advice.startswith("sudo usermod -aG ")
    assert machine.permission("port", path) is None
    os.close(master)
    os.close(slave)


def test_without_permission_nothing_is_opened(monkeypatch):
    monkeypatch.setattr(machine, "permission_problem", lambda path: f"you may not open {path}: sudo usermod")
    monkeypatch.setattr(machine, "open_link", lambda *_: pytest.fail("the port was opened"))
    check = fault_of("/dev/ttyUSB0")
    assert (check.fault, check.text, check.advice) == (
        Fault.PERMISSION,
        "you may not open /dev/ttyUSB0",
        "sudo usermod",
    )


def test_a_port_that_is_not_there():
    check = fault_of("/dev/nowhere")
    assert (check.fault, check.text) == (Fault.LINK, "/dev/nowhere: there is no such port")
    assert "goldfield ports" in check.advice


@pytest.mark.parametrize("where", ["nonsense", "nosuch:can0"])
def test_a_bus_that_is_none(where):
    assert fault_of(where, "can").fault is Fault.LINK


def test_a_part_that_is_missing(monkeypatch):
    (check,) = machine.installation()
    assert check.state is State.SOUND
    monkeypatch.setattr(machine, "PARTS", ("goldfield.nowhere",))
    (check,) = machine.installation()
    assert (check.fault, "goldfield.nowhere cannot be loaded" in check.text) == (Fault.INSTALLATION, True)
