"""``goldfield run --feed``: feeds beside the lines on stdout, of a recording and of a live sensor."""

import contextlib
import json
import re
import signal
import socket
import subprocess
import sys
import time

import numpy as np
import pytest
from websockets.sync.client import connect

from goldfield.cli import main
from tests.host.fake_sensor import CYCLE_S, SITE, PtySensor, log_of
from tests.host.free_port import free_port

TIMEOUT_S = 60.0
BEGIN_S = 1_700_000_000.0
FIRST_LATE_S = 1e-3
"""The last of the eleven messages of a cycle comes so long after its end in a log of `log_of`."""


@pytest.fixture
def log(tmp_path):
    """A recording whose first cycle began at a known time."""
    path = tmp_path / "run.log"
    path.write_text(re.sub(r"\(([\d.]+)\)", lambda time: f"({float(time[1]) + BEGIN_S:.6f})", log_of(range(5))))
    return path


def run(*words):
    return main(["run", "--site", str(SITE), *map(str, words)])


def test_a_recording_feeds_files_and_datagrams_with_the_times_of_its_measurements(tmp_path, log, capsys):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(TIMEOUT_S)
        udp = f"udp://127.0.0.1:{receiver.getsockname()[1]}"
        feeds = [word for url in (f"tum:{tmp_path / 'walk.txt'}", f"nmea:{tmp_path / 'w.nmea'}", udp, "ws://:0")
                 for word in ("--feed", url)]  # fmt: skip
        assert run("--log", log, "--json", *feeds) == 0
        sent = [json.loads(receiver.recv(65536)) for _ in range(5)]
    captured = capsys.readouterr()
    printed = [json.loads(line) for line in captured.out.splitlines()]
    assert [{k: v for k, v in line.items() if k not in ("unix_s", "latency_s")} for line in sent] == printed
    assert [line["latency_s"] for line in sent] == [None] * 5
    measured_s = BEGIN_S + (np.arange(5) + 0.5) * CYCLE_S + FIRST_LATE_S
    assert np.allclose([line["unix_s"] for line in sent], measured_s, rtol=0.0, atol=1e-4)
    assert np.allclose(np.loadtxt(tmp_path / "walk.txt")[:, 0], measured_s, rtol=0.0, atol=1e-4)
    assert len((tmp_path / "w.nmea").read_text().splitlines()) == 10
    assert re.search(r"^goldfield: ws://:0: serves poses at ws://127\.0\.0\.1:\d+$", captured.err, re.M)


def test_a_feed_may_not_write_the_file_of_another_option(tmp_path, log, capsys):
    path = tmp_path / "both"
    assert run("--log", log, "--record", path, "--feed", f"tum:{path}") == 2
    assert f"is the file of --record and would be overwritten by --feed tum:{path}" in capsys.readouterr().err
    assert not path.exists()


def test_a_feed_that_is_given_twice_is_refused(tmp_path, log, capsys):
    url = f"tum:{tmp_path / 'walk.txt'}"
    assert run("--log", log, "--feed", url, "--feed", "ws://:0", "--feed", url) == 2
    assert capsys.readouterr().err == f"goldfield: --feed {url}: is given twice: leave one out\n"


def test_two_feeds_cannot_have_one_port(log, capsys):
    port = free_port()
    for first, second in (("ws", "foxglove"), ("foxglove", "ws")):
        urls = [f"{scheme}://127.0.0.1:{port}" for scheme in (first, second)]
        assert run("--log", log, "--feed", urls[0], "--feed", urls[1]) == 2
        said = capsys.readouterr().err.splitlines()[-1]
        assert re.fullmatch(rf"goldfield: --feed {urls[1]}: this machine cannot listen there: .*in use.*", said)


def test_a_feed_that_fails_makes_the_exit_code_3(log, capsys):
    assert run("--log", log, "--feed", "tum:/dev/full") == 3
    assert "5 epochs: 5 ok" in capsys.readouterr().out


def test_feeds_of_the_environment(tmp_path, log, monkeypatch):
    paths = [tmp_path / "a.txt", tmp_path / "b.txt"]
    monkeypatch.setenv("GOLDFIELD_FEED", f"tum:{paths[0]} nmea:{paths[1]}")
    assert run("--log", log) == 0
    assert [len(path.read_text().splitlines()) for path in paths] == [6, 10]


def test_without_feeds_no_package_of_theirs_is_loaded(log):
    program = f"""
import sys
from goldfield.cli import main
assert main(["run", "--site", {str(SITE)!r}, "--log", {str(log)!r}]) == 0
print(*{{"websockets", "paho", "foxglove"}} & {{*sys.modules}}, "loaded")
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "loaded"


@contextlib.contextmanager
def running(*words):
    command = [sys.executable, "-m", "goldfield", "run", "--site", str(SITE), *words]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            yield process
        finally:
            process.kill()


def test_a_live_sensor_feeds_a_program_with_latency():
    """The program connects before the sensor begins to speak."""
    before_s, sensor = time.time(), PtySensor(range(100_000))
    with running("--port", sensor.path, "--feed", "ws://:0") as process:
        place = re.search(r"serves poses at (ws://\S+)", process.stderr.readline())[1]
        with connect(place) as client, sensor:
            sent = [json.loads(client.recv(timeout=TIMEOUT_S)) for _ in range(2)]
            process.send_signal(signal.SIGINT)
            _, err = process.communicate(timeout=TIMEOUT_S)
    assert process.returncode == 0, err
    for line in sent:
        assert before_s < line["unix_s"] + line["latency_s"] < time.time()
        assert line["latency_s"] > 0.5 * CYCLE_S - 1e-4, "a pose is at least as old as half of its cycle"
