"""Messages for tests of the node, and plain rclpy beside it."""

import math
import time

import rclpy
from geometry_msgs.msg import Pose, PoseStamped, Quaternion
from nav_msgs.msg import MapMetaData, OccupancyGrid, Odometry
from rclpy.action import ActionClient
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Header

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def posed(x, y, yaw_deg=0.0, **turn):
    """A pose on the ground; or with these parts of a quaternion."""
    half = math.radians(yaw_deg) / 2.0
    pose = Pose(orientation=Quaternion(**{"z": math.sin(half), "w": math.cos(half)} | turn))
    pose.position.x = x
    pose.position.y = y
    return pose


def stamped(x, y, yaw_deg=0.0, frame_id="map", **turn):
    return PoseStamped(header=Header(frame_id=frame_id), pose=posed(x, y, yaw_deg, **turn))


def odometry(pose, frame_id="map", child_frame_id="base_link"):
    message = Odometry(header=Header(frame_id=frame_id), child_frame_id=child_frame_id)
    message.pose.pose = pose
    return message


def grid(rows=40, cols=60, values=None, x=0.0, y=0.0, frame_id="map", **info):
    """A map of cells of 0.25 m from (x, y) on: free, or with these occupancies (rows, cols)."""
    fields = {"resolution": 0.25, "width": cols, "height": rows} | info
    place = MapMetaData(**fields, origin=posed(x, y))
    data = [0] * (rows * cols) if values is None else values.ravel().tolist()
    return OccupancyGrid(header=Header(frame_id=frame_id), info=place, data=data)


class Peer:
    """Plain rclpy in this process, whose callbacks run while it waits: `heard` is what it received,
    by topic.
    """

    def __init__(self, domain):
        self._context = Context()
        rclpy.init(context=self._context, domain_id=domain)
        self._node = rclpy.create_node("peer", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._publishers = {}
        self._timers = []
        self.heard = {}

    def until(self, holds, patience_s=60.0):
        """Wait for something that another process does."""
        end = time.monotonic() + patience_s
        while not holds():
            assert time.monotonic() < end, "it did not come about"
            self._executor.spin_once(timeout_sec=0.02)

    def pause(self, seconds):
        end = time.monotonic() + seconds
        self.until(lambda: time.monotonic() > end)

    def listen(self, topic, kind, qos=10):
        heard = self.heard.setdefault(topic, [])
        self._node.create_subscription(kind, topic, heard.append, qos)

    def wait(self, topic, holds=lambda message: True):
        """The next message of a topic that is as wanted; those before it are passed over."""
        found = []

        def came():
            waiting = self.heard[topic]
            while waiting and not found:
                message = waiting.pop(0)
                if holds(message):
                    found.append(message)
            return found

        self.until(came)
        return found[0]

    def publish(self, topic, message, qos=10, rate_hz=None):
        """Publish it once, or again and again; what is not latched, once somebody listens."""
        if topic not in self._publishers:
            made = self._node.create_publisher(type(message), topic, qos)
            self._publishers[topic] = made
        publisher = self._publishers[topic]
        if qos is not LATCHED:
            self.until(publisher.get_subscription_count)
        if rate_hz:
            again = self._node.create_timer(1.0 / rate_hz, lambda: publisher.publish(message))
            self._timers.append(again)
        publisher.publish(message)

    def silence(self):
        """Publish nothing more."""
        while self._timers:
            self._node.destroy_timer(self._timers.pop())
        while self._publishers:
            self._node.destroy_publisher(self._publishers.popitem()[1])

    def ask(self, name, kind, request):
        """The answer of a service."""
        client = self._node.create_client(kind, name)
        self.until(client.service_is_ready)
        answer = self._came(client.call_async(request))
        self._node.destroy_client(client)
        return answer

    def act(self, name, kind, goal):
        """The result of an action."""
        client = ActionClient(self._node, kind, name)
        self.until(client.server_is_ready)
        accepted = self._came(client.send_goal_async(goal))
        answer = self._came(accepted.get_result_async())
        client.destroy()
        return answer.result

    def _came(self, future):
        self.until(future.done)
        return future.result()

    def close(self):
        self._executor.shutdown()
        self._node.destroy_node()
        rclpy.shutdown(context=self._context)
