"""Maps and paths as ROS messages lay them out, in NumPy alone; no ROS is needed.

Two layouts occur. An occupancy grid (nav_msgs/OccupancyGrid) holds whole numbers row by row from the corner at its
origin: rows run with y, columns with x. A grid map (grid_map_msgs/GridMap) holds layers of floats column by column
from the corner farthest along x and y: rows run against x, columns against y, and both begin somewhere in a ring.
"""

import io
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nnpp_edge.files import write_whole
from nnpp_edge.ros.occupancy import BODY_TOUCHES, IMPASSABLE, UNKNOWN, as_cost, as_occupancy
from nnpp_edge.runtime.arguments import checked, is_real
from nnpp_edge.runtime.arrays import as_map
from nnpp_edge.runtime.cells import Cell
from nnpp_edge.runtime.errors import InvalidMapError, InvalidQueryError, shown
from nnpp_edge.runtime.loop.messages import MapPatch

_SAME = 1e-3
"""Share of a cell's side by which two maps' cells may differ."""
_LEVEL = (1e-3, 1e-3, 1e-3, 1.001)
"""Parts of a quaternion, of either sign, up to which a map counts as not turned."""


@checked(InvalidMapError)
@dataclass(frozen=True)
class MapFrame:
    """Where the cells of a map lie in metres. Rows run along one axis, columns along the other, forth or back.

    Raises
    ------
    InvalidMapError
        The resolution is not above 0, or a number is not finite.
    """

    resolution: float
    """Side of a cell, metres."""
    x: float = 0.0
    """Of the corner of cell (0, 0) where the map begins, metres."""
    y: float = 0.0
    rows_along_x: bool = False
    """Rows run against x and columns against y, as in a grid map; else rows with y and columns with x."""
    frame_id: str = ""
    """Name of the frame that x and y count in; empty where it is not told."""

    def __post_init__(self) -> None:
        if not (math.isfinite(self.resolution) and self.resolution > 0.0):
            raise InvalidMapError(f"resolution must be metres above 0, got {self.resolution}")
        if not (math.isfinite(self.x) and math.isfinite(self.y)):
            raise InvalidMapError(f"the map's corner must be finite, got ({self.x}, {self.y})")

    def metres(self, cells: ArrayLike) -> NDArray[np.float64]:
        """Points (x, y) in metres, (N, 2), of cells or places (row, col).

        Whole numbers are cells and give their middle; floats are places, as in a `Pose`, and 0.0 is the edge.
        """
        places = _pairs(cells)
        places = places + 0.5 if places.dtype.kind in "iu" else places
        span, corner = self.resolution * places, np.array((self.x, self.y))
        return np.asarray(corner - span if self.rows_along_x else corner + span[:, ::-1])

    def places(self, points: ArrayLike) -> NDArray[np.float64]:
        """Places (row, col) of points (x, y) in metres, (N, 2); their floor is the cell, as in a `Pose`."""
        xy = _pairs(points).astype(np.float64)
        if not np.isfinite(xy).all():
            raise InvalidQueryError("points must be finite metres (x, y)")
        away = xy - (self.x, self.y)
        return np.asarray((-away if self.rows_along_x else away[:, ::-1]) / self.resolution)

    def cell(self, x: float, y: float) -> Cell:
        """The cell that holds a point; it may lie outside the map."""
        row, col = np.floor(self.places((x, y))[0])
        return int(row), int(col)


