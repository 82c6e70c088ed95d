"""Wrong types at every public entry: what comes back is an error of the package, in one line."""

import inspect
import math

import numpy as np
import pytest

import nnpp_edge.runtime as runtime
from nnpp_edge.runtime import (
    DynamicPlanner,
    EnergyCost,
    Goal,
    Ground,
    InProcessSink,
    InProcessSource,
    IrmischerCost,
    LinearCost,
    Loop,
    MapPatch,
    Mobility,
    Navigator,
    NetworkModel,
    NnppEdgeError,
    Origin,
    PathMessage,
    Planner,
    Pose,
    Status,
    TimeCost,
    ToblerCost,
    Traversability,
    Vehicle,
    plan_path,
    pose_costs,
    traversability_cost,
)
from nnpp_edge.runtime.loop.timing import Ticker

COST = np.full((12, 14), 0.2, np.float32)
HEIGHTS = np.zeros((12, 14), np.float32)
ENDS = {"start": (1, 2), "goal": (9, 11)}
WRONG = [
    "0",
    None,
    [[1.0], [1.0, 2.0]],
    {},
    0.5,
    True,
    object(),
    b"x",
    10**400,
    -(10**30),
    math.nan,
    (1, "a"),
    1j,
]


PATCH = {"row": 1, "col": 1, "patch": COST[:2, :2]}
ENTRIES = {
    Planner: {"cost": COST},
    Planner.of_elevation: {"dem": HEIGHTS, "cell_size_m": 1.0},
    DynamicPlanner: {"cost": COST, "goal": (9, 11), "method": "astar"},
    DynamicPlanner.of_elevation: {
        "dem": HEIGHTS,
        "cell_size_m": 1.0,
        "goal": (9, 11),
        "method": "astar",
    },
    plan_path: {"cost": COST, **ENDS, "method": "astar"},
    traversability_cost: {"dem": HEIGHTS, "cell_size_m": 1.0},
    pose_costs: {"dem": HEIGHTS, "cell_size_m": 1.0, "vehicle": Vehicle(1.5, 1.0, 0.4)},
    Vehicle: {"length_m": 1.5, "width_m": 1.0, "clearance_m": 0.4},
    TimeCost: {"slope_deg": (-20.0, 0.0, 20.0), "speed_m_s": (0.1, 0.2, 0.1)},
    EnergyCost: {"mass_kg": 10.0, "rolling_resistance": 0.1},
    MapPatch: {"row": 1, "col": 1, "cost": COST},
    Pose: {"row": 1.0, "col": 1.0},
    Goal: {"row": 1, "col": 1},
    Loop: {
        "navigator": Navigator(Ground(COST), "astar"),
        "source": InProcessSource(),
    },
    Ground: {"elevation": HEIGHTS, "cell_size_m": 1.0},
    Ground.of_elevation: {"elevation": HEIGHTS, "cell_size_m": 1.0},
    Navigator: {"ground": Ground(COST), "method": "astar"},
    **{each: {} for each in (Traversability, Mobility, ToblerCost, IrmischerCost, LinearCost)},
    **{each: {} for each in (InProcessSource, InProcessSink, NetworkModel)},
}
"""Functions and classes, with arguments that do."""


def dynamic():
    made = DynamicPlanner(COST, (9, 11), "astar")
    made.move((1, 2))
    return made


METHODS = {
    lambda: Planner(COST): {
        "plan": {**ENDS, "method": "astar"},
        "plan_via": {**ENDS, "via": [(3, 3)], "method": "astar"},
        "nearest": {"start": (1, 2), "goals": [(3, 3)], "method": "astar"},
        "reach": {"start": (1, 2)},
        "update": PATCH,
        "use_model": {"model": "edge"},
        "prepare": {},
    },
    lambda: Planner.of_elevation(HEIGHTS, 1.0): {"update_elevation": PATCH},
    dynamic: {
        "set_goal": {"goal": (3, 3)},
        "move": {"start": (3, 3)},
        "is_passable": {"cell": (3, 3)},
        "update": PATCH,
        "reach": {},
        "use_model": {"model": "edge"},
        "replan": {"method": "astar"},
        "refined": {"plan": Planner(COST).plan((1, 2), (3, 3), method="astar")},
    },
    lambda: Navigator(Ground(COST), "astar"): {"offer": {"message": Goal(1, 1)}},
    InProcessSource: {"put": {"message": Goal(1, 1)}},
}
"""Methods of what each of these makes."""


