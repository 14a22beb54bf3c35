"""What the server answers: the page's files, the stream of messages, and the map of the expected error.

Nothing of it is for strangers: without a token only names of this machine itself are answered, so that no other page
in the same browser reads along by a name of its own (DNS rebinding); with one, only whoever has the whole address. A
browser names the page that a script comes from (``Origin``), and that must be this one.
"""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import Callable
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import Request
from starlette.responses import JSONResponse, PlainTextResponse, RedirectResponse, Response
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect

from goldfield.errors import UserError
from goldfield.page.hub import Hub, Mailbox

SEND_EVERY_S = 0.05
"""Messages that came meanwhile go to the browser in one frame: it draws no more than twenty pictures a second."""
STATE_EVERY_S = 1.0
OWN_NAMES = ("localhost", "127.0.0.1", "::1")
"""Names by which a browser of this machine asks this machine."""
HEADERS = {
    "content-security-policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "cache-control": "no-cache",
}

ErrorMap = Callable[[float], dict[str, Any]]


def application(hub: Hub, assets: Path, error_map: ErrorMap, token: str | None = None) -> ASGIApp:
    """Return the application.

    Parameters
    ----------
    hub : Hub
    assets : Path
        Folder of the built page.
    error_map : callable
        Returns the map of the expected error at a height, m, as JSON; `UserError` if there is none.
    token : str, optional
        First part of each path; None: the server is for browsers of this machine.
    """

    async def live(socket: WebSocket) -> None:
        await socket.accept()
        box = hub.open()
        try:
            async with asyncio.TaskGroup() as tasks:
                sending = tasks.create_task(_send(socket, hub, box))
                await _until_closed(socket)
                sending.cancel()
        finally:
            hub.close(box)

    async def expected_error(request: Request) -> Response:
        try:
            height_m = float(request.query_params.get("z", ""))
            return JSONResponse(await run_in_threadpool(error_map, height_m))
        except ValueError:
            return PlainTextResponse("z= must be a height in metres", status_code=400)
        except UserError as error:
            return PlainTextResponse(str(error), status_code=400)

    routes = [
        WebSocketRoute("/live", live),
        Route("/expected_error", expected_error),
        Mount("/", StaticFiles(directory=assets, html=True)),
    ]
    return Guard(Starlette(routes=routes), token)


async def _send(socket: WebSocket, hub: Hub, box: Mailbox) -> None:
    """Send what waits, again and again; a browser that takes nothing holds up this coroutine alone."""
    told_s = -STATE_EVERY_S
    clock = asyncio.get_running_loop().time
    while True:
        messages = box.take()
        if clock() - told_s >= STATE_EVERY_S:
            told_s = clock()
            messages.append(hub.state_message())
        if messages:
            try:
                await socket.send_text(f"[{','.join(messages)}]")
            except WebSocketDisconnect:
                return
        await asyncio.sleep(SEND_EVERY_S)


async def _until_closed(socket: WebSocket) -> None:
    """Wait until the browser goes; what it says until then has no meaning."""
    while (await socket.receive())["type"] != "websocket.disconnect":
        pass


class Guard:
    """Lets through to an application what may look, takes the token off the path, and adds the headers.

    Parameters
    ----------
    inner : ASGI application
    token : str or None
    """

    def __init__(self, inner: ASGIApp, token: str | None) -> None:
        self._inner = inner
        self._token = token

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request, or refuse it."""
        headers = Headers(scope=scope)
        path = self._path_after_token(scope["path"])
        if not (self._is_own_name(headers.get("host", "")) and _same_origin(headers)):
            await _refuse(403, "this page is for the machine that serves it", scope, receive, send)
        elif path is None:
            await _refuse(
                404, "there is nothing here: the whole address, token and all, is needed", scope, receive, send
            )
        elif path == "":
            await RedirectResponse(f"{scope['path']}/")(scope, receive, _with_headers(send))
        else:
            await self._inner({**scope, "path": path, "raw_path": path.encode()}, receive, _with_headers(send))

    def _path_after_token(self, path: str) -> str | None:
        """Return the rest of a path; None if it does not begin with the token."""
        if self._token is None:
            return path
        _, first, *rest = path.split("/", 2)
        right = secrets.compare_digest(first.encode(), self._token.encode())
        return "".join(f"/{part}" for part in rest) if right else None

    def _is_own_name(self, host: str) -> bool:
        """Tell whether a request asks for a name of this machine itself; with a token any name will do."""
        name = host.rpartition(":")[0] if not host.endswith("]") and ":" in host else host
        return self._token is not None or name.strip("[]").lower() in OWN_NAMES


def _same_origin(headers: Headers) -> bool:
    """Tell whether a request comes from this very page, or from no page at all."""
    origin = headers.get("origin")
    return origin is None or origin.partition("://")[2] == headers.get("host")


async def _refuse(status: int, text: str, scope: Scope, receive: Receive, send: Send) -> None:
    if scope["type"] == "websocket":
        await send({"type": "websocket.close", "code": 1008, "reason": text})
    else:
        await PlainTextResponse(text, status_code=status)(scope, receive, _with_headers(send))


def _with_headers(send: Send) -> Send:
    async def sent(message: Message) -> None:
        if message["type"] == "http.response.start":
            MutableHeaders(scope=message).update(HEADERS)
        await send(message)

    return sent
