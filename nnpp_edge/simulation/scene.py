"""A small simulated world for the onboard loop: ground that is not what the map says, a robot, and
obstacles.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np

from nnpp_edge.runtime import Goal, MapPatch, PathMessage, Pose
from nnpp_edge.runtime.arrays import Cells, Float2D
from nnpp_edge.runtime.cells import Cell, Rectangle, slices, widened
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.loop.messages import Input
from nnpp_edge.runtime.options import StepOptions
from nnpp_edge.simulation.ground import SurveyedGround
from nnpp_edge.terrain.obstacles import CLEAR, Obstacles


@dataclass(frozen=True)
class SimulationSettings:
    """How a drive goes."""

    method: str = "auto"
    model: str = "edge"
    rate_hz: float | None = None
    """Ticks a second, as on a robot. None for as fast as possible, without deadlines: the drive
    depends on the seed alone, and answers that take over a tenth of a second are counted as late.
    """
    ticks: int = 5000
    """The drive ends after so many, at the goal or not."""
    changes: int = 1
    """Events of obstacles between two ticks: one appears, moves or vanishes."""
    sight: int = 12
    """Cells that the robot sees to each side, beyond those under its body."""
    speed: int = 1
    """Cells that it walks between two ticks."""
    seed: int = 1
    """Of the obstacles."""
    endless: bool = False
    """Whether the robot drives on to another goal where it has reached one, or cannot, until the
    ticks are over.
    """
    steps: StepOptions = field(default_factory=StepOptions)
    """Of the loop's planner, and of the one that knows all."""


class Scene:
    """The ground, what the robot has been told of it, and the robot; an `InputSource` that advances
    at each poll.

    At a poll the robot walks on, `speed` cells along the newest path, as far as that is free,
    obstacles change (`changes` events), and the robot sees the true cost of the cells around it,
    `sight` to each side beyond those under its body, at least 1. Obstacles, which `rng` draws, are
    told at once, wherever they are. InvalidQueryError where start or goal, around which the true
    costs are known from the beginning, is outside the map or truly impassable.
    """

    def __init__(
        self,
        ground: SurveyedGround,
        start: Cell,
        goal: Cell,
        rng: np.random.Generator,
        settings: SimulationSettings,
    ) -> None:
        rows, cols = ground.true.shape
        for name, (row, col) in (("start", start), ("goal", goal)):
            if not (0 <= row < rows and 0 <= col < cols):
                raise InvalidQueryError(
                    f"{name} {(row, col)} lies outside the map of {rows} × {cols} cells"
                )
            if not ground.stands(ground.true, (row, col)):
                raise InvalidQueryError(f"{name} {ground.in_file((row, col))} is impassable")

        # the world
        self.ground = ground
        self.robot = start
        self.goal = goal
        self._settings = settings
        self._sight = settings.sight + ground.reach
        self.obstacles = Obstacles(
            (rows, cols), rng, value=ground.obstacle(ground.true), clear=max(CLEAR, ground.reach)
        )
        self.now = ground.true.copy()
        """(H, W) the ground with the obstacles that are there."""

        # what the robot knows of it
        self.known = ground.surveyed.copy()
        """(H, W) what has been seen or surveyed, without obstacles."""
        if ground.known is None:
            self._see(goal)
        self.seen = self._see(start)
        """The part of the map in sight."""
        self.told = self.known.copy()
        """(H, W) the map as the loop has been given it."""
        self._orders: list[Input] = [Goal(*goal)]

        # the drive
        self.path = np.empty((0, 2), np.int32)
        """The newest that was published; of a body that drives arcs (N, 3), with its states."""
        self._headings = np.empty(0)
        self.driven: list[tuple[int, ...]] = [start]
        """Cells that the robot walked over, each next to the one before; with its states where
        it drives arcs."""
        self.heading_deg: float | None = None
        """Of a body, once it has begun to drive."""
        self.polls = 0
        self.waited = 0
        self.forbidden = 0
        """Published paths that are broken or cross a cell which the map that was told forbids."""

    @property
    def reached(self) -> bool:
        """Whether the robot is at its goal."""
        return self.robot == self.goal

    def poll(self) -> Iterator[Input]:
        """Move on, and give the messages until the next tick; each counts as told once taken."""
        if self.polls:
            self._walk()
        self.polls += 1
        orders = self._orders
        self._orders = []
        yield from orders
        changed: list[Rectangle] = []
        for _ in range(self._settings.changes):
            changed += self.obstacles.one_event(self.robot, self.goal, self.path[:, :2])
        self.seen = self._see(self.robot)
        yield from self._patches([*changed, self.seen])
        row, col = self.robot
        yield Pose(row + 0.5, col + 0.5, heading_deg=self.heading_deg)

    def send_to(self, goal: Cell) -> None:
        """Give the robot another goal, at the next poll; obstacles too near to it vanish, and the
        way so far.
        """
        self.goal = goal
        self.path = self.path[:0]
        self.driven = self.driven[-1:]
        self._orders = [Goal(*goal), *self._patches(self.obstacles.clear_of(goal))]

    def _patches(self, parts: Iterable[Rectangle]) -> Iterator[MapPatch]:
        """Known values of these parts, and the obstacles there."""
        for part in parts:
            at = slices(part)
            self.now[at] = self.obstacles.cover(self.ground.true, part)
            self.told[at] = self.obstacles.cover(self.known, part)
            yield self.ground.patch(part[0], part[1], self.told[at])

    def heard(self, message: PathMessage) -> None:
        """Take the loop's answer, which is checked by the definition of a path that can
        be walked.
        """
        self.path = message.walked
        self._headings = message.headings_deg
        if message.ok and not walkable(self.ground, self.path, self.told, message.goal):
            self.forbidden += 1

    def _walk(self) -> None:
        """Go along the path, while the next step is truly free."""
        at = np.flatnonzero((self.path[:, :2] == self.robot).all(axis=1))
        if not len(at):
            self.waited += 1
            return
        first = int(at[0])
        ahead = self.path[first : first + 1 + self._settings.speed]
        count = self.ground.steps(self.now, ahead) if len(ahead) > 1 else 0
        if count and len(self.driven[-1]) < ahead.shape[1]:
            self.driven[-1] = tuple(ahead[0].tolist())
        self.driven += map(tuple, ahead[1 : 1 + count].tolist())
        self.robot = tuple(ahead[count, :2].tolist())
        if ahead.shape[1] == 3:
            self.heading_deg = float(self._headings[first + count])
        elif self.ground.ground.body and count:  # as it came here
            self.heading_deg = float(self._headings[first + count - 1])
        self.waited += not count

    def _see(self, cell: Cell) -> Rectangle:
        """The robot's view from a cell, which it knows from now on."""
        part = widened((*cell, 1, 1), (self._sight, self._sight), self.known.shape)
        self.known[slices(part)] = self.ground.true[slices(part)]
        return part


def walkable(ground: SurveyedGround, path: Cells, values: Float2D, goal: Cell | None) -> bool:
    """Whether a path leads to the goal over a map, by steps or a body's legs, and the robot can
    take it.
    """
    if not len(path) or tuple(path[-1, :2].tolist()) != goal:
        return False
    cells = path[:, :2]
    if not ((cells >= 0) & (cells < values.shape)).all():
        return False
    if path.shape[1] == 2:
        apart = np.abs(np.diff(cells, axis=0)).max(axis=1)
        longest = 2 if ground.ground.body else 1
        if ((apart < 1) | (apart > longest)).any():
            return False
    first = tuple(cells[0].tolist())
    return ground.stands(values, first) and ground.steps(values, path) == len(path) - 1
