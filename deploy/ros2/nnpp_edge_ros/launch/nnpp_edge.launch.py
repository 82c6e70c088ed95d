"""ros2 launch nnpp_edge_ros nnpp_edge.launch.py robot:=rover params_file:=mine.yaml"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterFile

ROBOTS = ["car", "rover", "tracked"]
CONFIG = str(Path(get_package_share_directory("nnpp_edge_ros"), "config"))


def generate_launch_description():
    robot = LaunchConfiguration("robot")
    shipped = PathJoinSubstitution([CONFIG, [robot, ".yaml"]])
    return LaunchDescription(
        [
            DeclareLaunchArgument("robot", default_value="rover", choices=ROBOTS),
            DeclareLaunchArgument("params_file", default_value=shipped),
            DeclareLaunchArgument("autostart_node", default_value="true"),
            Node(
                package="nnpp_edge_ros",
                executable="nnpp_edge",
                name="nnpp_edge",
                output="screen",
                parameters=[
                    ParameterFile(LaunchConfiguration("params_file"), allow_substs=True),
                    {"autostart_node": LaunchConfiguration("autostart_node")},
                ],
            ),
        ]
    )
