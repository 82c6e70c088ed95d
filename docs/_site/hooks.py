"""Additions to mkdocs: pages of examples, commands, public names, and of files outside docs/."""

from __future__ import annotations

import ast
import os
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import click
    from mkdocs.config.defaults import MkDocsConfig
    from mkdocs.structure.files import Files
    from mkdocs.structure.pages import Page

ROOT = Path(__file__).parent.parent.parent
OPTIONAL = {"view.md", "boards.md", "contributing.md", "changelog.md"}
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
        "terrain.dem terrain.dem_windows terrain.shipped terrain.workloads terrain.vehicle_files terrain.rocks "
        "terrain.synthetic terrain.coordinates terrain.vectors terrain.route",
    ),
    "large": (
        "Maps larger than memory",
        "A planner that reads its map by windows.",
        "runtime.planners.windowed.WindowedPlanner runtime.planners.windowed.Reading runtime.terrain.windows",
    ),
    "robot": (
        "ROS maps and transports",
        "The layouts of ROS messages without ROS, and what carries inputs and answers of the loop.",
        "ros.maps ros.occupancy robot.transports.wire robot.transports.framing robot.transports.rerun_view "
        "robot.transports.mcap_log",
    ),
    "simulation": (
        "Simulation",
        "A robot that drives through the loop over ground that its map knows only roughly.",
        "simulation.scene simulation.simulate simulation.drive_picture",
    ),
    "pictures": ("Pictures", "With OpenCV alone.", "viz.picture viz.reach_picture viz.profile_picture"),
    "profiling": (
        "Measuring",
        "What `nnpp-edge profile` and `evaluate` are made of.",
        "profiling.profile_file profiling.report profiling.report_format profiling.compare",
    ),
    "networks": (
        "Networks",
        "From terrain to an int8 model. Needs the extra `train`.",
        "terrain.shards.Recipe terrain.dataset model.registry training.checkpoint.TrainSettings training.train.train "
        "export.to_onnx.export_network export.to_onnx.ExportReport calibrate.quantize",
    ),
}
RUNTIME_MORE = ("planners.tour.Tour", "map.along.Along", "map.along.Numbers", "errors", "planners.refine")
_LOADED = re.compile(r"<(?:script|link|img|iframe|source|video|object|embed)\b[^>]*>")
_FENCED = re.compile(r"(^ *```.*?^ *```$)", re.DOTALL | re.MULTILINE)
_REPEAT = re.compile(r"^(Run time|Data): ", re.MULTILINE)


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Leave pages out of the navigation that are not there, and fill in those that are made."""
    os.environ.setdefault("NO_MKDOCS_2_WARNING", "1")
    experiments = sorted(
        (ROOT / "docs/reproduction").glob("*/*.md"), key=lambda path: (path.stem[0] == "t", len(path.stem), path)
    )
    made = {
        "gallery/index.md": [f"gallery/{path.stem}.md" for path in examples()],
        "api/index.md": ["api/runtime.md", *(f"api/{name}.md" for name in API)],
        "cli/index.md": [f"cli/{name}.md" for name in commands()],
        "reproduction/README.md": [f"reproduction/{path.stem}/{path.name}" for path in experiments],
    }

    def filled(nav: list[Any]) -> list[Any]:
        found: list[Any] = []
        for item in nav:
            if isinstance(item, dict):
                found.append({name: filled(of) if isinstance(of, list) else of for name, of in item.items()})
            elif item not in OPTIONAL or (ROOT / OUTSIDE.get(item, f"docs/{item}")).exists():
                found += [item, *made.get(item, [])]
        return found

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
    found = {page: (ROOT / path).read_text() for page, path in OUTSIDE.items() if (ROOT / path).exists()}
    return found | _gallery() | _api() | _cli()


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Turn links to files that have a page here into links to it, and `docs/…` in text into such links.

    Links to other files outside docs/ become their path.
    """
    here = page.file.src_uri
    up = "../" * here.count("/")
    where = {path: name for name, path in OUTSIDE.items()}
    written_in = Path(OUTSIDE.get(here, f"docs/{here}")).parent

    def linked(match: re.Match[str]) -> str:
        text, target, anchor = match[1], match[2], match[3] or ""
        path = os.path.normpath(written_in / target)
        if path in where or path.startswith("docs/"):
            return f"[{text}]({up}{where.get(path) or path.removeprefix('docs/')}{anchor})"
        return f"{text} (`{path}`)"

    def named(match: re.Match[str]) -> str:
        name = match[1]
        return f"[{match[0].strip('`')}]({up}{name})" if files.get_file_from_path(name) else match[0]

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
    found = {path.stem: path for path in (ROOT / "examples").glob("*.py") if path.stem != "drawing"}
    names = re.findall(r"\]\((\w+)\.py\)", (ROOT / "examples/README.md").read_text())
    return [found[name] for name in names]


