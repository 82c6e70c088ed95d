"""The page of `nnpp-edge view` in a headless Chromium: one browser and one server for all tests.

Skipped where playwright or a Chromium is missing.
"""

import json
import os
import re
import shutil
import time
from urllib.parse import urlparse

import numpy as np
import pytest

from tests.view_cases import serving, write_ground

playwright = pytest.importorskip(
    "playwright.sync_api", reason="playwright is not installed: pip install playwright"
)
NAMES = ("chromium", "chromium-browser", "google-chrome")
CHROMIUM = os.environ.get("NNPP_EDGE_CHROMIUM") or next(
    filter(None, map(shutil.which, NAMES)), None
)
pytestmark = pytest.mark.skipif(
    CHROMIUM is None,
    reason="no Chromium is installed: apt install chromium, or name one in NNPP_EDGE_CHROMIUM",
)
LINE = "document.querySelector('#path').getAttribute('d')"
COMPARED = (
    "!document.querySelector('#methods.stale') && "
    "document.querySelector('#row-nnpp').cells[3].textContent"
)


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    path = write_ground(tmp_path_factory.mktemp("ground"), 192, 240)
    with serving(path) as running:
        yield running
        assert running.end() == (0, "")


@pytest.fixture(scope="module")
def browser():
    with playwright.sync_playwright() as started:
        running = started.chromium.launch(
            executable_path=CHROMIUM, args=["--no-sandbox", "--disable-gpu"]
        )
        yield running
        running.close()


class Tab:
    """A page that has drawn its first path, and what must not happen on it."""

    def __init__(self, page, address):
        self.page = page
        self.wrong = []
        self.hosts = set()
        page.on(
            "console",
            lambda message: self.wrong.append(message.text) if message.type != "log" else None,
        )
        page.on("pageerror", lambda error: self.wrong.append(str(error)))
        page.on("request", lambda request: self.hosts.add(urlparse(request.url).netloc))
        page.goto(address)
        self.until(f"{LINE} && {COMPARED}")

    def until(self, condition):
        """Wait for an expression; the page's policy allows no evaluation inside of it."""
        end = time.monotonic() + 20.0
        while not (found := self.page.evaluate(condition)):
            assert time.monotonic() < end, f"waited in vain for {condition}"
            time.sleep(0.02)
        return found

    @property
    def line(self):
        return self.page.get_attribute("#path", "d")

    def line_other_than(self, before):
        return self.until(f"{LINE} !== {json.dumps(before)} && {LINE}")

    def cell(self, end):
        return tuple(map(int, re.findall(r"\d+", self.page.get_attribute(f"#{end}", "aria-label"))))

    def place(self, selector, row=0.5, col=0.5):
        """The pixel (x, y) at shares of the sides of what is there."""
        box = self.page.locator(selector).bounding_box()
        return box["x"] + col * box["width"], box["y"] + row * box["height"]

    def stroke(self, begin, end):
        """Move the mouse while it is held down."""
        self.page.mouse.move(*begin)
        self.page.mouse.down()
        self.page.mouse.move(*end, steps=8)
        self.page.mouse.up()

    def drag(self, end, by):
        x, y = self.place(f"#{end}")
        self.stroke((x, y), (x + by[1], y + by[0]))

    def click(self, row, col, *keys):
        """The map, at shares of its sides, with these keys held."""
        box = self.page.locator("#sheet").bounding_box()
        at = {"x": col * box["width"], "y": row * box["height"]}
        self.page.locator("#sheet").click(position=at, modifiers=list(keys))

    def command_has(self, words):
        """Wait until the command to copy has these words."""
        self.until(f"document.querySelector('#command').textContent.includes('{words}')")

    def slide(self, name, value):
        """Set a slider as a user's drag does."""
        script = (
            "([name, value]) => { const each = document.getElementById(name); each.value = value; "
        )
        self.page.evaluate(
            script + "each.dispatchEvent(new Event('input', {bubbles: true})); }", [name, value]
        )


@pytest.fixture
def tab(server, browser):
    context = browser.new_context(viewport={"width": 1200, "height": 800})
    context.grant_permissions(
        ["clipboard-read", "clipboard-write"], origin=server.address.rstrip("/")
    )
    opened = Tab(context.new_page(), server.address)
    yield opened
    context.close()
    assert opened.wrong == []
    assert opened.hosts == {f"127.0.0.1:{server.port}"}


def ends_of(line):
    """First and last (row, col) of a drawn line."""
    places = [tuple(map(float, place.split()))[::-1] for place in re.split("[ML]", line)[1:]]
    return places[0], places[-1]


