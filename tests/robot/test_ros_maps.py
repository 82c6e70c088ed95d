"""Maps in ROS' layouts: small examples by hand, and there and back."""

import functools
import itertools
import math
import operator
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nnpp_edge.ros.maps import GridMap, MapFrame, OccupancyGrid, grid_map_patch, occupancy_patch, path_poses
from nnpp_edge.ros.messages import definition, grid_message, heights_message
from nnpp_edge.ros.occupancy import as_cost, as_occupancy
from nnpp_edge.runtime.errors import InvalidMapError, InvalidQueryError
from nnpp_edge.runtime.loop.navigator import Navigator
from nnpp_edge.runtime.map.ground import Ground
from nnpp_edge.terrain.dem import read_dem

NAN = np.nan


def occupancy(**changes):
    """Three columns along x, two rows along y, cells of half a metre, corner at (10, 20)."""
    data = np.array([0, 50, -1, 98, 99, 100], np.int8)
    plain = {"resolution": 0.5, "width": 3, "height": 2, "data": data, "origin_x": 10.0, "origin_y": 20.0}
    return OccupancyGrid(**(plain | changes))


def grid_map(start=(0, 0), **changes):
    """Two rows against x, three columns against y, cells of 1 m, middle at (5, 7); the ring begins at `start`."""
    unrolled = np.array([[1, 2, 3], [4, 5, 6]], np.float32)
    flat = np.empty(6, np.float32)
    for i in range(2):
        for j in range(3):
            row, col = (i + start[0]) % 2, (j + start[1]) % 3
            flat[col * 2 + row] = unrolled[i, j]
    place = {"resolution": 1.0, "length_x": 2.0, "length_y": 3.0, "x": 5.0, "y": 7.0}
    ring = {"layers": {"elevation": flat}, "outer_start_index": start[0], "inner_start_index": start[1]}
    return GridMap(**(place | ring | changes))


def put(grid):
    return grid_map_patch(grid, MapFrame(1.0, frame_id="odom"))


def message(row_by_row=False, turned=0.0):
    """A grid_map_msgs/GridMap as nested dicts, of the same cells as `grid_map(start=(1, 2))`."""
    grid = grid_map((1, 2))
    flat, dims = grid.layers["elevation"], [("column_index", 3), ("row_index", 2)]
    if row_by_row:
        flat, dims = flat.reshape(3, 2).T.reshape(-1), dims[::-1]
    layout = {"dim": [{"label": label, "size": size, "stride": 0} for label, size in dims], "data_offset": 0}
    pose = {
        "position": {"x": 5.0, "y": 7.0, "z": 0.0},
        "orientation": {"x": 0.0, "y": 0.0, "z": turned, "w": 1.0},
    }
    return {
        "header": {"frame_id": "odom"},
        "info": {"resolution": 1.0, "length_x": 2.0, "length_y": 3.0, "pose": pose},
        "layers": ["elevation"],
        "basic_layers": [],
        "data": [{"layout": layout, "data": flat.tolist()}],
        "outer_start_index": 1,
        "inner_start_index": 2,
    }


def occupancy_message():
    """A nav_msgs/OccupancyGrid as nested dicts."""
    info = {"resolution": 0.5, "width": 3, "height": 2, "origin": message()["info"]["pose"]}
    return {"header": {"frame_id": "odom"}, "info": info, "data": [0, 50, -1, 98, 99, 100]}


def leaves(value, path=()):
    """The path to each value in nested dicts and lists, and to those that hold them."""
    if path:
        yield path
    of = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for step, inner in of:
        yield from leaves(inner, (*path, step))


def swap(changed):
    """Say that the layer's rows are columns, by the sizes of the two."""
    for dim in changed["data"][0]["layout"]["dim"]:
        dim["size"] = 5 - dim["size"]


def as_objects(value):
    """The same with attributes, as ROS has it."""
    if isinstance(value, dict):
        return SimpleNamespace(**{name: as_objects(each) for name, each in value.items()})
    return [as_objects(each) for each in value] if isinstance(value, list) else value


