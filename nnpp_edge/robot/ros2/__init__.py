"""The onboard loop as a ROS 2 node: its parameters, topics, services and life cycle."""
