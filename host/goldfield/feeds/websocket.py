"""A plain WebSocket server: whoever connects gets each pose as a text message of one line of JSON.

Programs may connect, and so may web pages of the origins that ``?origin=https://dashboard.example`` names; a browser
tells a page's origin, and others are refused, so that no page that somebody happens to look at reads along.
"""

from __future__ import annotations

import asyncio
import contextlib
import socket
import threading
from collections import deque
from collections.abc import Callable
from typing import cast

from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.exceptions import ConnectionClosed
from websockets.protocol import State
from websockets.typing import Origin

from goldfield.errors import tell
from goldfield.feeds.address import Address
from goldfield.feeds.feed import Feed, Setting
from goldfield.feeds.stamped import StampedPose
from goldfield.files.inputs import reason_of
from goldfield.view.listening import BACKLOG, MOST, listening

CAPACITY = 512
"""Poses that wait for one consumer: 1.5 s at 330 a second, beside what the system's buffers hold."""
LAST_S = 1.0
"""How long consumers get, at the end, to take what waits for them."""


def open_feed(address: Address, setting: Setting) -> Feed:
    """Return a server that listens, and tell where; `UserError` if it cannot."""
    feed = WebSocketFeed(address, setting)
    tell(f"{address.url}: serves poses at ws://{address.place(feed.port)}")
    return feed


class Consumer:
    """What waits for one consumer: the latest lines, and how many it has missed."""

    def __init__(self) -> None:
        self.lines: deque[str] = deque()
        self.ready = asyncio.Event()
        self.idle = asyncio.Event()
        self.idle.set()
        self.dropped = 0

    def put(self, line: str) -> None:
        """Add a line; the oldest goes if there is no room."""
        if len(self.lines) == CAPACITY:
            self.lines.popleft()
            self.dropped += 1
        self.lines.append(line)
        self.ready.set()
        self.idle.clear()

    async def send(self, connection: ServerConnection) -> None:
        """Send what comes, without end; only this waits for a consumer that is slow."""
        while True:
            await self.ready.wait()
            while self.lines:
                await connection.send(self.lines.popleft())
            self.ready.clear()
            self.idle.set()


class _Counted(ServerConnection):
    """A connection that is one of `MOST` at the most; another is ended before it has said anything."""

    connected: set[ServerConnection]
    turn_away: Callable[[], None]

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Begin, or end the connection."""
        if len(self.connected) >= MOST:
            cast(asyncio.Transport, transport).abort()
            self.turn_away()
            return
        self.connected.add(self)
        super().connection_made(transport)

    def connection_lost(self, exc: Exception | None) -> None:
        """End, if it has begun."""
        if self in self.connected:
            self.connected.discard(self)
            super().connection_lost(exc)


class WebSocketFeed:
    """Serves poses in a thread of its own.

    Parameters
    ----------
    address : Address
        Where it listens.
    setting : Setting

    Attributes
    ----------
    port : int
        The port that it has.
    dropped : int
        Messages that consumers have missed because they were too slow.

    Raises
    ------
    UserError
        If this machine cannot listen there.
    """

    whole = False

    def __init__(self, address: Address, setting: Setting) -> None:
        self.dropped = 0
        self._url = address.url
        self._clock = setting.clock
        self._origins = [None, *(Origin(one) for one in address.options.get("origin", "").split(",") if one)]
        self._consumers: set[Consumer] = set()
        self._told_of_most = False
        self._connected: set[ServerConnection] = set()
        opened = _listening(address)
        self.port = int(opened.getsockname()[1])
        self._loop = asyncio.new_event_loop()
        self._server: Server | None = None
        self._loop.run_until_complete(self._start(opened))
        self._thread = threading.Thread(target=self._loop.run_forever, name=address.url, daemon=True)
        self._thread.start()

    def write(self, stamped: StampedPose, /) -> None:
        """Hand a pose to every consumer; without one it costs nothing."""
        if self._consumers:
            self._loop.call_soon_threadsafe(self._hand_out, stamped.json(self._clock()))

    def close(self) -> None:
        """Let consumers take what waits for them, for a second at most, and end."""
        asyncio.run_coroutine_threadsafe(self._end(), self._loop).result()
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()

    async def _start(self, opened: socket.socket) -> None:
        self._server = await serve(
            self._serve,
            sock=opened,
            origins=self._origins,
            compression=None,  # a pose is short, and the processor has better things to do
            max_size=1024,
            server_header=None,
            backlog=BACKLOG,
            create_connection=type(
                "Counted", (_Counted,), {"connected": self._connected, "turn_away": self._turn_away}
            ),
        )

    def _turn_away(self) -> None:
        """Tell, once, that there are too many consumers."""
        if not self._told_of_most:
            self._told_of_most = True
            tell(f"{self._url}: {MOST} consumers are connected, and no more are let in")

    async def _serve(self, connection: ServerConnection) -> None:
        """Serve one consumer until it goes; what it says has no meaning."""
        consumer = Consumer()
        self._consumers.add(consumer)
        sending = asyncio.create_task(consumer.send(connection))
        try:
            async for _ in connection:
                pass
        except ConnectionClosed:
            pass  # without a farewell: it was ended, or its network is gone
        finally:
            sending.cancel()
            with contextlib.suppress(asyncio.CancelledError, ConnectionClosed):
                await sending
            self._consumers.discard(consumer)

    def _hand_out(self, line: str) -> None:
        for consumer in self._consumers:
            before = consumer.dropped
            consumer.put(line)
            self.dropped += consumer.dropped - before
            if consumer.dropped == 1 > before:
                tell(f"{self._url}: a consumer is too slow and misses the oldest poses")

    async def _end(self) -> None:
        assert self._server is not None  # __init__ has started it
        waiting = [asyncio.create_task(consumer.idle.wait()) for consumer in self._consumers]
        if waiting:
            await asyncio.wait(waiting, timeout=LAST_S)
        for connection in self._connected:
            if connection.state is State.CONNECTING:
                connection.transport.abort()  # It has said nothing yet, and would be waited for.
            connection.close_timeout = LAST_S
        self._server.close()
        await self._server.wait_closed()


def _listening(address: Address) -> socket.socket:
    try:
        return listening(address.host, address.port)
    except (OSError, UnicodeError) as error:
        raise address.wrong(
            f"this machine cannot listen there: {reason_of(error)}; give another port or address"
        ) from None
