"""A simulated robot drives by the node's paths, over rocks and among obstacles that move:
``.venv-ros/bin/python -m tests.robot.ros2_drive --minutes 3``. The robot is a process of its own, of
plain rclpy.

``--without-ros`` drives through the same scene with the same loop, which the robot reaches by a
socket of Python's multiprocessing instead: what the loop does without ROS.

Prints as JSON how many goals were reached, how many of the published paths led through an obstacle
that the robot had sent 0.3 s before and that was still there, and the loop's late ticks.
"""

import array
import json
import math
import os
import subprocess
import sys
import tempfile
import threading
import time
from argparse import ArgumentParser
from multiprocessing.connection import Client, Listener
from pathlib import Path

import numpy as np

SIDE_M = 0.2
CELLS = 300
WINDOW = 101
SPEED_M_S = 1.0
STEP_S = 0.05
LENGTH_M = 1.4
WIDTH_M = 0.9
VEHICLE = f"""
length_m = {LENGTH_M}
width_m = {WIDTH_M}
clearance_m = 0.3
turning_radius_m = 2.0
reverse_cost = 2.0
gear_change_m = 1.0
"""
RADIUS_M = 2.0
WITHIN_M = 1.0
"""Over which the robot steers back to the path: half its radius, critically damped."""
HIGH_M = 1.5
NEAR_M = 0.4
"""To the goal, where it counts as reached."""
GIVE_UP_S = 90.0
OLD_S = 0.3
COUNTERS = ["ticks", "planned", "kept", "failed", "overruns", "skipped", "tick_ms", "degraded"]


class World:
    """Heights (rows along y, columns along x, the middle at 0), rocks, and obstacles that move."""

    def __init__(self, rng):
        at = SIDE_M * np.arange(CELLS)
        x, y = np.meshgrid(at, at)
        self.ground = 0.3 * np.sin(x / 6.0) + 0.3 * np.cos(y / 8.0)
        self.rocks = np.zeros((CELLS, CELLS), bool)
        for row, col in rng.integers(5, CELLS - 10, (50, 2)):
            size = int(rng.integers(2, 6))
            self.rocks[row : row + size, col : col + size] = True
        self.rocks[140:160, 140:160] = False
        self.places = rng.uniform(-25.0, 25.0, (6, 2))
        self.speeds = rng.uniform(-0.4, 0.4, (6, 2))

    def move(self, robot, seconds):
        """Obstacles keep away from the robot, and turn at the sides."""
        ahead = self.places + self.speeds * seconds
        free = np.hypot(*(ahead - robot[:2]).T) > 5.0
        inside = (np.abs(ahead) < 27.0).all(1)
        self.places = np.where((free & inside)[:, None], ahead, self.places)
        self.speeds = np.where(inside[:, None], self.speeds, -self.speeds)

    def blocked(self):
        cells = self.rocks.copy()
        for col, row in np.floor(self.places / SIDE_M + CELLS / 2).astype(int):
            cells[max(row - 2, 0) : row + 3, max(col - 2, 0) : col + 3] = True
        return cells


def hits(poses, blocked):
    """Whether a body at one of these poses stands on a blocked cell's middle."""
    rows, cols = np.nonzero(blocked)
    places = SIDE_M * (np.column_stack((cols, rows)) + 0.5 - CELLS / 2)
    for x, y, yaw in poses:
        away = places - (x, y)
        near = away[np.hypot(*away.T) < LENGTH_M]
        ahead = near @ (math.cos(yaw), math.sin(yaw))
        left = near @ (-math.sin(yaw), math.cos(yaw))
        if ((np.abs(ahead) < LENGTH_M / 2) & (np.abs(left) < WIDTH_M / 2)).any():
            return True
    return False


def beside(pose, place):
    """How far a pose (x, y, yaw) lies ahead of a place and to its left, and is turned to its left,
    in metres and rad.
    """
    x, y = pose[:2] - place[:2]
    ahead = x * math.cos(place[2]) + y * math.sin(place[2])
    left = y * math.cos(place[2]) - x * math.sin(place[2])
    turned = (pose[2] - place[2] + math.pi) % (2.0 * math.pi) - math.pi
    return ahead, left, turned


