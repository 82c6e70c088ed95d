"""What runs on the robot: cost map, network, search, loop. Needs numpy, numba, onnxruntime and nothing of training.

Everything for users can be imported from here. A name is loaded when it is first used, so that a command which needs
none of them starts at once.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from nnpp_edge.runtime.errors import NnppEdgeError as NnppEdgeError
    from nnpp_edge.runtime.errors import Status as Status
    from nnpp_edge.runtime.loop.inprocess import InProcessSink as InProcessSink
    from nnpp_edge.runtime.loop.inprocess import InProcessSource as InProcessSource
    from nnpp_edge.runtime.loop.ladder import NavigatorSettings as NavigatorSettings
    from nnpp_edge.runtime.loop.messages import Counters as Counters
    from nnpp_edge.runtime.loop.messages import Goal as Goal
    from nnpp_edge.runtime.loop.messages import InvalidMessageError as InvalidMessageError
    from nnpp_edge.runtime.loop.messages import MapPatch as MapPatch
    from nnpp_edge.runtime.loop.messages import Origin as Origin
    from nnpp_edge.runtime.loop.messages import PathMessage as PathMessage
    from nnpp_edge.runtime.loop.messages import Pose as Pose
    from nnpp_edge.runtime.loop.messages import StatusMessage as StatusMessage
    from nnpp_edge.runtime.loop.navigator import Navigator as Navigator
    from nnpp_edge.runtime.loop.runner import InputSource as InputSource
    from nnpp_edge.runtime.loop.runner import Loop as Loop
    from nnpp_edge.runtime.loop.runner import handling_signals as handling_signals
    from nnpp_edge.runtime.loop.sinks import Sink as Sink
    from nnpp_edge.runtime.map.ground import Ground as Ground
    from nnpp_edge.runtime.map.poses import pose_costs as pose_costs
    from nnpp_edge.runtime.map.region import Region as Region
    from nnpp_edge.runtime.map.slope_cost import EnergyCost as EnergyCost
    from nnpp_edge.runtime.map.slope_cost import IrmischerCost as IrmischerCost
    from nnpp_edge.runtime.map.slope_cost import LinearCost as LinearCost
    from nnpp_edge.runtime.map.slope_cost import Mobility as Mobility
    from nnpp_edge.runtime.map.slope_cost import TimeCost as TimeCost
    from nnpp_edge.runtime.map.slope_cost import ToblerCost as ToblerCost
    from nnpp_edge.runtime.network.inference import NetworkModel as NetworkModel
    from nnpp_edge.runtime.network.model_file import ModelFile as ModelFile
    from nnpp_edge.runtime.network.model_file import list_models as list_models
    from nnpp_edge.runtime.planners.dynamic import DynamicPlanner as DynamicPlanner
    from nnpp_edge.runtime.planners.plan import DynamicMethod as DynamicMethod
    from nnpp_edge.runtime.planners.plan import Method as Method
    from nnpp_edge.runtime.planners.plan import Plan as Plan
    from nnpp_edge.runtime.planners.plan import Source as Source
    from nnpp_edge.runtime.planners.planner import Planner as Planner
    from nnpp_edge.runtime.planners.planner import plan_path as plan_path
    from nnpp_edge.runtime.planners.standing_path import Standing as Standing
    from nnpp_edge.runtime.terrain.traversability import SaturationWarning as SaturationWarning
    from nnpp_edge.runtime.terrain.traversability import Traversability as Traversability
    from nnpp_edge.runtime.terrain.traversability import traversability_cost as traversability_cost
    from nnpp_edge.runtime.terrain.traversability import update_cost as update_cost
    from nnpp_edge.runtime.terrain.vehicle import Vehicle as Vehicle

_MODULES = {
    "errors": ("NnppEdgeError", "Status"),
    "loop.inprocess": ("InProcessSink", "InProcessSource"),
    "loop.ladder": ("NavigatorSettings",),
    "loop.messages": (
        "Counters",
        "Goal",
        "InvalidMessageError",
        "MapPatch",
        "Origin",
        "PathMessage",
        "Pose",
        "StatusMessage",
    ),
    "loop.navigator": ("Navigator",),
    "loop.runner": ("InputSource", "Loop", "handling_signals"),
    "loop.sinks": ("Sink",),
    "map.ground": ("Ground",),
    "map.region": ("Region",),
    "map.slope_cost": ("EnergyCost", "IrmischerCost", "LinearCost", "Mobility", "TimeCost", "ToblerCost"),
    "network.inference": ("NetworkModel",),
    "network.model_file": ("ModelFile", "list_models"),
    "planners.dynamic": ("DynamicPlanner",),
    "planners.plan": ("DynamicMethod", "Method", "Plan", "Source"),
    "planners.planner": ("Planner", "plan_path"),
    "planners.standing_path": ("Standing",),
    "map.poses": ("pose_costs",),
    "terrain.vehicle": ("Vehicle",),
    "terrain.traversability": ("SaturationWarning", "Traversability", "traversability_cost", "update_cost"),
}
_MODULE_OF = {name: module for module, names in _MODULES.items() for name in names}


def __getattr__(name: str) -> object:
    if name == "World":  # for one release
        name = "Ground"
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)


def __dir__() -> list[str]:
    return sorted((*globals(), *_MODULE_OF))