def wrongs(entry, good):
    """Calls of an entry in which one argument is wrong."""
    for name, parameter in inspect.signature(entry).parameters.items():
        if parameter.kind not in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD):
            for value in WRONG:
                yield name, value, {**good, name: value}


def raw(call, label, value, given):
    """What is wrong with the answer to a call that is wrong itself; nothing where it is refused, or
    understood.
    """
    try:
        call(**given)
    except NnppEdgeError as error:
        return [f"{label}: {error}"] if "\n" in str(error) else []
    except Exception as error:
        return [f"{label}={value!r:.30}: {type(error).__name__}: {error}"[:200]]
    return [f"{label}={value!r:.30} is taken"] if type(value) is object else []


def test_every_public_name_is_called_here():
    answers = {
        "Counters",
        "ModelFile",
        "PathMessage",
        "Plan",
        "PoseCheck",
        "Region",
        "Standing",
        "StatusMessage",
    }
    words = {"DynamicMethod", "Method", "Origin", "Source", "Status"}
    others = {"InputSource", "Sink", "handling_signals", "list_models"}
    public = {name: getattr(runtime, name) for name in dir(runtime) if not name.startswith("_")}
    entries = {
        name
        for name, value in public.items()
        if getattr(value, "__module__", "").startswith("nnpp_edge.runtime.")
        and not (isinstance(value, type) and issubclass(value, Exception))
    }
    assert entries - answers - words - others <= {entry.__name__ for entry in ENTRIES}
    assert len(entries) >= 39


@pytest.mark.filterwarnings("ignore")
def test_every_entry_and_method_refuses_what_is_of_another_type():
    found = []
    for entry, good in ENTRIES.items():
        for name, value, given in wrongs(entry, good):
            found += raw(entry, f"{entry.__qualname__} {name}", value, given)
    for make, names in METHODS.items():
        for name, good in names.items():
            getattr(make(), name)(**good)
            for argument, value, given in wrongs(getattr(make(), name), good):
                found += raw(getattr(make(), name), f"{name} {argument}", value, given)
    assert not found, "\n".join(found)


# --- values of the right type