@checked(InvalidMapError)
@dataclass(frozen=True, eq=False)
class OccupancyGrid:
    """Content of a nav_msgs/OccupancyGrid, without its stamp. Its origin must not be turned.

    Raises
    ------
    InvalidMapError
        `data` does not have width · height numbers from -1 to 100.
    """

    resolution: float
    width: int
    height: int
    data: NDArray[np.int8] = field(repr=False)
    """(height · width,) int8: -1 unknown, 0 free to 100 occupied; row by row."""
    origin_x: float = 0.0
    """Of the corner of the first cell, metres."""
    origin_y: float = 0.0
    frame_id: str = ""

    @classmethod
    def of_message(cls, message: object) -> "OccupancyGrid":
        """From a message as rclpy, rosbags or mcap-ros2-support hand it out, or as nested dicts.

        Raises InvalidMapError for another message, or a turned grid.
        """
        data = _field(message, "data")
        resolution, width, height = (_field(message, f"info.{name}") for name in ("resolution", "width", "height"))
        origin = _corner(message, "info.origin")
        return cls(resolution, width, height, data, *origin, _field(message, "header.frame_id"))

    def __post_init__(self) -> None:
        values, _ = _array(self.data), self.frame
        fits = self.width >= 1 and self.height >= 1 and values.size == self.width * self.height
        if not fits or values.dtype.kind not in "iu":
            wanted = f"{self.height} × {self.width} whole numbers"
            raise InvalidMapError(f"an occupancy grid's data must be {wanted}, got {values.shape} {values.dtype}")
        if values.min() < UNKNOWN or values.max() > IMPASSABLE:
            raise InvalidMapError(
                f"an occupancy grid's data must lie in [-1, 100], got [{values.min()}, {values.max()}]"
            )
        object.__setattr__(self, "data", values.astype(np.int8).reshape(-1))

    @property
    def frame(self) -> MapFrame:
        """Where its cells lie."""
        return MapFrame(self.resolution, self.origin_x, self.origin_y, frame_id=self.frame_id)

    @checked(InvalidMapError)
    def cost(self, occupied: int = BODY_TOUCHES) -> NDArray[np.float32]:
        """Its cells as costs, (height, width): a hundredth of the occupancy; inf from `occupied` on; NaN if unknown.

        The rule, both ways, is in `nnpp_edge.ros.occupancy`.
        """
        return as_cost(self.data.reshape(self.height, self.width), occupied)

    @classmethod
    def of_cost(cls, cost: ArrayLike, frame: MapFrame) -> "OccupancyGrid":
        """The grid of a cost map (H, W); the inverse of `cost`, to a hundredth.

        Raises InvalidMapError where the frame's rows do not run with y.
        """
        if frame.rows_along_x:
            raise InvalidMapError("an occupancy grid's rows must run with y, got a frame whose rows run against x")
        values = as_map(cost, "cost")
        height, width = values.shape
        data = as_occupancy(values).reshape(-1)
        return cls(frame.resolution, width, height, data, frame.x, frame.y, frame.frame_id)


