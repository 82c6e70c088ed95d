"""One tab's trial: what it asks, the map that this is asked of, and the newest plan."""

import math
from dataclasses import dataclass
from statistics import median

import msgspec

from nnpp_edge.runtime import Plan
from nnpp_edge.runtime.cells import Cell, Rectangle
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.view.asked import METHODS, Asked, changed
from nnpp_edge.view.landscape import Landscape
from nnpp_edge.view.mending import Mended, Mending
from nnpp_edge.view.site import Site

MOST_OBSTACLES = 200
_REPEATS = 3
_LONG_MS = 100.0
"""A plan that takes longer is not repeated for its median time."""


@dataclass(frozen=True)
class Compared:
    """A method's plan with its region, the median time, and exact A*'s cost on the same map."""

    plan: Plan
    time_ms: float
    optimum: float

    @property
    def gap(self) -> float | None:
        """Share above the optimum; None without both paths."""
        if not (self.plan.ok and math.isfinite(self.optimum)):
            return None
        return (self.plan.cost - self.optimum) / abs(self.optimum) if self.optimum else 0.0


class Trial:
    """One tab's questions to the site, and the answers. Serves one thread at a time.

    The site is shared with other tabs, and never changed; `landscape` is that of the first question, where it is
    there already. NnppEdgeError as of `Landscape`; later questions raise it too, and leave everything as it was.
    """

    def __init__(self, site: Site, asked: Asked, landscape: Landscape | None = None) -> None:
        self.site = site
        self._ask(asked, landscape or Landscape(site, asked))

    def _ask(self, asked: Asked, landscape: Landscape) -> None:
        """Ask of another map; what belonged to the one before is forgotten."""
        self.plan = landscape.plan(asked, asked.method)
        self.asked, self.landscape = asked, landscape
        self._mending: Mending | None = None
        self._mended: tuple[Rectangle, ...] = ()
        self._optimum: tuple[Cell, Cell, float] | None = None

    def change(self, values: dict[str, object]) -> bool:
        """Ask with other values of `Asked`, by their names; whether that is another map."""
        asked = changed(self.asked, values)
        if asked.obstacles != self.asked.obstacles:
            raise InvalidQueryError("obstacles are painted, not set")
        if another := not asked.same_map(self.asked):
            self._ask(asked, Landscape(self.site, asked))
        else:
            self.plan, self.asked = self.landscape.plan(asked, asked.method), asked
        return another

    def compare(self, method: str) -> Compared:
        """Plan by one of the methods beside the others, and with its region."""
        if method not in METHODS:
            raise InvalidQueryError(f"method must be one of {', '.join(METHODS)}, got {method!r}")
        plans = [self.landscape.plan(self.asked, method, keep_regions=True)]
        if plans[0].timings_ms.get("total", _LONG_MS) < _LONG_MS:
            plans += [self.landscape.plan(self.asked, method, keep_regions=True) for _ in range(_REPEATS)]
        times = [plan.timings_ms.get("total", 0.0) for plan in plans[1:] or plans]
        return Compared(plans[-1], median(times), self._optimal_cost())

    def _optimal_cost(self) -> float:
        """Of exact A* between the ends; kept until they or the map change."""
        ends = self.asked.start, self.asked.goal
        if self._optimum is None or self._optimum[:2] != ends:
            self._optimum = (*ends, self.landscape.plan(self.asked, "astar").cost)
        return self._optimum[2]

    def paint(self, part: Rectangle) -> None:
        """Make the cells of a rectangle, clipped to the map, impassable, and plan anew."""
        (row, col, rows, cols), (height, width) = part, self.site.dem.shape
        row0, col0, row1, col1 = max(row, 0), max(col, 0), min(row + rows, height), min(col + cols, width)
        if row0 >= row1 or col0 >= col1:
            raise InvalidQueryError(f"an obstacle must cover cells of the map of {(height, width)}, got {part}")
        if len(self.asked.obstacles) >= MOST_OBSTACLES:
            raise InvalidQueryError(f"wanted at most {MOST_OBSTACLES} obstacles: undo some")
        clipped = row0, col0, row1 - row0, col1 - col0
        self._put((*self.asked.obstacles, clipped), clipped)

    def mend(self) -> Mended:
        """Work of mending the path for the obstacles that came or went since the last time, else for the last."""
        obstacles, landscape = self.asked.obstacles, self.landscape
        mending = self._mending
        if mending is None or mending.goal != self.asked.goal:
            mending, before = Mending(landscape.ground, self.asked), obstacles[:-1]
            mending.lay(before, before)
            self._mended = before
        mended = mending.mend(self.asked.start, set(self._mended) ^ set(obstacles), obstacles)
        self._mending, self._mended = mending, obstacles
        return mended

    def undo(self) -> bool:
        """Take the last obstacle away; whether there was one."""
        if not self.asked.obstacles:
            return False
        *rest, part = self.asked.obstacles
        self._put(tuple(rest), part)
        return True

    def clear(self) -> None:
        """Take all obstacles away."""
        while self.undo():
            pass

    def _put(self, obstacles: tuple[Rectangle, ...], part: Rectangle) -> None:
        """Other obstacles, which differ in this one."""
        self.landscape.lay(part, obstacles)
        self._optimum = None
        self.asked = msgspec.structs.replace(self.asked, obstacles=obstacles)
        self.plan = self.landscape.plan(self.asked, self.asked.method)
