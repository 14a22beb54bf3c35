"""Whatever feed listens: at this machine alone unless it is told otherwise, and it takes nothing from who connects."""

import contextlib
import json
import socket

import pytest
from websockets.sync.client import connect

from goldfield.feeds.address import SERVERS, parse_address
from goldfield.feeds.opening import open_feed
from tests.host.feeds.made import setting
from tests.host.free_port import free_port

PROTOCOLS = {"ws": None, "foxglove": ["foxglove.sdk.v1"]}


def test_each_feed_that_listens_is_tested_here():
    assert set(PROTOCOLS) == set(SERVERS)


@pytest.mark.parametrize(("host", "elsewhere"), [("", False), ("127.0.0.1", False), ("0.0.0.0", True)])
@pytest.mark.parametrize("scheme", SERVERS)
def test_it_listens_at_this_machine_alone_unless_told_otherwise(scheme, host, elsewhere):
    port = free_port()
    with contextlib.closing(open_feed(parse_address(f"{scheme}://{host}:{port}"), setting())):
        with connect(f"ws://127.0.0.1:{port}", subprotocols=PROTOCOLS[scheme]):
            pass
        # This machine by another address, which only a socket for all addresses has.
        with contextlib.nullcontext() if elsewhere else pytest.raises(ConnectionRefusedError):
            socket.create_connection(("127.0.0.2", port)).close()


@pytest.mark.parametrize("scheme", SERVERS)
@pytest.mark.parametrize("beginning", ["POST / HTTP/1.1", "PUT /live HTTP/1.1", "GET / HTTP/1.1", "SET x", "\0\xff"])
def test_what_is_no_websocket_is_answered_with_no_pose(scheme, beginning):
    feed = open_feed(parse_address(f"{scheme}://127.0.0.1:0"), setting())
    with contextlib.closing(feed), socket.create_connection(("127.0.0.1", feed.port)) as other:
        other.sendall(f"{beginning}\r\nHost: 127.0.0.1\r\nContent-Length: 2\r\n\r\n{{}}".encode("latin-1"))
        other.shutdown(socket.SHUT_WR)
        answer = b""
        with contextlib.suppress(ConnectionResetError):
            while part := other.recv(4096):
                answer += part
        assert b" 101 " not in answer
        assert b" 200 " not in answer


def test_foxglove_is_served_to_any_page():
    """Its app is a page itself, from more than one place, and the SDK asks none where it is from: docs/security.md."""
    feed = open_feed(parse_address("foxglove://127.0.0.1:0"), setting())
    words = {"subprotocols": PROTOCOLS["foxglove"], "origin": "https://evil.example"}
    with contextlib.closing(feed), connect(f"ws://127.0.0.1:{feed.port}", **words) as client:
        assert json.loads(client.recv(timeout=60.0))["op"] == "serverInfo"


def test_foxglove_offers_nothing_that_could_be_set():
    """Neither to publish, nor parameters, services, assets or a player: no such capability is told."""
    feed = open_feed(parse_address("foxglove://127.0.0.1:0"), setting())
    with (
        contextlib.closing(feed),
        connect(f"ws://127.0.0.1:{feed.port}", subprotocols=PROTOCOLS["foxglove"]) as client,
    ):
        told = json.loads(client.recv(timeout=60.0))
    assert told["op"] == "serverInfo"
    assert told["capabilities"] == []
