"""The node against ROS 2 itself: `nnpp-edge ros` in one process, plain rclpy in another.

They meet on the loopback interface, in a domain of their own. Messages that are on no wheel
(grid_map_msgs, map_msgs, nav2_msgs) are built by `ros2_types`.
"""

import hashlib
import json
import math
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy")

from nnpp_edge.ros.maps import GridMap, MapFrame
from tests.robot.conftest import wait_until

ROOT = Path(__file__).parents[2]
CAR = """
length_m = 1.2
width_m = 0.8
clearance_m = 0.3
turning_radius_m = 1.5
"""
TOPICS = {
    "plan": ("nav_msgs/msg/Path", "latched"),
    "plan_gears": ("std_msgs/msg/Int8MultiArray", "latched"),
    "/diagnostics": ("diagnostic_msgs/msg/DiagnosticArray", "default"),
}
DEFAULTS = {
    "map_file": "",
    "map_size_m": 0.0,
    "resolution": 0.1,
    "global_frame": "map",
    "vehicle": "",
    "radius_m": 0.0,
    "approach": False,
    "start_level_m": 0.0,
    "odom_timeout_s": 1.0,
    "method": "auto",
    "rate_hz": 17.0,
}


@pytest.fixture(scope="module")
def environment():
    """Of both processes: the loopback interface, a domain of their own, and the built messages."""
    script = ROOT / "tests/robot/ros2_types.py"
    stamp = hashlib.sha256(script.read_bytes()).hexdigest()[:12]
    folder = ROOT / "build" / f"ros2-types-{stamp}"
    if shutil.which("g++") and not folder.exists():
        made = folder.with_suffix(f".{os.getpid()}")
        subprocess.run([sys.executable, script, made], check=True, capture_output=True)
        made.rename(folder)
    return os.environ | {
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "ROS_DOMAIN_ID": str(1 + os.getpid() % 100),
        "PYTHONPATH": str(folder),
    }


