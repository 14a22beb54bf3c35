"""``goldfield view`` as a program: its first line, what it serves, its end, and what it refuses."""

import http.client
import itertools
import json
import resource
import signal
import socket
import subprocess
import sys
from urllib.parse import urlsplit

import pytest
from websockets.sync.client import connect

from goldfield.cli import main
from goldfield.page import serving
from goldfield_protocol import encode, encode_frame
from tests.host.fake_sensor import NODE, SITE, PtySensor, log_of

TIMEOUT_S = 120.0
PATHS = ("", "live", "expected_error?z=1", "index.html", "nodes/100/parameters/5")
SETTING = encode("PARAM_SET", {"kind": 0, "value_unsigned": 0}, node=NODE, index=5)
"""A message by which the sensor would report no field any more."""
MOST_MESSAGES = 120
"""A stream that runs tells its state every second: a message that is not among so many will not come."""


class View:
    """A running ``goldfield view``."""

    def __init__(self, *words):
        command = [sys.executable, "-m", "goldfield", "view", "--site", str(SITE), "--bind", "127.0.0.1:0", *words]
        self._process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)

    def __enter__(self):
        self.url = self._process.stdout.readline().strip()
        return self

    def __exit__(self, *_):
        self._process.kill()
        self._process.communicate()

    def stream(self):
        return connect(f"{self.url.replace('http', 'ws', 1)}live", max_size=None, open_timeout=TIMEOUT_S)

    def end(self):
        """Interrupt it, and return its exit code and what it said after the first line."""
        self._process.send_signal(signal.SIGINT)
        return self.ended()

    def ended(self):
        """Wait for its end; return its exit code and what it said after the first line."""
        out, err = self._process.communicate(timeout=TIMEOUT_S)
        return self._process.returncode, out, err


def until(stream, wanted):
    """Return every message up to the first that is wanted."""
    seen = []
    while not any(wanted(message) for message in seen):
        assert len(seen) < MOST_MESSAGES, seen[-1]
        seen += json.loads(stream.recv(TIMEOUT_S))
    return seen


def test_a_recording_is_served_to_its_end_and_beyond(tmp_path):
    log = tmp_path / "run.log"
    log.write_text(log_of(range(5)))
    with View("--log", str(log), "--pace", "0") as view:
        assert view.url.startswith("http://127.0.0.1:")
        with view.stream() as stream:
            seen = until(stream, lambda message: message.get("state") == "ended")
        assert seen[0]["type"] == "hello"
        assert [one["epoch"] for one in seen if one["type"] == "epoch"] == [0, 1, 2, 3, 4]
        assert view.end() == (0, "", "")


