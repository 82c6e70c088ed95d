"""Pictures: that what is drawn stands where it belongs, and is named in the legend."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_hex

from nnpp_edge.runtime import Method, Plan, Planner, Source, Vehicle
from nnpp_edge.runtime.errors import Status
from nnpp_edge.runtime.kernels.poses import REFUSALS
from nnpp_edge.viz.palette import (
    DRIVEN,
    GOAL,
    IMPASSABLE,
    OPTIMUM,
    PAPER,
    PATH,
    REFUSED,
    REGION,
    START,
    UNKNOWN,
    rgb,
)
from nnpp_edge.viz.picture import MapDrawing, Reached, body_outlines, plan_picture, reach_picture
from nnpp_edge.viz.relief import Chart, hillshade
from tests.strategies import uniform

SHUT = [*rgb(IMPASSABLE)]
GROUND = [214] * 3


def some_cost(rows, cols):
    return uniform(3, (rows, cols), 0.0, 0.9)


class Seen:
    """A figure: its words, its lines by them, and the colour at a cell."""

    def __init__(self, figure):
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
        self.pixels = np.asarray(canvas.buffer_rgba())[..., :3].astype(int)
        self.axes = figure.axes[0]
        self.words = [text.get_text() for text in figure.legends[0].get_texts()]
        self.lines = {line.get_label(): line for line in self.axes.lines}

    def at(self, row, col):
        x, y = self.axes.transData.transform((col, row))
        return self.pixels[-1 - round(y), round(x)]

    def cells(self, words):
        """(N, 2) row and column of a line."""
        return self.lines[words].get_xydata()[:, ::-1]


def test_the_costlier_the_darker_and_impassable_cells_are_the_darkest():
    cost = np.array([[0.0, 0.5, 0.99], [1.0, np.inf, np.nan]], np.float32)
    seen = Seen(MapDrawing(Chart(cost, np.zeros_like(cost))).finish())
    lightness = [seen.at(0, col).mean() for col in range(3)]
    assert (np.diff(lightness) < -20).all() and lightness[-1] > 40 + np.mean(SHUT)
    assert [seen.at(1, col).tolist() for col in range(3)] == [SHUT] * 3


def test_the_light_comes_from_the_north_west():
    south, east = np.mgrid[0:20, 0:20].astype(np.float32)
    faces_north_west = hillshade(south + east, 1.0)
    faces_south_east = hillshade(-south - east, 1.0)
    flat = hillshade(np.zeros((20, 20), np.float32), 1.0)
    south, east = np.mgrid[0:20, 0:30].astype(np.float32)
    for ridge, lit, shaded in ((east - 10, (9, 5), (9, 15)), (south - 7, (4, 9), (11, 9))):
        seen = Seen(MapDrawing(Chart(0.0 * ridge, -abs(ridge))).finish())
        assert seen.at(*lit).mean() > GROUND[0] > seen.at(*shaded).mean() + 30
    assert faces_north_west.mean() > flat.mean() + 30 > faces_south_east.mean() + 60


@pytest.mark.parametrize(("side", "step"), [(40, 1), (2000, 1), (4000, 2)])
def test_cells_keep_their_places_at_any_size_of_the_map(side, step):
    cost = np.zeros((side, side // 2), np.float32)
    cost[: side // 4, side // 4 :] = np.inf
    figure = MapDrawing(Chart(cost)).finish()
    image = figure.axes[0].images[0]
    assert image.get_array().shape[0] == side // step
    assert image.get_interpolation() == ("nearest" if side < 900 else "auto")
    seen = Seen(figure)
    colours = [
        seen.at(row * side, col * side).tolist() for row in (0.2, 0.3) for col in (0.23, 0.27)
    ]
    assert colours == [GROUND, SHUT, GROUND, GROUND] and seen.words == ["impassable"]


def test_start_goal_paths_and_the_region_stand_on_the_map():
    cost = some_cost(200, 400)
    cost[100:110, :300] = np.inf
    start, goal = (40, 60), (150, 330)
    plan = Planner(cost).plan(start, goal, method="corridor", keep_regions=True)
    plan = replace(plan, network_region=plan.region)
    detour = np.array([(40 + n, 60) for n in range(50)], np.int32)
    chart = Chart(cost, None, (2.0, 2.0), 30.0)
    seen = Seen(plan_picture(chart, plan, start, goal, via=[(20, 30)], reference_path=detour))
    assert [to_hex(seen.at(*cell) / 255.0) for cell in (start, goal)] == [START, GOAL]
    assert seen.at(105, 20).tolist() == SHUT
    np.testing.assert_array_equal(seen.cells("path"), plan.path)
    np.testing.assert_array_equal(seen.cells("exact optimum"), detour)
    np.testing.assert_array_equal(seen.cells("by way of"), [(20, 30)])
    assert seen.lines["path"].get_color() == PATH
    assert seen.lines["path"].get_linewidth() > 3 * seen.lines["exact optimum"].get_linewidth()

    # the region is bluer than the ground below it
    plain = Seen(MapDrawing(chart).finish())
    row, col = plan.path[60] - (6, 0)
    inside = plan.region.mask()
    assert inside[row, col]
    outline = seen.axes.collections[0].get_paths()[0].get_extents().extents
    bottom, right = np.argwhere(inside).max(0)
    np.testing.assert_allclose(outline[2:], (right, bottom), atol=0.6)
    bluer = seen.at(row, col) - plain.at(row, col)
    assert bluer[2] - bluer[0] > 20
    named = [
        "impassable",
        "network's region, outlined",
        "region searched",
        "path",
        "exact optimum",
        "by way of",
        "goal",
    ]
    assert seen.words == [*named, "start", "grid north"]
    (bar,) = [each for each in seen.axes.artists if hasattr(each, "txt_label")]
    assert bar.txt_label.get_text() == "200 m"
    assert bar.size_bar.get_children()[0].get_width() == 100.0, "cells"
    tip = seen.lines["grid north"].get_marker()[1]
    np.testing.assert_allclose(tip, (0.5, 0.75**0.5), err_msg="30 degrees clockwise")
    (number,) = [text for text in seen.axes.texts if text.get_text() == "1"]
    assert number.get_position() == (30, 20)
    facts = seen.axes.get_title(loc="left")
    assert f"cost {plan.cost:.5g}" in facts and "corridor" in facts and "cells" in facts


def test_a_short_path_is_shown_with_the_ground_around_it():
    chart = Chart(np.zeros((1000, 800), np.float32))
    path = np.array([(100, 150), (200, 230)])
    row, col, rows, cols = chart.around([path])
    assert 0 < row < 100 < row + rows - 100 < 250 and 50 < col < 150 < col + cols - 80 < 300
    axes = MapDrawing(chart, [path]).axes
    limits = (*axes.get_xlim(), *axes.get_ylim())
    assert limits == (col - 0.5, col + cols - 0.5, row + rows - 0.5, row - 0.5)
    assert chart.around([np.array([(0, 0), (999, 700)])]) == chart.whole


def test_without_a_path_the_ends_and_what_the_search_reached_are_shown():
    heights = np.zeros((200, 200), np.float32)
    heights[:40, :80] = np.nan
    cost = np.where(np.isnan(heights), np.inf, 0.1).astype(np.float32)
    cost[:, 100:104] = np.inf
    reached = np.zeros((200, 200), np.bool_)
    reached[:, :100] = True
    chart = Chart(cost, heights, (1.0, 1.0))
    plan = Plan(Status.NO_PATH, Method.ASTAR)
    ended = Reached(reached, "start", (150, 99))
    seen = Seen(plan_picture(chart, plan, (150, 10), (150, 190), reached=ended))
    assert to_hex(seen.at(150, 10) / 255.0) == START and to_hex(seen.at(150, 190) / 255.0) == GOAL
    np.testing.assert_array_equal(seen.cells("where the search ended"), [(150, 99)])
    assert seen.words[:3] == ["unknown", "impassable", "reached from the start"]
    assert "path" not in seen.words and "NO_PATH" in seen.axes.get_title(loc="left")
    greener = seen.at(100, 50) - seen.at(100, 150)
    assert greener[1] - greener[0] > 20
    stripes = {tuple(seen.at(row, col)) for row in np.arange(5, 35, 0.5) for col in (20, 70)}
    assert {rgb(PAPER), rgb(UNKNOWN)} <= stripes, "stripes on paper"


@pytest.mark.parametrize("shape", [(1, 1), (1, 300), (300, 1), (2, 3), (30, 3000)])
def test_maps_of_any_shape_are_drawn(shape):
    cost = some_cost(*shape)
    heights = np.where(cost < 0.6, cost, np.nan)
    ends = ((0, 0), (shape[0] - 1, shape[1] - 1))
    plan = Planner(cost).plan(*ends, method="astar")
    seen = Seen(plan_picture(Chart(cost, heights, (0.3, 0.3)), plan, *ends))
    np.testing.assert_array_equal(seen.cells("start"), [ends[0]])


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
    for rows, drawn in ((200, True), (2000, False)):
        drawing = MapDrawing(Chart(np.zeros((rows, rows), np.float32)))
        drawing.bodies(outlines)
        assert [line.get_label() for line in drawing.axes.lines] == ["vehicle"] * drawn


def test_a_picture_shows_where_the_vehicle_stands_in_no_heading():
    cost = np.zeros((40, 40), np.float32)
    path = np.array([(20, col) for col in range(5, 35)], np.int32)
    plan = Plan(Status.OK, Method.ASTAR, Source.MAP, path, cost=1.0, length=29.0)
    refused = np.zeros((40, 40), np.uint8)
    refused[2:8, 2:5] = 1 + REFUSALS.index("tilt")
    refused[2:8, 5:8] = 1 + REFUSALS.index("belly")
    refused[30:, 20:] = 1
    seen = Seen(plan_picture(Chart(cost), plan, (20, 5), (20, 34), refused=refused))
    assert seen.words[:3] == [REFUSED[0][1], "too steep", "ground touches the belly"]
    for cell, limit in (((4, 3), "tilt"), ((4, 6), "belly")):
        colour, _ = REFUSED[REFUSALS.index(limit)]
        np.testing.assert_allclose(seen.at(*cell), mixed(0.75, colour), atol=3)
    assert {tuple(seen.at(35, col)) for col in np.arange(25, 35, 0.1)} >= {rgb(PAPER)}


def test_bands_of_what_can_be_reached_are_told_apart():
    field = np.full((40, 40), np.inf, np.float32)
    field[10:20, 10:35] = 1.0 + np.arange(25) // 10
    levels = [(1.0, "within 1"), (2.0, "within 2"), (3.0, "within 3")]
    seen = Seen(reach_picture(Chart(np.zeros((40, 40), np.float32)), field, levels, (10, 10)))
    assert seen.words == ["within 1", "within 2", "within 3", "start"]
    bands = [seen.at(15, col).tolist() for col in (15, 17, 25, 32)]
    assert bands[0] == bands[1] and sum(bands[0]) + 50 < sum(bands[2]) < sum(bands[3])
    assert seen.at(25, 15).tolist() == GROUND


def mixed(strength, colour):
    """A colour laid over level ground."""
    return (1.0 - strength) * np.array(GROUND) + strength * np.array(rgb(colour))


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
    linear = (np.array(colour) / 255.0) ** 2.2
    x, y, z = np.cbrt(TO_XYZ @ (np.array(matrix) @ linear).clip(0.0, 1.0))
    return np.array([116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)])


@pytest.mark.parametrize("matrix", WITHOUT)
def test_lines_marks_and_areas_are_told_apart_with_any_colour_vision(matrix):
    areas = [mixed(0.75, colour) for colour, _ in REFUSED]
    lines = [rgb(colour) for colour in (PATH, OPTIMUM, DRIVEN, START, GOAL)]
    shown = [*areas[1:], mixed(0.3, REGION), SHUT, GROUND]  # the first is striped
    for colours, least in ((lines, 15.0), ([*areas, SHUT, GROUND], 15.0), (shown, 12.0)):
        looks = [seen(colour, matrix) for colour in colours]
        apart = [
            np.linalg.norm(one - other) for at, one in enumerate(looks) for other in looks[at + 1 :]
        ]
        assert min(apart) > least
