"""The WebSocket server: every program gets the poses, a slow one the latest, and no foreign page any."""

import asyncio
import contextlib
import json
import socket
import subprocess
import sys
from functools import partial
from itertools import pairwise

import pytest
from websockets.exceptions import ConnectionClosedOK, InvalidStatus, WebSocketException
from websockets.sync.client import connect

from goldfield.errors import UserError
from goldfield.feeds import websocket
from goldfield.feeds.address import parse_address
from goldfield.feeds.opening import open_feed
from goldfield.feeds.websocket import CAPACITY, Consumer, WebSocketFeed
from goldfield.view.listening import BACKLOG
from hil_sim.clib import ROOT
from tests.host.feeds.made import UNIX_S, pose, setting, stamped

TIMEOUT_S = 60.0
HELLO = -1


@pytest.fixture
def feed():
    served = WebSocketFeed(parse_address("ws://127.0.0.1:0"), setting())
    yield served
    served.close()


@contextlib.contextmanager
def joined(feed, **options):
    """A consumer that the feed is known to serve: it has got a pose."""
    with connect(f"ws://127.0.0.1:{feed.port}", **options) as client:
        while True:
            feed.write(stamped(pose(HELLO)))
            try:
                client.recv(timeout=0.05)
            except TimeoutError:
                continue
            break
        yield client


def epochs(client, last):
    """Every epoch that a consumer gets, without the poses that greeted it, up to the last."""
    got = []
    while not got or got[-1] != last:
        epoch = json.loads(client.recv(timeout=TIMEOUT_S))["epoch"]
        got += [] if epoch == HELLO else [epoch]
    return got


def test_a_pose_is_a_line_of_json(feed):
    with joined(feed) as client:
        feed.write(stamped())
        while (line := client.recv(timeout=TIMEOUT_S)) == stamped(pose(HELLO)).json(UNIX_S + 0.0625):
            pass
    assert line == stamped().json(UNIX_S + 0.0625)


def test_two_consumers_get_every_pose_and_one_that_leaves_is_forgotten(feed):
    with joined(feed) as stays:
        with joined(feed) as leaves:
            for number in range(50):
                feed.write(stamped(pose(number)))
            assert epochs(leaves, 49) == epochs(stays, 49) == list(range(50))
        feed.write(stamped(pose(50)))
        assert epochs(stays, 50) == [50]
    assert feed.dropped == 0


def test_a_consumer_that_does_not_read_loses_the_oldest_poses_and_holds_up_nobody(feed, capsys):
    """Many megabytes, more than the buffers of the system take, are written while one consumer reads nothing."""
    big, last = "x" * 30_000, 1200
    with joined(feed, max_queue=1) as slow, joined(feed) as well:
        for number in range(last):
            feed.write(stamped(pose(number, reason=big)))
            if number % 100 == 99:
                assert epochs(well, number)[-1] == number
        assert feed.dropped > 0
        feed.write(stamped(pose(last)))
        got = epochs(slow, last)
    missed = [after - before - 1 for before, after in pairwise(got) if after != before + 1]
    assert len(missed) >= 1
    assert len(got) + sum(missed) == last + 1
    assert got[-CAPACITY:] == list(range(last - CAPACITY + 1, last + 1))
    assert capsys.readouterr().err.count("a consumer is too slow and misses the oldest poses") >= 1


def test_a_full_queue_loses_its_oldest_line():
    async def filled():
        consumer = Consumer()
        for number in range(CAPACITY + 3):
            consumer.put(str(number))
        return consumer

    consumer = asyncio.run(filled())
    assert list(consumer.lines) == [str(number) for number in range(3, CAPACITY + 3)]
    assert consumer.dropped == 3


def test_what_waits_at_the_end_is_sent_and_then_the_connection_is_closed():
    feed = WebSocketFeed(parse_address("ws://127.0.0.1:0"), setting())
    with joined(feed) as client:
        for number in range(10):
            feed.write(stamped(pose(number)))
        feed.close()
        assert epochs(client, 9) == list(range(10))
        with pytest.raises(ConnectionClosedOK):
            client.recv(timeout=TIMEOUT_S)


