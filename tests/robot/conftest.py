"""A free map, a loop over a source, waiting, and a full disk: what tests of transports share."""

import time
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from nnpp_edge.robot.transports import incoming
from nnpp_edge.runtime import Ground, InProcessSink, Loop, Navigator, PathMessage


def free(shape=(40, 60)):
    """A map without obstacles."""
    return np.full(shape, 0.2, np.float32)


def wait_until(holds, patience_s=30.0):
    """Wait for something that another thread or process does."""
    until = time.monotonic() + patience_s
    while not holds():
        assert time.monotonic() < until, "it did not come about"
        time.sleep(0.005)


@pytest.fixture
def navigator():
    """Exact planning on a free map, without pose and goal."""
    return Navigator(Ground(free()), method="astar")


@pytest.fixture
def drive():
    """Run a loop over a source until the source ends, or for so many ticks; what came out."""

    def run(navigator, source, sinks=(), *, rate_hz=200.0, ticks=None, ends=None, **options):
        kept = InProcessSink(100_000)

        def after_tick(message):
            if (ends or source).ended:
                loop.stop()

        loop = Loop(
            navigator,
            source,
            [*sinks, kept],
            rate_hz=rate_hz,
            queue=10_000,
            after_tick=after_tick,
            **options,
        )
        counters = loop.run(ticks)
        paths = [m for m in kept.messages if isinstance(m, PathMessage)]
        return SimpleNamespace(counters=counters, paths=paths)

    return run


class FullDisk:
    """A file with room for so many bytes."""

    def __init__(self, file, room):
        self._file = file
        self._room = room

    def write(self, data):
        if not self._room:
            raise OSError(28, "No space left on device")
        fitting = data[: self._room]
        self._room -= len(fitting)
        return self._file.write(fitting)

    def __getattr__(self, name):
        return getattr(self._file, name)


@pytest.fixture
def make_mailbox(monkeypatch):
    """Have the mailbox of the source that is made next made so."""
    return partial(monkeypatch.setattr, incoming, "Mailbox")


@pytest.fixture
def full_disk(monkeypatch):
    """A file that is opened meanwhile has room for so many bytes."""

    @contextmanager
    def opening(room):
        opened = Path.open
        with monkeypatch.context() as patched:
            patched.setattr(
                Path, "open", lambda *given, **more: FullDisk(opened(*given, **more), room)
            )
            yield

    return opening
