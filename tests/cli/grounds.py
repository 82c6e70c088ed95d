"""Grounds that several tests of commands share."""

import json
from pathlib import Path

import numpy as np
from pyproj import CRS

from nnpp_edge.terrain.georeference import Georeference

GRID = "EPSG:3414"  # whose metres are those of the ground, here
PLACE = Georeference(CRS(GRID).to_wkt(), (2.0, 0.0, 28_000.0, 0.0, -2.0, 39_000.0))
ENDS = "--start 5,5 --goal 70,80"
BODY = "--vehicle large-rover --set max_tilt_deg=40 --set clearance_m=1.5"


def rolling(rows=80, cols=90):
    """Heights of rolling ground."""
    row, col = np.mgrid[0:rows, 0:cols]
    return (1.5 * np.sin(row / 7.0) * np.cos(col / 9.0)).astype(np.float32)


def written(path):
    """What a JSON file holds."""
    return json.loads(Path(path).read_text())
