"""A planner whose regions are searched by D* Lite, mended from one query to the next."""

import math
from enum import Enum, auto
from typing import Any

import numpy as np

from nnpp_edge.runtime.arrays import Float2D
from nnpp_edge.runtime.cells import Cell, Rectangle, apart, gather
from nnpp_edge.runtime.compiled.kernel import kernel
from nnpp_edge.runtime.kernels.expansion import octile
from nnpp_edge.runtime.map.grid import Change
from nnpp_edge.runtime.map.pyramid import FACTOR
from nnpp_edge.runtime.map.region import Region
from nnpp_edge.runtime.planners.plan import Method, Plan, Source
from nnpp_edge.runtime.planners.planner import Planner
from nnpp_edge.runtime.planners.query import Query
from nnpp_edge.runtime.search.astar import Search
from nnpp_edge.runtime.search.dstar_lite import DStarLite

_MOST_JOINED = 3
"""Regions are joined as long as they hold at most so many times the blocks of the newest."""
_DEARER = 2.5
"""Time that D* Lite takes to expand a cell, over what A* takes."""
_MOST_CHANGES = 64
"""Rectangles that are kept apart; one more and they are taken for the one that holds them all."""
_MENDED_TWICE = 2.0
"""Cells that became dearer, and all whose path led over them, are expanded twice: first to be given up."""


class Mending(Enum):
    """How regions are searched."""

    NEVER = auto()
    """By A*, afresh."""
    ALWAYS = auto()
    """By D* Lite."""
    WHERE_LESS_WORK = auto()
    """By whichever is expected to take less time."""


