import math
import resource
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from nnpp_edge.runtime.loop.realtime import rss_bytes
from nnpp_edge.runtime.memory import available_bytes, touch


def test_memory_is_there_and_values_stay():
    rng = np.random.default_rng(0)
    values = {
        "floats": rng.random((300, 70)),
        "small": np.array([np.nan, -0.0, np.inf], np.float32),
        "flags": rng.random(5000) < 0.5,
        "none": np.zeros(0),
        "words": rng.integers(-9, 9, 3000).astype(np.int16),
    }
    owner = SimpleNamespace(**{name: value.copy() for name, value in values.items()}, other="text")
    touch(owner, SimpleNamespace())
    for name, value in values.items():
        np.testing.assert_array_equal(getattr(owner, name), value)
    before = rss_bytes()
    owner.large = np.zeros(1 << 23)  # so large that it cannot be memory that was given back before
    touch(owner)
    assert rss_bytes() - before > 0.9 * owner.large.nbytes
    assert not owner.large.any()


def test_what_may_not_be_written_is_left_alone():
    fixed, base = np.arange(9000.0), np.arange(20000.0)
    fixed.flags.writeable = False
    owner = SimpleNamespace(fixed=fixed, strided=base[::2])
    touch(owner)
    np.testing.assert_array_equal(base, np.arange(20000.0))


def test_the_memory_that_is_left_follows_the_process_own_limit():
    before = available_bytes()
    assert 0 < before < 1 << 62
    old = resource.getrlimit(resource.RLIMIT_AS)
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + (64 << 20), old[1]))
    try:
        assert 0 < available_bytes() <= 64 << 20
    finally:
        resource.setrlimit(resource.RLIMIT_AS, old)
    assert math.isclose(available_bytes(), before, rel_tol=0.5)