NAN = math.nan
FLAT = np.zeros((40, 40), np.float32)
PAIR = ((1, 1), (2, 2))
POINT = Planner(FLAT)
HEAVY = Planner(FLAT + 0.2, step_cost="length")
ON_HEIGHTS = Planner.of_elevation(FLAT, 1.0)
BODY = Vehicle(1.5, 1.2, 0.3)
DISC = Vehicle(radius_m=1.2)
ON_DISC = Planner(FLAT, vehicle=DISC, cell_size_m=0.5)
MOVING = DynamicPlanner(FLAT, (9, 9), "corridor-dstar")
TOBLER = Planner.of_elevation(FLAT, 1.0, step_cost="tobler")
NO_MAP = np.zeros((3, 3, 3)), np.zeros((0, 3)), np.array([["a"]]), [[1.0, 2.0], [1.0]], np.ones(3)
TOO_LARGE = (np.full((2, 2), 1e39), np.full((2, 2), -1.7e308))
TOO_FAR = (1.1e30, 3.4e38, 0.0, 1e-39)
CELLS = (np.inf, 0), (NAN, 0), (0.5, 1), (1, 2, 3), "ab", None, (1e400, 2)
NO_CELL = r"must be two whole numbers \(row, col\), got"
PLANNERS = POINT, HEAVY, ON_DISC, ON_HEIGHTS, MOVING
REFUSED = (
    (Planner, (*NO_MAP, np.full((3, 3), -0.1)), None),
    (lambda cost: Planner(cost, step_cost="length"), TOO_LARGE, "32-bit floats"),
    (lambda heights: MapPatch(0, 0, elevation=heights), (*TOO_LARGE, *NO_MAP[2:]), None),
    (
        lambda weight: Planner(FLAT + weight, step_cost="length"),
        TOO_FAR,
        r"be from 1\.18e-38 to 1e\+30, got one of",
    ),
    (lambda weight: HEAVY.update(5, 5, np.full((2, 2), weight)), (*TOO_FAR, -1.0), "got one of"),
    (
        lambda planner: planner.update(5, 5, [[0.5, -0.1]]),
        (POINT, ON_DISC, MOVING),
        r"at least 0, got one of -0\.1",
    ),
    (lambda planner: planner.update(-1, 0, np.ones((3, 3))), PLANNERS, "inside the map"),
    (lambda planner: planner.update(38, 0, np.ones((3, 3))), PLANNERS, "inside the map"),
    (lambda planner: planner.update(0, 39, np.ones((3, 3))), PLANNERS, "inside the map"),
    (
        lambda at: ON_HEIGHTS.update_elevation(*at, FLAT[:3, :3]),
        ((-1, 0), (0, 38), (40, 0)),
        "inside the map",
    ),
    (
        lambda planner: planner.update_elevation(0, 0, FLAT[:2, :2]),
        (POINT, ON_DISC),
        "wanted costs",
    ),
    (lambda row: POINT.update(row, 0, np.ones((2, 2))), (1.7,), "whole number"),
    (lambda cell: POINT.plan(cell, (1, 1)), CELLS, NO_CELL),
    (lambda cell: POINT.plan((1, 1), cell), CELLS, NO_CELL),
    (lambda cell: POINT.nearest((1, 1), [cell]), CELLS, NO_CELL),
    (lambda cell: POINT.prepare(goals=[cell]), CELLS, NO_CELL),
    (lambda cell: DynamicPlanner(FLAT, cell), CELLS, NO_CELL),
    (lambda goals: POINT.nearest((1, 1), goals), ([],), "at least one goal"),
    (
        lambda count: POINT.nearest((1, 1), [(2, 2)], count=count),
        (0,),
        "count must be at least 1, got 0",
    ),
    (
        lambda s: POINT.plan(*PAIR, time_limit_s=s),
        (NAN, -1.0),
        "time_limit_s must be a number of at least 0",
    ),
    (
        lambda share: POINT.plan(*PAIR, epsilon=share),
        (NAN, -0.1),
        "epsilon must be a number of at least 0",
    ),
    (lambda method: POINT.plan(*PAIR, method=method), ("best",), "method must be one of"),
    (
        lambda refine: POINT.plan(*PAIR, refine=refine),
        ("smooth",),
        "refine must be one of any-angle",
    ),
    (
        lambda m: POINT.plan(*PAIR, refine="any-angle", turning_radius_m=m),
        (-1.0,),
        "positive number of metres",
    ),
    (
        lambda m: POINT.plan(*PAIR, refine="any-angle", turning_radius_m=m),
        (1.0,),
        "cells have a size",
    ),
    (lambda omega: Planner(FLAT, omega=omega), (1e300, NAN, -1.0), "omega must be from 0"),
    (lambda name: Planner(FLAT, step_cost=name), ("euclid",), "euclid"),
    (lambda name: Planner(FLAT, step_cost=name), ("tobler",), "'tobler'.*elevations"),
    (
        lambda name: DynamicPlanner(FLAT, (0, 0), step_cost=name),
        ("linear",),
        "'linear'.*elevations",
    ),
    (
        lambda vehicle: Planner(FLAT, vehicle=vehicle, cell_size_m=1.0),
        (BODY,),
        "a body needs elevations",
    ),
    (lambda vehicle: Planner(FLAT, vehicle=vehicle), (DISC,), "wanted cell_size_m"),
    (lambda method: DynamicPlanner(FLAT, (1, 1), method), ("dijkstra",), "method must be one of"),
    (lambda refine: DynamicPlanner(FLAT, (1, 1), refine=refine), ("smooth",), "refine must be"),
    (lambda goal: DynamicPlanner(FLAT, goal), ((40, 1),), "goal must lie inside"),
    (lambda planner: planner.replan(), (MOVING,), "wanted a start"),
    (
        lambda method: dynamic().replan(method=method),
        ("best",),
        "method must be one of auto, astar",
    ),
    (lambda landmarks: TOBLER.prepare(landmarks=landmarks), (2,), "landmarks.*alike both ways"),
    (lambda goal: TOBLER.prepare(goals=[goal]), ((1, 1),), "landmarks"),
    (
        lambda size: Planner.of_elevation(FLAT, size),
        (0.0, NAN),
        "cell size must be a positive number",
    ),
    (lambda size: Planner.of_elevation(FLAT, 1.0, cell_width_m=size), (0.0, NAN), "cell size"),
    (lambda dem: Planner.of_elevation(dem, 1.0), NO_MAP[:2], r"dem must be a \(H, W\) map"),
    (
        lambda name: Planner.of_elevation(FLAT, 1.0, step_cost=name),
        ("time",),
        r"mobility\.time.*speed_m_s",
    ),
    (
        lambda name: Planner.of_elevation(FLAT, 1.0, step_cost=name),
        ("energy",),
        r"mobility\.energy.*mass_kg",
    ),
    (
        lambda name: Planner.of_elevation(FLAT, 1.0, step_cost=name),
        ("length",),
        "one of paper, tobler.*'length'",
    ),
    (
        lambda m: Planner.of_elevation(FLAT[:10, :16], 0.25, vehicle=Vehicle(*m, 0.3)),
        ((4.3, 0.9), (3.0, 2.9)),
        "map",
    ),
    (lambda m: pose_costs(FLAT[:10, :16], 0.25, Vehicle(*m, 0.3)), ((4.3, 0.9), (3.0, 2.9)), "map"),
    (lambda vehicle: pose_costs(FLAT, 0.5, vehicle), (DISC,), "a disc has no poses"),
    (lambda radius: Vehicle(1.5, 1.2, 0.3, radius_m=radius), (1.0,), "wanted no other values"),
    (lambda radius: Vehicle(radius_m=radius), (-1.0, 0.0), "radius_m must be a positive"),
    (lambda dem: traversability_cost(dem, 1.0), NO_MAP[:2], "dem"),
    (lambda size: traversability_cost(FLAT, size), (0.0, NAN), "cell size"),
    (lambda slope: Traversability(slope_limit_deg=slope), (0, 90), "slope limit"),
    (lambda step: Traversability(step_limit_m=step), (-1,), "step_limit_m"),
    (lambda weight: Traversability(slope_weight=weight), (0.9,), "weight"),
    (lambda cost: MapPatch(0, 0, cost=cost), NO_MAP[1:], "numbers"),
    (
        lambda cost: MapPatch(0, 0, cost=cost),
        ([[0.5, -2.0]], [[-np.inf]]),
        "at least 0, got one of -",
    ),
    (
        lambda given: MapPatch(0, 0, **given),
        ({}, {"elevation": FLAT, "cost": FLAT}),
        "either elevation or cost",
    ),
    (lambda row: MapPatch(row, 0, cost=FLAT), (0.5, math.inf), "whole number"),
    (lambda stamp: MapPatch(0, 0, cost=FLAT, stamp=stamp), (NAN,), "finite"),
    (lambda col: Pose(0.0, col), (NAN, "a", 10**400), "a pose's col must be a finite number, got"),
    (lambda row: Goal(row, 0), (1.5, None), "whole number, got"),
    (lambda given: PathMessage(1, *given), ((Status.OK, Origin.FULL),), "comes with a path"),
    (
        lambda path: PathMessage(1, Status.NO_PATH, Origin.FULL, path),
        (np.zeros((1, 2), int),),
        "comes with a path",
    ),
    (
        lambda told: InProcessSource().put(told),
        ({"row": 5, "col": 5},),
        "must be a MapPatch or a Pose or a Goal, got",
    ),
    (lambda seconds: Ticker(seconds), (0.0, -1.0, math.inf, NAN), "period"),
    (
        lambda given: Loop(Navigator(Ground(COST)), InProcessSource(), given),
        (InProcessSink(),),
        "each a Sink, got <",
    ),
    (lambda rate: Loop(Navigator(Ground(COST)), InProcessSource(), rate_hz=rate), (0.0,), "rate"),
    (lambda share: Navigator(Ground(COST), tolerance=share), (-1.0,), "tolerance"),
    (lambda cells: Navigator(Ground(COST), snap_radius=cells), (-1,), "snap_radius"),
    (
        lambda kg: EnergyCost(kg, 0.1),
        (-5.0, NAN),
        "mass_kg must be a number above 0, got (-5.0|nan)",
    ),
    (lambda rolling: EnergyCost(5.0, rolling), (0.0,), "rolling_resistance .*above 0"),
    (
        lambda share: EnergyCost(5.0, 0.1, recovery=share),
        (1.2,),
        "recovery .*from 0 to 1.* got 1.2",
    ),
    (
        lambda share: EnergyCost(5.0, 0.1, efficiency=share),
        (0.0, 1.1),
        r"efficiency .*(\(0, 1\]|0 to 1).* got",
    ),
    (lambda watts: EnergyCost(5.0, 0.1, idle_w=watts), (3.0,), "idle_w needs a speed_m_s"),
    (
        lambda watts: EnergyCost(5.0, 0.1, idle_w=watts, speed_m_s=1.0),
        (-3.0,),
        "idle_w .*at least 0",
    ),
    (lambda speed: EnergyCost(5.0, 0.1, speed_m_s=speed), (math.inf,), "speed_m_s .*inf"),
    (lambda speed: ToblerCost(top_speed_km_h=speed), (0.0,), "top_speed_km_h .*above 0"),
    (lambda slope: ToblerCost(best_slope=slope), (2.0,), "best_slope .*from -1 to 1"),
    (lambda factor: IrmischerCost(factor=factor), (-1.0,), "factor .*above 0.*-1"),
    (lambda level: LinearCost(level), (0.0,), "level_per_m .*above 0"),
    (lambda down: LinearCost(down_per_m=down), (-4.0, NAN), "every way must cost more than 0"),
    (lambda up: LinearCost(up_per_m=up), (-1.0,), "up_per_m .*at least 0"),
    (lambda slope: LinearCost(steep_slope=slope), (0.1,), "steep_slope .*at most 0"),
    (
        lambda slopes: TimeCost(slopes, (1.0,)),
        ((), (0.0, 1.0)),
        "a speed for each slope_deg.*1 of ",
    ),
    (lambda slopes: TimeCost(slopes, (1.0, 1.0)), ((1.0, 1.0), (0.0, 90.0)), "ascend"),
    (lambda speed: TimeCost((0.0,), (speed,)), (0.0,), "speed_m_s must be positive"),
)


