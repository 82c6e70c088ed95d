"""A package of somebody else that uses ours is checked by mypy: our types arrive there."""

import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow
ROOT = Path(__file__).parent.parent
CONSUMER = """
from typing import assert_type

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime import DynamicPlanner, Plan, Planner, Vehicle, traversability_cost
from nnpp_edge.runtime.errors import NnppEdgeError, Status


def first_path(elevation: NDArray[np.float32]) -> NDArray[np.int32]:
    planner = Planner.of_elevation(elevation, 2.0)
    assert_type(planner, Planner)
    plan = planner.plan((0, 0), (9, 9), method="corridor")
    assert_type(plan, Plan)
    assert_type(plan.status, Status)
    assert_type(plan.cost, float)
    return plan.path


def on_costs(elevation: NDArray[np.float32]) -> Status:
    try:
        cost = traversability_cost(elevation, 2.0)
        return DynamicPlanner(cost, (9, 9)).replan().status
    except NnppEdgeError as error:
        raise SystemExit(str(error)) from error


def body() -> float:
    return Vehicle(1.5, 1.0, 0.25).length_m
"""
WRONG = """
from nnpp_edge.runtime import Planner


def wrong(planner: Planner) -> str:
    planner.plan((0, 0))
    return planner.plan((0, 0), (9, 9)).cost
"""


def test_a_strict_package_outside_passes_and_its_mistakes_are_found(tmp_path):
    package = tmp_path / "consumer"
    package.mkdir()
    for name, content in (("__init__", ""), ("right", CONSUMER), ("wrong", WRONG)):
        (package / f"{name}.py").write_text(content)
    command = [sys.executable, "-m", "mypy", "--strict", "--cache-dir", ROOT / ".mypy_cache" / "consumer", "consumer"]
    ended = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    problems = [line for line in ended.stdout.splitlines() if ": error: " in line]
    assert ended.returncode == 1 and not ended.stderr, ended.stdout + ended.stderr
    assert len(problems) == 2 and all(line.startswith("consumer/wrong.py:") for line in problems), ended.stdout
    assert "[call-arg]" in problems[0] and "[return-value]" in problems[1]
