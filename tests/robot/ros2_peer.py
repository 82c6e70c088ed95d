"""The other process: plain rclpy, nothing of ours. Lines of JSON say what it publishes and asks for,
and what it hears it prints as such.
"""

import array
import json
import sys
import threading
import time
from contextlib import suppress
from importlib import import_module

import rclpy
from rclpy.action import ActionClient
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
SENSOR = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
QOS = {"latched": LATCHED, "sensor": SENSOR, "default": QoSProfile(depth=10)}


def kind_of(name):
    package, part, kind = name.split("/")
    return getattr(import_module(f"{package}.{part}"), kind)


def fill(message, values):
    """Set a message's fields from nested dicts."""
    for name, value in values.items():
        old = getattr(message, name)
        if isinstance(value, dict):
            fill(old, value)
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            inner = message.get_fields_and_field_types()[name].split("<")[1].rstrip(">")
            package, kind = inner.split("/")
            setattr(message, name, [fill(kind_of(f"{package}/msg/{kind}")(), v) for v in value])
        elif isinstance(old, float):
            setattr(message, name, float(value))
        else:
            setattr(message, name, value)
    return message


def told(value):
    """A message as nested dicts."""
    if hasattr(value, "get_fields_and_field_types"):
        return {name: told(getattr(value, name)) for name in value.get_fields_and_field_types()}
    if isinstance(value, array.array):
        return value.tolist()
    if isinstance(value, list | tuple):
        return [told(each) for each in value]
    return (
        value.tolist()
        if hasattr(value, "tolist")
        else value.hex()
        if isinstance(value, bytes)
        else value
    )


lock = threading.Lock()


def say(topic, message):
    with lock:
        print(json.dumps([topic, told(message)]), flush=True)


rclpy.init()
node = rclpy.create_node("peer")
executor = SingleThreadedExecutor()
executor.add_node(node)
publishers = {}
clients = {}
timers = {}


def do(op, name, kind, qos="default", **more):
    if op == "listen":
        node.create_subscription(kind_of(kind), name, lambda message: say(name, message), QOS[qos])
    elif op == "publish":
        if name not in publishers:
            publishers[name] = node.create_publisher(kind_of(kind), name, QOS[qos])
        message = fill(kind_of(kind)(), more["message"])
        if name in timers:
            node.destroy_timer(timers.pop(name))
        if rate := more.get("rate_hz"):
            timers[name] = node.create_timer(1.0 / rate, lambda: publishers[name].publish(message))
        publisher = publishers[name]
        until = time.monotonic() + 5.0
        while (
            not publisher.get_subscription_count() and time.monotonic() < until and qos != "latched"
        ):
            time.sleep(0.01)
        publisher.publish(message)
    elif op == "silence":
        for made, free in ((timers, node.destroy_timer), (publishers, node.destroy_publisher)):
            if name in made:
                free(made.pop(name))
    elif op == "call":
        client = clients.setdefault(name, node.create_client(kind_of(kind), name))
        client.wait_for_service(10.0)
        future = client.call_async(fill(kind_of(kind).Request(), more["message"]))
        future.add_done_callback(lambda done: say(name, done.result()))
    elif op == "act":
        client = clients.setdefault(name, ActionClient(node, kind_of(kind), name))
        client.wait_for_server(10.0)
        sent = client.send_goal_async(fill(kind_of(kind).Goal(), more["message"]))

        def accepted(done):
            done.result().get_result_async().add_done_callback(
                lambda result: say(name, result.result().result)
            )

        sent.add_done_callback(accepted)


asked = []


def read():
    for line in sys.stdin:
        with lock:
            asked.append(json.loads(line))
    rclpy.try_shutdown()


threading.Thread(target=read, daemon=True).start()
say("ready", True)
while rclpy.ok():
    with lock:
        now, asked[:] = asked[:], []
    for each in now:
        do(each.pop("op"), each.pop("name"), each.pop("kind"), **each)
    with suppress(ExternalShutdownException):
        executor.spin_once(timeout_sec=0.02)