def _gallery() -> dict[str, str]:
    made, cards = {}, []
    for path in examples():
        source = path.read_text()
        words = ast.get_docstring(ast.parse(source)) or ""
        title, body = words.split("\n", 1)
        picture, short = f"{path.stem}.webp", re.split("[,:.](?: |$)", title)[0]
        made[f"gallery/{path.stem}.md"] = "\n".join(
            [f"---\ntitle: {short}\n---\n", f"# {title.rstrip('.')}",
             _REPEAT.sub(r"\n**\1**: ", body), f"\n![The picture that it makes]({picture})\n",
             f"```sh\npython examples/{path.name}\n```\n", "```python", source.split('"""', 2)[2].strip(), "```"]
        )  # fmt: skip
        cards.append(
            f'<a href="{path.stem}.html"><img src="{picture}" alt="" loading="lazy"><span>{title}</span></a>'
        )
    head = (
        "# Gallery\n\nScripts of less than 60 lines in the folder `examples/` of the repository, each with the "
        "picture that it makes. What they share, how ground and paths are drawn, is in `examples/drawing.py`.\n\n"
    )
    return made | {"gallery/index.md": head + '<div class="cards">\n' + "\n".join(cards) + "\n</div>\n"}


def _api() -> dict[str, str]:
    listed = ast.parse((ROOT / "runtime/__init__.pyi").read_text()).body
    imports = [node for node in listed if isinstance(node, ast.ImportFrom) and node.module]
    names = [f"{node.module}.{node.names[0].name}".removeprefix("nnpp_edge.runtime.") for node in imports]
    first = ["planners.planner.Planner", "planners.plan.Plan", "planners.dynamic.DynamicPlanner"]
    ordered = [*first, *(name for name in names if name not in first), *RUNTIME_MORE]
    text = "# nnpp_edge.runtime\n\nWhat runs on a robot. Every name down to `Vehicle` can be imported from here: "
    text += "`from nnpp_edge.runtime import Planner`.\n\n"
    made = {"api/runtime.md": text + _shown(f"runtime.{name}" for name in ordered)}
    what = "What runs on a robot: planners, plans, costs, regions, the loop. One import for all."
    lines = ["# Python\n", "| page | what |", "| --- | --- |", f"| [nnpp_edge.runtime](runtime.md) | {what} |"]
    for page, (title, words, shown) in API.items():
        made[f"api/{page}.md"] = f"# {title}\n\n{words}\n\n{_shown(shown.split())}"
        lines.append(f"| [{title}]({page}.md) | {words} |")
    lines.append("\nEvery entry says shapes, dtypes, units, ranges and errors, and shows its source.")
    return made | {"api/index.md": "\n".join(lines)}


def _shown(names: Any) -> str:
    return "\n\n".join(f"::: nnpp_edge.{name}" for name in names) + "\n"


def commands() -> dict[str, click.Command]:
    """Every command, by its name."""
    import click

    from nnpp_edge.cli.main import cli

    context = click.Context(cli)
    found = {name: cli.get_command(context, name) for name in cli.list_commands(context)}
    return {name: command for name, command in found.items() if command is not None}


def _cli() -> dict[str, str]:
    lines, made = ["# Commands\n", "| command | what it does |", "| --- | --- |"], {}
    for name, command in commands().items():
        lines.append(f"| [nnpp-edge {name}]({name}.md) | {command.get_short_help_str(200)} |")
        parts = [f"---\ntitle: {name}\n---\n\n# nnpp-edge {name}\n", _help(f"nnpp-edge {name}", command)]
        for inner, each in getattr(command, "commands", {}).items():
            parts += [f"## nnpp-edge {name} {inner}\n", _help(f"nnpp-edge {name} {inner}", each)]
        made[f"cli/{name}.md"] = "\n".join(parts)
    lines.append(
        "\nExit codes: 0 done; 1 no path, or a budget missed; 2 wrong use or bad input; 3 too noisy to tell."
    )
    return made | {"cli/index.md": "\n".join(lines)}


def _help(called: str, command: click.Command) -> str:
    """A command's `--help`."""
    import click

    context = click.Context(command, info_name=called, terminal_width=100, max_content_width=100)
    return f"```text\n{command.get_help(context)}\n```\n"
