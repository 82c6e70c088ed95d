"""Pictures: sizes, greys, and that what is drawn stands where it belongs."""

from dataclasses import replace

import numpy as np
import pytest

from nnpp_edge.runtime import Method, Plan, Planner, Source, Vehicle
from nnpp_edge.runtime.cells import slices
from nnpp_edge.runtime.errors import Status
from nnpp_edge.runtime.kernels.poses import REFUSALS
from nnpp_edge.viz.palette import DRIVEN, GOAL, OPTIMUM, PATH, REFUSED, REGION, START
from nnpp_edge.viz.picture import (
    SHUT_GROUND,
    Chart,
    Reached,
    Tint,
    body_outlines,
    cost_picture,
    hillshade,
    plan_picture,
    tinted,
)
from tests.strategies import uniform


def some_cost(rows, cols):
    return (np.random.default_rng(3).random((rows, cols)) * 0.9).astype(np.float32)


def count(picture, colour):
    return int((picture == colour).all(axis=2).sum())


def test_the_costlier_the_darker_and_impassable_cells_are_the_darkest():
    cost = np.array([[0.0, 0.5, 0.99], [1.0, np.inf, np.nan]], np.float32)
    picture = cost_picture(cost)
    lightness = picture[0].mean(axis=1)
    assert (np.diff(lightness) < -20).all() and lightness[-1] > 40 + np.mean(SHUT_GROUND)
    np.testing.assert_array_equal(picture[1], [SHUT_GROUND] * 3)
    relief = cost_picture(cost, np.array([[240, 185, 60]] * 2, np.uint8))
    assert (np.diff(relief[0].mean(axis=1)) < -20).all(), "lit more, and cheaper"


def test_the_light_comes_from_the_north_west():
    south, east = np.mgrid[0:20, 0:20].astype(np.float32)
    faces_north_west = hillshade(south + east, 1.0)
    faces_south_east = hillshade(-south - east, 1.0)
    flat = hillshade(np.zeros((20, 20), np.float32), 1.0)
    assert faces_north_west.mean() > flat.mean() + 30 > faces_south_east.mean() + 60


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (9, 1), (6, 7)])
def test_unknown_ground_and_any_shape_can_be_shaded(shape, recwarn):
    heights = uniform(1, shape)
    for known in (heights, np.where(heights > 0.5, heights, np.nan), heights * np.nan):
        shade = hillshade(known, 2.0, 3.0)
        assert (shade.shape, shade.dtype) == (shape, np.uint8)
    assert not recwarn


@pytest.mark.parametrize(
    ("shape", "drawn"),
    [
        ((256, 256), (1024, 1024)),
        ((400, 300), (800, 600)),
        ((900, 1000), (900, 1000)),
        ((1500, 3000), (600, 1200)),
    ],
)
def test_small_maps_are_enlarged_by_whole_factors_and_large_ones_reduced(shape, drawn):
    picture = Chart(some_cost(*shape)).picture()
    height, width, _ = picture.shape
    unit = max(1.0, max(drawn) / 1000)
    assert max(drawn[1], 800) < width < max(drawn[1], 800) + 50 * unit
    assert drawn[0] < height < drawn[0] + 140 * unit


def test_start_goal_both_paths_and_the_region_stand_on_the_map():
    cost = some_cost(400, 400)
    cost[200:210, :300] = np.inf
    ends = ((40, 60), (350, 330))
    plan = Planner(cost).plan(*ends, method="corridor", keep_regions=True)
    detour = np.array([(40 + n, 60) for n in range(100)], np.int32)

    def drawn(plan, **more):
        return plan_picture(Chart(cost, None, (2.0, 2.0)), plan, *ends, **more)[18:818, 18:818]

    picture = drawn(plan, reference_path=detour)
    on_map = picture[::2, ::2]
    marks = {(40, 60): START, (350, 330): GOAL, (205, 20): SHUT_GROUND}
    assert [tuple(on_map[cell].tolist()) for cell in marks] == list(marks.values())
    assert count(on_map, PATH) > 200
    assert (picture != drawn(plan))[160:230, 120:122].any((1, 2)).all(), "the detour"
    row, col = plan.path[100] - (5, 0)
    tinted_ground, plain = (
        each[2 * row, 2 * col].astype(int) for each in (picture, drawn(replace(plan, region=None)))
    )
    bluer = (tinted_ground - plain)[0] - (tinted_ground - plain)[2]
    assert bluer > 20, "the region's tint, beside the path"


