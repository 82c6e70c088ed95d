"""A simulated robot of plain rclpy drives by the node's paths, over rocks and among obstacles that
move: ``.venv-ros/bin/python -m tests.robot.ros2_drive --minutes 3``.

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

from tests.robot.ros2_types import built

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
AHEAD_M = 0.8
HIGH_M = 1.5
GIVE_UP_S = 60.0
OLD_S = 0.3


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


def drive(minutes, seed):
    import rclpy
    from diagnostic_msgs.msg import DiagnosticArray
    from geometry_msgs.msg import PoseStamped
    from grid_map_msgs.msg import GridMap
    from nav_msgs.msg import Odometry, Path
    from rclpy.qos import DurabilityPolicy, QoSProfile
    from std_msgs.msg import Float32MultiArray, MultiArrayDimension

    rng = np.random.default_rng(seed)
    world = World(rng)
    robot = np.zeros(3)
    known = np.zeros((CELLS, CELLS), bool)  # blocked, as the robot has sent it
    sent = [(0.0, known)]
    counts = dict.fromkeys(("goals", "given_up", "paths", "empty", "failing", "windows"), 0)
    told = {}
    path = np.empty((0, 3))

    rclpy.init()
    node = rclpy.create_node("robot")
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    maps = node.create_publisher(GridMap, "elevation_map", 5)
    odom = node.create_publisher(Odometry, "odom", 5)
    goals = node.create_publisher(PoseStamped, "goal_pose", 1)

    def posed(message, x, y, yaw):
        message.position.x = float(x)
        message.position.y = float(y)
        message.orientation.z = math.sin(yaw / 2.0)
        message.orientation.w = math.cos(yaw / 2.0)

    def on_path(message):
        nonlocal path
        found = []
        for stamped in message.poses:
            at = stamped.pose
            found.append(
                (at.position.x, at.position.y, 2.0 * math.atan2(at.orientation.z, at.orientation.w))
            )
        path = np.array(found).reshape(-1, 3)
        counts["paths"] += 1
        counts["empty"] += not len(path)
        now = time.monotonic()
        old = next((cells for at, cells in reversed(sent) if now - at >= OLD_S), sent[0][1])
        if len(path) and hits(path, old & sent[-1][1]):
            counts["failing"] += 1

    def on_diagnostics(message):
        told.update({pair.key: pair.value for pair in message.status[0].values})

    node.create_subscription(Path, "plan", on_path, latched)
    node.create_subscription(DiagnosticArray, "/diagnostics", on_diagnostics, 10)

    def send_window(size=WINDOW):
        half = size // 2
        col, row = np.floor(robot[:2] / SIDE_M + CELLS / 2).astype(int)
        row = int(np.clip(row - half, 0, CELLS - size))
        col = int(np.clip(col - half, 0, CELLS - size))
        part = (slice(row, row + size), slice(col, col + size))
        blocked = world.blocked()
        heights = (world.ground + HIGH_M * blocked)[part]
        message = GridMap(layers=["elevation"])
        message.header.frame_id = "odom"
        message.info.resolution = SIDE_M
        message.info.length_x = message.info.length_y = SIDE_M * size
        middle = SIDE_M * (np.array((col, row)) + size / 2 - CELLS / 2)
        posed(message.info.pose, *middle, 0.0)
        # rows against x, columns against y, one column after another
        ring = heights.T[::-1, ::-1].ravel(order="F").astype(np.float32)
        layer = Float32MultiArray(data=array.array("f", ring.tobytes()))
        for label in ("column_index", "row_index"):
            layer.layout.dim.append(MultiArrayDimension(label=label, size=size))
        message.data = [layer]
        now_known = sent[-1][1].copy()
        now_known[part] = blocked[part]
        sent.append((time.monotonic(), now_known))
        del sent[:-20]
        maps.publish(message)
        counts["windows"] += 1

    def new_goal():
        blocked = world.blocked()
        while True:
            x, y = rng.uniform(-26.0, 26.0, 2)
            row, col = np.floor(np.array((y, x)) / SIDE_M + CELLS / 2).astype(int)
            far = math.hypot(x - robot[0], y - robot[1]) > 8.0
            if far and not blocked[max(row - 8, 0) : row + 9, max(col - 8, 0) : col + 9].any():
                break
        message = PoseStamped()
        message.header.frame_id = "odom"
        posed(message.pose, x, y, rng.uniform(-math.pi, math.pi))
        goals.publish(message)
        return np.array((x, y)), time.monotonic()

    def follow():
        """Steer for a place ahead on the path, before the next change of gear (pure pursuit)."""
        nonlocal robot
        if len(path) < 2:
            return
        apart = np.hypot(*(path[:, :2] - robot[:2]).T)
        turn = np.abs((path[:, 2] - robot[2] + math.pi) % (2.0 * math.pi) - math.pi)
        order = 0.05 * np.arange(len(path))  # it may come by the same place twice
        at = int((apart + 0.3 * turn + order)[:-1].argmin())
        if apart[at] > 0.7:
            return
        steps = np.diff(path[:, :2], axis=0)
        gears = np.sign(np.cos(path[:-1, 2]) * steps[:, 0] + np.sin(path[:-1, 2]) * steps[:, 1])
        to = at + 1
        while to + 1 < len(path) and apart[to] < AHEAD_M and gears[to] == gears[at]:
            to += 1
        x, y = path[to, :2] - robot[:2]
        left = -math.sin(robot[2]) * x + math.cos(robot[2]) * y
        curvature = 2.0 * left / max(x * x + y * y, 0.05)
        curvature = float(np.clip(curvature, -1.0 / RADIUS_M, 1.0 / RADIUS_M))
        length = float(gears[at]) * SPEED_M_S * STEP_S
        yaw = robot[2] + 0.5 * curvature * length
        robot = robot + np.array((math.cos(yaw), math.sin(yaw), curvature)) * length

    while not maps.get_subscription_count():
        rclpy.spin_once(node, timeout_sec=0.1)
    end = time.monotonic() + 60.0 * minutes
    goal, begun = None, 0.0
    next_step = time.monotonic()
    steps = 0
    while time.monotonic() < end:
        rclpy.spin_once(node, timeout_sec=max(next_step - time.monotonic(), 0.0))
        if time.monotonic() < next_step:
            continue
        next_step += STEP_S
        steps += 1
        world.move(robot, STEP_S)
        follow()
        message = Odometry(child_frame_id="base_link")
        message.header.frame_id = "odom"
        posed(message.pose.pose, *robot)
        odom.publish(message)
        if steps % 2 == 0:  # the first is a survey of all, by which goals are known
            send_window(WINDOW if steps > 2 else CELLS)
        reached = goal is not None and np.hypot(*(goal - robot[:2])) < 0.4
        given_up = goal is not None and time.monotonic() - begun > GIVE_UP_S
        counts["goals"] += bool(reached)
        counts["given_up"] += bool(given_up and not reached)
        if steps > 20 and (goal is None or reached or given_up):
            goal, begun = new_goal()
    for name in (
        "ticks",
        "planned",
        "kept",
        "failed",
        "overruns",
        "skipped",
        "tick_ms",
        "degraded",
    ):
        counts[name] = told.get(name)
    print(json.dumps(counts, indent=1))
    return counts


def main():
    parser = ArgumentParser()
    parser.add_argument("--minutes", type=float, default=3.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--inside", action="store_true")
    asked = parser.parse_args()
    if asked.inside:
        counts = drive(asked.minutes, asked.seed)
        sys.exit(int(counts["failing"] > 0 or not counts["goals"]))
    environment = os.environ | {
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "ROS_DOMAIN_ID": str(1 + os.getpid() % 100),
        "PYTHONPATH": str(built()),
    }
    with tempfile.TemporaryDirectory() as folder:
        vehicle = Path(folder, "robot.toml")
        vehicle.write_text(VEHICLE)
        values = {"vehicle": vehicle, "global_frame": "odom", "resolution": SIDE_M}
        values |= {"map_size_m": SIDE_M * CELLS, "map_timeout_s": 2.0}
        words = [word for name, value in values.items() for word in ("-p", f"{name}:={value}")]
        node = subprocess.Popen(
            [sys.executable, "-m", "nnpp_edge.cli.main", "ros", "--ros-args", *words],
            env=environment,
        )
        robot = [sys.executable, "-m", "tests.robot.ros2_drive", *sys.argv[1:], "--inside"]
        code = subprocess.run(robot, env=environment).returncode
        node.terminate()
        sys.exit(code or node.wait(10.0))


if __name__ == "__main__":
    main()
