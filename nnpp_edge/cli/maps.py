"""A map as commands meet it: its size in words, its costs, and whether it fits into memory."""

import warnings
from pathlib import Path

from nnpp_edge.cli.options import TerrainOptions
from nnpp_edge.cli.vehicle_options import VehicleOptions
from nnpp_edge.runtime import Ground
from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.memory import available_bytes
from nnpp_edge.runtime.terrain.traversability import Traversability, traversability_cost
from nnpp_edge.terrain import dem_windows
from nnpp_edge.terrain.dem import Dem
from nnpp_edge.terrain.georeference import Place

_MOST_UNEQUAL_SIDES = 0.02
"""Cells whose sides differ by more than this share are warned of."""


def size_of(place: Place) -> dict[str, object]:
    """Rows, columns and the sides of a cell, ready for JSON."""
    rows, cols = place.shape
    return {"rows": rows, "cols": cols, "cell_size_m": place.cell_size_m, "cell_width_m": place.cell_width_m}


def size_in_words(place: Place) -> str:
    """Rows, columns and the sides of a cell."""
    (rows, cols), size, width = place.shape, place.cell_size_m, place.cell_width_m
    square = abs(size - width) <= 5e-4 * size
    cell = f"{size:.4g} m" if square else f"{size:.4g} m (north) × {width:.4g} m (east)"
    return f"{rows} × {cols} cells of {cell}"


def warn_if_not_square(place: Place) -> None:
    """Warn of cells whose sides differ."""
    size, width = place.cell_size_m, place.cell_width_m
    if abs(size - width) > _MOST_UNEQUAL_SIDES * size:
        warnings.warn(
            f"cells are {size:.4g} m from north to south and {width:.4g} m from east to west. Slopes and the path's "
            "length in metres allow for it; the search takes cells as square",
            stacklevel=2,
        )


def cost_of(dem: Dem, limits: Traversability) -> Float2D:
    """The cost map of an elevation map."""
    return traversability_cost(dem.elevation, dem.cell_size_m, limits, cell_width_m=dem.cell_width_m)


def ground_of(dem: Dem, limits: Traversability, vehicle: VehicleOptions, step_cost: str) -> Ground:
    """An elevation map, and who drives on it at what cost."""
    return Ground.of_elevation(
        dem.elevation,
        dem.cell_size_m,
        limits,
        cell_width_m=dem.cell_width_m,
        vehicle=vehicle.make(),
        step_cost=step_cost,
        mobility=vehicle.mobility(dem),
    )


def priced(ground: Ground, cost: Float2D) -> Ground:
    """The ground to plan on: the costs that are known already, where nothing but these is asked."""
    return ground if ground.vehicle or ground.step_cost != "paper" else Ground(cost)


def reads_by_windows(
    dem: Path, terrain: TerrainOptions, memory: float | None, bytes_per_cell: int, *, whole: bool = False
) -> bool:
    """Whether a map needs more memory than is free, or than was given; then a warning says so.

    InvalidQueryError if it does and the `whole` map is needed, as for a vehicle and for directed step costs.
    """
    if (size := dem_windows.size_of(dem, allow_vrt=terrain.allow_vrt)) is None:
        return False
    wanted, room = size[0] * size[1] * bytes_per_cell, available_bytes() if memory is None else memory
    if wanted <= room:
        return False
    left = "are free" if memory is None else "are allowed"
    need = f"{size[0]} × {size[1]} cells need {_bytes(wanted)} in memory, {_bytes(room)} {left}"
    if whole:
        raise InvalidQueryError(
            f"{need}: a vehicle or a directed step cost is planned for in memory alone, so cut out a part of the map"
        )
    warnings.warn(f"{need}: read by windows", stacklevel=2)
    return True


def _bytes(count: float) -> str:
    return f"{count / 1e9:.1f} GB" if count >= 1e9 else f"{count / 1e6:.1f} MB"
