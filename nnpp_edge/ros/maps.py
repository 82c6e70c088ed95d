"""Maps and paths as ROS messages lay them out, in NumPy alone; no ROS is needed.

Two layouts occur. An occupancy grid (nav_msgs/OccupancyGrid) holds whole numbers row by row from
the corner at its origin: rows run with y, columns with x. A grid map (grid_map_msgs/GridMap) holds
layers of floats column by column from the corner farthest along x and y: rows run against x,
columns against y, and both begin somewhere in a ring.

==========================  ==========  ====================
cost                        occupancy   read back as
==========================  ==========  ====================
NaN: unknown                -1          NaN
passable, at least 0, < 1   0 to 98     occupancy / 100
impassable: 1 or more, inf  100         inf
==========================  ==========  ====================

A passable cost is rounded to a hundredth, and to 0.98 at most: 99 is what costmaps write for cells
that the robot's body would touch, and is read as impassable.
"""

import io
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, TypeVar

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray

from nnpp_edge.files import write_whole
from nnpp_edge.runtime.arguments import checked
from nnpp_edge.runtime.arrays import Cells, Float2D, Floats, as_map, headings_along
from nnpp_edge.runtime.cells import Cell, Shape
from nnpp_edge.runtime.errors import InvalidMapError, InvalidQueryError, shown
from nnpp_edge.runtime.loop.messages import MapPatch, PathMessage
from nnpp_edge.runtime.planners.plan import Plan

__all__ = [
    "GridMap",
    "MapFrame",
    "OccupancyGrid",
    "arc_poses",
    "as_occupancy",
    "cloud_patch",
    "grid_map_patch",
    "occupancy_patch",
    "path_poses",
    "placed",
]

UNKNOWN = -1
MOST_PASSABLE = 98
BODY_TOUCHES = 99
IMPASSABLE = 100
"""Occupancies."""
_POINTS = {7: "f4", 8: "f8"}
"""By PointField's FLOAT32 and FLOAT64."""
_FARTHEST = 1e12
"""Cells from a frame's origin at which places within a cell still differ in 64 bits."""
_SAME = 1e-3
"""Share of a cell's side by which two maps' cells may differ."""
_LEVEL = 1e-3
"""Length of a quaternion's x, y and z up to which a map counts as not turned."""
T = TypeVar("T")
_Whole = Annotated[int, msgspec.Meta(ge=0, lt=2**32)]
_Data = Any
"""Checked where it becomes an array."""


class _Header(msgspec.Struct):
    frame_id: str


class _Position(msgspec.Struct):
    x: float
    y: float


class _Orientation(_Position):
    z: float
    w: float


class _Pose(msgspec.Struct):
    position: _Position
    orientation: _Orientation

    def corner(self) -> tuple[float, float]:
        """x and y; InvalidMapError where the map is turned."""
        turned = msgspec.structs.astuple(self.orientation)
        if not math.hypot(*turned[:3]) <= _LEVEL:
            raise InvalidMapError(
                f"wanted a map that is not turned, got one with the orientation x, y, z, w {turned}"
            )
        return self.position.x, self.position.y


class _GridInfo(msgspec.Struct):
    resolution: float
    width: _Whole
    height: _Whole
    origin: _Pose


class _Grid(msgspec.Struct):
    """What is read of a nav_msgs/OccupancyGrid."""

    header: _Header
    info: _GridInfo
    data: _Data


class _Dimension(msgspec.Struct):
    label: str
    size: _Whole


class _Layout(msgspec.Struct):
    dim: list[_Dimension]


class _Layer(msgspec.Struct):
    layout: _Layout
    data: _Data


class _LayersInfo(msgspec.Struct):
    resolution: float
    length_x: float
    length_y: float
    pose: _Pose


class _Layers(msgspec.Struct):
    """What is read of a grid_map_msgs/GridMap."""

    header: _Header
    info: _LayersInfo
    layers: list[str]
    data: list[_Layer]
    outer_start_index: _Whole
    inner_start_index: _Whole


class _PointField(msgspec.Struct):
    name: str
    offset: _Whole
    datatype: _Whole


class _Cloud(msgspec.Struct):
    """What is read of a sensor_msgs/PointCloud2."""

    header: _Header
    height: _Whole
    width: _Whole
    fields: list[_PointField]
    is_bigendian: _Data
    point_step: _Whole
    row_step: _Whole
    data: _Data


