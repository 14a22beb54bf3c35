"""The bench's CAN channel: frames both ways, a channel for each bench, strangers counted."""

from __future__ import annotations

import errno
import os
import select

import can
import pytest

from goldfield.errors import SystemFailure, UserError
from goldfield.link.can_channel import open_channel
from goldfield.link.loopback_bus import INTERFACE
from hil_sim.links.can_bridge import MOST_BAD, OWN, QUEUE, CanBridge
from hil_sim.rig import Frame, Rig
from tests.hil_sim.rig.fakes import FakeBoards, small


class Boards:
    """A rig that has some frames to send, and keeps what it gets."""

    host_node = 9

    def __init__(self, *frames):
        self.frames, self.got = list(frames), []

    def can_read(self):
        frames, self.frames = self.frames, []
        return frames

    def can_write(self, identifier, data, *, extended, remote):
        self.got.append((identifier, data, extended, remote))


@pytest.fixture
def bridge():
    made = CanBridge(OWN)
    yield made
    made.close()


def host(bridge):
    """Another program on a bench's channel."""
    return open_channel(*bridge.channel.split(":", 1))


def to_boards(bridge, boards, count):
    """Pass on what has come, until the boards have so many frames: datagrams may arrive after they were sent."""
    while len(boards.got) < count:
        select.select([bridge._bus.fileno()], [], [])
        bridge.to_boards(boards)


def test_round_trip(bridge, tmp_path):
    with host(bridge) as other, Rig(small(tmp_path), FakeBoards()) as rig:
        rig.advance(0.02)
        frames, read = rig.can_read(), rig.can_read
        rig.can_read = lambda: frames
        bridge.to_host(rig)
        rig.can_read = read
        assert len(frames) > 3
        for frame in frames:
            message = other.recv()
            assert (message.arbitration_id, bytes(message.data)) == (frame.identifier, frame.data)
            assert message.is_extended_id
        other.send(can.Message(arbitration_id=0x0C064001, data=b"\x12\x34", is_extended_id=True))
        select.select([bridge._bus.fileno()], [], [])
        bridge.to_boards(rig)
        rig.advance(0.001)
        mine = [frame for frame in rig.can_read() if frame.board == rig.host_node]
        assert [(frame.identifier, frame.data) for frame in mine] == [(0x0C064001, b"\x12\x34")]


def test_only_what_boards_sent_and_somebody_acknowledged_is_passed_on(bridge):
    frames = [Frame(0.1, 1, 0x10, b"", acknowledged=False), Frame(0.2, 9, 0x11, b""), Frame(0.3, 1, 0x12, b"x")]
    with host(bridge) as other:
        bridge.to_host(Boards(*frames))
        assert other.recv().arbitration_id == 0x12
        assert other.recv(0.0) is None


def test_benches_do_not_hear_each_other(bridge):
    neighbour, boards = CanBridge(OWN), Boards()
    with host(bridge) as here, host(neighbour) as there:
        bridge.to_host(Boards(Frame(0.1, 1, 1, b"")))
        neighbour.to_host(Boards(Frame(0.1, 1, 2, b"")))
        assert here.recv().arbitration_id == 1
        assert there.recv().arbitration_id == 2
        for each in (bridge, neighbour):
            each.to_boards(boards)
        assert (here.recv(0.0), there.recv(0.0), boards.got) == (None, None, [])
    neighbour.close()


def test_a_channel_has_one_bench(bridge):
    with pytest.raises(UserError, match=rf"^--can {bridge.channel}: cannot be opened: another bench or program holds"):
        CanBridge(bridge.channel)
    bridge.close()
    CanBridge(bridge.channel).close()


def test_what_is_no_frame_of_can_2_is_counted_and_goes_no_further(bridge):
    boards = Boards()
    with host(bridge) as other:
        for sent in (b"hello", b"", bytes(70)):
            other._out.sendto(sent, other._group)
        other.send(can.Message(is_error_frame=True, data=bytes(8)))
        other.send(can.Message(arbitration_id=0x7FF, is_extended_id=False, is_remote_frame=True))
        to_boards(bridge, boards, 1)
    assert boards.got == [(0x7FF, b"", False, True)]
    assert (bridge.refused, bridge.taken) == (4, 1)


