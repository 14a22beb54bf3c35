"""TLS and passwords with a real MQTT broker and an authority of our own: who gets in, and what the others are told."""

import re
import socket
import subprocess

import pytest

from goldfield.errors import UserError
from goldfield.feeds import mqtt
from goldfield.feeds.address import parse_address
from goldfield.feeds.mqtt_access import LONGEST_PASSWORD, PASSWORD, password_of, tls_of
from goldfield.feeds.opening import open_feed
from tests.host.feeds.broker import Broker, Certificates, Subscriber, Told, needs_mosquitto, needs_openssl
from tests.host.feeds.made import UNIX_S, setting, stamped

pytestmark = [needs_mosquitto, needs_openssl]


@pytest.fixture(scope="module")
def ours(tmp_path_factory):
    return Certificates(tmp_path_factory.mktemp("tls") / "ours")


@pytest.fixture(scope="module")
def theirs(tmp_path_factory):
    return Certificates(tmp_path_factory.mktemp("tls") / "theirs")


@pytest.fixture
def told(monkeypatch):
    heard = Told()
    monkeypatch.setattr(mqtt, "tell", heard)
    return heard


def opened(port, options, host="localhost", scheme="mqtts", user=""):
    return open_feed(parse_address(f"{scheme}://{user}{host}:{port}/hall/pose{options}"), setting())


def arrives(feed, subscriber):
    """Tell whether a pose of a feed arrives."""
    assert subscriber.next() == ("hall/pose/online", "true", False)
    feed.write(stamped())
    return subscriber.next() == ("hall/pose", stamped().json(UNIX_S + 0.0625), False)


def test_poses_go_by_tls_with_a_password_and_a_certificate(tmp_path, told, ours):
    secret = tmp_path / "a+b secret"
    secret.write_text("right\n")
    with (
        Broker(tmp_path, {"ann": "right"}, ours, wants_certificate=True) as broker,
        Subscriber(broker.port, "hall/#", "ann", "right", tls=ours) as subscriber,
    ):
        options = f"?ca={ours.authority}&cert={ours.client}&key={ours.client_key}&password_file={secret}"
        feed = opened(broker.port, options, user="ann@")
        assert arrives(feed, subscriber)
        feed.close()
    assert (feed.dropped, told.texts) == (0, [])


FOREIGN = (
    r"not trusted \((unable to get local issuer|self.signed) certificate.*\): name its authority's file as ca=FILE"
)
MISMATCH = r"not trusted \(IP address mismatch.*'127\.0\.0\.1'\): use a name that its certificate has"


@pytest.mark.parametrize(
    ("authority", "host", "said"),
    [("theirs", "localhost", FOREIGN), (None, "localhost", FOREIGN), ("ours", "127.0.0.1", MISMATCH)],
)
def test_a_broker_that_is_not_who_it_should_be_gets_nothing(tmp_path, told, request, ours, authority, host, said):
    options = "" if authority is None else f"?ca={request.getfixturevalue(authority).authority}"
    with Broker(tmp_path, tls=ours) as broker, Subscriber(broker.port, "hall/#", tls=ours) as subscriber:
        feed = opened(broker.port, options, host)
        text = told.wait_for("; trying again")
        feed.write(stamped())
        feed.close()
        assert subscriber.messages.empty()
    assert re.fullmatch(rf"mqtts://{host}:\d+/hall/pose\S*: the broker's certificate is {said}; trying again", text)
    assert feed.dropped == 1


def test_a_broker_that_speaks_no_tls_is_told(tmp_path, told, ours):
    with Broker(tmp_path) as broker:
        feed = opened(broker.port, f"?ca={ours.authority}")
        told.wait_for(": what is there ends the connection: it may speak no TLS, as mqtt://; trying again")
        feed.close()


def test_what_is_no_broker_is_told(told, ours):
    with socket.create_server(("127.0.0.1", 0)) as listening:
        feed = opened(listening.getsockname()[1], f"?ca={ours.authority}")
        connection, _ = listening.accept()
        with connection:
            connection.recv(4096)
            connection.sendall(b"SSH-2.0-OpenSSH_9.2\r\n")
            told.wait_for(": no TLS can be spoken with what is there (wrong version number); trying again")
        feed.close()


