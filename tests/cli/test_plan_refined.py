"""`nnpp-edge plan --refine` and `run --refine`: way points in every output, and what is refused."""

import csv
import json
import subprocess
import sys

import numpy as np
import pytest

from nnpp_edge.runtime import Planner, Vehicle
from nnpp_edge.runtime.map.turns import curvatures
from nnpp_edge.runtime.planners.refine import BodyLines

ENDS = ("--start", "3,4", "--goal", "40,52")
BODY = ("--set", "length_m=6", "--set", "width_m=5", "--set", "clearance_m=1.5", "--set", "max_tilt_deg=40")


@pytest.fixture
def ground(tmp_path):
    """Rolling ground, cells of 2 m."""
    row, col = np.mgrid[0:48, 0:60]
    heights = (1.2 * np.sin(row / 7.0) * np.cos(col / 9.0)).astype(np.float32)
    np.savez(tmp_path / "ground.npz", elevation=heights, cell_size_m=2.0)
    return tmp_path / "ground.npz"


def test_way_points_are_told_with_their_headings_and_curvatures(nnpp_edge, ground, tmp_path):
    words = ("plan", ground, *ENDS, "--refine", "any-angle")
    told = json.loads(nnpp_edge(*words, "--json", "-o", tmp_path / "out").out)
    line = told["line"]
    points = np.array(line["row_col"])
    assert points[0].tolist() == [3, 4] and points[-1].tolist() == [40, 52]
    assert len(line["heading_deg"]) == len(line["curvature_per_m"]) == len(points)
    assert line["curvature_per_m"] == pytest.approx(curvatures(2.0 * points), rel=0.05, abs=1e-4)
    assert told["sharpest_curvature_per_m"] == pytest.approx(max(line["curvature_per_m"]), abs=1e-5)
    feature = json.loads((tmp_path / "out" / "path.geojson").read_text())
    assert len(feature["geometry"]["coordinates"]) == len(points)
    assert feature["properties"]["sharpest_curvature_per_m"] == told["sharpest_curvature_per_m"]
    legs = np.hypot(*np.diff(2.0 * points, axis=0).T).sum()
    assert told["length_m"] == pytest.approx(legs, rel=1e-4)
    assert f"{len(points)} way points, line integral" in nnpp_edge(*words).out
    plain = json.loads(nnpp_edge(*words[:-2], "--json").out)
    assert "line" not in plain and "sharpest_curvature_per_m" not in plain


def test_how_a_body_stands_is_told_along_the_way_points(nnpp_edge, ground, tmp_path):
    words = ("plan", ground, *ENDS, *BODY, "--method", "astar", "--refine", "any-angle")
    told = json.loads(nnpp_edge(*words, "--json", "-o", tmp_path / "out").out)
    rows = list(csv.DictReader((tmp_path / "out" / "path.csv").read_text().splitlines()))
    for name in ("pitch", "roll", "tilt"):
        steepest = max(abs(float(row[f"{name}_deg"])) for row in rows)
        assert told[f"steepest_{name}_deg"] == pytest.approx(steepest, rel=1e-3)
    assert 0.0 < told["steepest_tilt_deg"] <= 40.0 and told["least_clearance_m"] >= 0.0
    assert "pitched by at most" in nnpp_edge(*words).out


def test_on_a_plane_a_body_stands_as_the_plane_in_every_heading():
    row, col = 0.1 * np.mgrid[0:240, 0:240]
    heights = (0.1 * row - 0.2 * col).astype(np.float32)
    planner = Planner.of_elevation(heights, 0.1, vehicle=Vehicle(3.0, 2.0, 2.0, max_tilt_deg=60.0), warn=False)
    points = np.array([[10.0, 10.0], [13.0, 14.0], [9.5, 14.5], [14.0, 14.5]])
    found = BodyLines(planner.state.grid).attitudes(points / 0.1)
    ahead = np.diff(points, axis=0, append=2.0 * points[-1:] - points[-2:-1])
    down, right = (ahead / np.hypot(*ahead.T)[:, None]).T
    # a wheel's height is known to half a cell each way: 0.015 m of height over 2 m
    assert found.pitch_deg == pytest.approx(np.degrees(np.arctan(0.1 * down - 0.2 * right)), abs=0.5)
    assert found.roll_deg == pytest.approx(-np.degrees(np.arctan(0.1 * right + 0.2 * down)), abs=0.5)
    assert (found.tilt_deg >= np.degrees(np.arctan(np.hypot(0.1, 0.2))) - 1e-3).all()


def test_a_body_s_line_is_told_of_where_it_was_checked(nnpp_edge):
    words = ("plan", "sample:moon_rocks", "--vehicle", "large-rover", "--start", "60,6", "--goal", "60,113")
    for via in ((), ("--via", "52,60")):
        told = json.loads(nnpp_edge(*words, *via, "--refine", "any-angle", "--json").out)
        assert told["least_clearance_m"] >= 0.0, "which it was between the places that were checked"


def test_turns_are_no_sharper_than_the_vehicle_s(nnpp_edge, ground):
    words = ("plan", ground, *ENDS, "--set", "radius_m=1", "--refine", "any-angle", "--json", "--set")
    told = json.loads(nnpp_edge(*words, "turning_radius_m=8").out)
    assert 0.0 < told["sharpest_curvature_per_m"] <= 1.0 / 8.0
    ended = nnpp_edge(*("radius_m=4" if word == "radius_m=1" else word for word in words), "turning_radius_m=390")
    refused = json.loads(ended.out)
    assert ended.code == 1 and refused["status"] == "NO_PATH" and "line" not in refused
    assert "no line that turns with a radius of 390 m" in refused["reason"]


def test_the_loop_tells_way_points_where_it_is_asked_for_them(ground, tmp_path):
    inputs = [{"v": 1, "type": "goal", "row": 40, "col": 52}, {"v": 1, "type": "pose", "row": 3, "col": 4}]
    recording = tmp_path / "drive.jsonl"
    recording.write_text("".join(json.dumps({"at": 0.0, **each}) + "\n" for each in inputs))
    module = (sys.executable, "-m", "nnpp_edge.cli.main", "run", "--map", ground, "--input", f"replay:{recording}")
    words, turning = (*module, "--fast", "--method", "astar"), ("--set", "radius_m=2", "--set", "turning_radius_m=6")
    for more, there in (((*turning, "--loop", "refine=any-angle"), True), ((), False)):
        ended = subprocess.run([*words, *more], capture_output=True, text=True, check=True)
        answers = [json.loads(line) for line in ended.stdout.splitlines()]
        paths = [each for each in answers if each["type"] == "path" and each["outcome"] == "OK"]
        assert paths and all(("waypoints" in path) == there for path in paths)
        for points in (np.array(path["waypoints"]) for path in paths if there):
            assert points[-1].tolist() == [40, 52] and curvatures(2.0 * points).max() <= 1.0 / 6.0
