"""What the documents say is so: links lead somewhere, Python runs, commands are understood, nothing
is left out.
"""

import ast
import doctest
import functools
import importlib
import json
import pkgutil
import re
import shlex
import sys
import tomllib
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace as Message

import click
import numpy as np
import pytest

from nnpp_edge.benchmarks import results
from nnpp_edge.cli.main import COMMANDS, cli
from nnpp_edge.runtime.errors import INSTALL
from nnpp_edge.runtime.network.inference import NetworkModel
from nnpp_edge.runtime.network.priors import prices_by
from nnpp_edge.terrain.dem import SAMPLES, sample_dem, sample_path
from nnpp_edge.terrain.georeference import Georeference
from nnpp_edge.terrain.rasters import raster_bytes
from tests.robot.test_ros_maps import as_objects, message
from tests.strategies import flat

ROOT = Path(__file__).parent.parent
DOCUMENTS = sorted(
    path
    for folder, pattern in (
        (".", "*.md"),
        ("docs", "**/*.md"),
        ("examples", "*.md"),
        ("nnpp_edge", "**/*.md"),
    )
    for path in (ROOT / folder).glob(pattern)
)
FENCE = re.compile(
    r"(?:<!-- (only shown|printed by): ([^>]+) -->\n)?^( *)```(\w*)\n(.*?)^ *```",
    re.DOTALL | re.MULTILINE,
)
LINK = re.compile(r"\[[^\]]*\]\((?!https?:|mailto:)([^)#\s]*)(?:#([^)\s]*))?\)")
NOT_RUN = {
    "nnpp-edge warmup": "minutes on a new machine; tests/runtime/test_warmup.py",
    "nnpp-edge view": "ends with Ctrl-C; tests/view",
    "--input zenoh": "ends with a signal; tests/robot",
    "nnpp-edge ros": "ends with a signal; tests/robot",
    "$DEM": "a script with pipes; tests/robot/test_run.py",
    "nnpp-edge profile": "its exit code is the machine's; tests/profiling",
    "nnpp-edge evaluate": "minutes; tests/profiling",
    "docs/boards.md": "minutes",
    "docs/reproduce.md": "an hour; tests/reproduction",
    "docs/models.md": "hours of training; tests/training",
    "docs/reference/shipped-models.md": "hours of training; tests/training",
    "docs/dataset.md": "minutes; tests/training",
    "docs/deploy.md": "a robot's system, and root",
    "docs/large-maps.md": "a map of 20,000 × 20,000 cells",
    "CONTRIBUTING.md": "minutes",
}
"""Commands, by a part of them, and pages that are not run: why, and the tests that run the like."""


DRIVE = """
{"at": 0, "type": "pose", "row": 20, "col": 20}
{"at": 0, "type": "goal", "row": 90, "col": 90}
""".lstrip()
SHORT = {"docs/start.md": 255}
"""Words at most of a page that must be shorter than the other guides."""
LONG = ("messages.md", "glossary.md", "results.md", "architecture.md", "boards.md")
"""Pages that are looked things up in, beside those in folders of their own: they may be long."""


def name_of(path):
    return path.relative_to(ROOT).as_posix()


def blocks(path, *languages):
    """The text of each block in one of these languages, whether it is only shown, and the command
    that prints it.
    """
    for kind, words, indent, language, text in FENCE.findall(path.read_text()):
        if language in languages:
            text = re.sub(f"^{indent}", "", text, flags=re.MULTILINE)
            yield text, kind == "only shown", words if kind == "printed by" else ""


def with_blocks(*languages):
    return [path for path in DOCUMENTS if any(True for _ in blocks(path, *languages))]


