"""Elevation maps in NumPy files and 16-bit PNGs: arrays of heights that need no rasterio."""

import math
import struct
import warnings
import zipfile
import zlib
from pathlib import Path
from typing import IO

import numpy as np
import numpy.typing as npt
from numpy.lib import format as npy

from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.errors import TerrainError
from nnpp_edge.runtime.reading import problem_with_file, refused_as
from nnpp_edge.terrain.georeference import Georeference
from nnpp_edge.terrain.heights import Reading, Window, check_grid, check_room, checked_window, metres

_ZIP_STARTS = (b"PK\x03\x04", b"PK\x05\x06")
_ARRAY_NAMES = ("elevation_m", "elevation", "dem")
_HEADERS = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}
_PNG_START = b"\x89PNG\r\n\x1a\n"
_PNG_HEAD = struct.Struct(">8s4s4sIIBB")
"""Start, length and kind of the first chunk; columns, rows, bits of a level, kind of colour."""
_CHANNELS = {0: 1, 2: 3, 3: 3, 4: 2, 6: 4}
_LAST_FILTER = 4
_NO_PNG = "wanted a grey 16-bit PNG, got a file that is not a whole PNG"


def read_arrays(path: Path, vertical_scale: float | None, window: Window | None) -> Reading:
    """Elevation and cell (size, width) of a NumPy file; its first bytes show whether it is an archive.

    Raises TerrainError and InvalidQueryError as `read_dem` does, and whatever else NumPy raises for a broken file.
    """
    cell = place = None
    with path.open("rb") as file:
        if file.read(4) in _ZIP_STARTS:
            with _Archive(path) as archive:
                cell = archive.cell()
                name = archive.elevation_name()
                promised = archive.promise(name)
                row0, col0, rows, cols = checked_window(path, promised.shape, window)
                check_room(path, (rows, cols), promised.dtype, promised.nbytes)
                loaded, place = archive.array(name), archive.place(row0, col0)
        else:
            file.seek(0)
            promised = _promised(file)
            check_grid(path, promised)
            row0, col0, rows, cols = checked_window(path, promised.shape, window)
            check_room(path, (rows, cols), promised.dtype)
            loaded = np.load(path, mmap_mode="r", allow_pickle=False)
    part = loaded[row0 : row0 + rows, col0 : col0 + cols]
    return metres(part, vertical_scale or 1.0, 0.0), cell, place


def read_cost_map(path: Path) -> tuple[Float2D, float] | None:
    """Costs and cell size of an archive that `nnpp-edge costmap` has written; None for a file of another kind.

    Returns
    -------
    ((H, W) float32, float) or None
        The cell size in metres, above 0 and finite; 1 where the archive has none.

    Raises
    ------
    TerrainError
        The archive is damaged, holds no map of costs, or one that is larger than the memory that is free.
    """
    if path.suffix.lower() != ".npz" or problem_with_file(path) is not None:
        return None
    with refused_as(TerrainError, f"{path}: wanted a map, got a file that cannot be read"), _Archive(path) as archive:
        if "cost" not in archive:
            return None
        promised, cell = archive.promise("cost"), archive.cell()
        if promised.ndim != 2 or promised.size == 0 or promised.dtype.kind not in "biuf":
            raise TerrainError(f"{path}: wanted an (H, W) array of costs, got {promised.shape} {promised.dtype}")
        check_room(path, promised.shape, promised.dtype)
        return metres(archive.array("cost"), 1.0, 0.0), cell[0] if cell else 1.0


