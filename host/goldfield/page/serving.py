"""Serves the live page at an address of this machine, in a thread of its own."""

from __future__ import annotations

import asyncio
import ipaddress
import secrets
import socket
import threading
import time
from pathlib import Path
from types import TracebackType
from typing import Self

import uvicorn
from starlette.types import ASGIApp
from uvicorn.protocols.http.h11_impl import H11Protocol

from goldfield.errors import Loudness, SystemFailure, UserError, loudness, option, tell
from goldfield.files.inputs import reason_of
from goldfield.view.listening import BACKLOG, MOST, listening

PORT = 8420
"""Port of this machine that is taken if none is asked for; if another program has it, any that is free."""
ASSETS = Path(__file__).parent / "built"
"""The built page; `make page` and the wheel's build put it there."""
PATIENCE_S = 10.0
"""Longest wait for the server to start or to end."""
ASKING_S = 10.0
"""Longest wait for the next request of a connection, s: one that asks for nothing takes no place from one that does."""
LOOPBACK = "127.0.0.1"


def built_assets(folder: Path | None = None) -> Path:
    """Return the folder of the built page, `ASSETS` unless another is given.

    Raises
    ------
    SystemFailure
        If the page is not built.
    """
    folder = ASSETS if folder is None else folder
    if not (folder / "index.html").exists():
        raise SystemFailure(
            "the live page is not built: run 'make page' in the checkout, or install a wheel of "
            "goldfield, which holds it"
        )
    return folder


def parse_address(text: str, named: str = "bind") -> tuple[str, int]:
    """Return address and port of ``ADDRESS:PORT``; an IPv6 address is in brackets. ``named``: the option it is from.

    Raises
    ------
    UserError
        If there is no port of 0 to 65535, where 0 means any that is free, or no address.

    Examples
    --------
    >>> parse_address("0.0.0.0:8000"), parse_address("[::1]:0")
    (('0.0.0.0', 8000), ('::1', 0))
    """
    address, colon, port = text.rpartition(":")
    bare = address.removeprefix("[").removesuffix("]")
    bracketed = address.startswith("[") and address.endswith("]")
    if not (colon and bare and port.isascii() and port.isdigit() and len(port) <= 5 and int(port) <= 65535):
        raise UserError(f"{option(named, text)}: give ADDRESS:PORT, as 0.0.0.0:8000")
    if ":" in bare and not bracketed:
        raise UserError(f"{option(named, text)}: an IPv6 address is in brackets, as [::1]:8000")
    return bare, int(port)


def is_loopback(address: str) -> bool:
    """Tell whether only programs of this machine reach an address.

    Examples
    --------
    >>> is_loopback("127.0.0.1"), is_loopback("localhost"), is_loopback("0.0.0.0"), is_loopback("hall-7")
    (True, True, False, False)
    """
    try:
        return ipaddress.ip_address(address).is_loopback
    except ValueError:
        return address == "localhost"


def new_token() -> str:
    """Return a token that nobody guesses: 128 random bits."""
    return secrets.token_urlsafe(16)


class Listener:
    """A socket that listens, and the address at which a browser finds it.

    Parameters
    ----------
    bind : tuple of str and int, optional
        Address and port; None: this machine only, at `PORT` or else at a free port.
    named : str, optional
        The option that gives them, for error messages.

    Attributes
    ----------
    socket : socket.socket
    token : str or None
        What the path begins with; None where only this machine reaches it.

    Raises
    ------
    UserError
        If the address is none of this machine's, or the port is taken or not allowed.
    """

    def __init__(self, bind: tuple[str, int] | None = None, named: str = "bind") -> None:
        address, port = bind or (LOOPBACK, PORT)
        try:
            self.socket = listening(address, port)
        except OSError as error:
            if bind is not None:
                raise UserError(
                    f"{option(named, f'{address}:{port}')}: this machine cannot listen there: {reason_of(error)}; "
                    "give another port or address"
                ) from None
            tell(f"port {PORT} of this machine is taken, perhaps by another page: this one has another address")
            self.socket = listening(address, 0)
        self._address = address
        self.token = None if is_loopback(address) else new_token()

    @property
    def url(self) -> str:
        """The page's address; for a server on every address of this machine that of its way to the network."""
        host = self._address
        if host in ("0.0.0.0", "::"):
            host = _outward(self.socket.family)
        host = f"[{host}]" if ":" in host else host
        path = "" if self.token is None else f"{self.token}/"
        return f"http://{host}:{self.socket.getsockname()[1]}/{path}"


def _outward(family: int) -> str:
    """Return this machine's address on its way to the network; nothing is sent to find it out."""
    anywhere = (
        "192.0.2.1" if family == socket.AF_INET else "2001:db8::1"
    )  # for documentation, nobody's (RFC 5737, 3849)
    with socket.socket(family, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect((anywhere, 9))
            return str(probe.getsockname()[0])
        except OSError:
            return socket.gethostname()


class _Counted(H11Protocol):
    """A connection that is one of `MOST` at the most; another is ended before it has said anything.

    uvicorn waits without end for the first request, and for the rest of one whose beginning has come. A hundred
    connections that say nothing, of anybody in the network, would then keep out whoever may look.
    """

    _overdue: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begin, or end the connection."""
        if len(self.connections) >= MOST:
            transport.abort()
        else:
            super().connection_made(transport)
            self._await_request()

    def connection_lost(self, exc: Exception | None) -> None:
        """End, if it has begun."""
        if self in self.connections:
            super().connection_lost(exc)

    def on_response_complete(self) -> None:
        """Wait for the next request, if it is not there already."""
        self._await_request()
        super().on_response_complete()

    def _await_request(self) -> None:
        if self._overdue is not None:
            self._overdue.cancel()
        self._overdue = self.loop.call_later(ASKING_S, self._end_unless_asked, self.cycle)

    def _end_unless_asked(self, latest: object) -> None:
        """End, unless a request came behind the latest one; a connection that became a WebSocket is none of these."""
        if self in self.connections and self.cycle is latest:
            self.transport.abort()


class PageServer:
    """Serves an application on a listener's socket while it is a context.

    Parameters
    ----------
    application : ASGI application
    listener : Listener
    """

    def __init__(self, application: ASGIApp, listener: Listener) -> None:
        self._listener = listener
        config = uvicorn.Config(
            application,
            http=_Counted,
            loop="asyncio",
            ws="websockets-sansio",
            ws_max_size=1024,
            ws_per_message_deflate=False,
            lifespan="off",
            log_config=None,
            # Its words are about its own tasks, not for who looks for a sensor.
            log_level="info" if loudness() is Loudness.VERBOSE else "critical",
            access_log=False,
            server_header=False,
            backlog=BACKLOG,
            timeout_graceful_shutdown=1,
        )
        self._server = uvicorn.Server(config)
        self._thread = threading.Thread(target=self._run, name="live page", daemon=True)

    def _run(self) -> None:
        self._server.run(sockets=[self._listener.socket])

    def __enter__(self) -> Self:
        """Start, and return when browsers are answered."""
        self._thread.start()
        end_s = time.monotonic() + PATIENCE_S
        while not self._server.started:
            if not self._thread.is_alive() or time.monotonic() > end_s:
                raise SystemFailure("the server of the live page did not start")
            time.sleep(0.005)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Let go of the browsers and end."""
        self._server.should_exit = True
        self._thread.join(PATIENCE_S)
        self._listener.socket.close()
