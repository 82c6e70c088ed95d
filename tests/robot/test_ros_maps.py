"""Maps in ROS' layouts: small examples by hand, and there and back."""

import functools
import itertools
import json
import math
import operator
import re
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from nnpp_edge.ros.maps import (
    GridMap,
    MapFrame,
    OccupancyGrid,
    arc_poses,
    as_occupancy,
    cloud_patch,
    grid_map_patch,
    occupancy_patch,
    path_poses,
)
from nnpp_edge.ros.messages import definition, grid_message, heights_message
from nnpp_edge.runtime import Planner, Vehicle
from nnpp_edge.runtime.errors import InvalidMapError, InvalidQueryError
from nnpp_edge.terrain.dem import read_dem
from tests.tables import cases

NAN = np.nan
VALUES = np.array([[1, 2, 3], [4, 5, 6]], np.float32)
AGAINST_X = MapFrame(1.0, 6.0, 8.5, rows_along_x=True)


HEADER = {"frame_id": "odom"}


def pose():
    turn = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
    return {"position": {"x": 5.0, "y": 7.0, "z": 0.0}, "orientation": turn}


def occupancy_message():
    """A nav_msgs/OccupancyGrid as nested dicts: three columns along x, two rows along y, cells of
    half a metre.
    """
    info = {"resolution": 0.5, "width": 3, "height": 2, "origin": pose()}
    return {"header": HEADER.copy(), "info": info, "data": [0, 50, -1, 98, 99, 100]}


def message(start=(1, 2), values=VALUES, row_by_row=False, **sides):
    """A grid_map_msgs/GridMap as nested dicts, whose ring begins at `start`."""
    ring = np.roll(values, start, axis=(0, 1))
    rows, cols = ring.shape
    sizes = {"column_index": cols, "row_index": rows}
    dims = [{"label": label, "size": size, "stride": 0} for label, size in sizes.items()]
    layout = {"dim": dims[::-1] if row_by_row else dims, "data_offset": 0}
    data = ring.ravel("C" if row_by_row else "F").tolist()
    lengths = {"length_x": float(rows), "length_y": float(cols)}
    return {
        "header": HEADER.copy(),
        "info": {"resolution": 1.0, **lengths, "pose": pose()} | sides,
        "layers": ["elevation"],
        "basic_layers": [],
        "data": [{"layout": layout, "data": data}],
        "outer_start_index": start[0],
        "inner_start_index": start[1],
    }


