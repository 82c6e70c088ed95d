"""Memory: how much is left, what takes it, and maps that are too large for it."""

import ctypes
import gc
import itertools
import math
import os
import resource
import weakref
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from nnpp_edge.runtime import DynamicPlanner, Ground, Planner, Vehicle, memory, warmup
from nnpp_edge.runtime.errors import InvalidMapError
from nnpp_edge.runtime.map.state import map_state
from nnpp_edge.runtime.memory import (
    available_bytes,
    check_planner_fits,
    rss_bytes,
    small_pages,
    touch,
    virtual_zeros,
)
from nnpp_edge.runtime.planners import methods
from tests.strategies import uniform

BODY = Vehicle(1.5, 1.2, 0.3)
CAR = replace(BODY, turning_radius_m=2.0, reverse_cost=2.0)


def test_memory_is_there_values_stay_and_what_may_not_be_written_is_left_alone():
    rng = np.random.default_rng(0)
    base = np.arange(20000.0)
    fixed = np.arange(9000.0)
    fixed.flags.writeable = False
    values = {
        "floats": rng.random((300, 70)),
        "small": np.array([np.nan, -0.0, np.inf], np.float32),
        "flags": rng.random(5000) < 0.5,
        "none": np.zeros(0),
        "words": rng.integers(-9, 9, 3000).astype(np.int16),
    }
    copies = {name: value.copy() for name, value in values.items()}
    owner = SimpleNamespace(**copies, other="text", fixed=fixed, strided=base[::2])
    touch(owner, SimpleNamespace())
    for name, value in values.items():
        np.testing.assert_array_equal(getattr(owner, name), value)
    np.testing.assert_array_equal(base, np.arange(20000.0))
    before = rss_bytes()
    owner.large = virtual_zeros(1 << 23, np.float64)  # no memory that was given back before
    touch(owner)
    assert rss_bytes() - before > 0.9 * owner.large.nbytes
    assert not owner.large.any()


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
    "version 2": (
        "0::/system.slice/nnpp-edge.service",
        "sys/fs/cgroup/",
        "memory.max",
        "memory.current",
        "",
    ),
    "version 1": (
        "12:cpu,cpuacct:/\n4:memory:/system.slice/nnpp-edge.service\n0::/init.scope",
        "sys/fs/cgroup/memory/",
        "memory.limit_in_bytes",
        "memory.usage_in_bytes",
        "total_",
    ),
}


def test_the_memory_that_is_left_follows_every_control_group_around_the_process(tmp_path):
    """The last group is what a container sees that has no path of its own there."""
    groups = ("system.slice/nnpp-edge.service", "system.slice", "")
    for number, ((version, known), group) in enumerate(itertools.product(GROUPS.items(), groups)):
        (told, root, limit, used, prefix), base = known, tmp_path / str(number)
        files = {
            "proc/meminfo": "MemTotal: 8000000 kB\nMemAvailable:    3000000 kB\n",
            "proc/self/cgroup": f"{told}\n",
            f"{root}{group}/{limit}": f"{1 << 30}\n",
            f"{root}{group}/{used}": f"{600 << 20}\n",
            f"{root}{group}/memory.stat": f"anon 7\n{prefix}inactive_file {100 << 20}\ntotal_x 5\n",
        }
        for name, text in files.items():
            (base / name).parent.mkdir(parents=True, exist_ok=True)
            (base / name).write_text(text)
        assert available_bytes(base) == 524 << 20
        (base / f"{root}{group}/{limit}").write_text(
            "max\n" if version == "version 2" else f"{2**63 - 4096}\n"
        )
        assert available_bytes(base) == 3_000_000 * 1024


def test_a_warm_up_takes_no_more_processes_than_memory_is_left_for(monkeypatch):
    for processors, left_gb, jobs in (
        (4, 0.95, 1),
        (4, 1.45, 2),
        (1, 64, 1),
        (64, 64, 4),
        (4, 0, 1),
    ):
        monkeypatch.setattr(
            os, "sched_getaffinity", lambda _, processors=processors: set(range(processors))
        )
        monkeypatch.setattr(warmup, "available_bytes", lambda left_gb=left_gb: int(left_gb * 1e9))
        assert warmup.default_jobs() == jobs


def test_only_what_is_written_to_takes_memory():
    zeros = virtual_zeros(1 << 31, np.int32)
    before = rss_bytes()
    zeros[:: 1 << 21] = (
        1  # in a thousand places, each of which would bring 2 MiB along as a huge page
    )
    assert rss_bytes() - before < 64 << 20
    assert zeros[1 << 21] == 1 and not zeros[(1 << 21) + 1 : (1 << 21) + 100].any()


def test_huge_pages_are_off_for_a_while():
    def off():
        return ctypes.CDLL(None).prctl(42, 0, 0, 0, 0)  # PR_GET_THP_DISABLE

    assert off() == 0
    with small_pages():
        assert off() == 1
    assert off() == 0