@pytest.mark.parametrize("row_by_row", [False, True])
@pytest.mark.parametrize("kind", [dict, as_objects])
def test_a_grid_map_is_made_of_a_message(kind, row_by_row):
    grid = GridMap.of_message(kind(message(row_by_row)))
    np.testing.assert_array_equal(grid.layer(), [[1, 2, 3], [4, 5, 6]])
    assert grid.frame == MapFrame(1.0, 6.0, 8.5, rows_along_x=True, frame_id="odom")
    assert GridMap.of_layers({"elevation": grid.layer()}, grid.frame).frame == grid.frame
    frame = MapFrame(1.0, frame_id="odom")
    assert grid_map_patch(grid, frame).shape == (3, 2)


def test_messages_are_read_as_other_libraries_decode_them():
    """mcap-ros2-support hands out objects with lists, of bytes that this package and those libraries write alike."""
    from mcap_ros2._dynamic import generate_dynamic

    heights = np.array([[1, 2, 3], [4, NAN, 6]], np.float32)
    name = "grid_map_msgs/GridMap"
    decoded = generate_dynamic(name, definition(name))[name](heights_message(heights, (4, 5), 0.5, 0))
    grid = GridMap.of_message(decoded)
    patch = grid_map_patch(grid, MapFrame(0.5, frame_id="map"))
    assert (patch.row, patch.col) == (4, 5)
    np.testing.assert_array_equal(patch.elevation, heights)
    cost = np.array([[0.25, NAN, np.inf]], np.float32)
    name = "nav_msgs/OccupancyGrid"
    decoded = generate_dynamic(name, definition(name))[name](grid_message(cost, (4, 5), 0.5, 0))
    patch = occupancy_patch(OccupancyGrid.of_message(decoded), MapFrame(0.5, frame_id="map"))
    assert (patch.row, patch.col) == (4, 5)
    np.testing.assert_array_equal(patch.cost, cost)


def test_a_saved_layer_lies_where_the_grid_map_does(tmp_path):
    grid = grid_map((1, 2))
    grid.save(tmp_path / "map.npz")
    dem = read_dem(tmp_path / "map.npz")
    np.testing.assert_array_equal(dem.elevation, grid.layer())
    assert (dem.cell_size_m, dem.cell_width_m) == (1.0, 1.0)
    for cell in ((0, 0), (1, 2)):
        x, y = grid.frame.metres([cell])[0]
        assert dem.map_coordinates(*cell) == pytest.approx((x, y)) and dem.cell_of(x, y) == cell


def test_an_occupancy_grid_is_read_row_by_row_along_y():
    grid = occupancy()
    np.testing.assert_array_equal(grid.cost(), np.array([[0, 0.5, NAN], [0.98, np.inf, np.inf]], np.float32))
    np.testing.assert_array_equal(grid.cost(50)[0], np.array([0, np.inf, NAN], np.float32))
    np.testing.assert_allclose(grid.frame.metres([[0, 0], [1, 2]]), [[10.25, 20.25], [11.25, 20.75]])
    assert grid.frame.cell(11.4, 20.6) == (1, 2)
    assert grid.frame.cell(9.9, 20.6) == (1, -1)


def test_an_occupancy_grid_comes_back_as_it_was():
    data = np.concatenate([np.arange(-1, 99), np.full(4, 100)]).astype(np.int8)
    grid = OccupancyGrid(0.1, 13, 8, data, -3.0, 4.0)
    back = OccupancyGrid.of_cost(grid.cost(), grid.frame)
    np.testing.assert_array_equal(back.data, data)
    assert (back.width, back.height, back.origin_x, back.origin_y, back.resolution) == (13, 8, -3.0, 4.0, 0.1)
    assert OccupancyGrid.of_cost([[0.999, 1.0, 7.0, np.inf]], grid.frame).data.tolist() == [98, 100, 100, 100]


