"""Parameters of the node, by ROS' own means: ``--ros-args -p``, a YAML file, ``ros2 param``."""

from typing import TYPE_CHECKING, Annotated, Any

import msgspec
from msgspec import Meta
from msgspec.structs import asdict, fields

from nnpp_edge.profiling.profile_file import OnboardLoop, Table
from nnpp_edge.runtime.errors import InvalidQueryError, shown

if TYPE_CHECKING:
    from rclpy.node import Node
    from rclpy.parameter import Parameter

_Seconds = Annotated[float, Meta(ge=0.0, le=1e6)]
_Metres = Annotated[float, Meta(ge=0.0, le=1e5)]
_Place = Annotated[float, Meta(ge=-1e9, le=1e9)]
_LIVE = ("map_timeout_s", "odom_timeout_s", "planner_patience_s")
"""May be changed while the loop runs."""


class ParameterError(InvalidQueryError):
    """A parameter that is unknown, or whose value makes no sense; one line."""


class Parameters(Table, frozen=True, kw_only=True):
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
        str,
        Meta(description="Elevation map, or an .npz of `nnpp-edge costmap`, to begin with."),
    ] = ""
    map_size_m: Annotated[
        _Metres,
        Meta(
            description="Side of a map that begins unknown and takes elevation maps in; 0: the map "
            "is what the topic map says."
        ),
    ] = 0.0
    resolution: Annotated[
        float, Meta(gt=0.0, le=1e4, description="Side of a cell of that map, metres.")
    ] = 0.1
    center_x: Annotated[_Place, Meta(description="Middle of that map, metres.")] = 0.0
    center_y: Annotated[_Place, Meta(description="Middle of that map, metres.")] = 0.0
    layer: Annotated[
        str, Meta(min_length=1, description="Layer of elevation maps that has the heights.")
    ] = "elevation"
    start_level_m: Annotated[
        _Metres,
        Meta(
            description="Unknown ground so near to the first pose counts as level at its height, "
            "as sensors do not see below the robot; 0: not."
        ),
    ] = 0.0
    vehicle: Annotated[
        str,
        Meta(description="small-rover, large-rover, tracked, or a TOML file; empty for a point."),
    ] = ""
    radius_m: Annotated[
        _Metres, Meta(description="Of a disc in place of a vehicle, on costs; 0: a point.")
    ] = 0.0
    workload: Annotated[
        str,
        Meta(description="Limits of ground: safe, soft or limitN; by default as `nnpp-edge run`."),
    ] = ""
    rate_hz: Annotated[
        float, Meta(ge=0.001, le=1000.0, description="Ticks of the loop a second.")
    ] = OnboardLoop().rate_hz
    method: Annotated[str, Meta(description="Planner, as of `nnpp-edge run --method`.")] = "auto"
    model: Annotated[str, Meta(description="Network, for the methods that need one.")] = "edge"
    tolerance: Annotated[
        float,
        Meta(ge=0.0, le=1e9, description="Share by which a kept path may cost more than a new."),
    ] = 0.02
    snap_radius: Annotated[
        int,
        Meta(ge=0, le=1000, description="Cells that a path may start beside a blocked robot."),
    ] = 3
    refine: Annotated[str, Meta(description="any-angle frees paths from the grid.")] = ""
    approach: Annotated[
        bool, Meta(description="Go as near to a goal as there is a way, where none leads to it.")
    ] = False
    odom_timeout_s: Annotated[
        _Seconds, Meta(description="Age of the newest pose from which no path is given; 0: any.")
    ] = 1.0
    map_timeout_s: Annotated[
        _Seconds, Meta(description="Likewise of the newest map or part of one; 0: any.")
    ] = 0.0
    planner_patience_s: Annotated[
        _Seconds, Meta(description="Longest work on a service's or an action's plan.")
    ] = 5.0

    @classmethod
    def of(cls, values: dict[str, Any]) -> "Parameters":
        """From values as ROS has them: a whole number serves as a fraction. ParameterError says
        which makes no sense.
        """
        try:
            read = msgspec.convert(values, cls)
            _ = read.loop
        except (msgspec.ValidationError, ValueError) as error:
            problem, _, place = str(error).partition(" - at `$.")
            key = place.rstrip("`")
            if key:
                wanted = problem.replace("Expected", "wanted").split(", got ")[0]
                problem = f"{key}: {wanted}, got {shown(values.get(key))}"
            raise ParameterError(problem) from None
        return read

    def __post_init__(self) -> None:
        fits = not (self.map_file and self.map_size_m)
        self.refuse_unless(fits, "map_file", "either map_file or map_size_m")
        self.refuse_unless(not (self.vehicle and self.radius_m), "radius_m", "0 with a vehicle")

    @property
    def loop(self) -> OnboardLoop:
        """How the loop plans."""
        own = asdict(self)
        names = [field.name for field in fields(OnboardLoop) if field.name in own]
        return OnboardLoop(**{name: own[name] for name in names})


def declare(node: "Node") -> None:
    """Declare all parameters of a node with their descriptions and defaults, and have changes
    checked.
    """
    from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult

    for field in fields(Parameters):
        words = field.type.__metadata__
        description = next(each.description for each in words[::-1] if each.description)
        live = "" if field.name in _LIVE else " Read when the node is configured."
        # a whole number is taken for a fraction, which ROS itself refuses
        descriptor = ParameterDescriptor(
            name=field.name, description=description + live, dynamic_typing=True
        )
        node.declare_parameter(field.name, field.default, descriptor)

    def check(changes: "list[Parameter[Any]]") -> SetParametersResult:
        names = _names()
        try:  # what goes together is checked when the node is configured
            Parameters.of({each.name: each.value for each in changes if each.name in names})
        except ParameterError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    node.add_on_set_parameters_callback(check)


def values_of(node: "Node") -> dict[str, Any]:
    """The node's values now, unchecked."""
    return {name: node.get_parameter(name).value for name in _names()}


def followed(own: Parameters, node: "Node") -> Parameters:
    """What a node was configured with, but what may be changed while it runs as it is now."""
    values = values_of(node)
    return Parameters.of(asdict(own) | {name: values[name] for name in _LIVE})


def _names() -> list[str]:
    return [field.name for field in fields(Parameters)]
