"""Additions to mkdocs: pages of examples, commands, public names, and of files outside docs/."""

from __future__ import annotations

import ast
import os
import re
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from mkdocs.config.defaults import MkDocsConfig
    from mkdocs.structure.files import Files
    from mkdocs.structure.pages import Page

ROOT = Path(__file__).parent.parent.parent
OUTSIDE = {  # page: the file that it shows
    "cards/edge.md": "nnpp_edge/models/edge.md",
    "cards/paper.md": "nnpp_edge/models/paper.md",
    "samples.md": "nnpp_edge/terrain/samples/README.md",
    "contributing.md": "CONTRIBUTING.md",
    "changelog.md": "CHANGELOG.md",
}
API = {  # page: its title, what it says first, and the modules or names it shows
    "terrain": (
        "Terrain files",
        "Elevation maps from files, samples, workloads, vehicles, rocks. Rasters need the extra `geo`.",
        "terrain.dem terrain.workloads terrain.vehicle_files terrain.rocks "
        "terrain.synthetic terrain.coordinates terrain.vectors terrain.route",
    ),
    "large": (
        "Maps larger than memory",
        "A planner that reads its map by windows.",
        "runtime.planners.windowed.WindowedPlanner runtime.terrain.windows",
    ),
    "robot": (
        "ROS maps and transports",
        "The layouts of ROS messages without ROS, and what carries inputs and answers of the loop.",
        "ros.maps robot.transports.wire robot.transports.stdio robot.transports.rerun_view robot.transports.mcap_log",
    ),
    "simulation": (
        "Simulation",
        "A robot that drives through the loop over ground that its map knows only roughly.",
        "simulation.scene simulation.simulate simulation.drive_picture",
    ),
    "pictures": ("Pictures", "With OpenCV alone; figures with matplotlib.", "viz.picture viz.figures"),
    "profiling": (
        "Measuring",
        "What `nnpp-edge profile` and `evaluate` are made of.",
        "profiling.profile_file profiling.report profiling.compare",
    ),
    "networks": (
        "Networks",
        "From terrain to an int8 model. Needs the extra `train`.",
        "terrain.shards.Recipe terrain.dataset model.registry training.checkpoint.TrainSettings training.train.train "
        "export.to_onnx.export_network export.to_onnx.ExportReport calibrate.quantize",
    ),
}
RUNTIME_FIRST = ["planners.planner.Planner", "planners.plan.Plan", "planners.dynamic.DynamicPlanner"]
RUNTIME_LAST = ["planners.tour.Tour", "map.along.Along", "map.along.Numbers", "errors", "planners.refine"]
_LOADED = re.compile(r"<(?:script|link|img|iframe|source|video|object|embed)\b[^>]*>")
_FENCED = re.compile(r"(^ *```.*?^ *```$)", re.DOTALL | re.MULTILINE)


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Put the pages that are made into the navigation, each after the page that lists them."""
    os.environ.setdefault("NO_MKDOCS_2_WARNING", "1")
    experiments = list((ROOT / "docs/reproduction").glob("*/*.md"))
    experiments.sort(key=lambda path: (path.stem[0] == "t", len(path.stem), path))
    made = {
        "gallery/index.md": [f"gallery/{path.stem}.md" for path in examples()],
        "api/index.md": ["api/runtime.md", *(f"api/{name}.md" for name in API)],
        "cli/index.md": [f"cli/{name}.md" for name in commands()],
        "reproduction/README.md": [f"reproduction/{path.stem}/{path.name}" for path in experiments],
    }

    def filled(item: Any) -> list[Any]:
        if isinstance(item, list):
            return [each for inner in item for each in filled(inner)]
        if isinstance(item, dict):
            return [{name: filled(of) if isinstance(of, list) else of for name, of in item.items()}]
        return [item, *made.get(item, [])]

    config.nav = filled(config.nav or [])
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that are made."""
    from mkdocs.structure.files import File

    for page, content in pages().items():
        files.append(File.generated(config, page, content=content))
    files.append(File.generated(config, "style.css", content=(ROOT / "docs/_site/style.css").read_text()))
    return files


def pages() -> dict[str, str]:
    """Every page that is made, and its Markdown."""
    return {page: (ROOT / path).read_text() for page, path in OUTSIDE.items()} | _gallery() | _api() | _cli()


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Turn links to files that have a page here into links to it, and `docs/…` in text into such links.

    Links to other files outside docs/ become their path.
    """
    here = page.file.src_uri
    up = "../" * here.count("/")
    page_of = {path: name for name, path in OUTSIDE.items()}
    written_in = Path(OUTSIDE.get(here, f"docs/{here}")).parent

    def linked(match: re.Match[str]) -> str:
        text, target, anchor = match[1], match[2], match[3] or ""
        path = os.path.normpath(written_in / target)
        if path in page_of or path.startswith("docs/"):
            return f"[{text}]({up}{page_of.get(path) or path.removeprefix('docs/')}{anchor})"
        return f"{text} (`{path}`)"

    def named(match: re.Match[str]) -> str:
        return f"[{match[0].strip('`')}]({up}{match[1]})" if files.get_file_from_path(match[1]) else match[0]

    parts = _FENCED.split(markdown)  # text, code, text, …
    for at in range(0, len(parts), 2):
        text = re.sub(r"(?<!!)\[([^\]]+)\]\((?!http|#)([^)#\s]+)(#[^)\s]*)?\)", linked, parts[at])
        parts[at] = re.sub(r"(?<!\[)`docs/([a-z-]+\.md)`", named, text)
    return "".join(parts)


def on_post_build(config: MkDocsConfig) -> None:
    """Fail where a page would ask another host for something."""
    for path in Path(config.site_dir).rglob("*.html"):
        for tag in _LOADED.findall(path.read_text()):
            if re.search(r"""\b(src|href|srcset)=["']?(https?:)?//""", tag) and "canonical" not in tag:
                raise SystemExit(f"{path}: wanted nothing from other hosts, got {tag}")


