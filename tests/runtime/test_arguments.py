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
    NavigatorSettings,
    NetworkModel,
    NnppEdgeError,
    Planner,
    Pose,
    TimeCost,
    ToblerCost,
    Traversability,
    Vehicle,
    plan_path,
    pose_costs,
    traversability_cost,
    update_cost,
)

COST, HEIGHTS = np.full((12, 14), 0.2, np.float32), np.zeros((12, 14), np.float32)
ENDS = {"start": (1, 2), "goal": (9, 11)}
WRONG = ["0", None, [[1.0], [1.0, 2.0]], {}, 0.5, True, object(), b"x", 10**400, -(10**30), math.nan, (1, "a"), 1j]


PATCH = {"row": 1, "col": 1, "patch": COST[:2, :2]}
ENTRIES = {
    Planner: {"cost": COST},
    Planner.of_elevation: {"dem": HEIGHTS, "cell_size_m": 1.0},
    DynamicPlanner: {"cost": COST, "goal": (9, 11), "method": "astar"},
    DynamicPlanner.of_elevation: {"dem": HEIGHTS, "cell_size_m": 1.0, "goal": (9, 11), "method": "astar"},
    plan_path: {"cost": COST, **ENDS, "method": "astar"},
    traversability_cost: {"dem": HEIGHTS, "cell_size_m": 1.0},
    update_cost: {"cost": COST.copy(), "dem": HEIGHTS, "changed": (1, 1, 2, 2), "cell_size_m": 1.0},
    pose_costs: {"dem": HEIGHTS, "cell_size_m": 1.0, "vehicle": Vehicle(1.5, 1.0, 0.4)},
    Vehicle: {"length_m": 1.5, "width_m": 1.0, "clearance_m": 0.4},
    TimeCost: {"slope_deg": (-20.0, 0.0, 20.0), "speed_m_s": (0.1, 0.2, 0.1)},
    TimeCost.of_speed: {"speed": lambda slope: np.full_like(slope, 0.3)},
    EnergyCost: {"mass_kg": 10.0, "rolling_resistance": 0.1},
    MapPatch: {"row": 1, "col": 1, "cost": COST},
    Pose: {"row": 1.0, "col": 1.0},
    Goal: {"row": 1, "col": 1},
    Loop: {"navigator": Navigator(Ground(COST), NavigatorSettings("astar")), "source": InProcessSource()},
    Ground: {"elevation": HEIGHTS, "cell_size_m": 1.0},
    Ground.of_elevation: {"elevation": HEIGHTS, "cell_size_m": 1.0},
    Navigator: {"ground": Ground(COST), "settings": NavigatorSettings("astar")},
    **{each: {} for each in (Traversability, Mobility, ToblerCost, IrmischerCost, LinearCost)},
    **{each: {} for each in (NavigatorSettings, InProcessSource, InProcessSink, NetworkModel)},
}
"""Functions and classes, with arguments that do."""


def dynamic():
    made = DynamicPlanner(COST, (9, 11), "astar", also=["dstar"])
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
    lambda: Navigator(Ground(COST), NavigatorSettings("astar")): {"offer": {"message": Goal(1, 1)}, "reload": {}},
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
    """What is wrong with the answer to a call that is wrong itself; nothing where it is refused, or understood."""
    try:
        call(**given)
    except NnppEdgeError as error:
        return [f"{label}: {error}"] if "\n" in str(error) else []
    except Exception as error:
        return [f"{label}={value!r:.30}: {type(error).__name__}: {error}"[:200]]
    return [f"{label}={value!r:.30} is taken"] if type(value) is object else []


def test_every_public_name_is_called_here():
    answers = {"Counters", "ModelFile", "PathMessage", "Plan", "Region", "Standing", "StatusMessage"}
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
    assert len(entries) >= 40


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
