"""What runs on the robot: cost map, network, search. Needs numpy, numba, onnxruntime and nothing of training.

The names below are imported when first used, so that a command which needs none of them starts at once.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from nnpp_edge.runtime.errors import NnppEdgeError, Status
    from nnpp_edge.runtime.network.inference import NetworkModel
    from nnpp_edge.runtime.network.model_file import ModelFile, list_models
    from nnpp_edge.runtime.planners.plan import Method, Plan, Source
    from nnpp_edge.runtime.planners.planner import Planner, plan_path
    from nnpp_edge.runtime.terrain.traversability import (
        SaturationWarning,
        Traversability,
        traversability_cost,
        update_cost,
    )

_HOMES = {
    "Method": "planners.plan",
    "ModelFile": "network.model_file",
    "NetworkModel": "network.inference",
    "NnppEdgeError": "errors",
    "Plan": "planners.plan",
    "Planner": "planners.planner",
    "SaturationWarning": "terrain.traversability",
    "Source": "planners.plan",
    "Status": "errors",
    "Traversability": "terrain.traversability",
    "list_models": "network.model_file",
    "plan_path": "planners.planner",
    "traversability_cost": "terrain.traversability",
    "update_cost": "terrain.traversability",
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
