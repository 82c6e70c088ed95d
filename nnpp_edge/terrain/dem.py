"""Digital elevation models: read from the files that space agencies and surveyors publish, and written back.

GeoTIFF, PDS3 (`.img`, `.lbl`), ESRI ASCII grid and the rest of GDAL's rasters go through rasterio, which only
these need; NumPy arrays and 16-bit PNGs do not.
"""

import json
import math
import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from nnpp_edge.files import write_whole
from nnpp_edge.runtime.errors import (
    InvalidQueryError,
    MissingExtraError,
    NnppEdgeError,
    OutputError,
    TerrainError,
)

Window = tuple[int, int, int, int]  # row0, col0, rows, cols

_ARRAY_NAMES = ("elevation_m", "elevation", "dem")
_METRES_PER_UNIT = dict.fromkeys(("ft", "foot", "feet"), 0.3048)
_METRES_PER_UNIT |= dict.fromkeys(("us survey foot", "us_survey_foot", "us-ft", "ftus"), 1200 / 3937)
_METRES_PER_UNIT |= dict.fromkeys(("km", "kilometer", "kilometre", "kilometers", "kilometres"), 1000.0)
_SEMI_MAJOR = re.compile(r'(?:SPHEROID|ELLIPSOID)\["[^"]*",\s*([^,\]]+)(?:[^\[]*LENGTHUNIT\["[^"]*",\s*([^,\]]+))?')
_ASCII_HEADER = re.compile(r"\A(?:\s*(?!nan|inf)[a-z]\w+[ \t]+\S+[ \t]*$)+", re.IGNORECASE | re.MULTILINE)
_HIGHEST_OFFSET_M = 1e5
_FARTHEST_M = 1e9


@dataclass(frozen=True)
class Georeference:
    """Where the cells lie on the map.

    `crs` is the coordinate system as WKT, None where the file names none. `transform` is rasterio's
    (a, b, c, d, e, f): the corner of cell (row, col) lies at x = a col + b row + c, y = d col + e row + f.
    """

    crs: str | None
    transform: tuple[float, float, float, float, float, float]

    def map_coordinates(self, row: float, col: float) -> tuple[float, float]:
        """Map coordinates (x, y) of the centre of cell (row, col), in the units of `crs`."""
        a, b, c, d, e, f = self.transform
        row, col = row + 0.5, col + 0.5
        return a * col + b * row + c, d * col + e * row + f

    def cell_of(self, x: float, y: float) -> tuple[int, int]:
        """Cell (row, col) that holds the map point (x, y); it may lie outside the map.

        Raises InvalidQueryError where x or y is not finite.
        """
        if not (math.isfinite(x) and math.isfinite(y)):
            raise InvalidQueryError(f"map coordinates must be finite, got ({x}, {y})")
        a, b, c, d, e, f = self.transform
        determinant = a * e - b * d
        col = (e * (x - c) - b * (y - f)) / determinant
        row = (a * (y - f) - d * (x - c)) / determinant
        return math.floor(row), math.floor(col)