@given(st.lists(st.floats(0.0, 2.0, width=32) | st.sampled_from([NAN, np.inf, 0.98, 0.985, 0.99, 0.999]), min_size=1))
def test_a_cost_read_back_is_passable_impassable_or_unknown_as_it_was(costs):
    cost = np.array(costs, np.float32)
    occupancy = as_occupancy(cost)
    back = as_cost(occupancy)
    np.testing.assert_array_equal(np.isnan(back), np.isnan(cost))
    np.testing.assert_array_equal(back < 1.0, cost < 1.0)
    passable = cost < 1.0
    np.testing.assert_allclose(back[passable], np.minimum(cost[passable], 0.98), atol=0.00501)
    np.testing.assert_array_equal(as_occupancy(back), occupancy)


def test_an_occupancy_written_again_means_the_same():
    cost = as_cost(np.arange(-1, 101))
    again = as_occupancy(cost)
    assert again.tolist() == [*range(-1, 99), 100, 100]
    np.testing.assert_array_equal(as_cost(again), cost)


def test_a_grid_map_is_read_column_by_column_and_its_ring_unrolled():
    first = grid_map()
    np.testing.assert_array_equal(first.layers["elevation"], [1, 4, 2, 5, 3, 6])
    for start in [(0, 0), (1, 0), (0, 2), (1, 1)]:
        np.testing.assert_array_equal(grid_map(start).layer(), [[1, 2, 3], [4, 5, 6]])
    # rows run against x, columns against y: the first cell is the farthest along both
    np.testing.assert_allclose(first.frame.metres([[0, 0], [1, 2]]), [[5.5, 8.0], [4.5, 6.0]])
    assert first.frame.cell(5.9, 8.4) == (0, 0)
    assert first.frame.cell(4.1, 5.6) == (1, 2)


@settings(deadline=None)
@given(st.integers(1, 7), st.integers(1, 7), st.data())
def test_a_grid_map_comes_back_as_it_was(rows, cols, data):
    start = data.draw(st.integers(0, rows - 1)), data.draw(st.integers(0, cols - 1))
    values = np.arange(rows * cols, dtype=np.float32).reshape(rows, cols)
    values[data.draw(st.integers(0, rows - 1)), 0] = NAN
    frame = MapFrame(0.25, 3.0, -2.0, rows_along_x=True)
    grid = GridMap.of_layers({"elevation": values, "cost": values + 1}, frame, start=start)
    assert (grid.outer_start_index, grid.inner_start_index) == start
    np.testing.assert_array_equal(grid.layer(), values)
    np.testing.assert_array_equal(grid.layer("cost"), values + 1)
    assert grid.frame.x == pytest.approx(3.0)
    assert grid.frame.y == pytest.approx(-2.0)


@pytest.mark.parametrize("rows_along_x", [False, True])
def test_every_cell_of_a_patch_lands_where_it_lay(rows_along_x):
    target = MapFrame(1.0, 11.0 if rows_along_x else -3.0, 13.0 if rows_along_x else -2.0, rows_along_x=rows_along_x)
    world = np.full((14, 15), NAN, np.float32)
    occupied = OccupancyGrid(1.0, 3, 2, np.arange(6), 4.0, 5.0)
    for source, name in ((grid_map((1, 2), y=7.5), "elevation"), (occupied, "cost")):
        if name == "elevation":
            patch, values = grid_map_patch(source, target, stamp=3.0), source.layer()
        else:
            patch, values = occupancy_patch(source, target, stamp=3.0), source.cost()
        got = getattr(patch, name)
        world[:] = NAN
        world[patch.row : patch.row + got.shape[0], patch.col : patch.col + got.shape[1]] = got
        for (row, col), value in np.ndenumerate(values):
            assert world[target.cell(*source.frame.metres([[row, col]])[0])] == value
        assert np.isfinite(world).sum() == values.size
        assert patch.stamp == 3.0


