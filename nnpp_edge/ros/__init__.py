"""Maps, paths and messages as ROS 2 lays them out, without ROS."""
