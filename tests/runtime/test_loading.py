"""Model files are opened once in a process, in the background where that is wanted."""

import os
import shutil
import threading
import time
import weakref
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from nnpp_edge.runtime import Ground, Navigator, NetworkModel, Planner
from nnpp_edge.runtime.errors import ModelError
from nnpp_edge.runtime.loop import navigator
from nnpp_edge.runtime.network import loading
from nnpp_edge.runtime.network.loading import KEPT, begin_loading
from tests.strategies import uniform

COST = uniform(5, (120, 130), 0.0, 0.5)
ENDS = (3, 4), (110, 120)


class Sessions:
    """Counts sessions that are opened, and may make each take longer."""

    def __init__(self):
        self.paths = []
        self.seconds = 0.0
        self._open_session = loading.open_session

    def __call__(self, path, options=None):
        self.paths.append(path)
        time.sleep(self.seconds)
        return self._open_session(path, options)


@pytest.fixture
def sessions(monkeypatch):
    found = Sessions()
    monkeypatch.setattr(loading, "open_session", found)
    return found


@pytest.fixture
def fresh_model(tiny_model, tmp_path):
    """A file that no test has opened."""
    return shutil.copy(tiny_model, tmp_path / "fresh.onnx")


def loaders():
    return [thread for thread in threading.enumerate() if thread.name == "load a model"]


def test_threads_that_ask_at_once_wait_for_one_session(fresh_model, sessions):
    sessions.seconds = 0.1
    together = threading.Barrier(6)

    def ask(_):
        together.wait()
        return NetworkModel(fresh_model)

    with ThreadPoolExecutor(6) as threads:
        found = list(threads.map(ask, range(6)))
    assert len(sessions.paths) == 1
    assert len({id(network.session) for network in found}) == 1
    assert all(network.waited for network in found)


def test_sessions_that_nobody_uses_do_not_pile_up(tiny_model, tmp_path):
    found = []
    for number in range(KEPT + 4):
        network = NetworkModel(shutil.copy(tiny_model, tmp_path / f"{number}.onnx"))
        found.append(weakref.ref(network.session))
    del network
    alive = [number for number, session in enumerate(found) if session() is not None]
    assert alive == [KEPT + 2, KEPT + 3]


def test_a_file_that_was_written_anew_is_opened_anew_though_its_time_was_set_back(
    fresh_model, sessions
):
    NetworkModel(fresh_model)
    before = fresh_model.stat()
    fresh_model.write_bytes(fresh_model.read_bytes())
    os.utime(fresh_model, ns=(before.st_atime_ns, before.st_mtime_ns))
    NetworkModel(fresh_model)
    assert len(sessions.paths) == 2


def test_an_error_in_the_background_is_raised_to_each_who_asks_and_printed_to_none(
    fresh_model, capfd
):
    content = fresh_model.read_bytes()
    fresh_model.write_bytes(content[:-40])
    begin_loading(fresh_model)
    begin_loading(fresh_model.with_name("none.onnx"))
    for thread in loaders():
        thread.join()
    planners = [Planner(COST, model=fresh_model) for _ in range(2)]
    for planner in (*planners, *planners):
        with pytest.raises(ModelError, match=r"fresh.onnx: wanted an ONNX model"):
            planner.plan(*ENDS, method="nnpp")
    fresh_model.write_bytes(content)
    assert planners[0].plan(*ENDS, method="nnpp").ok
    assert capfd.readouterr() == ("", "")


def test_only_what_will_be_asked_begins_to_load_ahead(fresh_model, monkeypatch):
    begun = []
    monkeypatch.setattr(navigator, "begin_loading", begun.append)
    for method in ("auto", "dstar", "corridor-dstar", "nnpp", "nnpp-dstar"):
        begun.clear()
        Navigator(Ground(COST), method=method, model=fresh_model)
        assert begun == [fresh_model] * method.startswith("nnpp")


def test_no_telemetry_waits_to_be_sent(fresh_model):
    NetworkModel(fresh_model)
    assert "onnxruntime.db" not in Path("/proc/self/maps").read_text()