def test_values_that_make_no_sense_are_refused_in_a_line_and_change_no_map():
    before = [planner.state.grid.map().copy() for planner in PLANNERS]
    for call, values, words in REFUSED:
        for value in values:
            with pytest.raises(NnppEdgeError, match=words) as caught:
                call(value)
            assert "\n" not in str(caught.value)
    for planner, wanted in zip(PLANNERS, before, strict=True):
        np.testing.assert_array_equal(planner.state.grid.map(), wanted)
    assert ON_HEIGHTS.update(0, 0, FLAT[:1, :1]) == 0  # costs are told beside the heights


@pytest.mark.parametrize("dtype", [np.float32, np.float64, np.int16, np.uint8])
def test_a_masked_cell_is_unknown_everywhere(dtype):
    """As rasterio's read(masked=True) gives it: a number that means nothing under the mask."""
    plain = np.ones((5, 5), dtype)
    weights = np.ma.MaskedArray(plain.copy(), np.zeros(plain.shape, np.bool_), fill_value=0)
    weights.data[2, 2] = 0
    weights.mask[2, 2] = True
    planner = Planner(weights, step_cost="length")
    free = Planner(plain, step_cost="length")
    assert planner.plan((2, 2), (0, 0)).status == "START_BLOCKED"
    assert free.plan((2, 2), (0, 0)).ok
    free.update(0, 0, weights)
    assert free.plan((2, 2), (0, 0)).status == "START_BLOCKED"
    dynamic = DynamicPlanner(plain, (4, 4), "dstar", step_cost="length")
    dynamic.update(0, 0, weights)
    assert not dynamic.is_passable((2, 2))
    assert np.argwhere(np.isnan(MapPatch(0, 0, elevation=weights).elevation)).tolist() == [[2, 2]]
    loop = Navigator(Ground.of_elevation(plain, 1.0))
    loop.offer(MapPatch(0, 0, elevation=weights))
    loop.tick()
    assert np.isinf(loop.map.cost()[2, 2])
    if dtype is np.float64:
        weights.data[2, 2] = -1.7976931348623157e308  # which no map can hold
    assert np.argwhere(np.isinf(traversability_cost(weights, 1.0))).tolist() == [[2, 2]]
