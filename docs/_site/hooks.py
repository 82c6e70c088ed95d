"""Additions to mkdocs: pages of commands, and of files outside docs/."""

from __future__ import annotations

import json
import os
import re
from html import escape
from itertools import cycle
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
    "gallery/index.md": "examples/README.md",
    "samples.md": "nnpp_edge/terrain/samples/README.md",
    "contributing.md": "CONTRIBUTING.md",
    "changelog.md": "CHANGELOG.md",
}
_LOADED = re.compile(r"<(?:script|link|img|iframe|source|video|object|embed)\b[^>]*>")
_FENCED = re.compile(r"(^ *```.*?^ *```$)", re.DOTALL | re.MULTILINE)
_TABLE = re.compile(r"<table>.*?</table>", re.DOTALL)
_WIDE = 6
"""Columns from which on a phone shows each row of a table as a list."""


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Put the pages that are made into the navigation, each after the page that lists them."""
    made = {"cli/index.md": [f"cli/{name}.md" for name in commands()]}

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
    files.append(
        File.generated(config, "style.css", content=(ROOT / "docs/_site/style.css").read_text())
    )
    return files


def pages() -> dict[str, str]:
    """Every page that is made, and its Markdown."""
    return {page: (ROOT / path).read_text() for page, path in OUTSIDE.items()} | _cli()


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Turn links to files that have a page here into links to it, and `docs/…` in text into such
    links; fill in the tables of results.

    Links to other files outside docs/ become their path, behind the text that it does not repeat.
    """
    from nnpp_edge.benchmarks import results

    markdown = results.filled(markdown, json.loads((ROOT / results.STORED).read_text()))
    here = page.file.src_uri
    up = "../" * here.count("/")
    page_of = {path: name for name, path in OUTSIDE.items()}
    written_in = Path(OUTSIDE.get(here, f"docs/{here}")).parent

    def linked(match: re.Match[str]) -> str:
        text = match[1]
        target = match[2]
        anchor = match[3] or ""
        path = os.path.normpath(written_in / target)
        if path in page_of or path.startswith("docs/"):
            return f"[{text}]({up}{page_of.get(path) or path.removeprefix('docs/')}{anchor})"
        return f"`{path}`" if path.endswith(text.strip("`")) else f"{text} (`{path}`)"

    def named(match: re.Match[str]) -> str:
        return (
            f"[{match[0].strip('`')}]({up}{match[1]})"
            if files.get_file_from_path(match[1])
            else match[0]
        )

    parts = _FENCED.split(markdown)  # text, code, text, …
    for at in range(0, len(parts), 2):
        text = re.sub(r"\[([^\]]+)\]\((?!http|#)([^)#\s]+)(#[^)\s]*)?\)", linked, parts[at])
        parts[at] = re.sub(r"(?<!\[)`docs/([a-z/-]+\.md)`", named, text)
    return "".join(parts)


def on_page_content(html: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Give the cells of wide tables the heads of their columns, for phones (`style.css`)."""

    def labelled(table: re.Match[str]) -> str:
        heads = re.findall(r"<th[^>]*>(.*?)</th>", table[0], re.DOTALL)
        if len(heads) < _WIDE:
            return table[0]
        names = cycle(escape(re.sub("<[^>]*>", "", head)) for head in heads)
        cells = re.sub("<td", lambda _: f'<td data-head="{next(names)}"', table[0])
        return cells.replace("<table>", "<table data-wide>")

    return _TABLE.sub(labelled, html)


def on_post_build(config: MkDocsConfig) -> None:
    """Fail where a page would ask another host for something."""
    for path in Path(config.site_dir).rglob("*.html"):
        for tag in _LOADED.findall(path.read_text()):
            if (
                re.search(r"""\b(src|href|srcset)=["']?(https?:)?//""", tag)
                and "canonical" not in tag
            ):
                raise SystemExit(f"{path}: wanted nothing from other hosts, got {tag}")


def commands() -> dict[str, click.Command]:
    """Every command, by its name."""
    from nnpp_edge.cli.main import cli

    context = click.Context(cli)
    found = {name: cli.get_command(context, name) for name in cli.list_commands(context)}
    return {name: command for name, command in found.items() if command is not None}


def _cli() -> dict[str, str]:
    rows = list[str]()
    made = {}
    for name, command in commands().items():
        rows.append(f"| [nnpp-edge {name}]({name}.md) | {command.get_short_help_str(200)} |")
        text = (
            f"---\ntitle: {name}\n---\n\n# nnpp-edge "
            f"{name}\n\n{_help(f'nnpp-edge {name}', command)}"
        )
        for inner, each in getattr(command, "commands", {}).items():
            text += f"\n## nnpp-edge {name} {inner}\n\n{_help(f'nnpp-edge {name} {inner}', each)}"
        made[f"cli/{name}.md"] = text
    last = (
        "\nExit codes: 0 done; 1 no path, or a budget missed; 2 wrong use or bad input; 3 too "
        "noisy to tell."
    )
    head = ["# Commands\n", "| command | what it does |", "| --- | --- |"]
    return made | {"cli/index.md": "\n".join([*head, *rows, last])}


def _help(called: str, command: click.Command) -> str:
    context = click.Context(command, info_name=called, terminal_width=100, max_content_width=100)
    return f"```text\n{command.get_help(context)}\n```\n"