@checked(InvalidMapError)
@dataclass(frozen=True, eq=False)
class GridMap:
    """Content of a grid_map_msgs/GridMap, without its stamp. Its pose must not be turned.

    Raises
    ------
    InvalidMapError
        Lengths are no multiples of the resolution, a layer has another number of cells, or a start lies outside.
    """

    resolution: float
    length_x: float
    """Metres; rows · resolution."""
    length_y: float
    """Metres; columns · resolution."""
    layers: dict[str, NDArray[np.float32]] = field(repr=False)
    """Each (rows · columns,) float32, column by column, as in the message's ``data``; NaN where unknown."""
    x: float = 0.0
    """Of the map's middle, metres."""
    y: float = 0.0
    outer_start_index: int = 0
    """Row of the ring at which the map begins."""
    inner_start_index: int = 0
    """Column of the ring at which the map begins."""
    frame_id: str = ""

    @classmethod
    def of_message(cls, message: object) -> "GridMap":
        """From a message as rclpy, rosbags or mcap-ros2-support hand it out, or as nested dicts.

        Raises InvalidMapError for another message, or a turned map.
        """
        names, arrays = _items(message, "layers"), _items(message, "data")
        texts = {name for name in names if isinstance(name, str)}
        if not len(texts) == len(names) == len(arrays):
            raise InvalidMapError(f"wanted a name for each of {len(arrays)} layers, got {shown(names)}")
        side, *lengths = (_field(message, f"info.{name}") for name in ("resolution", "length_x", "length_y"))
        middle = _corner(message, "info.pose")
        starts = [_field(message, f"{name}_start_index") for name in ("outer", "inner")]
        frame_id = _field(message, "header.frame_id")
        grid = cls(side, lengths[0], lengths[1], {}, *middle, starts[0], starts[1], frame_id)
        rows, cols = grid.shape
        layers: dict[str, NDArray[np.float32]] = {}
        by_column = [f"column_index {cols}", f"row_index {rows}"]
        for name, array in zip(names, arrays, strict=True):
            values = _array(_field(array, "data"))
            layout = [f"{_field(dim, 'label')} {_field(dim, 'size')}" for dim in _items(array, "layout.dim")]
            if layout not in (by_column, by_column[::-1]):
                wanted = " and ".join(by_column)
                raise InvalidMapError(f"layer {name!r} must be laid out by {wanted}, got {shown(layout)}")
            by_row = layout != by_column and values.size == rows * cols
            layers[str(name)] = values.reshape(rows, cols).T.reshape(-1) if by_row else values
        return replace(grid, layers=layers)

    def __post_init__(self) -> None:
        (rows, cols), _, layers = self.shape, self.frame, {}
        for length, cells in ((self.length_x, rows), (self.length_y, cols)):
            if cells < 1 or abs(length - cells * self.resolution) > _SAME * self.resolution * max(cells, 1):
                got = f"{self.length_x}, {self.length_y}"
                raise InvalidMapError(f"a grid map's lengths must be multiples of {self.resolution} m, got {got}")
        if not (0 <= self.outer_start_index < rows and 0 <= self.inner_start_index < cols):
            start = (self.outer_start_index, self.inner_start_index)
            raise InvalidMapError(f"a grid map's start must lie within {rows} × {cols} cells, got {start}")
        for name, values in self.layers.items():
            flat = _array(values)
            if flat.shape != (rows * cols,) or flat.dtype.kind not in "iuf":
                wanted = f"{rows} × {cols} numbers column by column, as in the message"
                also = "; of_layers takes maps (rows, columns)" if flat.ndim == 2 else ""
                raise InvalidMapError(f"layer {name!r} must be {wanted}, got {flat.shape} {flat.dtype}{also}")
            with np.errstate(over="ignore"):  # heights beyond 32-bit floats are unknown, as infinite ones
                layers[name] = flat.astype(np.float32, copy=False)
        object.__setattr__(self, "layers", layers)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        frame = MapFrame(self.resolution)  # checks the resolution
        along_x, along_y = self.length_x / frame.resolution, self.length_y / frame.resolution
        if not (0.0 < along_x < math.inf and 0.0 < along_y < math.inf):
            raise InvalidMapError(f"a grid map's lengths must be above 0 m, got {self.length_x}, {self.length_y}")
        return round(along_x), round(along_y)

    @property
    def frame(self) -> MapFrame:
        """Where its cells lie."""
        x, y = self.x + 0.5 * self.length_x, self.y + 0.5 * self.length_y
        return MapFrame(self.resolution, x, y, rows_along_x=True, frame_id=self.frame_id)

    def layer(self, name: str = "elevation") -> NDArray[np.float32]:
        """A layer (rows, columns) in the order of its frame: unrolled, rows against x and columns against y."""
        if name not in self.layers:
            raise InvalidMapError(f"wanted layer {name!r}, the grid map has {', '.join(self.layers) or 'none'}")
        rows, cols = self.shape
        ring = self.layers[name].reshape(cols, rows).T
        return np.ascontiguousarray(np.roll(ring, (-self.outer_start_index, -self.inner_start_index), axis=(0, 1)))

    def save(self, path: Path | str, name: str = "elevation") -> None:
        """Write a layer of heights as an `.npz` that every command reads, with places in this map's metres.

        OutputError where it cannot be written, InvalidMapError without that layer.
        """
        side, frame = self.resolution, self.frame
        transform = 0.0, -side, frame.x, -side, 0.0, frame.y
        content = io.BytesIO()
        np.savez_compressed(content, elevation_m=self.layer(name), cell_size_m=side, transform=transform)
        write_whole(Path(path), content.getvalue())

    @classmethod
    def of_layers(cls, layers: dict[str, NDArray[np.float32]], frame: MapFrame, *, start: Cell = (0, 0)) -> "GridMap":
        """The grid map of layers (rows, columns) that lie in `frame`; the inverse of `layer`.

        `start` is the ring's start. Raises InvalidMapError where the frame's rows do not run against x, or the
        layers differ in shape.
        """
        if not frame.rows_along_x:
            raise InvalidMapError("a grid map's rows must run against x, got a frame whose rows run with y")
        shapes = {as_map(values, "a layer").shape for values in layers.values()}
        if len(shapes) != 1:
            raise InvalidMapError(f"a grid map's layers must have one shape, got {sorted(shapes) or 'none'}")
        rows, cols = shapes.pop()
        flat = {name: np.roll(as_map(each, "a layer"), start, (0, 1)).T.reshape(-1) for name, each in layers.items()}
        length_x, length_y = rows * frame.resolution, cols * frame.resolution
        middle = frame.x - 0.5 * length_x, frame.y - 0.5 * length_y
        return cls(frame.resolution, length_x, length_y, flat, *middle, *start, frame.frame_id)


@checked(InvalidMapError)
def occupancy_patch(
    grid: OccupancyGrid, frame: MapFrame, *, occupied: int = BODY_TOUCHES, keep_known: bool = True, stamp: float = 0.0
) -> MapPatch:
    """An occupancy grid as new costs for the map that lies in `frame`; see `placed`."""
    values, row, col = placed(grid.cost(occupied), grid.frame, frame)
    return MapPatch(row, col, cost=values, keep_known=keep_known, stamp=stamp)