def test_a_corridor_of_a_large_map_has_small_pages(monkeypatch):
    begun = []

    @contextmanager
    def noted():
        begun.append(True)
        yield

    monkeypatch.setattr(methods, "small_pages", noted)
    monkeypatch.setattr(methods, "SPARSE_FROM", 16 * 1000)
    for cols, method, expected in (
        (1001, "corridor", 1),
        (1001, "astar", 0),
        (1000, "corridor", 0),
    ):
        begun.clear()
        plan = Planner(np.zeros((16, cols), np.float32)).plan((2, 2), (9, 99), method=method)
        assert plan.ok
        assert len(begun) == expected


def test_a_map_too_large_for_memory_is_refused_before_anything_is_allocated(monkeypatch):
    huge = np.broadcast_to(np.float32(0.2), (4_000_000, 1_000_000))
    with pytest.raises(InvalidMapError, match="at most 2000000000 cells"):
        Planner(huge)
    check_planner_fits((2048, 2048))
    monkeypatch.setattr(memory, "available_bytes", lambda: 4096 * 4096 * 20)
    check_planner_fits((4096, 4096))
    with pytest.raises(InvalidMapError, match=r"wanted 0\.9 GB"):
        check_planner_fits((4096, 4096), memory.DIRECTED_BYTES_PER_CELL)
    wide = np.broadcast_to(np.float32(0.0), (4096, 4096))
    geared = replace(CAR, gear_change_m=1.0)
    for vehicle, gigabytes in ((BODY, 3.0), (CAR, 3.6), (geared, 5.7)):
        with pytest.raises(InvalidMapError, match=f"wanted {gigabytes} GB"):
            Planner.of_elevation(wide, 0.25, vehicle=vehicle)
    with pytest.raises(InvalidMapError, match="at most 2000000000 cells"):
        check_planner_fits((60_000, 60_000), filed=True)


@pytest.mark.parametrize("cutting", [True, False])
def test_a_file_has_the_coarse_levels_that_a_map_in_memory_has(cutting, monkeypatch):
    monkeypatch.setattr("nnpp_edge.runtime.bands.STRIPE_CELLS", 1)
    heights = uniform(3, (300, 280), 0.0, 0.7)
    filed = memory.filed_zeros(heights.shape, np.float32)
    filed[:] = heights
    one, other = (
        map_state(Ground.of_elevation(each, 1.0), 1.0, cutting, lazy=each is filed)
        for each in (heights, filed)
    )
    for level, same in zip(one.pyramid.levels[1:], other.pyramid.levels[1:], strict=True):
        for name in ("pieces", "links"):
            assert np.array_equal(getattr(level, name), getattr(same, name))
        assert np.array_equal(level.grid.weights, same.grid.weights)
    assert other.costs_computed == 0.0
    assert not any(map(memory.is_filed, [heights, virtual_zeros(1, float)]))


def test_a_map_in_a_file_is_planned_on_as_one_in_memory():
    heights = uniform(3, (300, 280), 0.0, 0.07)
    filed = memory.filed_zeros(heights.shape, np.float32)
    filed[:] = heights
    plans = [Planner.of_elevation(each, 1.0, warn=False) for each in (heights, filed)]
    one, other = (each.plan((5, 5), (290, 270), method="corridor") for each in plans)
    assert one.ok and np.array_equal(one.path, other.path) and one.cost == other.cost
    assert np.shares_memory(plans[1].state.heights.array, filed)
    assert 0.0 < other.costs_computed < one.costs_computed
    bodies = [
        Planner.of_elevation(each, 1.0, vehicle=BODY, warn=False) for each in (heights, filed)
    ]
    checks = [body.plan((5, 5), (290, 270), method="corridor").checks for body in bodies]
    assert checks[0] == checks[1] > 0


ROBOTS = (
    {},
    {"step_cost": "tobler"},
    {"vehicle": Vehicle(radius_m=1.0)},
    {"vehicle": BODY},
    {"vehicle": CAR},
)


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize("method", ["auto", "corridor", "dstar"])
def test_a_planner_that_is_dropped_leaves_its_maps_memory_at_once(robot, method):
    heights = uniform(0, (96, 96), 0.0, 0.1)
    ground = Ground.of_elevation(heights, 0.25, **robot)
    gc.disable()  # which would find what only refers to itself
    try:
        moving = DynamicPlanner(ground, (80, 80), method)
        moving.move((10, 10))
        assert moving.replan().ok
        planner = Planner(ground)
        assert planner.plan((10, 10), (80, 80), method="corridor").ok
        kept = [weakref.ref(each.state.grid) for each in (moving, planner)]
        del moving, planner
        assert not any(each() for each in kept)
    finally:
        gc.enable()
