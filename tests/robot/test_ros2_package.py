"""The package for colcon: what it installs, and whether the node knows its parameters. ROS is not
needed.
"""

import ast
import runpy
import sys
from configparser import ConfigParser
from pathlib import Path
from unittest.mock import MagicMock
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml

from nnpp_edge.robot.ros2 import answers, inputs
from nnpp_edge.robot.ros2.grounds import first_ground
from nnpp_edge.robot.ros2.parameters import NAMES, checked
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.terrain.dem import read_dem

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


@pytest.mark.parametrize("axes", [(0.25, 0.0, 0.0, 0.25), (0.0, 0.25, 0.25, 0.0)])
@pytest.mark.parametrize("signs", [(1, 1), (1, -1), (-1, 1), (-1, -1)])
def test_of_a_map_file_every_cell_stays_where_it_lies(tmp_path, axes, signs):
    """However its rows and columns run."""
    heights = np.arange(6.0).reshape(2, 3)
    (a, b, d, e), (x, y) = axes, signs
    place = (x * a, x * b, 7.0, y * d, y * e, -3.0)
    np.savez(tmp_path / "map.npz", elevation_m=heights, cell_size_m=0.25, transform=place)
    ground, frame = first_ground(checked({"map_file": str(tmp_path / "map.npz")})[0])
    dem = read_dem(tmp_path / "map.npz")
    for cell, height in np.ndenumerate(heights):
        assert ground.elevation[frame.cell(*dem.map_coordinates(*cell))] == height


def test_the_package_installs_its_files_and_an_entry_point(monkeypatch):
    given = {}
    monkeypatch.setattr("setuptools.setup", lambda **words: given.update(words))
    monkeypatch.chdir(PACKAGE)
    runpy.run_path("setup.py")
    installed = {
        f"{folder}/{Path(name).name}" for folder, names in given["data_files"] for name in names
    }
    wanted = {"package.xml", "launch/nnpp_edge.launch.py", "config/car.toml"}
    wanted |= {f"config/{robot}.yaml" for robot in ROBOTS}
    assert {f"share/nnpp_edge_ros/{name}" for name in wanted} < installed
    (script,) = given["entry_points"]["console_scripts"]
    module, _, function = script.partition(" = ")[2].partition(":")
    tree = ast.parse((PACKAGE / f"{module.replace('.', '/')}.py").read_text())
    assert function in [each.name for each in tree.body if isinstance(each, ast.FunctionDef)]


def test_the_package_depends_on_all_that_the_node_imports():
    wanted = {
        kind.partition(".")[0] for kind in (*inputs.TOPICS.values(), *answers.TOPICS.values())
    }
    tree = ElementTree.parse(PACKAGE / "package.xml")
    found = {each.text for each in tree.iter("exec_depend")}
    assert wanted | {"rclpy", "tf2_ros_py", "tf2_geometry_msgs"} <= found


def test_the_installed_script_runs_by_the_python_of_the_active_environment():
    config = ConfigParser()
    config.read(PACKAGE / "setup.cfg")
    assert config["build_scripts"]["executable"] == "/usr/bin/env python3"


def test_the_launch_file_starts_the_node_with_a_robots_parameters(monkeypatch):
    for name in (
        "launch",
        "launch_ros",
        "ament_index_python",
        "launch.actions",
        "launch.substitutions",
        "launch_ros.actions",
        "launch_ros.parameter_descriptions",
        "ament_index_python.packages",
    ):
        monkeypatch.setitem(sys.modules, name, MagicMock())
    found = sys.modules["ament_index_python.packages"].get_package_share_directory
    found.return_value = str(PACKAGE)
    module = runpy.run_path(str(PACKAGE / "launch/nnpp_edge.launch.py"))
    module["generate_launch_description"]()
    given = sys.modules["launch_ros.actions"].Node.call_args.kwargs
    (script,) = (PACKAGE / "setup.py").read_text().partition("console_scripts")[2:]
    assert (given["package"], given["name"]) == (PACKAGE.name, "nnpp_edge")
    assert f'["{given["executable"]} = ' in script
    (argument, *_) = sys.modules["launch.actions"].DeclareLaunchArgument.call_args_list
    assert tuple(argument.kwargs["choices"]) == ROBOTS
    joined = sys.modules["launch.substitutions"].PathJoinSubstitution.call_args.args[0]
    assert joined[0] == str(PACKAGE / "config")


BAD = (
    ({"rate_hz": -1}, "rate_hz: Expected float >= 0.001, got -1"),
    ({"map_size_m": "wide"}, "map_size_m: Expected float, got 'wide'"),
    ({"method": "rrt"}, "method: wanted one of"),
)


@pytest.mark.parametrize(("values", "words"), BAD)
def test_a_parameter_that_makes_no_sense_is_refused_in_a_line(values, words):
    with pytest.raises(InvalidQueryError) as raised:
        checked(values)
    assert str(raised.value).startswith(words) and "\n" not in str(raised.value)


def test_a_whole_number_serves_as_a_fraction_and_a_body_needs_elevations():
    own, loop = checked({"map_size_m": 20, "rate_hz": 10})
    assert (own.map_size_m, loop.rate_hz) == (20.0, 10.0)
    with pytest.raises(InvalidQueryError, match="a body needs elevations"):
        first_ground(checked({"vehicle": "tracked"})[0])
