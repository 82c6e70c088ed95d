"""Send a map of elevations, a pose and a goal to `nnpp-edge ros` by rclpy alone; print its path.

nnpp-edge ros --ros-args -p map_size_m:=20.0 -p resolution:=0.25 &
python send_elevations.py
"""

from array import array

import numpy as np
import rclpy
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import PointCloud2, PointField

# a hill: a point in the middle of each cell of the node's map
middles = 0.25 * (np.arange(80) + 0.5) - 10.0
x, y = np.meshgrid(middles, middles)
z = 3.0 * np.exp(-(x**2 + y**2) / 4.0)
points = np.stack((x, y, z), axis=-1).astype(np.float32)

cloud = PointCloud2(height=80, width=80, point_step=12, row_step=12 * 80)
cloud.header.frame_id = "map"
for n, name in enumerate("xyz"):
    field = PointField(name=name, offset=4 * n, datatype=PointField.FLOAT32, count=1)
    cloud.fields.append(field)
cloud.data = array("B", points.tobytes())

robot = PoseStamped()
robot.header.frame_id = "map"
robot.pose.position.x = -8.0
goal = PoseStamped()
goal.header.frame_id = "map"
goal.pose.position.x = 8.0

rclpy.init()
node = rclpy.create_node("elevations")
clouds = node.create_publisher(PointCloud2, "elevation_points", 10)
poses = node.create_publisher(PoseStamped, "pose", 10)
goals = node.create_publisher(PoseStamped, "goal_pose", 10)
paths = []
latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
node.create_subscription(Path, "plan", paths.append, latched)


def send():
    clouds.publish(cloud)
    poses.publish(robot)
    goals.publish(goal)


node.create_timer(0.5, send)
while not (paths and paths[-1].poses):
    rclpy.spin_once(node)
for stamped in paths[-1].poses:
    print(f"{stamped.pose.position.x:.2f} {stamped.pose.position.y:.2f}")
