"""The programs in docs/feeds.md run as a reader would run them, each beside the feed that it is for."""

import re
import socket
import subprocess
import sys
import threading

import numpy as np
import pytest

from goldfield.feeds.address import parse_address
from goldfield.feeds.opening import open_feed
from hil_sim.clib import ROOT
from tests.host.feeds.broker import Broker, needs_mosquitto
from tests.host.feeds.made import UNIX_S, pose, setting, stamped
from tests.host.free_port import free_port

TIMEOUT_S = 120.0
EXAMPLES = dict(re.findall(r"<!-- example: (\w+) -->\n```python\n(.*?)```", (ROOT / "docs/feeds.md").read_text(), re.S))
SAID = "ok [1.5, -0.25, 0.875] 1700000000.25 0.0625\n"


def program(name, folder, **places):
    """Start the page's program, with the places that it names replaced by those of the test."""
    text = EXAMPLES[name]
    for old, new in places.items():
        assert old in text
        text = text.replace(old, new)
    command = [sys.executable, "-c", text]
    return subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def beside(feed, process):
    """Write poses until a program has ended; return what it printed."""
    ended = threading.Event()

    def end():
        process.wait(TIMEOUT_S)
        ended.set()

    threading.Thread(target=end, daemon=True).start()
    while not ended.wait(0.02):
        feed.write(stamped())
    feed.close()
    out, err = process.communicate()
    assert process.returncode == 0, err
    return out


def test_websocket(tmp_path):
    feed = open_feed(parse_address("ws://127.0.0.1:0"), setting())
    assert beside(feed, program("websocket", tmp_path, **{"8421": str(feed.port)})) == 3 * SAID


def test_udp(tmp_path):
    port = free_port(socket.SOCK_DGRAM)
    feed = open_feed(parse_address(f"udp://127.0.0.1:{port}"), setting())
    assert beside(feed, program("udp", tmp_path, **{"9000": str(port)})) == 3 * SAID


@needs_mosquitto
def test_mqtt(tmp_path):
    with Broker(tmp_path) as broker:
        feed = open_feed(parse_address(f"mqtt://127.0.0.1:{broker.port}/hall/pose"), setting())
        assert beside(feed, program("mqtt", tmp_path, **{"1883": str(broker.port)})) == 3 * SAID


@pytest.mark.parametrize("name", ["tum", "nmea"])
def test_files(tmp_path, name):
    path = tmp_path / {"tum": "walk.txt", "nmea": "today.nmea"}[name]
    feed = open_feed(parse_address(f"{name}:{path}"), setting())
    for number in range(3):
        position = pose().position_m + np.array([0.5 * number, 0.0, 0.0])
        feed.write(stamped(pose(position_m=position), unix_s=UNIX_S + number))
    feed.close()
    out, err = program(name, tmp_path).communicate(timeout=TIMEOUT_S)
    assert err == ""
    if name == "tum":
        assert out == "3 poses, 1.00 m\n"
    else:
        assert len(out.splitlines()) == 6
        assert out.startswith("PGFDP 1700000000.250 ['1.500', '-0.250', '0.875', ")
