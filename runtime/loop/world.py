"""The loop's map: heights or costs, kept up to date by patches from any thread."""

import math
import threading
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.arrays import Float2D, as_map
from nnpp_edge.runtime.cells import Cell, Rectangle, enclosing
from nnpp_edge.runtime.errors import InvalidMapError
from nnpp_edge.runtime.loop.messages import MapPatch
from nnpp_edge.runtime.map.changes import Change, ChangeLog
from nnpp_edge.runtime.map.disc import Disc
from nnpp_edge.runtime.map.poses import Poses, term_weights
from nnpp_edge.runtime.map.slope_cost import Mobility, slope_cost_of
from nnpp_edge.runtime.map.step_cost import StepModel
from nnpp_edge.runtime.terrain.traversability import Traversability, sides_of, traversability_cost, update_cost
from nnpp_edge.runtime.terrain.vehicle import Vehicle


@dataclass(frozen=True)
class Terrain:
    """How heights become costs."""

    cell_size_m: float
    traversability: Traversability
    cell_width_m: float | None = None
    vehicle: Vehicle | None = None
    """Whose poses the path must hold for, on the heights; None for a point."""
    step_cost: str = "paper"
    """What steps cost, as for `Planner.of_elevation`: by the costs, or by the slope."""
    mobility: Mobility | None = None

    @property
    def sides_m(self) -> tuple[float, float]:
        """Height and width of a cell."""
        return sides_of(self.cell_size_m, self.cell_width_m)

    def costs(self, heights: Float2D) -> Float2D:
        """(H, W) traversability costs of heights."""
        size, width = self.sides_m
        return traversability_cost(heights, size, self.traversability, cell_width_m=width, warn=False)


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
        self._blocked: NDArray[np.bool_] | None = None
        """Cells that a vehicle may not stand over, whatever their heights: cost patches made them impassable."""
        self._by_heights = terrain is not None and (terrain.vehicle is not None or terrain.step_cost != "paper")
        self._poses: Poses | None = None
        self._disc: Disc | None = None
        self._model = StepModel.of(step_cost)
        if terrain is not None and terrain.vehicle is not None:
            assert self._elevation is not None
            self._blocked = np.zeros(self._cost.shape, np.bool_)
            weights = term_weights(terrain.traversability)
            if terrain.vehicle.radius_m is not None:
                self._disc = Disc(terrain.vehicle.radius_m, terrain.sides_m, self._model.costs[2])
            else:
                self._poses = Poses(self._elevation, terrain.sides_m, terrain.vehicle, weights, 1.0)
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
        vehicle: Vehicle | None = None,
        step_cost: str = "paper",
        mobility: Mobility | None = None,
    ) -> "World":
        """The world of an elevation map; arguments as for `Planner.of_elevation`.

        With a vehicle, or where steps cost by the slope, what a patch of costs makes impassable is as unknown ground,
        and its other costs count for nothing. InvalidQueryError for a step cost that there is none of, or whose model
        needs a mobility.
        """
        slope_cost_of(step_cost, mobility)
        limits = traversability or Traversability()
        terrain = Terrain(cell_size_m, limits, cell_width_m, vehicle, step_cost, mobility)
        return cls(terrain.costs(elevation), elevation=elevation, terrain=terrain)

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

    @property
    def ground(self) -> Terrain | None:
        """How the heights become costs, where a planner goes by them; None where it goes by the costs."""
        return self._terrain if self._by_heights else None

    def unknown_around(self, cell: Cell, radius: int = 0) -> str:
        """How many of the cells around one are unknown, with the vehicle's reach, for people; empty for none."""
        radius += self.reach_cells
        rows, cols = (slice(max(at - radius, 0), at + radius + 1) for at in cell)
        unknown = self.unknown(rows, cols)
        return f"; {unknown.sum()} of {unknown.size} cells around it are unknown" if unknown.any() else ""

    def unknown(self, rows: slice = slice(None), cols: slice = slice(None)) -> NDArray[np.bool_]:
        """Cells, of the whole map or a part, of which nothing is known."""
        with self._lock:
            known = self._cost if self._elevation is None else self._elevation
            return np.isnan(known[rows, cols])

    @property
    def reach_cells(self) -> int:
        """From the vehicle's middle to its corners; 0 for a point."""
        if self._terrain is None or self._terrain.vehicle is None:
            return 0
        return math.ceil(self._terrain.vehicle.reach_m / min(self._terrain.sides_m))

    def heights(self) -> Float2D:
        """A copy of what a planner of heights goes by now: metres, NaN where none may be or where it is unknown."""
        with self._lock:
            return self._ground((0, 0, *self.shape))

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
        """The version, and what has changed since the last call: (row, col, costs), or heights as `heights` has them.

        Rectangles that together have more cells than the one that holds them all are read as that one.
        """
        with self._lock:
            parts = [change.part for change in self._unread.read() if change.cells]
            if parts and _area(whole := enclosing(parts)) < sum(map(_area, parts)):
                parts = [whole]
            read = self._ground if self._by_heights else self._costs_of
            return self.version, [(part[0], part[1], read(part)) for part in parts]

    def _costs_of(self, part: Rectangle) -> Float2D:
        row, col, rows, cols = part
        return self._cost[row : row + rows, col : col + cols].copy()

    def _ground(self, part: Rectangle) -> Float2D:
        row, col, rows, cols = part
        here = (slice(row, row + rows), slice(col, col + cols))
        assert self._elevation is not None
        blocked = ~(self._cost[here] < self._model.costs[2]) if self._blocked is None else self._blocked[here]
        heights: Float2D = np.where(blocked, np.float32(np.nan), self._elevation[here])
        return heights

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
            if self._poses is not None:
                standing = self._poses.walk(path) < 0 and (len(path) > 1 or self._poses.stands_at(path[0].tolist()))
                return "" if standing else "the vehicle does not stand on all of it"
            if self._disc is not None:
                row, col, _, _ = part = enclosing([(*cell, 1, 1) for cell in path.tolist()])
                free = self._disc.costs(self._cost, part) < self._model.costs[2]
                if not free[rows - row, cols - col].all():
                    return "the vehicle touches an impassable cell"
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
            if self._blocked is not None:
                self._blocked[here] = ~(self._cost[here] < self._model.costs[2])
            if self._poses is not None:
                self._poses.write(row, col, self._ground(part))
            return part
        terrain = self._terrain
        assert patch.elevation is not None and self._elevation is not None and terrain is not None
        heights = patch.elevation[cut]
        old = self._elevation[here].copy()
        unknown = old if patch.keep_known else np.float32(np.nan)
        self._elevation[here] = new = np.where(np.isfinite(heights), heights, unknown)
        part = _trimmed(part, (new != old) & ~(np.isnan(new) & np.isnan(old)))
        if not _area(part):
            return part
        size, width = terrain.cell_size_m, terrain.cell_width_m
        if self._poses is not None:
            self._poses.write(part[0], part[1], self._ground(part))
        return update_cost(self._cost, self._elevation, part, size, terrain.traversability, cell_width_m=width)


def _trimmed(part: Rectangle, changed: NDArray[np.bool_]) -> Rectangle:
    """The least rectangle of a part that holds its changed cells: a robot sends again what the map has already."""
    rows, cols = np.flatnonzero(changed.any(1)), np.flatnonzero(changed.any(0))
    if not len(rows):
        return part[0], part[1], 0, 0
    row, col = int(rows[0]), int(cols[0])
    return part[0] + row, part[1] + col, int(rows[-1]) - row + 1, int(cols[-1]) - col + 1


def _area(part: Rectangle) -> int:
    return part[2] * part[3]
