"""What systemd is told, and a manager that is missing or does not read."""

import itertools
import logging
import os
import secrets
import socket
import time
from contextlib import ExitStack, closing, suppress

import pytest

from nnpp_edge.robot.operations.systemd import Notifier
from nnpp_edge.runtime import Counters, Status, StatusMessage


@pytest.fixture(params=["path", "abstract"])
def manager(tmp_path, request):
    """A socket as systemd's, and its name: a path or an abstract one."""
    name = str(tmp_path / "notify")
    place = name
    if request.param == "abstract":
        name = f"@nnpp-edge-{secrets.token_hex(8)}"
        place = "\0" + name[1:]
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as receiver:
        receiver.bind(place)
        yield name, receiver


@pytest.fixture
def notify(monkeypatch):
    """Make notifiers told a socket and a watchdog; their sockets are closed at the end."""

    def make(name, watchdog=()):
        for variable, text in {"NOTIFY_SOCKET": name, **dict(watchdog)}.items():
            monkeypatch.setenv(variable, text)
        return stack.enter_context(closing(Notifier()))

    for variable in ("NOTIFY_SOCKET", "WATCHDOG_USEC", "WATCHDOG_PID"):
        monkeypatch.delenv(variable, raising=False)
    with ExitStack() as stack:
        yield make


def waiting(receiver):
    """All that was sent."""
    receiver.setblocking(False)
    words = []
    with suppress(BlockingIOError):
        while True:
            words.append(receiver.recv(4096).decode())
    return words


def test_the_manager_hears_each_word(manager, notify):
    name, receiver = manager
    notifier = notify(name)
    for word in (notifier.ready, notifier.stopping, notifier.alive, notifier.close, notifier.ready):
        word()
    assert waiting(receiver) == ["READY=1", "STOPPING=1"]


def test_the_watchdog_hears_at_most_twice_in_its_time(manager, notify, monkeypatch):
    name, receiver = manager
    notifier = notify(name, {"WATCHDOG_USEC": "2000000", "WATCHDOG_PID": str(os.getpid())})
    clock = itertools.count()
    monkeypatch.setattr(time, "monotonic", lambda: 50.0 + 0.1 * next(clock))
    assert notifier.watchdog_s == 2.0
    for _ in range(50):
        notifier.alive()
    assert waiting(receiver) == ["WATCHDOG=1"] * 5


@pytest.mark.parametrize(
    "watchdog",
    [
        {"WATCHDOG_USEC": "2000000", "WATCHDOG_PID": str(os.getppid())},
        {"WATCHDOG_USEC": "2000000", "WATCHDOG_PID": "me"},
        {"WATCHDOG_USEC": "-5"},
        {"WATCHDOG_USEC": "soon"},
    ],
)
def test_a_watchdog_that_is_not_ours_hears_nothing(manager, notify, watchdog):
    name, receiver = manager
    notifier = notify(name, watchdog)
    assert notifier.watchdog_s is None
    notifier.alive()
    notifier.ready()
    assert waiting(receiver) == ["READY=1"]


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("two\nlines\tand more", "two lines and more"),
        ("READY=1\nSTOPPING=1", "READY=1 STOPPING=1"),
        ("größer als 2 %", "größer als 2 %"),
        ("x" * 5000, "x" * 200),
        ("a\u2028b", "a b"),
    ],
    ids=["breaks", "words of systemd", "umlauts", "long", "odd characters"],
)
def test_a_status_is_one_line(manager, notify, text, line):
    name, receiver = manager
    notify(name).publish(StatusMessage(1, Status.OK, text, Counters()))
    assert waiting(receiver) == ["STATUS=" + line]


@pytest.mark.parametrize("name", ["", "notify", "@", "vsock:2:1234"])
def test_without_a_manager_nothing_happens(notify, name):
    notifier = notify(name, {"WATCHDOG_USEC": "1000"})
    assert notifier.watchdog_s is None
    notifier.ready()
    notifier.alive()


def test_a_manager_that_went_away_or_does_not_read_is_warned_of_once(tmp_path, caplog, notify):
    notifier = notify(str(tmp_path / "gone"))
    with caplog.at_level(logging.WARNING):
        notifier.ready()
        notifier.stopping()
    assert len(caplog.records) == 1
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as receiver:
        receiver.bind(str(tmp_path / "full"))
        notifier = notify(str(tmp_path / "full"))
        for _ in range(5000):  # never waits for the reader
            notifier.ready()
        assert 0 < len(waiting(receiver)) < 5000