def test_a_run_shows_the_page_beside_its_lines():
    command = [sys.executable, "-m", "goldfield", "run", "--site", str(SITE), "--view", "127.0.0.1:0", "--json"]
    sensor = PtySensor(range(100_000))
    run = subprocess.Popen([*command, "--port", sensor.path], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        url = run.stderr.readline().split()[-1]
        address = f"{url.replace('http', 'ws', 1)}live"
        with connect(address, max_size=None, open_timeout=TIMEOUT_S) as stream, sensor:  # which speaks from now on
            first = json.loads(run.stdout.readline())
            seen = until(stream, lambda message: message["type"] == "health")
            run.send_signal(signal.SIGINT)
            run.communicate(timeout=TIMEOUT_S)
    finally:
        run.kill()
        run.wait()
    assert run.returncode == 0
    assert seen[0]["type"] == "hello"
    assert seen[0]["live"]
    (same,) = [one for one in seen if one["type"] == "epoch" and one["epoch"] == first["epoch"]]
    assert {key: same[key] for key in first if key in same} == {key: first[key] for key in first if key in same}
    assert next(one for one in seen if one["type"] == "health")["node"] is not None


def test_nothing_that_a_browser_sends_reaches_the_sensor():
    """Whatever it asks for, by any method, and says on the stream: the line carries what the run itself has to say."""
    with PtySensor(range(100_000)) as sensor, View("--port", sensor.path) as view, view.stream() as stream:
        until(stream, lambda message: message["type"] == "epoch")
        before = list(sensor.requests)
        for method, path in itertools.product(("POST", "PUT", "DELETE", "PATCH", "OPTIONS"), PATHS):
            connection = http.client.HTTPConnection(urlsplit(view.url).netloc, timeout=TIMEOUT_S)
            connection.request(method, f"/{path}", encode_frame(*SETTING))
            assert connection.getresponse().status in (404, 405)
            connection.close()
        for said in ("set", json.dumps({"index": 5, "value": 0}), encode_frame(*SETTING)):
            stream.send(said)
        last = max(message["epoch"] for message in until(stream, is_state) if message["type"] == "epoch")
        until(stream, lambda message: message.get("epoch", 0) > last)
        assert view.end()[0] == 0
        assert sensor.requests == before


def is_state(message):
    return message["type"] == "state"


def test_a_full_disk_costs_the_recording_and_not_the_page(tmp_path):
    words = ["--view", "127.0.0.1:0", "--json", "--record", str(tmp_path / "run.log")]
    full = resource.RLIMIT_FSIZE, (2000, 2000)
    with PtySensor(range(100_000)) as sensor:
        run = subprocess.Popen(
            [sys.executable, "-m", "goldfield", "run", "--site", str(SITE), "--port", sensor.path, *words],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            preexec_fn=lambda: resource.setrlimit(*full),
        )
        try:
            url = run.stderr.readline().split()[-1]
            told = run.stderr.readline()
            with connect(f"{url.replace('http', 'ws', 1)}live", max_size=None, open_timeout=TIMEOUT_S) as stream:
                until(stream, lambda message: message.get("epoch", 0) > 30)  # far beyond what the file holds
            run.send_signal(signal.SIGINT)
            run.communicate(timeout=TIMEOUT_S)
        finally:
            run.kill()
            run.wait()
    assert "run.log: " in told
    assert "recording stopped after" in told
    assert run.returncode == 3


def test_a_second_view_of_one_port_is_refused_and_the_first_goes_on():
    with PtySensor(range(100_000)) as sensor, View("--port", sensor.path) as first:
        with first.stream() as stream:
            until(stream, lambda message: message["type"] == "epoch")
        with View("--port", sensor.path) as second:
            code, _, said = second.ended()
        assert code == 2
        assert said.count("\n") == 1
        assert f"{sensor.path}: is in use" in said
        with first.stream() as stream:
            seen = until(stream, lambda message: message["type"] == "state")  # the epochs so far came first
            last = max(message["epoch"] for message in seen if message["type"] == "epoch")
            until(stream, lambda message: message.get("epoch", 0) > last)
        assert first.end()[0] == 0


def test_two_pages_on_one_machine_have_two_addresses_and_the_second_says_so(monkeypatch, capsys):
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        monkeypatch.setattr(serving, "PORT", other.getsockname()[1])
        listener = serving.Listener()
        assert listener.url != f"http://127.0.0.1:{serving.PORT}/"
        listener.socket.close()
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert f"port {serving.PORT} of this machine is taken" in said


def test_a_page_and_feeds_at_once(tmp_path):
    log, walk = tmp_path / "run.log", tmp_path / "walk.txt"
    log.write_text(log_of(range(5)))
    with View("--log", str(log), "--pace", "0", "--feed", f"tum:{walk}") as view:
        with view.stream() as stream:
            until(stream, lambda message: message.get("state") == "ended")
        assert view.end() == (0, "", "")
    assert len(walk.read_text().splitlines()) == 1 + 5


def test_a_live_sensor_that_hangs_up_is_waited_for():
    with PtySensor(range(5), hang_up=True) as sensor, View("--port", sensor.path) as view, view.stream() as stream:
        until(stream, lambda message: message.get("epoch") == 4)
        *_, lost = (one for one in until(stream, lambda one: one.get("state") == "lost") if one["type"] == "state")
        code, out, _ = view.end()
    assert "cable pulled or sender ended; waiting for it" in lost["text"]
    assert (code, out) == (0, "")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--bind", "8000"], "--bind 8000: give ADDRESS:PORT"),
        (["--bind", "192.0.2.7:0"], "cannot listen there"),
        (["--rate", "20000"], "--rate: 20000 Hz is not above 0 and at most 10000 Hz"),
        (["--node", "7", "--log", "none.log"], "more than one source"),
    ],
)
def test_what_makes_no_sense_is_refused_in_a_sentence(words, said, capsys, tmp_path, monkeypatch):
    (tmp_path / "index.html").write_text("")
    monkeypatch.setattr(serving, "ASSETS", tmp_path)
    assert main(["view", "--port", "/dev/none", "--site", str(SITE), *words]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert said in err
    assert err.count("\n") == 1


def test_a_negative_pace_is_refused(capsys):
    with pytest.raises(SystemExit) as refused:
        main(["view", "--pace", "-1"])
    assert refused.value.code == 2
    assert "-1 is no pace" in capsys.readouterr().err


def test_a_port_that_is_not_there_ends_it_with_the_address_printed(capsys, tmp_path, monkeypatch):
    (tmp_path / "index.html").write_text("")
    monkeypatch.setattr(serving, "ASSETS", tmp_path)
    assert main(["view", "--port", "/dev/none", "--site", str(SITE), "--bind", "127.0.0.1:0"]) == 2
    out, err = capsys.readouterr()
    assert out.count("\n") == 1
    assert "/dev/none" in err


def test_a_page_that_is_not_built_is_told_before_anything_is_opened(capsys, tmp_path, monkeypatch):
    monkeypatch.setattr(serving, "ASSETS", tmp_path)
    assert main(["view", "--port", "/dev/none", "--site", str(SITE)]) == 3
    assert "make page" in capsys.readouterr().err


def test_without_the_server_s_packages_it_says_what_to_install(capsys, monkeypatch):
    for module in [name for name in sys.modules if name.startswith(("goldfield.page.", "goldfield.cli.viewing"))]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setitem(sys.modules, "starlette.applications", None)
    assert main(["view", "--port", "/dev/none", "--site", str(SITE)]) == 3
    said = capsys.readouterr().err
    assert "a package is missing" in said
    assert "pip install 'goldfield[" in said
    assert "view" in said
