"""The Foxglove server as a client sees it: by its WebSocket protocol, decoded by protobuf, not by the SDK."""

import base64
import contextlib
import json
import math
import socket
import struct

import mcap.records
import numpy as np
import pytest
from mcap_protobuf.decoder import DecoderFactory
from websockets.sync.client import connect

from goldfield.errors import UserError
from goldfield.feeds.address import parse_address
from goldfield.feeds.foxglove import BACKLOG, FoxgloveFeed
from goldfield.feeds.opening import open_feed
from goldfield.feeds.stamped import StampedPose
from goldfield.foxglove.topics import LINE
from goldfield.view.lines import Line
from tests.host.feeds import made
from tests.host.feeds.made import UNIX_S, epoch, failed, pose, setting, stamped

TIMEOUT_S = 60.0
TOPICS = {"/goldfield/line", "/goldfield/pose", "/goldfield/pose_covariance", "/tf", "/goldfield/scene"}
TOPICS |= {"/goldfield/fields", "/goldfield/health", "/goldfield/log"}


def of_epoch(number):
    """An epoch on its way to a feed, measured so many cycles later."""
    item = epoch(number)
    return StampedPose(Line(item.pose, item, 0, math.nan), UNIX_S + number * made.SITE.cycle_s)


class Client:
    """A client that subscribes to every topic that there is."""

    def __init__(self, socket):
        self._socket = socket
        self._decoders = {}

    def subscribe(self, topics=TOPICS):
        while self.channels() != TOPICS:
            message = json.loads(self._socket.recv(timeout=TIMEOUT_S))
            for channel in message.get("channels", ()):
                self._decoders[channel["id"]] = (channel["topic"], decoder_of(channel))
        chosen = [number for number, (topic, _) in self._decoders.items() if topic in topics]
        wanted = [{"id": number, "channelId": number} for number in chosen]
        self._socket.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))

    def channels(self):
        return {topic for topic, _ in self._decoders.values()}

    def next(self):
        """Return topic, log time in nanoseconds and message of the next one."""
        while isinstance(data := self._socket.recv(timeout=TIMEOUT_S), str):
            pass
        code, number, nanoseconds = struct.unpack_from("<BIQ", data)
        assert code == 1
        topic, decoder = self._decoders[number]
        return topic, nanoseconds, decoder(data[13:])


def decoder_of(channel):
    if channel["encoding"] == "json":
        return json.loads
    data = base64.b64decode(channel["schema"])
    schema = mcap.records.Schema(id=1, name=channel["schemaName"], encoding=channel["schemaEncoding"], data=data)
    return DecoderFactory().decoder_for("protobuf", schema)


@pytest.fixture
def feed():
    served = FoxgloveFeed(parse_address("foxglove://127.0.0.1:0"), setting())
    yield served
    served.close()


@contextlib.contextmanager
def client_of(feed, topics=TOPICS, **options):
    """A client whose subscriptions the server is known to have."""
    feed.write(of_epoch(0))
    with connect(f"ws://127.0.0.1:{feed.port}", subprotocols=["foxglove.sdk.v1"], **options) as socket:
        client = Client(socket)
        client.subscribe(topics)
        while not all(feed._channels.wanted(topic) for topic in topics):
            pass  # the server takes the subscriptions in a thread of its own
        yield client


def until(client, wanted):
    """Every message by topic, up to one of a topic."""
    found = {}
    while wanted not in found:
        topic, nanoseconds, message = client.next()
        found.setdefault(topic, []).append((nanoseconds, message))
    return found


def test_every_pose_has_place_frames_covariance_and_times(feed):
    with client_of(feed) as client:
        feed.write(of_epoch(20))
        found = until(client, "/goldfield/pose_covariance")
    stamp_s = UNIX_S + 20 * made.SITE.cycle_s
    ((came_ns, odometry),) = found["/goldfield/pose_covariance"]
    assert came_ns == 1_700_000_000_312_500_000
    assert odometry.timestamp.seconds + 1e-9 * odometry.timestamp.nanos == pytest.approx(stamp_s, abs=1e-6)
    assert (odometry.frame_id, odometry.body_frame_id) == ("map", "sensor")
    place = odometry.pose.position
    assert np.allclose([place.x, place.y, place.z], made.POSITION_M)
    covariance = np.reshape(odometry.pose_covariance, (6, 6))
    assert np.allclose(covariance[3:, 3:], made.ATTITUDE_COV_RAD2)
    ((_, line),) = found["/goldfield/line"]
    assert line["unix_s"] == pytest.approx(stamp_s)
    assert line["latency_s"] == pytest.approx(UNIX_S + 0.0625 - stamp_s)
    assert set(found) >= {"/goldfield/line", "/tf", "/goldfield/pose", "/goldfield/fields", "/goldfield/scene"}


def test_the_scene_comes_again_for_clients_that_came_later(feed):
    with client_of(feed) as client:
        for number in range(20, 45):
            feed.write(of_epoch(number))
        feed.write(stamped(pose(reason="the end")))
        found = until(client, "/goldfield/log")
    names = [{entity.id for entity in scene.entities} for _, scene in found["/goldfield/scene"]]
    coils = [one for one in names if len(one) > 1]
    assert len(coils) == 3, "once a second"
    assert all(any("b1" in name for name in one) for one in coils)


def test_a_pose_without_a_place_is_told_as_a_line_and_in_the_log(feed):
    with client_of(feed) as client:
        feed.write(stamped(failed()))
        found = until(client, "/goldfield/log")
    ((_, log),) = found["/goldfield/log"]
    assert log.message == "failed: no beacon was heard"
    assert found["/goldfield/line"][0][1]["position_m"] is None
    assert "/goldfield/pose" not in found


def test_a_client_that_does_not_read_misses_the_oldest_and_then_gets_the_newest_in_order(feed):
    """Many megabytes, more than the buffers of the system take, are written while the client reads nothing."""
    big, last = "x" * 30_000, 1500
    with client_of(feed, {LINE}, max_queue=1) as client:
        for number in range(1, last + 1):
            feed.write(stamped(pose(number, reason=big)))
        got = [0]
        while got[-1] != last:
            got.append(client.next()[2]["epoch"])
    assert got == sorted(set(got)), "never an older one behind a newer"
    assert len(got) < last, "some are lost"
    assert got[-BACKLOG:] == list(range(last - BACKLOG + 1, last + 1))


def test_a_place_that_is_taken_is_refused(feed):
    with pytest.raises(
        UserError, match=r"^feed=foxglove://127\.0\.0\.1:\d+: this machine cannot listen there: .*in use"
    ):
        open_feed(parse_address(f"foxglove://127.0.0.1:{feed.port}"), setting())


def test_it_tells_where_it_listens(capsys):
    feed = open_feed(parse_address("foxglove://:0"), setting())
    feed.close()
    assert capsys.readouterr().err == f"goldfield: foxglove://:0: serves Foxglove at ws://127.0.0.1:{feed.port}\n"


def test_a_connection_that_says_nothing_does_not_hold_up_the_end():
    """The SDK's server waits for such a one for ever."""
    feed = open_feed(parse_address("foxglove://127.0.0.1:0"), setting())
    with socket.create_connection(("127.0.0.1", feed.port)):
        with connect(f"ws://127.0.0.1:{feed.port}", subprotocols=["foxglove.sdk.v1"]):
            pass  # The first has been taken, too.
        feed.close()