def _read(message: object, kind: type[T]) -> T:
    """A ROS message, or nested dicts, as one of these records; InvalidMapError for another."""
    try:
        return msgspec.convert(message, kind, from_attributes=True)
    except (msgspec.ValidationError, IndexError) as error:  # of a bare array
        raise InvalidMapError(f"wanted another message of ROS: {error}") from None


def as_occupancy(cost: NDArray[np.floating]) -> NDArray[np.int8]:
    """The occupancies of costs of any shape, by the rule of this module."""
    passable = np.minimum(np.rint(100.0 * cost), MOST_PASSABLE)
    known = np.where(cost >= 1.0, float(IMPASSABLE), passable)
    return np.where(np.isnan(cost), float(UNKNOWN), known).astype(np.int8)


@checked(InvalidMapError)
@dataclass(frozen=True)
class MapFrame:
    """Where the cells of a map lie in metres. Rows run along one axis, columns along the other,
    forth or back.

    InvalidMapError where the resolution is not above 0, or the corner not within 1e12 cells of the
    frame's origin.
    """

    resolution: float
    """Side of a cell, metres."""
    x: float = 0.0
    """Of the corner of cell (0, 0) where the map begins, metres."""
    y: float = 0.0
    rows_along_x: bool = False
    """Rows run against x and columns against y, as in a grid map; else rows with y and columns with
    x.
    """
    frame_id: str = ""
    """Name of the frame that x and y count in; empty where it is not told."""

    def __post_init__(self) -> None:
        if not (math.isfinite(self.resolution) and self.resolution > 0.0):
            raise InvalidMapError(f"resolution must be metres above 0, got {self.resolution}")
        farthest = _FARTHEST * self.resolution
        if not (abs(self.x) <= farthest and abs(self.y) <= farthest):
            raise InvalidMapError(
                f"the map's corner must be finite, within {farthest:g} m, got ({self.x}, {self.y})"
            )

    def metres(self, cells: ArrayLike) -> Floats:
        """Points (x, y) in metres, (N, 2), of cells or places (row, col).

        Whole numbers are cells and give their middle; floats are places, as in a `Pose`, and 0.0 is
        the edge.
        """
        places = _pairs(cells)
        if places.dtype.kind in "iu":
            places = places + 0.5
        span = self.resolution * places
        away = -span if self.rows_along_x else span[:, ::-1]
        return np.asarray(np.add(away, (self.x, self.y)))

    def places(self, points: ArrayLike) -> Floats:
        """Places (row, col) of points (x, y) in metres, (N, 2); their floor is the cell, as in a
        `Pose`.
        """
        away = _pairs(points).astype(np.float64) - (self.x, self.y)
        span = -away if self.rows_along_x else away[:, ::-1]
        with np.errstate(over="ignore"):
            places = np.asarray(span / self.resolution)
        if not np.isfinite(places).all():
            raise InvalidQueryError("points must be finite metres (x, y), and so their cells")
        return places

    def cell(self, x: float, y: float) -> Cell:
        """The cell that holds a point; it may lie outside the map."""
        row, col = np.floor(self.places((x, y))[0])
        return int(row), int(col)

    def heading_deg(self, yaw_rad: float) -> float:
        """The heading on the map, in degrees clockwise from up the rows from 0 to 360, of a yaw
        counted from x towards y, as in ROS.
        """
        yaw_deg = math.degrees(yaw_rad)
        return (-yaw_deg if self.rows_along_x else yaw_deg + 90.0) % 360.0

    def yaw_rad(self, heading_deg: ArrayLike) -> Floats:
        """The yaw from -π to π of a heading on the map, or of (N,) headings, see `heading_deg`."""
        headings = np.asarray(heading_deg, np.float64)
        turned = np.radians(-headings if self.rows_along_x else headings - 90.0)
        return np.arctan2(np.sin(turned), np.cos(turned))