@dataclass(frozen=True, eq=False)
class Dem:
    """An elevation map and the size of its cells.

    Attributes
    ----------
    elevation : (H, W) float32
        Metres; NaN where unknown, finite in at least one cell.
    cell_size_m, cell_width_m : float
        Side of a cell along a column of the map (north-south) and along a row (east-west).
    georeference : Georeference or None
        Where the cells lie, in the coordinates of the file.
    source : Path
        The file, for messages.

    Raises
    ------
    TerrainError
        Anything else than the above.
    """

    elevation: npt.NDArray[np.float32]
    cell_size_m: float
    cell_width_m: float
    georeference: Georeference | None
    source: Path

    def __post_init__(self) -> None:
        _check_grid(self.source, self.elevation)
        if self.elevation.dtype != np.float32:
            raise TerrainError(f"{self.source}: elevation must be float32, got {self.elevation.dtype}")
        if not np.isfinite(self.elevation).any():
            raise TerrainError(f"{self.source}: wanted an elevation map, got no cell with a known height")
        for side in (self.cell_size_m, self.cell_width_m):
            if not (math.isfinite(side) and side > 0):
                raise TerrainError(f"{self.source}: wanted cells with sides above 0 m, got {side:g} m")

    def rescaled(self, cell_size_m: float) -> "Dem":
        """The same terrain grown or shrunk to cells of `cell_size_m`: heights follow, so slopes stay.

        The georeference stays as it is: it still says where each cell lay on the map. Raises
        InvalidQueryError where `cell_size_m` is not above 0 and finite.
        """
        _check_option("cell size", cell_size_m)
        factor = cell_size_m / self.cell_size_m
        elevation = self.elevation * np.float32(factor)
        return replace(
            self, elevation=elevation, cell_size_m=float(cell_size_m), cell_width_m=self.cell_width_m * factor
        )

    def map_coordinates(self, row: float, col: float) -> tuple[float, float]:
        """`Georeference.map_coordinates`; InvalidQueryError where the map has no georeference."""
        return self._located().map_coordinates(row, col)

    def cell_of(self, x: float, y: float) -> tuple[int, int]:
        """`Georeference.cell_of`; InvalidQueryError where the map has no georeference."""
        return self._located().cell_of(x, y)

    def _located(self) -> Georeference:
        """The georeference, or the error that it lacks."""
        if self.georeference is None:
            raise InvalidQueryError(f"{self.source}: map coordinates need a georeference, the file has none")
        return self.georeference


def read_dem(
    path: Path | str,
    cell_size_m: float | None = None,
    vertical_scale: float | None = None,
    window: Window | None = None,
) -> Dem:
    """Read an elevation map; the ending `.npy`, `.npz` or `.png` decides, all else is GDAL's.

    Parameters
    ----------
    path : Path or str
        A raster of one band that GDAL reads (for a PDS3 `.img` with a `.lbl` beside it, the label is opened);
        a 2-D `.npy`; an `.npz` with `elevation_m`, `elevation`, `dem` or a single 2-D array, and perhaps
        `cell_size_m` (or `cell_m`) and `cell_width_m`; a grey 16-bit PNG.
    cell_size_m : float, optional
        Side of a cell, north-south. Wins over the file's; the ratio of width to height is kept.
    vertical_scale : float, optional
        Metres per unit of the file's heights, after the band's own scale and offset. A PNG needs it;
        elsewhere it wins over the unit that the file names, which is metres where it names none.
    window : (row0, col0, rows, cols), optional
        The part to read; the georeference is the part's own.

    Returns
    -------
    Dem
        NaN where the file has no data, an infinity, or a height beyond 1e9 m (a fill value left undeclared).

    Raises
    ------
    TerrainError
        The file is missing, broken, not an elevation map, or lacks a cell size that was not given.
    InvalidQueryError
        `cell_size_m`, `vertical_scale` or `window` makes no sense.
    MissingExtraError
        The format needs rasterio, which is not installed.

    Notes
    -----
    In a projected system cells are as long as the projection draws them: on an equirectangular map, wider
    than the ground by 1 / cos(latitude) away from its standard parallel. Degrees become metres on the
    system's own ellipsoid, taken as a sphere of its semi-major axis, with the cosine of the latitude at the
    middle of the map. A transform without a system is taken as metres.

    An offset over 100 km is a body's radius (PDS3 labels of the Moon): it is left out, so heights count from
    that sphere and keep float32's precision.
    """
    path = Path(path)
    _check_option("cell size", cell_size_m)
    _check_option("vertical scale", vertical_scale)
    if not path.is_file():
        got = "a folder" if path.is_dir() else "no such file"
        raise TerrainError(f"{path}: wanted a file with an elevation map, got {got}")
    read = {".npy": _read_numpy, ".npz": _read_numpy, ".png": _read_png}.get(path.suffix.lower(), _read_gdal)
    with _one_line_error(TerrainError, f"{path}: wanted an elevation map, got a file that cannot be read"):
        elevation, cell, georeference = read(path, vertical_scale, window)
        elevation[~(np.abs(elevation) < _FARTHEST_M)] = np.nan
    if cell_size_m is not None:
        cell = (cell_size_m, cell_size_m * cell[1] / cell[0] if cell else cell_size_m)
    if cell is None:
        raise TerrainError(f"{path}: no cell size in the file; give it with --cell-size METRES")
    return Dem(elevation, float(cell[0]), float(cell[1]), georeference, path)


