"""Recordings that play on the site's pages: the viewer's files, the pages, and the recordings themselves."""

import gzip
import importlib
import io
import re
import sys
import tomllib
from importlib.metadata import PackageNotFoundError
from pathlib import Path
from types import SimpleNamespace

import pytest

ROOT = Path(__file__).parent.parent
RECORDINGS = sorted((ROOT / "docs/gallery").glob("*.rrd"))
MOST_BYTES = 1_500_000
MODULE = "before //!<INLINE-MARKER-OPEN> what it does in a notebook //!<INLINE-MARKER-CLOSE> after"
ON_PAGE = SimpleNamespace(file=SimpleNamespace(src_uri="gallery/drive.md"))
ON_ANOTHER = SimpleNamespace(file=SimpleNamespace(src_uri="gallery/tour.md"))


@pytest.fixture
def site(monkeypatch):
    """The module that mkdocs is given, and pages without recordings."""
    monkeypatch.syspath_prepend(ROOT / "docs/_site")
    recordings = importlib.import_module("recordings")
    recordings.viewer.cache_clear()
    yield recordings
    recordings.viewer.cache_clear()


@pytest.fixture
def package(tmp_path, monkeypatch):
    """What is installed of the viewer's package: it must not be imported."""
    static, facts = tmp_path / "rerun_notebook/static", tmp_path / "rerun_notebook-0.41.0.dist-info"
    static.mkdir(parents=True)
    facts.mkdir()
    (facts / "METADATA").write_text("Metadata-Version: 2.4\nName: rerun-notebook\nVersion: 0.41.0\n")
    (static.parent / "__init__.py").write_text("raise AssertionError('imported')\n")
    (static / "widget.js").write_text(MODULE)
    (static / "re_viewer_bg.wasm").write_bytes(b"\0asm" * 1000)
    monkeypatch.syspath_prepend(tmp_path)
    return static


@pytest.fixture
def no_package(site, monkeypatch):
    def missing(name):
        raise PackageNotFoundError(name)

    monkeypatch.setattr(site, "distribution", missing)


def drive_page():
    return importlib.import_module("hooks").pages()["gallery/drive.md"]


def test_the_site_has_the_viewer_packed(site, package):
    files = site.viewer()
    assert set(files) == {"widget.js", "re_viewer_bg.wasm.packed"}
    assert gzip.decompress(files["re_viewer_bg.wasm.packed"]) == (package / "re_viewer_bg.wasm").read_bytes()
    module = files["widget.js"].decode()
    assert module.startswith("before ") and module.endswith(" after") and "notebook" not in module
    assert '"./re_viewer_bg.wasm.packed", import.meta.url' in module
    assert "rerun_notebook" not in sys.modules


def test_another_viewer_than_the_one_it_was_made_for_is_refused(site, package):
    (package / "widget.js").write_text("no marks")
    with pytest.raises(SystemExit, match=r"wanted //!<INLINE-MARKER-OPEN> and .* got a module without"):
        site.viewer()


def test_a_page_with_a_recording_has_the_button_and_asks_no_other_host(site, package):
    page = site.on_page_markdown(drive_page(), ON_PAGE, None, None)
    assert re.search(
        r'<button type="button".* hidden>Play the recording: loads the viewer, about \d+ MB</button>', page
    )
    assert 'data-viewer="../viewer/widget.js" data-recording="drive.rrd"' in page
    assert page.count("![The picture that it makes](drive.webp)") == 1
    assert '<script src="../recording.js" defer></script>' in page and "[drive.rrd](drive.rrd)" in page
    html = "<html><head></head></html>"
    assert """content="connect-src 'self'">""" in site.on_post_page(html, ON_PAGE, None)
    assert site.on_page_markdown("text", ON_ANOTHER, None, None) == "text"
    assert site.on_post_page(html, ON_ANOTHER, None) == html


def test_without_the_viewer_a_page_has_the_file_alone(site, no_package):
    assert site.viewer() == {}
    page = site.on_page_markdown(drive_page(), ON_PAGE, None, None)
    assert "[drive.rrd](drive.rrd)" in page and "(drive.webp)" in page
    assert "<button" not in page and "<script" not in page


def test_a_page_without_its_picture_is_refused(site):
    with pytest.raises(SystemExit, match=r"gallery/drive.md: wanted !\[The picture"):
        site.with_player("# A drive\n", "drive", 17.0)


def contents(path):
    """By rerun's own reader: {entity: {column: values}}."""
    found = {}
    for chunk in pytest.importorskip("rerun.chunk").RrdReader(str(path)).stream():
        columns, batch = found.setdefault(chunk.entity_path, {}), chunk.to_record_batch()
        for name in set(batch.schema.names) - {"log_time", "time"}:  # nanoseconds, too fine for datetime
            columns.setdefault(name.rpartition(":")[2], []).extend(batch.column(name).to_pylist())
    return found


def test_there_is_a_recording_for_each_page_that_has_one():
    assert [path.stem for path in RECORDINGS] == ["drive"]


@pytest.mark.slow
@pytest.mark.parametrize("path", RECORDINGS, ids=lambda path: path.stem)
def test_a_recording_is_small_and_holds_the_map_and_the_path(path):
    from PIL import Image

    found = contents(path)
    assert path.stat().st_size < MOST_BYTES
    assert pytest.importorskip("rerun.chunk").RrdReader(str(path)).blueprints(), "how it is laid out"
    maps, paths = found["/map/cost"], found["/map/path"]
    assert maps["tick"][0] == paths["tick"][0] == 1 and len(maps["tick"]) > 10, "the map follows the drive"
    shapes = set()
    for (data,) in maps["blob"]:
        with Image.open(io.BytesIO(bytes(data))) as picture:
            shapes.add(picture.size)
    ((width, height),) = shapes
    (goal,) = found["/map/goal"]["positions"]
    for (line,) in filter(None, paths["strips"]):
        assert all(0 <= x < width and 0 <= y < height for x, y in line) and line[-1] == goal[0]
    assert len(found["/map/robot"]["positions"]) == len(paths["tick"])


@pytest.mark.parametrize("path", RECORDINGS, ids=lambda path: path.stem)
def test_a_recording_can_be_read_by_the_viewer_that_the_site_has(path):
    """Viewers read what older ones wrote, not the reverse."""
    extra = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]["docs"]
    (version,) = (re.fullmatch(r"rerun-notebook~=(\d+)\.(\d+)\.0", name) for name in extra if "rerun" in name)
    head = path.read_bytes()[:8]
    assert head[:4] == b"RRF2" and tuple(head[4:6]) <= tuple(map(int, version.groups()))


@pytest.mark.slow
@pytest.mark.parametrize("path", RECORDINGS, ids=lambda path: path.stem)
def test_a_recording_has_what_its_example_records_now(path, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "examples")
    importlib.import_module(path.stem).main(tmp_path, small=True)
    sys.modules.pop(path.stem)
    kept, made = contents(path), contents(tmp_path / path.name)
    assert kept.keys() == made.keys()
    assert all(kept[name].keys() == made[name].keys() for name in made if name != "/map/cost")
