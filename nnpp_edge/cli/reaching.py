"""The search of `nnpp-edge reach`, and its answer for people, for programs, and as files."""

import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from nnpp_edge.cli.maps import cost_of, ground_of, priced, size_in_words, size_of
from nnpp_edge.cli.options import TerrainOptions, shade_of
from nnpp_edge.cli.plan_answer import duration
from nnpp_edge.cli.refusal import Near, refuse
from nnpp_edge.cli.requests import ReachRequest
from nnpp_edge.cli.vehicle_options import VehicleOptions
from nnpp_edge.files import write_all
from nnpp_edge.runtime import Planner
from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Cell
from nnpp_edge.runtime.map.slope_cost import Mobility, unit_of
from nnpp_edge.runtime.planners.query import problem_with
from nnpp_edge.terrain.dem import raster_bytes
from nnpp_edge.terrain.reach import Reach
from nnpp_edge.viz.picture import png_bytes
from nnpp_edge.viz.reach_picture import reach_picture


def reach(request: ReachRequest, path: Path, terrain: TerrainOptions, vehicle: VehicleOptions) -> "Reached":
    """Search from the start until all is known that lies within."""
    dem, limits = terrain.read(path), terrain.limits()
    cost, start = cost_of(dem, limits), request.start.one_cell(dem, "--start")
    ground = ground_of(dem, limits, vehicle, "paper")
    step_cost = _step_cost(request, ground.mobility)
    ground = replace(ground, step_cost=step_cost)
    planner = Planner(priced(ground, cost), omega=request.omega, corner_cutting=request.corner_cutting)
    if problem := problem_with(planner.state.grid, start, start):
        refuse(problem, start, start, Near(dem, dem.elevation, cost, limits, ground.vehicle))
    measure, most = request.most
    shares = tuple((most * np.arange(1, request.levels + 1) / request.levels).tolist())
    return Reached(start, Reach(planner.reach(start, most), shares, measure, unit_of(step_cost), dem), cost)


def _step_cost(request: ReachRequest, mobility: Mobility | None) -> str:
    """The step cost that counts what is asked."""
    if request.within_time is not None and unit_of(request.step_cost) != "s":
        return "time" if mobility and mobility.time else "tobler"
    return request.step_cost if request.within_energy is None else "energy"


@dataclass(frozen=True)
class Reached:
    """Cells that can be reached from one on a cost map."""

    start: Cell
    found: Reach
    cost: Float2D

    @property
    def _areas(self) -> list[tuple[float, int, float]]:
        """Levels, with their cells and square metres."""
        return list(zip(self.found.levels, self.found.cells, self.found.areas_m2, strict=True))

    def figures(self, files: list[str]) -> dict[str, object]:
        """Ready for JSON."""
        areas = [{"within": level, "cells": n, "area_m2": round(area, 3)} for level, n, area in self._areas]
        figures = {"start": self.start, "measure": self.found.measure, "unit": self.found.unit, "areas": areas}
        return {**figures, **size_of(self.found.dem), **({"files": files} if files else {})}

    def text(self, files: list[str]) -> str:
        """For people."""
        lines = {"map": size_in_words(self.found.dem), "start": str(self.start)}
        for level, cells, area in self._areas:
            size = f"{area / 1e6:.4g} km²" if area >= 1e5 else f"{area:.0f} m²"
            lines[self._words(level)] = f"{cells} cells, {size}, {100.0 * cells / self.cost.size:.1f} % of the map"
        if files:
            lines["written"] = ", ".join(files)
        wide = max(map(len, lines)) + 2
        return "\n".join(f"{name:<{wide}}{value}" for name, value in lines.items())

    def save(self, paths: list[Path], *, hillshade: bool) -> list[str]:
        """Write the files, all or none; their names."""
        if not paths:
            return []
        dem, files = self.found.dem, [str(path) for path in paths]
        levels = [(level, self._words(level)) for level in self.found.levels]
        shade = shade_of(dem) if hillshade else None
        drawn = reach_picture(
            self.cost, self.found.field, levels, self.start, shade=shade, cell_size_m=dem.cell_width_m
        )
        contents = (
            raster_bytes(paths[0], self.found.raster(), dem),
            self.found.geojson(),
            png_bytes(drawn),
            json.dumps(self.figures(files), indent=1).encode(),
            *(self.found.geopackage() for _ in paths[4:]),
        )
        write_all(dict(zip(paths, contents, strict=True)))
        return files

    def _words(self, level: float) -> str:
        """A level for people, in ASCII."""
        if self.found.measure == "time":
            return f"within {duration(level)}"
        if self.found.measure == "energy":
            return f"within {level / 1000.0:.4g} kJ"
        return f"within a cost of {level:.6g} {self.found.unit}".rstrip()
