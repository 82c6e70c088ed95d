import math
import os
import resource
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from nnpp_edge.runtime import warmup
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


GROUPS = {
    "version 2": ("0::/system.slice/nnpp-edge.service", "sys/fs/cgroup/", "memory.max", "memory.current", ""),
    "version 1": (
        "12:cpu,cpuacct:/\n4:memory:/system.slice/nnpp-edge.service\n0::/init.scope",
        "sys/fs/cgroup/memory/",
        "memory.limit_in_bytes",
        "memory.usage_in_bytes",
        "total_",
    ),
}


@pytest.mark.parametrize("version", GROUPS)
@pytest.mark.parametrize("group", ["system.slice/nnpp-edge.service", "system.slice", ""])
def test_the_memory_that_is_left_follows_every_control_group_around_the_process(tmp_path, version, group):
    """The last is what a container sees that has no path of its own there."""
    told, root, limit, used, prefix = GROUPS[version]
    files = {
        "proc/meminfo": "MemTotal: 8000000 kB\nMemAvailable:    3000000 kB\n",
        "proc/self/cgroup": f"{told}\n",
        f"{root}{group}/{limit}": f"{1 << 30}\n",
        f"{root}{group}/{used}": f"{600 << 20}\n",
        f"{root}{group}/memory.stat": f"anon 7\n{prefix}inactive_file {100 << 20}\ntotal_x 5\n",
    }
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    assert available_bytes(tmp_path) == 524 << 20
    (tmp_path / f"{root}{group}/{limit}").write_text("max\n" if version == "version 2" else f"{2**63 - 4096}\n")
    assert available_bytes(tmp_path) == 3_000_000 * 1024


@pytest.mark.parametrize(
    ("processors", "left_gb", "jobs"), [(4, 0.95, 1), (4, 1.45, 2), (1, 64, 1), (64, 64, 4), (4, 0, 1)]
)
def test_a_warm_up_takes_no_more_processes_than_memory_is_left_for(monkeypatch, processors, left_gb, jobs):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(processors)))
    monkeypatch.setattr(warmup, "available_bytes", lambda: int(left_gb * 1e9))
    assert warmup.default_jobs() == jobs
