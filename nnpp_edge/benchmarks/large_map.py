"""A path across a raster that is read by windows: seconds, peak memory, cost and bound.

``python -m nnpp_edge.benchmarks.large_map --size 20000 --folder build/large_map`` makes a cloud-optimised GeoTIFF of
fractal ground, kept there for the next run, and plans across it by `nnpp-edge plan` in a process of its own.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import click
import cv2
import numpy as np
from numpy.typing import NDArray

from nnpp_edge.progress import bar
from nnpp_edge.runtime.errors import InvalidQueryError, optional_module

TILE = 512
_LATTICE = 1024
"""Lattice points after which an octave of the ground repeats."""
_COARSE = 64
"""Cells to a lattice point of the finest octave among those that are summed up on a small map first."""
_ROUGHNESS, _STEEPNESS = 0.85, 0.055
"""Exponent by which heights grow with the size of an octave, and heights of the finest, in cells."""
_BYTES_ON_PAPER = {
    "skimage.graph.MCP_Geometric, in memory": 4 + 64,
    "GRASS r.cost, in segments on disk": 24,
    "Planner, in memory": 4 + 16,
}
"""Bytes a cell that other ways take. MCP_Geometric: float32 costs, and 64 measured beside them at 1000² and 2000².
r.cost: three float64 a cell (cost in, cost out, nearest), of which `memory` megabytes are kept."""


@dataclass(frozen=True)
class Crossed:
    """A path across the map, and what it took."""

    size: int
    file_gb: float
    seconds: float
    """Of the whole command, start-up and files included."""
    cpu_s: float
    """Processor time of the command, on all cores."""
    map_s: float
    """Of reading all heights once and making the coarse levels."""
    stages_s: dict[str, float]
    """Of the plan: coarse levels searched, cells under the corridor read, searched, path."""
    peak_memory_gb: float
    """Resident, of the process, as the system counted it."""
    read_again: float
    """Share of the cells that was read twice."""
    status: str
    cost: float | None
    bound: float | None
    """The path costs at most so many times the optimum."""
    path_cells: int
    paper_gb: dict[str, float]
    """What whole-array tools would hold."""


class Ground:
    """Fractal ground, made tile by tile: octaves of noise on lattices that repeat after `_LATTICE` points."""

    def __init__(self, size: int, seed: int) -> None:
        rng = np.random.default_rng(seed)
        self._size, self._noise = size, rng.normal(size=(_LATTICE, _LATTICE)).astype(np.float32)
        self._shifts = rng.integers(0, _LATTICE, (32, 2))
        side = -(-size // TILE) * TILE // _COARSE + 16
        octaves = range(int(np.log2(_COARSE)), max(int(np.log2(size)), int(np.log2(_COARSE)) + 1))
        self._coarse = np.zeros((side, side), np.float32)
        for octave in octaves:
            self._coarse += self._octave(octave, (-8, -8), side, _COARSE)

    def tile(self, row: int, col: int) -> NDArray[np.float32]:
        """(TILE, TILE) float32 heights in cells' sides, from a cell on whose row and column are multiples of TILE."""
        at, points = (row // _COARSE + 8, col // _COARSE + 8), TILE // _COARSE
        heights = _enlarged(self._coarse[at[0] - 4 : at[0] + points + 4, at[1] - 4 : at[1] + points + 4], _COARSE)
        for octave in range(int(np.log2(_COARSE))):
            heights = heights + self._octave(octave, (row, col), TILE, 1)
        return heights.astype(np.float32)

    def _octave(self, octave: int, first: tuple[int, int], side: int, unit: int) -> NDArray[np.float32]:
        """A square of an octave of so many points a side, `unit` cells apart."""
        spacing = (1 << octave) // unit
        rows, cols = (
            np.arange(at // spacing - 4, -(-(at + side) // spacing) + 4) + shift
            for at, shift in zip(first, self._shifts[octave], strict=True)
        )
        noise = self._noise[np.ix_(rows % _LATTICE, cols % _LATTICE)] * (_STEEPNESS * 2.0 ** (octave * _ROUGHNESS))
        down, right = first[0] % spacing, first[1] % spacing
        return _enlarged(noise, spacing)[down : down + side, right : right + side]


def _enlarged(points: NDArray[np.float32], factor: int) -> NDArray[np.float32]:
    """The points, each as many cells wide, smoothed between; without four points at each rim."""
    size = (points.shape[1] * factor, points.shape[0] * factor)
    large = points if factor == 1 else cv2.resize(points, size, interpolation=cv2.INTER_CUBIC)
    return np.asarray(large[4 * factor : -4 * factor, 4 * factor : -4 * factor], np.float32)


def make_cog(path: Path, size: int, seed: int = 1, cell_size_m: float = 1.0) -> None:
    """Write a square COG of fractal ground: deflate with predictor, tiles of 512², overviews. Never all in memory."""
    rasterio = optional_module("rasterio", "making the map", "geo")
    ground = Ground(size, seed)
    place = rasterio.Affine(cell_size_m, 0, 400_000, 0, -cell_size_m, 5_000_000)
    kind = {"driver": "GTiff", "width": size, "height": size, "count": 1, "dtype": "float32", "nodata": np.nan}
    tiles = {"tiled": True, "blockxsize": TILE, "blockysize": TILE, "BIGTIFF": "YES"}
    with tempfile.TemporaryDirectory(dir=path.parent) as folder, rasterio.Env(GDAL_CACHEMAX=1 << 28):
        plain, cog = Path(folder) / "plain.tif", Path(folder) / "cog.tif"
        with (
            bar("ground", size) as progress,
            rasterio.open(plain, "w", **kind, **tiles, crs="EPSG:32615", transform=place) as dataset,
        ):
            for row in range(0, size, TILE):
                for col in range(0, size, TILE):
                    high, wide = min(TILE, size - row), min(TILE, size - col)
                    heights = ground.tile(row, col)[:high, :wide] * np.float32(cell_size_m)
                    dataset.write(heights, 1, window=((row, row + high), (col, col + wide)))
                progress(min(row + TILE, size))
        options = {"COMPRESS": "DEFLATE", "PREDICTOR": "YES", "BLOCKSIZE": TILE, "NUM_THREADS": "ALL_CPUS"}
        copy = optional_module("rasterio.shutil", "making the map", "geo").copy
        copy(plain, cog, driver="COG", OVERVIEW_RESAMPLING="AVERAGE", **options)
        cog.replace(path)


def cross(path: Path, size: int, memory: str | None) -> Crossed:
    """Plan from corner to corner of the map, by the command, with so much memory allowed."""
    margin = size // 50
    ends = ["--start", f"{margin},{margin}", "--goal", f"{size - 1 - margin},{size - 1 - margin}"]
    words = [sys.executable, "-m", "nnpp_edge.cli.main", "plan", str(path), *ends, "--workload", "limit20", "--json"]
    with tempfile.TemporaryDirectory(dir=path.parent) as folder:
        words += ["-o", folder, *(["--memory", memory] if memory else [])]
        began = time.perf_counter()
        with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None
            told = process.stdout.read()
            _, status, usage = os.wait4(process.pid, 0)
            process.returncode = os.waitstatus_to_exitcode(status)
        seconds = time.perf_counter() - began
    if not told:
        raise InvalidQueryError(f"the command ended with exit code {process.returncode}")
    plan = json.loads(told)
    windows = plan.get("windows") or {"map_s": 0.0, "read_again": 0.0}
    stages = {name: round(ms / 1e3, 3) for name, ms in plan["timings_ms"].items()}
    on_paper = {name: round(1e-9 * count * size * size, 2) for name, count in _BYTES_ON_PAPER.items()}
    return Crossed(
        size,
        path.stat().st_size * 1e-9,
        seconds,
        usage.ru_utime + usage.ru_stime,
        windows["map_s"],
        stages,
        usage.ru_maxrss * 1024e-9,
        windows["read_again"],
        plan["status"],
        plan["cost"],
        plan["bound"],
        plan["cells"],
        on_paper,
    )


@click.command()
@click.option("--size", type=click.IntRange(256), default=20_000, show_default=True, help="Cells a side.")
@click.option("--folder", type=click.Path(path_type=Path, file_okay=False), default=Path("build/large_map"))
@click.option("--memory", default="2GB", show_default=True, help="As for `nnpp-edge plan`.")
@click.option("--seed", type=int, default=1, show_default=True)
def main(size: int, folder: Path, memory: str, seed: int) -> None:
    """Make the map unless it is there, plan across it, and print the figures as JSON."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"ground-{size}-{seed}.tif"
    if not path.exists():
        make_cog(path, size, seed)
    crossed = cross(path, size, memory)
    click.echo(json.dumps(asdict(crossed), indent=1))
    sys.exit(int(crossed.status != "OK"))


if __name__ == "__main__":
    main()
