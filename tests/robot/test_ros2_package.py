"""The package for colcon: what it installs, and whether the node knows its parameters. ROS is not
needed.
"""

import ast
import runpy
from pathlib import Path

import pytest
import yaml

from nnpp_edge.robot.ros2.grounds import first_ground
from nnpp_edge.robot.ros2.parameters import NAMES, ParameterError, checked

PACKAGE = Path(__file__).parents[2] / "deploy/ros2/nnpp_edge_ros"
ROBOTS = ("car", "rover", "tracked")


@pytest.mark.parametrize("robot", ROBOTS)
def test_a_robots_parameters_make_a_ground(robot):
    text = (PACKAGE / f"config/{robot}.yaml").read_text()
    text = text.replace("$(find-pkg-share nnpp_edge_ros)", str(PACKAGE))
    values = yaml.safe_load(text)["nnpp_edge"]["ros__parameters"]
    assert values.keys() <= set(NAMES)
    own, loop = checked(values)
    ground, frame = first_ground(own)
    assert loop.approach and frame.frame_id == own.global_frame
    assert ground.shape == (round(own.map_size_m / own.resolution),) * 2
    assert (ground.vehicle.turning_radius_m is not None) == (robot == "car")


def test_the_package_installs_its_files_and_an_entry_point(monkeypatch):
    given = {}
    monkeypatch.setattr("setuptools.setup", lambda **words: given.update(words))
    monkeypatch.chdir(PACKAGE)
    runpy.run_path("setup.py")
    installed = {
        f"{folder}/{Path(name).name}" for folder, names in given["data_files"] for name in names
    }
    share = "share/nnpp_edge_ros"
    wanted = {
        f"{share}/package.xml",
        f"{share}/launch/nnpp_edge.launch.py",
        f"{share}/config/car.toml",
    }
    wanted |= {f"{share}/config/{robot}.yaml" for robot in ROBOTS}
    assert wanted < installed
    (script,) = given["entry_points"]["console_scripts"]
    module, _, function = script.partition(" = ")[2].partition(":")
    tree = ast.parse((PACKAGE / f"{module.replace('.', '/')}.py").read_text())
    assert function in [each.name for each in tree.body if isinstance(each, ast.FunctionDef)]


BAD = (
    ({"rate_hz": -1}, "rate_hz: wanted `float` >= 0.001, got -1"),
    ({"map_size_m": "wide"}, "map_size_m: wanted `float`, got 'wide'"),
    ({"method": "rrt"}, "method: wanted one of"),
)


@pytest.mark.parametrize(("values", "words"), BAD)
def test_a_parameter_that_makes_no_sense_is_refused_in_a_line(values, words):
    with pytest.raises(ParameterError) as raised:
        checked(values)
    assert str(raised.value).startswith(words) and "\n" not in str(raised.value)


def test_a_whole_number_serves_as_a_fraction_and_a_body_needs_elevations():
    own, loop = checked({"map_size_m": 20, "rate_hz": 10})
    assert (own.map_size_m, loop.rate_hz) == (20.0, 10.0)
    with pytest.raises(ParameterError, match="a body needs elevations"):
        first_ground(checked({"vehicle": "tracked"})[0])
