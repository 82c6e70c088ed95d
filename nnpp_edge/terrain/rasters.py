"""Elevation maps in GDAL's rasters: GeoTIFF, PDS3 (`.img`, `.lbl`), ESRI ASCII grid and others, by rasterio."""

import json
import math
import re
import sys
import warnings
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, cast

import numpy as np
import numpy.typing as npt

from nnpp_edge.runtime.errors import OutputError, TerrainError, optional_module
from nnpp_edge.terrain.gdal_files import FORMATS, NO_NETWORK, openable
from nnpp_edge.terrain.georeference import Georeference
from nnpp_edge.terrain.heights import Reading, Window, check_room, checked_window, metres
from nnpp_edge.terrain.tiff_blocks import DeflateBlocks

if TYPE_CHECKING:
    from rasterio.io import DatasetReader

_METRES_PER_UNIT = dict.fromkeys(("ft", "foot", "feet"), 0.3048)
_METRES_PER_UNIT |= dict.fromkeys(("us survey foot", "us_survey_foot", "us-ft", "ftus"), 1200 / 3937)
_METRES_PER_UNIT |= dict.fromkeys(("km", "kilometer", "kilometre", "kilometers", "kilometres"), 1000.0)
_ASCII_HEADER = re.compile(r"\A(?:\s*(?!nan|inf)[a-z]\w+[ \t]+\S+[ \t]*$)+", re.IGNORECASE | re.MULTILINE)
_HIGHEST_OFFSET_M = 1e5
_TILE = 512
"""Cells to the side of a tile of a raster that is written as a stream."""
_LEAST_CACHE_BYTES = 1 << 26
"""Of blocks that GDAL keeps for a raster read by windows; by itself it would keep a twentieth of the memory."""


class Raster:
    """The heights in an open file of one of `FORMATS`; `opened_raster` makes one."""

    def __init__(self, path: Path, dataset: "DatasetReader", vertical_scale: float | None) -> None:
        self._path, self._dataset = path, dataset
        self.shape: tuple[int, int] = dataset.shape
        """Rows and columns."""
        self.block: tuple[int, int] = dataset.block_shapes[0]
        """Rows and columns of a block, which is read as one."""
        self.dtype, self.driver = np.dtype(dataset.dtypes[0]), dataset.driver
        self._blocks = DeflateBlocks(path, dataset)
        unit = vertical_scale or _metres_per_unit(dataset)
        offset = dataset.offsets[0] * unit
        self._offset = 0.0 if abs(offset) > _HIGHEST_OFFSET_M else offset
        self._scale = dataset.scales[0] * unit

    def check_whole(self) -> None:
        """TerrainError for a file cut short where GDAL would fill in zeros and say nothing."""
        _check_whole(self._path, self._dataset)

    def heights(self, part: Window) -> npt.NDArray[np.float32]:
        """Metres in a window (row0, col0, rows, cols), NaN where unknown; TerrainError where a block is damaged."""
        row0, col0, rows, cols = part
        window = ((row0, row0 + rows), (col0, col0 + cols))
        self._blocks.check(part)
        heights = metres(self._dataset.read(1, window=window), self._scale, self._offset)
        heights[self._dataset.read_masks(1, window=window) == 0] = np.nan
        return heights

    def place(self, part: Window) -> Georeference | None:
        """The georeference of a window; None where the file has no transform."""
        if self._dataset.transform.is_identity:  # how rasterio says that
            return None
        row0, col0, *_ = part
        a, b, c, d, e, f = self._dataset.transform[:6]
        crs = self._dataset.crs.to_wkt() if self._dataset.crs else None
        return Georeference(crs, (a, b, a * col0 + b * row0 + c, d, e, d * col0 + e * row0 + f))


