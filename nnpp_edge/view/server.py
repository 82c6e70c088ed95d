"""The page on 127.0.0.1: its files, and answers to its questions, for this machine's own browser
alone.
"""

import mimetypes
import re
import sys
from collections.abc import Callable
from contextlib import suppress
from http.server import BaseHTTPRequestHandler
from importlib.resources import files
from io import BufferedReader, FileIO
from pathlib import Path
from socketserver import ThreadingTCPServer
from tempfile import TemporaryDirectory
from urllib.parse import unquote

import msgspec

from nnpp_edge.robot.transports.stdio import messages
from nnpp_edge.robot.transports.wire import WireError, decode_output
from nnpp_edge.runtime.errors import NnppEdgeError, OutputError
from nnpp_edge.runtime.loop.messages import PathMessage
from nnpp_edge.runtime.reading import reason
from nnpp_edge.view.answers import Answerer

HOST = "127.0.0.1"
_PAGE = Path(str(files("nnpp_edge.view"))) / "page"
_FILES = {f"/page/{path.name}": path for path in _PAGE.iterdir()} | {"/": _PAGE / "index.html"}
_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; connect-src "
    "'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
_HEADERS = {
    "Content-Security-Policy": _POLICY,
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-cache",
}
_LONGEST_QUESTION = 1 << 16
_LARGEST_FILE = 1 << 28
_MOST_DROPPED = 2
"""Bytes of a map that is dropped onto the page, and how many of these are kept, the newest."""
_MOST_DIGITS = 18
"""Of a number in a request."""
_NO_MAP = "wanted a map's number after ?map="


def _whole(word: str) -> int | None:
    """A whole number in a request; None for anything else."""
    return int(word) if word.isdecimal() and len(word) <= _MOST_DIGITS else None


class PageServer(ThreadingTCPServer):
    """Listens on a port, 0 for any that is free, from when it is made; OutputError where the port
    is taken.
    """

    allow_reuse_address = True
    daemon_threads = True
    request_queue_size = 64
    open_map: Callable[[Path], Answerer]
    """Reads a map that is dropped onto the page."""
    live = b"null"
    """The newest message of the run that is followed; null without one."""

    def __init__(self, port: int) -> None:
        self.maps: list[Answerer | None] = []
        """By the number in the page's address: that of the command line, then those that were
        dropped.
        """
        try:
            super().__init__((HOST, port), _Handler)
        except OSError as error:
            why = f"cannot be used ({reason(error)}): give another with --port"
            raise OutputError(f"port {port} on {HOST} {why}") from error

    @property
    def address(self) -> str:
        """Of the page."""
        return f"http://{HOST}:{self.server_address[1]}/"

    def serve(self) -> None:
        """Answer until Ctrl-C."""
        with suppress(KeyboardInterrupt):
            self.serve_forever()

    def follow(self) -> None:
        """Show what a run says on stdin of its robot, as it comes; what is no message of a run is
        passed over.
        """
        self.live = b"{}"
        for line in messages(BufferedReader(FileIO(0, closefd=False))):
            with suppress(WireError):
                if isinstance(line, bytes) and isinstance(decode_output(line), PathMessage):
                    self.live = line

    def handle_error(self, request: object, client_address: object) -> None:
        """Say what went wrong, unless a tab was closed while it was answered."""
        if not isinstance(sys.exception(), ConnectionError):
            super().handle_error(request, client_address)  # type: ignore[arg-type]  # it prints them alone


class _Handler(BaseHTTPRequestHandler):
    """One request; a connection that sends nothing or half a request is closed after a while."""

    timeout = 10.0
    server: PageServer

    def do_GET(self) -> None:
        """A file of the page, what it opens with, or what there is to tell meanwhile."""
        path, number = self._asked()
        answerer = self._answerer(number)
        if not self._is_asked_of_us():
            self.send_error(400, "this page is for this machine alone")
        elif number is None:
            self.send_error(400, _NO_MAP)
        elif path == "/opening" and answerer:
            self._send(answerer.opening(), "application/json")
        elif path == "/news" and answerer:
            live = msgspec.Raw(b"null" if number else self.server.live)
            news = {"notice": answerer.notice, "live": live}
            self._send(msgspec.json.encode(news), "application/json")
        elif file := _FILES.get(path):
            self._send(file.read_bytes(), mimetypes.guess_type(file)[0] or "text/plain")
        else:
            self.send_error(404)

    def do_POST(self) -> None:
        """A question of our own page, or a map that was dropped onto it."""
        path, number = self._asked()
        length = _whole(self.headers.get("Content-Length", ""))
        answerer = self._answerer(number)
        most = _LARGEST_FILE if path == "/drop" else _LONGEST_QUESTION
        if (
            not self._is_asked_of_us()
            or self.headers.get("Origin") != f"http://{self.headers['Host']}"
        ):
            self.send_error(403, "questions of other pages are not answered")
        elif number is None:
            self.send_error(400, _NO_MAP)
        elif path not in ("/ask", "/drop") or answerer is None:
            self.send_error(404)
        elif length is None:
            self.send_error(400, "wanted a Content-Length in digits")
        elif length > most:
            self.send_error(413)
        elif path == "/drop":
            self._send(self._dropped(length), "application/json")
        else:
            self._send(answerer.answer(self.rfile.read(length)), "application/octet-stream")

    def _asked(self) -> tuple[str, int | None]:
        """The path that is asked for and the number of the map, None where it is no number."""
        path, named, number = self.path.partition("?map=")
        return path, _whole(number) if named else 0

    def _answerer(self, number: int | None) -> Answerer | None:
        """Of the map that is asked of, if it is open."""
        maps = self.server.maps
        return None if number is None or number >= len(maps) else maps[number]

    def _dropped(self, length: int) -> bytes:
        """JSON of the number of a map that is dropped onto the page, or a ``problem`` in
        one line.
        """
        maps = self.server.maps
        name = re.sub(r"[^\w.+-]", "_", unquote(self.headers.get("X-Name", "")))[-100:]
        with TemporaryDirectory() as folder:
            file = Path(folder) / (name.lstrip(".") or "map")
            why = ""
            try:
                file.write_bytes(self.rfile.read(length))
                maps.append(self.server.open_map(file))
            except NnppEdgeError as error:
                why = str(error)
            except (OSError, MemoryError) as error:
                why = f"{name}: not enough room ({error})"
            if why:
                return msgspec.json.encode({"problem": why.replace(f"{folder}/", "")})
        maps[1:-_MOST_DROPPED] = [None] * len(maps[1:-_MOST_DROPPED])
        return msgspec.json.encode({"map": len(maps) - 1})

    def _is_asked_of_us(self) -> bool:
        """Whether it is our name that the browser knows: another's page may have been given our
        address.
        """
        return self.headers.get("Host", "").partition(":")[0] in (HOST, "localhost")

    def _send(self, content: bytes, kind: str) -> None:
        self.send_response(200)
        for name, value in _HEADERS.items():
            self.send_header(name, value)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, format: str, *words: object) -> None:
        """Log nothing."""
