"""The poses of a vehicle on a map of heights: checked where a search first asks, kept, forgotten where it changes.

A search of the map stands on cells, and a step along a heading costs by the poses of both its cells in that heading.
An unchecked pose counts as free until its step would be worth taking; only then it is checked. So what a search
finds is the optimum over all poses, though it has checked a part.
"""

import functools
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.arguments import checked
from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Cell, Rectangle, slices, widened
from nnpp_edge.runtime.errors import InvalidMapError
from nnpp_edge.runtime.kernels.poses import (
    FAILS,
    LIMIT_SLOTS,
    MOST_CODE,
    RUN,
    UNCHECKED,
    address_of_check,
    check_rows,
    check_run,
    forget_poses,
    put_heights,
    walk_poses,
)
from nnpp_edge.runtime.terrain.traversability import Traversability, relative_heights, sides_of
from nnpp_edge.runtime.terrain.vehicle import HEADINGS, Vehicle, footprint

PoseSource = tuple[
    NDArray[np.float32],
    NDArray[np.int64],
    NDArray[np.int64],
    tuple[NDArray[np.float32], NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]],
    NDArray[np.float32],
    NDArray[np.float32],
    NDArray[np.float32],
    NDArray[np.int64],
    NDArray[np.int64],
]
PackedPoses = tuple[NDArray[np.uint16], np.float32, PoseSource, int]
"""Poses as the kernels take them, see `kernels.poses`."""
_ROUNDING = 1e-12
"""By which a share of a height may seem negative that is none."""
_SAFE = 1.0 - 1e-5
"""Share of a limit that is used: what rounding to float32 may add."""


class Poses:
    """Which poses of a map have been checked, with what result, and what it takes to check the others.

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
    """

    def __init__(
        self,
        heights: Float2D,
        sides_m: tuple[float, float],
        vehicle: Vehicle,
        weights: tuple[float, float, float],
        scale: float,
        shut: NDArray[np.bool_] | None = None,
    ) -> None:
        self.weights = weights
        self.vehicle, self.shape, self.sides_m = vehicle, (heights.shape[0], heights.shape[1]), sides_m
        (rows, cols), (dy, dx) = self.shape, sides_m
        if vehicle.length_m > max(rows * dy, cols * dx) or vehicle.width_m > min(rows * dy, cols * dx):
            raise InvalidMapError(
                f"wanted a map that the vehicle fits on, {vehicle.length_m:g} × {vehicle.width_m:g} m, "
                f"got one of {rows * dy:g} × {cols * dx:g} m"
            )
        geometry = _geometry(vehicle, dy, dx)
        offsets = geometry.cells
        self.reach: Cell = (int(np.abs(offsets[:, 0]).max()), int(np.abs(offsets[:, 1]).max()))
        """Rows and columns from a pose to the cells that it takes to check."""
        self._margin, width = max(self.reach), cols + 2 * max(self.reach) + RUN
        self._base = _some_height(heights)
        self._unknown = np.float32(np.nan if vehicle.unknown_passes else np.inf)
        self._heights = np.empty((rows + 2 * self._margin, width), np.float32)
        for edge in (
            np.s_[: self._margin],
            np.s_[-self._margin :],
            np.s_[:, : self._margin],
            np.s_[:, self._margin + cols :],
        ):
            self._heights[edge] = self._unknown
        nodes = (rows + 2) * (cols + 2)
        self.codes: NDArray[np.uint16] = np.zeros((nodes, len(HEADINGS)), np.uint16)
        """(nodes, 4) what is known of each pose."""
        self._close_border(rows, cols)
        self._counts = np.zeros(1, np.int64)
        source = (
            self._heights.reshape(-1),
            offsets[:, 0] * width + offsets[:, 1],
            geometry.starts,
            (geometry.places, geometry.patches_of, geometry.patches, geometry.raised),
            geometry.gradients,
            _limits(geometry, vehicle, weights),
            np.zeros(geometry.gradients.shape[1] * RUN, np.float32),
            self._counts,
            np.array((rows, cols, width, self._margin), np.int64),
        )
        self.packed: PackedPoses = self.codes, np.float32(scale / MOST_CODE), source, _address()
        """As the kernels take them."""
        self._put(0, 0, heights, shut)

    def _close_border(self, rows: int, cols: int) -> None:
        padded = self.codes.reshape(rows + 2, cols + 2, -1)
        padded[[0, -1]] = FAILS
        padded[:, [0, -1]] = FAILS

    @property
    def checked(self) -> int:
        """Poses checked so far; one that was forgotten and checked again counts twice."""
        return int(self._counts[0])

    def _put(self, row: int, col: int, heights: Float2D, shut: NDArray[np.bool_] | None) -> None:
        place = self._margin + row, self._margin + col
        put_heights(np.ascontiguousarray(heights), self._base, self._unknown, self._heights, *place)
        if shut is not None:
            self._heights[slices((*place, *heights.shape))][shut] = np.inf

    def write(self, row: int, col: int, heights: Float2D, shut: NDArray[np.bool_] | None = None) -> Rectangle:
        """Put heights into the map, (h, w) float32 that lie inside it, and forget the poses that they touch.

        `shut` as for the class, of these cells. Returns the rectangle of cells whose poses may be other ones now.
        """
        self._put(row, col, heights, shut)
        rows, cols = heights.shape
        forget_poses(self.packed, (row, row + rows, col, col + cols), self.reach)
        return widened((row, col, rows, cols), self.reach, self.shape)

    def complete(self) -> None:
        """Check all poses that are not checked yet."""
        check_rows(self.packed, 0, self.shape[0])

    def stands_at(self, cell: Cell) -> bool:
        """Whether the body may stand on a cell of the map in one heading at least."""
        codes = self.codes[(cell[0] + 1) * (self.shape[1] + 2) + cell[1] + 1]
        for heading in range(len(HEADINGS)):
            if codes[heading] == UNCHECKED:
                check_run(self.packed, *cell, heading)
            if codes[heading] != FAILS:
                return True
        return False

    def walk(self, path: NDArray[np.int32]) -> int:
        """Number of the first cell of a path that a failing pose leads to; -1 if all its poses pass."""
        stride, steps = self.shape[1] + 2, (1.0, 1.0, 1.0, 1.0)
        return int(walk_poses(self.packed, stride, steps, path, 0, np.empty(len(path))))

    def costs(self, rows: NDArray[np.int64] | slice = slice(None)) -> NDArray[np.float32]:
        """(4, H, W) float32, T of all poses, or of those of some rows, inf where one fails; all get checked."""
        for row in np.arange(self.shape[0])[rows].tolist():
            check_rows(self.packed, row, row + 1)
        codes = self.codes.reshape(self.shape[0] + 2, self.shape[1] + 2, -1)[1:-1, 1:-1][rows].transpose(2, 0, 1)
        costs = (np.maximum(codes, 1) - np.float32(1)) / np.float32(MOST_CODE)
        return np.where(codes == FAILS, np.float32(np.inf), costs.astype(np.float32))


