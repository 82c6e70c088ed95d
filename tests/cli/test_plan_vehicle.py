"""`nnpp-edge plan`, `run` and `evaluate` with a vehicle: what is written, and what is refused in one line."""

import csv
import json

import cv2
import numpy as np
import pytest

from nnpp_edge.runtime import Planner, Vehicle, pose_costs
from nnpp_edge.viz.picture import BODY, POINT

CELL_M = 0.25
GOOD = "length_m = 1.0\nwidth_m = 0.8\nclearance_m = 0.3\n"
OWN = Vehicle(1.0, 0.8, 0.3)
ENDS = ("--start", "10,10", "--goal", "45,48")


@pytest.fixture
def place(tmp_path, monkeypatch):
    """A folder with a map of 60 × 60 cells that has a hill, and one that has a wall too."""
    monkeypatch.chdir(tmp_path)
    heights = (0.02 * np.random.default_rng(0).random((60, 60))).astype(np.float32)
    heights[18:30, 20:30] += np.arange(12, dtype=np.float32)[:, None] * np.float32(0.4)
    np.savez("hill.npz", elevation_m=heights, cell_size_m=CELL_M)
    heights[:, 30:32] = 5.0
    np.savez("wall.npz", elevation_m=heights, cell_size_m=CELL_M)
    return tmp_path


def test_every_waypoint_has_its_heading_and_how_the_body_stands(nnpp_edge, place):
    (place / "own.toml").write_text(GOOD)
    ended = nnpp_edge("plan", "hill.npz", *ENDS, "--vehicle", "own.toml", "--method", "astar", "-o", "out")
    assert (ended.code, ended.err) == (0, "")
    heights = np.load("hill.npz")["elevation_m"]
    plan = Planner.of_elevation(heights, CELL_M, vehicle=OWN).plan((10, 10), (45, 48), method="astar")
    told = json.loads((place / "out" / "plan.json").read_text())
    assert told["cost"] == pytest.approx(plan.cost, rel=1e-5)
    assert told["waypoints"]["heading_deg"] == plan.headings_deg.tolist()
    with (place / "out" / "path.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [float(row["heading_deg"]) for row in rows] == plan.headings_deg.tolist()
    assert all(float(row["tilt_deg"]) <= 25.0 and 0.0 < float(row["clearance_m"]) <= 0.3 for row in rows)
    costs = pose_costs(heights, CELL_M, OWN)
    assert np.isfinite(costs[:, *plan.path.T]).any(0).all()
    assert set(told["waypoints"]) <= set(json.loads((place / "out" / "path.geojson").read_text())["properties"])


def test_the_picture_has_the_body_and_with_a_comparison_a_points_path(nnpp_edge, place):
    pictures = []
    for more in ((), ("--vehicle", "small-rover"), ("--vehicle", "small-rover", "--compare")):
        assert nnpp_edge("plan", "hill.npz", *ENDS, *more, "--method", "astar", "-o", "out").code == 0
        picture = cv2.imread(str(place / "out" / "plan.png"))
        pictures.append([int((picture == colour).all(2).sum()) for colour in (BODY, POINT)])
    (no_body, few), (body, as_few), (as_much, point) = pictures
    assert no_body == 0 and body == as_much > 100
    assert few == as_few < 50 and point > few + 100


def test_nnpp_says_that_no_network_is_asked_for_a_body(nnpp_edge, place):
    ended = nnpp_edge("plan", "hill.npz", *ENDS, "--vehicle", "small-rover", "--method", "nnpp", "--json")
    told = json.loads(ended.out)
    assert (ended.code, ended.err, told["method"]) == (0, "", "nnpp")
    assert "no network is asked for a vehicle's body" in told["choice"]


def test_no_path_for_the_body_is_an_outcome(nnpp_edge, place):
    words = ("plan", "wall.npz", *ENDS, "--vehicle", "small-rover")
    ended = nnpp_edge(*words, "--json")
    told = json.loads(ended.out)
    assert (ended.code, told["status"]) == (1, "NO_PATH")
    reached = told["reached_cells"]
    assert 0 < reached < told["rows"] * told["cols"]
    assert f"reached     {reached} cells of the map, from the start" in nnpp_edge(*words).out