@functools.cache
def anchors(path):
    """As GitHub and the site make them of headings."""
    text = FENCE.sub("", path.read_text())
    heads = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    plain = [re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", head).strip().lower() for head in heads]
    return {re.sub(r"[^\w\- ]", "", head).replace(" ", "-") for head in plain} | set(
        re.findall(r'id="([^"]+)"', text)
    )


def test_links_lead_somewhere():
    made = [
        ROOT / "docs" / name for name in ("gallery", "api", "cli")
    ]  # pages are made when the site is built
    for path in DOCUMENTS:
        for target, anchor in LINK.findall(FENCE.sub("", path.read_text())):
            end = (path.parent / target).resolve() if target else path
            if end.parent in made and end.suffix == ".md":
                continue
            assert end.exists(), f"{name_of(path)}: {target}"
            if anchor and end.suffix == ".md":
                assert anchor in anchors(end), f"{name_of(path)}: {target}#{anchor}"


@pytest.mark.parametrize("path", sorted((ROOT / "docs").glob("*.md")), ids=name_of)
def test_a_guide_is_short(path):
    if path.name not in LONG:
        assert len(path.read_text().split()) <= SHORT.get(name_of(path), 860)


@pytest.fixture(scope="module")
def workshop(tmp_path_factory):
    """A folder with what the documents take for granted."""
    folder = tmp_path_factory.mktemp("workshop")
    place = Georeference("EPSG:26915", (1.0, 0.0, 429_324.0, 0.0, -1.0, 5_150_813.0))
    dem = replace(sample_dem("earth_hummocks"), georeference=place)
    (folder / "dem.tif").write_bytes(raster_bytes(folder, dem.elevation, dem))
    np.save(folder / "heights.npy", dem.elevation[:80, :90])
    (folder / "coarse.tif").symlink_to("dem.tif")
    (folder / "drive.jsonl").write_text(DRIVE)
    return folder


def grid_map_message(rows, cols):
    """A flat grid_map_msgs/GridMap of cells of 0.1 m."""
    sides = {"resolution": 0.1, "length_x": 0.1 * rows, "length_y": 0.1 * cols}
    return as_objects(message(values=np.zeros((rows, cols), np.float32), **sides))


def assumed(path):
    """Names that a document's Python assumes: a map, a query, messages."""
    dem = sample_dem("earth_hummocks").elevation
    names = {"np": np, "dem": dem, "start": (20, 20), "goal": (240, 150)}
    if path.name == "README.md":
        return {"np": np, "dem": np.outer(np.sin(np.arange(512) / 40.0), np.ones(512))}
    if path.name == "onboard.md":
        return names | {"cost": flat(256, 256, 0.2), "patch": np.ones((3, 4))}
    if path.name == "how-to-maps.md":
        return names | {"message": grid_map_message(200, 150)}
    if path.name == "routes.md":
        from nnpp_edge.runtime import Planner

        return names | {
            "planner": Planner(flat(400, 360, 0.2)),
            "start": (5, 5),
            "goal": (390, 90),
        }
    if path.name == "messages.md":
        from nnpp_edge.ros.maps import MapFrame

        return names | {
            "message": grid_map_message(20, 30),
            "map_frame": MapFrame(0.1, -5.0, -5.0),
            "answer": Message(path=np.array([[3, 4], [3, 5]]), arcs=(), waypoints=None),
            "yaw": 0.5,
        }
    return names


@pytest.mark.parametrize("path", with_blocks("python"), ids=name_of)
@pytest.mark.filterwarnings("ignore::nnpp_edge.runtime.SaturationWarning")
def test_python_runs(path, workshop, monkeypatch):
    monkeypatch.chdir(workshop)
    names = assumed(path)
    for code, only_shown, _ in blocks(path, "python"):
        if only_shown:
            imports = [
                node
                for node in ast.parse(code).body
                if isinstance(node, ast.Import | ast.ImportFrom)
            ]
            code = ast.unparse(ast.Module(imports, []))
        exec(code, names)


def test_the_page_of_model_files_is_that_of_the_shipped_files():
    page = ROOT / "docs/reference/model-files.md"
    names = {}
    for code, *_ in blocks(page, "python"):
        exec(code, names)
    described = page.read_text().split("\n## ")
    for model in ("edge", "paper", "unseen"):
        network = NetworkModel(model)
        (section,) = (text for text in described if text.startswith(f"`{model}.onnx`"))
        session = network.session
        for value in (*session.get_inputs(), *session.get_outputs()):
            shape = str(tuple(value.shape))
            assert re.search(
                rf"^\| `{value.name}` \w+ \| {re.escape(shape)}", section, re.MULTILINE
            )
        assert all(f"`{name}`" in section for name in network.metadata.channels if name != "ends")
    edge, paper = NetworkModel("edge"), NetworkModel("paper")
    edge.set_map(names["planes"])
    paper.set_map(np.stack([names["cost"]] * 2).astype(np.float32))
    wanted = {
        "edge": edge.answer((32.0, 8.0), (32.0, 56.0)),
        "paper": paper.answer((128.0, 32.0), (128.0, 224.0)),
        "unseen": prices_by("network", np.float32(names["heights"]), names["limits"], 160.0, 8),
    }
    for model, answer in wanted.items():
        assert names[model] == pytest.approx(answer, abs=1e-5), model


def test_examples_in_docstrings_are_true():
    names = set()
    for folder in (ROOT / "nnpp_edge").iterdir():  # those at the top are links
        for path in folder.rglob("*.py") if folder.is_dir() else ():
            if ">>> " in path.read_text():
                names.add(
                    ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
                )
    assert {f"nnpp_edge.runtime.planners.{name}" for name in ("planner", "dynamic")} <= names
    for name in names:
        options = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
        result = doctest.testmod(importlib.import_module(name), optionflags=options)
        assert result.attempted and not result.failed, name


def commands(path):
    """The commands of a document's blocks, as lists of words, and what stands below each as its
    output.
    """
    for text, _, printing in blocks(path, "", "sh"):
        lines = text.replace("\\\n", " ").splitlines()
        for at, line in enumerate([printing] if printing else lines):
            called = re.match(r"^\$? *(?:\S*/)?nnpp-edge (.*)", line)
            if called:
                words = shlex.split(re.split(r" (?:[0-9]?[<>|]|&$)", called[1])[0], comments=True)
                shown = (
                    text if printing else "\n".join(lines[at + 1 :]) if line.startswith("$") else ""
                )
                yield [word for word in words if word not in ("...", "…")], shown


def test_commands_are_understood():
    context = click.Context(cli)
    understood = 0
    for name, *words in (words for path in with_blocks("", "sh") for words, _ in commands(path)):
        command = cli.get_command(context, name)
        assert command is not None, name
        if isinstance(command, click.Group) and words and words[0] in command.commands:
            command = command.commands[words[0]]
            words = words[1:]
        inner = click.Context(command, info_name=name, **command.context_settings)
        given, *_ = command.make_parser(inner).parse_args(list(words))
        for parameter in command.params:
            value = given.get(parameter.name)
            limited = click.Choice | click.IntRange | click.FloatRange
            if isinstance(parameter.type, limited) and isinstance(value, str):
                parameter.type.convert(value, parameter, context)  # BadParameter where it is none
        understood += 1
    assert understood > 50


def without_times(text):
    """On one line, `…` for what is left out; times are another machine's."""
    text = re.sub(r"^time  .*\n", "", text, flags=re.MULTILINE)
    text = re.sub(r"( (?:MAP|map|region) +OK .*%) .* (\d+)$", r"\1 \2", text, flags=re.MULTILINE)
    return " ".join(re.sub("─+", " ", text).split())


@pytest.mark.slow
@pytest.mark.parametrize("path", with_blocks("", "sh"), ids=name_of)
def test_commands_run_and_print_what_stands_below_them(
    path, workshop, nnpp_edge, tmp_path, monkeypatch
):
    for file in workshop.iterdir():
        (tmp_path / file.name).symlink_to(file)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("nnpp_edge.runtime.compiled.notice.AFTER_S", 1e6)  # busy machines are slow
    for words, shown in commands(path):
        line = " ".join(("nnpp-edge", *words))
        if not any(part in line or part == name_of(path) for part in NOT_RUN):
            ended = nnpp_edge(*words)
            assert ended.code == ("NO_PATH" in shown), (line, ended.err)
            if shown:
                parts = map(re.escape, without_times(shown).split("…"))
                assert re.fullmatch(".*".join(parts), without_times(ended.err + ended.out)), line


def test_tables_and_messages_can_be_read():
    for path in with_blocks("toml", "json"):
        for text, *_ in blocks(path, "toml"):
            tomllib.loads(text)
        for text, *_ in blocks(path, "json"):
            json.loads(text)


@pytest.fixture(scope="module")
def hooks():
    sys.path.insert(0, str(ROOT / "docs/_site"))
    yield importlib.import_module("hooks")
    sys.path.remove(str(ROOT / "docs/_site"))


def test_the_site_shows_every_command_and_option(hooks):
    pages = hooks.pages()
    for name in COMMANDS:
        assert f"({name}.md)" in pages["cli/index.md"]
        command = cli.get_command(click.Context(cli), name)
        for each in (command, *getattr(command, "commands", {}).values()):
            shown = [
                opt.opts[-1]
                for opt in each.params
                if isinstance(opt, click.Option) and not opt.hidden
            ]
            assert shown or name == "ros"  # whose options are those of ROS
            assert all(option in pages[f"cli/{name}.md"] for option in shown)


def test_the_site_shows_names_that_are_there_and_all_of_the_runtime():
    import nnpp_edge.runtime as runtime

    public = {name for name in dir(runtime) if name[0].isupper() and name != "TYPE_CHECKING"}
    pages = "\n".join(path.read_text() for path in (ROOT / "docs/api").glob("*.md"))
    shown = re.findall(r"^::: (nnpp_edge\S+)", pages, re.MULTILINE)
    assert public and public <= {name.rpartition(".")[2] for name in shown}
    for name in shown:
        assert pkgutil.resolve_name(name), name


def test_the_sites_home_shows_the_mission_as_readme_does(hooks):
    page = Message(file=Message(src_uri="index.md"))
    home = hooks.on_page_markdown((ROOT / "docs/index.md").read_text(), page, None, None)
    readme = (ROOT / "README.md").read_text()
    assert re.search(r"results: mission -->.*?end -->", readme, re.DOTALL)[0] in home


def test_cells_of_wide_tables_name_their_columns_for_phones(hooks):
    heads = "<th>time, <code>ms</code></th>" + "<th>n</th>" * 5
    wide = f"<table><tr>{heads}</tr>{'<tr><td>1</td></tr>' * 12}</table>"
    shown = hooks.on_page_content(wide, None, None, None)
    assert shown.count('<td data-head="time, ms">1</td>') == 2


def test_a_page_that_asks_another_host_for_something_is_refused(hooks, tmp_path):
    config = Message(site_dir=str(tmp_path))
    page = tmp_path / "page.html"
    page.write_text(
        '<a href="https://example.org">a link</a><script src="../recording.js"></script>'
    )
    hooks.on_post_build(config)
    page.write_text('<script src="https://example.org/script.js"></script>')
    with pytest.raises(
        SystemExit, match=r"page.html: wanted nothing from other hosts, got <script"
    ):
        hooks.on_post_build(config)


def test_every_sample_is_shipped_with_its_source():
    words = (ROOT / "nnpp_edge/terrain/samples/README.md").read_text()
    assert {path.stem for path in sample_path("moon_rocks").parent.glob("*.npz")} == set(SAMPLES)
    assert all(f"`{name}.npz`" in words for name in SAMPLES)


def test_the_documents_index_of_decisions_is_whole():
    linked = re.findall(
        r"^- \[.*\]\((.*)\)", (ROOT / "docs/decisions.md").read_text(), re.MULTILINE
    )
    assert sorted(linked) == sorted(
        f"decisions/{path.name}" for path in (ROOT / "docs/decisions").iterdir()
    )


def test_tables_of_results_are_those_of_the_run_that_is_kept():
    kept = json.loads((ROOT / results.STORED).read_text())
    for page in results.PAGES:
        text = (ROOT / page).read_text()
        assert "<!-- results: " in text and results.filled(text, kept) == text
    network = next(row for row in kept["mission"] if row["planner"] == "nnpp")  # at 256²
    told = f"`edge` is {network['speedup_total']:.1f} times as fast as exact A"
    assert told in " ".join(text.split())


def test_how_it_is_installed_stands_on_one_page_as_in_error_lines():
    """A release changes `INSTALL` and this page. Robots get a bundle."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    bundle = "pip install --no-index --find-links . nnpp-edge nnpp-edge-kernels"
    assert f"{bundle}\n" in (ROOT / ".ci/bundle").read_text()
    others = ("pip install uv", "pip install mcap-ros2-support")
    by_page = {"docs/start.md": INSTALL.partition("{0}")[0], "docs/deploy.md": bundle}
    for path in DOCUMENTS:
        lines = re.findall(r"pip install [^`\n]+", path.read_text())
        begins = by_page.get(name_of(path), others)
        assert all(line.startswith(begins) for line in lines), (name_of(path), lines)
        assert lines or name_of(path) not in by_page
        for named in re.findall(r"the extras? `([a-z,]+)`", path.read_text()):
            assert set(named.split(",")) <= set(project["optional-dependencies"]), named
    for folder in ("nnpp_edge", "runtime", "export", "calibrate"):
        for path in (ROOT / folder).rglob("*.py"):
            assert "pip install" not in path.read_text() or path.name == "errors.py", path
