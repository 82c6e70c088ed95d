"""A small simulated world for the onboard loop: ground that is not what the map says, a robot, and obstacles."""

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Cell
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.loop.messages import Goal, Input, MapPatch, PathMessage, Pose
from nnpp_edge.runtime.terrain.traversability import Traversability, traversability_cost

OBSTACLE = 1.0
"""Traversability cost of an obstacle: impassable."""
_CLEAR = 3
"""Cells around robot and goal that no obstacle covers."""
_MOST_OBSTACLES = 12
_ACROSS_THE_PATH = 0.5
"""Share of the obstacles that appear on the path ahead; the others appear anywhere."""

Block = tuple[int, int, int, int]
"""(row, col, rows, cols)."""


class Obstacles:
    """Rectangles that appear, move and vanish, the same for the same generator.

    Parameters
    ----------
    shape : (H, W)
        Of the map.
    rng : numpy.random.Generator
        Of every choice.
    """

    def __init__(self, shape: tuple[int, int], rng: np.random.Generator) -> None:
        self.shape, self._rng = shape, rng
        self.blocks: list[Block] = []
        longest = max(max(shape) // 12, 2)
        self._sides = (min(2, *shape), longest)

    def step(self, robot: Cell, goal: Cell, path: NDArray[np.int32]) -> list[Block]:
        """One event; the rectangles of the map that are to be looked at again (none where no place was free)."""
        rng, blocks = self._rng, self.blocks
        if not blocks or (len(blocks) < _MOST_OBSTACLES and rng.random() < 0.4):
            block = self._new(path)
            if self._near(block, robot) or self._near(block, goal):
                return []
            blocks.append(block)
            return [block]
        at = int(rng.integers(len(blocks)))
        old = blocks[at]
        if rng.random() < 0.4:
            del blocks[at]
            return [old]
        row, col, rows, cols = old
        row = int(np.clip(row + rng.integers(-2, 3), 0, self.shape[0] - rows))
        col = int(np.clip(col + rng.integers(-2, 3), 0, self.shape[1] - cols))
        new = (row, col, rows, cols)
        if new == old or self._near(new, robot) or self._near(new, goal):
            return []
        blocks[at] = new
        return [old, new]

    def clear_of(self, cell: Cell) -> list[Block]:
        """Take away those that are too near to a cell, and name them."""
        near = [block for block in self.blocks if self._near(block, cell)]
        self.blocks = [block for block in self.blocks if block not in near]
        return near

    def lay(self, ground: Float2D, part: Block) -> Float2D:
        """A copy of a part of the ground with the obstacles on it."""
        row, col, rows, cols = part
        out = ground[row : row + rows, col : col + cols].copy()
        for top, left, height, width in self.blocks:
            here = out[
                max(top - row, 0) : max(top + height - row, 0), max(left - col, 0) : max(left + width - col, 0)
            ]
            np.maximum(here, np.float32(OBSTACLE), out=here)
        return out

    def _new(self, path: NDArray[np.int32]) -> Block:
        rng = self._rng
        rows, cols = (min(int(rng.integers(self._sides[0], self._sides[1] + 1)), n) for n in self.shape)
        if len(path) > 2 and rng.random() < _ACROSS_THE_PATH:
            middle = path[int(rng.integers(1, len(path) - 1))]
        else:
            middle = rng.integers(0, self.shape)
        row = int(np.clip(middle[0] - rows // 2, 0, self.shape[0] - rows))
        col = int(np.clip(middle[1] - cols // 2, 0, self.shape[1] - cols))
        return row, col, rows, cols

    @staticmethod
    def _near(block: Block, cell: Cell) -> bool:
        row, col, rows, cols = block
        return row - _CLEAR <= cell[0] < row + rows + _CLEAR and col - _CLEAR <= cell[1] < col + cols + _CLEAR


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
    ground : SurveyedGround
        True and surveyed costs.
    start, goal : (row, col)
        Cells that are truly passable. Around both the true costs are known from the beginning.
    rng : numpy.random.Generator
        Of the obstacles.
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
        parts = [part for _ in range(self._changes) for part in self.obstacles.step(self.robot, self.goal, self.path)]
        self.seen = seen = self._around(self.robot, self._sight)
        self.known[_slices(seen)] = self.ground.true[_slices(seen)]
        for part in (*parts, seen):
            cost = self.obstacles.lay(self.known, part)
            self.told[_slices(part)] = cost
            yield MapPatch(part[0], part[1], cost=cost)
        yield Pose(self.robot[0] + 0.5, self.robot[1] + 0.5)

    def send_to(self, goal: Cell) -> Iterator[Input]:
        """Give the robot another goal; obstacles too near to it vanish."""
        self.goal = goal
        self.path = self.path[:0]
        yield Goal(*goal)
        for part in self.obstacles.clear_of(goal):
            cost = self.obstacles.lay(self.known, part)
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
                if not self.obstacles.lay(self.ground.true, (row, col, 1, 1))[0, 0] < OBSTACLE:
                    break
                self.robot = (row, col)
                self.driven.append(self.robot)
        self.waited += self.robot == before

    def _around(self, cell: Cell, radius: int) -> Block:
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


def _slices(part: Block) -> tuple[slice, slice]:
    row, col, rows, cols = part
    return slice(row, row + rows), slice(col, col + cols)