def test_a_path_on_the_optimum_hides_no_more_than_its_middle():
    chart = Chart(some_cost(400, 400))
    ends = ((40, 60), (350, 330))
    plan = Planner(chart.cost).plan(*ends, method="astar")
    alone = plan_picture(chart, plan, *ends)[:818]
    picture = plan_picture(chart, plan, *ends, reference_path=plan.path)[:818]
    assert 500 < count(picture, PATH) < count(alone, PATH) - 500


def test_a_short_path_is_shown_with_the_ground_around_it():
    heights = uniform(1, (1000, 1000))
    chart = Chart(np.zeros((1000, 1000), np.float32), heights, (1.0, 1.0), 0.0)
    plan = Planner(chart.cost).plan((100, 100), (200, 180), method="astar")
    row, col, rows, cols = part = chart.around(plan.path)
    assert 0 < row < 100 and 0 < col < 100 and max(rows, cols) < 200
    picture = chart.picture((100, 100), (200, 180), part=part)
    alone = replace(chart, cost=chart.cost[slices(part)], elevation=heights[slices(part)])
    plain = alone.picture((100 - row, 100 - col), (200 - row, 180 - col))
    np.testing.assert_array_equal(picture, plain)
    assert chart.around(np.array([(0, 0), (999, 900)])) == chart.whole
    picture = plan_picture(chart, plan, (100, 100), (200, 180))
    assert count(picture, PATH) > 1000


def test_unknown_ground_is_striped_and_what_a_search_reached_is_tinted():
    heights = np.zeros((200, 200), np.float32)
    heights[:40, :40] = np.nan
    cost = np.where(np.isnan(heights), np.inf, 0.1).astype(np.float32)
    cost[:, 100:104] = np.inf
    reached = np.zeros((200, 200), np.bool_)
    reached[:, :100] = cost[:, :100] < 1.0
    chart = Chart(cost, heights, (1.0, 1.0))
    plan = Plan(Status.NO_PATH, Method.ASTAR)
    ends = ((150, 10), (150, 190))
    plain, ended = (
        plan_picture(chart, plan, *ends, reached=each)[18:818, 18:818]
        for each in (None, Reached(reached, "start", (150, 99)))
    )
    corner = plain[:160, :160]
    assert len(np.unique(corner.reshape(-1, 3), axis=0)) == 2, "stripes on paper"
    assert plain[400, 408].tolist() == list(SHUT_GROUND)
    np.testing.assert_array_equal(
        (plain != ended).any(-1)[400:560:16, ::16], reached[100:140:4, ::4]
    )
    assert (plain[602, 398] != ended[602, 398]).any(), "the cross where it ended"


def test_a_plan_without_a_path_shows_its_ends():
    plan = Plan(Status.NO_PATH, Method.ASTAR)
    picture = plan_picture(Chart(some_cost(400, 400)), plan, (20, 30), (380, 330))
    assert picture[18 + 41, 18 + 61].tolist() == list(START)
    assert picture[18 + 761, 18 + 661].tolist() == list(GOAL)
    assert count(picture, PATH) == 0


@pytest.mark.parametrize("shape", [(1, 1), (1, 300), (300, 1), (2, 3), (30, 3000)])
def test_maps_of_any_shape_are_drawn(shape):
    cost = some_cost(*shape)
    ends = ((0, 0), (shape[0] - 1, shape[1] - 1))
    plan = Planner(cost).plan(*ends, method="astar")
    picture = plan_picture(Chart(cost, cost, (0.3, 0.3)), plan, *ends)
    assert picture.dtype == np.uint8 and picture.shape[1] >= 800
    assert count(picture, START) > 10