def cloud_message(points=((5.2, 7.9, 1.5), (5.9, 7.6, 2.0)), kind="<f4", pad=0, height=1):
    """A sensor_msgs/PointCloud2 as nested dicts: `pad` bytes before each point and after each row."""
    dtype = np.dtype(kind)
    side = dtype.itemsize
    rows = np.array(points, dtype).reshape(height, -1, 3)
    gap = b"?" * pad
    data = b"".join(b"".join(gap + point.tobytes() for point in row) + gap for row in rows)
    fields = [
        {"name": name, "offset": pad + n * side, "datatype": side // 4 + 6}
        for n, name in enumerate("xyz")
    ]
    return {
        "header": HEADER.copy(),
        "height": height,
        "width": rows.shape[1],
        "fields": fields,
        "is_bigendian": kind[0] == ">",
        "point_step": pad + 3 * side,
        "row_step": len(data) // height,
        "data": data,
    }


def read_cloud(message):
    return cloud_patch(message, MapFrame(0.5, 1.0, -2.0, frame_id="odom"), (20, 30))


def as_objects(value):
    """The same with attributes, as ROS has it."""
    if isinstance(value, dict):
        return SimpleNamespace(**{name: as_objects(each) for name, each in value.items()})
    return [as_objects(each) for each in value] if isinstance(value, list) else value


def test_a_grid_map_is_made_of_a_message_and_its_ring_unrolled():
    starts = itertools.product((0, 1), (0, 1, 2))
    for start, row_by_row, kind in itertools.product(starts, (False, True), (dict, as_objects)):
        grid = GridMap.of_message(kind(message(start, row_by_row=row_by_row)))
        np.testing.assert_array_equal(grid.layer(), VALUES)
        assert grid.frame == MapFrame(1.0, 6.0, 8.5, rows_along_x=True, frame_id="odom")
    # the first cell is the farthest along both
    np.testing.assert_allclose(grid.frame.metres([[0, 0], [1, 2]]), [[5.5, 8.0], [4.5, 6.0]])
    assert grid.frame.cell(5.9, 8.4) == (0, 0)
    assert grid.frame.cell(4.1, 5.6) == (1, 2)
    assert grid_map_patch(grid, MapFrame(1.0, frame_id="odom")).shape == (3, 2)


def test_an_occupancy_grid_is_read_row_by_row_along_y():
    for kind in (dict, as_objects):
        grid = OccupancyGrid.of_message(kind(occupancy_message()))
        np.testing.assert_array_equal(
            grid.cost(),
            np.array([[0, 0.5, NAN], [0.98, np.inf, np.inf]], np.float32),
        )
    np.testing.assert_allclose(grid.frame.metres([[0, 0], [1, 2]]), [[5.25, 7.25], [6.25, 7.75]])
    assert grid.frame.cell(6.4, 7.6) == (1, 2)
    assert grid.frame.cell(4.9, 7.6) == (1, -1)


FRAME = MapFrame(0.5, 2.5, 2.0)
COST = np.array([[0.25, NAN, np.inf]], np.float32)
HEIGHTS = np.array([[1, 2, 3], [4, NAN, 6]], np.float32)


@pytest.mark.parametrize(
    ("kind", "content", "patch_of", "wanted"),
    [
        (GridMap, heights_message(HEIGHTS, FRAME, 0), grid_map_patch, HEIGHTS),
        (OccupancyGrid, grid_message(COST, FRAME, 0), occupancy_patch, COST),
    ],
)
def test_messages_are_read_as_other_libraries_decode_them(kind, content, patch_of, wanted):
    """mcap-ros2-support hands out objects with lists, of bytes that this package and those
    libraries write alike.
    """
    from mcap_ros2._dynamic import generate_dynamic

    name = f"{'grid_map' if kind is GridMap else 'nav'}_msgs/{kind.__name__}"
    decoded = generate_dynamic(name, definition(name))[name](content)
    patch = patch_of(kind.of_message(decoded), MapFrame(0.5, frame_id="map"))
    assert (patch.row, patch.col) == (4, 5)
    np.testing.assert_array_equal(patch.values, wanted)


def test_a_saved_layer_lies_where_the_grid_map_does(tmp_path):
    grid = GridMap({"elevation": VALUES}, AGAINST_X)
    grid.save(tmp_path / "map.npz")
    dem = read_dem(tmp_path / "map.npz")
    np.testing.assert_array_equal(dem.elevation, VALUES)
    assert (dem.cell_size_m, dem.cell_width_m) == (1.0, 1.0)
    for cell in ((0, 0), (1, 2)):
        x, y = grid.frame.metres([cell])[0]
        assert dem.map_coordinates(*cell) == pytest.approx((x, y)) and dem.cell_of(x, y) == cell


@given(
    st.lists(
        st.floats(0.0, 2.0, width=32) | st.sampled_from([NAN, np.inf, 0.98, 0.985, 0.99, 0.999]),
        min_size=1,
    )
)
@example([0.01 * n for n in range(101)])
def test_a_cost_read_back_is_passable_impassable_or_unknown_as_it_was(costs):
    cost = np.array([costs], np.float32)
    grid = OccupancyGrid(as_occupancy(cost), MapFrame(0.1))
    back = grid.cost()
    np.testing.assert_array_equal(np.isnan(back), np.isnan(cost))
    np.testing.assert_array_equal(back < 1.0, cost < 1.0)
    passable = cost < 1.0
    np.testing.assert_allclose(back[passable], np.minimum(cost[passable], 0.98), atol=0.00501)
    np.testing.assert_array_equal(as_occupancy(back), grid.data)


@pytest.mark.parametrize(
    "target", [MapFrame(1.0, -3.0, -2.0), MapFrame(1.0, 11.0, 13.0, rows_along_x=True)]
)
def test_every_cell_of_a_patch_lands_where_it_lay(target):
    grid_map = GridMap({"told": VALUES}, MapFrame(1.0, 6.0, 9.0, rows_along_x=True))
    occupied = OccupancyGrid(np.arange(6).reshape(2, 3), MapFrame(1.0, 4.0, 5.0))
    for patch, frame, values in (
        (grid_map_patch(grid_map, target, "told"), grid_map.frame, VALUES),
        (occupancy_patch(occupied, target), occupied.frame, occupied.cost()),
    ):
        world = on_map(patch, (14, 15), NAN)
        for (row, col), value in np.ndenumerate(values):
            assert world[target.cell(*frame.metres([[row, col]])[0])] == value
        assert np.isfinite(world).sum() == values.size


def on_map(patch, shape, unseen):
    """A map on which only a patch is known."""
    found = np.full(shape, unseen, np.float32)
    rows, cols = patch.shape
    found[patch.row : patch.row + rows, patch.col : patch.col + cols] = patch.values
    return found


def test_a_patch_is_moved_to_the_nearest_cells_but_never_resampled():
    source = OccupancyGrid(np.zeros((2, 3), np.int8), MapFrame(1.0, 4.4, 5.6, frame_id="map"))
    patch = occupancy_patch(source, MapFrame(1.0))
    assert (patch.row, patch.col) == (6, 4)
    for frame, words in (
        (MapFrame(0.5), r"cells of 0.5 m, got 1.0 m"),
        (MapFrame(1.0, frame_id="odom"), "the frame 'odom', got one in 'map'"),
    ):
        with pytest.raises(InvalidMapError, match=words):
            occupancy_patch(source, frame)


@pytest.mark.parametrize("keep", [True, False])
def test_cells_that_were_not_seen_stay_as_the_map_has_them_unless_told_otherwise(keep):
    grid = OccupancyGrid(np.array([[-1, 100]]), MapFrame(1.0, 1.0, 2.0))
    given = {} if keep else {"keep_known": False}
    patch = occupancy_patch(grid, MapFrame(1.0), **given)
    assert (patch.row, patch.col, patch.keep_known) == (2, 1, keep)
    np.testing.assert_array_equal(patch.cost, [[NAN, np.inf]])


@pytest.mark.parametrize("kind", ["<f4", ">f4", "<f8", ">f8"])
def test_of_a_clouds_points_the_highest_in_each_cell_of_the_map_counts(kind):
    rng = np.random.default_rng(7)
    points = rng.uniform((-2.0, -5.0, -3.0), (20.0, 12.0, 3.0), (400, 3)).astype(kind)
    points[::9, rng.integers(0, 3, 45)] = rng.choice([NAN, np.inf])
    wanted = np.full((20, 30), -np.inf, np.float32)
    for x, y, z in points[np.isfinite(points).all(axis=1)]:
        if 1.0 <= x < 16.0 and -2.0 <= y < 8.0:
            cell = int((y + 2.0) // 0.5), int((x - 1.0) // 0.5)
            wanted[cell] = max(wanted[cell], z)
    for message in (cloud_message(points, kind), cloud_message(points, kind, pad=5, height=8)):
        patch = read_cloud(message)
        np.testing.assert_array_equal(on_map(patch, (20, 30), -np.inf), wanted)
        assert patch.keep_known
    assert read_cloud(cloud_message()).shape == (1, 2)  # no larger than the points are apart


PATH = np.array([[0, 0], [1, 1], [1, 2]], np.int32)


POSES = """
3 | 2 10 20 0 | 11 21 45    13 23 0    15 23 0
3 | 2 10 20 1 | 9 19 -135   7 17 -90   7 15 -90
1 | 1 0 0 0   | 0.5 0.5 0
0 | 1 0 0 0   |
"""
"""Cells of the path; side, x and y of the frame, and whether its rows run along x; the poses."""


@pytest.mark.parametrize(("cells", "frame", "poses"), cases(POSES, 3))
def test_a_path_becomes_poses_in_metres(cells, frame, poses):
    side, x, y, rows_along_x = map(float, frame.split())
    found = path_poses(PATH[: int(cells)], MapFrame(side, x, y, bool(rows_along_x)))
    found[:, 2] = np.degrees(found[:, 2])
    np.testing.assert_allclose(found.ravel(), np.array(poses.split(), float))


GRID = """
info.width                      | 4     | 2 × 4 whole numbers as data, got (6,)
info.width                      | -3    | $.info.width
info.resolution                 | 0.0   | resolution
info.origin.orientation.z       | 0.1   | not turned
data                            | [[1.0], [1.0, 2.0]] | wanted numbers
data                            | null  | 2 × 3 whole numbers as data, got ()
data                            | "x"   | 2 × 3 whole numbers as data, got ()
data                            | [1, 2, 3, 4, 5, NaN] | whole numbers, got (2, 3) float64
info.resolution                 | "x"   | $.info.resolution
info.resolution                 | NaN   | resolution
info.height                     | 1e300 | $.info.height
info.origin.position.x          | NaN   | corner must be finite
header                          | 3     | $.header
"""
LAYERS = """
info.pose.orientation.z         | 0.1   | (0.0, 0.0, 0.1, 1.0)
info.pose.orientation.x         | NaN   | not turned
info.resolution                 | 0.0   | resolution
info.length_x                   | 2.5   | multiples of 1.0 m above 0
info.resolution                 | 1e-300 | corner must be finite, within 1e-288 m
info.pose.position.y            | 1e300  | corner must be finite, within 1e+12 m
data.0.layout.dim.0.label       | ""    | laid out by
data.0.layout.dim.0.size        | 2     | laid out by
data.0.layout.dim | [{"label":"row_index","size":3},{"label":"column_index","size":2}] | laid out by
data.0.data                     | [1.0, 1.0, 1.0] | 2 × 3 numbers, got (3,)
layers                          | ["elevation", "cost"] | a name for each of 1 layers, got
layers                          | ["a", "a"] | a name for each of 1 layers, got
outer_start_index               | 0.5   | $.outer_start_index
outer_start_index               | 2     | within 2 × 3 cells
inner_start_index               | -1    | $.inner_start_index
info.length_y                   | 1e300 | finite
info.length_x                   | -1.0  | multiples of 1.0 m above 0
info.length_x                   | NaN   | finite
data.0.data                     | "x"   | 2 × 3 numbers, got ()
layers                          | "x"   | $.layers
"""
CLOUD = """
header.frame_id                 | "map" | a map in the frame 'odom', got one in 'map'
fields.1.name                   | "r"   | x, y and z as FLOAT32 or FLOAT64, got others, with ['x', 'r', 'z']
fields.2.datatype               | 6     | x, y and z as FLOAT32 or FLOAT64, got others, with ['x', 'y', 'z']
fields.2.offset                 | 10    | 1 × 2 points of 12 bytes with
width                           | 3     | 1 × 3 points of 12 bytes with
height                          | 2     | 2 × 2 points of 12 bytes with
row_step                        | 23    | 1 × 2 points of 12 bytes with
width                           | 0     | points on a map of (20, 30) cells, got none there
data                            | null  | 1 × 2 points of 12 bytes with
data                            | [1]   | 1 × 2 points of 12 bytes with
point_step                      | -1    | $.point_step
fields.0.offset                 | 1e300 | offset
"""
"""The path to a value of a message, another value, and words of the refusal."""


def put(message, path, value):
    """Set the value at a path of names and numbers in nested dicts and lists."""
    *most, last = (int(step) if step.isdigit() else step for step in path.split("."))
    functools.reduce(operator.getitem, most, message)[last] = value


@pytest.mark.parametrize(
    ("read", "made", "table"),
    [
        (OccupancyGrid.of_message, occupancy_message, GRID),
        (GridMap.of_message, message, LAYERS),
        (read_cloud, cloud_message, CLOUD),
    ],
)
def test_a_message_that_makes_no_map_or_would_be_read_scrambled_is_refused(read, made, table):
    for case in cases(table, 3):
        path, value, words = case.values
        altered = made()
        put(altered, path, json.loads(value))
        with pytest.raises(InvalidMapError, match=re.escape(words)):
            read(altered)


NO_MAPS = r"""
OccupancyGrid.of_message(message()) | `width`
GridMap.of_message(np.zeros((2, 3))) | another message of ROS
OccupancyGrid(np.zeros((2, 3)), MapFrame(1.0)) | \(2, 3\) float64
OccupancyGrid(np.zeros(6, int), MapFrame(1.0)) | a map \(height, width\)
OccupancyGrid(np.full((2, 3), 101), MapFrame(1.0)) | \[-1, 100\], got \[101
OccupancyGrid(np.zeros((2, 2), int), AGAINST_X) | rows must run with y
MapFrame(1.0, x=math.nan) | finite
GridMap({'elevation': VALUES}, AGAINST_X).layer('cost') | has elevation
GridMap({'a': np.zeros((2, 2))}, MapFrame(1.0)) | against x
GridMap({}, AGAINST_X) | got none
GridMap({'a': VALUES, 'b': VALUES.T}, AGAINST_X) | one shape
"""


@pytest.mark.parametrize(
    ("make", "words"),
    cases(NO_MAPS),
)
def test_what_makes_no_map_is_refused(make, words):
    with pytest.raises(InvalidMapError, match=words):
        eval(make)


@pytest.mark.parametrize(
    "points",
    [(math.nan, 0.0), ("x", 0.0), [[1.0], [1.0, 2.0]], (1.0, 2.0, 3.0), None],
)
def test_points_must_be_finite(points):
    with pytest.raises((InvalidQueryError, InvalidMapError)):
        MapFrame(1.0).places(points)


@pytest.mark.parametrize("rows_along_x", [False, True])
def test_a_yaw_and_its_heading_point_to_the_same_place_and_lead_back(rows_along_x):
    frame = MapFrame(0.5, 3.0, -4.0, rows_along_x=rows_along_x)
    for yaw_deg in range(-179, 181, 7):
        yaw = math.radians(yaw_deg)
        heading = frame.heading_deg(yaw)
        assert 0.0 <= heading < 360.0
        assert frame.yaw_rad(heading) == pytest.approx(yaw)
        up = math.radians(heading)
        step = frame.metres([[0.0, 0.0], [-math.cos(up), math.sin(up)]])
        x, y = step[1] - step[0]
        assert math.atan2(y, x) == pytest.approx(yaw)


@pytest.mark.parametrize("rows_along_x", [False, True])
def test_arcs_become_poses_that_lead_on_from_one_another_in_the_frame(rows_along_x):
    car = Vehicle(1.2, 0.8, 0.3, turning_radius_m=1.5, reverse_cost=2.0)
    planner = Planner.of_elevation(np.zeros((80, 90), np.float32), 0.25, vehicle=car)
    plan = planner.plan((40, 20), (30, 24), start_heading_deg=90.0, goal_heading_deg=180.0)
    frame = MapFrame(0.25, 30.0, 40.0, rows_along_x=rows_along_x)
    poses = arc_poses(plan, frame)
    np.testing.assert_allclose(poses[[0, -1], :2], frame.metres([(40, 20), (30, 24)]))
    yaws = [frame.yaw_rad(90.0), frame.yaw_rad(180.0)]
    np.testing.assert_allclose(np.exp(1j * poses[[0, -1], 2]), np.exp(1j * np.array(yaws)))
    assert set(poses[:, 3]) == {1.0, -1.0}
    steps = np.diff(poses[:, :2], axis=0)
    lengths = np.hypot(*steps.T)
    assert lengths.max() <= 0.25
    # a step leads where the body heads on its way, or backwards
    turned = np.angle(np.exp(1j * np.diff(poses[:, 2])))
    middle = poses[:-1, 2] + 0.5 * turned
    ahead = np.cos(middle) * steps[:, 0] + np.sin(middle) * steps[:, 1]
    np.testing.assert_allclose(ahead, poses[1:, 3] * lengths, atol=1e-6)


def test_a_path_without_arcs_has_the_poses_of_its_cells_or_way_points():
    planner = Planner(np.full((30, 40), 0.2, np.float32))
    plan = planner.plan((5, 5), (20, 35), refine="any-angle")
    frame = MapFrame(0.5, 1.0, 2.0)
    poses = arc_poses(plan, frame)
    assert poses.shape == (len(plan.waypoints), 4)
    np.testing.assert_allclose(poses[[0, -1], :2], frame.metres([(5, 5), (20, 35)]))
    of_cells = planner.plan((5, 5), (20, 35))
    cells = arc_poses(of_cells, frame)
    np.testing.assert_array_equal(cells[:, :3], path_poses(of_cells.path, frame))
    planner.update(0, 20, np.ones((30, 1)))
    assert arc_poses(planner.plan((5, 5), (20, 35)), frame).shape == (0, 4)