def test_a_drag_moves_the_path_and_says_how_fast(tab):
    before = tab.line
    goal = tab.cell("goal")
    assert ends_of(before) == (tab.cell("start"), goal)
    tab.drag("goal", (-90, -160))
    tab.until(
        "/the screen follows in \\d+ ms/.test(document.querySelector('#latency').textContent)"
    )
    tab.until("document.querySelector('#busy').hidden")
    row, col = tab.cell("goal")
    assert row < goal[0] - 10 and col < goal[1] - 20
    tab.until(f"{LINE}.endsWith('L{col} {row}')")
    assert ends_of(tab.line) == (tab.cell("start"), (row, col))


def test_sliders_and_choices_change_path_and_figures(tab):
    assert tab.page.locator("#cost").is_visible()
    pixels = "document.querySelector('#cost').toDataURL()"
    colours = tab.page.evaluate(pixels)
    line = tab.line
    tab.slide("omega", "0")
    line = tab.line_other_than(line)  # straight over the hill
    tab.slide("hard_slope_deg", "8")
    line = tab.line_other_than(line)
    tab.until(f"{pixels} !== {json.dumps(colours)}")
    assert tab.page.is_checked("#hard_slope_deg-on")
    tab.page.check("#refine")
    tab.line_other_than(line)
    assert tab.page.locator("#waypoints i").count() > 0 and "line integral" in tab.page.inner_text(
        "#figures"
    )
    assert tab.page.locator("#step_cost option[value=energy]").is_disabled()
    tab.page.select_option("#body", "large-rover")
    assert tab.page.locator("#clearance_m").is_visible() and tab.page.is_disabled("#refine")
    tab.command_has("--vehicle large-rover")
    tab.page.select_option("#step_cost", "energy")
    tab.until("/ [kM]J.* at /.test(document.querySelector('#figures').textContent)")
    assert tab.page.is_disabled("#refine")
    tab.page.check("[name=layer][value=slope]")
    tab.until("document.querySelector('#slope').width === 240")
    assert not tab.page.locator("#cost").is_visible()


def test_what_is_refused_leaves_path_and_controls_as_they_were(tab):
    before = tab.line
    tab.page.evaluate("document.querySelector('#slope_limit_deg').max = 95")
    tab.slide("slope_limit_deg", "95")
    tab.until(
        "document.querySelector('#notice').textContent.includes('slope limit must lie in (0, 90)')"
    )
    assert tab.line == before
    assert tab.page.input_value("#slope_limit_deg") == "30"
    tab.slide("slope_limit_deg", "20")
    tab.until("document.querySelector('#notice').hidden")


def test_clicks_set_goal_start_and_via_points(tab):
    tab.click(0.201, 0.801)
    tab.until("document.querySelector('#goal').ariaLabel === 'Goal, row 38, column 192'")
    tab.click(0.9, 0.1, "Shift")
    tab.until(f"{LINE}.startsWith('M24 172')")
    tab.until(f"{LINE}.endsWith('L192 38')")
    tab.click(0.501, 0.751, "Control")
    tab.until(f"{LINE}.includes('L180 96L')")
    tab.click(0.501, 0.201, "Alt")  # the path passes near it before
    tab.command_has("--via 96,48 --via 96,180 ")
    tab.until(f"/L48 96L.*L180 96L/.test({LINE})")
    tab.page.click("#add-via")
    tab.until("document.querySelectorAll('.via').length === 3")
    tab.page.focus(".via:nth-of-type(2)")
    tab.page.keyboard.press("Delete")
    tab.until("document.querySelectorAll('.via').length === 2")
    tab.page.dblclick(".via")
    tab.until("document.querySelectorAll('.via').length === 1")
    tab.page.focus(".via")
    tab.page.keyboard.press("ArrowUp")
    tab.command_has("--via 95,180 --goal")
    before = tab.line
    tab.click(0.241, 0.271, "Control")  # nobody knows the ground there
    tab.until(
        "/via \\d, \\(46, 65\\), is impassable/.test(document.querySelector('#notice').textContent)"
    )
    assert tab.line == before and tab.page.locator(".via").count() == 1
    goal = tab.cell("goal")
    tab.page.click("#zoom-in")
    tab.stroke((300, 300), (340, 330))  # the map was moved, no goal set
    assert tab.cell("goal") == goal


def test_the_place_below_the_pointer_is_told(tab):
    tab.page.mouse.move(*tab.place("#sheet", 0.75))
    tab.until(
        "document.querySelector('#place').textContent.startsWith('row 144, column 120 · x 240, y "
        "288 · height')"
    )
    assert tab.page.is_visible("#place")
    tab.page.mouse.move(*tab.place("#sheet", -0.1, -0.1))
    tab.until("document.querySelector('#place').hidden")