class _Archive:
    """An `.npz` whose arrays' headers are read before the arrays."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def __enter__(self) -> "_Archive":
        self._zip = zipfile.ZipFile(self._path)
        self._names = {name.removesuffix(".npy"): name for name in self._zip.namelist()}
        return self

    def __exit__(self, *_: object) -> None:
        self._zip.close()

    def __contains__(self, name: str) -> bool:
        return name in self._names

    def promise(self, name: str) -> npt.NDArray[np.generic]:
        """As `_promised`."""
        with self._zip.open(self._names[name]) as member:
            return _promised(member)

    def array(self, name: str) -> npt.NDArray[np.generic]:
        """The array itself."""
        with self._zip.open(self._names[name]) as member:
            found: npt.NDArray[np.generic] = npy.read_array(member, allow_pickle=False)
        return found

    def elevation_name(self) -> str:
        """That of the array of heights: one of ours, or the only one of two dimensions; TerrainError for others."""
        name = next((name for name in _ARRAY_NAMES if name in self), None)
        if name is None and "cost" in self:
            raise TerrainError(
                f"{self._path}: wanted heights, got costs: `nnpp-edge run` takes them, no other command"
            )
        if name is None:
            grids = [name for name in self._names if self.promise(name).ndim == 2]
            if len(grids) != 1:
                wanted, got = ", ".join(_ARRAY_NAMES), ", ".join(self._names) or "nothing"
                raise TerrainError(f"{self._path}: wanted {wanted} or a single 2-D array, got {got}")
            name = grids[0]
        check_grid(self._path, self.promise(name))
        return name

    def cell(self) -> tuple[float, float] | None:
        """Size and width of a cell; None where the archive does not say."""
        size, width = self._number("cell_size_m", "cell_m"), self._number("cell_width_m")
        if size is None:
            if width is not None:
                raise TerrainError(f"{self._path}: wanted cell_size_m beside cell_width_m, got cell_width_m alone")
            return None
        return size, size if width is None else width

    def place(self, row: int, col: int) -> Georeference | None:
        """Where the part from this cell on lies, by the array `transform`; None where there is none."""
        if "transform" not in self:
            return None
        promised = self.promise("transform")
        values = self.array("transform").tolist() if promised.shape == (6,) and promised.dtype.kind in "iuf" else []
        a, b, c, d, e, f = values or [math.nan] * 6
        if not all(map(math.isfinite, (a, b, c, d, e, f))) or a * e == b * d:
            wanted, got = "6 numbers (a, b, c, d, e, f) that place cells", values or promised.shape
            raise TerrainError(f"{self._path}: transform must be {wanted}, got {got}")
        return Georeference(None, (a, b, a * col + b * row + c, d, e, d * col + e * row + f))

    def _number(self, *names: str) -> float | None:
        """The scalar under the first of `names` that is there, above 0 and finite; None without one."""
        for name in (name for name in names if name in self):
            promised = self.promise(name)
            if promised.size != 1 or promised.dtype.kind not in "iuf":
                got = f"{promised.dtype} {promised.shape}"
            elif 0 < (value := float(self.array(name).item())) < math.inf:
                return value
            else:
                got = f"{value:g}"
            raise TerrainError(f"{self._path}: {name} must be one number above 0, got {got}")
        return None


def _promised(file: IO[bytes]) -> npt.NDArray[np.generic]:
    """An array that takes no memory, of the shape and type that the header of a `.npy` promises."""
    version = npy.read_magic(file)
    if version not in _HEADERS:
        raise ValueError(f"wanted version 1 or 2 of NumPy's format, got {version}")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a damaged header is parsed as Python, which warns of odd spellings
        shape, _, dtype = _HEADERS[version](file)
    return np.broadcast_to(np.empty((), dtype), shape)


def read_png(path: Path, vertical_scale: float | None, window: Window | None) -> Reading:
    """Elevation of a grey 16-bit PNG; TerrainError and InvalidQueryError as in `read_dem`."""
    import cv2

    with path.open("rb") as file:
        start = file.read(_PNG_HEAD.size)
    if len(start) < _PNG_HEAD.size or not start.startswith(_PNG_START):
        raise TerrainError(f"{path}: {_NO_PNG}")
    *_, cols, rows, bits, colour = _PNG_HEAD.unpack(start)
    if (bits, colour) != (16, 0):
        channels = _CHANNELS.get(colour, 0)
        plural = "" if channels == 1 else "s"
        raise TerrainError(f"{path}: wanted a grey 16-bit PNG, got {channels} channel{plural} of {bits} bits")
    if vertical_scale is None:
        raise TerrainError(f"{path}: no unit of height in a PNG; give metres per level with --vertical-scale")
    row0, col0, height, width = checked_window(path, (rows, cols), window)
    check_room(path, (rows, cols), np.dtype(np.uint16), 2 * path.stat().st_size)
    with refused_as(TerrainError, f"{path}: {_NO_PNG}"):
        content = _checked_png(path.read_bytes(), rows, cols)
    levels = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    if levels is None or levels.shape != (rows, cols):
        raise TerrainError(f"{path}: {_NO_PNG}")
    return metres(levels[row0 : row0 + height, col0 : col0 + width], vertical_scale, 0.0), None, None


def _checked_png(content: bytes, rows: int, cols: int) -> bytes:
    """The chunks that a grey 16-bit picture needs; ValueError or zlib.error unless all of it is whole.

    Given a damaged file libpng prints on stderr, and hands out the rows that it has of one cut short.
    """
    kept, data, kind, at = [_PNG_START], [], b"", len(_PNG_START)
    while kind != b"IEND":
        end = at + 12 + int.from_bytes(content[at : at + 4])
        kind, checksum = content[at + 4 : at + 8], int.from_bytes(content[end - 4 : end])
        if end > len(content) or zlib.crc32(content[at + 4 : end - 4]) != checksum:
            raise ValueError(f"damaged at byte {at}")
        if kind in (b"IHDR", b"IDAT", b"IEND"):
            kept.append(content[at:end])
        if kind == b"IDAT":
            data.append(content[at + 8 : end - 4])
        at = end
    line, unpacker = 2 * cols + 1, zlib.decompressobj()
    interlaced = kept[1][20]
    lines = unpacker.decompress(b"".join(data), rows * line + 1)
    if not interlaced and (len(lines) != rows * line or not unpacker.eof or max(lines[::line]) > _LAST_FILTER):
        raise ValueError(f"not {rows} lines of {cols} levels")
    return b"".join(kept)
