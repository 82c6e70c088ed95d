"""A path by way of several places: in the order given, or in the order that costs least."""

import itertools
import math
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from nnpp_edge.runtime.arrays import Floats
from nnpp_edge.runtime.cells import Cell
from nnpp_edge.runtime.deadline import NEVER, Deadline, OutOfTimeError
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.map.along import joined
from nnpp_edge.runtime.map.grid import Grid
from nnpp_edge.runtime.options import STATES
from nnpp_edge.runtime.planners.plan import Method, Plan, Source
from nnpp_edge.runtime.planners.query import in_words
from nnpp_edge.runtime.stopwatch import Work

MOST_ORDERED = 12
"""Places between start and goal whose best order is looked for: 12! orders, 12² · 2^12 sums."""
_TIE = 1e-5
"""Share by which another order must cost less than the one given: sums of rounded costs differ by
less.
"""

_SUMMED = ("length", "line_cost", "lower_bound")
"""Figures of a tour's plan that are those of its legs together."""
PlanLeg = Callable[..., Plan]
Order = tuple[int, ...]
"""Numbers of the places between, counted from 0 as they were given."""


@dataclass(frozen=True)
class Tour:
    """A path from start to goal by way of other places."""

    stops: tuple[Cell, ...]
    """Start, the places between in the order in which they are visited, and goal."""
    order: tuple[int, ...]
    """Numbers of the places between, counted from 0 as they were given."""
    legs: tuple[Plan, ...]
    """From each stop to the next; up to the first that has no path."""
    plan: Plan
    """The legs as one plan. Its lower bound is that of this order. Without a path from one stop
    to the next its status is that leg's, and its reason names the leg."""
    given_cost: float = math.nan
    """Cost of the order given; NaN where no other was looked for, inf where a body finds no
    path by it.
    """

    def told(self, on_the_ground: Callable[[Plan], Plan]) -> "Tour":
        """This tour with what the function adds to each of its plans."""
        return replace(
            self, legs=tuple(map(on_the_ground, self.legs)), plan=on_the_ground(self.plan)
        )


def tour(
    plan: PlanLeg,
    stops: Sequence[Cell],
    grid: Grid,
    *,
    best_order: bool = False,
    finish: Callable[[Plan], Plan] = lambda leg: leg,
    deadline: Deadline = NEVER,
) -> Tour:
    """A path along stops, which are start, the places between, and goal, each leg planned by
    itself.

    Parameters
    ----------
    grid : Grid
        Of the map, filled where paths lead.
    best_order : bool
        Visit the places between in the order that costs least, by what lies between each two stops.
        To turn at the stops costs a body more: the order given stays where it then costs less.
    finish : callable
        Applied to the plans of a whole tour's legs, and not to those that were made for the order
        alone.
    deadline : Deadline
        When to stop looking for a better order: then it is the one given.

    Raises
    ------
    InvalidQueryError
        A place between start and goal lies outside the map or is impassable, or more than
        `MOST_ORDERED` are to be ordered.
    """
    watch = Work()
    legs = _Legs(plan, stops, grid)
    count = len(stops) - 2
    given_cost = math.nan
    order = given = tuple(range(count))
    if best_order and count:
        if count > MOST_ORDERED:
            raise InvalidQueryError(
                f"the best order is found of at most {MOST_ORDERED} places, got {count}"
            )
        with suppress(OutOfTimeError):
            order, given_cost = legs.best_order(given, deadline)

    def by(order: Order) -> Tour:
        found = legs.driven(order, finish)
        ordered = stops[0], *(stops[each + 1] for each in order), stops[-1]
        return Tour(ordered, order, tuple(found), _as_one(found, ordered, grid), given_cost)

    made = by(order)
    # legs alone cost less than all as one, where the robot must turn between them
    if grid.robot.moves.over == STATES and not math.isnan(given_cost):
        as_given = made if order == given else by(given)
        cheaper = min(as_given, made, key=lambda each: each.plan.cost)
        made = replace(cheaper, given_cost=as_given.plan.cost)
    total = watch.total_ms()
    timings = dict(made.plan.timings_ms)
    if best_order:
        timings["order"] = total - sum(leg.timings_ms.get("total", 0.0) for leg in made.legs)
    timings["total"] = total
    return replace(made, plan=replace(made.plan, timings_ms=timings))


