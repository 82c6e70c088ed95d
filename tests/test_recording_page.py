"""The script that plays recordings, in a headless Chromium, with a stand-in for the viewer.

Skipped where playwright or a Chromium is missing.
"""

import functools
import http.server
import importlib
import re
import threading
from pathlib import Path
from types import SimpleNamespace

import pytest

from tests.browsers import CHROMIUM, NEEDS_CHROMIUM, QUIET

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed: pip install playwright")
pytestmark = NEEDS_CHROMIUM
ROOT = Path(__file__).parent.parent
VIEWER = """
export default { render({ model, el }) {
  const canvas = document.createElement("canvas");
  canvas.tabIndex = 0;
  canvas.addEventListener("keydown", (event) => event.preventDefault());
  el.append(canvas);
  canvas.focus();
  globalThis.asked = Object.fromEntries(["_url", "_theme", "_panel_states"].map((n) => [n, model.get(n)]));
  globalThis.elsewhere = fetch("http://localhost:" + location.port + "/x/y/gallery/drive.rrd", { mode: "no-cors" })
    .then(() => "got", () => "refused");
  if (globalThis.broken) return Promise.reject(new Error("404 Not Found")), () => {};
  model.send("ready");
  return () => { globalThis.stopped = (globalThis.stopped ?? 0) + 1; };
} };
"""


class Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, *words):
        pass


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A site in a folder of a host: the page, the script, and a viewer that only says what it was asked."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(ROOT / "docs/_site")
        recordings = importlib.import_module("recordings")
    host = tmp_path_factory.mktemp("host")
    (host / "x/y/gallery").mkdir(parents=True)
    (host / "x/y/viewer").mkdir()
    (host / "x/y/viewer/widget.js").write_text(VIEWER)
    (host / "x/y/recording.js").write_text((ROOT / "docs/_site/recording.js").read_text())
    for name in ("drive.webp", "drive.rrd"):
        (host / "x/y/gallery" / name).write_bytes((ROOT / "docs/gallery" / name).read_bytes())
    text = recordings.with_player("![The picture that it makes](drive.webp)", "drive", 17.0)
    text = re.sub(r"!\[([^]]*)\]\(([^)]*)\)", r'<p><img alt="\1" src="\2"></p>', text)
    style = (
        ROOT / "docs/_site/style.css"
    ).read_text() + ".md-typeset .md-button { display: inline-block; }"  # a theme's
    html = f'<!doctype html><html><head><link rel="icon" href="data:,"><style>{style}</style></head>'
    html += f'<body class="md-typeset">{text}</body></html>'
    on_page = SimpleNamespace(file=SimpleNamespace(src_uri="gallery/drive.md"))
    (host / "x/y/gallery/drive.html").write_text(recordings.on_post_page(html, on_page, None))
    (host / "x/y/gallery/open.html").write_text(html)
    return host


@pytest.fixture(scope="module")
def address(folder):
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Quiet, directory=folder))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}/x/y/gallery/drive.html"
    server.shutdown()
    server.server_close()


@pytest.fixture(scope="module")
def browser():
    with playwright.sync_playwright() as started:
        running = started.chromium.launch(executable_path=CHROMIUM, args=list(QUIET))
        yield running
        running.close()


@pytest.fixture
def page(browser):
    """A page in a browser that says it has WebGL 2; what goes wrong on it fails the test."""
    opened, wrong = browser.new_page(viewport={"width": 390, "height": 800}), []
    opened.on("pageerror", lambda error: wrong.append(str(error)))
    with_webgl(opened, "{}")
    yield opened
    opened.close()
    assert wrong == []


def with_webgl(page, context):
    page.add_init_script(f"HTMLCanvasElement.prototype.getContext = () => ({context})")


def said(page):
    return page.inner_text("[role=status]")


def test_the_button_plays_the_recording_and_closes_it(page, address):
    page.goto(address)
    button, label = page.locator("button"), "Play the recording: loads the viewer, about 17 MB"
    assert button.inner_text() == label
    page.keyboard.press("Tab")
    page.keyboard.press("Enter")
    page.wait_for_selector("canvas")
    assert button.inner_text() == "Close the recording" and not page.is_visible("img")
    asked = page.evaluate("asked")
    assert asked["_url"] == address.replace("drive.html", "drive.rrd"), "absolute, beside the page"
    assert asked["_theme"] == "light"
    assert asked["_panel_states"] == {
        "top": "hidden",
        "blueprint": "hidden",
        "selection": "hidden",
        "time": "expanded",
    }
    assert "Escape leaves the viewer" in said(page)
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.tagName") == "CANVAS", "as the viewer has it"
    page.keyboard.press("Escape")
    assert page.evaluate("document.activeElement.tagName") == "BUTTON"
    page.keyboard.press("Enter")
    assert page.evaluate("stopped") == 1 and not page.locator("canvas").count() and page.is_visible("img")
    assert button.inner_text() == label and said(page) == ""
    page.click("img")
    page.wait_for_selector("canvas")
    assert button.inner_text() == "Close the recording"


def test_the_viewer_follows_the_theme_and_reaches_no_other_host(page, address):
    page.goto(address)
    page.set_viewport_size({"width": 1200, "height": 800})
    page.evaluate("document.body.dataset.mdColorScheme = 'slate'")
    page.click("button")
    page.wait_for_selector("canvas")
    assert page.evaluate("asked._theme") == "dark" and page.evaluate("asked._panel_states.time") == "collapsed"
    assert page.evaluate("elsewhere") == "refused"
    page.goto(address.replace("drive.html", "open.html"))
    page.click("button")
    page.wait_for_selector("canvas")
    assert page.evaluate("elsewhere") == "got", "it is the page's policy that refuses"


def test_closed_while_it_loads_it_stays_closed(page, address):
    page.goto(address)
    page.evaluate("const each = document.querySelector('button'); each.click(); each.click()")
    page.evaluate("import('../viewer/widget.js')")  # until it is there
    assert page.is_visible("img") and not page.locator("canvas").count() and said(page) == ""


FAILURES = {
    "not there": "document.querySelector('.recording').dataset.viewer = '../viewer/none.js'",
    "cannot start": "globalThis.broken = true; addEventListener('unhandledrejection', (e) => e.preventDefault())",
}


@pytest.mark.parametrize("failure", FAILURES)
def test_a_viewer_that_does_not_start_is_one_line(page, address, failure):
    page.goto(address)
    page.evaluate(FAILURES[failure])
    page.click("button")
    page.wait_for_function("document.querySelector('[role=status]').textContent.includes('could not be loaded: ')")
    assert page.is_visible("img") and not page.locator("canvas").count()
    assert page.inner_text("button").startswith("Play the recording")


def test_where_it_cannot_play_one_line_says_why(page, address, folder):
    page.goto((folder / "x/y/gallery/drive.html").as_uri())
    assert said(page) == "To play the recording here, serve the folder: python -m http.server -d build/site"
    assert not page.is_visible("button") and page.is_visible("img")
    with_webgl(page, "null")
    page.goto(address)
    assert "a browser with WebGL 2 is needed" in said(page)
    assert not page.is_visible("button")
