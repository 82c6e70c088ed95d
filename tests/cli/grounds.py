"""Grounds that several tests of commands share."""

import json
from pathlib import Path

import numpy as np
from pyproj import CRS
from rasterio import Affine

from nnpp_edge.terrain.georeference import Georeference

GRID = "EPSG:3414"  # whose metres are those of the ground, here
PLACE = Georeference(CRS(GRID).to_wkt(), (2.0, 0.0, 28_000.0, 0.0, -2.0, 39_000.0))
LAID = {"crs": GRID, "transform": Affine(*PLACE.transform)}
ENDS = "--start 5,5 --goal 70,80"
BODY = "--vehicle large-rover --set max_tilt_deg=40 --set clearance_m=1.5"


def rolling(rows=80, cols=90):
    """Heights of rolling ground."""
    row, col = np.mgrid[0:rows, 0:cols]
    return (1.5 * np.sin(row / 7.0) * np.cos(col / 9.0)).astype(np.float32)


def with_a_hill():
    """Heights of rough ground with a steep hill, for cells of 0.25 m."""
    heights = (0.02 * np.random.default_rng(0).random((60, 60))).astype(np.float32)
    heights[18:30, 20:30] += np.arange(12, dtype=np.float32)[:, None] * np.float32(0.4)
    return heights


def written(path):
    """What a JSON file holds."""
    return json.loads(Path(path).read_text())
