"""The loop's map: heights or costs, kept up to date by patches from any thread."""

import threading
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.arrays import Float2D, as_map
from nnpp_edge.runtime.cells import Rectangle, enclosing
from nnpp_edge.runtime.errors import InvalidMapError
from nnpp_edge.runtime.loop.messages import MapPatch
from nnpp_edge.runtime.map.changes import Change, ChangeLog
from nnpp_edge.runtime.map.step_cost import StepModel
from nnpp_edge.runtime.terrain.traversability import Traversability, traversability_cost, update_cost


@dataclass(frozen=True)
class Terrain:
    """How heights become costs."""

    cell_size_m: float
    traversability: Traversability
    cell_width_m: float | None = None


class World:
    """The newest map. Each patch is written into it at once, in order, so none is lost. A log keeps which rectangles
    changed since the planner last read them. Any thread may call any method.

    Parameters
    ----------
    cost : (H, W) float
        As `Planner` takes it. Copied.
    step_cost : str
        ``paper`` or ``length``.
    elevation : (H, W) float
        Heights that the costs come from, for patches of heights. Copied.
    terrain : Terrain
        Needed with `elevation`.
    """

    def __init__(
        self,
        cost: Float2D,
        *,
        step_cost: str = "paper",
        elevation: Float2D | None = None,
        terrain: Terrain | None = None,
    ) -> None:
        if (elevation is None) != (terrain is None):
            raise InvalidMapError("heights and how they become costs must be given together")
        self._cost = np.array(as_map(cost, "cost"))
        self._elevation = None if elevation is None else np.array(as_map(elevation, "elevation"))
        if self._elevation is not None and self._elevation.shape != self._cost.shape:
            raise InvalidMapError(f"elevation must be {self._cost.shape}, got {self._elevation.shape}")
        self._terrain = terrain
        self._model = StepModel.of(step_cost)
        self._lock = threading.Lock()
        self._log = ChangeLog()
        self._unread = self._log.reader()
        self.clipped = 0
        """Patches that stuck out of the map."""
        self.rejected = 0
        """Patches of which nothing was written."""

    @classmethod
    def of_elevation(
        cls,
        elevation: Float2D,
        cell_size_m: float,
        traversability: Traversability | None = None,
        *,
        cell_width_m: float | None = None,
    ) -> "World":
        """The world of an elevation map, in the paper's step costs; arguments as for `traversability_cost`."""
        limits = traversability or Traversability()
        cost = traversability_cost(elevation, cell_size_m, limits, cell_width_m=cell_width_m, warn=False)
        terrain = Terrain(cell_size_m, limits, cell_width_m)
        return cls(cost, elevation=elevation, terrain=terrain)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self._cost.shape[0], self._cost.shape[1]

    @property
    def version(self) -> int:
        """Number of patches written into the map."""
        return self._log.version

    @property
    def merged(self) -> int:
        """Changes that were merged with the next because too many were waiting for the planner."""
        return self._log.merged

    def cost(self) -> Float2D:
        """A copy of the costs as they are now."""
        with self._lock:
            return self._cost.copy()

    def put(self, patch: MapPatch) -> bool:
        """Write a patch into the map, as far as it lies on it; False if it is rejected.

        A patch is rejected if it misses the map, if it holds heights and the world was made from costs, or if it
        holds a cost out of range.
        """
        rows, cols = patch.shape
        top, left = max(patch.row, 0), max(patch.col, 0)
        bottom, right = min(patch.row + rows, self.shape[0]), min(patch.col + cols, self.shape[1])
        outside = patch.cost is not None and self._model.refuses(patch.cost)
        if top >= bottom or left >= right or outside or (patch.elevation is not None and self._elevation is None):
            with self._lock:
                self.rejected += 1
            return False
        part = (top, left, bottom - top, right - left)
        cut = (slice(top - patch.row, bottom - patch.row), slice(left - patch.col, right - patch.col))
        with self._lock:
            self.clipped += part[2:] != (rows, cols)
            changed = self._write(patch, part, cut)
            self._log.append(Change(changed, _area(changed)))
        return True

    def read_changes(self) -> tuple[int, list[tuple[int, int, Float2D]]]:
        """The version, and what has changed since the last call: (row, col, costs) of rectangles.

        Rectangles that together have more cells than the one that holds them all are read as that one.
        """
        with self._lock:
            parts = [change.part for change in self._unread.read()]
            if parts and _area(whole := enclosing(parts)) < sum(map(_area, parts)):
                parts = [whole]
            changes = [(r, c, self._cost[r : r + h, c : c + w].copy()) for r, c, h, w in parts]
            return self.version, changes

    def path_problem(self, path: NDArray[np.int32], corner_cutting: bool) -> str:
        """Why a path may not be walked on the newest map; empty if it may."""
        if not len(path):
            return "it is empty"
        rows, cols = path[:, 0], path[:, 1]
        if rows.min() < 0 or cols.min() < 0 or rows.max() >= self.shape[0] or cols.max() >= self.shape[1]:
            return "it leaves the map"
        if len(path) > 1 and not (np.abs(np.diff(path, axis=0)).max(axis=1) == 1).all():
            return "it is not connected"
        with self._lock:
            if not self._passable(rows, cols).all():
                return "it leads through an impassable cell"
            if not corner_cutting and not (
                self._passable(rows[:-1], cols[1:]).all() and self._passable(rows[1:], cols[:-1]).all()
            ):
                return "it cuts a corner"
        return ""

    def _passable(self, rows: NDArray[np.int32], cols: NDArray[np.int32]) -> NDArray[np.bool_]:
        return self._cost[rows, cols] < self._model.costs[2]

    def _write(self, patch: MapPatch, part: Rectangle, cut: tuple[slice, slice]) -> Rectangle:
        """Write the `cut` of a patch at `part`; the rectangle whose costs may have changed."""
        row, col, rows, cols = part
        here = (slice(row, row + rows), slice(col, col + cols))
        if patch.cost is not None:
            new = patch.cost[cut]
            unseen = self._cost[here] if patch.keep_known else np.float32(np.inf)
            self._cost[here] = np.where(np.isnan(new), unseen, new)
            return part
        terrain = self._terrain
        assert patch.elevation is not None and self._elevation is not None and terrain is not None
        heights = patch.elevation[cut]
        unknown = self._elevation[here] if patch.keep_known else np.float32(np.nan)
        self._elevation[here] = np.where(np.isfinite(heights), heights, unknown)
        size, width = terrain.cell_size_m, terrain.cell_width_m
        return update_cost(self._cost, self._elevation, part, size, terrain.traversability, cell_width_m=width)


def _area(part: Rectangle) -> int:
    return part[2] * part[3]