def test_a_patch_is_moved_to_the_nearest_cells_but_never_resampled():
    source = OccupancyGrid(1.0, 3, 2, np.zeros(6, np.int8), 4.4, 5.6)
    patch = occupancy_patch(source, MapFrame(1.0))
    assert (patch.row, patch.col) == (6, 4)
    with pytest.raises(InvalidMapError, match=r"cells of 0.5 m, got 1.0 m"):
        occupancy_patch(source, MapFrame(0.5))


def test_cells_that_were_not_seen_stay_as_the_map_has_them():
    loop = Navigator(Ground(np.full((4, 5), 0.3, np.float32)))
    grid = OccupancyGrid(1.0, 2, 1, np.array([-1, 100]), 1.0, 2.0)
    loop.offer(occupancy_patch(grid, MapFrame(1.0)))
    loop.tick()
    assert loop.map.cost()[2].tolist() == pytest.approx([0.3, 0.3, math.inf, 0.3, 0.3])
    loop.offer(occupancy_patch(grid, MapFrame(1.0), keep_known=False))
    loop.tick()
    assert np.argwhere(loop.map.unknown()).tolist() == [[2, 1]] and not loop.planner.is_passable((2, 1))


def test_a_layer_may_hold_costs():
    patch = grid_map_patch(grid_map(layers={"cost": np.full(6, 0.5)}), grid_map().frame, "cost", cost=True)
    assert patch.elevation is None
    assert (patch.row, patch.col, patch.shape) == (0, 0, (2, 3))


def test_a_path_becomes_poses_in_metres():
    path = np.array([[0, 0], [1, 1], [1, 2]], np.int32)
    poses = path_poses(path, MapFrame(2.0, 10.0, 20.0))
    np.testing.assert_allclose(poses, [[11, 21, math.pi / 4], [13, 23, 0], [15, 23, 0]])
    against = path_poses(path, MapFrame(2.0, 10.0, 20.0, rows_along_x=True))
    np.testing.assert_allclose(against, [[9, 19, -0.75 * math.pi], [7, 17, -math.pi / 2], [7, 15, -math.pi / 2]])
    assert path_poses(path[:1], MapFrame(1.0)).tolist() == [[0.5, 0.5, 0.0]]
    assert path_poses(np.empty((0, 2), np.int32), MapFrame(1.0)).shape == (0, 3)


@settings(deadline=None)
@given(st.floats(-50, 50), st.floats(-50, 50), st.booleans(), st.sampled_from([0.05, 0.2, 1.0, 3.0]))
def test_places_and_metres_are_inverse(row, col, rows_along_x, resolution):
    frame = MapFrame(resolution, 12.5, -4.0, rows_along_x=rows_along_x)
    np.testing.assert_allclose(frame.places(frame.metres([[row, col]])), [[row, col]], atol=1e-9)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: occupancy(width=4), r"2 × 4 whole numbers, got \(6,\) int8"),
        (lambda: occupancy(data=np.zeros(6)), "whole numbers"),
        (lambda: occupancy(data=np.full(6, 101)), r"\[-1, 100\], got \[101, 101\]"),
        (lambda: occupancy(data=np.full(6, -2, np.int8)), r"\[-1, 100\]"),
        (lambda: occupancy(resolution=0.0).frame, "resolution"),
        (lambda: occupancy(origin_x=math.nan).frame, "finite"),
        (lambda: OccupancyGrid.of_cost(np.zeros((2, 2)), grid_map().frame), "rows must run with y"),
        (lambda: OccupancyGrid.of_cost(np.zeros(3), MapFrame(1.0)), r"\(H, W\) map of numbers, got \(3,\)"),
        (lambda: grid_map(resolution=0.0), "resolution"),
        (lambda: grid_map(length_x=2.5), "multiples of 1.0 m"),
        (lambda: grid_map(length_y=math.inf), "above 0 m"),
        (lambda: grid_map(layers={"a": np.zeros(5)}), r"2 × 3 numbers column by column.*, got \(5,\) float64$"),
        (lambda: grid_map(layers={"a": np.zeros((2, 3))}), r"got \(2, 3\) float64; of_layers takes maps"),
        (lambda: put(grid_map(frame_id="map")), "the frame 'odom', got one in 'map'"),
        (lambda: GridMap.of_message(np.zeros((2, 3))), "a message with layers, got a ndarray without layers"),
        (lambda: GridMap.of_message({"layers": [], "data": [], "info": {}}), "a dict without resolution"),
        (lambda: GridMap.of_message(message(turned=0.1)), r"not turned, .* \[0.0, 0.0, 0.1, 1.0\]"),
        (lambda: OccupancyGrid.of_message(message()), "info.width"),
        (lambda: grid_map(outer_start_index=2), "within 2 × 3 cells"),
        (lambda: grid_map().layer("cost"), "has elevation"),
        (lambda: GridMap.of_layers({"a": np.zeros((2, 2))}, MapFrame(1.0)), "against x"),
        (lambda: GridMap.of_layers({}, grid_map().frame), "got none"),
        (lambda: GridMap.of_layers({"a": np.zeros((2, 2)), "b": np.zeros((1, 2))}, grid_map().frame), "one shape"),
    ],
)
def test_what_makes_no_map_is_refused(make, words):
    with pytest.raises(InvalidMapError, match=words):
        make()


