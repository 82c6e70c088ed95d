"""The map that the loop begins with, and where its cells lie."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from nnpp_edge.robot.ros2.parameters import ParameterError, Parameters
from nnpp_edge.ros.maps import MapFrame, OccupancyGrid
from nnpp_edge.runtime.map.ground import Ground
from nnpp_edge.runtime.terrain.vehicle import Vehicle
from nnpp_edge.terrain.array_files import read_cost_map
from nnpp_edge.terrain.dem import Dem, read_dem
from nnpp_edge.terrain.vehicle_files import read_vehicle, vehicle_of
from nnpp_edge.terrain.workloads import SAFE, SOFT, workload

if TYPE_CHECKING:
    from nnpp_edge.runtime.arrays import Float2D

Located = tuple[Ground, MapFrame]


def vehicle_by(parameters: Parameters) -> Vehicle | None:
    """The body or disc that the parameters name; None for a point. VehicleError as of its file."""
    if parameters.vehicle:
        values = read_vehicle(parameters.vehicle)
        return vehicle_of(values, Path(parameters.vehicle).name)
    if parameters.radius_m:
        return Vehicle(radius_m=parameters.radius_m)
    return None


def first_ground(parameters: Parameters) -> Located | None:
    """The ground that the loop begins with; None where the topic of maps is to say.

    ParameterError, TerrainError, VehicleError or InvalidMapError in one line where the parameters
    make none.
    """
    if parameters.map_file:
        return _read(parameters)
    if not parameters.map_size_m:
        if parameters.vehicle and not _is_disc(parameters):
            raise ParameterError(
                "vehicle: a body needs elevations: wanted map_file or map_size_m, got neither"
            )
        return None
    side = parameters.resolution
    cells = max(round(parameters.map_size_m / side), 1)
    corner = (parameters.center_x - 0.5 * cells * side, parameters.center_y - 0.5 * cells * side)
    frame = MapFrame(side, *corner, frame_id=parameters.global_frame)
    unknown = np.full((cells, cells), np.nan, np.float32)
    return _of_heights(unknown, frame, parameters), frame


def ground_of_grid(grid: OccupancyGrid, parameters: Parameters) -> Located:
    """The ground that an occupancy grid tells."""
    frame = grid.frame
    vehicle = vehicle_by(parameters)
    return Ground(grid.cost(), cell_size_m=frame.resolution, vehicle=vehicle), frame


def _is_disc(parameters: Parameters) -> bool:
    vehicle = vehicle_by(parameters)
    return vehicle is None or vehicle.is_disc


def _read(parameters: Parameters) -> Located:
    """Of a file: where it says where it lies there, else with its first cell at (0, 0)."""
    path = Path(parameters.map_file)
    found = read_cost_map(path)
    if found is not None:
        cost, side = found
        frame = MapFrame(side, frame_id=parameters.global_frame)
        return Ground(cost, cell_size_m=side, vehicle=vehicle_by(parameters)), frame
    dem = read_dem(path)
    if dem.cell_width_m != dem.cell_size_m:
        sides = f"{dem.cell_size_m:g} × {dem.cell_width_m:g} m"
        raise ParameterError(f"map_file: wanted a map of square cells, got cells of {sides}")
    heights, frame = _laid_out(dem, parameters.global_frame)
    return _of_heights(heights, frame, parameters), frame


def _of_heights(heights: "Float2D", frame: MapFrame, parameters: Parameters) -> Ground:
    vehicle = vehicle_by(parameters)
    default = SAFE if _is_disc(parameters) else SOFT
    limits = workload(parameters.workload or default)
    return Ground.of_elevation(heights, frame.resolution, limits, vehicle=vehicle)


def _laid_out(dem: Dem, frame_id: str) -> "tuple[Float2D, MapFrame]":
    """The heights, and their frame: a map whose rows run against y is turned over."""
    side = dem.cell_size_m
    if dem.georeference is None:
        return dem.elevation, MapFrame(side, frame_id=frame_id)
    a, b, x, d, e, y = dem.georeference.transform
    if b < 0.0 and d < 0.0 and a == e == 0.0:  # as `GridMap.save` writes it
        return dem.elevation, MapFrame(side, x, y, True, frame_id)
    if a <= 0.0 or b or d or not e:
        raise ParameterError(
            f"map_file: wanted a map that is not turned, got the transform {(a, b, x, d, e, y)}"
        )
    if e > 0.0:
        return dem.elevation, MapFrame(side, x, y, frame_id=frame_id)
    rows = dem.shape[0]
    return dem.elevation[::-1], MapFrame(side, x, y + e * rows, frame_id=frame_id)