@checked(InvalidMapError)
def pose_costs(
    dem: Float2D,
    cell_size_m: float,
    vehicle: Vehicle,
    *,
    cell_width_m: float | None = None,
    traversability: Traversability | None = None,
) -> NDArray[np.float32]:
    """Cost of a vehicle's poses on each cell: every one is checked, which planners do only where they look.

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
        Its three weights are those of tilt, rise of the ground under the belly, and step; the paper's if not given.

    Returns
    -------
    (4, H, W) float32
        T in [0, 1), rounded up to a part in 65533; inf where the pose fails. The headings are those of the steps
        (1, 0), (1, 1), (0, 1) and (-1, 1) in (row, col), and of their reverses.

    Raises
    ------
    InvalidMapError
        `dem` is no map, a cell size is not positive, or the body is larger than the map.

    Notes
    -----
    docs/vehicle.md. NNPP (arXiv 2308.04792v3), Eq. 1, of the body in place of the 3 × 3 patch; bounds as in ACE
    (arXiv 1808.00031).
    """
    sides = sides_of(cell_size_m, cell_width_m)
    if vehicle.is_disc:
        raise InvalidMapError("a disc has no poses: wanted a vehicle with length, width and clearance")
    heights, _ = relative_heights(dem)
    return Poses(heights, sides, vehicle, term_weights(traversability), 1.0).costs()


def term_weights(traversability: Traversability | None) -> tuple[float, float, float]:
    """Weights of tilt, rise and step in T."""
    rule = traversability or Traversability()
    return rule.slope_weight, rule.roughness_weight, rule.step_weight


def _some_height(heights: Float2D) -> np.float32:
    """The first finite height; 0 without any."""
    for line in heights:
        known = line[np.isfinite(line)]
        if known.size:
            return np.float32(known[0])
    return np.float32(0.0)