@pytest.mark.parametrize("vehicle", [Vehicle(2.0, 1.0, 0.3), Vehicle(radius_m=0.7)])
@pytest.mark.parametrize("step", [(0, 1), (1, 0), (-1, 1)])
def test_bodies_lie_along_the_path_and_point_ahead(vehicle, step):
    sides = np.array((0.5, 0.25))
    path = np.add(np.outer(np.arange(60), step), (70, 10))
    ahead = step * sides / np.hypot(*(step * sides))
    half_m = np.array((1.0, 0.5) if vehicle.radius_m is None else (0.7, 0.7))
    outlines = body_outlines(path, vehicle, sides)
    assert len(outlines) > 3
    for outline in outlines:
        around = (outline - outline[-1]) * sides
        np.testing.assert_allclose(around[0], ahead * half_m[0], atol=1e-9)
        frame = np.array([ahead, (-ahead[1], ahead[0])])
        np.testing.assert_allclose(np.abs(around @ frame.T).max(0), half_m)
    backwards = np.full(60, np.degrees(np.arctan2(ahead[1], -ahead[0])) + 180.0)
    outline = body_outlines(path, vehicle, sides, backwards)[0] * sides
    np.testing.assert_allclose(outline[0] - outline[-1], -ahead * half_m[0], atol=1e-9)
    assert body_outlines(path[:1], vehicle, sides) == []


def test_a_picture_shows_where_the_vehicle_stands_in_no_heading():
    cost = np.full((40, 40), 0.3, np.float32)
    path = np.array([(20, col) for col in range(5, 35)], np.int32)
    plan = Plan(Status.OK, Method.ASTAR, Source.MAP, path, cost=1.0, length=29.0)
    refused = np.zeros((40, 40), np.uint8)
    refused[2:8, 2:5] = 1 + REFUSALS.index("tilt")
    refused[2:8, 5:8] = 1 + REFUSALS.index("belly")
    pictures = []
    for given in (None, refused):
        picture = plan_picture(Chart(cost), plan, (20, 5), (20, 34), refused=given)
        pictures.append(picture[18:818, 18:818][10::20, 10::20])
    plain, shown = pictures
    np.testing.assert_array_equal((plain != shown).any(-1), refused > 0)
    assert (shown[4, 3] != shown[4, 6]).any(), "a colour for each limit"


# linear RGB as it is seen without one kind of cone (Machado, Oliveira and Fernandes 2009)
WITHOUT = (
    np.eye(3),
    [[0.152, 1.053, -0.205], [0.115, 0.786, 0.099], [-0.004, -0.048, 1.052]],
    [[0.367, 0.861, -0.228], [0.280, 0.673, 0.047], [-0.012, 0.043, 0.969]],
    [[1.256, -0.077, -0.179], [-0.078, 0.931, 0.148], [0.005, 0.691, 0.304]],
)
TO_XYZ = [[0.434, 0.376, 0.190], [0.213, 0.715, 0.072], [0.018, 0.109, 0.873]]  # white is 1, 1, 1


def seen(colour, matrix):
    """Lightness and two axes of colour, CIELAB."""
    linear = (np.array(colour[::-1]) / 255.0) ** 2.2
    x, y, z = np.cbrt(TO_XYZ @ (np.array(matrix) @ linear).clip(0.0, 1.0))
    return np.array([116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)])


@pytest.mark.parametrize("matrix", WITHOUT)
def test_lines_marks_and_areas_are_told_apart_with_any_colour_vision(matrix):
    areas = [tinted(Tint(None, 0.75, colour, "")) for colour, _ in REFUSED]
    ground = tuple(cost_picture(np.zeros((1, 1), np.float32))[0, 0].tolist())
    lines = [PATH, OPTIMUM, DRIVEN, START, GOAL]
    region = tinted(Tint(None, 0.3, REGION, ""))
    shown = [*areas[1:], region, SHUT_GROUND, ground]  # the first is striped
    for colours, least in ((lines, 15.0), ([*areas, SHUT_GROUND, ground], 15.0), (shown, 12.0)):
        looks = [seen(colour, matrix) for colour in colours]
        apart = [
            np.linalg.norm(one - other) for at, one in enumerate(looks) for other in looks[at + 1 :]
        ]
        assert min(apart) > least
