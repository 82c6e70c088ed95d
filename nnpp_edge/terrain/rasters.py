"""Elevation maps in rasters (GeoTIFF, PDS3, ESRI ASCII grid and others), read and written by
rasterio.
"""

import json
import math
import os
import re
import sys
import warnings
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import product
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, cast

import numpy as np
import numpy.typing as npt

from nnpp_edge.runtime.arrays import Float2D, unmasked
from nnpp_edge.runtime.bands import in_bands
from nnpp_edge.runtime.cells import Cell, Rectangle, Shape
from nnpp_edge.runtime.errors import OutputError, TerrainError, optional_module, shown
from nnpp_edge.runtime.reading import refused_as
from nnpp_edge.runtime.tuning import THREADS_FROM
from nnpp_edge.terrain.array_files import Reading, check_room, metres
from nnpp_edge.terrain.gdal_files import DRIVERS, FORMATS, NO_NETWORK, openable
from nnpp_edge.terrain.georeference import Georeference, Place

if TYPE_CHECKING:
    from rasterio.io import DatasetReader

_METRES_PER_UNIT = {
    name: metres
    for names, metres in (
        ("m, meter, metre, meters, metres, ", 1.0),  # the last one: no unit is named
        ("ft, foot, feet, international foot, international feet", 0.3048),
        ("us survey foot, us survey feet, us foot, foot us, us ft, ftus", 1200 / 3937),
        ("cm, centimeter, centimetre, centimeters, centimetres", 0.01),
        ("km, kilometer, kilometre, kilometers, kilometres", 1000.0),
    )
    for name in names.split(", ")
}
"""Of heights, by the unit's name in lower case, with spaces."""
READ_IN_METRES = "heights are read as metres; for feet: rio edit-info FILE --bidx 1 --units ft"
_ASCII_HEADER = re.compile(
    r"\A(?:\s*(?!nan|inf)[a-z]\w+[ \t]+\S+[ \t]*$)+",
    re.IGNORECASE | re.MULTILINE,
)
_HIGHEST_OFFSET_M = 1e5
_LEAST_CACHE_BYTES = 1 << 26
"""Of blocks that GDAL keeps for a raster read by windows; by itself it would keep a twentieth of
the memory.
"""