@pytest.mark.parametrize("scheme", ["mqtt", "mqtts"])
def test_a_broker_that_wants_more_than_it_gets_is_told(tmp_path, told, ours, scheme):
    said = {
        "mqtt": "it may want TLS, as mqtts://",
        "mqtts": "it may want a certificate of yours, as cert=FILE&key=FILE",
    }
    with Broker(tmp_path, tls=ours, wants_certificate=True) as broker:
        feed = opened(broker.port, f"?ca={ours.authority}" if scheme == "mqtts" else "", scheme=scheme)
        told.wait_for(f": the broker ends the connection at once: {said[scheme]}; trying again")
        feed.close()
    assert len(told.texts) == 1, "it is told once, however often it is tried"


def test_a_broker_that_does_not_trust_our_certificate_is_told(tmp_path, told, ours, theirs):
    with Broker(tmp_path, tls=ours, wants_certificate=True) as broker:
        feed = opened(broker.port, f"?ca={ours.authority}&cert={theirs.client}&key={theirs.client_key}")
        told.wait_for(": the broker ends the connection at once: it may not trust your certificate; trying again")
        feed.close()


def test_a_wrong_password_in_a_file_is_refused(tmp_path, told, ours):
    (tmp_path / "secret").write_text("wrong")
    with Broker(tmp_path, {"ann": "right"}, ours) as broker:
        feed = opened(broker.port, f"?ca={ours.authority}&password_file={tmp_path / 'secret'}", user="ann@")
        told.wait_for("the broker refuses: Not authorized; trying again")
        feed.close()
    assert len(told.texts) == 1


def test_where_a_password_comes_from(tmp_path, monkeypatch):
    monkeypatch.setenv(PASSWORD, "of the environment")
    (tmp_path / "secret").write_text("of the file\n")
    assert password_of(parse_address("mqtt://ann@b/x")) == "of the environment"
    assert password_of(parse_address(f"mqtts://ann@b/x?password_file={tmp_path / 'secret'}")) == "of the file"
    (tmp_path / "secret").write_text("é" * (LONGEST_PASSWORD // 2))
    assert (
        len(password_of(parse_address(f"mqtts://ann@b/x?password_file={tmp_path / 'secret'}"))) == LONGEST_PASSWORD // 2
    )


@pytest.mark.parametrize(
    ("user", "content", "said"),
    [
        ("ann@", None, "cannot be read: No such file or directory"),
        ("ann@", b"", "holds no password"),
        ("ann@", b"\n", "holds no password"),
        ("ann@", b"\xff\xfe", "cannot be read: 'utf-8' codec"),
        ("ann@", b"x" * (LONGEST_PASSWORD + 1), "holds no password"),
        ("", b"secret", "password_file needs a user, as mqtts://ann@b/x"),
    ],
)
def test_a_file_without_a_password_is_refused(tmp_path, user, content, said):
    path = tmp_path / "secret"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(UserError, match=re.escape(said)):
        password_of(parse_address(f"mqtts://{user}b/x?password_file={path}"))


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ("?ca={junk}", "ca={junk} is no file of certificates in PEM: no certificate or crl found"),
        ("?ca=/no/file", "ca=/no/file is no file of certificates in PEM: No such file or directory"),
        ("?ca=", "ca= is no file of certificates in PEM: No such file or directory"),
        ("?cert={junk}", "cert={junk} is no certificate with its key in PEM, unencrypted: nothing more is known"),
        ("?cert={ours.client}&key={ours.broker_key}", "with key={ours.broker_key} is no certificate with its key"),
        ("?cert={ours.client}&key={locked}", "with key={locked} is no certificate with its key in PEM, unencrypted"),
        ("?key={ours.client_key}", "key={ours.client_key} needs the certificate that it belongs to, as cert=FILE"),
    ],
)
def test_files_that_are_not_what_they_should_be_are_refused(tmp_path, ours, options, said):
    names = {"ours": ours, "junk": tmp_path / "junk", "locked": tmp_path / "locked"}
    names["junk"].write_text("junk")
    words = ["openssl", "pkey", "-in", ours.client_key, "-aes128", "-passout", "pass:abcd", "-out", names["locked"]]
    subprocess.run(words, check=True)
    with pytest.raises(UserError) as raised:
        tls_of(parse_address(f"mqtts://b/x{options.format(**names)}"))
    assert said.format(**names) in str(raised.value)
