"""The motions of a vehicle's body on a map of heights: checked where a search first asks, kept,
forgotten on change.

A search stands on cells in one of sixteen directions, leaves them by legs and turns on them. A
motion that has not been checked counts as free until it would be worth taking; only then it is
checked. So what a search finds is the optimum over all motions, though it has checked a part.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.arguments import checked
from nnpp_edge.runtime.arrays import (
    Bool,
    Cells,
    Float,
    Float2D,
    Float32s,
    Floats,
    Int32,
    Int64,
    UInt16,
)
from nnpp_edge.runtime.cells import Cell, Rectangle, Sides, slices, widened
from nnpp_edge.runtime.errors import InvalidMapError
from nnpp_edge.runtime.kernels import records
from nnpp_edge.runtime.kernels.by_address import address_of
from nnpp_edge.runtime.kernels.lanes import LANES
from nnpp_edge.runtime.kernels.lattice import DIRECTION_COUNT, LEG, walk_primitives, walk_states
from nnpp_edge.runtime.kernels.poses import (
    AXIS_COUNT,
    FAILS,
    MOST_CODE,
    UNCHECKED,
    check_all,
    check_run,
    figures_of,
    standing_codes,
)
from nnpp_edge.runtime.kernels.records import (
    BY_LENGTH,
    DOWN,
    MOTION,
    RIGHT,
    THERE,
    TO,
    Packed,
    PoseTables,
    Prices,
)
from nnpp_edge.runtime.memory import virtual_zeros
from nnpp_edge.runtime.robots.body import motions
from nnpp_edge.runtime.robots.body.primitives import ARCS, primitives
from nnpp_edge.runtime.terrain.traversability import Traversability, relative_heights, sides_of
from nnpp_edge.runtime.terrain.vehicle import Vehicle

NOTHING = np.empty((0, 0), np.float32)
"""Of a map without such numbers."""
_SAFE = 1.0 - 1e-5
"""Share of a limit that is used: what rounding to float32 may add."""


class Poses:
    """Which motions of a map have been checked, with what result, and what it takes to check the
    others.

    Parameters
    ----------
    heights : (H, W) float32
        Metres; not finite where unknown. Copied.
    sides_m : (float, float)
        Height and width of a cell.
    vehicle : Vehicle
        The body. InvalidMapError where it is larger than the map.
    weights : (float, float, float)
        Of tilt, rise and step in T; they sum to 1.
    scale : float
        Weight of T = 1.
    shut : (H, W) bool
        Cells that no part of the body may be above, whatever their heights; by default none.
    unseen : (I, J) float32
        Prices of blocks, see `map.unseen.Unseen`, of which later ones count too: motions that would
        be over unknown cells cost by these.
    added : (H, W) float32
        What layers add to T.
    """

    def __init__(
        self,
        heights: Float2D,
        sides_m: Sides,
        vehicle: Vehicle,
        weights: tuple[float, float, float],
        scale: float,
        shut: Bool | None = None,
        unseen: Float2D = NOTHING,
        added: Float2D = NOTHING,
    ) -> None:
        self.vehicle = vehicle
        rows, cols = heights.shape
        self.shape = (rows, cols)
        self.sides_m = sides_m
        dy, dx = sides_m
        down = rows * dy
        across = cols * dx
        if vehicle.length_m > max(down, across) or vehicle.width_m > min(down, across):
            raise InvalidMapError(
                f"wanted a map that the vehicle fits on, {vehicle.length_m:g} × "
                f"{vehicle.width_m:g} m, got one of {down:g} × {across:g} m"
            )
        self.motions = tables = motions.all_motions(vehicle, sides_m)
        offsets = np.concatenate((tables.offsets, tables.fit_offsets))
        self.reach: Cell = tuple(np.abs(offsets).max(0).tolist())
        """Rows and columns from a cell to those that it takes to check its motions."""
        margin = max(self.reach) + 1
        width = cols + 2 * margin + LANES
        self._base = np.float32(np.nan)
        """The first height that was known, to which all are relative; NaN before."""
        self._unknown = np.float32(np.nan if vehicle.unknown_passes or unseen.size else np.inf)
        beyond = np.inf if unseen.size else self._unknown
        self.heights = np.full((rows + 2 * margin, width), beyond, np.float32)
        """Within a margin of `margin` unknown cells, and more to the right; relative to `_base`."""
        self._added = np.zeros(self.heights.shape if added.size else (0, 0), np.float32)
        """Likewise; (0, 0) without layers."""
        nodes = (rows + 2) * (cols + 2)
        count = len(tables.poses_of) - 1 - AXIS_COUNT
        self.codes: UInt16 = virtual_zeros(nodes * count, np.uint16).reshape(nodes, count)
        """(nodes, M) what is known of each motion that begins on a node: legs, turns, and arcs if
        there are any. Searches come to new pages of it all the time, and huge ones take up to 3 ms
        to be cleared.
        """
        self.limits = _limits_of(vehicle, weights)
        """As of `records.PosesRecord`."""
        record = records.PosesRecord(
            codes=self.codes,
            heights=self.heights.reshape(-1),
            added=self._added.reshape(-1),
            tables=tuple(motions.by_offsets(tables, width)),
            limits=self.limits,
            scratch=np.zeros(tables.gradients.shape[1] * LANES, np.float32),
            counts=np.zeros(1, np.int64),
            rows=rows,
            cols=cols,
            width=width,
            margin=margin,
            block_side=cols // unseen.shape[1] if unseen.size else 0,
            block_prices=unseen.reshape(-1),
            check_run=0,
        )
        address = address_of(check_run, tuple(record), 0, 0, 0)  # type: ignore[no-untyped-call]  # as all of `kernels`
        self._record = record._replace(check_run=address)
        self.packed: Packed = tuple(self._record)
        """As the kernels take them."""
        prices, self.shortest = primitives(vehicle, sides_m)
        """No curve is shorter than so many times the way by legs."""
        self.prices = prices._replace(unit=np.float32(2.0 * scale / MOST_CODE))
        """Of the vehicle's motions, in cells of level ground."""
        self._put((0, 0, rows, cols), heights, shut, added)

    def figures(self, cell: Cell, motion: int, other: PoseTables | None = None) -> Floats:
        """(P, 7) of the poses of a motion from a cell, or of one of other motions: bounds of slope,
        pitch, roll, step and rise, and slopes ahead and to the left with the wheels in the middle
        of their ranges; see `kernels.poses`.
        """
        packed = self.packed
        if other is not None:
            tables = tuple(motions.by_offsets(other, self._record.width))
            packed = tuple(self._record._replace(tables=tables))
        first, last = (other or self.motions).poses_of[motion : motion + 2].tolist()
        found = np.empty((last - first, 7))
        figures_of(packed, *cell, motion, found)
        return found

    @property
    def checked(self) -> int:
        """Poses checked so far; one that was forgotten and checked again counts twice."""
        return int(self._record.counts[0])

    def _put(self, part: Rectangle, heights: Float2D, shut: Bool | None, added: Float2D) -> None:
        if np.isnan(self._base):
            known = (height for line in heights for height in line[np.isfinite(line)][:1])
            self._base = np.float32(next(known, np.nan))
        row, col, rows, cols = part
        here = slices((self._record.margin + row, self._record.margin + col, rows, cols))
        there = self.heights[here]
        there[:] = self._unknown
        np.subtract(heights, self._base, out=there, where=np.isfinite(heights))
        if shut is not None:
            there[shut] = np.inf
        if added.size:
            self._added[here] = added

    def write(
        self,
        part: Rectangle,
        heights: Float2D,
        shut: Bool | None = None,
        added: Float2D = NOTHING,
    ) -> Rectangle:
        """Put heights (h, w) float32 into a part of the map, and forget the motions that they
        touch.

        `shut` and `added` as for the class, of these cells. Returns the rectangle of cells whose
        motions may have changed.
        """
        self._put(part, heights, shut, added)
        near = widened(part, self.reach, self.shape)
        rows, cols = slices(near)
        # whole runs, within the border
        first = cols.start - cols.start % LANES
        last = min(cols.stop + -cols.stop % LANES, self.shape[1])
        codes = self.codes.reshape(self.shape[0] + 2, self.shape[1] + 2, -1)
        codes[rows.start + 1 : rows.stop + 1, first + 1 : last + 1] = UNCHECKED
        return near

    def complete(self) -> None:
        """Check all motions that are not checked yet."""
        check_all(self.packed)

    def standing(self, rows: Sequence[int] | None = None) -> UInt16:
        """(8, H, W) codes of the body standing on each cell in each direction, or of those of some
        rows.
        """
        rows = rows or range(self.shape[0])
        found = np.empty((len(rows), AXIS_COUNT, self.shape[1]), np.uint16)
        for codes, row in zip(found, rows, strict=True):
            standing_codes(self.packed, row, codes)
        return found.swapaxes(0, 1)

    def stands_at(self, cell: Cell) -> bool:
        """Whether the body may stand on a cell of the map in one direction at least."""
        row, col = cell
        codes = self.standing([row])[:, 0, col]
        return bool((codes < FAILS).any())

    def walk(
        self,
        path: Cells,
        first: int,
        costs: Floats,
        prices: Prices | None = None,
    ) -> int:
        """As `Grid.walk`, by these prices if given."""
        walk = walk_primitives if path.shape[1] == 3 else walk_states
        blocked = int(walk(self.packed, tuple(prices or self.prices), path, first, costs))
        if blocked < 0 and first == len(path) - 1:  # it moves no more
            row, col = path[-1, :2].tolist()
            return -1 if self.stands_at((row, col)) else first
        return blocked

    def steps(self, path: Cells) -> "PathMotions":
        """The motions along a path: legs between its cells (N, 2), or primitives between its states
        (N, 3).
        """
        moves = self.prices.moves
        steps = np.diff(path, axis=0)
        if path.shape[1] == 3:
            local = path[:-1, 2].astype(np.int64)
            steps[:, 2] = path[1:, 2]
            alike = moves[local][..., [DOWN, RIGHT, TO]] == steps[:, None]
            ways = alike.all(2).argmax(1)
            lengths = self.prices.fares[local, ways, BY_LENGTH].astype(np.float64)
        else:
            local = np.array([motions.LEGS.index(tuple(leg)) for leg in steps.tolist()], np.int64)
            ways = np.full(len(local), LEG)
            lengths = np.hypot(*steps.T)
        taken = moves[local, ways]
        motion = taken[:, MOTION].astype(np.int64)
        there = taken[:, THERE] > 0
        heading = local % DIRECTION_COUNT
        of_arc = (motion - ARCS + there) % DIRECTION_COUNT
        at_path = np.where(motion < ARCS, motion % AXIS_COUNT, of_arc)
        cells = path[:, :2]
        begins = np.where(there[:, None], cells[1:], cells[:-1])
        return PathMotions(begins, motion, there, heading, heading != at_path, lengths)

    def cost_along(self, path: Cells) -> tuple[Floats, Floats]:
        """(N - 1,) lengths of the motions along a path, in cells, and their T; all of them have
        been checked.
        """
        steps = self.steps(path)
        nodes = (steps.cells + 1) @ (self.shape[1] + 2, 1)
        codes = self.codes[nodes, steps.motions]
        return steps.lengths, _rated(codes, np.float64)


