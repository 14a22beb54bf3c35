"""The server, asked over real connections: files, headers, who may look, the stream, and a browser that is slow."""

import contextlib
import http.client
import itertools
import json
import re
import socket
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from urllib.parse import urlsplit

import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from goldfield.errors import SystemFailure, UserError
from goldfield.page import serving as serving_module
from goldfield.page.application import HEADERS, application
from goldfield.page.hub import Hub
from goldfield.page.serving import Listener, PageServer, built_assets, parse_address
from goldfield.view.listening import BACKLOG, MOST

TIMEOUT_S = 60.0
METHODS = ("POST", "PUT", "DELETE", "PATCH", "OPTIONS", "TRACE", "PROPFIND", "SET")
PATHS = ("", "live", "expected_error?z=1", "index.html", "assets/main.js", "assets/", "new.js", "../new.js")
MOST_STATES = 60
"""A message that has not come before so many states, one a second, does not come."""


@pytest.fixture
def assets(tmp_path):
    (tmp_path / "index.html").write_text("<p>the page</p>")
    (tmp_path / "assets").mkdir()
    (tmp_path / "assets" / "main.js").write_text("1;")
    return tmp_path


def error_map(height_m):
    if height_m > 9.0:
        raise UserError("z=10: is far from the beacons")
    return {"z_m": height_m}


@contextmanager
def serving(assets, bind=("127.0.0.1", 0)):
    """Serve, and return the hub, which is never silent, and the address."""
    hub = Hub('{"type":"hello"}', 0.1, live=True, clock=lambda: 0.0)
    listener = Listener(bind)
    with PageServer(application(hub, assets, error_map, listener.token), listener):
        yield hub, listener.url


@pytest.fixture
def local(assets):
    with serving(assets) as served:
        yield served


def get(url, path="", **headers):
    """Return status, headers and text of an answer."""
    parts = urlsplit(url)
    connection = http.client.HTTPConnection("127.0.0.1", parts.port, timeout=TIMEOUT_S)
    try:
        connection.request("GET", parts.path + path, headers={"Host": parts.netloc, **headers})
        answer = connection.getresponse()
        return answer.status, dict(answer.getheaders()), answer.read().decode()
    finally:
        connection.close()


def request(url, method, path="", body=None):
    """Return the status of the answer to a request of any method."""
    parts = urlsplit(url)
    connection = http.client.HTTPConnection("127.0.0.1", parts.port, timeout=TIMEOUT_S)
    try:
        connection.request(method, parts.path + path, body, headers={"Host": parts.netloc})
        return connection.getresponse().status
    finally:
        connection.close()


def live(url, **options):
    parts = urlsplit(url)
    return connect(f"ws://127.0.0.1:{parts.port}{parts.path}live", open_timeout=TIMEOUT_S, **options)


def next_messages(stream, kind):
    """Return the messages of one kind of the next frame that has any; states go on coming, so they end the patience."""
    states = 0
    while states < MOST_STATES:
        messages = json.loads(stream.recv(TIMEOUT_S))
        found = [message for message in messages if message["type"] == kind]
        if found:
            return found
        states += sum(message["type"] == "state" for message in messages)
    raise AssertionError(f"no {kind} among the messages between {states} states of the stream")


def test_the_page_and_its_files_come_with_a_policy(local):
    _, url = local
    status, headers, text = get(url)
    assert (status, text) == (200, "<p>the page</p>")
    assert headers.items() >= HEADERS.items()
    assert "default-src 'none'" in headers["content-security-policy"]
    assert "unsafe" not in headers["content-security-policy"]
    assert get(url, "assets/main.js")[0] == 200
    assert get(url, "assets/none.js")[0] == 404
    assert get(url, "../serving.py")[0] == 404


@pytest.mark.parametrize("name", ["localhost", "127.0.0.1", "[::1]", "LOCALHOST"])
def test_names_of_this_machine_are_answered(local, name):
    assert get(local[1], Host=f"{name}:{urlsplit(local[1]).port}")[0] == 200


@pytest.mark.parametrize("name", ["evil.example", "localhost.evil.example", "192.168.0.7", ""])
def test_a_page_that_points_its_own_name_here_gets_nothing(local, name):
    _, url = local
    status, _, text = get(url, Host=f"{name}:{urlsplit(url).port}")
    assert status in (400, 403)
    assert "the page" not in text or "this page is for" in text


def test_another_page_does_not_get_the_stream(local):
    _, url = local
    own = url.rstrip("/")
    with live(url, origin=own) as stream:
        assert next_messages(stream, "hello")
    for origin in ("http://evil.example", "null", own.replace("127.0.0.1", "localhost"), "http://127.0.0.1:1"):
        with pytest.raises(InvalidStatus) as refused:
            live(url, origin=origin)
        assert refused.value.response.status_code == 403
        assert get(url, Origin=origin)[0] == 403