class Raster:
    """The heights in an open file of one of `FORMATS`; `opened_raster` makes one."""

    def __init__(self, path: Path, dataset: "DatasetReader") -> None:
        self.path = path
        self.dataset = dataset
        self.shape: Shape = dataset.shape
        """Rows and columns."""
        self.block: Shape = dataset.block_shapes[0]
        """Rows and columns of a block, which is read as one."""
        self.dtype = np.dtype(dataset.dtypes[0])
        self.driver = dataset.driver
        if dataset.count != 1:
            raise TerrainError(f"{path}: wanted one band of elevation, got {dataset.count} bands")
        if dataset.dtypes[0].startswith("complex"):
            raise TerrainError(f"{path}: wanted a band of real numbers, got {dataset.dtypes[0]}")
        image = _pds_image(dataset)
        # GDAL passes over the unit in a PDS3 label
        self._unit = str(dataset.units[0] or image.get("UNIT", ""))
        unit = _METRES_PER_UNIT.get(re.sub("[_-]", " ", self._unit.lower()))
        if unit is None:
            raise TerrainError(
                f"{path}: wanted heights in m, cm, km, ft or ftUS, got the unit "
                f"{shown(self._unit)}; rio edit-info FILE --bidx 1 --units m names another"
            )
        offset = dataset.offsets[0] * unit
        self._scale = dataset.scales[0] * unit
        self._offset = 0.0 if abs(offset) > _HIGHEST_OFFSET_M else offset
        structure = dataset.tags(ns="IMAGE_STRUCTURE")
        self._deflated = self.driver == "GTiff" and structure.get("COMPRESSION") == "DEFLATE"
        self._right: set[Cell] = set()
        """Blocks whose checksums are right."""

    def heights(self, part: Rectangle) -> Float2D:
        """Metres in a window (row0, col0, rows, cols), NaN where unknown; TerrainError where a
        block is damaged.
        """
        row0, col0, rows, cols = part
        window = ((row0, row0 + rows), (col0, col0 + cols))
        if self._deflated:
            self._check_blocks(part)
        heights = metres(self.dataset.read(1, window=window), self._scale, self._offset)
        heights[self.dataset.read_masks(1, window=window) == 0] = np.nan
        return heights

    def place(self) -> Georeference | None:
        """The georeference; None where the file has no transform."""
        if self.dataset.transform.is_identity:  # how rasterio says that
            return None
        a, b, c, d, e, f = self.dataset.transform[:6]
        crs = self.dataset.crs
        if crs and crs.is_projected and crs.linear_units_factor[1] != 1.0 and not self._unit:
            warnings.warn(
                f"{self.path}: coordinates are in {crs.linear_units}, but {READ_IN_METRES}",
                stacklevel=2,
            )
        return Georeference(crs.to_wkt() if crs else None, (a, b, c, d, e, f))

    def check_whole(self) -> None:
        """TerrainError for a file cut short where GDAL would fill in zeros and say nothing."""
        cells = math.prod(self.shape)
        if self.driver == "AAIGrid":
            text = _ASCII_HEADER.sub("", self.path.read_text("latin-1"))
            got = np.fromstring(text, dtype=np.float32, sep=" ").size
            if got < cells:
                raise TerrainError(
                    f"{self.path}: wanted {cells} heights, got {got} before the end or a word"
                )
        elif self.driver in ("EHdr", "PDS"):
            files = self.dataset.files if self.driver == "PDS" else [self.path]
            wanted = cells * self.dtype.itemsize
            bytes_ = sum(Path(name).stat().st_size for name in files)
            if bytes_ < wanted:
                raise TerrainError(
                    f"{self.path}: wanted {wanted} bytes of heights, got {bytes_} with the label"
                )

    def _check_blocks(self, part: Rectangle) -> None:
        """TerrainError where a deflated block under a window is damaged; each block is checked
        once.

        libtiff gives up on a stream when the block is full, before the checksum at the stream's
        end: it takes many a damaged one for whole ground. To decompress the streams here takes as
        long as reading them (24 ns a cell).
        """
        row, col, rows, cols = part
        high, wide = self.block
        down = range(row // high, -(-(row + rows) // high))
        across = range(col // wide, -(-(col + cols) // wide))
        blocks = set(product(down, across)) - self._right
        places = []
        for i, j in sorted(blocks):
            at, size = (
                self.dataset.get_tag_item(f"BLOCK_{what}_{j}_{i}", dm="TIFF", bidx=1)
                for what in ("OFFSET", "SIZE")
            )
            if at and size:  # others were left out
                places.append((int(at), int(size)))

        def check(first: int, last: int) -> None:
            with self.path.open("rb") as file:
                for at, size in places[first:last]:
                    try:
                        zlib.decompress(os.pread(file.fileno(), size, at))
                    except zlib.error as error:
                        raise TerrainError(
                            f"{self.path}: wanted whole blocks, got a damaged one at byte {at}"
                        ) from error

        if places:
            in_bands(check, 0, len(places), THREADS_FROM // 8)  # fewer are not worth threads
        self._right |= blocks


@contextmanager
def opened_raster(path: Path, *, by_windows: bool = False) -> Iterator[Raster]:
    """An open raster of one band of heights, all in files of its own folder; raises as
    `read_raster`.

    One to be read by windows keeps a row of blocks, decoded by several threads, and forgets what it
    has read before.
    """
    opened = openable(path)
    rasterio = optional_module("rasterio", f"reading {path.name}", "geo")
    # An ASCII grid without a decimal point would be read as whole numbers, and its nan as 0.
    options = {"DATATYPE": "Float64"} if path.suffix.lower() == ".asc" else {}
    if by_windows:
        options["NUM_THREADS"] = "ALL_CPUS"
    with _quiet(rasterio), _opened(rasterio, path, opened, **options) as dataset:
        if any(Path(name).parent != opened.parent for name in dataset.files):
            raise TerrainError(
                f"{path}: wanted a raster whose files lie in its own folder, got {dataset.files}"
            )
        raster = Raster(path, dataset)
        if not by_windows:
            yield raster
            return
        high, wide = raster.block
        row_of_blocks = high * (raster.shape[1] + wide) * raster.dtype.itemsize
        with rasterio.Env(GDAL_CACHEMAX=max(_LEAST_CACHE_BYTES, 5 * row_of_blocks // 2)):
            yield raster


def read_raster(path: Path) -> Reading:
    """Elevation and georeference of a raster of `FORMATS`; errors of `read_dem`, and whatever
    rasterio raises.
    """
    with opened_raster(path) as raster:
        block_bytes = raster.dtype.itemsize * math.prod(raster.block)
        check_room(path, raster.shape, raster.dtype, block_bytes)
        raster.check_whole()
        return raster.heights((0, 0, *raster.shape)), None, raster.place()


def raster_bytes(path: Path, array: npt.ArrayLike, place: Place) -> bytes:
    """A map of a place's cells, numbers or bools, as a float32 GeoTIFF whose masked cells are NaN.

    It is made in memory, as GDAL may meet a full disk in silence. OutputError, which names the file
    to be written, where GDAL cannot write it.
    """
    values = unmasked(array)
    rasterio = optional_module("rasterio", f"writing {path.name}", "geo")
    rows, cols = values.shape
    options = {
        "driver": "GTiff",
        "compress": "deflate",
        "predictor": 3,
        "nodata": math.nan,
        "height": rows,
        "width": cols,
        "count": 1,
        "dtype": "float32",
    }
    if place.georeference is not None:
        transform = rasterio.Affine(*place.georeference.transform)
        options |= {"crs": place.georeference.crs, "transform": transform}
    with (
        refused_as(OutputError, f"{path}: could not be written"),
        _quiet(rasterio),
        rasterio.MemoryFile() as memory,
    ):
        with memory.open(**options) as dataset:
            dataset.write(values.astype(np.float32), 1)
        return bytes(memory.read())


def _pds_image(dataset: "DatasetReader") -> dict[str, object]:
    """The image object of a PDS3 label; empty for other files."""
    tags = dataset.tags(ns="json:PDS")
    # rasterio cuts the JSON at its first colon
    label = json.loads(":".join(*tags.items())) if tags else {}
    found: dict[str, object] = label.get("IMAGE", {})
    return found


def _opened(rasterio: ModuleType, path: Path, opened: Path, **options: object) -> "DatasetReader":
    """The raster, opened by one of `DRIVERS`: `rasterio.open` would take one driver."""
    try:
        found = rasterio.io.DatasetReader(str(opened), driver=list(DRIVERS), **options)
        return cast("DatasetReader", found)
    except rasterio.errors.RasterioIOError as error:
        if "not recognized" in str(error):
            raise TerrainError(
                f"{path}: wanted {FORMATS}, got a file that cannot be read as one of them"
            ) from error
        raise


@contextmanager
def _quiet(rasterio: ModuleType) -> Iterator[None]:
    """Keep GDAL from talking, to the user as to the network: its errors become exceptions, its
    warnings nothing.
    """
    hooks = sys.excepthook, sys.unraisablehook
    try:
        # both are told of GDAL's messages that are no UTF-8
        sys.excepthook = lambda *_: None
        sys.unraisablehook = lambda _: None
        with warnings.catch_warnings(), rasterio.Env(**NO_NETWORK):
            # its own alone: a raster read by windows is open for long
            for kind in vars(rasterio.errors).values():
                if isinstance(kind, type) and issubclass(kind, Warning):
                    warnings.simplefilter("ignore", kind)
            yield
    finally:
        sys.excepthook, sys.unraisablehook = hooks