class Follower:
    """Drives along a path from pose to pose, each in its gear. It has come by a pose once it is
    beside it or beyond, so that a change of gear is driven out to its end.
    """

    def __init__(self):
        self.poses = np.empty((0, 3))
        self.gears = np.empty(0)
        self.at = 1
        """The pose that it drives to."""

    def take(self, poses, gears):
        """Another path, from where the robot is; what is left of the present one changes
        nothing.
        """
        rest = poses[1:]
        known = self.poses[len(self.poses) - len(rest) :]
        if len(rest) and rest.shape == known.shape and np.allclose(rest, known, atol=1e-6):
            return
        self.poses = poses
        self.gears = gears
        self.at = 1

    def drive(self, pose, length):
        """The pose after so many metres along the path, or fewer where it ends."""
        while length > 1e-9 and self.at < len(self.poses):
            gear = self.gears[self.at] or 1
            target = self.poses[self.at]
            ahead, _, _ = beside(pose, target)
            left_m = -gear * ahead
            if left_m <= 1e-6:
                self.at += 1
                continue
            before = self.poses[self.at - 1]
            chord = np.hypot(*(target - before)[:2])
            bend = beside(target, before)[2] / chord * gear if chord > 1e-3 else 0.0
            # where it ought to be: as far along the arc as it has come, from its end back
            yaw = target[2] - gear * bend * min(left_m, chord)
            _, aside, turned = beside(pose, _on_arc(target, yaw, gear, min(left_m, chord)))
            wanted = bend - aside / WITHIN_M**2 - 2.0 * gear * turned / WITHIN_M
            wanted = float(np.clip(wanted, -1.0 / RADIUS_M, 1.0 / RADIUS_M))
            step = min(length, left_m)
            yaw = pose[2] + 0.5 * gear * wanted * step
            pose = pose + np.array((math.cos(yaw), math.sin(yaw), wanted)) * gear * step
            length -= step
        return pose


def _on_arc(target, yaw, gear, length):
    """The pose so many metres before the end of an arc, where it heads for `yaw`."""
    middle = 0.5 * (target[2] + yaw)
    back = np.array((math.cos(middle), math.sin(middle))) * gear * length
    return np.array((*(target[:2] - back), yaw))


class RosLink:
    """The robot's side of the topics, by plain rclpy."""

    def __init__(self, place):
        import rclpy
        from diagnostic_msgs.msg import DiagnosticArray
        from geometry_msgs.msg import PoseStamped
        from grid_map_msgs.msg import GridMap
        from nav_msgs.msg import Odometry, Path
        from rclpy.qos import DurabilityPolicy, QoSProfile
        from std_msgs.msg import Float32MultiArray, Int8MultiArray, MultiArrayDimension

        self._kinds = GridMap, Odometry, PoseStamped, Float32MultiArray, MultiArrayDimension
        rclpy.init()
        self._rclpy = rclpy
        self._node = rclpy.create_node("robot")
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._maps = self._node.create_publisher(GridMap, "elevation_map", 5)
        self._odom = self._node.create_publisher(Odometry, "odom", 5)
        self._goals = self._node.create_publisher(PoseStamped, "goal_pose", 1)
        self._gears = np.empty(0)
        self._heard = []
        self.told = {}
        for kind, topic, hear in (
            (Int8MultiArray, "plan_gears", self._on_gears),  # heard before the path they are of
            (Path, "plan", self._on_path),
            (DiagnosticArray, "/diagnostics", self._on_diagnostics),
        ):
            self._node.create_subscription(kind, topic, hear, latched)
        while not self._maps.get_subscription_count():
            self.wait(0.1)

    def _on_gears(self, message):
        self._gears = np.array(message.data)

    def _on_path(self, message):
        found = []
        for stamped in message.poses:
            at = stamped.pose
            yaw = 2.0 * math.atan2(at.orientation.z, at.orientation.w)
            found.append((at.position.x, at.position.y, yaw))
        self._heard.append(np.array(found).reshape(-1, 3))

    def _on_diagnostics(self, message):
        self.told.update({pair.key: pair.value for pair in message.status[0].values})

    def wait(self, seconds):
        self._rclpy.spin_once(self._node, timeout_sec=max(seconds, 0.0))

    def paths(self):
        """Paths that came, with their gears, which come before them."""
        heard = self._heard
        self._heard = []
        return [(poses, self._gears) for poses in heard if len(poses) == len(self._gears)]

    def send_pose(self, pose):
        message = self._kinds[1](child_frame_id="base_link")
        message.header.frame_id = "odom"
        _set(message.pose.pose, pose)
        self._odom.publish(message)

    def send_goal(self, pose):
        message = self._kinds[2]()
        message.header.frame_id = "odom"
        _set(message.pose, pose)
        self._goals.publish(message)

    def send_window(self, row, col, heights):
        grid_map, _, _, layer_kind, dimension = self._kinds
        size = len(heights)
        message = grid_map(layers=["elevation"])
        message.header.frame_id = "odom"
        message.info.resolution = SIDE_M
        message.info.length_x = message.info.length_y = SIDE_M * size
        middle = SIDE_M * (np.array((col, row)) + size / 2 - CELLS / 2)
        _set(message.info.pose, (*middle, 0.0))
        # rows against x, columns against y, one column after another
        ring = heights.T[::-1, ::-1].ravel(order="F").astype(np.float32)
        layer = layer_kind(data=array.array("f", ring.tobytes()))
        for label in ("column_index", "row_index"):
            layer.layout.dim.append(dimension(label=label, size=size))
        message.data = [layer]
        self._maps.publish(message)


