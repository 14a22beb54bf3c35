"""The CAN channel of the loopback interface: frames in, frames out, strangers counted."""

from __future__ import annotations

import contextlib
import shutil
import socket
import struct
import subprocess
import sys
from pathlib import Path

import can
import numpy as np
import pytest

from goldfield.link.can_channel import open_channel
from goldfield.link.loopback_bus import FRAME, LoopbackBus


@pytest.fixture
def bench():
    with LoopbackBus() as made:
        yield made


def reader(bench):
    return open_channel("goldfield_loopback", bench.channel)


def throw(datagram, bench):
    """Send a datagram to a bench's group and port, as a stranger of this machine can."""
    group, port = bench.channel.split(":")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton("127.0.0.1"))
        stranger.sendto(datagram, (group, int(port)))


FRAMES = [
    can.Message(arbitration_id=0x1FFFFFFF, data=bytes(range(8))),
    can.Message(arbitration_id=0, data=b""),
    can.Message(arbitration_id=0x7FF, is_extended_id=False, data=b"\xff"),
    can.Message(arbitration_id=0x123, is_extended_id=False, is_remote_frame=True, dlc=5),
    can.Message(arbitration_id=0x20, is_error_frame=True, is_extended_id=False, data=bytes(8)),
]


@pytest.mark.parametrize("frame", FRAMES, ids=range(len(FRAMES)))
def test_every_kind_of_frame_passes_both_ways(bench, frame):
    with reader(bench) as other:
        for one, two in ((bench, other), (other, bench)):
            one.send(frame)
            assert two.recv().equals(frame, timestamp_delta=None, check_channel=False, check_direction=False)
            assert one.recv(0.0) is None  # nobody gets his own back


def test_frames_stay_in_order_for_every_reader(bench):
    with reader(bench) as one, reader(bench) as two:
        for number in range(100):
            bench.send(can.Message(arbitration_id=number))
        for other in (one, two):
            assert [other.recv().arbitration_id for _ in range(100)] == list(range(100))


def test_a_datagram_of_a_frame_is_linux_can_frame(bench):
    """The layout is that of linux/can.h, with the flag of an extended identifier in the highest bit."""
    throw(struct.pack("<IBBBB8s", 0x80000000 | 0x0C064001, 2, 0, 0, 0, b"\x12\x34"), bench)
    message = bench.recv()
    assert (message.arbitration_id, message.is_extended_id, bytes(message.data)) == (0x0C064001, True, b"\x12\x34")
    assert message.channel == bench.channel


GOOD = FRAME.pack(0x80000001, 2, b"ab")
BAD = {
    "text": b"hello",
    "empty": b"",
    "short": GOOD[:-1],
    "long": GOOD + b"\0",
    "very long": bytes(60_000),
    "nine bytes": FRAME.pack(0x80000001, 9, bytes(8)),
    "padding": GOOD[:6] + b"\1" + GOOD[7:],
    "bytes beyond its length": FRAME.pack(0x80000001, 2, b"abc"),
    "a standard identifier of twelve bits": FRAME.pack(0x800, 0, b""),
    "remote and error": FRAME.pack(0xE0000001, 0, b""),
    "a remote frame with data": FRAME.pack(0xC0000001, 2, b"ab"),
}


@pytest.mark.parametrize("kind", BAD)
def test_a_datagram_that_is_no_frame_is_counted_and_no_more(bench, kind):
    throw(BAD[kind], bench)
    throw(GOOD, bench)
    assert bench.recv().arbitration_id == 1
    assert bench.bad_frames == 1


def test_random_bytes(bench):
    random = np.random.default_rng(1)
    for length in random.integers(0, 40, 60):
        throw(random.bytes(int(length)), bench)
    throw(GOOD, bench)
    assert bench.recv().arbitration_id == 1
    assert bench.bad_frames == 60