def write_raster(path: Path | str, array: npt.ArrayLike, dem: Dem) -> None:
    """Write a map of `dem`'s cells as a float32 GeoTIFF (deflate, nodata NaN) with `dem`'s georeference.

    Parameters
    ----------
    path : Path or str
        Replaced in one step: whoever looks sees the old file or the whole new one.
    array : (H, W) numbers or bools
        As many cells as `dem.elevation`.
    dem : Dem
        Where the cells lie. Without a georeference the file has none either.

    Raises
    ------
    OutputError
        The shape or type does not fit, or the file could not be written; what stood there is untouched.
    MissingExtraError
        rasterio is not installed.
    """
    path, values = Path(path), np.asarray(array)
    if values.shape != dem.elevation.shape or values.dtype.kind not in "biuf":
        wanted = f"wanted a {dem.elevation.shape} array of numbers"
        raise OutputError(f"{path}: {wanted}, got {values.shape} {values.dtype}")
    rasterio = _rasterio(f"writing {path.name}")
    with _one_line_error(OutputError, f"{path}: could not be written"):
        write_whole(path, _geotiff(rasterio, values, dem.georeference))


_Read = tuple[npt.NDArray[np.float32], tuple[float, float] | None, Georeference | None]


def _read_gdal(path: Path, vertical_scale: float | None, window: Window | None) -> _Read:
    """Elevation, cell (size, width) and georeference of whatever GDAL reads."""
    rasterio = _rasterio(f"reading {path.name}")
    # An ASCII grid without a decimal point would be read as whole numbers, and its nan as 0.
    options = {"DATATYPE": "Float64"} if path.suffix.lower() == ".asc" else {}
    with _quiet(rasterio), rasterio.open(_openable(path), **options) as dataset:
        if dataset.count != 1:
            raise TerrainError(f"{path}: wanted one band of elevation, got {dataset.count} bands")
        if dataset.dtypes[0].startswith("complex"):
            raise TerrainError(f"{path}: wanted a band of real numbers, got {dataset.dtypes[0]}")
        _check_whole(path, dataset)
        row0, col0, rows, cols = _checked_window(path, dataset.shape, window)
        part = ((row0, row0 + rows), (col0, col0 + cols))
        unit = vertical_scale or _metres_per_unit(dataset)
        offset = dataset.offsets[0] * unit
        offset = 0.0 if abs(offset) > _HIGHEST_OFFSET_M else offset
        elevation = _metres(dataset.read(1, window=part), dataset.scales[0] * unit, offset)
        elevation[dataset.read_masks(1, window=part) == 0] = np.nan
        if dataset.transform.is_identity:  # how rasterio says that the file has no transform
            return elevation, None, None
        a, b, c, d, e, f = dataset.transform[:6]
        crs = dataset.crs.to_wkt() if dataset.crs else None
        moved = (a, b, a * col0 + b * row0 + c, d, e, d * col0 + e * row0 + f)
        georeference = Georeference(crs, moved)
        return elevation, _cell_on_ground(path, dataset.crs, georeference, (rows, cols)), georeference


def _cell_on_ground(path: Path, crs: Any, place: Georeference, shape: tuple[int, int]) -> tuple[float, float]:
    """A cell's (size, width) in metres: the lengths of a step along a column and along a row."""
    a, b, _, d, e, _ = place.transform
    if not (math.isfinite(a * e - b * d) and a * e != b * d):
        raise TerrainError(f"{path}: wanted a transform that can be turned back, got {place.transform}")
    x_unit = y_unit = crs.units_factor[1] if crs else 1.0
    if crs and crs.is_geographic:
        found = _SEMI_MAJOR.search(place.crs or "")
        if found is None:
            raise TerrainError(f"{path}: wanted an ellipsoid to measure degrees on, got {place.crs}")
        latitude = place.map_coordinates(shape[0] / 2 - 0.5, shape[1] / 2 - 0.5)[1] * y_unit
        if abs(latitude) >= math.pi / 2:
            raise TerrainError(f"{path}: wanted latitudes within the poles, got {math.degrees(latitude):g}°")
        y_unit *= float(found[1]) * float(found[2] or 1)
        x_unit = y_unit * math.cos(latitude)
    return math.hypot(x_unit * b, y_unit * e), math.hypot(x_unit * a, y_unit * d)