def _set(message, pose):
    x, y, yaw = pose
    message.position.x = float(x)
    message.position.y = float(y)
    message.orientation.z = math.sin(yaw / 2.0)
    message.orientation.w = math.cos(yaw / 2.0)


class SocketLink:
    """The same without ROS."""

    def __init__(self, place):
        self._connection = Client(place)
        self._heard = []
        self.told = {}

    def wait(self, seconds):
        if self._connection.poll(max(seconds, 0.0)):
            kind, content = self._connection.recv()
            if kind == "path":
                self._heard.append(content)
            else:
                self.told.update(content)

    def paths(self):
        heard = self._heard
        self._heard = []
        return heard

    def send_pose(self, pose):
        self._connection.send(("pose", tuple(pose)))

    def send_goal(self, pose):
        self._connection.send(("goal", tuple(pose)))

    def send_window(self, row, col, heights):
        self._connection.send(("window", (row, col, heights.astype(np.float32))))


def loop_without_ros(place, vehicle):
    """The node's loop, ground and poses of paths, with the socket in place of topics."""
    from nnpp_edge.profiling.profile_file import OnboardLoop
    from nnpp_edge.robot.ros2.grounds import first_ground
    from nnpp_edge.robot.ros2.parameters import Own
    from nnpp_edge.robot.transports.mcap_log import is_rest
    from nnpp_edge.ros.maps import arc_poses
    from nnpp_edge.runtime import Goal, Loop, MapPatch, Navigator, Pose
    from nnpp_edge.runtime.exercises import exercise
    from nnpp_edge.runtime.loop.connections import Mailbox
    from nnpp_edge.runtime.loop.messages import StatusMessage
    from nnpp_edge.runtime.loop.runner import handling_signals

    exercise()
    own = Own(vehicle=vehicle, global_frame="odom", resolution=SIDE_M, map_size_m=SIDE_M * CELLS)
    ground, frame = first_ground(own)
    navigator = Navigator(ground, **OnboardLoop().planning())
    mailbox = Mailbox()
    with Listener(place) as listener:
        connection = listener.accept()

    def read():
        while True:
            try:
                kind, content = connection.recv()
            except (EOFError, OSError):
                return
            if kind == "window":
                row, col, heights = content
                message = MapPatch(row, col, elevation=heights)
            else:
                x, y, yaw = content
                places = frame.places((x, y))[0].tolist()
                if kind == "goal":
                    message = Goal(*frame.cell(x, y), heading_deg=frame.heading_deg(yaw))
                else:
                    message = Pose(*places, heading_deg=frame.heading_deg(yaw))
            mailbox.put(message, when_full="drop oldest")

    class Source:
        poll = staticmethod(mailbox.read)

    class Answers:
        name = "socket"
        walked = None
        due = False

        def publish(self, message):
            if isinstance(message, StatusMessage):
                self.due = True
                connection.send(
                    ("told", {name: getattr(message.counters, name) for name in COUNTERS})
                )
                return
            if self.due or not is_rest(message.walked, self.walked):
                self.due = False
                poses = arc_poses(message, frame)
                connection.send(("path", (poses[:, :3], poses[:, 3])))
            self.walked = message.walked

    threading.Thread(target=read, daemon=True).start()
    loop = Loop(navigator, Source(), [Answers()], **OnboardLoop().pace())
    with handling_signals(loop):
        loop.run()


