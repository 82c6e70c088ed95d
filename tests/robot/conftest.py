"""A free map, a loop over a source, and waiting: what tests of transports share."""

import time
from types import SimpleNamespace

import numpy as np
import pytest

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
