"""A live link beside whatever else is on it: counted by kind and gone on; only a link that is dead ends it."""

import os
import queue
import threading
import tty
from types import SimpleNamespace

import can
import pytest
from can.interfaces.slcan import slcanBus
from can.interfaces.udp_multicast import UdpMulticastBus
from can.interfaces.udp_multicast.utils import pack_message

from goldfield.errors import SystemFailure, UserError
from goldfield.link import buses
from goldfield.link.buses import BusSource, LogSource, open_can, open_port
from goldfield.link.recordings import CandumpReader
from goldfield.link.traffic import CORRUPT, ELEVEN_BIT, ERROR, FD, GARBLED, REMOTE
from goldfield_protocol import encode_frame

GOOD = can.Message(arbitration_id=0x08000064, is_extended_id=True, data=bytes(8))
HANGS_S = 60.0
"""What has not come after so long does not come."""
OTHERS = {
    ELEVEN_BIT: can.Message(arbitration_id=0x123, is_extended_id=False, data=b"\xde\xad"),
    REMOTE: can.Message(arbitration_id=0x18DAF110, is_remote_frame=True, dlc=8),
    ERROR: can.Message(is_error_frame=True),
    FD: can.Message(arbitration_id=0x7A1, is_extended_id=False, is_fd=True, data=bytes(64)),
}


class ScriptedBus:
    """A bus that receives these things one after the other: messages, errors that are raised, and nothing."""

    def __init__(self, *script):
        self._script = list(script)
        self._rest = threading.Event()
        self.sent = []

    def recv(self, timeout):
        if not self._script:
            self._rest.wait(timeout)
            return None
        item = self._script.pop(0)
        if isinstance(item, BaseException):
            raise item
        return item

    def send(self, message, timeout):
        self.sent.append(message)

    def shutdown(self):
        self._rest.set()


def counted(source):
    return {kind: count for kind, count in source.traffic.items() if count}


@pytest.mark.parametrize("kind", OTHERS)
def test_frames_that_are_never_ours_are_counted_by_kind(kind, tmp_path):
    source = BusSource(ScriptedBus(OTHERS[kind], OTHERS[kind], GOOD), "bus")
    assert source.receive(HANGS_S) is GOOD
    assert counted(source) == {kind: 2}
    source.close()

    with can.Logger(tmp_path / "x.log") as writer:
        for message in (OTHERS[kind], GOOD, OTHERS[kind]):
            writer.on_message_received(message)
    log = LogSource(CandumpReader(tmp_path / "x.log"))
    first = log.receive(0.0)
    assert (first.arbitration_id, first.data, log.receive(0.0)) == (GOOD.arbitration_id, GOOD.data, None)
    assert counted(log) == {kind: 2}


def udp_bus(*datagrams):
    """python-can's own bus, with these datagrams in place of the network's."""
    bus = UdpMulticastBus.__new__(UdpMulticastBus)
    left = [(data, ("127.0.0.1", 1), 1.0) for data in datagrams]
    bus._multicast = SimpleNamespace(recv=lambda timeout: left.pop(0) if left else None, shutdown=lambda: None)
    bus._can_protocol = can.CanProtocol.CAN_FD
    bus._filters = None
    bus._is_shutdown = False
    return bus


@pytest.mark.parametrize(
    "datagram", [b"hello", b"", b"\xc1", b"\x81\xa1x\x01", pack_message(GOOD)[:-3], b"\xff" * 4096]
)
def test_a_strangers_datagram_costs_nothing(datagram):
    source = BusSource(udp_bus(datagram, pack_message(GOOD)), "udp")
    message = source.receive(HANGS_S)
    assert (message.arbitration_id, bytes(message.data)) == (GOOD.arbitration_id, bytes(GOOD.data))
    assert counted(source) == {GARBLED: 1}
    source.close()


@pytest.mark.parametrize(
    "line", [b"T0800\r", b"T0800006480zz\r", b"\xff\xfe\x80\r", b"tXYZ1\r", b"D08000064Z\r", b"R\r"]
)
def test_a_garbled_line_of_slcan_costs_that_line(line):
    master, slave = os.openpty()
    tty.setraw(slave)
    source = BusSource(slcanBus(os.ttyname(slave), sleep_after_open=0.0), "slcan")
    os.write(master, line + line + b"T0800006480102030405060708\r")
    message = source.receive(HANGS_S)
    assert (message.arbitration_id, bytes(message.data)) == (0x08000064, bytes(range(1, 9)))
    assert counted(source) == {GARBLED: 2}
    source.close()
    os.close(master)
    os.close(slave)