def examples() -> list[Path]:
    """The runnable examples, in the order of the table in their README."""
    names = re.findall(r"\]\((\w+\.py)\)", (ROOT / "examples/README.md").read_text())
    return [ROOT / "examples" / name for name in names]


def _gallery() -> dict[str, str]:
    cards, made = "", {}
    for path in examples():
        _, words, code = path.read_text().split('"""', 2)
        title, body = words.split("\n", 1)
        body = re.sub(r"^(Run time|Data): ", r"\n**\1**: ", body, flags=re.MULTILINE)
        made[f"gallery/{path.stem}.md"] = (
            f"---\ntitle: {re.split('[,:.](?: |$)', title)[0]}\n---\n\n# {title.rstrip('.')}\n{body}\n\n"
            f"![The picture that it makes]({path.stem}.webp)\n\n"
            f"```sh\npython examples/{path.name}\n```\n\n```python\n{code.strip()}\n```"
        )
        picture = f'<img src="{path.stem}.webp" alt="" loading="lazy">'
        cards += f'<a href="{path.stem}.html">{picture}<span>{title}</span></a>\n'
    head = (
        "# Gallery\n\nScripts of less than 60 lines in the folder `examples/` of the repository, each with the "
        "picture that it makes. What they share, how ground and paths are drawn, is in `examples/drawing.py`.\n\n"
    )
    return made | {"gallery/index.md": f'{head}<div class="cards">\n{cards}</div>\n'}


def _api() -> dict[str, str]:
    listed = ast.parse((ROOT / "runtime/__init__.pyi").read_text()).body
    imports = [node for node in listed if isinstance(node, ast.ImportFrom) and node.module]
    names = [f"{node.module}.{node.names[0].name}".removeprefix("nnpp_edge.runtime.") for node in imports]
    shown = dict.fromkeys([*RUNTIME_FIRST, *names, *RUNTIME_LAST])
    words = "What runs on a robot: planners, plans, costs, regions, the loop. One import for all."
    first = "What runs on a robot. Every name down to `Vehicle` can be imported from here: "
    first += "`from nnpp_edge.runtime import Planner`."
    made = {"api/runtime.md": f"# nnpp_edge.runtime\n\n{first}\n\n{_shown(f'runtime.{name}' for name in shown)}"}
    rows = [f"| [nnpp_edge.runtime](runtime.md) | {words} |"]
    for page, (title, words, of_page) in API.items():
        made[f"api/{page}.md"] = f"# {title}\n\n{words}\n\n{_shown(of_page.split())}"
        rows.append(f"| [{title}]({page}.md) | {words} |")
    last = "\nEvery entry says shapes, dtypes, units, ranges and errors, and shows its source."
    return made | {"api/index.md": "\n".join(["# Python\n", "| page | what |", "| --- | --- |", *rows, last])}


def _shown(names: Iterable[str]) -> str:
    return "\n\n".join(f"::: nnpp_edge.{name}" for name in names) + "\n"


def commands() -> dict[str, click.Command]:
    """Every command, by its name."""
    from nnpp_edge.cli.main import cli

    context = click.Context(cli)
    found = {name: cli.get_command(context, name) for name in cli.list_commands(context)}
    return {name: command for name, command in found.items() if command is not None}


def _cli() -> dict[str, str]:
    rows, made = list[str](), {}
    for name, command in commands().items():
        rows.append(f"| [nnpp-edge {name}]({name}.md) | {command.get_short_help_str(200)} |")
        text = f"---\ntitle: {name}\n---\n\n# nnpp-edge {name}\n\n{_help(f'nnpp-edge {name}', command)}"
        for inner, each in getattr(command, "commands", {}).items():
            text += f"\n## nnpp-edge {name} {inner}\n\n{_help(f'nnpp-edge {name} {inner}', each)}"
        made[f"cli/{name}.md"] = text
    last = "\nExit codes: 0 done; 1 no path, or a budget missed; 2 wrong use or bad input; 3 too noisy to tell."
    head = ["# Commands\n", "| command | what it does |", "| --- | --- |"]
    return made | {"cli/index.md": "\n".join([*head, *rows, last])}


def _help(called: str, command: click.Command) -> str:
    context = click.Context(command, info_name=called, terminal_width=100, max_content_width=100)
    return f"```text\n{command.get_help(context)}\n```\n"
