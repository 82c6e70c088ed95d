"""nnpp-edge: learned path planning on a robot's own computer."""

import os

__version__ = "0.1.0"
os.environ.setdefault(
    "ORT_DISABLE_TELEMETRY", "1"
)  # which ONNX Runtime, from 1.29, reads when it is imported