def test_beyond_this_machine_the_address_holds_a_token_and_nothing_answers_without(assets):
    with serving(assets, ("0.0.0.0", 0)) as (_, url), serving(assets, ("0.0.0.0", 0)) as (_, other):
        parts = urlsplit(url)
        token = parts.path.strip("/")
        assert len(token) >= 22
        assert token != urlsplit(other).path.strip("/")
        assert get(url)[2] == "<p>the page</p>"
        assert get(url, "assets/main.js")[0] == 200
        status, headers, _ = get(url.rstrip("/"))
        assert (status, urlsplit(headers["location"]).path) == (307, parts.path)
        with live(url) as stream:
            assert next_messages(stream, "hello")
        bare = f"http://{parts.netloc}/"
        for wrong in (bare, f"{bare}{token[:-1]}/", f"{bare}{token}x/", f"{bare}assets/main.js", f"{bare}x/{token}/"):
            status, _, text = get(wrong)
            assert status == 404
            assert "token" in text
        with pytest.raises(InvalidStatus):
            live(bare)
        with pytest.raises(InvalidStatus):
            live(url, origin="http://evil.example")


def test_the_stream_begins_with_the_site_and_goes_on(local):
    hub, url = local
    with live(url) as stream:
        assert next_messages(stream, "hello") == [{"type": "hello"}]
        hub.publish_epoch('{"type":"epoch","epoch":1}')
        assert next_messages(stream, "epoch")[0]["epoch"] == 1
        assert next_messages(stream, "state")[0]["state"] == "running"
        with live(url) as later:
            assert next_messages(later, "epoch")[0]["epoch"] == 1


def test_a_browser_that_reads_nothing_holds_up_nobody_and_loses_the_oldest(local):
    hub, url = local
    message = json.dumps({"type": "epoch", "fill": "x" * 4000})
    with live(url, max_queue=1, max_size=None) as slow, live(url, max_size=None) as quick:
        next_messages(slow, "hello")
        next_messages(quick, "hello")
        for _ in range(10_000):  # 40 MB, which no buffer of a connection holds
            hub.publish_epoch(message)
        hub.publish_epoch('{"type":"epoch","fill":"last"}')
        for stream in (quick, slow):
            got, dropped, last = 0, 0, ""
            while last != "last":
                for one in json.loads(stream.recv(TIMEOUT_S)):
                    dropped += one.get("count", 0)
                    if one["type"] == "epoch":
                        got, last = got + 1, one["fill"]
            assert got + dropped == 10_001
        assert dropped > 0  # by the slow one


def test_a_browser_that_reads_nothing_is_let_go_at_the_end_without_a_word(assets, caplog):
    message = json.dumps({"type": "epoch", "fill": "x" * 4000})
    with contextlib.ExitStack() as stack, serving(assets) as (hub, url):
        slow = stack.enter_context(live(url, max_queue=1, max_size=None, close_timeout=0.1))  # longer than the server
        next_messages(slow, "hello")
        with live(url, max_size=None) as quick:
            for number in range(20):  # 40 MB in all, each part of which the quick one has had
                for _ in range(500):
                    hub.publish_fix(message)
                hub.publish_health(json.dumps({"type": "health", "number": number}))
                assert next_messages(quick, "health")[0]["number"] == number
    assert [record.getMessage() for record in caplog.records if record.name.startswith("uvicorn")] == []


def test_browsers_that_go_are_forgotten(local):
    hub, url = local
    for _ in range(3):
        with live(url) as stream:
            next_messages(stream, "hello")
            assert hub.browsers >= 1
    with live(url) as stream:  # by its second state the server has seen the others go
        next_messages(stream, "state")
        next_messages(stream, "state")
        assert hub.browsers == 1


def test_what_a_browser_says_has_no_effect(local):
    hub, url = local
    with live(url) as stream:
        next_messages(stream, "hello")
        stream.send("anything")
        stream.send(b"\x00\xff")
        hub.publish_epoch('{"type":"epoch"}')
        assert next_messages(stream, "epoch")


def test_a_method_that_could_set_something_is_refused_on_each_path(assets):
    """With a body and without: no file of the page is changed, no map is computed, and the stream is as it was."""
    asked = []
    files = {path: path.read_bytes() for path in assets.rglob("*") if path.is_file()}
    listener, hub = Listener(("127.0.0.1", 0)), Hub('{"type":"hello"}', 0.1, live=True, clock=lambda: 0.0)
    with PageServer(application(hub, assets, asked.append), listener), live(listener.url) as stream:
        for method, path, body in itertools.product(METHODS, PATHS, (None, b'{"z": 1}', bytes(100_000))):
            assert request(listener.url, method, path, body) in (404, 405), (method, path)
        assert next_messages(stream, "hello") == [{"type": "hello"}]
        assert next_messages(stream, "state")[0]["state"] == "waiting"
        assert get(listener.url)[2] == "<p>the page</p>"
    assert asked == []
    assert {path: path.read_bytes() for path in assets.rglob("*") if path.is_file()} == files