class Peer:
    """The other process: `send` has it publish or ask, `heard` is what it received."""

    def __init__(self, environment):
        self.heard = {}
        self.process = subprocess.Popen(
            [sys.executable, ROOT / "tests/robot/ros2_peer.py"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=environment,
        )
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()
        self.wait("ready")
        for topic, (kind, qos) in TOPICS.items():
            self.send("listen", topic, kind, qos=qos)

    def _listen(self):
        for line in self.process.stdout:
            topic, message = json.loads(line)
            self.heard.setdefault(topic, []).append(message)

    def send(self, op, name, kind, **more):
        self.process.stdin.write(json.dumps({"op": op, "name": name, "kind": kind} | more) + "\n")
        self.process.stdin.flush()

    def wait(self, topic, holds=lambda message: True, patience_s=10.0):
        """The next message of a topic that is as wanted; those before it are passed over."""
        found = []

        def came():
            waiting = self.heard.get(topic, [])
            while waiting and not found:
                message = waiting.pop(0)
                if holds(message):
                    found.append(message)
            return found

        wait_until(came, patience_s)
        return found[0]

    def ask(self, name, kind, message=None, op="call"):
        """The answer of a service, or with ``act`` of an action."""
        self.heard.pop(name, None)
        self.send(op, name, kind, message=message or {})
        return self.wait(name, patience_s=20.0)

    def close(self):
        self.process.stdin.close()
        self.process.wait(10.0)
        self._thread.join(5.0)
        self.process.stdout.close()


class Node:
    """The node's process, and the other through which it is spoken to."""

    def __init__(self, environment, peer, *arguments):
        self.peer = peer
        self._environment = environment
        self._arguments = arguments
        self.start()

    def start(self):
        self.process = subprocess.Popen(
            [sys.executable, "-m", "nnpp_edge.cli.main", "ros", "--ros-args", *self._arguments],
            stderr=subprocess.PIPE,
            text=True,
            env=self._environment,
            cwd=ROOT,
        )
        self.lines = []
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def _read(self):
        self.lines.extend(self.process.stderr)

    def said(self, words):
        wait_until(lambda: any(words in line for line in list(self.lines)))

    @property
    def state(self):
        answer = self.peer.ask("/nnpp_edge/get_state", "lifecycle_msgs/srv/GetState")
        return answer["current_state"]["label"]

    def change(self, transition):
        """Whether the transition, 1 configure, 2 clean up, 3 activate, 4 deactivate, succeeded."""
        kind = "lifecycle_msgs/srv/ChangeState"
        message = {"transition": {"id": transition}}
        return self.peer.ask("/nnpp_edge/change_state", kind, message)["success"]

    def set(self, **values):
        """Set parameters; why one was refused, or nothing."""
        kinds = {bool: (1, "bool"), int: (2, "integer"), float: (3, "double"), str: (4, "string")}
        parameters = []
        for name, value in values.items():
            number, word = kinds[type(value)]
            parameters.append({"name": name, "value": {"type": number, f"{word}_value": value}})
        kind = "rcl_interfaces/srv/SetParameters"
        answer = self.peer.ask("/nnpp_edge/set_parameters", kind, {"parameters": parameters})
        return [each["reason"] for each in answer["results"] if not each["successful"]]

    def run(self, **values):
        """Have it run anew with these parameters, all others being the defaults."""
        if self.state == "active":
            self.change(4)
        if self.state == "inactive":
            self.change(2)
        assert self.set(**(DEFAULTS | values)) == []
        for heard in self.peer.heard.values():
            heard.clear()
        assert self.change(1) and self.change(3)

    def quiet(self):
        """Publish nothing more."""
        for name, kind in (("odom", "Odometry"), ("map", "OccupancyGrid")):
            self.peer.send("silence", name, f"nav_msgs/msg/{kind}")

    def odom(self, x, y, yaw_deg=0.0, frame="map", rate_hz=20.0, **more):
        self.peer.send(
            "publish",
            "odom",
            "nav_msgs/msg/Odometry",
            qos="sensor",
            rate_hz=rate_hz,
            message={
                "header": {"frame_id": frame},
                "child_frame_id": "base_link",
                "pose": {"pose": pose(x, y, yaw_deg)},
            }
            | more,
        )

    def goal(self, x, y, yaw_deg=0.0, frame="map"):
        message = {"header": {"frame_id": frame}, "pose": pose(x, y, yaw_deg)}
        self.peer.send("publish", "goal_pose", "geometry_msgs/msg/PoseStamped", message=message)

    def map(self, values, side=0.25, x=0.0, y=0.0, frame="map"):
        rows, cols = values.shape
        info = {"resolution": side, "width": cols, "height": rows, "origin": pose(x, y)}
        message = {"header": {"frame_id": frame}, "info": info, "data": values.ravel().tolist()}
        self.peer.send(
            "publish", "map", "nav_msgs/msg/OccupancyGrid", qos="latched", message=message
        )

    def path(self, holds=lambda poses: len(poses)):
        """The next path that is as wanted: (N, 3) x, y and yaw in degrees."""
        return poses_of(self.peer.wait("plan", lambda message: holds(poses_of(message))))

    def trouble(self, words):
        """Wait until the diagnostics say so."""

        def says(message):
            (status,) = message["status"]
            values = " ".join(pair["value"] for pair in status["values"])
            return words in status["message"] + values

        return self.peer.wait("/diagnostics", says)

    def close(self):
        if self.process.poll() is None:
            self.process.terminate()
        code = self.process.wait(10.0)
        self._thread.join(5.0)
        self.process.stderr.close()
        return code


def pose(x, y, yaw_deg=0.0):
    half = math.radians(yaw_deg) / 2.0
    return {
        "position": {"x": x, "y": y, "z": 0.0},
        "orientation": {"z": math.sin(half), "w": math.cos(half)},
    }


def poses_of(message):
    """(N, 3) x, y and yaw in degrees of a nav_msgs/Path."""
    found = []
    for stamped in message["poses"]:
        assert stamped["header"]["frame_id"] == message["header"]["frame_id"]
        at = stamped["pose"]["position"]
        turn = stamped["pose"]["orientation"]
        yaw = math.degrees(2.0 * math.atan2(turn["z"], turn["w"]))
        found.append((at["x"], at["y"], yaw))
    return np.array(found).reshape(-1, 3)


def turned(a, b):
    """Degrees between two headings."""
    return abs((a - b + 180.0) % 360.0 - 180.0)


@pytest.fixture(scope="module")
def peer(environment):
    with closing(Peer(environment)) as peer:
        yield peer


@pytest.fixture(scope="module")
def process(environment, peer):
    node = Node(environment, peer, "-p", "autostart_node:=false")
    yield node
    assert node.close() == 0


@pytest.fixture
def node(process):
    """One node for all tests; each has it run anew."""
    yield process
    process.quiet()


def hall(rows=40, cols=60):
    """A room with a wall that leaves way along the upper side."""
    values = np.zeros((rows, cols), np.int8)
    values[: rows - 8, cols // 2] = 100
    return values


def test_from_a_latched_map_to_a_path_around_a_wall_and_whoever_joins_late_gets_it(node, peer):
    node.map(hall(), x=-5.0, y=2.0)
    node.run(radius_m=0.3)
    node.odom(-4.0, 4.0)
    node.goal(8.0, 4.0, 90.0)
    path = node.path()
    assert np.hypot(*(path[0, :2] - (-4.0, 4.0))) < 0.25
    assert np.hypot(*(path[-1, :2] - (8.0, 4.0))) < 0.25
    assert turned(path[-1, 2], 90.0) < 1.0  # the goal's own yaw
    beside = path[np.abs(path[:, 0] - 2.6) < 0.5]
    assert (beside[:, 1] > 10.0).all()  # by the way that the wall leaves
    steps = np.diff(path[:, :2], axis=0)
    yaws = np.degrees(np.arctan2(steps[:, 1], steps[:, 0]))
    assert turned(path[:-1, 2], yaws).max() < 0.1
    for topic, kind, qos in (
        ("/plan", "nav_msgs/msg/Path", "latched"),
        ("traversability", "nav_msgs/msg/OccupancyGrid", "latched"),
        ("footprints", "visualization_msgs/msg/MarkerArray", "latched"),
    ):
        peer.send("listen", topic, kind, qos=qos)
    late = poses_of(peer.wait("/plan"))
    np.testing.assert_array_equal(late, path)
    seen = peer.wait("traversability")
    assert (np.reshape(seen["data"], (40, 60)) == 100)[:30, 30].all()
    (marker,) = peer.wait("footprints", lambda message: message["markers"][0]["points"])["markers"]
    first = np.array([(point["x"], point["y"]) for point in marker["points"][:20]])
    assert np.hypot(*(first - path[0, :2]).T).max() < 1.0