def test_what_can_be_reached_is_shaded_and_why_there_is_no_path_is_told(tab):
    tab.page.check("[name=layer][value=reach]")
    tab.until("!document.querySelector('#reach').hidden")
    assert tab.page.locator("#bands span").count() >= 3 and "can be reached" in tab.page.inner_text(
        "#bands"
    )
    shaded = "document.querySelector('#reach').toDataURL()"
    whole = tab.page.evaluate(shaded)
    tab.page.fill("#within", "40")
    tab.page.dispatch_event("#within", "change")
    tab.until(f"!document.querySelector('#reach').hidden && {shaded} !== {json.dumps(whole)}")
    tab.page.fill("#within", "")
    tab.page.dispatch_event("#within", "change")
    tab.until(f"!document.querySelector('#reach').hidden && {shaded} === {json.dumps(whole)}")
    before = tab.page.evaluate(shaded)
    tab.click(0.1, 0.9)
    tab.until("document.querySelector('#goal').ariaLabel === 'Goal, row 19, column 216'")
    assert tab.page.is_visible("#reach"), "it does not depend on the goal"
    tab.click(0.9, 0.1, "Shift")
    tab.until(f"!document.querySelector('#reach').hidden && {shaded} !== {json.dumps(before)}")
    tab.page.select_option("#body", "small-rover")
    tab.page.evaluate("document.querySelector('#max_tilt_deg').min = 1")
    tab.slide("max_tilt_deg", "3")
    tab.until("document.querySelector('#status.bad')")
    why = tab.page.inner_text("#why")
    assert "max_tilt_deg is 3" in why


def test_the_path_is_downloaded(tab):
    with tab.page.expect_download() as download:
        tab.page.click("[data-format=geojson]")
    assert download.value.suggested_filename == "ground-path.geojson"
    saved = json.loads(download.value.path().read_text())["geometry"]["coordinates"]
    ends = ends_of(tab.line)
    assert [saved[0], saved[-1]] == [[2.0 * col, 2.0 * row] for row, col in ends]
    assert tab.page.is_visible("[data-format=gpkg]")


def test_arrows_set_headings_and_a_dashed_line_is_driven_backwards(browser, tmp_path):
    car = ("--vehicle", "large-rover", "--set", "turning_radius_m=8", "--set", "reverse_cost=2")
    with serving(write_ground(tmp_path), *car) as running:
        tab = Tab(browser.new_page(), running.address)
        before = tab.line
        headings = "[...document.querySelectorAll('.heading')].map(each => each.ariaLabel)"
        tab.drag("start-heading", (36, -36))
        turned = tab.line_other_than(before)
        assert tab.page.evaluate(headings) == ["Start heading, 270°", "Goal heading, any"]
        assert tab.page.get_attribute("#reverse", "d").startswith("M")
        tab.page.focus("#goal-heading")
        tab.page.keyboard.press("ArrowLeft")
        tab.line_other_than(turned)
        tab.command_has("--start-heading 270 --goal-heading 355")
        tab.page.keyboard.press("Delete")
        tab.page.dblclick("#start-heading")
        tab.until(f"{LINE} === {json.dumps(before)}")
        tab.page.mouse.move(*tab.place("#chart"))
        tab.until("document.querySelector('#outline').getAttribute('d')")
        assert "· tilt " in tab.page.inner_text("#reading-at")
        assert tab.page.inner_text("#scale").endswith(" m")
        assert tab.page.locator("#axis-distance span").count() == 5
        tab.page.set_viewport_size({"width": 390, "height": 844})
        tab.page.focus("#start")
        for _ in range(8):
            tab.page.keyboard.press("Shift+ArrowUp")
        tab.until("document.querySelector('#start').ariaLabel.startsWith('Start, row 0')")
        left, top = tab.place("#map", 0.0, 0.0)
        for arrow in ("#start-heading", "#goal-heading"):
            x, y = tab.place(arrow, 0.0, 0.0)
            assert x >= left and y >= top, "whole on a phone"
        tab.page.select_option("#body", "none")
        assert not tab.page.is_visible("#start-heading") and not tab.page.is_visible("#turns")
        assert tab.wrong == [] and running.end() == (0, "")