def test_the_map_of_the_expected_error(local):
    _, url = local
    status, _, text = get(url, "expected_error?z=1.5")
    assert (status, json.loads(text)) == (200, {"z_m": 1.5})
    for query, said in (("z=10", "far from the beacons"), ("z=high", "height in metres"), ("", "height in metres")):
        status, _, text = get(url, f"expected_error?{query}")
        assert status == 400
        assert said in text


def test_an_address_that_is_taken_or_none_of_ours():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        with pytest.raises(UserError, match="cannot listen there"):
            Listener(taken.getsockname())
    with pytest.raises(UserError, match=r"cannot listen there: .*; give another port or address"):
        Listener(("192.0.2.7", 0))  # nobody's (RFC 5737)


def test_two_pages_without_an_address_of_their_own_both_find_a_port():
    first, second = Listener(), Listener()
    try:
        assert re.fullmatch(r"http://127\.0\.0\.1:\d+/", first.url)
        assert first.url != second.url
    finally:
        first.socket.close()
        second.socket.close()


@pytest.mark.parametrize(
    "text", ["8000", "127.0.0.1", "127.0.0.1:", ":8000", "a:65536", "a:-1", "::1:80", "a:٣", "[]:1"]
)
def test_what_is_no_address_is_refused(text):
    with pytest.raises(UserError, match=r"ADDRESS:PORT|brackets"):
        parse_address(text)


def test_a_page_that_is_not_built_says_how_to_build_it(tmp_path):
    with pytest.raises(SystemFailure, match="make page"):
        built_assets(tmp_path)
    (tmp_path / "index.html").write_text("")
    assert built_assets(tmp_path) == tmp_path


def test_a_hundred_connections_are_taken_and_no_more(local):
    """Whoever connects further is turned away at once; the stream that is open goes on, and who leaves makes room."""
    hub, url = local
    address = ("127.0.0.1", urlsplit(url).port)
    with live(url) as stream, contextlib.ExitStack() as stack:
        assert next_messages(stream, "hello")
        taken = [stack.enter_context(socket.create_connection(address, TIMEOUT_S)) for _ in range(MOST - 1)]
        for _ in range(BACKLOG + 5):
            with socket.create_connection(address, TIMEOUT_S) as further, contextlib.suppress(ConnectionResetError):
                assert further.recv(1) == b""
        hub.publish_epoch('{"type":"epoch","epoch":1}')
        assert next_messages(stream, "epoch")
        leaving = taken[0]
        leaving.sendall(b"GET / HTTP/1.0\r\n\r\n")
        while leaving.recv(4096):
            pass
        assert get(url)[0] == 200


@pytest.mark.parametrize(
    "beginning",
    [
        b"",
        b"GET / HTTP/1.1\r\nHost: x\r\n",
        b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\nGET /",
        b"POST / HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 9\r\n\r\nx",
    ],
    ids=["nothing", "half a request", "half a second one", "half of what it says"],
)
def test_a_connection_that_asks_for_nothing_takes_no_place_for_long(local, monkeypatch, beginning):
    """It is ended, and with it what it might still ask; the stream and the answer begun before go on for longer."""
    hub, url = local
    monkeypatch.setattr(serving_module, "ASKING_S", 1.0)
    with live(url) as stream:
        assert next_messages(stream, "hello")
        with socket.create_connection(("127.0.0.1", urlsplit(url).port), TIMEOUT_S) as silent:
            silent.sendall(beginning)
            with contextlib.suppress(ConnectionResetError):
                while silent.recv(4096):
                    pass
        hub.publish_epoch('{"type":"epoch","epoch":1}')
        assert next_messages(stream, "epoch")


def test_an_answer_that_takes_longer_than_a_request_may_is_waited_for(assets, monkeypatch):
    monkeypatch.setattr(serving_module, "ASKING_S", 1.0)
    release = threading.Event()

    def slow_map(height_m):
        assert release.wait(TIMEOUT_S)
        return {"z_m": height_m}

    listener = Listener(("127.0.0.1", 0))
    with PageServer(application(Hub("{}", 0.1, live=True), assets, slow_map), listener), ThreadPoolExecutor() as pool:
        asked = pool.submit(get, listener.url, "expected_error?z=1")
        with socket.create_connection(("127.0.0.1", urlsplit(listener.url).port), TIMEOUT_S) as silent:
            assert silent.recv(1) == b""  # as long as that, at least, the answer has been waited for
        release.set()
        assert asked.result(TIMEOUT_S)[0] == 200