class _Legs:
    """Plans between stops, each made once."""

    def __init__(self, plan: PlanLeg, stops: Sequence[Cell], grid: Grid) -> None:
        self._plan = plan
        self._stops = stops
        self._grid = grid
        self._symmetric = grid.robot.symmetric
        """Whether a path costs the same both ways, and is driven so: then one plan serves a leg and
        its reverse.
        """
        self._made: dict[tuple[int, int], Plan] = {}

    def plan(self, begin: int, end: int) -> Plan:
        """From one stop, by its number, to another; InvalidQueryError for a place between that is
        none.
        """
        if (begin, end) in self._made:
            return self._made[begin, end]
        back = self._made.get((end, begin)) if self._symmetric else None
        if back is not None and back.ok:
            along = None if back.along is None else back.along.back()
            plan = replace(back, path=back.path[::-1].copy(), along=along)
        else:
            plan = self._plan(self._stops[begin], self._stops[end])
            at = begin if plan.status.startswith("START") else end
            # of start and goal the status tells
            if plan.source is None and 0 < at < len(self._stops) - 1:
                raise InvalidQueryError(f"via {at}, {self._stops[at]}, {in_words(plan.status)}")
        self._made[begin, end] = plan
        return plan

    def driven(self, order: Order, finish: Callable[[Plan], Plan]) -> list[Plan]:
        """Finished plans of the legs in this order, up to the first that has no path; a body sets
        out on each as it has arrived.
        """
        found: list[Plan] = []
        for begin, end in self.along(order):
            leg = self.plan(begin, end)
            heading = self._grid.robot.moves.arrival(found[-1].walked) if found and leg.ok else -1
            if heading >= 0:
                leg = self._plan(self._stops[begin], self._stops[end], direction=heading)
            found.append(finish(leg))
            if not found[-1].ok:
                break
        return found

    def best_order(self, given: Order, deadline: Deadline) -> tuple[Order, float]:
        """The cheapest order of the stops between the first and the last, and what the order given
        costs.

        The order given, and NaN, where a leg that was planned has no path. The legs of the cheapest
        order by what is known, others being as cheap as they can be, are planned until none is left
        to plan: no other order can then be cheaper, though most legs were never planned.
        OutOfTimeError at the deadline.
        """
        stops = self._stops
        known = np.eye(len(stops), dtype=np.bool_)
        legs = self.along(given)
        costs = np.array([[self._grid.least_cost(begin, end) for end in stops] for begin in stops])
        while legs:
            for leg in legs:
                if not (plan := self.plan(*leg)).ok:
                    return given, math.nan
                for pair in (leg, leg[::-1])[: 1 + self._symmetric]:
                    costs[pair] = plan.cost
                    known[pair] = True
            order, given_cost = _cheapest_order(costs, deadline)
            legs = [leg for leg in self.along(order) if not known[leg]]
        return order, given_cost

    def along(self, order: Order) -> list[tuple[int, int]]:
        """Numbers of the stops at both ends of each leg; of the stops between the order counts from
        0.
        """
        visited = [0, *(each + 1 for each in order), len(self._stops) - 1]
        return list(itertools.pairwise(visited))


def _cheapest_order(costs: Floats, deadline: Deadline) -> tuple[Order, float]:
    """The cheapest order of the stops between the first and the last, and what the order given
    costs.

    Held and Karp (1962): the cheapest way through each set of stops that ends at each of its
    members.
    """
    count = len(costs) - 2
    inner = costs[1:-1, 1:-1]
    members = 1 << np.arange(count)
    sets = np.arange(1 << count)
    sizes = np.bitwise_count(sets)
    cheapest = np.full((1 << count, count), math.inf)
    cheapest[members, np.arange(count)] = costs[0, 1:-1]
    for size in range(1, count):
        deadline.check()
        visited = sets[sizes == size]
        ways = (cheapest[visited][:, :, None] + inner).min(1)
        at, new = np.nonzero(visited[:, None] & members == 0)
        cheapest[visited[at] | members[new], new] = ways[at, new]
    given = float(costs.diagonal(1).sum())
    onwards = costs[1:-1, -1]
    if (cheapest[-1] + onwards).min() >= given * (1.0 - _TIE):
        return tuple(range(count)), given
    # back from the goal
    order: list[int] = []
    left = (1 << count) - 1
    while left:
        last = int((cheapest[left] + onwards).argmin())
        order.append(last)
        left &= ~(1 << last)
        onwards = inner[:, last]
    return tuple(reversed(order)), given


def _as_one(legs: Sequence[Plan], stops: Sequence[Cell], grid: Grid) -> Plan:
    """Legs along stops, each of which begins where the one before ends, as one plan; the last may
    have no path.
    """
    first = legs[0]
    last = legs[-1]
    wanted = len(stops) - 1
    if wanted == 1:
        return first
    alike = len({leg.method for leg in legs}) == 1
    timings = Counter[str]()
    for leg in legs:
        timings.update(leg.timings_ms)
    sources = [leg.source for leg in legs if leg.source]
    whole = Plan(
        last.status,
        first.method if alike else Method.AUTO,
        last.source and max(sources, key=list(Source).index),
        expansions=sum(leg.expansions for leg in legs),
        planner=first.planner if alike else Method.AUTO,
        choice=f"{wanted} legs",
        costs_computed=last.costs_computed,
        checks=sum(leg.checks for leg in legs),
        timings_ms=dict(timings),
    )
    if not last.ok:
        count = len(legs)
        name = f"leg {count} of {wanted}, from {stops[count - 1]} to {stops[count]}"
        return replace(whole, reason=": ".join(filter(None, (name, last.reason))))
    walked = joined([leg.walked for leg in legs]).astype(np.int32)
    costs = grid.costs_of(walked)
    lines = [leg.waypoints for leg in legs if leg.waypoints is not None]
    arcs = first.states is not None
    return replace(
        whole,
        path=np.ascontiguousarray(walked[:, :2]),
        states=walked[:, 2].copy() if arcs else None,
        vehicle=first.vehicle,
        along=first.along if arcs else None,  # of which `Plan.over` needs the cells' sides
        waypoints=joined(lines).astype(np.float64) if len(lines) == len(legs) else None,
        cost=costs[0] if grid.robot.moves.over == STATES else sum(leg.cost for leg in legs),
        traverse_cost=costs[2],
        **{name: sum(getattr(leg, name) for leg in legs) for name in _SUMMED},
    )
