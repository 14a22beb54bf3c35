"""The rate of a link: found on a serial line, given by the user, or the kernel's own on CAN."""

from __future__ import annotations

import json
import os
import pty
import subprocess
import tty

import pytest

from goldfield.errors import SystemFailure, UserError
from goldfield.link import can_channel
from goldfield.link.buses import open_can, open_port
from goldfield.link.line import RATES, Line, Link, checked_rate
from goldfield.link.serial_bus import ENOUGH_BYTES, SerialBus
from goldfield_protocol import encode_frame
from tests.host.fake_sensor import heartbeat
from tests.host.uart import Uart, received

SERIAL, CAN = RATES[Link.SERIAL], RATES[Link.CAN]


def test_the_line_at_its_own_rate_is_heard_as_it_is():
    data = bytes(range(1, 200))
    assert received(data, 2_000_000, 2_000_000) == data
    assert received(data, 115_200, 2_000_000) != data


def first(source):
    """The identifier of the first message that comes."""
    message = None
    while message is None:
        message = source.receive(10.0)
    return message.arbitration_id


@pytest.mark.parametrize("baud", SERIAL)
@pytest.mark.parametrize("listen_only", [False, True])
def test_the_rate_of_a_serial_line_is_found_and_said(baud, listen_only, capsys):
    with Uart(baud) as board:
        source = open_port(board.path, listen_only=listen_only)
        assert first(source) == heartbeat()[0]
        assert source.line == Line(Link.SERIAL, baud)
        source.close()
        said = f"goldfield: {board.path}: the frames are right at {baud} baud\n"
        assert capsys.readouterr().err == (said if baud != SERIAL[0] else "")


@pytest.mark.parametrize("baud", SERIAL)
def test_a_rate_that_is_given_is_taken_and_not_looked_for(baud, capsys):
    with Uart(baud) as board:
        source = open_port(board.path, bit_rate=baud)
        assert first(source) == heartbeat()[0]
        source.close()
        assert capsys.readouterr().err == ""
        other = SERIAL[SERIAL.index(baud) - 1]
        source = open_port(board.path, bit_rate=other)
        assert source.receive(0.5) is None
        assert source.line.bit_rate == other
        source.set_bit_rate(baud)
        assert first(source) == heartbeat()[0]
        assert source.line == Line(Link.SERIAL, baud)
        source.close()


def test_a_port_that_is_gone_meanwhile_is_told():
    with Uart(SERIAL[0]) as board:
        source = open_port(board.path, bit_rate=SERIAL[0])
        assert source.virtual  # a pseudo-terminal
    with pytest.raises(SystemFailure, match=board.path):
        source.set_bit_rate(SERIAL[3])
    source.close()


@pytest.fixture
def line():
    master, slave = pty.openpty()
    tty.setraw(slave)
    bus = SerialBus(os.ttyname(slave), SERIAL[0], False, SERIAL[1:])
    yield master, bus
    bus.shutdown()
    os.close(slave)
    os.close(master)


def test_so_many_bytes_without_a_right_frame_are_another_rate(line):
    """Noise at the begin is gone through: the rates are tried again and again."""
    master, bus = line
    os.write(master, b"\x77" * (ENOUGH_BYTES - 1))
    assert bus.recv(0.1) is None
    assert bus.bit_rate == SERIAL[0]
    for rate in (*SERIAL[1:], SERIAL[0], SERIAL[1]):
        os.write(master, b"\x77" * (1 if rate == SERIAL[1] and bus.bit_rate == SERIAL[0] else ENOUGH_BYTES))
        while bus.bit_rate != rate:
            os.write(master, b"\x77")
            assert bus.recv(0.05) is None
    os.write(master, b"\0" + encode_frame(*heartbeat()))
    assert bus.recv(10.0).arbitration_id == heartbeat()[0]
    os.write(master, b"\x77" * 2 * ENOUGH_BYTES)
    assert bus.recv(0.1) is None
    assert bus.bit_rate == SERIAL[1]


@pytest.mark.parametrize(("frames", "found"), [(1, False), (2, True)])
def test_one_frame_that_no_board_sends_may_be_chance(line, frames, found):
    master, bus = line
    os.write(master, b"\0" + encode_frame(0x1FFFFFFF, b"") * frames)
    assert bus.recv(10.0).arbitration_id == 0x1FFFFFFF
    os.write(master, b"\x77" * ENOUGH_BYTES)
    while bus.recv(0.1) is not None:
        pass
    assert (bus.bit_rate == SERIAL[0]) is found