class PathMotions(NamedTuple):
    """The motions along a path of N places, (N - 1,) each."""

    cells: Int32
    """(N - 1, 2) where each motion begins, which for some is where the path comes to by it."""
    motions: Int64
    reversed: Bool
    """Whether it begins there."""
    headings: Int64
    """Direction of the body where the path comes from."""
    turned: Bool
    """Whether the body stands the other way round there than the motion is checked."""
    lengths: Floats


@checked(InvalidMapError)
def pose_costs(
    dem: Float2D,
    cell_size_m: float,
    vehicle: Vehicle,
    *,
    cell_width_m: float | None = None,
    traversability: Traversability | None = None,
) -> Float32s:
    """Cost of a vehicle's poses on each cell: every one is checked, which planners do only where
    they look.

    Parameters
    ----------
    dem : (H, W) float
        Elevation in metres; NaN where unknown.
    cell_size_m : float
        Side of a cell from row to row.
    vehicle : Vehicle
        The body.
    cell_width_m : float
        Side of a cell from column to column, where cells are not square.
    traversability : Traversability
        Its three weights are those of tilt, rise of the ground under the belly, and step; the
        paper's if not given.

    Returns
    -------
    (8, H, W) float32
        T in [0, 1), rounded up to a part in 65520, of the body standing there; inf where it cannot.
        The axes of the sixteen directions by rising angle: (1, 0), (2, 1), (1, 1), (1, 2), (0, 1),
        (-1, 2), (-1, 1) and (-2, 1) in (row, col), and their reverses.

    Raises
    ------
    InvalidMapError
        `dem` is no map, a cell size is not positive, or the body is larger than the map.

    Notes
    -----
    docs/vehicle-check.md. NNPP (arXiv 2308.04792v3), Eq. 1, of the body in place of the 3 × 3
    patch; bounds as in ACE (arXiv 1808.00031), of what departs from the plane on which the body
    stands.
    """
    sides = sides_of(cell_size_m, cell_width_m)
    if vehicle.as_body is None:
        raise InvalidMapError(
            "a disc has no poses: wanted a vehicle with length, width and clearance"
        )
    heights, _ = relative_heights(dem)
    weights = (traversability or Traversability()).body_weights
    codes = Poses(heights, sides, vehicle, weights, 1.0).standing()
    return _rated(codes, np.float32)


def _rated(codes: UInt16, kind: type[Float]) -> NDArray[Float]:
    """T by the codes of poses, in numbers of this kind; inf of those that fail."""
    rated = (np.maximum(codes, 1) - kind(1)) / kind(MOST_CODE)
    return np.where(codes < FAILS, rated, kind(np.inf))


def _limits_of(vehicle: Vehicle, weights: tuple[float, float, float]) -> Float32s:
    """Of a vehicle, as the check takes them."""
    *angles, step_m, rise_m = vehicle.allowances
    tilt, pitch, roll = map(math.radians, angles)
    limits = np.array((0.0, tilt, math.tan(pitch), math.tan(roll), step_m, rise_m)) * _SAFE
    return np.array((*limits, *weights), np.float32)
