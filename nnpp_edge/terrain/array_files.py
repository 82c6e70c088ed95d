"""Elevation maps in NumPy files and 16-bit PNGs: arrays of heights that need no rasterio."""

import math
from pathlib import Path

import numpy as np
import numpy.typing as npt
from numpy.lib.npyio import NpzFile

from nnpp_edge.runtime.errors import TerrainError
from nnpp_edge.terrain.heights import Reading, Window, check_grid, checked_window, metres

_ZIP_STARTS = (b"PK\x03\x04", b"PK\x05\x06")
_ARRAY_NAMES = ("elevation_m", "elevation", "dem")


def read_arrays(path: Path, vertical_scale: float | None, window: Window | None) -> Reading:
    """Elevation and cell (size, width) of a NumPy file; its first bytes show whether it is an archive.

    Raises TerrainError and InvalidQueryError as `read_dem` does, and whatever else NumPy raises for a broken file.
    """
    cell = None
    with path.open("rb") as file:
        is_archive = file.read(4) in _ZIP_STARTS
    if not is_archive:
        loaded = np.load(path, mmap_mode="r", allow_pickle=False)
    else:  # NumPy leaves a path's file open where the archive is broken
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            size = _number(path, archive, "cell_size_m", "cell_m")
            width = _number(path, archive, "cell_width_m")
            loaded = _elevation_array(path, archive)
        if size is not None:
            cell = (size, size if width is None else width)
        elif width is not None:
            raise TerrainError(f"{path}: wanted cell_size_m beside cell_width_m, got cell_width_m alone")
    check_grid(path, loaded)
    row0, col0, rows, cols = checked_window(path, loaded.shape, window)
    part = loaded[row0 : row0 + rows, col0 : col0 + cols]
    return metres(part, vertical_scale or 1.0, 0.0), cell, None


def _elevation_array(path: Path, archive: NpzFile) -> npt.NDArray[np.generic]:
    """The archive's array of heights: by its name, or the only one of two dimensions."""
    for name in _ARRAY_NAMES:
        if name in archive.files:
            found: npt.NDArray[np.generic] = archive[name]
            return found
    grids = {name: array for name in archive.files if (array := archive[name]).ndim == 2}
    if len(grids) != 1:
        wanted, got = ", ".join(_ARRAY_NAMES), ", ".join(archive.files) or "nothing"
        raise TerrainError(f"{path}: wanted {wanted} or a single 2-D array, got {got}")
    _, found = grids.popitem()
    return found


def _number(path: Path, archive: NpzFile, *names: str) -> float | None:
    """The archive's scalar under the first of `names` it has, above 0; None without one."""
    for name in (name for name in names if name in archive.files):
        value = archive[name]
        if value.size != 1 or value.dtype.kind not in "iuf" or not 0 < value.item() < math.inf:
            raise TerrainError(f"{path}: {name} must be one number above 0, got {value.dtype} {value.shape}")
        return float(value.item())
    return None


def read_png(path: Path, vertical_scale: float | None, window: Window | None) -> Reading:
    """Elevation of a grey 16-bit PNG; TerrainError and InvalidQueryError as in `read_dem`."""
    import cv2

    content = path.read_bytes()
    # Some decoders hand out the rows they have of a file cut short, so look for its end.
    whole = b"IEND" in content
    levels = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED) if whole else None
    if levels is None:
        raise TerrainError(f"{path}: wanted a grey 16-bit PNG, got a file that is not a whole PNG")
    if levels.dtype != np.uint16 or levels.ndim != 2:
        channels = 1 if levels.ndim == 2 else levels.shape[2]
        got = f"{channels} channel{'s' if channels > 1 else ''} of {8 * levels.dtype.itemsize} bits"
        raise TerrainError(f"{path}: wanted a grey 16-bit PNG, got {got}")
    if vertical_scale is None:
        raise TerrainError(f"{path}: no unit of height in a PNG; give metres per level with --vertical-scale")
    row0, col0, rows, cols = checked_window(path, levels.shape, window)
    return metres(levels[row0 : row0 + rows, col0 : col0 + cols], vertical_scale, 0.0), None, None