class DStarPlanner(Planner):
    """A planner that can search its regions by D* Lite, which it keeps from one query to the next.

    D* Lite takes note of every change, and works only when it is asked. Coarse levels and the whole map are searched
    afresh. Worth it for queries towards one goal: another goal starts D* Lite afresh.
    """

    overlooked = 0.02
    """As for `Planner`: what is passable is read from the newest map in any case, and a look takes as long as a short
    search."""
    mending = Mending.NEVER
    """How the next queries' regions are searched."""
    _dstar: DStarLite | None = None
    _known: Region | None = None
    """What D* Lite has searched; None where it has forgotten all."""
    _last: Region | None = None
    """What was searched last, by either."""
    _beginnings = 0
    """How often D* Lite had forgotten all by its last search."""
    _missed = 0.0
    """What mending would have saved since it was last done, had it been done each time, in fresh searches."""

    def __init__(self, cost: Float2D, **options: Any) -> None:
        super().__init__(cost, **options)
        self._changes: list[Rectangle] = []
        """Since the last region was searched."""

    def take(self, row: int, col: int, patch: Float2D, *, keep: bool = False) -> Change:
        """As `Planner.take`; D* Lite takes note."""
        change = super().take(row, col, patch, keep=keep)
        if self._dstar is not None and change.cells:
            self._dstar.cells_changed(*change.part)
            gather(self._changes, change.part, _MOST_CHANGES)
        return change

    def expect(self, goal: Cell) -> None:
        """Set D* Lite up for queries to this goal, in a region that holds nothing yet."""
        if self._dstar is None:
            self._dstar = DStarLite(self.grid, goal, corner_cutting=self.corner_cutting)
            self._dstar.touch()
        elif self._dstar.goal != goal:
            self._dstar.set_goal(goal)
        corridor = (2 * math.ceil(self.grid.rows / FACTOR), 2 * math.ceil(self.grid.cols / FACTOR))
        self._dstar.set_region(Region(np.zeros(corridor, np.int32), *self.pyramid.levels[0].quarters))
        self._dstar.plan(goal)  # so that the cells left out are dealt with now
        self._known = self._last = None
        self._changes.clear()
        self._missed, self._beginnings = 0.0, self._dstar.beginnings

    def mends(self, goal: Cell) -> bool:
        """Whether there is a search to be mended, for this goal."""
        return self._dstar is not None and self._dstar.goal == goal and self._known is not None

    def mend(self, query: Query) -> Plan:
        """Search the region that D* Lite knows again, from another start and on the map as it is now."""
        return self._answer(query, Method.CORRIDOR, Source.REGION, self._in_region(query), None)

    def _search(
        self, query: Query, level: int, region: Region | None, band: float = 0.0, limit: int | None = None
    ) -> Search:
        if level == 0:
            query.account = ""
        if level or region is None or self.mending is Mending.NEVER or query.start == query.goal:
            return super()._search(query, level, region, band, limit)
        if self._dstar is None or self._dstar.goal != query.goal:
            self.expect(query.goal)
        assert self._dstar is not None
        self._dstar.move_start(query.start)
        if self.mending is Mending.WHERE_LESS_WORK and not self._worth_mending(query, region):
            return super()._search(query, level, region, band)
        self._last, self._known = region, self._joined(region)
        self._dstar.set_region(self._known)
        return self._in_region(query)

    def _worth_mending(self, query: Query, region: Region) -> bool:
        """Whether D* Lite is expected to search a region with less work than A*, now or before long.

        A fresh search expands most of a region. D* Lite expands the cells that are new to it, and twice those
        that lie between the start and a change, and takes longer for each. What a fresh search leaves unmended is to
        be mended later: once steps that D* Lite would have made cheaply sum to what that is dearer by, it is mended
        after all. What such a step would have taken is put down by the distances of the changes.
        """
        assert self._dstar is not None
        if self._dstar.beginnings != self._beginnings:
            self._known = None
        mended = _DEARER * _new_share(region, self._known)
        looked = mended <= 1.0 + self._missed
        if looked:
            mended += _DEARER * _MENDED_TWICE * self._dstar.reach()
        step = _DEARER * _MENDED_TWICE * self._reach(query)
        if step < 1.0:
            step += _DEARER * _new_share(region, self._last)
        self._last = region
        self._changes.clear()
        worth = mended <= 1.0 + self._missed
        if not worth:
            self._missed += max(1.0 - step, 0.0)
        did = "mended" if worth else "searched afresh"
        least = "" if looked else "at least "
        query.account = f"{did}: mending was put at {least}{mended:.2f} times the work of a fresh search"
        return worth

    def _reach(self, query: Query) -> float:
        """As `DStarLite.reach`, by distances as the king moves."""
        nearest = min((apart(part, query.goal) for part in self._changes), default=query.apart)
        return max(1.0 - nearest / query.apart, 0.0)

    def _joined(self, region: Region) -> Region:
        """The region together with the last one: to D* Lite, cells that leave are much work, and stay for nothing."""
        wanted, known = region.bitmap == region.stamp, self._known
        both = wanted | (known.bitmap == known.stamp) if known and _comparable(region, known) else wanted
        if np.count_nonzero(both) > _MOST_JOINED * np.count_nonzero(wanted):
            both = wanted
        return Region(both.astype(np.int32), region.row_block, region.col_block)

    def _in_region(self, query: Query) -> Search:
        assert self._dstar is not None
        found = self._dstar.plan(query.start, deadline=query.deadline, cancelled=query.cancelled)
        query.expansions += found.expansions
        self._missed, self._beginnings = 0.0, self._dstar.beginnings
        self._changes.clear()
        query.lap("search")
        # D* Lite does not say what it refused: the octile distance is the bound
        straight = octile.py_func(*query.start, *query.goal, *self.grid.prices)
        return Search(found.status, found.path, found.expansions, straight)


def _comparable(one: Region, other: Region) -> bool:
    """Whether their bitmaps have the same blocks."""
    return one.bitmap.shape == other.bitmap.shape and one.row_block is other.row_block


def _new_share(region: Region, known: Region | None) -> float:
    """The share of a region's blocks that are outside another; None holds nothing."""
    if known is None or not _comparable(region, known):
        return 1.0
    blocks, new = _count(region.bitmap, region.stamp, known.bitmap, known.stamp)
    return new / blocks if blocks else 0.0


@kernel
def _count(bitmap, stamp, known, known_stamp):
    """How many blocks a region has, and how many of them are outside another."""
    blocks, new = 0, 0
    for i in range(bitmap.shape[0]):
        for j in range(bitmap.shape[1]):
            inside = bitmap[i, j] == stamp
            blocks += inside
            new += inside and known[i, j] != known_stamp
    return blocks, new
