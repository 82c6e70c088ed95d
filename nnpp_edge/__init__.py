"""nnpp-edge: learned path planning on a robot's own computer."""

__version__ = "0.1.0"
