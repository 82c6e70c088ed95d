"""Compiled kernels on disk: kept for other processes, and never in the way of a plan."""

import errno
import os
import signal
import sys
import time
import warnings
from pathlib import Path

import numpy as np
import pytest

from nnpp_edge.runtime import warmup
from nnpp_edge.runtime.compiled import cache, claims, places
from nnpp_edge.runtime.compiled import kernel as compiling
from nnpp_edge.runtime.errors import OutputError
from nnpp_edge.runtime.stopwatch import Work

TYPES = np.int8, np.int32, np.int64, np.uint8, np.float32, np.float64


def double(x):
    return x + x


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Where kernels made in this process are kept."""
    folder = tmp_path / "cache" / "kernels"
    monkeypatch.setattr(places, "OWN", folder)
    monkeypatch.setattr(places, "READ", ())
    monkeypatch.setattr(cache, "save_error", None)
    return folder


@pytest.fixture
def made_folder(folder):
    """The same, which is there already."""
    folder.mkdir(mode=0o700, parents=True)
    folder.parent.chmod(0o700)
    return folder


def compilations(function, *arguments):
    """Call a fresh kernel of `function`, as another process would; its answer and how often it was
    compiled.
    """
    fresh = compiling.kernel(function)
    return fresh(*arguments), sum(fresh.stats.cache_misses.values())


def kept(folder: Path) -> list[Path]:
    return sorted(folder.rglob("*.nbc"))


# Other processes


def forked(work):
    """The number of a child that does this."""
    with warnings.catch_warnings(
        action="ignore"
    ):  # Python 3.12 on warns of every fork beside a thread
        child = os.fork()
    if child == 0:
        try:
            work()
            os._exit(0)
        finally:
            os._exit(1)
    return child


def ended(child):
    return os.waitpid(child, 0)[1]


def test_processes_at_once_keep_every_version(folder):
    parts = [TYPES[first::3] for first in range(3)]
    children = [
        forked(lambda part=part: [compilations(double, kind(21)) for kind in part])
        for part in parts
    ]
    assert list(map(ended, children)) == [0, 0, 0]
    assert all(compilations(double, kind(21)) == (42, 0) for kind in TYPES)
    assert len(kept(folder)) == len(TYPES)


def test_a_process_killed_while_saving_leaves_nothing_in_the_way(folder):
    def save_and_die():
        Path.replace = lambda *_: os.kill(os.getpid(), signal.SIGKILL)
        compilations(double, 1)

    assert ended(forked(save_and_die)) == signal.SIGKILL
    (left,) = folder.iterdir()
    assert left.suffix != ".nbc"
    assert [compilations(double, 1) for _ in range(2)] == [(2, 1), (2, 0)]


@pytest.mark.parametrize("killed", [False, True])
def test_a_version_is_compiled_by_one_of_those_that_fill_a_folder(made_folder, tmp_path, killed):
    def fill(name, before_it_is_kept):
        def save(self, sig, data, save=cache.KernelCache.save_overload):
            (tmp_path / name).touch()
            before_it_is_kept()
            save(self, sig, data)

        cache.KernelCache.save_overload = save
        with claims.shared(made_folder):
            assert compilations(double, 21)[0] == 42

    ends = (lambda: os.kill(os.getpid(), signal.SIGKILL)) if killed else (lambda: time.sleep(0.5))
    first = forked(lambda: fill("first", ends))
    while not (tmp_path / "first").exists():
        time.sleep(0.01)
    second = forked(lambda: fill("second", lambda: None))
    assert (ended(first), ended(second)) == (signal.SIGKILL if killed else 0, 0)
    assert (tmp_path / "second").exists() == killed  # it compiled


# What is read back


def test_a_kernel_is_compiled_once_for_each_set_of_types(folder):
    def other(x):
        return x - x

    frozen = np.ones(3)
    frozen.flags.writeable = False
    for argument in (1, 1.0, np.float32(1), np.ones(3), frozen, np.ones((3, 3))[:, 0]):
        assert compilations(double, argument)[1] == 1
        answer, compiled = compilations(double, argument)
        np.testing.assert_array_equal(answer, argument + argument)
        assert compiled == 0
    compilations(other, 1)
    assert cache.count_kept(folder) == (2, 7)
    assert compilations(other, 1) == (0, 0)


def test_what_is_damaged_or_may_be_anothers_is_compiled_anew_and_replaced(folder, monkeypatch):
    compilations(double, 1)
    (path,) = kept(folder)
    for damage in (
        lambda content: b"",
        lambda content: content[: len(content) // 2],
        lambda content: bytes(len(content)),
        lambda content: content[:1000] + bytes([content[1000] ^ 1]) + content[1001:],
        lambda content: content + b"more",
    ):
        damaged = damage(path.read_bytes())
        path.write_bytes(damaged)
        assert compilations(double, 1) == (2, 1)
        assert len(kept(folder)) == 1 and path.read_bytes() != damaged
        assert compilations(double, 1) == (2, 0)
    path.chmod(0o622)
    assert compilations(double, 1) == (2, 1)
    assert path.stat().st_uid == os.geteuid() and path.stat().st_mode & 0o777 == 0o600
    if os.geteuid() == 0:  # only root gives files away
        os.chown(path, 12345, -1)
        assert compilations(double, 1) == (2, 1)
    compilations(double, 1.5)
    (real,) = set(kept(folder)) - {path}
    real.write_bytes(path.read_bytes())  # another version under its name
    assert compilations(double, 1.5) == (3.0, 1)

    def from_elsewhere(*_):
        raise AttributeError("no such name in this version")

    monkeypatch.setattr(cache.pickle, "loads", from_elsewhere)
    assert compilations(double, 1) == (2, 1)


def test_a_kernel_may_not_close_over_variables(folder):
    step = 2

    def plus(x):
        return x + step

    with pytest.raises(ValueError, match="step"):
        compiling.kernel(plus)


# Where kernels are found


def test_a_cache_that_can_only_be_read_is_read(folder, tmp_path, monkeypatch):
    base = tmp_path / "image"
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(base))
    ours, only_read = places.own_folders()
    assert ours.parent == base and only_read == []
    compilations(double, 1)
    kept(folder)[0].rename(ours / kept(folder)[0].name)
    monkeypatch.setattr(places.os, "access", lambda *_: False)
    assert places.own_folders() == (None, [ours])
    monkeypatch.setattr(places, "READ", (ours,))
    monkeypatch.setattr(places, "OWN", None)
    assert compilations(double, 1) == (2, 0)
    with pytest.warns(RuntimeWarning, match="NUMBA_CACHE_DIR"):
        assert compilations(double, 1.5) == (3.0, 1)
    base.chmod(0o770)
    assert places.own_folders() == (None, [])


@pytest.fixture
def wheel(tmp_path, monkeypatch):
    """An installed wheel of kernels, without any."""
    monkeypatch.setattr(places, "passed_over", False)
    folder = tmp_path / "nnpp_edge_kernels" / places.name_in_wheel("x86-64-v3")
    folder.mkdir(parents=True, mode=0o755)
    return folder


def test_a_wheel_of_kernels_that_does_not_fit_or_may_be_anothers_is_passed_over_in_one_line(
    wheel, monkeypatch
):
    def found():
        monkeypatch.setattr(places, "passed_over", False)
        with warnings.catch_warnings(record=True, action="always") as told:
            return places.in_wheel("x86-64-v3", wheel.parent), "".join(
                str(each.message) for each in told
            )

    assert places.in_wheel("x86-64-v3", wheel.parent / "none") == []
    assert found() == ([wheel], "")
    wheel.chmod(0o757)
    assert found()[0] == [] and "others" in found()[1]
    wheel.chmod(0o755)
    if os.geteuid() == 0:
        os.chown(wheel.parent, 12345, -1)
        assert found()[0] == [] and "others" in found()[1]
        os.chown(wheel.parent, 0, -1)
    other = wheel.rename(f"{wheel}-of-another-numba")
    assert (
        found()[0] == []
        and f"wanted {wheel.name}, got {other.name}" in found()[1]
        and "\n" not in found()[1]
    )


def test_a_damaged_kernel_of_a_wheel_is_told_of_and_compiled(folder, wheel, monkeypatch):
    compilations(double, 1)
    compilations(double, 1.5)
    for path in kept(folder):
        path.rename(wheel / path.name)
    monkeypatch.setattr(places, "WHEEL", [wheel])
    monkeypatch.setattr(places, "READ", (wheel,))
    assert compilations(double, 1) == (2, 0)
    for path in kept(wheel):
        path.write_bytes(path.read_bytes()[:-1])
    with pytest.warns(RuntimeWarning, match="damaged") as told:
        assert (compilations(double, 1), compilations(double, 1.5)) == ((2, 1), (3.0, 1))
    assert len(told) == 1 and len(kept(folder)) == 2
    assert compilations(double, 1) == (2, 0)


# What cannot be written


def fails_with(number):
    def fail(*_, **__):
        raise OSError(number, os.strerror(number))

    return fail


@pytest.mark.parametrize(
    ("step", "number"),
    [
        ("mkdir", errno.EROFS),
        ("touch", errno.EACCES),
        ("write_bytes", errno.ENOSPC),
        ("replace", errno.EIO),
    ],
)
def test_a_failure_to_save_is_warned_of_once_and_the_kernel_runs(folder, monkeypatch, step, number):
    with monkeypatch.context() as failing:
        failing.setattr(Path, step, fails_with(number))
        with pytest.warns(RuntimeWarning, match=os.strerror(number)) as warned:
            assert compilations(double, 1) == (2, 1)
            assert compilations(double, 1.5) == (3.0, 1)
        assert len(warned) == 1
        assert cache.save_error.errno == number
    assert not folder.exists() or list(folder.iterdir()) == []
    with warnings.catch_warnings(action="error"):
        compilations(double, 1)
    assert compilations(double, 1) == (2, 0)


def test_a_folder_is_ours_alone(folder):
    """One that vanished is made again; in one that others may write to nothing is kept."""
    fresh = compiling.kernel(double)
    assert not folder.parent.exists()
    fresh(1)
    assert folder.parent.stat().st_mode & 0o777 == folder.stat().st_mode & 0o777 == 0o700
    assert compilations(double, 1) == (2, 0) and cache.save_error is None
    folder.parent.chmod(0o777)
    with pytest.warns(RuntimeWarning, match="no other"):
        assert compilations(double, 2.0) == (4.0, 1)
    assert len(kept(folder)) == 1


def test_a_warm_up_that_cannot_keep_what_it_compiled_fails(made_folder, monkeypatch):
    monkeypatch.setattr(warmup, "exercise", lambda: compilations(double, 1))
    told = [warmup.warm_up(jobs=1) for _ in range(2)]
    assert [(warmth.kernels, warmth.signatures, warmth.compiled) for warmth in told] == [
        (1, 1, 1),
        (1, 1, 0),
    ]
    monkeypatch.setattr(warmup, "exercise", lambda: compilations(double, 1.5))
    monkeypatch.setattr(Path, "replace", fails_with(errno.ENOSPC))
    with warnings.catch_warnings(action="error"), pytest.raises(OutputError, match="No space left"):
        warmup.warm_up(jobs=1)
    with pytest.raises(ValueError, match="at least 1, got 0"):
        warmup.warm_up(jobs=0)


@pytest.mark.parametrize(
    "python", ["/bin/false", "/bin/true", None], ids=["fails", "does nothing", "has other kernels"]
)
def test_a_warm_up_needs_no_help(made_folder, monkeypatch, python):
    monkeypatch.setattr(warmup, "exercise", lambda: compilations(double, 1))
    monkeypatch.setattr(sys, "executable", python or sys.executable)
    assert warmup.warm_up(jobs=3).compiled == 1


def test_time_in_which_kernels_are_made_ready_is_a_stage_of_its_own(folder):
    """Compiled or read back, within a stage or before it."""
    for state in ("compiled", "read back"):
        watch = Work()
        compilations(double, 1)
        watch.stage_ends("coarse")
        watch.stage_ends("search")
        timings = watch.timings_ms
        assert list(timings) == ["kernels", "coarse", "search"], state
        assert timings["kernels"] > timings["coarse"] + timings["search"]
        assert sum(timings.values()) <= watch.total_ms()
    again = Work()
    again.stage_ends("coarse")
    assert list(again.timings_ms) == ["coarse"]


@pytest.fixture
def interrupted(folder, monkeypatch):
    """A kernel that is kept, of which Ctrl-C comes while its file is read, or before it is compiled."""
    compilations(double, 2)

    def interrupt(method):
        plain = getattr(cache.KernelCache, method)

        def struck(self, *given):
            signal.raise_signal(signal.SIGINT)
            return plain(self, *given)

        monkeypatch.setattr(cache.KernelCache, method, struck)
        return compiling.kernel(double)

    return interrupt


def test_an_interrupt_waits_until_a_kernel_is_loaded(interrupted, monkeypatch):
    fresh = interrupted("_load")
    with pytest.raises(KeyboardInterrupt):
        fresh(2)
    assert len(fresh.overloads) == 1 and sum(fresh.stats.cache_misses.values()) == 0
    monkeypatch.undo()
    assert fresh(2) == 4
    with pytest.raises(KeyboardInterrupt):  # later ones come at once
        signal.raise_signal(signal.SIGINT)


def test_an_interrupt_does_not_wait_until_a_kernel_is_compiled(interrupted, monkeypatch):
    fresh = interrupted("_find")
    with pytest.raises(KeyboardInterrupt):
        fresh(2.5)
    assert not fresh.overloads
    monkeypatch.undo()
    assert fresh(2.5) == 5.0
