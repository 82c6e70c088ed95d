"""What the examples share: their arguments, and how ground, paths and ends are drawn. Nothing here plans."""

import argparse
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from nnpp_edge.terrain.dem import Dem
from nnpp_edge.viz.picture import hillshade

OUT = Path(__file__).parent / "out"
_TILE = 512
"""Cells a side of the pieces in which a large file is made."""


def run(example: Callable[[Path, bool], Path]) -> None:
    """Run an example from the command line: `python examples/NAME.py [FOLDER] [--small]`."""
    kind = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=sys.modules["__main__"].__doc__, formatter_class=kind)
    parser.add_argument("folder", nargs="?", type=Path, default=OUT, help="for the picture; by default examples/out")
    parser.add_argument("--small", action="store_true", help="less work, where there is much")
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    print(f"written: {example(given.folder, given.small)}")


def panels(count: int, *, width: float = 4.2, height: float = 4.4) -> tuple[Figure, list[Axes]]:
    """A figure with so many panels side by side, inches."""
    figure = Figure(figsize=(width * count, height), layout="constrained")
    return figure, list(figure.subplots(1, count, squeeze=False)[0])


def relief(axes: Axes, dem: Dem, title: str = "") -> None:
    """Draw a map's ground, lit from the north-west."""
    axes.imshow(hillshade(dem.elevation, dem.cell_size_m, dem.cell_width_m), cmap="gray", vmin=0, vmax=255)
    axes.set_title(title, fontsize=10)
    axes.set_xticks([])
    axes.set_yticks([])


def line(axes: Axes, path: np.ndarray, color: str = "tab:orange", label: str | None = None) -> None:
    """Draw places (N, 2) (row, col) as a line with a dark rim."""
    axes.plot(path[:, 1], path[:, 0], color="black", linewidth=3.2)
    axes.plot(path[:, 1], path[:, 0], color=color, linewidth=1.8, label=label)


def ends(axes: Axes, start: tuple[int, int], goal: tuple[int, int]) -> None:
    """Mark the start with a square and the goal with a star."""
    axes.plot(start[1], start[0], "s", color="gold", markeredgecolor="black", markersize=7)
    axes.plot(goal[1], goal[0], "*", color="red", markeredgecolor="black", markersize=12)


def save(figure: Figure, folder: Path, name: str) -> Path:
    """Write the figure as a PNG; its path."""
    figure.savefig(folder / f"{name}.png", dpi=100)
    return folder / f"{name}.png"


def large_ground(path: Path, side: int) -> None:
    """Write a square cloud-optimised GeoTIFF of cells of 1 m, tile by tile: it is never all in memory."""
    import rasterio
    import rasterio.shutil

    from nnpp_edge.terrain.synthetic import fractal

    ground = fractal(np.random.default_rng(1), _TILE, 1.0, 8.0)
    plain = path.with_suffix(".plain.tif")
    kind = {"width": side, "height": side, "count": 1, "dtype": "float32", "nodata": np.nan, "crs": "EPSG:32615"}
    tiles = {"tiled": True, "blockxsize": _TILE, "blockysize": _TILE, "BIGTIFF": "YES"}
    place = rasterio.Affine(1, 0, 400_000, 0, -1, 5_000_000)
    with rasterio.open(plain, "w", driver="GTiff", transform=place, **kind, **tiles) as dataset:
        for row in range(0, side, _TILE):
            for col in range(0, side, _TILE):
                high, wide = min(_TILE, side - row), min(_TILE, side - col)
                hills = np.add.outer(
                    np.sin(np.arange(row, row + high) / 300), np.sin(np.arange(col, col + wide) / 500)
                )
                tile = ground[:: 1 - row // _TILE % 2 * 2, :: 1 - col // _TILE % 2 * 2][:high, :wide]
                window = ((row, row + high), (col, col + wide))
                dataset.write((tile + 30.0 * hills).astype(np.float32), 1, window=window)
    rasterio.shutil.copy(plain, path, driver="COG", COMPRESS="DEFLATE", PREDICTOR="YES", BLOCKSIZE=_TILE)
    plain.unlink()
