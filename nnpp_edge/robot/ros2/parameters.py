"""Parameters of the node, by ROS' own means: ``--ros-args -p``, a YAML file, ``ros2 param``."""

from typing import TYPE_CHECKING, Annotated

from msgspec import Meta
from msgspec.structs import asdict, fields

from nnpp_edge.robot.ros2 import Ros
from nnpp_edge.runtime.errors import InvalidQueryError
from nnpp_edge.runtime.loop.settings import OnboardLoop
from nnpp_edge.runtime.reading import Table, changed

if TYPE_CHECKING:
    from rclpy.node import Node

_Seconds = Annotated[float, Meta(ge=0.0, le=1e6)]
_Metres = Annotated[float, Meta(ge=0.0, le=1e5)]
LIVE = ("map_timeout_s", "odom_timeout_s")
"""May be changed while the loop runs."""


class Own(Table, frozen=True, kw_only=True):
    """What the node is configured with. Each annotation says what `ros2 param describe` says."""

    autostart_node: Annotated[
        bool, Meta(description="Configure and activate at once, without a lifecycle manager.")
    ] = True
    global_frame: Annotated[
        str, Meta(min_length=1, description="Frame of maps, goals and paths.")
    ] = "map"
    robot_base_frame: Annotated[
        str, Meta(description="Frame of the robot, child of the odometry; empty for any.")
    ] = "base_link"
    map_file: Annotated[
        str, Meta(description="Elevation map to begin with, in place of map_size_m.")
    ] = ""
    map_size_m: Annotated[
        _Metres,
        Meta(
            description="Side of a map around the frame's origin that begins unknown and takes "
            "elevation maps in; 0: the map is what the topic map says."
        ),
    ] = 0.0
    resolution: Annotated[
        float, Meta(gt=0.0, le=1e4, description="Side of a cell of that map, metres.")
    ] = 0.1
    layer: Annotated[
        str, Meta(min_length=1, description="Layer of elevation maps that has the heights.")
    ] = "elevation"
    vehicle: Annotated[
        str,
        Meta(description="small-rover, large-rover, tracked, or a TOML file; empty for a point."),
    ] = ""
    radius_m: Annotated[_Metres, Meta(description="Of a disc, without a vehicle; 0: a point.")] = (
        0.0
    )
    workload: Annotated[
        str, Meta(description="Limits of ground: safe, soft or limitN; empty as `nnpp-edge run`.")
    ] = ""
    odom_timeout_s: Annotated[
        _Seconds, Meta(description="Age of the newest pose from which no path is given; 0: any.")
    ] = 1.0
    map_timeout_s: Annotated[
        _Seconds, Meta(description="Likewise of the newest map or part of one; 0: any.")
    ] = 0.0

    @property
    def by_topic(self) -> bool:
        """Whether the topic of maps says what the map is."""
        return not (self.map_file or self.map_size_m)


_OF_LOOP = {
    field.name: field.default
    for field in fields(OnboardLoop)
    if isinstance(field.default, str | float | int)
}
"""Parameters of the loop, which a profile's table has too, with their defaults."""
NAMES = (*Own.__struct_fields__, *_OF_LOOP)


def checked(values: dict[str, object]) -> tuple[Own, OnboardLoop]:
    """Parameters from values as ROS has them: a whole number serves as a fraction.
    InvalidQueryError says which makes no sense.
    """
    own, loop = (
        {name: values[name] for name in names if name in values}
        for names in (Own.__struct_fields__, _OF_LOOP)
    )
    return changed(Own(), **own), changed(OnboardLoop(), **loop)


def declare(node: "Node") -> None:
    """Declare all parameters of a node with their descriptions and defaults, and have changes
    checked, each by itself.
    """
    from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult

    descriptions = dict.fromkeys(_OF_LOOP, "Of the loop, as of `nnpp-edge run --loop`.")
    for field in fields(Own):
        descriptions[field.name] = str(field.type.__metadata__[-1].description)
    for name, words in descriptions.items():
        when = "" if name in LIVE else " Read when the node is configured."
        # a whole number is taken for a fraction, which ROS itself refuses
        descriptor = ParameterDescriptor(description=words + when, dynamic_typing=True)
        node.declare_parameter(name, (asdict(Own()) | _OF_LOOP)[name], descriptor)
    for name in node._parameter_overrides.keys() - node._parameters.keys():
        node.get_logger().warning(f"{name} was set, and there is no such parameter")

    def check(changes: list[Ros]) -> SetParametersResult:
        try:
            checked({each.name: each.value for each in changes})
        except InvalidQueryError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    node.add_on_set_parameters_callback(check)


def values_of(node: "Node") -> dict[str, object]:
    """The node's values now, unchecked."""
    return {name: node.get_parameter(name).value for name in NAMES}