@contextmanager
def opened_raster(
    path: Path, vertical_scale: float | None, allow_vrt: bool = False, *, by_windows: bool = False
) -> Iterator[Raster]:
    """An open raster of one band of heights, all in files of its own folder.

    One to be read by windows keeps a row of blocks, decoded by several threads, and forgets what it has read before.
    Raises as `read_raster`.
    """
    rasterio = optional_module("rasterio", f"reading {path.name}", "geo")
    # An ASCII grid without a decimal point would be read as whole numbers, and its nan as 0.
    options = {"DATATYPE": "Float64"} if path.suffix.lower() == ".asc" else {}
    opened, drivers = openable(path, allow_vrt)
    if by_windows and len(drivers) > 1:
        options["NUM_THREADS"] = "ALL_CPUS"
    with _quiet(rasterio), _opened(rasterio, path, opened, driver=drivers, **options) as dataset:
        if any(Path(name).parent != opened.parent for name in dataset.files):
            raise TerrainError(f"{path}: wanted a raster whose files lie in its own folder, got {dataset.files}")
        if dataset.count != 1:
            raise TerrainError(f"{path}: wanted one band of elevation, got {dataset.count} bands")
        if dataset.dtypes[0].startswith("complex"):
            raise TerrainError(f"{path}: wanted a band of real numbers, got {dataset.dtypes[0]}")
        raster = Raster(path, dataset, vertical_scale)
        if not by_windows:
            yield raster
            return
        raster.check_whole()
        row_of_blocks = raster.block[0] * (raster.shape[1] + raster.block[1]) * raster.dtype.itemsize
        with rasterio.Env(GDAL_CACHEMAX=max(_LEAST_CACHE_BYTES, 5 * row_of_blocks // 2)):
            yield raster


def read_raster(path: Path, vertical_scale: float | None, window: Window | None, allow_vrt: bool = False) -> Reading:
    """Elevation and georeference of a raster in one of `FORMATS`; the cell's size is the georeference's.

    Raises TerrainError, InvalidQueryError and MissingExtraError as `read_dem` does, and whatever else rasterio
    raises for a broken file.
    """
    with opened_raster(path, vertical_scale, allow_vrt) as raster:
        part = checked_window(path, raster.shape, window)
        check_room(path, part[2:], raster.dtype, raster.dtype.itemsize * math.prod(raster.block))
        raster.check_whole()
        return raster.heights(part), None, raster.place(part)


def geotiff_bytes(name: str, values: npt.NDArray[np.generic], place: Georeference | None) -> bytes:
    """A float32 GeoTIFF of `values` (H, W), made in memory: GDAL may meet a full disk in silence, Python does not.

    Raises MissingExtraError, with the file's `name`, where rasterio is not installed.
    """
    rasterio = optional_module("rasterio", f"writing {name}", "geo")
    with _quiet(rasterio), rasterio.MemoryFile() as memory:
        with memory.open(**_geotiff(rasterio, values.shape, place)) as dataset:
            dataset.write(values.astype(np.float32), 1)
        return bytes(memory.read())


@contextmanager
def geotiff_stream(
    path: Path, shape: tuple[int, int], place: Georeference | None
) -> Iterator[Callable[[int, npt.NDArray[np.float32]], None]]:
    """A tiled GeoTIFF to be written by bands of rows: a function that takes a band's first row and its values.

    At the end it is read again: GDAL may meet a full disk in silence. OutputError where it is not what was written;
    rasterio's errors, and MissingExtraError, as they come.
    """
    rasterio = optional_module("rasterio", f"writing {path.name}", "geo")
    tiles = {
        "tiled": True,
        "blockxsize": _TILE,
        "blockysize": _TILE,
        "BIGTIFF": "IF_SAFER",
        "NUM_THREADS": "ALL_CPUS",
    }
    written: list[tuple[int, int, int]] = []

    def write(row: int, values: npt.NDArray[np.float32]) -> None:
        dataset.write(values, 1, window=((row, row + len(values)), (0, shape[1])))
        written.append((row, len(values), zlib.crc32(values.tobytes())))

    with _quiet(rasterio):
        with rasterio.open(path, "w", **_geotiff(rasterio, shape, place), **tiles) as dataset:
            yield write
        with rasterio.open(path) as back:
            for row, rows, checksum in written:
                if zlib.crc32(back.read(1, window=((row, row + rows), (0, shape[1]))).tobytes()) != checksum:
                    raise OutputError(f"{path}: could not be written (rows from {row} on are not what was written)")


def _geotiff(rasterio: ModuleType, shape: tuple[int, ...], place: Georeference | None) -> dict[str, object]:
    """rasterio's options for a compressed float32 GeoTIFF whose unknown cells are NaN."""
    where = {"crs": place.crs, "transform": rasterio.Affine(*place.transform)} if place else {}
    size = {"height": shape[0], "width": shape[1], "count": 1, "dtype": "float32"}
    return {"driver": "GTiff", "compress": "deflate", "predictor": 3, "nodata": math.nan, **size, **where}


def _metres_per_unit(dataset: "DatasetReader") -> float:
    """Metres in the unit of height that the band names; GDAL passes over the one in a PDS3 label."""
    name = dataset.units[0] or _pds_label(dataset)[0].get("UNIT", "")
    return _METRES_PER_UNIT.get(str(name).lower(), 1.0)


def _check_whole(path: Path, dataset: "DatasetReader") -> None:
    """Refuse a file cut short where GDAL would fill in zeros and say nothing: ASCII grids, PDS3 images, .bil."""
    cells = dataset.width * dataset.height
    if dataset.driver == "AAIGrid":
        numbers = np.fromstring(_ASCII_HEADER.sub("", path.read_text("latin-1")), dtype=np.float32, sep=" ")
        if numbers.size < cells:
            raise TerrainError(f"{path}: wanted {cells} heights, got {numbers.size} before the end or a word")
    if dataset.driver == "EHdr" or (dataset.driver == "PDS" and not _pds_label(dataset)[1]):
        wanted = cells * np.dtype(dataset.dtypes[0]).itemsize
        files = dataset.files if dataset.driver == "PDS" else [path]
        got = sum(Path(name).stat().st_size for name in files)
        if got < wanted:
            raise TerrainError(f"{path}: wanted {wanted} bytes of heights, got {got} with the label")


def _pds_label(dataset: "DatasetReader") -> tuple[dict[str, object], bool]:
    """The image object of a PDS3 label, empty for other files, and whether the image is compressed."""
    tags = dataset.tags(ns="json:PDS")
    label = json.loads(":".join(*tags.items())) if tags else {}  # rasterio cuts the JSON at its first colon
    image = label.get("UNCOMPRESSED_FILE", label).get("IMAGE", {})
    return image, "COMPRESSED_FILE" in label


def _opened(rasterio: ModuleType, path: Path, opened: Path, **options: object) -> "DatasetReader":
    """The raster, opened by the drivers in `options` alone: `rasterio.open` would take one."""
    try:
        return cast("DatasetReader", rasterio.io.DatasetReader(str(opened), **options))
    except rasterio.errors.RasterioIOError as error:
        if "not recognized" in str(error):
            raise TerrainError(f"{path}: wanted {FORMATS}, got a file that cannot be read as one of them") from error
        raise


@contextmanager
def _quiet(rasterio: ModuleType) -> Iterator[None]:
    """Keep GDAL from talking, to the user as to the network: its errors become exceptions, its warnings nothing."""
    hooks = sys.excepthook, sys.unraisablehook
    try:
        # both are told of GDAL's messages that are no UTF-8
        sys.excepthook, sys.unraisablehook = lambda *_: None, lambda _: None
        with warnings.catch_warnings(), rasterio.Env(**NO_NETWORK):
            for kind in vars(rasterio.errors).values():  # its own alone: a raster read by windows is open for long
                if isinstance(kind, type) and issubclass(kind, Warning):
                    warnings.simplefilter("ignore", kind)
            yield
    finally:
        sys.excepthook, sys.unraisablehook = hooks
