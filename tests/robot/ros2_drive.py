"""A simulated robot drives by the node's paths, over rocks and among obstacles that move:
``.venv-ros/bin/python -m tests.robot.ros2_drive --minutes 3``. The robot is a process of its own, of
plain rclpy.

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
import time
from argparse import ArgumentParser
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

    def __init__(self):
        import rclpy
        from diagnostic_msgs.msg import DiagnosticArray
        from geometry_msgs.msg import PoseStamped
        from nav_msgs.msg import Odometry, Path
        from rclpy.qos import DurabilityPolicy, QoSProfile
        from sensor_msgs.msg import PointCloud2, PointField
        from std_msgs.msg import Int8MultiArray

        self._kinds = PointCloud2, Odometry, PoseStamped
        self._fields = [
            PointField(name=name, offset=4 * n, datatype=PointField.FLOAT32, count=1)
            for n, name in enumerate("xyz")
        ]
        rclpy.init()
        self._rclpy = rclpy
        self._node = rclpy.create_node("robot")
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._maps = self._node.create_publisher(PointCloud2, "elevation_points", 5)
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
        """A point in the middle of each of its cells."""
        places = SIDE_M * (np.indices(heights.shape) + 0.5 - CELLS / 2)
        y, x = places + SIDE_M * np.array((row, col))[:, None, None]
        points = np.stack((x, y, heights), axis=-1).astype(np.float32)
        size = len(heights)
        message = self._kinds[0](height=size, width=size, point_step=12, row_step=12 * size)
        message.header.frame_id = "odom"
        message.fields = self._fields
        message.data = array.array("B", points.tobytes())
        self._maps.publish(message)


def _set(message, pose):
    x, y, yaw = pose
    message.position.x = float(x)
    message.position.y = float(y)
    message.orientation.z = math.sin(yaw / 2.0)
    message.orientation.w = math.cos(yaw / 2.0)


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
    parser.add_argument("--robot", action="store_true")
    asked = parser.parse_args()
    if asked.robot:
        counts = drive(RosLink(), asked.minutes, asked.seed)
        sys.exit(int(counts["failing"] > 0 or not counts["goals"]))
    environment = os.environ | {
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "ROS_DOMAIN_ID": str(1 + os.getpid() % 100),
    }
    with tempfile.TemporaryDirectory() as folder:
        vehicle = Path(folder, "robot.toml")
        vehicle.write_text(VEHICLE)
        values = {"vehicle": vehicle, "global_frame": "odom", "resolution": SIDE_M}
        values |= {"map_size_m": SIDE_M * CELLS, "map_timeout_s": 2.0}
        words = [word for name, value in values.items() for word in ("-p", f"{name}:={value}")]
        command = [sys.executable, "-m", "nnpp_edge.cli.main", "ros", "--ros-args", *words]
        loop = subprocess.Popen(command, env=environment)
        robot = [sys.executable, "-m", "tests.robot.ros2_drive", *sys.argv[1:], "--robot"]
        code = subprocess.run(robot, env=environment).returncode
        loop.terminate()
        sys.exit(code or loop.wait(10.0))


if __name__ == "__main__":
    main()
