"""A folder with grounds that several tests of commands share, and commands as they are
typed there.
"""

import shlex

import numpy as np
import pytest

from nnpp_edge.terrain.shards import shard_content
from nnpp_edge.terrain.synthetic import synthetic_terrain
from tests.cli.grounds import LAID, rolling
from tests.terrain.test_dem import geotiff


@pytest.fixture
def run(nnpp_edge, tmp_path, monkeypatch):
    """Run a command line in a folder of its own."""
    monkeypatch.chdir(tmp_path)
    return lambda line, *more: nnpp_edge(*shlex.split(line), *more)


@pytest.fixture
def trained_on(run, monkeypatch):
    """Writes dem.npz, a map of so many rows × 160 cells, and returns its heights; shards are made
    without the processes that the command starts.
    """

    def make(recipe, tiles, indices, _):
        for index in indices:
            yield index, shard_content(recipe, tiles, index)

    def written(rows):
        elevation = synthetic_terrain(np.random.default_rng(5), 160, 5.0)[:rows]
        np.savez("dem.npz", elevation_m=elevation, cell_size_m=5.0)
        return elevation

    monkeypatch.setattr("nnpp_edge.terrain.dataset._shards_here", make)
    return written


@pytest.fixture
def told(run):
    """JSON of a command's answer; `code` is its exit code."""

    def told(line, *more, code=0):
        ended = run(line, *more, "--json")
        assert ended.code == code, ended.err
        return ended.json

    return told


@pytest.fixture
def hills(run):
    """Heights of rolling ground with an unknown column, in hills.tif and hills.npz; cells
    of 2 m.
    """
    heights = rolling()
    heights[:, 86] = np.nan
    geotiff("hills.tif", heights, **LAID)
    np.savez("hills.npz", elevation_m=heights, cell_size_m=2.0)
    return heights
