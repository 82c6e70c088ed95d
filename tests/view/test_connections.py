"""The server of `nnpp-edge view`: connections that send nothing or half a request, and too many of them."""

import errno
import socket
import threading
import time
from contextlib import contextmanager

import pytest

from nnpp_edge.view import server

HALF = b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n"
WHOLE = HALF + b"\r\n"
UPGRADE = (
    b"GET /live HTTP/1.1\r\nHost: 127.0.0.1\r\nOrigin: http://127.0.0.1\r\nConnection: Upgrade\r\n"
    b"Upgrade: websocket\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n"
)


class ShortOfDescriptors(socket.socket):
    """A listening socket that has no descriptor left for new connections, for as long as `short`."""

    short = False
    tries = 0

    def accept(self):
        if self.short:
            self.tries += 1
            raise OSError(errno.EMFILE, "Too many open files")
        return super().accept()


@contextmanager
def serving(listening):
    """A server in a thread, whose tabs wait for a trial until the end; yields how to connect."""
    ready, ended = threading.Event(), threading.Event()
    running = server.server_of(server.make_app(ended.wait, ready.set))
    thread = threading.Thread(target=running.run, kwargs={"sockets": [listening]})
    thread.start()
    opened = []

    def opening(sent):
        opened.append(socket.create_connection(("127.0.0.1", listening.getsockname()[1]), timeout=10))
        opened[-1].sendall(sent)
        return opened[-1]

    try:
        assert ready.wait(10)
        yield opening
    finally:
        for each in opened:
            each.close()
        ended.set()
        running.should_exit = True
        thread.join(10)


def answered(connection):
    return connection.recv(12) == b"HTTP/1.1 200"


def closed(connection):
    """Wait until the server has closed it."""
    try:
        while connection.recv(1 << 16):
            pass
    except ConnectionResetError:
        pass
    return True


@pytest.mark.parametrize("sent", [b"", HALF, WHOLE, WHOLE + HALF])
def test_a_connection_is_closed_after_a_while_unless_it_is_a_tabs(monkeypatch, sent):
    monkeypatch.setattr(server, "_LONGEST_CONNECTION_S", 0.2)
    with serving(server.listen(0)) as opening:
        tab = opening(UPGRADE)
        assert tab.recv(12) == b"HTTP/1.1 101"
        idle = opening(sent)
        idle.settimeout(3)  # uvicorn's own limit after an answer is 5 s
        assert closed(idle)
        tab.settimeout(0.05)
        tab.recv(1 << 16)
        with pytest.raises(TimeoutError):
            tab.recv(1)


def test_a_connection_too_many_is_closed_at_once(monkeypatch):
    monkeypatch.setattr(server, "_MOST_CONNECTIONS", 3)
    with serving(server.listen(0)) as opening:
        idle = [opening(b"") for _ in range(2)]
        assert answered(opening(WHOLE))
        assert closed(opening(b""))
        idle.pop().close()
        time.sleep(0.05)
        assert answered(opening(WHOLE))


def test_without_descriptors_one_line_is_said_and_the_server_waits(caplog):
    with server.listen(0) as plain:
        listening = ShortOfDescriptors(fileno=plain.detach())
        with serving(listening) as opening:
            listening.short = True
            waiting = opening(WHOLE)
            time.sleep(0.3)
            tries = listening.tries
            listening.short = False
            assert answered(waiting)
    assert 0 < tries <= 64
    assert caplog.messages == ["warning: new connections wait (Too many open files)"]
