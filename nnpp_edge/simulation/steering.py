"""A kinematic vehicle that follows arcs, with noise in its steering."""

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from nnpp_edge.runtime.map.arcs import Arc, Drive, PoseOf
from nnpp_edge.runtime.terrain.vehicle import Vehicle

_CORRECTS_WITHIN = 0.5
"""Turning radii over which it steers back to the path: critically damped."""


def followed(
    pose: PoseOf, drive: Drive, vehicle: Vehicle, noise_deg: float, rng: np.random.Generator
) -> Iterator[Arc]:
    """The arcs by which a vehicle follows a drive from where it stands, one for each of its poses ahead.

    It steers by the arc's curvature, and back to the path from where it is beside it, never sharper than its turning
    radius. The angle is off by one normal error of so many degrees all along; a turn on the spot ends as far off.
    """
    least, wheelbase = vehicle.turning_radius_m or math.inf, vehicle.stance_m[0]
    within, error_deg = _CORRECTS_WITHIN * least, rng.normal(0.0, noise_deg)
    for n, (gear, curvature) in enumerate(zip(drive.gears[1:].tolist(), drive.curvatures_per_m[1:], strict=True)):
        if gear:
            _, aside, turned = _beside(pose, drive.poses[n])
            wanted = curvature - aside / within**2 - 2.0 * gear * turned / within
            steered = math.tan(math.atan(wanted * wheelbase) + math.radians(error_deg))
            bend = float(np.clip(steered / wheelbase, -1.0 / least, 1.0 / least))
            if (length := -gear * _beside(pose, drive.poses[n + 1])[0]) <= 0.0:
                continue  # it is past that pose
            if sharp := abs(bend):  # until it has come as far ahead
                length = math.asin(min(sharp * length, 1.0)) / sharp
            arc = Arc(gear, bend, length, pose, math.degrees(gear * bend * length))
        else:
            turned = _beside(pose, drive.poses[n + 1])[2]
            arc = Arc(0, 0.0, 0.0, pose, error_deg - math.degrees(turned))
        yield arc
        pose = arc.at(1.0)


def _beside(pose: PoseOf, place: NDArray[np.float64]) -> tuple[float, float, float]:
    """How far a pose lies ahead of another and to its left, in metres, and is turned to its left, in rad."""
    x, y, heading = pose[0] - place[0], pose[1] - place[1], math.radians(place[2])
    turned = math.radians((place[2] - pose[2] + 180.0) % 360.0 - 180.0)
    ahead, left = x * math.sin(heading) - y * math.cos(heading), -x * math.cos(heading) - y * math.sin(heading)
    return ahead, left, turned
