"""The Foxglove server as the reference client sees it: `@foxglove/ws-protocol` of npm, which reads by the schemas."""

import contextlib
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from goldfield.feeds.address import parse_address
from goldfield.feeds.foxglove import FoxgloveFeed
from hil_sim.clib import ROOT
from tests.host.feeds import made
from tests.host.feeds.made import UNIX_S, pose, setting, stamped
from tests.host.feeds.test_foxglove import TOPICS, of_epoch

CLIENT = ROOT / "build/foxglove-reader/listen.mjs"
SUBPROTOCOL = "foxglove.sdk.v1"
EARLIER = "foxglove.websocket.v1"
"""What the client's own constant names; the SDK's server has left it behind."""


@pytest.fixture
def feed():
    served = FoxgloveFeed(parse_address("foxglove://127.0.0.1:0"), setting())
    yield served
    served.close()


def listening(feed, subprotocol, topics, out=subprocess.DEVNULL):
    """Start the client; what it prints is more than a pipe holds."""
    assert CLIENT.exists(), "make build/foxglove-reader.stamp installs it"
    command = [Path(sys.executable).with_name("node"), CLIENT, f"ws://127.0.0.1:{feed.port}", subprotocol, *topics]
    return subprocess.Popen(command, stdout=out, stderr=subprocess.PIPE, text=True)


def ended(client):
    """Tell whether the client has ended; what it is sent meanwhile is little, so that it can follow."""
    with contextlib.suppress(subprocess.TimeoutExpired):
        client.wait(0.005)
    return client.returncode is not None


def test_the_reference_client_reads_every_topic(feed, tmp_path):
    with (tmp_path / "found").open("w") as out, listening(feed, SUBPROTOCOL, sorted(TOPICS), out) as client:
        number = 0
        while not ended(client):  # it ends when it has had a message of each
            for _ in range(5):  # more arrives at once than it wants
                feed.write(of_epoch(number := number + 1))
                later_s = UNIX_S + number * made.SITE.cycle_s  # its first message may be any of them
                feed.write(stamped(pose(number, reason=f"{number}"), later_s))  # what is told again is not logged again
        _, err = client.communicate()
    assert (client.returncode, err) == (0, "")
    found = json.loads((tmp_path / "found").read_text())
    assert found["name"] == f"goldfield: {made.SITE.name}"
    assert found["capabilities"] == [], "nothing can be set through a feed"
    contents = {topic: one["content"] for topic, one in found["topics"].items()}
    assert set(contents) == TOPICS
    odometry, (transform,) = contents["/goldfield/pose_covariance"], contents["/tf"]["transforms"]
    assert (odometry["frame_id"], odometry["body_frame_id"]) == ("map", "sensor")
    assert (transform["parent_frame_id"], transform["child_frame_id"]) == ("map", "sensor")
    assert np.allclose([odometry["pose"]["position"][axis] for axis in "xyz"], made.POSITION_M)
    stamp = odometry["timestamp"]
    cycles = (stamp["seconds"] + 1e-9 * stamp["nanos"] - UNIX_S) / made.SITE.cycle_s
    assert 1 <= round(cycles) <= number
    assert cycles == pytest.approx(round(cycles), abs=1e-4)
    assert contents["/goldfield/line"]["position_m"] == pytest.approx(list(made.POSITION_M))


def test_a_client_of_the_earlier_protocol_is_turned_away(feed):
    """The page of the feeds says so."""
    with listening(feed, EARLIER, sorted(TOPICS)) as client:
        _, err = client.communicate()
    assert client.returncode == 1
    assert "400" in err