def test_an_adapter_holds_so_many_frames_and_the_channel_the_others(bridge):
    """A flood fills the adapter; each of its frames that was on the bus makes room for the next."""
    boards = Boards()
    with host(bridge) as other:
        for number in range(QUEUE + 10):
            other.send(can.Message(arbitration_id=number))
        to_boards(bridge, boards, QUEUE)
        bridge.to_boards(boards)
        assert len(boards.got) == QUEUE
        boards.frames = [Frame(0.1, boards.host_node, number, b"") for number in range(3)]
        bridge.to_host(boards)
        to_boards(bridge, boards, QUEUE + 3)
        bridge.to_boards(boards)
        assert len(boards.got) == QUEUE + 3
        boards.frames = [Frame(0.1, boards.host_node, number, b"") for number in range(QUEUE)]
        bridge.to_host(boards)
        to_boards(bridge, boards, QUEUE + 10)
    assert [identifier for identifier, *_ in boards.got] == list(range(QUEUE + 10))
    assert bridge.taken == QUEUE + 10


class Channel(can.BusABC):
    """A channel of another interface, which does what a test says."""

    def __init__(self, sending=None, receiving=None):
        super().__init__(channel="test")
        self.sending, self.receiving = sending, receiving

    def send(self, msg, timeout=None):
        if self.sending is not None:
            raise self.sending

    def _recv_internal(self, timeout):
        raise self.receiving


@pytest.fixture
def on(monkeypatch):
    """Return a function that opens a bridge on such a channel."""
    return lambda *what: (
        monkeypatch.setattr("hil_sim.links.can_bridge.open_channel", lambda *_: Channel(*what))
        or CanBridge("other:test")
    )


def test_a_channel_without_room_costs_the_frame(on):
    bridge = on(can.CanOperationError("full", errno.ENOBUFS))
    bridge.to_host(Boards(Frame(0.1, 1, 1, b""), Frame(0.2, 1, 2, b"")))
    assert bridge.lost == 2


def test_a_channel_that_is_gone_ends_the_bench(on):
    bridge = on(can.CanOperationError("no such device", errno.ENODEV))
    with pytest.raises(SystemFailure, match=r"^the CAN channel other:test is gone: no such device"):
        bridge.to_host(Boards(Frame(0.1, 1, 1, b"")))


def test_a_channel_that_gives_nothing_but_errors_does_not_hold_the_bench(on):
    bridge = on(None, can.CanOperationError("could not unpack received message"))
    bridge.to_boards(Boards())
    assert bridge.refused == MOST_BAD


@pytest.mark.parametrize("channel", ["vcan0", "socketcan:", ":can0", ""])
def test_what_is_no_channel_is_refused(channel):
    with pytest.raises(UserError, match=rf"^--can {channel}: is no CAN channel: write own, INTERFACE:CHANNEL or none$"):
        CanBridge(channel)


@pytest.mark.parametrize("channel", ["no_such_interface:0", f"{INTERFACE}:0", "socketcan:no-such"])
def test_a_channel_that_is_not_there_is_an_error(channel):
    with pytest.raises(UserError, match=rf"^--can {channel}: cannot be opened: .*; --can none does without$"):
        CanBridge(channel)


# ---- Groups of python-can, which other programs open by themselves ----


def has_network():
    """Whether this machine has a route for python-can's groups, which it opens on no interface by name."""
    try:
        open_channel("udp_multicast", GROUP).shutdown()
    except can.CanError:
        return False
    return True


GROUP = f"239.192.{os.getpid() >> 8 & 255}.{os.getpid() & 255}"
"""A group of this process: several test runs of one machine must not hear each other."""
needs_network = pytest.mark.skipif(not has_network(), reason="python-can's groups need a network")


@needs_network
def test_a_group_of_python_can_stays_on_this_machine_and_gives_no_echo():
    bridge, boards = CanBridge(f"udp_multicast:{GROUP}"), Boards()
    with open_channel("udp_multicast", GROUP) as other:
        assert bridge._bus._multicast.hop_limit == 0
        bridge.to_host(Boards(Frame(0.1, 1, 0x11, b"x")))
        assert other.recv().arbitration_id == 0x11
        other.send(can.Message(arbitration_id=0x22, data=b"y"))
        to_boards(bridge, boards, 1)
    assert boards.got == [(0x22, b"y", True, False)]
    bridge.close()


@needs_network
def test_a_stray_datagram_does_not_end_it():
    bridge, boards = CanBridge(f"udp_multicast:{GROUP}"), Boards()
    with open_channel("udp_multicast", GROUP) as other:
        other._multicast.send(b"hello")
        other.send(can.Message(arbitration_id=0x22))
        to_boards(bridge, boards, 1)
    assert bridge.refused == 1
    bridge.close()