def test_methods_stand_side_by_side_and_shade_their_regions(tab):
    rows = {
        name: tab.page.locator(f"#row-{name} td").all_inner_texts()
        for name in ("auto", "astar", "corridor")
    }
    assert rows["astar"][2] == "0.00 %"
    assert all(float(row[1]) > 0.0 and float(row[3]) > 0.0 for row in rows.values())
    tab.page.check("#row-corridor input")
    tab.until("!document.querySelector('#region').hidden")
    blank = "Object.assign(document.createElement('canvas'), {width: 240, height: 192}).toDataURL()"
    tab.until(f"document.querySelector('#region').toDataURL() !== {blank}")
    tab.page.check("#row-astar input")
    assert tab.page.evaluate("document.querySelector('#region').hidden")


def test_an_obstacle_is_painted_and_undone(tab):
    before = tab.line
    tab.page.click("#across")
    around = tab.line_other_than(before)
    assert tab.page.get_attribute("#before", "d") == before
    tab.page.click("#paint")
    tab.stroke(tab.place("#sheet", 0.05, 0.45), tab.place("#sheet", 0.3, 0.6))
    tab.until("document.querySelectorAll('#obstacles rect').length === 2")
    tab.page.keyboard.press("Escape")
    assert tab.page.get_attribute("#paint", "aria-pressed") == "false"
    tab.page.click("#undo")
    tab.until("document.querySelectorAll('#obstacles rect').length === 1")
    assert tab.line == around
    tab.page.click("#clear")
    assert tab.line_other_than(around) == before


def test_what_is_copied_is_what_is_seen(tab, nnpp_edge):
    tab.slide("slope_limit_deg", "12")
    tab.command_has("--limit slope_limit_deg=12")
    tab.page.click("#copy-command")
    tab.until("document.querySelector('#copied').textContent.startsWith('Copied')")
    words = tab.page.evaluate("navigator.clipboard.readText()").split()
    seen = float(tab.page.locator("#figures dt:text-is('cost') + dd").inner_text().split(",")[0])
    assert nnpp_edge(*words[1:], "--json").json["cost"] == pytest.approx(seen, rel=1e-4)
    tab.page.click("#across")
    tab.page.click("#copy-command")
    tab.until("document.querySelector('#copied').textContent.includes('no painted obstacles')")


def test_everything_is_reached_by_keys(tab):
    names = "document.activeElement.id || document.activeElement.name"
    reached = set()
    for _ in range(60):
        tab.page.keyboard.press("Tab")
        reached.add(tab.page.evaluate(names))
    wanted = (
        "start goal zoom-in chart layer opacity method step_cost body refine slope_limit_deg omega"
    )
    assert {
        *wanted.split(),
        "hard_slope_deg",
        "shade",
        "paint",
        "across",
        "copy-command",
    } <= reached
    unnamed = (
        "[...document.querySelectorAll('button, input, select, [role=slider]')].filter(each => !("
    )
    unnamed += (
        "each.labels?.length || each.ariaLabel || each.textContent.trim())).map(each => each.id)"
    )
    assert tab.page.evaluate(unnamed) == []
    row, col = tab.cell("start")
    tab.page.focus("#start")
    tab.page.keyboard.press("ArrowDown")
    tab.page.keyboard.press("Shift+ArrowRight")
    tab.until("document.querySelector('#busy').hidden")
    assert tab.cell("start") == (row + 1, col + 6)
    tab.until(f"{LINE}.startsWith('M{col + 6} {row + 1}L')")
    tab.page.focus("#chart")
    tab.page.keyboard.press("End")
    assert tab.page.get_attribute("#chart", "aria-valuenow") == tab.page.get_attribute(
        "#chart", "aria-valuemax"
    )
    at = tab.page.evaluate("[cursor, goal].map(each => [each.style.left, each.style.top].join())")
    assert at[0] == at[1]


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_it_fits_a_phone(server, browser, scheme):
    context = browser.new_context(
        viewport={"width": 390, "height": 844}, color_scheme=scheme, has_touch=True
    )
    opened = Tab(context.new_page(), server.address)
    assert opened.page.evaluate("document.documentElement.scrollWidth") == 390
    shade = opened.page.evaluate("getComputedStyle(document.body).backgroundColor")
    assert (np.mean(list(map(int, re.findall(r"\d+", shade)))) < 128) == (scheme == "dark")
    opened.page.touchscreen.tap(200, 300)
    opened.until("/^row /.test(document.querySelector('#place').textContent)")
    opened.until(
        f"{LINE}.endsWith('L' + "
        "document.querySelector('#goal').ariaLabel.match(/\\d+/g).reverse().join(' '))"
    )
    start = opened.page.locator("#start").bounding_box()
    assert min(start["width"], start["height"]) >= 44  # a finger's
    context.close()
    assert opened.wrong == []