def test_a_flood_does_not_hold_who_only_looks(bench, monkeypatch):
    """One call takes so many bad datagrams and no more, however many wait; some may arrive after they were sent."""
    monkeypatch.setattr("goldfield.link.loopback_bus.MOST_IN_A_ROW", 5)
    for _ in range(12):
        throw(b"hello", bench)
    counts = [0]
    while counts[-1] < 12:
        assert bench._recv_internal(0.0) == (None, False)
        counts.append(bench.bad_frames)
    assert max(np.diff(counts)) <= 5


def test_channels_do_not_hear_each_other(bench):
    with LoopbackBus() as neighbour:
        assert neighbour.channel.split(":")[0] != bench.channel.split(":")[0]
        assert neighbour.channel.split(":")[1] != bench.channel.split(":")[1]
        with reader(bench) as here, reader(neighbour) as there:
            bench.send(can.Message(arbitration_id=1))
            neighbour.send(can.Message(arbitration_id=2))
            assert here.recv().arbitration_id == 1
            assert there.recv().arbitration_id == 2
            for bus in (bench, neighbour, here, there):
                assert bus.recv(0.0) is None


def test_what_is_sent_to_the_port_alone_does_not_arrive(bench):
    """A datagram to the port of this machine, which anyone on its network can send, is not one to the group."""
    port = int(bench.channel.split(":")[1])
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.sendto(GOOD, ("127.0.0.1", port))
        with contextlib.suppress(OSError):  # where there is no such address
            stranger.sendto(GOOD, (socket.gethostbyname(socket.gethostname()), port))
    throw(FRAME.pack(0x80000002, 0, b""), bench)
    assert bench.recv().arbitration_id == 2
    assert bench.bad_frames == 0


def test_datagrams_leave_by_the_loopback_interface_with_no_time_to_live(bench):
    option = bench._out.getsockopt
    assert option(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL) == 0
    assert option(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, 4) == socket.inet_aton("127.0.0.1")


def test_a_channel_is_held_once(bench):
    with pytest.raises(can.CanInitializationError, match="another bench or program holds port"):
        LoopbackBus(bench.channel, holds=True)
    with reader(bench), reader(bench):
        pass
    bench.shutdown()
    LoopbackBus(bench.channel, holds=True).shutdown()


NO_PORTS = ["", ":", ":0", ":65536", ":x", ":²", ":" + "9" * 5000]
NO_GROUPS = ["10.0.0.1", "240.0.0.1", "", "ff15::1", "a"]
WRONG = [f"239.74.1.2{port}" for port in NO_PORTS] + [f"{group}:5000" for group in NO_GROUPS]


@pytest.mark.parametrize("channel", WRONG, ids=lambda channel: channel[:20])
def test_a_wrong_channel_is_refused(channel):
    with pytest.raises(can.CanInitializationError, match="write GROUP:PORT, as in 239"):
        LoopbackBus(channel)


def test_a_frame_of_can_fd_is_refused(bench):
    with pytest.raises(can.CanOperationError, match=r"CAN 2\.0 only"):
        bench.send(can.Message(arbitration_id=1, is_fd=True, data=bytes(12)))


ALONE = shutil.which("unshare") is not None and (
    subprocess.run(["unshare", "-rn", "true"], check=False, stderr=subprocess.DEVNULL).returncode == 0
)
TWO_ENDS = """
import can
from goldfield.link.loopback_bus import LoopbackBus
try:
    with LoopbackBus() as bench, LoopbackBus(bench.channel) as reader:
        bench.send(can.Message(arbitration_id=5))
        print(reader.recv().arbitration_id)
except can.CanInitializationError as error:
    print(error)
"""


@pytest.mark.skipif(not ALONE, reason="this machine lets nobody make a network of his own")
@pytest.mark.parametrize(
    ("network", "said"),
    [("ip link set lo up", "5"), ("true", "this machine has no loopback interface that is up (ip link set lo up)")],
)
def test_the_loopback_interface_is_all_that_it_needs(network, said, tmp_path):
    program = tmp_path / "ends.py"
    program.write_text(TWO_ENDS)
    command = ["unshare", "-rn", "sh", "-c", f"{network} && exec {sys.executable} {program}"]
    done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=Path(__file__).parents[3])
    assert done.stdout.strip() == said
