"""The page on 127.0.0.1: its files, and one WebSocket a tab. Nothing but this machine's own browser is answered."""

import asyncio
import logging
import socket
import threading
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from functools import partial
from importlib.resources import files
from pathlib import Path
from typing import TypeVar

import msgspec
import uvicorn
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.requests import Request
from starlette.responses import FileResponse, Response
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect
from uvicorn.protocols.http.h11_impl import H11Protocol

from nnpp_edge.runtime.errors import NnppEdgeError, OutputError
from nnpp_edge.runtime.reading import reason
from nnpp_edge.view.answers import Answer, Answerer
from nnpp_edge.view.messages import decode
from nnpp_edge.view.trial import Trial

HOST = "127.0.0.1"
_HOSTS = [HOST, "localhost"]
_PAGE = Path(str(files("nnpp_edge.view"))) / "page"
_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
_HEADERS = {
    "content-security-policy": _POLICY,
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cache-control": "no-cache",
}
Result = TypeVar("Result")

_LONGEST_MESSAGE = 1 << 16
_MOST_TABS = 8
"""Each holds a map and a planner of its own."""
_CLOSE_TABS = f"{_MOST_TABS} tabs are open: close one"
_MOST_CONNECTIONS = 64
"""Tabs' own included; a browser opens at most 6 a tab. As many may wait to be accepted."""
_LONGEST_CONNECTION_S = 10.0
"""Of a connection that is not a tab's WebSocket; the page's files take a tenth of a second."""
_LOG = logging.getLogger(__name__)


def listen(port: int) -> socket.socket:
    """A socket that listens on 127.0.0.1, 0 for any free port; OutputError where the port is taken."""
    listening = socket.socket()
    try:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind((HOST, port))
        listening.listen()
    except OSError as error:
        listening.close()
        raise OutputError(
            f"port {port} on {HOST} cannot be used ({reason(error)}): give another with --port"
        ) from error
    return listening


def serve(app: ASGIApp, listening: socket.socket) -> None:
    """Answer until Ctrl-C or SIGTERM."""
    with suppress(KeyboardInterrupt):  # uvicorn raises it again when it has stopped
        server_of(app).run(sockets=[listening])


def server_of(app: ASGIApp) -> uvicorn.Server:
    """The coroutine of `serve`."""
    config = uvicorn.Config(
        app,
        log_config=None,
        loop="asyncio",
        http=_Connection,
        ws="websockets-sansio",
        ws_max_size=_LONGEST_MESSAGE,
        ws_per_message_deflate=False,
        timeout_graceful_shutdown=1,
        backlog=_MOST_CONNECTIONS,
    )
    return uvicorn.Server(config)


def make_app(make_trial: Callable[[], Trial], when_ready: Callable[[], None] = lambda: None) -> Starlette:
    """The application.

    Parameters
    ----------
    make_trial : callable
        Makes what a new tab begins with, in a thread of its own.
    when_ready : callable
        Called once, as soon as requests are answered.
    """
    tabs = 0

    @asynccontextmanager
    async def lifespan(_: Starlette) -> AsyncIterator[None]:
        asyncio.get_running_loop().set_exception_handler(_AcceptErrors())
        when_ready()
        yield

    async def page(_: Request) -> Response:
        return FileResponse(_PAGE / "index.html")

    async def live(websocket: WebSocket) -> None:
        nonlocal tabs
        if websocket.headers.get("origin") != f"http://{websocket.headers.get('host')}":
            await websocket.close(1008)
            return
        await websocket.accept()
        tabs += 1
        try:
            with suppress(WebSocketDisconnect, asyncio.CancelledError):  # the tab, or the server, ends
                if tabs > _MOST_TABS:
                    await _send(websocket, {"type": "problem", "number": 0, "text": _CLOSE_TABS})
                    await websocket.close(1013)
                    return
                await _converse(websocket, make_trial)
        finally:
            tabs -= 1

    return Starlette(
        routes=[Route("/", page), WebSocketRoute("/live", live), Mount("/page", StaticFiles(directory=_PAGE))],
        middleware=[
            Middleware(TrustedHostMiddleware, allowed_hosts=_HOSTS, www_redirect=False),
            Middleware(_Headers),
        ],
        lifespan=lifespan,
    )


async def _converse(websocket: WebSocket, make_trial: Callable[[], Trial]) -> None:
    """Answer one tab's messages, one after another, until it closes."""
    try:
        answerer = Answerer(await _in_thread(make_trial))
    except NnppEdgeError as error:
        await _send(websocket, {"type": "problem", "number": 0, "text": str(error)})
        await websocket.close(1011)
        return
    while True:
        text = await websocket.receive_text()
        try:
            message = decode(text)
        except NnppEdgeError as error:
            await _send(websocket, {"type": "problem", "number": 0, "text": str(error)})
            continue
        for answer in await _in_thread(partial(answerer.answer, message)):
            await _send(websocket, answer)


async def _in_thread(work: Callable[[], Result]) -> Result:
    """Result of `work`, done in a thread that neither a tab that closes nor the server's end waits for."""
    loop = asyncio.get_running_loop()
    done: asyncio.Future[Result] = loop.create_future()

    def tell(give: Callable[[], None]) -> None:
        with suppress(RuntimeError):  # the server has ended
            loop.call_soon_threadsafe(lambda: None if done.done() else give())

    def run() -> None:
        try:
            result = work()
        except Exception as error:
            tell(partial(done.set_exception, error))
        else:
            tell(partial(done.set_result, result))

    threading.Thread(target=run, daemon=True).start()
    return await done


async def _send(websocket: WebSocket, answer: Answer | bytes) -> None:
    if isinstance(answer, bytes):
        await websocket.send_bytes(answer)
    else:
        await websocket.send_text(msgspec.json.encode(answer).decode())


class _Connection(H11Protocol):
    """A connection that is closed where there are too many, or where it becomes no tab's WebSocket in time."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]  # as uvicorn has it
        """Begin to count the time."""
        super().connection_made(transport)
        if len(self.connections) > _MOST_CONNECTIONS:
            transport.abort()
        else:
            self.loop.call_later(_LONGEST_CONNECTION_S, self._end)

    def _end(self) -> None:
        if self.transport.get_protocol() is self:
            self.transport.abort()


class _AcceptErrors:
    """Says once that connections cannot be accepted; asyncio tries again after a second, and logs each try."""

    def __init__(self) -> None:
        self._told = False

    def __call__(self, loop: asyncio.AbstractEventLoop, context: dict[str, object]) -> None:
        """Handle what nobody caught in the loop of events."""
        error = context.get("exception")
        if "accept" not in str(context["message"]) or not isinstance(error, OSError):
            loop.default_exception_handler(context)
        elif not self._told:
            self._told = True
            _LOG.warning("warning: new connections wait (%s)", reason(error))


class _Headers:
    """Adds the same headers to every answer."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on."""

        async def with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                more = [(name.encode(), value.encode()) for name, value in _HEADERS.items()]
                message["headers"] = [*message["headers"], *more]
            await send(message)

        await self._app(scope, receive, with_headers if scope["type"] == "http" else send)
