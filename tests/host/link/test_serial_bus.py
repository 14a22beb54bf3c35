"""The serial link on a pseudo-terminal."""

import contextlib
import os
import pty
import termios
import tty

import can
import pytest

from goldfield.link.serial_bus import SerialBus
from goldfield_protocol import FrameDecoder, encode_frame


@contextlib.contextmanager
def line():
    """A pseudo-terminal: the board's end as a descriptor, the host's end as a path."""
    master, slave = pty.openpty()
    tty.setraw(slave)
    closed = []
    try:
        yield master, os.ttyname(slave), lambda: closed.append(os.close(slave) or os.close(master))
    finally:
        if not closed:
            os.close(slave)
            os.close(master)


def received(bus, last):
    """Return what arrives up to the message with this identifier."""
    messages = []
    while not messages or messages[-1][0] != last:
        message = bus.recv()
        messages.append((message.arbitration_id, bytes(message.data)))
    return messages


def test_it_is_found_by_its_name_in_python_can():
    with line() as (master, path, _), can.Bus(interface="goldfield_serial", channel=path) as bus:
        assert isinstance(bus, SerialBus)
        os.write(master, encode_frame(0x1FFFFFFF, b"\0\1\2"))
        message = bus.recv()
        assert message is not None
        assert (message.arbitration_id, bytes(message.data), message.is_extended_id) == (0x1FFFFFFF, b"\0\1\2", True)
        assert bus.recv(0.0) is None


def test_what_is_sent_arrives_behind_a_flush():
    with line() as (master, path, _), SerialBus(path) as bus:
        bus.send(can.Message(arbitration_id=0x0E100064, data=b"\0" * 5, is_extended_id=True))
        bus.send(can.Message(arbitration_id=3, data=b"", is_extended_id=True))
        decoder, frames = FrameDecoder(), []
        while len(frames) < 2:
            frames += decoder.feed(os.read(master, 100))
        assert [(f.identifier, f.data) for f in frames] == [(0x0E100064, b"\0" * 5), (3, b"")]
        assert decoder.malformed == 0


def test_frames_that_the_line_cannot_carry_are_refused():
    with line() as (_, path, _), SerialBus(path) as bus:
        for message in (
            can.Message(arbitration_id=3, is_extended_id=False),
            can.Message(arbitration_id=3, is_remote_frame=True),
            can.Message(arbitration_id=3, is_fd=True, data=b"0123456789ab"),
        ):
            with pytest.raises(can.CanOperationError, match="extended data frames"):
                bus.send(message)


def test_bad_frames_cost_only_themselves_and_are_counted():
    good = [encode_frame(i, bytes([i])) for i in range(1, 5)]
    flipped = bytearray(good[0])
    flipped[2] ^= 0x40
    with line() as (master, path, _), SerialBus(path) as bus:
        os.write(
            master,
            good[0] + bytes(flipped) + good[1] + b"\x77" * 40 + b"\0" + good[2][3:] + good[2] + good[2] + good[3],
        )
        assert [i for i, _ in received(bus, last=4)] == [1, 2, 3, 3, 4]
        assert bus.bad_frames == 3


def test_beginning_to_listen_in_the_middle_of_a_frame_is_no_fault():
    with line() as (master, path, _), SerialBus(path) as bus:
        os.write(master, encode_frame(1, b"torn")[4:])
        os.write(master, encode_frame(2, b""))
        assert received(bus, last=2) == [(2, b"")]
        assert bus.bad_frames == 0


def test_a_pulled_cable_is_told():
    with line() as (_, path, hang_up):
        bus = SerialBus(path)
        hang_up()
        with pytest.raises(can.CanOperationError, match=f"{path}: the port is gone"):
            bus.recv()
        with pytest.raises(can.CanOperationError, match=f"{path}: the port is gone"):
            bus.send(can.Message(arbitration_id=1, is_extended_id=True))
        bus.shutdown()


def test_ports_that_cannot_be_opened(tmp_path):
    (tmp_path / "file").write_text("")
    for path, words in (
        ("/dev/no-such-port", "no such port"),
        (tmp_path, "is a directory"),
        (tmp_path / "file", "is no serial port"),
    ):
        with pytest.raises(can.CanInitializationError, match=words):
            SerialBus(str(path))


def test_a_port_in_use_is_refused():
    with line() as (_, path, _), SerialBus(path), pytest.raises(can.CanInitializationError, match="in use"):
        SerialBus(path)


def test_a_port_is_left_as_it_was_found():
    """A pseudo-terminal as a shell has it: lines, echo, and another speed."""
    master, slave = pty.openpty()
    before = termios.tcgetattr(slave)
    assert before[3] & termios.ECHO
    bus = SerialBus(os.ttyname(slave))
    assert not termios.tcgetattr(slave)[3] & termios.ECHO
    bus.shutdown()
    assert termios.tcgetattr(slave) == before
    os.close(master)
    os.close(slave)


def test_a_pseudo_terminal_waits_until_it_is_read_and_is_known_behind_a_link(tmp_path):
    with line() as (_, path, _):
        (tmp_path / "sensor").symlink_to(path)
        for name in (path, str(tmp_path / "sensor")):
            with SerialBus(name) as bus:
                assert bus.sender_waits
