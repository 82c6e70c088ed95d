"""A small simulated world for the onboard loop: ground that is not what the map says, a robot, and obstacles."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Cell, Rectangle
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.loop.messages import Goal, Input, MapPatch, PathMessage, Pose
from nnpp_edge.runtime.terrain.traversability import Traversability, traversability_cost
from nnpp_edge.terrain.obstacles import OBSTACLE, Obstacles


@dataclass(frozen=True, eq=False)
class SurveyedGround:
    """A terrain as it is, and as a coarse survey has it."""

    true: Float2D
    """(H, W) traversability cost."""
    surveyed: Float2D
    """(H, W) traversability cost of blurred heights."""
    cell_size_m: float = 1.0

    @classmethod
    def of(
        cls,
        elevation: Float2D,
        cell_size_m: float,
        limits: Traversability,
        block: int,
        cell_width_m: float | None = None,
    ) -> "SurveyedGround":
        """From heights; the survey has them blurred by a Gaussian of half a `block` of cells (1 knows all).

        Raises
        ------
        InvalidQueryError
            `block` is less than 1, or no cell's height is known.
        """
        if block < 1:
            raise InvalidQueryError(f"the survey's blocks must be of at least 1 cell, got {block}")
        true = traversability_cost(elevation, cell_size_m, limits, cell_width_m=cell_width_m, warn=False)
        if block == 1:
            return cls(true, true.copy(), cell_size_m)
        known = np.isfinite(elevation)
        if not known.any():
            raise InvalidQueryError("wanted an elevation map, got no cell with a known height")
        filled = np.where(known, elevation, elevation[known].mean()).astype(np.float32)
        blurred = cv2.GaussianBlur(filled, (0, 0), block / 2.0, borderType=cv2.BORDER_REPLICATE)
        smooth: Float2D = np.where(known, blurred, np.nan).astype(np.float32)
        surveyed = traversability_cost(smooth, cell_size_m, limits, cell_width_m=cell_width_m, warn=False)
        return cls(true, surveyed, cell_size_m)


class Scene:
    """The ground, what the robot has been told of it, and the robot; an `InputSource` that advances at each poll.

    At a poll the robot walks on along the newest path as far as that is free, obstacles change, and the robot
    sees the true cost of the cells around it. Obstacles are told at once, wherever they are.

    Parameters
    ----------
    start, goal : (row, col)
        Cells that are truly passable. Around both the true costs are known from the beginning.
    sight : int
        Cells that the robot sees to each side, at least 1.
    speed : int
        Cells that it walks between two polls, at least 1.
    changes : int
        Events of obstacles between two polls.

    Raises
    ------
    InvalidQueryError
        Start or goal is outside the map or truly impassable, or a number is out of range.
    """

    def __init__(
        self,
        ground: SurveyedGround,
        start: Cell,
        goal: Cell,
        rng: np.random.Generator,
        *,
        sight: int = 12,
        speed: int = 1,
        changes: int = 1,
    ) -> None:
        for name, value, least in (("sight", sight, 1), ("speed", speed, 1), ("changes", changes, 0)):
            if value < least:
                raise InvalidQueryError(f"{name} must be at least {least}, got {value}")
        rows, cols = ground.true.shape
        for name, cell in (("start", start), ("goal", goal)):
            if not (0 <= cell[0] < rows and 0 <= cell[1] < cols):
                raise InvalidQueryError(f"{name} {cell} lies outside the map of {rows} × {cols} cells")
            if not ground.true[cell] < OBSTACLE:
                raise InvalidQueryError(f"{name} {cell} is impassable")
        self.ground, self.robot, self.goal = ground, start, goal
        self.obstacles = Obstacles((rows, cols), rng)
        self.known = ground.surveyed.copy()
        """(H, W) what has been seen or surveyed, without obstacles."""
        for cell in (start, goal):
            part = self._around(cell, sight)
            self.known[_slices(part)] = ground.true[_slices(part)]
        self.told = self.known.copy()
        """(H, W) the map as the loop has been given it."""
        self.driven: list[Cell] = [start]
        """Cells that the robot walked over, each next to the one before."""
        self.polls = self.waited = self.forbidden = self.answers = 0
        """`forbidden`: published paths that crossed a cell which the map that was told forbids, or were broken."""
        self._sight, self._speed, self._changes = sight, speed, changes
        self.seen = self._around(start, sight)
        """(row, col, rows, cols) of what the robot sees."""
        self.path = np.empty((0, 2), np.int32)
        """The newest that was published."""

    @property
    def reached(self) -> bool:
        """Whether the robot is at its goal."""
        return self.robot == self.goal

    def poll(self) -> Iterator[Input]:
        """What happens until the next tick. Each message counts as told once it is taken."""
        first = self.polls == 0
        self.polls += 1
        if first:
            yield Goal(*self.goal)
        else:
            self._walk()
        parts = [
            part for _ in range(self._changes) for part in self.obstacles.one_event(self.robot, self.goal, self.path)
        ]
        self.seen = seen = self._around(self.robot, self._sight)
        self.known[_slices(seen)] = self.ground.true[_slices(seen)]
        yield from self._patches((*parts, seen))
        yield Pose(self.robot[0] + 0.5, self.robot[1] + 0.5)

    def send_to(self, goal: Cell) -> Iterator[Input]:
        """Give the robot another goal; obstacles too near to it vanish."""
        self.goal = goal
        self.path = self.path[:0]
        yield Goal(*goal)
        yield from self._patches(self.obstacles.clear_of(goal))

    def _patches(self, parts: Iterable[Rectangle]) -> Iterator[MapPatch]:
        """What is known of these parts, and the obstacles there."""
        for part in parts:
            cost = self.obstacles.cover(self.known, part)
            self.told[_slices(part)] = cost
            yield MapPatch(part[0], part[1], cost=cost)

    def heard(self, message: PathMessage) -> None:
        """Take the loop's answer, which is checked by the definition of a path that can be walked."""
        self.answers += 1
        self.path = message.path
        if message.ok and not walkable(message.path, self.told, message.goal):
            self.forbidden += 1

    def _walk(self) -> None:
        """Along the path, while the next cell is truly free."""
        before = self.robot
        at = np.flatnonzero((self.path == self.robot).all(axis=1))
        if len(at):
            for row, col in self.path[at[0] + 1 : at[0] + 1 + self._speed].tolist():
                if not self.obstacles.cover(self.ground.true, (row, col, 1, 1))[0, 0] < OBSTACLE:
                    break
                self.robot = (row, col)
                self.driven.append(self.robot)
        self.waited += self.robot == before

    def _around(self, cell: Cell, radius: int) -> Rectangle:
        row, col = max(cell[0] - radius, 0), max(cell[1] - radius, 0)
        rows, cols = self.ground.true.shape
        return row, col, min(cell[0] + radius + 1, rows) - row, min(cell[1] + radius + 1, cols) - col


def walkable(path: NDArray[np.int32], cost: Float2D, goal: Cell | None) -> bool:
    """Whether a path leads to the goal over passable cells of a cost map, each next to the one before."""
    before: tuple[int, int] | None = None
    rows, cols = cost.shape
    for row, col in path.tolist():
        if not (0 <= row < rows and 0 <= col < cols) or not cost[row, col] < OBSTACLE:
            return False
        if before is not None and max(abs(row - before[0]), abs(col - before[1])) != 1:
            return False
        before = (row, col)
    return before is not None and before == goal


def _slices(part: Rectangle) -> tuple[slice, slice]:
    row, col, rows, cols = part
    return slice(row, row + rows), slice(col, col + cols)
