"""The maps and queries of a profile: crops of terrain, synthetic terrain where no file is large enough."""

from collections.abc import Iterator
from pathlib import Path

from nnpp_edge.profiling.profile_file import SAMPLE, Load
from nnpp_edge.profiling.suites import SYNTHETIC, Case, TerrainFiles, large_enough, source_of, terrain_cases
from nnpp_edge.runtime.errors import TerrainError
from nnpp_edge.terrain.dem import Dem
from nnpp_edge.terrain.vehicle_files import load_vehicle


class ProfileMaps:
    """Where a profile's maps come from. The same load gives the same maps on any machine.

    TerrainError or InvalidQueryError if a terrain file or the vehicle's cannot be read, or no file is large enough
    for any of the sizes.
    """

    def __init__(self, load: Load) -> None:
        self.load = load
        self._vehicle = None if load.vehicle is None else load_vehicle(load.vehicle)
        self._dems: list[Dem] = []
        for name in () if load.terrain == (SYNTHETIC,) else load.terrain:
            paths = () if name == SAMPLE else (Path(name),)
            self._dems += TerrainFiles.or_sample(paths, load.rescale, load.cell_size).read()
        largest = max(self._dems, key=lambda dem: min(dem.shape), default=None)
        if largest is not None and not any(large_enough(self._dems, size) for size in load.sizes):
            (rows, cols), least = largest.shape, min(load.sizes)
            raise TerrainError(
                f"{largest.source}: wanted at least {least} × {least} cells, the size to be measured, got {rows} × "
                f"{cols}; --sizes {min(rows, cols)} measures on it"
            )

    def source(self, size: int) -> str:
        """Name of the terrain that maps of this size come from."""
        return source_of(self._dems, size)

    def maps(self, name: str, size: int) -> Iterator[Case]:
        """Maps of one workload and size with their queries, without end."""
        return terrain_cases(self._dems, name, size, self.load.seed, self.load.min_distance, self._vehicle)
