"""Print what feeds cost: processor time of the thread that makes the poses, and of the whole process, for each pose.

``python -m tests.bench.feed_costs``; poses come at 330 Hz of the wall clock for SECONDS, with a consumer in another
process for each feed, or none. MQTT needs mosquitto; without it that row is left out.
"""

from __future__ import annotations

import argparse
import json
import socket
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

from goldfield.feeds.address import parse_address
from goldfield.feeds.feed import Setting
from goldfield.feeds.opening import Feeds, open_feed
from goldfield.sensor.pipeline import Fix
from tests.command import real_number
from tests.host.feeds.broker import BROKER, Broker
from tests.host.feeds.made import SITE, pose
from tests.host.free_port import free_port

RATE_HZ = 330.0
CONSUMERS = {
    "ws": """
from websockets.sync.client import connect
with connect("ws://127.0.0.1:{port}") as stream:
    for _ in stream:
        said or said.append(print(flush=True))
""",
    "udp": """
import socket
receiver = socket.socket(type=socket.SOCK_DGRAM)
receiver.bind(("127.0.0.1", {port}))
while receiver.recv(9999):
    said or said.append(print(flush=True))
""",
    "mqtt": """
from paho.mqtt import subscribe
subscribe.callback(lambda *_: said or said.append(print(flush=True)), "t", port={port})
""",
    "foxglove": """
import json
from websockets.sync.client import connect
with connect("ws://127.0.0.1:{port}", subprotocols=["foxglove.sdk.v1"]) as stream:
    for message in stream:
        if isinstance(message, bytes):
            said or said.append(print(flush=True))
        elif "channels" in json.loads(message):
            wanted = [dict(id=one["id"], channelId=one["id"]) for one in json.loads(message)["channels"]]
            stream.send(json.dumps(dict(op="subscribe", subscriptions=wanted)))
""",
}
"""A program that takes what each kind of feed sends, and prints an empty line when the first came."""


def poses_for(seconds):
    """Return what a pipeline yields at the rate: poses with the eight beacons of prigge8."""
    names = tuple(beacon.id for beacon in SITE.beacons)
    made = pose(used=names, excluded=(), residuals=dict.fromkeys(names, 1.0))
    return [made for _ in range(int(seconds * RATE_HZ))]


def cost(feeds, seconds):
    """Feed poses at the rate; return each call's processor time, s, and that of the whole process a pose, s."""
    calls = []
    pause = threading.Event()
    items = poses_for(seconds)
    begin_cpu_s, begin_s = time.process_time(), time.monotonic()
    for number, made in enumerate(items):
        pause.wait(max(0.0, begin_s + number / RATE_HZ - time.monotonic()))
        item = Fix(made, time.time())
        before_s = time.thread_time()
        feeds.write(item)
        calls.append(time.thread_time() - before_s)
    return calls, (time.process_time() - begin_cpu_s) / len(items)


def begun(consumer, port, feeds):
    """Start a consumer, and return when it has got something."""
    process = subprocess.Popen(
        [sys.executable, "-c", f"said = []{CONSUMERS[consumer].format(port=port)}"], stdout=subprocess.PIPE
    )
    got = threading.Event()

    threading.Thread(target=lambda: process.stdout.readline() and got.set(), daemon=True).start()
    while not got.wait(0.05):
        feeds.write(Fix(poses_for(1.0)[0], time.time()))
    return process


def row(name, urls, consumer, seconds, idle_s):
    """Print the costs of some feeds."""
    opened = [(url, open_feed(parse_address(url), Setting(SITE))) for url in urls]
    feeds = Feeds(opened, SITE.cycle_s, live=True)
    process = None
    try:
        if consumer is not None:
            process = begun(consumer[0], consumer[1] or opened[0][1].port, feeds)
        calls, cpu_s = cost(feeds, seconds)
        feeds.close()
    finally:
        if process is not None:
            process.kill()
            process.wait()
    figures = {
        "feed": name,
        "pose_thread_median_us": round(1e6 * statistics.median(calls), 1),
        "pose_thread_p99_us": round(1e6 * sorted(calls)[int(0.99 * len(calls))], 1),
        "process_us_per_pose": round(1e6 * (cpu_s - idle_s), 1),
        "dropped": sum(feeds.dropped.values()),
    }
    print(json.dumps(figures), flush=True)


def main():
    """Print a line for each feed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=real_number(1.0), default=10.0)
    seconds = parser.parse_args().seconds
    _, idle_s = cost(Feeds([], SITE.cycle_s, live=True), seconds)
    with tempfile.TemporaryDirectory() as folder, socket.socket(type=socket.SOCK_DGRAM) as held:
        held.bind(("127.0.0.1", 0))
        row("ws, no consumer", ["ws://:0"], None, seconds, idle_s)
        row("ws", ["ws://:0"], ("ws", None), seconds, idle_s)
        port = free_port()
        row("udp", [f"udp://127.0.0.1:{port}"], ("udp", port), seconds, idle_s)
        if BROKER is not None:
            with Broker(Path(folder)) as broker:
                row("mqtt", [f"mqtt://127.0.0.1:{broker.port}/t"], ("mqtt", broker.port), seconds, idle_s)
        row("foxglove, no consumer", ["foxglove://:0"], None, seconds, idle_s)
        row("foxglove", ["foxglove://:0"], ("foxglove", None), seconds, idle_s)
        row("tum", [f"tum:{folder}/walk.txt"], None, seconds, idle_s)
        row("nmea", [f"nmea:{folder}/walk.nmea"], None, seconds, idle_s)
        urls = ["ws://:0", f"udp://127.0.0.1:{port}", f"tum:{folder}/all.txt", f"nmea:{folder}/all.nmea"]
        row("ws, udp, tum and nmea at once", urls, None, seconds, idle_s)


if __name__ == "__main__":
    main()
