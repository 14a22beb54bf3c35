"""Poses by a real MQTT broker: what arrives, what is retained, and a broker that is absent, refuses or goes away."""

import socket
from dataclasses import replace

import pytest

from goldfield.feeds import mqtt
from goldfield.feeds.address import parse_address
from goldfield.feeds.mqtt_access import PASSWORD
from goldfield.feeds.opening import Feeds, open_feed
from tests.host.feeds.broker import Broker, Subscriber, Told, needs_mosquitto
from tests.host.feeds.made import SITE, UNIX_S, epoch, pose, setting, stamped
from tests.host.free_port import free_port

pytestmark = needs_mosquitto


@pytest.fixture
def told(monkeypatch):
    heard = Told()
    monkeypatch.setattr(mqtt, "tell", heard)
    return heard


@pytest.fixture
def broker(tmp_path):
    with Broker(tmp_path) as started:
        yield started


def opened(port, user=""):
    return open_feed(parse_address(f"mqtt://{user}127.0.0.1:{port}/hall/pose"), setting())


def test_poses_are_published_and_whether_somebody_is_there(broker, told):
    with Subscriber(broker.port, "hall/#") as subscriber:
        feed = opened(broker.port)
        assert subscriber.next() == ("hall/pose/online", "true", False)
        for number in range(20):
            feed.write(stamped(pose(number)))
        for number in range(20):
            assert subscriber.next() == ("hall/pose", stamped(pose(number)).json(UNIX_S + 0.0625), False)
        with Subscriber(broker.port, "hall/#") as later:
            assert later.next() == ("hall/pose/online", "true", True)
        feed.close()
        assert subscriber.next() == ("hall/pose/online", "false", False)
    assert feed.dropped == 0
    assert told.texts == []


def test_a_run_that_dies_is_told_by_the_broker(broker, told):
    with Subscriber(broker.port, "hall/#") as subscriber:
        feed = opened(broker.port)
        assert subscriber.next() == ("hall/pose/online", "true", False)
        feed._client.socket().shutdown(socket.SHUT_RDWR)  # without a farewell
        assert subscriber.next() == ("hall/pose/online", "false", False)
        assert subscriber.next() == ("hall/pose/online", "true", False)  # it comes back by itself
        feed.close()


def test_a_broker_that_comes_late_and_goes_away_is_connected_again(tmp_path, told):
    broker = Broker(tmp_path)
    feed = opened(broker.port)
    try:
        told.wait_for("no broker answers there: Connection refused; trying again")
        feed.write(stamped())
        assert feed.dropped == 1
        broker.start()
        told.wait_for("the broker is there")
        broker.end()
        told.wait_for("the broker is gone; trying again")
        feed.write(stamped())
        assert feed.dropped == 2
        broker.start()
        told.wait_for("the broker is there again")
        with Subscriber(broker.port, "hall/pose") as subscriber:
            feed.write(stamped(pose(3)))
            assert subscriber.next()[1] == stamped(pose(3)).json(UNIX_S + 0.0625)
    finally:
        feed.close()
        broker.end()
    assert feed.dropped == 2


@pytest.mark.parametrize(("password", "accepted"), [("right", True), ("wrong", False), (None, False)])
def test_a_password_comes_from_the_environment(tmp_path, told, monkeypatch, password, accepted):
    monkeypatch.delenv(PASSWORD, raising=False)
    if password is not None:
        monkeypatch.setenv(PASSWORD, password)
    with (
        Broker(tmp_path, users={"ann": "right"}) as broker,
        Subscriber(broker.port, "hall/#", "ann", "right") as subscriber,
    ):
        feed = opened(broker.port, "ann@")
        if accepted:
            assert subscriber.next() == ("hall/pose/online", "true", False)
            assert told.texts == []
        else:
            told.wait_for("the broker refuses: Not authorized; trying again")
            feed.write(stamped())
            assert feed.dropped == 1
        feed.close()


def test_a_broker_that_ends_each_connection_at_the_first_message_costs_these_messages_alone(told):
    """Whichever moment the end comes at, a pose is dropped and the feed goes on."""
    with socket.create_server(("127.0.0.1", 0)) as listening:
        feed = opened(listening.getsockname()[1])
        feed._client.reconnect_delay_set(0.001, 0.001)
        for number in range(20):
            connection, _ = listening.accept()
            with connection:
                assert connection.recv(4096)[0] == 0x10  # CONNECT
                connection.sendall(b"\x20\x02\x00\x00")  # CONNACK
                assert connection.recv(4096)  # it is online
                feed.write(stamped(pose(number)))
        assert feed.dropped <= 20
        feed.close()


class Lost:
    """A message whose connection ends right after it was looked at, as in another thread."""

    def is_published(self):
        return False

    def wait_for_publish(self, timeout):
        raise RuntimeError("Message publish failed: The connection was lost.")


def test_a_message_whose_connection_ends_while_it_is_waited_for_is_dropped(broker, told, monkeypatch):
    with Subscriber(broker.port, "hall/#") as subscriber:
        feed = opened(broker.port)
        assert subscriber.next() == ("hall/pose/online", "true", False)
        monkeypatch.setattr(feed._client, "publish", lambda *_, **__: Lost())
        feed.write(stamped())
        assert feed.dropped == 1
        feed.close()


def test_a_network_that_takes_nothing_holds_up_nobody_but_its_own_feed(told):
    """A broker that says welcome and then reads no more: pose after pose is dropped, and none waits in memory."""
    with socket.create_server(("127.0.0.1", 0)) as listening:
        port = listening.getsockname()[1]
        feed = opened(port)
        feeds = Feeds([("mqtt", feed)], SITE.cycle_s, live=True, capacity=5)
        connection, _ = listening.accept()
        with connection:
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            assert connection.recv(4096)[0] == 0x10  # CONNECT
            connection.sendall(b"\x20\x02\x00\x00")  # CONNACK
            assert connection.recv(4096)  # it is online
            number = 0
            while feeds.dropped.get("mqtt", 0) < 50:
                big = epoch(number)
                feeds.write(replace(big, pose=replace(big.pose, reason="x" * 1_000_000)))
                number += 1
            assert len(feed._client._out_packet) <= 1
        feeds.close()
    assert 50 <= feeds.dropped["mqtt"] <= number


def test_a_free_port_has_no_broker(told):
    feed = opened(free_port())
    told.wait_for("no broker answers there: Connection refused; trying again")
    feed.close()