def test_a_dead_link_ends_it():
    for error in (
        OSError(100, "Network is down"),
        can.CanOperationError("adapter unplugged"),
        RuntimeError("out of handles"),
    ):
        source = BusSource(ScriptedBus(GOOD, error), "bus")
        assert source.receive(HANGS_S) is GOOD
        for _ in range(2):
            with pytest.raises(SystemFailure, match="bus: the link failed"):
                source.receive(HANGS_S)
        source.close()
    down = can.CanOperationError("could not receive")
    down.__cause__ = OSError(19, "No such device")
    source = BusSource(ScriptedBus(down), "bus")
    with pytest.raises(SystemFailure, match="could not receive"):
        source.receive(HANGS_S)
    source.close()


def test_what_came_while_the_process_was_stopped_is_not_taken_for_silence():
    """The wait is over when the process goes on; the thread has not looked at the link yet."""
    held = threading.Event()
    bus = ScriptedBus(None, GOOD)
    scripted = bus.recv

    def recv(timeout):
        held.wait()
        return scripted(timeout)

    bus.recv = recv
    source = BusSource(bus, "bus")
    inner = source._queue

    class Late:
        """The queue as the main thread sees it: empty at the end of the wait, whatever it holds a moment later."""

        put = inner.put

        def get(self, timeout):
            if not held.is_set():
                held.set()
                raise queue.Empty
            return inner.get(timeout=timeout)

    source._queue = Late()
    assert source.receive(0.0) is GOOD
    source.close()


def test_a_silent_link_is_silent_though_garbage_comes():
    garbage = [ValueError("no frame")] * 5
    source = BusSource(ScriptedBus(*garbage), "bus")
    assert source.receive(0.0) is None
    assert set(counted(source)) <= {GARBLED}
    source.close()


def test_what_is_sent_and_comes_back_is_no_other_hosts():
    bus = ScriptedBus()
    source = BusSource(bus, "bus")
    source.send(0x0D002007, b"\0")
    echo = can.Message(arbitration_id=0x0D002007, is_extended_id=True, data=b"\0")
    bus._script += [echo, echo]
    assert source.receive(HANGS_S) is echo, "the second is another host's"
    assert source.receive(0.0) is None
    source.close()


def test_a_link_that_is_only_listened_to_sends_nothing():
    master, slave = os.openpty()
    tty.setraw(slave)
    os.set_blocking(master, False)
    source = open_port(os.ttyname(slave), listen_only=True)
    with pytest.raises(SystemFailure, match="nothing is sent to a link that is only listened to"):
        source.send(3, b"")
    os.write(master, b"\0" + encode_frame(5, b"x"))
    assert source.receive(HANGS_S).arbitration_id == 5
    source.close()
    with pytest.raises(BlockingIOError):
        os.read(master, 100)
    os.close(master)
    os.close(slave)
    source = open_can("virtual:quiet", listen_only=True)
    with pytest.raises(SystemFailure, match="only listened to"):
        source.send(3, b"")
    source.close()


def test_a_port_that_is_gone_is_waited_for(tmp_path, monkeypatch, capsys):
    port = tmp_path / "port"

    def plug():
        master, slave = os.openpty()
        tty.setraw(slave)
        port.symlink_to(os.ttyname(slave))
        return master, slave

    def unplug(ends):
        port.unlink()
        for end in ends:
            os.close(end)

    absent, ends = [], list(plug())
    source = open_port(str(port), reconnect=True)
    os.write(ends[0], b"\0\x07\x07\0" + encode_frame(1, b""))
    assert source.receive(HANGS_S).arbitration_id == 1
    unplug(ends)

    def sleep(seconds):
        absent.append(seconds)
        if len(absent) == 3:
            ends[:] = plug()

    monkeypatch.setattr(buses, "time", SimpleNamespace(sleep=sleep, monotonic=lambda: 10.0 * len(absent)))
    assert source.receive(HANGS_S) is None
    os.write(ends[0], encode_frame(2, b""))
    assert source.receive(HANGS_S).arbitration_id == 2
    assert (len(absent), source.reconnections) == (3, 1)
    assert source.traffic[CORRUPT] == 1, "those of before are not forgotten"
    err = capsys.readouterr().err
    assert f"{port}: the port is gone" in err
    assert "waiting for it" in err
    assert f"{port}: is back after 30.0 s" in err
    source.close()
    unplug(ends)
    with pytest.raises(UserError, match="no such port"):
        open_port(str(port), reconnect=True)
