"""Wrong types and values at every public entry: what comes back is an error of the package, in one
line.
"""

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
    LinearCost,
    Loop,
    MapPatch,
    Mobility,
    Navigator,
    NetworkModel,
    NnppEdgeError,
    Planner,
    Pose,
    TimeCost,
    ToblerCost,
    Traversability,
    Vehicle,
    pose_costs,
    traversability_cost,
)
from nnpp_edge.runtime.loop.timing import Ticker
from tests.strategies import flat
from tests.tables import cases

COST = flat(12, 14, 0.2)
HEIGHTS = flat(12, 14)
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
    **{each: {} for each in (Traversability, Mobility, ToblerCost, LinearCost)},
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
        "reach": {"start": (1, 2)},
        "update": PATCH,
        "prepare": {},
    },
    lambda: Planner.of_elevation(HEIGHTS, 1.0): {"update_elevation": PATCH},
    dynamic: {
        "set_goal": {"goal": (3, 3)},
        "move": {"start": (3, 3)},
        "is_passable": {"cell": (3, 3)},
        "update": PATCH,
        "reach": {"start": (1, 2)},
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
    assert len(entries) >= 37


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
FLAT = flat(40, 40)
PAIR = ((1, 1), (2, 2))
POINT = Planner(FLAT)
HEAVY = Planner(FLAT + 0.2, step_cost="length")
ON_HEIGHTS = Planner.of_elevation(FLAT, 1.0)
BODY = Vehicle(1.5, 1.2, 0.3)
SIZES = {"length_m": 1.6, "width_m": 1.2, "clearance_m": 0.3}
CAR = Vehicle(1.5, 1.2, 0.3, turning_radius_m=2.0)
DISC = Vehicle(radius_m=1.2)
ON_BODY = Planner.of_elevation(FLAT, 0.25, vehicle=BODY)
WALLED = Planner(np.where(np.arange(40) == 20, np.inf, FLAT))
MEANS = FLAT[:8, :8]
ON_DISC = Planner(FLAT, vehicle=DISC, cell_size_m=0.5)
MOVING = DynamicPlanner(FLAT, (9, 9), "corridor-dstar")
TOBLER = Planner.of_elevation(FLAT, 1.0, step_cost="tobler")
NO_MAP = np.zeros((3, 3, 3)), np.zeros((0, 3)), np.array([["a"]]), [[1.0, 2.0], [1.0]], np.ones(3)
TOO_LARGE = (np.full((2, 2), 1e39), np.full((2, 2), -1.7e308))
TOO_FAR = (1.1e30, 3.4e38, 0.0, 1e-39)
NO_SIZE = (0.0, -0.1, math.inf, -math.inf, NAN)
NO_ANGLE = (0.0, -5.0, 90.0, 91.0, math.inf, NAN)
CELLS = (np.inf, 0), (NAN, 0), (0.5, 1), (1, 2, 3), "ab", None, (1e400, 2)
PLANNERS = POINT, HEAVY, ON_DISC, ON_HEIGHTS, MOVING
REFUSED = r"""
Planner(X) | *NO_MAP, np.full((3, 3), -0.1) | .
Planner(X, step_cost='length') | *TOO_LARGE | 32-bit floats
MapPatch(0, 0, elevation=X) | *TOO_LARGE, *NO_MAP[2:] | .
Planner(FLAT + X, step_cost='length') | *TOO_FAR | be from 1\.18e-38 to 1e\+30, got one of
HEAVY.update(5, 5, np.full((2, 2), X)) | *TOO_FAR, -1.0 | got one of
X.update(5, 5, [[0.5, -0.1]]) | POINT, ON_DISC, MOVING | at least 0, got one of -0\.1
X.update(-1, 0, np.ones((3, 3))) | *PLANNERS | inside the map
X.update(38, 0, np.ones((3, 3))) | *PLANNERS | inside the map
X.update(0, 39, np.ones((3, 3))) | *PLANNERS | inside the map
ON_HEIGHTS.update_elevation(*X, FLAT[:3, :3]) | (-1, 0), (0, 38), (40, 0) | inside the map
X.update_elevation(0, 0, FLAT[:2, :2]) | POINT, ON_DISC | wanted costs
POINT.update(X, 0, np.ones((2, 2))) | 1.7 | whole number
POINT.plan(X, (1, 1)) | *CELLS | must be two whole numbers \(row, col\), got
POINT.plan((1, 1), X) | *CELLS | must be two whole numbers \(row, col\), got
DynamicPlanner(FLAT, X) | *CELLS | must be two whole numbers \(row, col\), got
POINT.plan(*PAIR, time_limit_s=X) | NAN, -1.0 | time_limit_s must be a number of at least 0
POINT.plan(*PAIR, epsilon=X) | NAN, -0.1 | epsilon must be a number of at least 0
POINT.plan(*PAIR, method=X) | 'best' | method must be one of
POINT.plan(*PAIR, refine=X) | 'smooth' | refine must be one of any-angle
Planner(FLAT, omega=X) | 1e+300, NAN, -1.0 | omega must be from 0
Planner(FLAT, step_cost=X) | 'euclid' | euclid
Planner(FLAT, step_cost=X) | 'tobler' | 'tobler'.*elevations
DynamicPlanner(FLAT, (0, 0), step_cost=X) | 'linear' | 'linear'.*elevations
Planner(FLAT, vehicle=X, cell_size_m=1.0) | BODY | a body needs elevations
Planner(FLAT, vehicle=X) | DISC | wanted cell_size_m
DynamicPlanner(FLAT, (1, 1), X) | 'dijkstra' | method must be one of
DynamicPlanner(FLAT, (1, 1), refine=X) | 'smooth' | refine must be
DynamicPlanner(FLAT, X) | (40, 1) | goal must lie inside
X.replan() | MOVING | wanted a start
dynamic().replan(method=X) | 'best' | method must be one of auto, astar
TOBLER.prepare(landmarks=X) | 2 | landmarks.*alike both ways
Planner.of_elevation(FLAT, X) | 0.0, NAN | cell size must be a positive number
Planner.of_elevation(FLAT, 1.0, cell_width_m=X) | 0.0, NAN | cell size
Planner.of_elevation(X, 1.0) | *NO_MAP[:2] | dem must be a \(H, W\) map
Planner.of_elevation(FLAT, 1.0, step_cost=X) | 'time' | mobility\.time.*speed_m_s
Planner.of_elevation(FLAT, 1.0, step_cost=X) | 'energy' | mobility\.energy.*mass_kg
Planner.of_elevation(FLAT, 1.0, step_cost=X) | 'length' | one of paper, tobler.*'length'
Planner.of_elevation(FLAT[:10, :16], 0.25, vehicle=Vehicle(*X, 0.3)) | (4.3, 0.9), (3.0, 2.9) | map
pose_costs(FLAT[:10, :16], 0.25, Vehicle(*X, 0.3)) | (4.3, 0.9), (3.0, 2.9) | map
pose_costs(FLAT, 0.5, X) | DISC | a disc has no poses
POINT.plan(*PAIR, start_heading_deg=X) | 3.0 | want a vehicle's body
ON_BODY.plan((9, 9), (30, 30), start_heading_deg=X) | NAN | headings must be numbers of degrees
ON_BODY.plan((9, 9), (30, 30), goal_heading_deg=9.0, goal_tolerance_deg=X) | -1.0 | headings must be
ON_BODY.plan((10, 10), (20, 30), refine=X) | 'any-angle' | a body's legs lead in 16 directions
POINT.explain(X, 0.0) | (2, 2) | wanted a vehicle with length, width and clearance
ON_BODY.explain(X, 0.0) | (40, 2) | map of 40 × 40
ON_BODY.explain(X, 0.0) | 3 | cell
ON_BODY.explain((2, 2), X) | NAN, 'north' | heading_deg
POINT.reach((1, 1), X) | -1.0 | within
WALLED.reach(X) | (9, 20) | is impassable
WALLED.reach(X) | (40, 3) | outside the map
WALLED.reach(X) | (0.5, 1) | two whole numbers
WALLED.prepare(landmarks=X) | 9 | at most 8
WALLED.plan_via((1, 1), (9, 9), [(2, 2), X]) | (7, 20) | via 2, \(7, 20\), is impassable
WALLED.plan_via((1, 1), (9, 9), [(2, 2), X], best_order=True) | (7, 20) | via 2, \(7, 20\), is impa
WALLED.plan_via((1, 1), (9, 9), [X]) | (2, 40) | via 1, \(2, 40\), lies outside the map
WALLED.plan_via((1, 1), (9, 9), [(2, 2), X]) | (1.5, 2) | via 2 must be two whole numbers
POINT.plan_via((0, 0), (0, 39), X, best_order=True) | [(1, 1)] * 13 | at most 12 places, got 13
MOVING.first_blocked(np.array(X, int)) | [(5, 5), (40, 5)], [(5, -1)], [(10**6, 5)] | path must lie on
POINT.state.grid.walk(np.zeros((2, 2), int), 0, np.empty(X)) | 1 | wanted room for 2 costs, got 1
Planner.of_coarse(MEANS, 1.0, factor=X) | 0 | factor must be at least 1, got 0
Planner.of_coarse(MEANS, 1.0, 4, prior=X) | 'best' | prior must be one of network, slope, got 'best'
Planner.of_coarse(MEANS, 1.0, 4, step_cost=X) | 'tobler' | a coarse map is for points and bodies
Planner.of_coarse(MEANS, 1.0, 4, vehicle=X) | DISC | and no radius_m
Ground(MEANS, factor=X) | 4 | a coarse map has elevations
Planner.of_elevation(FLAT, 1.0, vehicle=CAR, step_cost=X) | 'tobler' | arcs have the paper's cost
Vehicle(X, 1.2, 0.3) | *NO_SIZE | length_m .* got (0|-0.1|-?inf|nan)
Vehicle(1.6, X, 0.3) | *NO_SIZE | width_m .* got (0|-0.1|-?inf|nan)
Vehicle(1.6, 1.2, X) | *NO_SIZE | clearance_m .* got (0|-0.1|-?inf|nan)
Vehicle(**SIZES, max_step_m=X) | *NO_SIZE | max_step_m .* got (0|-0.1|-?inf|nan)
Vehicle(**SIZES, wheelbase_m=X) | *NO_SIZE | wheelbase_m .* got (0|-0.1|-?inf|nan)
Vehicle(**SIZES, track_m=X) | *NO_SIZE | track_m .* got (0|-0.1|-?inf|nan)
Vehicle(**SIZES, wheel_length_m=X) | *NO_SIZE | wheel_length_m .* got (0|-0.1|-?inf|nan)
Vehicle(**SIZES, wheel_width_m=X) | *NO_SIZE | wheel_width_m .* got (0|-0.1|-?inf|nan)
Vehicle(**SIZES, max_tilt_deg=X) | *NO_ANGLE | max_tilt_deg .* got (0|-5|9[01]|inf|nan)
Vehicle(**SIZES, max_pitch_deg=X) | *NO_ANGLE | max_pitch_deg .* got (0|-5|9[01]|inf|nan)
Vehicle(**SIZES, max_roll_deg=X) | *NO_ANGLE | max_roll_deg .* got (0|-5|9[01]|inf|nan)
Vehicle(**SIZES, turn_cost_m_per_rad=X) | -0.1, math.inf, NAN | turn_cost_m_per_rad .* got (-0.1|inf|nan)
Vehicle(**SIZES, axles=X) | 0, 1, 9, -2, 2.5, 3.0, NAN, True | axles .* got (0|1|9|-2|2.5|3.0|nan|True)
Vehicle(**SIZES, reserve=X) | 1.0 | reserve must be a share
Vehicle(radius_m=X) | 400.0 | must be in metres
Vehicle(radius_m=0.3, turning_radius_m=X) | 2.0 | wanted no other values
Vehicle(1.5, 1.2, 0.3, radius_m=X) | 1.0 | wanted no other values
Vehicle(radius_m=X) | -1.0, 0.0 | radius_m must be in metres, above 0
traversability_cost(X, 1.0) | *NO_MAP[:2] | dem
traversability_cost(FLAT, X) | 0.0, NAN | cell size
Traversability(slope_limit_deg=X) | 0, 90 | slope limit
Traversability(step_limit_m=X) | -1 | step_limit_m
Traversability(slope_weight=X) | 0.9 | weight
MapPatch(0, 0, cost=X) | *NO_MAP[1:] | numbers
MapPatch(0, 0, cost=X) | [[0.5, -2.0]], [[-np.inf]] | at least 0, got one of -
MapPatch(0, 0, **X) | {}, {'elevation': FLAT, 'cost': FLAT} | either elevation or cost
MapPatch(X, 0, cost=FLAT) | 0.5, math.inf | whole number
MapPatch(0, 0, cost=FLAT, stamp=X) | NAN | finite
Pose(0.0, X) | NAN, 'a', 10 ** 400 | a pose's col must be a finite number, got
Goal(X, 0) | 1.5, None | whole number, got
PathMessage(1, *X) | (Status.OK, Origin.FULL) | comes with a path
PathMessage(1, Status.NO_PATH, Origin.FULL, X) | np.zeros((1, 2), int) | comes with a path
InProcessSource().put(X) | {'row': 5, 'col': 5} | must be a MapPatch or a Pose or a Goal, got
Ticker(X) | 0.0, -1.0, math.inf, NAN | period
Loop(Navigator(Ground(COST)), InProcessSource(), X) | InProcessSink() | each a Sink, got <
Loop(Navigator(Ground(COST)), InProcessSource(), rate_hz=X) | 0.0 | rate
Navigator(Ground(COST), tolerance=X) | -1.0 | tolerance
Navigator(Ground(COST), snap_radius=X) | -1 | snap_radius
EnergyCost(X, 0.1) | -5.0, NAN | mass_kg must be a number above 0, got (-5.0|nan)
EnergyCost(5.0, X) | 0.0 | rolling_resistance .*above 0
EnergyCost(5.0, 0.1, recovery=X) | 1.2 | recovery .*from 0 to 1.* got 1.2
EnergyCost(5.0, 0.1, efficiency=X) | 0.0, 1.1 | efficiency .*(\(0, 1\]|0 to 1).* got
EnergyCost(5.0, 0.1, idle_w=X) | 3.0 | idle_w needs a speed_m_s
EnergyCost(5.0, 0.1, idle_w=X, speed_m_s=1.0) | -3.0 | idle_w .*at least 0
EnergyCost(5.0, 0.1, speed_m_s=X) | math.inf | speed_m_s .*inf
ToblerCost(top_speed_km_h=X) | 0.0 | top_speed_km_h .*above 0
ToblerCost(best_slope=X) | 2.0 | best_slope .*from -1 to 1
LinearCost(X) | 0.0 | level_per_m .*above 0
LinearCost(down_per_m=X) | -4.0, NAN | every way must cost more than 0
LinearCost(up_per_m=X) | -1.0 | up_per_m .*at least 0
LinearCost(steep_slope=X) | 0.1 | steep_slope .*at most 0
TimeCost(X, (1.0,)) | (), (0.0, 1.0) | a speed for each slope_deg.*1 of
TimeCost(X, (1.0, 1.0)) | (1.0, 1.0), (0.0, 90.0) | ascend
TimeCost((0.0,), (X,)) | 0.0 | speed_m_s must be positive
"""
"""Calls with an X, what it is not to be, and a part of the message."""
NAMES = {name: getattr(runtime, name) for name in dir(runtime)} | {"Ticker": Ticker}
BEFORE = [planner.state.grid.map().copy() for planner in PLANNERS]


@pytest.mark.parametrize(("call", "values", "words"), cases(REFUSED, 3))
def test_values_that_make_no_sense_are_refused_in_a_line_and_change_no_map(call, values, words):
    for value in eval(f"[{values}]", NAMES | globals()):
        with pytest.raises(NnppEdgeError, match=words) as caught:
            eval(call, NAMES | globals() | {"X": value})
        assert "\n" not in str(caught.value)
    for planner, wanted in zip(PLANNERS, BEFORE, strict=True):
        np.testing.assert_array_equal(planner.state.grid.map(), wanted)


def test_an_option_that_does_not_exist_is_answered_with_those_that_do():
    with pytest.raises(
        TypeError, match="no option is named methods: wanted one of method, epsilon"
    ):
        POINT.plan(*PAIR, methods="astar")


def test_costs_are_told_beside_heights():
    assert ON_HEIGHTS.update(0, 0, FLAT[:1, :1]) == 0


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
