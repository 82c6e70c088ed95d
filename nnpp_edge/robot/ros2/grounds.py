"""The map that the loop begins with, and where its cells lie: rows along y, columns along x."""

import math
from pathlib import Path

import numpy as np

from nnpp_edge.robot.ros2.parameters import Own
from nnpp_edge.ros.maps import MapFrame, OccupancyGrid
from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.errors import InvalidMapError, InvalidQueryError
from nnpp_edge.runtime.map.ground import Ground
from nnpp_edge.runtime.memory import check_planner_fits
from nnpp_edge.runtime.terrain.vehicle import Vehicle
from nnpp_edge.terrain.dem import Dem, read_dem
from nnpp_edge.terrain.vehicle_files import read_vehicle, vehicle_of
from nnpp_edge.terrain.workloads import workload

Located = tuple[Ground, MapFrame]
_MOST_CELLS = 200
"""Along a vehicle: the time to find where it can stand grows with their square."""


def first_ground(own: Own) -> Located | None:
    """The ground that the loop begins with; None where the topic of maps is to say.

    InvalidQueryError, TerrainError, VehicleError or InvalidMapError in one line where the
    parameters make none.
    """
    if own.by_topic:
        vehicle = _vehicle(own)
        if vehicle is not None and vehicle.as_body:
            raise InvalidQueryError(
                "vehicle: a body needs elevations: wanted map_file or map_size_m"
            )
        return None
    if own.map_file:
        heights, frame = _laid_out(read_dem(own.map_file), own.global_frame)
    else:
        cells = max(round(own.map_size_m / own.resolution), 1)
        check_planner_fits((cells, cells))
        corner = -0.5 * cells * own.resolution
        frame = MapFrame(own.resolution, corner, corner, frame_id=own.global_frame)
        heights = np.full((cells, cells), np.nan, np.float32)
    vehicle = _vehicle(own, frame.resolution)
    limits = workload(own.workload) if own.workload else None
    return Ground.of_elevation(heights, frame.resolution, limits, vehicle=vehicle), frame


def ground_of(own: Own, grid: OccupancyGrid) -> Ground:
    """The ground that a map of costs tells; errors as of `first_ground`."""
    side = grid.frame.resolution
    return Ground(grid.cost(), cell_size_m=side, vehicle=_vehicle(own, side))


def _vehicle(own: Own, cell_size_m: float = math.inf) -> Vehicle | None:
    """The body or disc that the parameters name; None for a point. InvalidMapError for one of more
    cells than can be checked in a moment.
    """
    if own.vehicle:
        vehicle = vehicle_of(read_vehicle(own.vehicle), Path(own.vehicle).name)
    elif own.radius_m:
        vehicle = Vehicle(radius_m=own.radius_m)
    else:
        return None
    longest = max(2.0 * (vehicle.radius_m or 0.0), vehicle.length_m, vehicle.width_m)
    if longest > _MOST_CELLS * cell_size_m:
        raise InvalidMapError(
            f"wanted cells of at least {longest / _MOST_CELLS:g} m for a vehicle of {longest:g} m, "
            f"got {cell_size_m:g} m"
        )
    return vehicle


def _laid_out(dem: Dem, frame_id: str) -> tuple[Float2D, MapFrame]:
    """The heights with rows along y and columns along x, and their frame; a map that does not say
    where it lies begins at (0, 0).
    """
    heights = dem.elevation
    side = dem.cell_size_m
    if dem.georeference is None:
        return heights, MapFrame(side, frame_id=frame_id)
    a, b, x, d, e, y = dem.georeference.transform
    if not (a or e):  # rows along x, as `GridMap.save` writes them
        heights = heights.T
        a = b
        e = d
        b = d = 0.0
    if b or d or abs(a) != abs(e):
        raise InvalidQueryError("map_file: wanted square cells along the axes, got others")
    rows, cols = heights.shape
    heights = heights[:: 1 if e > 0.0 else -1, :: 1 if a > 0.0 else -1]
    corner = (x + min(a, 0.0) * cols, y + min(e, 0.0) * rows)
    return np.ascontiguousarray(heights), MapFrame(side, *corner, frame_id=frame_id)
