"""Elevation maps in rasters (GeoTIFF, PDS3, ESRI ASCII grid and others), read and written by
rasterio.
"""

import json
import math
import re
import sys
import warnings
import zlib
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from itertools import product
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, cast

import numpy as np
import numpy.typing as npt

from nnpp_edge.runtime.arrays import Float2D, unmasked
from nnpp_edge.runtime.cells import Cell, Rectangle, Shape
from nnpp_edge.runtime.errors import OutputError, TerrainError, optional_module, shown
from nnpp_edge.runtime.reading import refused_as
from nnpp_edge.terrain.array_files import check_room, known_heights, metres
from nnpp_edge.terrain.coordinates import cell_on_ground
from nnpp_edge.terrain.gdal_files import DRIVERS, FORMATS, NO_NETWORK, openable
from nnpp_edge.terrain.georeference import Georeference, Place, cell_sides

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
"""Of blocks that GDAL keeps; by itself it would keep a twentieth of the memory."""
_MOST_BLOCK_BYTES = 1 << 28
"""Of the blocks of a row of them, which are in memory at once."""


class Raster(Place):
    """An elevation map in an open file of one of `FORMATS`: what `Dem` holds, but its heights are
    read a rectangle at a time.
    """

    def __init__(self, path: Path, dataset: "DatasetReader", cell_size_m: float | None) -> None:
        self.source = path
        self._dataset = dataset
        self._dtype = np.dtype(dataset.dtypes[0])
        self._block: Shape = dataset.block_shapes[0]
        """Rows and columns of a block, which is read as one."""
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
        self._deflated = dataset.driver == "GTiff" and structure.get("COMPRESSION") == "DEFLATE"
        self._right: set[Cell] = set()
        """Blocks whose checksums are right."""
        self.georeference = self._place()
        cell = cell_on_ground(self, warn=cell_size_m is None)
        self.sides_m = cell_sides(path, cell, cell_size_m)
        self.cell_size_m, self.cell_width_m = self.sides_m
        self.check_place()

    @property
    def shape(self) -> Shape:
        rows, cols = self._dataset.shape
        return rows, cols

    def bands(self) -> Iterator[Rectangle]:
        """Rows that are stored together, from top to bottom."""
        rows, cols = self.shape
        high = max(self._block[0], 256)
        return ((row, 0, min(high, rows - row), cols) for row in range(0, rows, high))

    def read(self, part: Rectangle) -> Float2D:
        """(rows, cols) float32 heights of a rectangle, NaN where unknown; TerrainError for a broken
        file.
        """
        row0, col0, rows, cols = part
        window = ((row0, row0 + rows), (col0, col0 + cols))
        with refused_as(TerrainError, f"{self.source}: cells {part} could not be read"):
            if self._deflated:
                self._check_blocks(part)
            heights = metres(self._dataset.read(1, window=window), self._scale, self._offset)
            heights[self._dataset.read_masks(1, window=window) == 0] = np.nan
        return known_heights(heights)

    def read_whole(self) -> Float2D:
        """All heights; TerrainError, too, where the file was cut short, or memory is."""
        block_bytes = self._dtype.itemsize * math.prod(self._block)
        check_room(self.source, self.shape, self._dtype, block_bytes)
        self._check_length()
        return self.read((0, 0, *self.shape))

    def check_windows(self) -> None:
        """TerrainError for a file whose windows cannot be read without much else of it."""
        high, wide = self._block
        stored = ""
        if self._dataset.driver == "AAIGrid":
            stored = "as text"
        elif high * max(self.shape[1], wide) * self._dtype.itemsize > _MOST_BLOCK_BYTES:
            stored = f"in blocks of {high} × {wide} cells"
        if stored:
            raise TerrainError(
                f"{self.source}: wanted a raster that can be read by windows, got one stored "
                f"{stored}: make it tiled with gdal_translate -of COG"
            )

    def _place(self) -> Georeference | None:
        """The georeference; None where the file has no transform."""
        if self._dataset.transform.is_identity:  # how rasterio says that
            return None
        a, b, c, d, e, f = self._dataset.transform[:6]
        crs = self._dataset.crs
        if crs and crs.is_projected and crs.linear_units_factor[1] != 1.0 and not self._unit:
            warnings.warn(
                f"{self.source}: coordinates are in {crs.linear_units}, but {READ_IN_METRES}",
                stacklevel=2,
            )
        return Georeference(crs.to_wkt() if crs else None, (a, b, c, d, e, f))

    def _check_length(self) -> None:
        """TerrainError for a file cut short where GDAL would fill in zeros and say nothing."""
        cells = math.prod(self.shape)
        if self._dataset.driver == "AAIGrid":
            text = _ASCII_HEADER.sub("", self.source.read_text("latin-1"))
            got = np.fromstring(text, dtype=np.float32, sep=" ").size
            if got < cells:
                raise TerrainError(
                    f"{self.source}: wanted {cells} heights, got {got} before the end or a word"
                )
        elif self._dataset.driver in ("EHdr", "PDS"):
            files = self._dataset.files if self._dataset.driver == "PDS" else [self.source]
            wanted = cells * self._dtype.itemsize
            bytes_ = sum(Path(name).stat().st_size for name in files)
            if bytes_ < wanted:
                raise TerrainError(
                    f"{self.source}: wanted {wanted} bytes of heights, got {bytes_} with the label"
                )

    def _check_blocks(self, part: Rectangle) -> None:
        """TerrainError where a deflated block under a window is damaged; each block is checked
        once.

        libtiff gives up on a stream when the block is full, before the checksum at the stream's
        end: it takes many a damaged one for whole ground. To decompress the streams here takes as
        long as reading them (24 ns a cell).
        """
        row, col, rows, cols = part
        high, wide = self._block
        down = range(row // high, -(-(row + rows) // high))
        across = range(col // wide, -(-(col + cols) // wide))
        blocks = set(product(down, across)) - self._right
        places = []
        for i, j in sorted(blocks):
            at, size = (
                self._dataset.get_tag_item(f"BLOCK_{what}_{j}_{i}", dm="TIFF", bidx=1)
                for what in ("OFFSET", "SIZE")
            )
            if at and size:  # others were left out
                places.append((int(at), int(size)))

        def check(place: tuple[int, int]) -> None:
            at, size = place
            with self.source.open("rb") as file:
                file.seek(at)
                try:
                    zlib.decompress(file.read(size))
                except zlib.error as error:
                    raise TerrainError(
                        f"{self.source}: wanted whole blocks, got a damaged one at byte {at}"
                    ) from error

        with ThreadPoolExecutor() as pool:
            list(pool.map(check, places))
        self._right |= blocks


@contextmanager
def opened_raster(path: Path) -> Iterator["DatasetReader"]:
    """An open raster, all of it in files of its own folder; blocks are decoded by several threads,
    a row of them is kept, and what was read before is forgotten.

    Raises errors of `read_dem`, and whatever rasterio raises.
    """
    opened = openable(path)
    rasterio = optional_module("rasterio", f"reading {path.name}", "geo")
    options = {"NUM_THREADS": "ALL_CPUS"}
    if path.suffix.lower() == ".asc":
        # without a decimal point it would be read as whole numbers, and its nan as 0
        options["DATATYPE"] = "Float64"
    with _quiet(rasterio), _opened(rasterio, path, opened, **options) as dataset:
        if any(Path(name).parent != opened.parent for name in dataset.files):
            raise TerrainError(
                f"{path}: wanted a raster whose files lie in its own folder, got {dataset.files}"
            )
        high, wide = dataset.block_shapes[0]
        row_of_blocks = high * (dataset.width + wide) * np.dtype(dataset.dtypes[0]).itemsize
        with rasterio.Env(GDAL_CACHEMAX=max(_LEAST_CACHE_BYTES, 5 * row_of_blocks // 2)):
            yield dataset


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
