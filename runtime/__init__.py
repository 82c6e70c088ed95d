"""What runs on the robot: cost map, network, search. Needs numpy, numba, onnxruntime and nothing of training.

The names below are imported when first used, so that a command which needs none of them starts at once.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from nnpp_edge.runtime.costmap import SaturationWarning, Traversability, traversability_cost, update_cost
    from nnpp_edge.runtime.errors import NnppEdgeError, Status
    from nnpp_edge.runtime.inference import NetworkModel
    from nnpp_edge.runtime.model_file import ModelFile, list_models
    from nnpp_edge.runtime.planning.plan import Method, Plan, Source
    from nnpp_edge.runtime.planning.planner import Planner, plan_path

_HOMES = {
    "Method": "planning.plan",
    "ModelFile": "model_file",
    "NetworkModel": "inference",
    "NnppEdgeError": "errors",
    "Plan": "planning.plan",
    "Planner": "planning.planner",
    "SaturationWarning": "costmap",
    "Source": "planning.plan",
    "Status": "errors",
    "Traversability": "costmap",
    "list_models": "model_file",
    "plan_path": "planning.planner",
    "traversability_cost": "costmap",
    "update_cost": "costmap",
}

__all__ = [
    "Method",
    "ModelFile",
    "NetworkModel",
    "NnppEdgeError",
    "Plan",
    "Planner",
    "SaturationWarning",
    "Source",
    "Status",
    "Traversability",
    "list_models",
    "plan_path",
    "traversability_cost",
    "update_cost",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