def _metres_per_unit(dataset: Any) -> float:
    """Metres in the unit of height that the band names; GDAL passes over the one in a PDS3 label."""
    name = dataset.units[0] or _pds_label(dataset)[0].get("UNIT", "")
    return _METRES_PER_UNIT.get(str(name).lower(), 1.0)


def _check_whole(path: Path, dataset: Any) -> None:
    """Refuse a file cut short where GDAL would fill in zeros and say nothing: ASCII grids, PDS3 images."""
    cells = dataset.width * dataset.height
    if dataset.driver == "AAIGrid":
        numbers = np.fromstring(_ASCII_HEADER.sub("", path.read_text("latin-1")), dtype=np.float32, sep=" ")
        if numbers.size < cells:
            raise TerrainError(f"{path}: wanted {cells} heights, got {numbers.size} before the end or a word")
    if dataset.driver == "PDS" and not _pds_label(dataset)[1]:
        wanted = cells * np.dtype(dataset.dtypes[0]).itemsize
        got = sum(Path(name).stat().st_size for name in dataset.files)
        if got < wanted:
            raise TerrainError(f"{path}: wanted {wanted} bytes of heights, got {got} with the label")


def _pds_label(dataset: Any) -> tuple[dict[str, Any], bool]:
    """The image object of a PDS3 label, empty for other files, and whether the image is compressed."""
    tags = dataset.tags(ns="json:PDS")
    label = json.loads(":".join(*tags.items())) if tags else {}  # rasterio cuts the JSON at its first colon
    image = label.get("UNCOMPRESSED_FILE", label).get("IMAGE", {})
    return image, "COMPRESSED_FILE" in label


def _openable(path: Path) -> Path:
    """The detached label of a PDS3 image, which GDAL opens in its stead; else the path itself."""
    endings = (".lbl", ".LBL") if path.suffix.lower() == ".img" else ()
    return next((label for end in endings if (label := path.with_suffix(end)).is_file()), path)


def _read_numpy(path: Path, vertical_scale: float | None, window: Window | None) -> _Read:
    """Elevation and cell (size, width) of a NumPy file; the content tells an archive from an array."""
    loaded = np.load(path, mmap_mode="r", allow_pickle=False)
    cell = None
    if isinstance(loaded, np.lib.npyio.NpzFile):
        with loaded as archive:
            size = _number(path, archive, "cell_size_m", "cell_m")
            width = _number(path, archive, "cell_width_m")
            loaded = _elevation_array(path, archive)
        if size is not None:
            cell = (size, size if width is None else width)
        elif width is not None:
            raise TerrainError(f"{path}: wanted cell_size_m beside cell_width_m, got cell_width_m alone")
    _check_grid(path, loaded)
    row0, col0, rows, cols = _checked_window(path, loaded.shape, window)
    part = loaded[row0 : row0 + rows, col0 : col0 + cols]
    return _metres(part, vertical_scale or 1.0, 0.0), cell, None


def _elevation_array(path: Path, archive: Any) -> npt.NDArray[Any]:
    """The archive's array of heights: by its name, or the only one of two dimensions."""
    for name in _ARRAY_NAMES:
        if name in archive.files:
            return archive[name]
    grids = {name: array for name in archive.files if (array := archive[name]).ndim == 2}
    if len(grids) != 1:
        wanted, got = ", ".join(_ARRAY_NAMES), ", ".join(archive.files) or "nothing"
        raise TerrainError(f"{path}: wanted {wanted} or a single 2-D array, got {got}")
    return grids.popitem()[1]