def test_a_message_with_a_field_of_another_type_is_refused_in_a_line():
    others = None, "x", [], {}, [[1.0], [1.0, 2.0]], 2.5, -1, math.nan, math.inf, 1e300, 10**400, 1j, object()
    # what has no meaning here, where the map lies, a height, a name
    free = {"z", "stride", "data_offset", "basic_layers", "layers", "frame_id", 0, 1, 2, 3, 4, 5}
    for kind, make in ((GridMap, message), (OccupancyGrid, occupancy_message)):
        for path, value in itertools.product(leaves(make()), others):
            changed = make()
            functools.reduce(operator.getitem, path[:-1], changed)[path[-1]] = value
            try:
                kind.of_message(changed)
            except InvalidMapError as error:
                assert "\n" not in str(error)
            else:
                place = {"x", "y", "w", "resolution"} if value in (-1, 2.5, 1e300) else set()
                assert path[-1] in free | place, value


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda m: m["data"][0]["layout"].update(dim=[]), r"laid out by column_index 3 and row_index 2, got \[\]"),
        (lambda m: m["data"][0]["layout"]["dim"][0].update(label=""), "laid out by"),
        (lambda m: m["data"][0]["layout"]["dim"][0].update(size=2), "laid out by"),
        (lambda m: swap(m), "laid out by"),
        (lambda m: m.update(data=message(row_by_row=True)["data"]) or swap(m), "laid out by"),
        (lambda m: m.update(layers=["elevation", "cost"]), "a name for each of 1 layers, got .*cost"),
        (lambda m: m.update(layers=[]), r"a name for each of 1 layers, got \[\]"),
        (lambda m: m.update(layers=["a", "a"], data=2 * m["data"]), "a name for each of 2 layers"),
        (lambda m: m.update(outer_start_index=0.5), "outer_start_index must be a whole number, got 0.5"),
        (lambda m: m["info"]["pose"]["orientation"].update(x=math.nan), "not turned"),
        (lambda m: m["info"]["pose"]["orientation"].update(w=math.nan), "not turned"),
        (lambda m: m["info"].update(length_x=1e308, resolution=1e-9), "above 0 m"),
    ],
)
def test_a_grid_map_that_would_be_read_scrambled_is_refused(change, words):
    changed = message()
    change(changed)
    with pytest.raises(InvalidMapError, match=words):
        GridMap.of_message(changed)


@pytest.mark.parametrize("points", [(math.nan, 0.0), ("x", 0.0), [[1.0], [1.0, 2.0]], (1.0, 2.0, 3.0), None])
def test_points_must_be_finite(points):
    with pytest.raises((InvalidQueryError, InvalidMapError)):
        MapFrame(1.0).places(points)
