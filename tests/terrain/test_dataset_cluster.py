"""A data set made by a real Dask cluster of two worker processes, some of which are killed."""

import gc
import os
import signal
import sys
from functools import partial

import dask
import distributed
import numpy as np
import pytest
from distributed import LocalCluster

from nnpp_edge.terrain import cluster
from nnpp_edge.terrain.cluster import ClusterError, shards_on_cluster
from nnpp_edge.terrain.dataset import make_dataset
from nnpp_edge.terrain.shards import Recipe
from nnpp_edge.terrain.synthetic import synthetic_terrain
from tests.tables import cases

RECIPE = Recipe(
    ("dem.npz",),
    maps=18,
    size=32,
    blocks=8,
    maps_per_shard=2,
    poolings=((1, 0.7), (2, 0.3)),
)


@pytest.fixture(scope="module")
def workers():
    """Two worker processes, each with a nanny that replaces it when it dies."""
    quiet = {"dashboard_address": ":0", "silence_logs": "CRITICAL"}
    with LocalCluster(n_workers=2, threads_per_worker=1, processes=True, **quiet) as started:
        yield started


@pytest.fixture
def terrain(tmp_path, monkeypatch):
    """A folder with an elevation map: where the command runs, and where no worker does."""
    elevation = synthetic_terrain(np.random.default_rng(1), 130, 2.0)
    np.savez(tmp_path / "dem.npz", elevation_m=elevation, cell_size_m=2.0)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def content(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def kill(nannies):
    for nanny in nannies:
        os.kill(nanny.pid, signal.SIGKILL)


@pytest.mark.slow
def test_killed_workers_change_no_byte_and_a_second_run_makes_what_is_missing(workers, terrain):
    make = partial(shards_on_cluster, workers.scheduler_address)
    seen = []

    def progress(done):
        seen.append(done)
        nannies = list(workers.workers.values())
        if done == 2:
            kill(nannies[:1])
        if done == 5:  # the terrain is then in no worker's memory any more
            kill([nanny for nanny in nannies if nanny.pid])

    make_dataset(RECIPE, terrain / "here", workers=1)
    counts = make_dataset(RECIPE, terrain / "cluster", make=make, progress=progress)
    assert (counts["shards"], counts["maps"]) == (9, 18)
    assert seen == list(range(10))
    wanted = content(terrain / "here")
    assert len(wanted) == 10
    assert content(terrain / "cluster") == wanted
    for number in (3, 6):
        (terrain / "cluster" / f"shard-{number:05d}.npz").unlink()
    make_dataset(RECIPE, terrain / "cluster", make=make, progress=seen.append)
    assert seen[10:] == [7, 8, 9]
    assert content(terrain / "cluster") == wanted


def test_the_command_makes_a_data_set_on_a_cluster_or_says_in_one_line_what_is_wrong(
    nnpp_edge,
    workers,
    terrain,
):
    words = ["dataset", "dem.npz", "--synthetic-share", "0", "--maps", "2", "--scheduler"]
    words.append(workers.scheduler_address)
    ended = nnpp_edge(*words, "--size", 32, "-o", "set", "--json")
    assert ended.code == 0, ended.err
    assert '"shards": 1' in ended.out
    assert "shards: 100 %" in ended.err
    ended = nnpp_edge(*words, "--size", 256, "-o", "larger")
    ended.refused("dem.npz: wanted at least", "on the shorter side")
    assert ended.err.count("\n") == 1


def at_scheduler(nnpp_edge, folder, address, *more):
    words = ("dataset", "-o", folder / "set", "--maps", 2, "--scheduler", address)
    with dask.config.set({"distributed.comm.timeouts.connect": "300ms"}):
        return nnpp_edge(*words, *more)


ADDRESSES = """
tcp://127.0.0.1:1 | 'tcp://127.0.0.1:1'
nowhere           | missing port
http://a:1        | unknown address scheme
"""


@pytest.mark.parametrize(("address", "word"), cases(ADDRESSES))
def test_an_address_without_a_scheduler_is_refused_in_one_line(nnpp_edge, tmp_path, address, word):
    ended = at_scheduler(nnpp_edge, tmp_path, address)
    ended.refused("wanted a Dask scheduler", word)
    assert ended.err.count("\n") == 1
    # collected as garbage while another is made, clients would wait for each other for ever
    clients = [one for one in gc.get_objects() if type(one) is distributed.Client]
    assert {client.status for client in clients} <= {"closed"}


def test_workers_and_a_missing_package_are_refused(nnpp_edge, tmp_path, monkeypatch):
    address = "tcp://127.0.0.1:1"
    at_scheduler(nnpp_edge, tmp_path, address, "--workers", 2).refused("--workers")
    monkeypatch.setitem(sys.modules, "distributed", None)
    at_scheduler(nnpp_edge, tmp_path, address).refused("distributed: pip install")


def test_a_cluster_without_workers_and_a_worker_of_another_version_are_refused(monkeypatch):
    monkeypatch.setattr(cluster, "WORKER_WAIT_S", 0.2)
    with (
        LocalCluster(n_workers=0, dashboard_address=":0", silence_logs="CRITICAL") as empty,
        pytest.raises(ClusterError, match="got none within"),
    ):
        list(shards_on_cluster(empty.scheduler_address, Recipe(()), [], [0]))
    with pytest.raises(ClusterError, match=r"wanted workers with nnpp-edge 0\.0\.0"):
        cluster._make("0.0.0", RECIPE, [], 0)
