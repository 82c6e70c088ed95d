"""Ground for the tests of `nnpp-edge view`, and the server in a process of its own."""

import signal
import subprocess
import sys
from contextlib import contextmanager

import numpy as np

COMMAND = (
    sys.executable,
    "-W",
    "error",
    "-W",
    "ignore::UserWarning",
    "-m",
    "nnpp_edge.cli.main",
    "view",
)
"""Warnings to users, such as of a network that was trained for another ω, are no errors."""


def write_ground(folder, rows=96, cols=120):
    """Rolling ground on cells of 2 m, with a hill and a hole of unknown heights."""
    row, col = np.mgrid[0:rows, 0:cols]
    heights = 1.2 * np.sin(row / 9.0) * np.cos(col / 11.0) + 2.0 * np.sin(col / 30.0)
    heights += 8.0 * np.exp(-((row - 0.65 * rows) ** 2 + (col - 0.7 * cols) ** 2) / 160.0)
    heights[40:52, 60:72] = np.nan
    np.savez(folder / "ground.npz", elevation_m=heights.astype(np.float32), cell_size_m=2.0)
    return folder / "ground.npz"


class Server:
    """A running `nnpp-edge view`."""

    def __init__(self, process):
        self.process = process
        assert process.stdout is not None
        self.address = process.stdout.readline().strip()
        assert self.address.startswith("http://127.0.0.1:"), self.address or self.end()
        self.port = int(self.address.rpartition(":")[2].strip("/"))

    def end(self):
        """Ctrl-C: exit code, and what it had to say on stderr."""
        self.process.send_signal(signal.SIGINT)
        _, said = self.process.communicate(timeout=30)
        return self.process.returncode, said


@contextmanager
def serving(*words):
    """A `Server` with these words, ended afterwards."""
    command = [*COMMAND, *map(str, words), "--port", "0", "--no-browser"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        yield Server(process)
    finally:
        if process.poll() is None:
            process.kill()
        process.communicate()
