"""The map as the loop has it: heights or costs, brought up to date by patches from any thread."""

import threading
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.arrays import Float2D, as_map
from nnpp_edge.runtime.cells import Rectangle, gather
from nnpp_edge.runtime.errors import InvalidMapError
from nnpp_edge.runtime.loop.messages import MapPatch
from nnpp_edge.runtime.map.step_cost import StepCost
from nnpp_edge.runtime.terrain.traversability import Traversability, traversability_cost, update_cost


@dataclass(frozen=True)
class Terrain:
    """How heights become costs."""

    cell_size_m: float
    traversability: Traversability
    cell_width_m: float | None = None


class World:
    """The newest map. Patches are taken in at once and in order, so nothing of them is ever lost; what the planner
    has not heard of yet is kept as a few rectangles. Any thread may call any method.

    Parameters
    ----------
    cost : (H, W) float
        As `Planner` takes it. Copied.
    step_cost : str
        ``paper`` or ``length``.
    elevation : (H, W) float
        Heights that the costs come from, where patches of heights are to be understood. Copied.
    terrain : Terrain
        Needed with `elevation`.
    most_rectangles : int
        That are kept apart; one more and they are taken for the one that holds them all.
    """

    def __init__(
        self,
        cost: Float2D,
        *,
        step_cost: str = "paper",
        elevation: Float2D | None = None,
        terrain: Terrain | None = None,
        most_rectangles: int = 32,
    ) -> None:
        if (elevation is None) != (terrain is None):
            raise InvalidMapError("heights and how they become costs must be given together")
        self._cost = np.array(as_map(cost, "cost"))
        self._elevation = None if elevation is None else np.array(as_map(elevation, "elevation"))
        if self._elevation is not None and self._elevation.shape != self._cost.shape:
            raise InvalidMapError(f"elevation must be {self._cost.shape}, got {self._elevation.shape}")
        self._terrain = terrain
        self._lengths = step_cost == StepCost.LENGTH
        self._most = most_rectangles
        self._lock = threading.Lock()
        self._dirty: list[Rectangle] = []
        self.version = 0
        """Number of patches taken in."""
        self.clipped = self.rejected = self.merged = 0

    @classmethod
    def of_elevation(
        cls,
        elevation: Float2D,
        cell_size_m: float,
        traversability: Traversability | None = None,
        *,
        cell_width_m: float | None = None,
        most_rectangles: int = 32,
    ) -> "World":
        """The world of an elevation map, in the paper's step costs; arguments as for `traversability_cost`."""
        limits = traversability or Traversability()
        cost = traversability_cost(elevation, cell_size_m, limits, cell_width_m=cell_width_m, warn=False)
        terrain = Terrain(cell_size_m, limits, cell_width_m)
        return cls(cost, elevation=elevation, terrain=terrain, most_rectangles=most_rectangles)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self._cost.shape[0], self._cost.shape[1]

    def cost(self) -> Float2D:
        """A copy of the costs as they are now."""
        with self._lock:
            return self._cost.copy()

    def put(self, patch: MapPatch) -> bool:
        """Take a patch in, as far as it lies on the map; False if it is rejected.

        It is where it misses the map, holds heights while the world knows costs only, or a weight of 0 in the
        ``length`` model.
        """
        rows, cols = patch.shape
        top, left = max(patch.row, 0), max(patch.col, 0)
        bottom, right = min(patch.row + rows, self.shape[0]), min(patch.col + cols, self.shape[1])
        zeros = patch.cost is not None and self._lengths and bool((patch.cost == 0.0).any())
        if top >= bottom or left >= right or zeros or (patch.elevation is not None and self._elevation is None):
            with self._lock:
                self.rejected += 1
            return False
        part = (top, left, bottom - top, right - left)
        cut = (slice(top - patch.row, bottom - patch.row), slice(left - patch.col, right - patch.col))
        with self._lock:
            self.clipped += part[2:] != (rows, cols)
            self._write(patch, part, cut)
            self.version += 1
        return True

    def take(self) -> tuple[int, list[tuple[int, int, Float2D]]]:
        """The version, and what has changed since the last call: (row, col, costs) of rectangles."""
        with self._lock:
            changes = [(r, c, self._cost[r : r + h, c : c + w].copy()) for r, c, h, w in self._dirty]
            self._dirty.clear()
            return self.version, changes

    def refuses(self, path: NDArray[np.int32], corner_cutting: bool) -> str:
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
        return self._cost[rows, cols] < (np.inf if self._lengths else 1.0)

    def _write(self, patch: MapPatch, part: Rectangle, cut: tuple[slice, slice]) -> None:
        row, col, rows, cols = part
        here = (slice(row, row + rows), slice(col, col + cols))
        if patch.cost is not None:
            new = patch.cost[cut]
            unseen = self._cost[here] if patch.keep_known else np.float32(np.inf)
            self._cost[here] = np.where(np.isnan(new), unseen, new)
        else:
            assert patch.elevation is not None and self._elevation is not None and self._terrain is not None
            new = patch.elevation[cut]
            unseen = self._elevation[here] if patch.keep_known else np.float32(np.nan)
            self._elevation[here] = np.where(np.isfinite(new), new, unseen)
            terrain = self._terrain
            part = update_cost(
                self._cost, self._elevation, part, terrain.cell_size_m, terrain.traversability,
                cell_width_m=terrain.cell_width_m,
            )  # fmt: skip
        if gather(self._dirty, part, self._most):
            self.merged += self._most + 1