def _number(path: Path, archive: Any, *names: str) -> float | None:
    """The archive's scalar under the first of `names` it has, above 0; None without one."""
    for name in (name for name in names if name in archive.files):
        value = archive[name]
        if value.size != 1 or value.dtype.kind not in "iuf" or not 0 < value.item() < math.inf:
            raise TerrainError(f"{path}: {name} must be one number above 0, got {value.dtype} {value.shape}")
        return float(value.item())
    return None


def _read_png(path: Path, vertical_scale: float | None, window: Window | None) -> _Read:
    """Elevation of a grey 16-bit PNG."""
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
    row0, col0, rows, cols = _checked_window(path, levels.shape, window)
    return _metres(levels[row0 : row0 + rows, col0 : col0 + cols], vertical_scale, 0.0), None, None


def _metres(values: npt.NDArray[Any], scale: float, offset: float) -> npt.NDArray[np.float32]:
    """A fresh float32 array of scale * values + offset, worked out in float64."""
    with np.errstate(over="ignore", invalid="ignore"):
        if scale == 1.0 and offset == 0.0:
            return np.array(values, dtype=np.float32, order="C")
        return np.ascontiguousarray((values.astype(np.float64) * scale + offset).astype(np.float32))


def _checked_window(path: Path, shape: tuple[int, ...], window: Window | None) -> Window:
    """The window, or the whole map; it must hold a cell and lie inside."""
    if window is None:
        return 0, 0, shape[0], shape[1]
    row0, col0, rows, cols = window
    if min(row0, col0) < 0 or min(rows, cols) < 1 or row0 + rows > shape[0] or col0 + cols > shape[1]:
        raise InvalidQueryError(f"{path}: window {window} must lie in {shape[0]} rows, {shape[1]} columns")
    return row0, col0, rows, cols


def _check_grid(path: Path, array: npt.NDArray[Any]) -> None:
    """Refuse what is not a 2-D array of at least one real number."""
    if array.ndim != 2 or array.size == 0 or array.dtype.kind not in "iuf":
        raise TerrainError(f"{path}: wanted an (H, W) array of heights, got {array.shape} {array.dtype}")


def _check_option(name: str, value: float | None) -> None:
    """Refuse an option that is given and not above 0 and finite."""
    if value is not None and not (math.isfinite(value) and value > 0):
        raise InvalidQueryError(f"{name} must be above 0 and finite, got {value}")


def _rasterio(purpose: str) -> Any:
    """The rasterio module, or the error that says how to get it."""
    try:
        import rasterio
        import rasterio.io
    except ImportError as error:
        raise MissingExtraError(f"{purpose} needs rasterio: pip install 'nnpp-edge[geo]'") from error
    return rasterio


@contextmanager
def _quiet(rasterio: Any) -> Iterator[None]:
    """Keep GDAL from talking: its errors become exceptions, its warnings nothing."""
    with warnings.catch_warnings(), rasterio.Env():
        warnings.simplefilter("ignore")
        yield


@contextmanager
def _one_line_error(kind: type[NnppEdgeError], what: str) -> Iterator[None]:
    """Turn whatever a broken file or a full disk raises into one `kind` that ends with the first cause."""
    try:
        yield
    except NnppEdgeError:
        raise
    except Exception as error:  # libraries meet bad bytes with nearly every kind there is
        cause: BaseException = error
        while cause.__cause__ is not None:
            cause = cause.__cause__
        reason = " ".join(str(cause).split()) or type(cause).__name__
        raise kind(f"{what} ({reason})") from error


def _geotiff(rasterio: Any, values: npt.NDArray[Any], place: Georeference | None) -> bytes:
    """A float32 GeoTIFF, made in memory, for GDAL may meet a full disk in silence and Python does not."""
    where = {"crs": place.crs, "transform": rasterio.Affine(*place.transform)} if place else {}
    shape = {"height": values.shape[0], "width": values.shape[1], "count": 1, "dtype": "float32"}
    kind = {"driver": "GTiff", "compress": "deflate", "predictor": 3, "nodata": math.nan}
    with _quiet(rasterio), rasterio.MemoryFile() as memory:
        with memory.open(**kind, **shape, **where) as dataset:
            dataset.write(values.astype(np.float32), 1)
        return memory.read()