@checked(InvalidMapError)
@dataclass(frozen=True, eq=False)
class OccupancyGrid:
    """Content of a nav_msgs/OccupancyGrid, without its stamp.

    InvalidMapError unless the data are whole numbers from -1 to 100, and the frame's rows run with
    y.
    """

    data: NDArray[np.int8] = field(repr=False)
    """(height, width) int8: -1 unknown, 0 free to 100 occupied."""
    frame: MapFrame

    @classmethod
    def of_message(cls, message: object) -> "OccupancyGrid":
        """Read a message as rclpy, rosbags or mcap-ros2-support hand it out, or nested dicts.

        Raises InvalidMapError for another message, or a turned grid.
        """
        found = _read(message, _Grid)
        info = found.info
        values = _array(found.data)
        if values.size != info.width * info.height:
            raise InvalidMapError(
                f"wanted {info.height} × {info.width} whole numbers as data, got {values.shape}"
            )
        frame = MapFrame(info.resolution, *info.origin.corner(), frame_id=found.header.frame_id)
        return cls(values.reshape(info.height, info.width), frame)  # type: ignore[arg-type]  # checked there

    def __post_init__(self) -> None:
        values = _array(self.data)
        if values.ndim != 2 or not values.size or values.dtype.kind not in "iu":
            wanted = "a map (height, width) of whole numbers"
            raise InvalidMapError(
                f"an occupancy grid's data must be {wanted}, got {values.shape} {values.dtype}"
            )
        span = [int(values.min()), int(values.max())]
        if span[0] < UNKNOWN or span[1] > IMPASSABLE:
            raise InvalidMapError(f"an occupancy grid's data must lie in [-1, 100], got {span}")
        if self.frame.rows_along_x:
            raise InvalidMapError(
                "an occupancy grid's rows must run with y, got a frame whose rows run against x"
            )
        object.__setattr__(self, "data", values.astype(np.int8))

    def cost(self) -> Float2D:
        """Its cells as costs, (height, width), by the rule of this module."""
        values = self.data.astype(np.float32)
        costs = values / np.float32(100.0)
        costs[values >= BODY_TOUCHES] = np.inf
        costs[values < 0] = np.nan
        return costs


@checked(InvalidMapError)
@dataclass(frozen=True, eq=False)
class GridMap:
    """Content of a grid_map_msgs/GridMap, without its stamp, unrolled.

    InvalidMapError unless there is a layer, all are maps of one shape, and the frame's rows run
    against x.
    """

    layers: dict[str, Float2D] = field(repr=False)
    """Each (rows, columns) float32, rows against x and columns against y; NaN where unknown."""
    frame: MapFrame

    @classmethod
    def of_message(cls, message: object) -> "GridMap":
        """Read a message as rclpy, rosbags or mcap-ros2-support hand it out, or nested dicts.

        Raises InvalidMapError for another message, a turned map, lengths that are no multiples of
        the resolution, or a layer of another layout.
        """
        found = _read(message, _Layers)
        names = found.layers
        if not len(set(names)) == len(names) == len(found.data):
            raise InvalidMapError(
                f"wanted a name for each of {len(found.data)} layers, got {shown(names)}"
            )

        # the frame begins at the corner farthest along x and y
        info = found.info
        side = info.resolution
        lengths = (info.length_x, info.length_y)
        x, y = info.pose.corner()
        corner = (x + 0.5 * lengths[0], y + 0.5 * lengths[1])
        frame = MapFrame(side, *corner, True, found.header.frame_id)

        rows, cols = (_cells(length, side) for length in lengths)
        if not (rows and cols):
            raise InvalidMapError(
                f"a grid map's lengths must be multiples of {side} m above 0, got {lengths}"
            )
        row = found.outer_start_index
        col = found.inner_start_index
        if not (row < rows and col < cols):
            raise InvalidMapError(
                f"a grid map's start must lie within {rows} × {cols} cells, got {(row, col)}"
            )
        layers = {}
        for name, layer in zip(names, found.data, strict=True):
            ring = _ring(layer, f"layer {name!r}", (rows, cols))
            layers[name] = np.roll(ring, (-row, -col), axis=(0, 1))
        return cls(layers, frame)

    def __post_init__(self) -> None:
        layers = {name: as_map(values, f"layer {name!r}") for name, values in self.layers.items()}
        shapes = {values.shape for values in layers.values()}
        if len(shapes) != 1:
            raise InvalidMapError(
                f"a grid map's layers must have one shape, got {sorted(shapes) or 'none'}"
            )
        if not self.frame.rows_along_x:
            raise InvalidMapError(
                "a grid map's rows must run against x, got a frame whose rows run with y"
            )
        object.__setattr__(self, "layers", layers)

    def layer(self, name: str = "elevation") -> Float2D:
        """A layer (rows, columns); InvalidMapError where there is none of that name."""
        if name not in self.layers:
            raise InvalidMapError(
                f"wanted layer {name!r}, the grid map has {', '.join(self.layers)}"
            )
        return self.layers[name]

    def save(self, path: Path | str, name: str = "elevation") -> None:
        """Write a layer of heights as an `.npz` that every command reads, with places in this map's
        metres.

        OutputError where it cannot be written, InvalidMapError without that layer.
        """
        side = self.frame.resolution
        transform = (0.0, -side, self.frame.x, -side, 0.0, self.frame.y)
        content = io.BytesIO()
        np.savez_compressed(
            content,
            elevation_m=self.layer(name),
            cell_size_m=side,
            transform=transform,
        )
        write_whole(Path(path), content.getvalue())


