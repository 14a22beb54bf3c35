"""Chromium without a screen, and a page in it that is fed by hand: for the tests, and for the picture in the docs."""

from __future__ import annotations

import json
from contextlib import contextmanager

from playwright.sync_api import sync_playwright

from goldfield import site as sites
from goldfield.page.application import application
from goldfield.page.expected_error import ExpectedError
from goldfield.page.feeding import Feed
from goldfield.page.greeting import hello
from goldfield.page.hub import Hub
from goldfield.page.serving import Listener, PageServer, built_assets
from goldfield.sensor.options import Options
from tests.host.fake_sensor import SITE
from tests.host.free_port import free_port

CHROMIUM = "/usr/bin/chromium"
FLAGS = (
    "--no-sandbox",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--use-angle=swiftshader",  # three dimensions without a graphics card
    "--enable-unsafe-swiftshader",
)
STILL = """
    let stands_ms = 0;
    performance.now = () => stands_ms;
    globalThis.passed = (seconds) => { stands_ms += 1000 * seconds; };
"""
"""Lets the clock stand still by which the page forgets alarms; ``passed(seconds)`` moves it on."""
DESKTOP, PHONE = {"width": 1440, "height": 900}, {"width": 390, "height": 844}
ROOM = sites.load(SITE)


@contextmanager
def chromium():
    """Start a browser."""
    with sync_playwright() as player:
        browser = player.chromium.launch(executable_path=CHROMIUM, args=list(FLAGS))
        try:
            yield browser
        finally:
            browser.close()


class Keeping(Hub):
    """A hub that keeps what is published, each message with what it is, so that it can be published again by hand."""

    def __init__(self):
        super().__init__("", ROOM.cycle_s, live=False)
        self.kept = []

    def publish_epoch(self, message):
        self.kept.append(("epoch", message))

    def publish_health(self, message):
        self.kept.append(("health", message))


def recorded(log):
    """Return the messages of a recording."""
    hub = Keeping()
    Feed(hub, "log", str(log), ROOM, Options(), 0.0).run()
    return hub.kept


class Served:
    """The page at an address, fed by hand; its server can be stopped and started again.

    Attributes
    ----------
    now_s : float
        The time by which a stream is silent or not: it stands still unless it is set.
    """

    def __init__(self):
        self.now_s = 0.0
        self.hub = Hub(hello(ROOM, "a bench", live=True), ROOM.cycle_s, live=True, clock=lambda: self.now_s)
        self._port, self._server = free_port(), None
        self.start()

    def start(self):
        """Begin to serve, at the same address as before."""
        listener = Listener(("127.0.0.1", self._port))
        self.url = listener.url
        page = application(self.hub, built_assets(), ExpectedError(ROOM), listener.token)
        self._server = PageServer(page, listener)
        self._server.__enter__()

    def stop(self):
        """Let go of the browsers and serve no more."""
        if self._server:
            self._server.__exit__(None, None, None)
        self._server = None

    def publish(self, messages):
        """Publish messages of a recording."""
        for kind, message in messages:
            getattr(self.hub, f"publish_{kind}")(message)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.stop()


def times_later(messages, later_s):
    """Return messages with the sensor's time so much later."""
    moved = []
    for kind, message in messages:
        record = json.loads(message)
        record["t_s"] += later_s
        moved.append((kind, json.dumps(record)))
    return moved