def test_planners_that_name_the_same_file_share_a_session_and_keep_maps_of_their_own(
    fresh_model, sessions
):
    planners = [
        Planner(COST, model=model) for model in (fresh_model, str(fresh_model), fresh_model)
    ]
    plans = [planner.plan(*ENDS, method="nnpp") for planner in planners]
    plans.append(Planner(COST, model=fresh_model).plan(*ENDS, method="nnpp"))
    pair = NetworkModel(fresh_model), NetworkModel(fresh_model)
    begin_loading(pair[0])
    begin_loading(fresh_model)
    assert not loaders() and sessions.paths == [fresh_model]
    assert all(np.array_equal(plan.path, plans[0].path) for plan in plans)
    NetworkModel(fresh_model, threads=2)
    assert len(sessions.paths) == 2
    ends = ((5.0, 6.0), (50.0, 40.0))
    for one, other in (pair, (NetworkModel("edge"), NetworkModel("edge"))):
        for seed, network in enumerate((one, other)):
            network.set_map(uniform(seed, (2, 64, 64)))
        first = one.answer(*ends).copy()
        assert not np.array_equal(first, other.answer(*ends))
        assert np.array_equal(first, one.answer(*ends))
        assert NetworkModel(one.path).session is one.session is other.session


@pytest.mark.parametrize("way", ["in place, its time set back", "another in its place"])
def test_a_file_that_has_changed_is_opened_anew(fresh_model, sessions, way):
    planner = Planner(COST, model=fresh_model)
    before = NetworkModel(fresh_model)
    assert planner.plan(*ENDS, method="nnpp").ok and len(sessions.paths) == 1
    whole = fresh_model.read_bytes()
    fresh_model.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ModelError):
        Planner(COST, model=fresh_model).plan(*ENDS, method="nnpp")
    assert planner.plan(*ENDS, method="nnpp").ok  # by the old one
    fresh_model.write_bytes(whole)
    content = fresh_model.read_bytes().replace(b'"version": "0"', b'"version": "1"')
    found = fresh_model.stat()
    if way.startswith("in place"):
        fresh_model.write_bytes(content)
        os.utime(fresh_model, ns=(found.st_atime_ns, found.st_mtime_ns))
    else:
        fresh_model.with_suffix(".new").write_bytes(content)
        fresh_model.with_suffix(".new").replace(fresh_model)
    after = NetworkModel(fresh_model)
    assert (before.metadata.version, after.metadata.version) == ("0", "1")
    newer = Planner(COST, model=fresh_model)
    assert newer.plan(*ENDS, method="nnpp").ok and len(sessions.paths) == 2


def test_a_file_that_changes_while_it_is_loaded_is_refused(fresh_model, sessions, monkeypatch):
    def open_and_write(path, options):
        session = sessions(path, options)
        os.utime(path, ns=(1, 1))
        return session

    with monkeypatch.context() as patch:
        patch.setattr(loading, "open_session", open_and_write)
        with pytest.raises(ModelError, match="changed while it was loaded"):
            NetworkModel(fresh_model)
    assert NetworkModel(fresh_model).metadata.name == "tiny"


def test_who_asks_waits_only_for_what_is_left_of_loading_and_that_is_a_stage_of_its_own(
    fresh_model, tmp_path, sessions
):
    other = shutil.copy(fresh_model, tmp_path / "other.onnx")
    kept = NetworkModel(fresh_model)
    planner = Planner(COST, model=other)
    sessions.seconds = 0.4
    begin_loading(other)
    while len(sessions.paths) < 2:
        time.sleep(0.001)
    time.sleep(0.15)
    assert NetworkModel(fresh_model).session is kept.session
    assert loaders(), "who asks for an open file does not wait for another"
    slow, ready = (planner.plan(*ENDS, method="nnpp").timings_ms for _ in range(2))
    assert 0.0 < slow["load"] < 400.0 and "load" not in ready and len(sessions.paths) == 2
    for times in (slow, ready):
        stages = [ms for stage, ms in times.items() if stage != "total"]
        assert sum(stages) == pytest.approx(times["total"], rel=0.05)
