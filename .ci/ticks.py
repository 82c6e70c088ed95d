"""What a tick of the loop takes, and what garbage collection and loading take of it.

python .ci/ticks.py TICKS RATE [options of nnpp-edge simulate]

A simulated robot drives on and on, with the deadlines of the rate, but nothing is waited for: in the
place of a sleep the next tick is moved here. Reading the inputs is not counted, as the scene is
simulated there.
"""

import contextlib
import gc
import json
import sys
import time
from array import array
from io import StringIO

import numpy as np

from nnpp_edge.cli.main import cli
from nnpp_edge.robot.transports.wire import encode
from nnpp_edge.runtime.exercises import exercise
from nnpp_edge.runtime.loop import runner
from nnpp_edge.simulation import simulate

elapsed = array("d")
"""Seconds of each tick."""
on_processor = array("d")
"""Of these those in which this thread ran."""
slowest = [0.0, None]
"""Most of these seconds, and the answer of that tick."""
collections = []
"""Seconds of each garbage collection."""


class Unwaiting(runner.Loop):
    """Moves the next tick here in place of sleeping until it is due."""

    def _sleep(self, seconds):
        left_s = seconds - runner._WAKE_S
        if left_s <= 0.0 or not self.navigator.go_on(left_s):
            self._ticker._origin -= seconds
        return self._stopping

    def _read_inputs(self, began):
        if not elapsed:
            collections.clear()  # of before the first tick
        super()._read_inputs(began)
        self.read = time.perf_counter(), time.thread_time()

    def _tick(self):
        message = super()._tick()
        encode(message)  # as a sink does, in a thread of its own
        read_s, read_cpu_s = self.read
        elapsed.append(time.perf_counter() - read_s)
        on_processor.append(time.thread_time() - read_cpu_s)
        if on_processor[-1] > slowest[0]:
            slowest[:] = on_processor[-1], message
        return message


def note_collection(phase, info):
    """Begin, or end, to count a garbage collection."""
    collections.append(time.perf_counter() - (collections.pop() if phase == "stop" else 0.0))


def quantiles(name, seconds):
    shares = np.quantile(seconds, [0.5, 0.99, 0.999])
    figures = ", ".join(f"{1e3 * each:.2f}" for each in (*shares, np.max(seconds)))
    print(f"{name}: p50, p99, p99.9, slowest {figures} ms")


def main(ticks, rate, *options):
    print(f"imports: {time.process_time():.2f} s of a processor")
    began = time.process_time()
    exercise()
    print(f"kernels and a network: {time.process_time() - began:.2f} s of a processor")
    simulate.Loop = Unwaiting
    gc.callbacks.append(note_collection)
    words = f"simulate --endless --workload limit20 --size 512 --ticks {ticks} --rate {rate} --json"
    with contextlib.redirect_stdout(StringIO()) as printed:
        cli.main([*words.split(), *options], standalone_mode=False)
    gc.callbacks.clear()
    drive = json.loads(printed.getvalue())
    late = int(np.greater(elapsed, 1.0 / float(rate)).sum())
    counts = "planned", "kept", "failed", "goals", "forbidden"
    print(
        f"{len(elapsed)} ticks at {rate} Hz, {late} late:", {name: drive[name] for name in counts}
    )
    quantiles("a tick", elapsed)
    quantiles("of it on a processor", on_processor)
    message = slowest[1]
    print(f"slowest: tick {message.tick}, {message.outcome} by {message.origin}: {message.reason}")
    quantiles(f"{len(collections)} garbage collections, each", collections)


if __name__ == "__main__":
    main(*sys.argv[1:])
