"""nnpp-edge as a package of a colcon workspace."""
