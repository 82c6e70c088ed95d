"""The layers of a map of heights: these, and costs told on it."""

import numpy as np

from nnpp_edge.runtime.arrays import Bool, Float2D, Floats, as_map
from nnpp_edge.runtime.cells import Rectangle, slices
from nnpp_edge.runtime.errors import InvalidMapError
from nnpp_edge.runtime.kernels.pooling import FACTOR
from nnpp_edge.runtime.map.along import Line, heights_at
from nnpp_edge.runtime.map.grid import ALL_SEEN, Grid, bordered
from nnpp_edge.runtime.map.ground import Ground
from nnpp_edge.runtime.map.layers import Layer, Lowest, Put
from nnpp_edge.runtime.map.pyramid import coarse_shapes
from nnpp_edge.runtime.map.tiles import Tiles
from nnpp_edge.runtime.map.unseen import Unseen
from nnpp_edge.runtime.memory import is_filed, virtual_zeros
from nnpp_edge.runtime.terrain.step_cost import StepModel
from nnpp_edge.runtime.terrain.traversability import relative_heights, traversability_cost
from nnpp_edge.runtime.tuning import MOST_PRICE


class Heights(Lowest):
    """Heights, by whose terms (Eq. 1) cells weigh, tile by tile; over `unseen` blocks, where those
    are known before.

    A patch matters to the cells beside it.
    """

    name = "heights"

    def __init__(self, ground: Ground, model: StepModel, corner_cutting: bool) -> None:
        self.model = model
        self._cutting = corner_cutting
        self.limits = ground.limits
        self._sides = ground.sides_m
        self.unseen = Unseen(ground) if ground.factor > 1 else None
        """Blocks that are known by their means; None where cells are known, or nothing."""
        dem = np.asarray(ground.elevation)
        heights, self.base = relative_heights(dem)
        if self.unseen is not None:
            rows, cols = ground.shape
            heights = virtual_zeros(rows * cols, np.float32).reshape(rows, cols)
        elif np.shares_memory(heights, dem) and not is_filed(dem):
            heights = heights.copy()
        self.array = heights
        """(H, W) float32, relative to `base`; not finite where unknown. To be read only."""
        self.told: Float2D = virtual_zeros(heights.size, np.float32).reshape(heights.shape)
        """(H, W) of `Told`, which the tiles weigh with these; 0 where nothing was."""
        self.tells = np.zeros(1, np.bool_)
        """(1,) whether anything was."""
        self.given = {name: np.array(as_map(each, name)) for name, each in ground.layers.items()}
        """(H, W) of each `Given`."""
        for name, each in self.given.items():
            if each.shape != ground.shape:
                raise InvalidMapError(f"{name} must have {ground.shape} cells, got {each.shape}")

    def __getstate__(self) -> dict[str, object]:
        return {name: value for name, value in vars(self).items() if name != "tiles"}

    def begin(self) -> Grid:
        rows, cols = self.array.shape
        small = self.unseen is not None or is_filed(self.array)
        weights = bordered(rows, cols, small=small)
        source = {
            "rule": self.limits.rule(*self._sides, scale=self.model.scale),
            "weights": weights,
            "corner_cutting": self._cutting,
            "told": self.told.reshape(-1),
            "tells": self.tells,
            "added": self.added((0, 0, rows, cols)).reshape(-1),
        }
        if self.unseen is not None:
            source |= self.unseen.source
        self.tiles = Tiles(self.array, FACTOR ** len(coarse_shapes(rows, cols)), source)
        grid = Grid(rows, cols, self.model, self._cutting, weights, self.tiles)
        if self.unseen is not None:  # whose prices may be greater than any cost
            grid.set_bounds(grid.least, MOST_PRICE * self.model.scale)
        return grid

    def read(self, patch: Float2D) -> Float2D:
        return relative_heights(patch, self.base)[0]

    def put(self, part: Rectangle, patch: Float2D, seen: Bool | None, *, keeps: bool) -> Put:
        if self.unseen is not None:
            known = np.isfinite(patch)
            self.unseen.see(part, known if seen is None else known & seen, self.array)
        return self.tiles.write(part, patch, ALL_SEEN if seen is None else seen, keeps=keeps)

    def cost(self) -> Float2D:
        dy, dx = self._sides
        whole = (0, 0, *self.array.shape)
        known = self.known(whole).copy()
        cost = traversability_cost(
            known, dy, self.limits, cell_width_m=dx, warn=False, layers=self.given
        )
        if self.unseen is None:
            return cost
        return np.where(self.unknown(whole), self.unseen.prices(whole), cost)

    def unknown(self, part: Rectangle) -> Bool:
        unknown: Bool = ~np.isfinite(self.array[slices(part)])
        return unknown if self.unseen is None else unknown | self.unseen.unknown(part)

    def known(self, part: Rectangle) -> Float2D:
        """Heights of a part, NaN where they mean nothing."""
        here: Float2D = self.array[slices(part)]
        if self.unseen is None:
            return here
        return np.where(self.unknown(part), np.float32(np.nan), here)

    def added(self, part: Rectangle) -> Float2D:
        """(h, w) what the layers given add to the costs of a part; (0, 0) without any."""
        return self.limits.added(self.given, part)

    def shut(self, part: Rectangle) -> Bool | None:
        """(h, w) cells of a part that were told to be shut; None where nothing was told."""
        return self.told[slices(part)] >= 1.0 if self.tells else None

    def metres_at(self, places: Line) -> Floats:
        """(N,) metres at places (N, 2)."""
        found = heights_at(self.array, places)
        if self.unseen is not None:
            found = self.unseen.heights_at(places, found)
        return found + self.base


class Given(Layer):
    """Numbers that were given for a term of Eq. 1 (`options.LAYER_TERMS`)."""

    def __init__(self, heights: Heights, name: str) -> None:
        self.name = name
        self._heights = heights

    def put(self, part: Rectangle, patch: Float2D, seen: Bool | None, *, keeps: bool) -> Put:
        everywhere = True if seen is None else seen
        np.copyto(self._heights.given[self.name][slices(part)], patch, where=everywhere)
        added = self._heights.added(part)
        return self._heights.tiles.write(part, added, ALL_SEEN, into="added", keeps=keeps)


class Told(Layer):
    """Costs told on a map of heights: a cell weighs by the greater of both.

    With `shut_alone` a cost below 1 says nothing but that the cell is not shut.
    """

    name = "cost"

    def __init__(self, heights: Heights, shut_alone: bool) -> None:
        self._heights = heights
        self._shut_alone = shut_alone

    def put(self, part: Rectangle, patch: Float2D, seen: Bool | None, *, keeps: bool) -> Put:
        model = self._heights.model
        if model.refuses(patch):
            model.refuse(float(np.nanmin(patch)))
        self._heights.tells[0] = True
        known = ~np.isnan(patch)
        if seen is not None:
            known &= seen
        below = np.float32(0.0) if self._shut_alone else patch
        told = np.where(patch < 1.0, below, np.float32(np.inf))
        return self._heights.tiles.write(part, told, known, into="told", keeps=keeps)
