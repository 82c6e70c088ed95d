"""The page on 127.0.0.1: its files, and answers to its questions, for this machine's own browser
alone.
"""

import mimetypes
import sys
from contextlib import suppress
from http.server import BaseHTTPRequestHandler
from importlib.resources import files
from pathlib import Path
from socketserver import ThreadingTCPServer

import msgspec

from nnpp_edge.runtime.errors import OutputError
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
_MOST_DIGITS = 18
"""Of a question's length."""


class PageServer(ThreadingTCPServer):
    """Listens on a port, 0 for any that is free, from when it is made; OutputError where the port
    is taken.
    """

    allow_reuse_address = True
    daemon_threads = True
    request_queue_size = 64
    answerer: Answerer
    """Set before it serves."""

    def __init__(self, port: int) -> None:
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
        if not self._is_asked_of_us():
            self.send_error(400, "this page is for this machine alone")
        elif self.path == "/opening":
            self._send(self.server.answerer.opening(), "application/json")
        elif self.path == "/news":
            news = {"notice": self.server.answerer.notice}
            self._send(msgspec.json.encode(news), "application/json")
        elif file := _FILES.get(self.path):
            self._send(file.read_bytes(), mimetypes.guess_type(file)[0] or "text/plain")
        else:
            self.send_error(404)

    def do_POST(self) -> None:
        """A question of our own page."""
        length = self.headers.get("Content-Length", "")
        if (
            not self._is_asked_of_us()
            or self.headers.get("Origin") != f"http://{self.headers['Host']}"
        ):
            self.send_error(403, "questions of other pages are not answered")
        elif self.path != "/ask":
            self.send_error(404)
        elif not length.isdecimal() or len(length) > _MOST_DIGITS:
            self.send_error(400, "wanted a Content-Length in digits")
        elif int(length) > _LONGEST_QUESTION:
            self.send_error(413)
        else:
            question = self.rfile.read(int(length))
            self._send(self.server.answerer.answer(question), "application/octet-stream")

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