@checked(InvalidMapError)
def grid_map_patch(
    grid: GridMap,
    frame: MapFrame,
    layer: str = "elevation",
    *,
    cost: bool = False,
    keep_known: bool = True,
    stamp: float = 0.0,
) -> MapPatch:
    """A grid map's layer as new heights, or new costs, for the map that lies in `frame`; see `placed`."""
    values, row, col = placed(grid.layer(layer), grid.frame, frame)
    elevation, costs = (None, values) if cost else (values, None)
    return MapPatch(row, col, elevation, costs, keep_known, stamp)


def placed(values: NDArray[np.float32], source: MapFrame, target: MapFrame) -> tuple[NDArray[np.float32], int, int]:
    """Cells (h, w) of one map, laid out as another wants them; also row and column of the first, to the nearest cell.

    Raises
    ------
    InvalidMapError
        The resolutions differ by over a thousandth: values would have to be mixed, which is for the sender to do.
        Or the maps lie in frames of two names.
    """
    if source.frame_id and target.frame_id and source.frame_id != target.frame_id:
        raise InvalidMapError(f"wanted a map in the frame {target.frame_id!r}, got one in {source.frame_id!r}")
    if abs(source.resolution - target.resolution) > _SAME * target.resolution:
        raise InvalidMapError(f"wanted cells of {target.resolution} m, got {source.resolution} m")
    cells = as_map(values, "a map")
    rows, cols = cells.shape
    if source.rows_along_x != target.rows_along_x:
        cells = cells[::-1, ::-1].T
        corner = source.metres(np.array([[float(rows), float(cols)]]))
    else:
        corner = source.metres(np.zeros((1, 2)))
    row, col = np.rint(target.places(corner)[0])
    return np.ascontiguousarray(cells), int(row), int(col)


def path_poses(path: NDArray[np.int32], frame: MapFrame) -> NDArray[np.float64]:
    """The poses (N, 3) of a path's cells (N, 2), as nav_msgs/Path wants them: x, y and heading.

    x and y are those of the cells' middles in metres; the heading is in radians, counted from x towards y: to the
    next cell, and at the end as it was before. Its quaternion has z = sin(heading / 2) and w = cos(heading / 2).
    """
    points = frame.metres(np.asarray(path, np.int64).reshape(-1, 2))
    heading = np.zeros(len(points))
    if len(points) > 1:
        steps = np.diff(points, axis=0)
        heading[:-1] = np.arctan2(steps[:, 1], steps[:, 0])
        heading[-1] = heading[-2]
    return np.column_stack([points, heading])


def _array(values: ArrayLike) -> NDArray[np.float32]:
    """An array of any type; InvalidMapError for lists of different lengths."""
    try:
        found: NDArray[np.float32] = np.asarray(values)
        return found
    except ValueError:
        raise InvalidMapError(f"wanted numbers, got {shown(values)}") from None


def _pairs(values: ArrayLike) -> NDArray[np.float32]:
    """(N, 2) numbers."""
    pairs = _array(values)
    if pairs.dtype.kind not in "iuf" or pairs.size % 2:
        raise InvalidQueryError(f"wanted pairs (N, 2) of numbers, got {shown(values)}")
    return pairs.reshape(-1, 2)


def _field(message: object, path: str) -> Any:
    """The value at a path of names in a message, or in nested dicts."""
    found: Any = message
    for name in path.split("."):
        try:
            found = found[name] if isinstance(found, Mapping) else getattr(found, name)
        except (KeyError, AttributeError):
            kind = type(message).__name__
            raise InvalidMapError(f"wanted a message with {path}, got a {kind} without {name}") from None
    return found


def _items(message: object, path: str) -> list[object]:
    """A sequence in a message."""
    found = _field(message, path)
    if isinstance(found, str | bytes | Mapping) or not isinstance(found, Iterable):
        raise InvalidMapError(f"{path} must be a sequence, got {shown(found)}")
    return list(found)


def _corner(message: object, path: str) -> tuple[float, float]:
    """x and y of a map's pose; InvalidMapError where the map is turned."""
    turned = [_field(message, f"{path}.orientation.{axis}") for axis in "xyzw"]
    if not all(is_real(part) and abs(part) <= most for part, most in zip(turned, _LEVEL, strict=True)):
        raise InvalidMapError(f"wanted a map that is not turned, got one with the orientation x, y, z, w {turned}")
    return _field(message, f"{path}.position.x"), _field(message, f"{path}.position.y")
