"""Ground to measure on."""

import numpy as np
import pytest

from nnpp_edge.terrain.synthetic import synthetic_terrain


@pytest.fixture(scope="session")
def ground_file(tmp_path_factory):
    """Write synthetic ground of so many cells a side, which are so many metres wide."""

    def write(cells, cell_m):
        path = tmp_path_factory.mktemp("terrain") / "dem.npz"
        heights = synthetic_terrain(np.random.default_rng(4), cells, cell_m)
        np.savez(path, elevation_m=heights, cell_size_m=cell_m)
        return path

    return write