def drive(link, minutes, seed):
    """The robot: it sends where it is, what it sees and goals, and follows the paths."""
    rng = np.random.default_rng(seed)
    world = World(rng)
    robot = np.zeros(3)
    follower = Follower()
    sent = [(0.0, np.zeros((CELLS, CELLS), bool))]  # blocked, as the robot has sent it
    counts = dict.fromkeys(["goals", "given_up", "paths", "empty", "failing", "windows"], 0)
    counts["metres"] = 0.0

    def check(poses):
        counts["paths"] += 1
        counts["empty"] += not len(poses)
        now = time.monotonic()
        old = next((cells for at, cells in reversed(sent) if now - at >= OLD_S), sent[0][1])
        counts["failing"] += bool(len(poses)) and hits(poses, old & sent[-1][1])

    def send_window(size=WINDOW):
        half = size // 2
        col, row = np.floor(robot[:2] / SIDE_M + CELLS / 2).astype(int)
        row = int(np.clip(row - half, 0, CELLS - size))
        col = int(np.clip(col - half, 0, CELLS - size))
        part = (slice(row, row + size), slice(col, col + size))
        blocked = world.blocked()
        now_known = sent[-1][1].copy()
        now_known[part] = blocked[part]
        sent.append((time.monotonic(), now_known))
        del sent[:-20]
        link.send_window(row, col, (world.ground + HIGH_M * blocked)[part])
        counts["windows"] += 1

    def new_goal():
        blocked = world.blocked() | sent[-1][1]
        while True:
            x, y = rng.uniform(-26.0, 26.0, 2)
            row, col = np.floor(np.array((y, x)) / SIDE_M + CELLS / 2).astype(int)
            far = math.hypot(x - robot[0], y - robot[1]) > 8.0
            if far and not blocked[max(row - 8, 0) : row + 9, max(col - 8, 0) : col + 9].any():
                break
        link.send_goal((x, y, rng.uniform(-math.pi, math.pi)))
        return np.array((x, y)), time.monotonic()

    end = time.monotonic() + 60.0 * minutes
    goal, begun = None, 0.0
    next_step = time.monotonic()
    steps = 0
    while time.monotonic() < end:
        link.wait(next_step - time.monotonic())
        for poses, gears in link.paths():
            check(poses)
            follower.take(poses, gears)
        if time.monotonic() < next_step:
            continue
        next_step += STEP_S
        steps += 1
        world.move(robot, STEP_S)
        before = robot
        robot = follower.drive(robot, SPEED_M_S * STEP_S)
        counts["metres"] += float(np.hypot(*(robot - before)[:2]))
        link.send_pose(robot)
        if steps % 2 == 0:  # the first is a survey of all, by which goals are known
            send_window(WINDOW if steps > 2 else CELLS)
        reached = goal is not None and np.hypot(*(goal - robot[:2])) < NEAR_M
        given_up = goal is not None and time.monotonic() - begun > GIVE_UP_S
        counts["goals"] += bool(reached)
        counts["given_up"] += bool(given_up and not reached)
        if steps > 20 and (goal is None or reached or given_up):
            goal, begun = new_goal()
    counts |= {name: str(link.told.get(name)) for name in COUNTERS}
    print(json.dumps(counts, indent=1))
    return counts


def main():
    parser = ArgumentParser()
    parser.add_argument("--minutes", type=float, default=3.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--without-ros", action="store_true")
    parser.add_argument("--process", choices=("robot", "loop"))
    parser.add_argument("--place", default="")
    parser.add_argument("--vehicle", default="")
    asked = parser.parse_args()
    if asked.process == "loop":
        loop_without_ros(asked.place, asked.vehicle)
        return
    if asked.process == "robot":
        link = (SocketLink if asked.without_ros else RosLink)(asked.place)
        counts = drive(link, asked.minutes, asked.seed)
        sys.exit(int(counts["failing"] > 0 or not counts["goals"]))
    environment = dict(os.environ)
    if not asked.without_ros:
        from tests.robot.ros2_types import built

        environment |= {
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "ROS_DOMAIN_ID": str(1 + os.getpid() % 100),
            "PYTHONPATH": str(built()),
        }
    with tempfile.TemporaryDirectory() as folder:
        vehicle = Path(folder, "robot.toml")
        vehicle.write_text(VEHICLE)
        place = str(Path(folder, "socket"))
        drives = [sys.executable, "-m", "tests.robot.ros2_drive", "--place", place]
        command = [*drives, "--process", "loop", "--vehicle", str(vehicle)]
        if not asked.without_ros:
            values = {"vehicle": vehicle, "global_frame": "odom", "resolution": SIDE_M}
            values |= {"map_size_m": SIDE_M * CELLS, "map_timeout_s": 2.0}
            words = [word for name, value in values.items() for word in ("-p", f"{name}:={value}")]
            command = [sys.executable, "-m", "nnpp_edge.cli.main", "ros", "--ros-args", *words]
        loop = subprocess.Popen(command, env=environment)
        while asked.without_ros and not Path(place).exists() and loop.poll() is None:
            time.sleep(0.1)
        robot = [*drives, *sys.argv[1:], "--process", "robot"]
        code = subprocess.run(robot, env=environment).returncode
        loop.terminate()
        sys.exit(code or loop.wait(10.0))


if __name__ == "__main__":
    main()