@pytest.mark.parametrize("rate", [0, -1, 10**9, 123_456])
def test_a_rate_that_no_board_has_is_refused_with_those_there_are(rate):
    told = f"bit_rate={rate}: boards speak on "
    with pytest.raises(UserError, match=f"{told}serial at 2000000, 921600, 460800 or 115200 baud$"):
        open_port("/dev/nowhere", bit_rate=rate)
    with pytest.raises(UserError, match=f"{told}CAN at 1000000, 500000, 250000 or 125000 bit/s$"):
        open_can("virtual:none", bit_rate=rate)


@pytest.mark.parametrize(("link", "other"), [(Link.CAN, Link.SERIAL), (Link.SERIAL, Link.CAN)])
def test_each_link_has_its_own_rates(link, other):
    for rate in RATES[link]:
        assert checked_rate(link, rate) == rate
        with pytest.raises(UserError):
            checked_rate(other, rate)


@pytest.mark.parametrize("rate", CAN)
def test_a_virtual_bus_has_the_rate_that_is_said(rate):
    source = open_can("virtual:rates", bit_rate=rate)
    assert source.line == Line(Link.CAN, rate)
    source.set_bit_rate(CAN[0])
    assert source.line == Line(Link.CAN, CAN[0])
    source.close()
    source = open_can("virtual:rates")
    assert source.line == Line(Link.CAN, CAN[0])
    assert source.virtual
    source.close()


class Kernel:
    """The kernel's word on an interface, and a bus in its place."""

    def __init__(self, monkeypatch, told):
        self.opened = []
        monkeypatch.setattr(can_channel.subprocess, "run", lambda *_, **__: self._ran(told))
        monkeypatch.setattr("goldfield.link.buses.open_channel", self._open)

    @staticmethod
    def _ran(told):
        if isinstance(told, Exception):
            raise told
        return subprocess.CompletedProcess([], 0, told, "")

    def _open(self, interface, channel, **options):
        self.opened.append(options["bitrate"])
        return can_channel.can.Bus(interface="virtual", channel="kernel")


@pytest.mark.parametrize(("given", "refused"), [(None, False), (250_000, False), (500_000, True)])
def test_the_rate_of_a_kernels_interface_is_its_own(monkeypatch, given, refused):
    told = json.dumps([{"linkinfo": {"info_kind": "can", "info_data": {"bittiming": {"bitrate": 250_000}}}}])
    kernel = Kernel(monkeypatch, told)
    if refused:
        with pytest.raises(UserError, match="the kernel runs can0 at 250000 bit/s: sudo ip link set can0 down, then"):
            open_can("socketcan:can0", bit_rate=given)
        assert kernel.opened == []
        return
    source = open_can("socketcan:can0", bit_rate=given)
    assert source.line == Line(Link.CAN, 250_000)
    assert kernel.opened == [250_000]
    with pytest.raises(UserError, match="the kernel runs can0 at 250000 bit/s"):
        source.set_bit_rate(500_000)
    assert source.line == Line(Link.CAN, 250_000)
    assert kernel.opened == [250_000] * 2, "it is open as it was"
    source.send(1, b"")
    source.close()


@pytest.mark.parametrize(("given", "expected"), [(None, 1_000_000), (250_000, 250_000)])
def test_an_adapter_is_told_the_rate(monkeypatch, given, expected):
    kernel = Kernel(monkeypatch, AssertionError("the kernel was asked"))
    source = open_can("slcan:/dev/ttyACM0", bit_rate=given)
    source.set_bit_rate(125_000)
    assert kernel.opened == [expected, 125_000]
    assert source.line == Line(Link.CAN, 125_000)
    source.close()


@pytest.mark.parametrize(
    "told",
    [
        FileNotFoundError("ip"),
        subprocess.CalledProcessError(1, "ip"),
        subprocess.TimeoutExpired("ip", 5.0),
        "no JSON",
        "[]",
        "[{}]",
        "null",
        '[{"linkinfo": {"info_kind": "vcan"}}]',
        '[{"linkinfo": {"info_data": {"bittiming": {"bitrate": "many"}}}}]',
    ],
)
def test_a_kernel_that_tells_no_rate_is_believed_whatever_is_given(monkeypatch, told):
    kernel = Kernel(monkeypatch, told)
    for given, expected in ((None, CAN[0]), (125_000, 125_000)):
        source = open_can("socketcan:vcan0", bit_rate=given)
        assert source.line.bit_rate == expected == kernel.opened[-1]
        assert source.virtual
        source.close()


@pytest.mark.parametrize(
    ("name", "virtual"),
    [("socketcan:can0", False), ("socketcan:vcan1", True), ("socketcan:vxcan0", True), ("slcan:/dev/vcan", False)],
)
def test_whose_boards_keep_their_rate(monkeypatch, name, virtual):
    Kernel(monkeypatch, "[]")
    source = open_can(name)
    assert source.virtual == virtual
    source.close()