@functools.cache
def _address() -> int:
    """Of the check, compiled by way of a map of one cell and a body without wheels."""
    nothing, one, none = np.zeros((0, 2), np.float32), np.ones(LIMIT_SLOTS, np.float32), np.zeros(5, np.int64)
    own, scratch = np.zeros((5, 4), np.float32), np.zeros(4 * RUN, np.float32)
    parts = (nothing, none, none.reshape(1, 5), none), own, one, scratch
    heights, cells = np.zeros(2 * RUN, np.float32), np.zeros(1, np.int64)
    source = heights, cells, np.zeros((4, 5), np.int64), *parts, cells, np.array((1, 1, RUN, 0))
    packed = np.zeros((9, 4), np.uint16), np.float32(1.0), source, 0
    return int(address_of_check(packed))  # type: ignore[no-untyped-call]  # as all of `kernels`


class _Geometry(NamedTuple):
    """Tables of the check, of all headings, one after another."""

    cells: NDArray[np.int64]
    """(N, 2) cells of each heading's wheels, then of its belly, as (row, col) from the pose's own."""
    starts: NDArray[np.int64]
    """(4, W + 1) where the cells of each wheel begin, and where the last one's end."""
    places: NDArray[np.float32]
    """(N, 2) metres ahead of the body's middle and to its left; 0 for wheels."""
    patches_of: NDArray[np.int64]
    """(5,) where each heading's patches of the belly begin, and the last one's end."""
    patches: NDArray[np.int64]
    """(P, 4) of each patch, on which the same wheels' heights lower the plane: where its cells begin and end, and
    where these wheels do among the raised."""
    raised: NDArray[np.int64]
    """Numbers of the wheels whose greatest heights make the plane lowest, patch by patch."""
    gradients: NDArray[np.float32]
    """(5, W) what a wheel's height adds to the plane at the body's middle, to its gradients ahead and to the left,
    and to these two without sign."""
    half_steps: tuple[float, ...]
    """Half a step along each heading, metres."""
    margins: tuple[float, ...]
    """By how much the belly may come lower between two poses of each heading than their gradients say, metres."""


@functools.lru_cache(maxsize=16)
def _geometry(vehicle: Vehicle, dy: float, dx: float) -> _Geometry:
    """Of a vehicle on cells of `dy` × `dx` metres. The plane is fitted by least squares to the wheels' heights."""
    wheels = vehicle.wheels_m
    solved = np.linalg.pinv(np.column_stack((np.ones(len(wheels)), wheels)))
    prints = [footprint(vehicle, heading, dy, dx) for heading in range(len(HEADINGS))]
    parts, starts = [], np.zeros((len(prints), len(wheels) + 1), np.int64)
    patches_of, count = [0], 0
    patches: list[tuple[int, int, int, int]] = []
    raised: list[int] = []
    for heading, each in enumerate(prints):
        under = np.concatenate(each.wheels)
        parts.append(np.column_stack((under, np.zeros(under.shape))))
        starts[heading] = count + np.cumsum([0, *map(len, each.wheels)])
        count += len(under)
        lowers = np.column_stack((np.ones(len(each.places)), each.places)) @ solved < -_ROUNDING
        for pattern in np.unique(lowers, axis=0):
            there, here = (lowers == pattern).all(1), np.nonzero(pattern)[0]
            parts.append(np.column_stack((each.belly[there], each.places[there])))
            patches.append((count, count + int(there.sum()), len(raised), len(raised) + len(here)))
            raised.extend(here)
            count += int(there.sum())
        patches_of.append(len(patches))
    cells = np.concatenate(parts)
    return _Geometry(
        cells[:, :2].astype(np.int64),
        starts,
        np.ascontiguousarray(cells[:, 2:], np.float32),
        np.array(patches_of, np.int64),
        np.array(patches, np.int64),
        np.array(raised, np.int64),
        np.ascontiguousarray(np.concatenate((solved, np.abs(solved[1:]))), np.float32),
        tuple(each.half_step for each in prints),
        tuple(each.margin for each in prints),
    )


def _limits(geometry: _Geometry, vehicle: Vehicle, weights: tuple[float, float, float]) -> NDArray[np.float32]:
    pitch, roll, tilt = (math.radians(angle) for angle in vehicle.tilts_deg)
    limits = np.array((math.tan(pitch), math.tan(roll), tilt, vehicle.step_m, vehicle.clearance_m)) * _SAFE
    return np.array((*limits, *weights, *geometry.half_steps, *geometry.margins), np.float32)