@checked(InvalidMapError)
def occupancy_patch(grid: OccupancyGrid, frame: MapFrame, *, keep_known: bool = True) -> MapPatch:
    """Make an occupancy grid new costs for the map that lies in `frame`; see `placed`."""
    values, row, col = placed(grid.cost(), grid.frame, frame)
    return MapPatch(row, col, cost=values, keep_known=keep_known)


@checked(InvalidMapError)
def grid_map_patch(
    grid: GridMap,
    frame: MapFrame,
    layer: str = "elevation",
) -> MapPatch:
    """Make a grid map's layer new heights for the map that lies in `frame`; see `placed`. Unknown
    cells stay as the map has them.
    """
    values, row, col = placed(grid.layer(layer), grid.frame, frame)
    return MapPatch(row, col, values, keep_known=True)


@checked(InvalidMapError)
def cloud_patch(message: object, frame: MapFrame, shape: Shape) -> MapPatch:
    """Make the points of a sensor_msgs/PointCloud2, a message as of `OccupancyGrid.of_message`, new
    heights for the map (H, W) that lies in `frame`.

    The highest point of a cell counts, cells without one stay as they are, and points off the map
    are left out. InvalidMapError for another message, fields x, y and z that are no floats, a frame
    of another name, or where no point lies on the map.
    """
    cloud = _read(message, _Cloud)
    _check_frame(cloud.header.frame_id, frame)
    x_y_z = _points(cloud)
    cells = np.floor(frame.places(x_y_z[:2].T)).T
    inside = ((cells >= 0) & (cells < np.reshape(shape, (2, 1)))).all(axis=0)
    if not inside.any():
        raise InvalidMapError(f"wanted points on a map of {shape} cells, got none there")
    cells = cells[:, inside].astype(np.int64)
    first = cells.min(axis=1)
    rows, cols = cells - first[:, None]
    heights = np.full((rows.max() + 1, cols.max() + 1), -np.inf, np.float32)  # inf: unseen
    nodes = rows * heights.shape[1] + cols
    np.maximum.at(heights.reshape(-1), nodes, x_y_z[2, inside].astype(np.float32))
    row, col = first.tolist()
    return MapPatch(row, col, heights, keep_known=True)


def placed(values: Float2D, source: MapFrame, target: MapFrame) -> tuple[Float2D, int, int]:
    """Lay out the cells (h, w) of one map as another wants them; also row and column of the first,
    to the nearest cell.

    InvalidMapError where the resolutions differ by over a thousandth, as values would have to be
    mixed, which is for the sender to do; or where the maps lie in frames of two names.
    """
    _check_frame(source.frame_id, target)
    if abs(source.resolution - target.resolution) > _SAME * target.resolution:
        raise InvalidMapError(f"wanted cells of {target.resolution} m, got {source.resolution} m")
    cells = as_map(values, "a map")
    first = np.zeros(2)
    if source.rows_along_x != target.rows_along_x:
        first += cells.shape
        cells = cells[::-1, ::-1].T
    row, col = np.rint(target.places(source.metres(first))[0])
    return np.ascontiguousarray(cells), int(row), int(col)


def _check_frame(frame_id: str, target: MapFrame) -> None:
    """InvalidMapError where both frames have names, and not the same."""
    if frame_id and target.frame_id and frame_id != target.frame_id:
        raise InvalidMapError(
            f"wanted a map in the frame {target.frame_id!r}, got one in {frame_id!r}"
        )


def path_poses(path: Cells | Floats, frame: MapFrame) -> Floats:
    """The poses (N, 3) of a path's cells or way points (N, 2), as nav_msgs/Path wants them: x, y
    and heading.

    x and y are those of cells' middles or of places (see `MapFrame.metres`), in metres; the heading
    is in radians, counted from x towards y: to the next one, and at the end as it was before. Its
    quaternion has z = sin(heading / 2) and w = cos(heading / 2).
    """
    yaws = np.zeros(len(path))
    if len(path) > 1:
        yaws = frame.yaw_rad(headings_along(path))
    return np.column_stack([frame.metres(path), yaws])