@pytest.mark.parametrize(
    ("options", "origin", "served"),
    [
        ("", None, True),
        ("", "http://127.0.0.1:8000", False),
        ("", "https://evil.example", False),
        ("?origin=https://dashboard.example,http://localhost:3000", "http://localhost:3000", True),
        ("?origin=https://dashboard.example", "https://evil.example", False),
        ("?origin=https://dashboard.example", None, True),
    ],
)
def test_pages_are_served_only_if_their_origin_is_named(options, origin, served):
    feed = WebSocketFeed(parse_address(f"ws://127.0.0.1:0{options}"), setting())
    try:
        if served:
            with joined(feed, origin=origin):
                pass
        else:
            with pytest.raises(InvalidStatus, match="403"), connect(f"ws://127.0.0.1:{feed.port}", origin=origin):
                pass
    finally:
        feed.close()


def test_so_many_consumers_are_served_and_the_others_turned_away(feed, capsys, monkeypatch):
    monkeypatch.setattr(websocket, "MOST", 3)
    with contextlib.ExitStack() as stack:
        clients = [stack.enter_context(joined(feed)) for _ in range(3)]
        for _ in range(4):
            with pytest.raises((OSError, WebSocketException)), connect(f"ws://127.0.0.1:{feed.port}"):
                pass
        feed.write(stamped(pose(5)))
        assert [epochs(client, 5) for client in clients] == [[5]] * 3
    told = f"goldfield: {feed._url}: 3 consumers are connected, and no more are let in\n"
    assert capsys.readouterr().err == told
    while True:  # the server learns of those who left in a thread of its own
        with contextlib.suppress(OSError, WebSocketException), joined(feed):
            break


SILENT = """
import contextlib, resource, socket, sys
resource.setrlimit(resource.RLIMIT_NOFILE, (256, 256))
from goldfield.feeds.address import parse_address
from goldfield.feeds.websocket import WebSocketFeed
from tests.host.feeds.made import setting
feed = WebSocketFeed(parse_address("ws://127.0.0.1:0"), setting())
print(feed.port, flush=True)
sys.stdin.readline()
open("/dev/null").close()
feed.close()
"""


def test_a_connection_that_has_said_nothing_does_not_hold_up_the_end(monkeypatch):
    """The end does not wait until the library gives such a one up, as this one never does."""
    monkeypatch.setattr(websocket, "serve", partial(websocket.serve, open_timeout=None))
    feed = WebSocketFeed(parse_address("ws://127.0.0.1:0"), setting())
    with socket.create_connection(("127.0.0.1", feed.port)), joined(feed):  # The second: so the first was taken.
        feed.close()


def test_more_connections_than_the_system_has_files_for_leave_the_run_its_own():
    """Most say nothing; the last of each few is answered or ended, so that all before it were taken."""
    command = [sys.executable, "-c", SILENT]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, cwd=ROOT, stdin=pipe, stdout=pipe, stderr=pipe, text=True) as process:
        port = int(process.stdout.readline())
        with contextlib.ExitStack() as stack:
            for _ in range(400 // BACKLOG):  # More at once would be asked to come again a second later.
                few = [stack.enter_context(socket.create_connection(("127.0.0.1", port))) for _ in range(BACKLOG)]
                with contextlib.suppress(OSError):
                    few[-1].sendall(b"no HTTP\r\n\r\n")
                    few[-1].recv(100)
            _, err = process.communicate("go on\n")
    assert process.returncode == 0
    assert err == "goldfield: ws://127.0.0.1:0: 100 consumers are connected, and no more are let in\n"


def test_it_listens_at_an_address_of_ipv6(capsys):
    feed = open_feed(parse_address("ws://[::1]:0"), setting())
    assert capsys.readouterr().err == f"goldfield: ws://[::1]:0: serves poses at ws://[::1]:{feed.port}\n"
    with connect(f"ws://[::1]:{feed.port}"):
        pass
    feed.close()


def test_a_port_that_is_taken_is_refused(feed):
    with pytest.raises(UserError, match=r"^feed=ws://127\.0\.0\.1:\d+: this machine cannot listen there: Address"):
        WebSocketFeed(parse_address(f"ws://127.0.0.1:{feed.port}"), setting())
