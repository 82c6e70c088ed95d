"""The files that `plan` and `reach` write into a folder, in formats that are asked for."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import click

from nnpp_edge.cli import options
from nnpp_edge.files import older_outputs
from nnpp_edge.runtime.errors import optional_module


class Format(NamedTuple):
    """What --format adds."""

    files: tuple[str, ...]
    module: str
    """That makes them."""
    extra: str
    """That brings it."""


def chosen(
    folder: Path | None,
    always: Sequence[str],
    formats: Mapping[str, Format],
    asked: Sequence[str],
    inputs: Iterable[Path],
) -> tuple[list[Path], list[Path]]:
    """The files to write, and those of an earlier run of the command that go, all checked before
    any work; none without a folder.

    The last of the names that are `always` written is the record that lists an earlier run's.
    Raises UsageError for a format without a folder, MissingExtraError for one whose module is not
    installed, OutputError as of `files.check_outputs`.
    """
    if folder is None:
        if asked:
            raise click.UsageError("--format needs -o")
        return [], []
    for name in asked:
        optional_module(formats[name].module, f"--format {name}", formats[name].extra)
    names = dict.fromkeys((*always, *(file for name in asked for file in formats[name].files)))
    paths = [folder / name for name in names]
    unasked = {name for each in formats.values() for name in each.files}.difference(names)
    older = [path for path in older_outputs(folder / always[-1]) if path.name in unasked]
    outputs = [("--output", path) for path in (*paths, *older)]
    options.check_outputs(*outputs, more_inputs=inputs, make_folders=True)
    return paths, older