def arc_poses(answer: PathMessage | Plan, frame: MapFrame) -> Floats:
    """The poses (N, 4) of an answer on its way: x, y and yaw as of `path_poses`, and the gear: 1
    forwards, -1 backwards, 0 where it turns on the spot.

    Of a body that drives arcs every 0.25 m or nearer, and every 15° of a turn on the spot; of
    others the way points where its path was freed from the grid, else the middles of its cells. The
    last pose has the gear in which it is come to. Empty (0, 4) without a path.
    """
    if not answer.arcs:
        line = answer.path if answer.waypoints is None else answer.waypoints + 0.5
        poses = path_poses(line, frame)
        return np.column_stack([poses, np.ones(len(poses))])
    first = answer.arcs[0]
    found = [(*first.start_pose, first.gear)]
    for arc in answer.arcs:
        found += [(*pose, arc.gear) for pose in arc.poses]
    across, down, headings, gears = np.array(found).T
    # metres from the middle of cell (0, 0)
    places = np.column_stack((down, across)) / frame.resolution + 0.5
    return np.column_stack([frame.metres(places), frame.yaw_rad(headings), gears])


def _cells(length: float, side: float) -> int:
    """How many cells a map is long; 0 where that is no whole number above 0."""
    cells = length / side
    if abs(cells - round(cells)) > _SAME * cells:
        return 0
    return round(cells)


def _ring(layer: _Layer, name: str, shape: Shape) -> Float2D:
    """The cells of a layer as they lie in their ring; InvalidMapError for another layout."""
    rows, cols = shape
    values = _array(layer.data)
    layout = [f"{dim.label} {dim.size}" for dim in layer.layout.dim]
    by_column = [f"column_index {cols}", f"row_index {rows}"]
    if layout not in (by_column, by_column[::-1]):
        wanted = " and ".join(by_column)
        raise InvalidMapError(f"{name} must be laid out by {wanted}, got {shown(layout)}")
    if values.shape != (rows * cols,) or values.dtype.kind not in "iuf":
        got = f"{values.shape} {values.dtype}"
        raise InvalidMapError(f"{name} must be {rows} × {cols} numbers, got {got}")
    with np.errstate(over="ignore"):  # heights beyond float32 become infinite, which is unknown
        flat = values.astype(np.float32)
    return flat.reshape(cols, rows).T if layout == by_column else flat.reshape(rows, cols)


def _points(cloud: _Cloud) -> Floats:
    """(3, N) x, y and z of a cloud's points, of those where all are finite."""
    shape = (cloud.height, cloud.width)
    step = cloud.point_step
    fields = {each.name: each for each in cloud.fields}
    try:
        if cloud.row_step < cloud.width * step:
            raise ValueError("rows that overlap")
        point = np.dtype(
            {
                "names": list("xyz"),
                "formats": [_POINTS[fields[axis].datatype] for axis in "xyz"],
                "offsets": [fields[axis].offset for axis in "xyz"],
                "itemsize": step,
            }
        ).newbyteorder(">" if cloud.is_bigendian else "<")
        strides = (cloud.row_step, step)
        points = np.ndarray(shape, point, memoryview(cloud.data), strides=strides)
    except (KeyError, TypeError, ValueError, OverflowError):
        raise InvalidMapError(
            f"wanted {cloud.height} × {cloud.width} points of {step} bytes with x, y and z as "
            f"FLOAT32 or FLOAT64, got others, with {shown(list(fields))}"
        ) from None
    x_y_z = np.array([points[axis].ravel() for axis in "xyz"], np.float64)
    return x_y_z[:, np.isfinite(x_y_z).all(axis=0)]


def _array(values: ArrayLike) -> Float2D:
    """An array of any type; InvalidMapError for lists of different lengths."""
    try:
        return np.asarray(values)
    except ValueError:
        raise InvalidMapError(f"wanted numbers, got {shown(values)}") from None


def _pairs(values: ArrayLike) -> Float2D:
    """(N, 2) numbers, of any type."""
    pairs = _array(values)
    if pairs.dtype.kind not in "iuf" or pairs.size % 2:
        raise InvalidQueryError(f"wanted pairs (N, 2) of numbers, got {shown(values)}")
    return pairs.reshape(-1, 2)
