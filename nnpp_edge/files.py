"""Writing files whole or not at all, and never over what is read."""

import errno
import os
import stat
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import IO

from nnpp_edge.runtime.errors import OutputError
from nnpp_edge.runtime.reading import reason, refused_as

Content = bytes | memoryview
_made: list[Path] = []
"""Folders that `make_folder` has made, each after the one that holds it."""


def write_whole(path: Path, content: Content) -> None:
    """Write one file, as `write_all`."""
    write_all({path: content})


def write_all(contents: Mapping[Path, Content]) -> None:
    """Put each content at its path: all or none, by way of temporary files beside them and then
    renames.

    A reader finds the old file or the whole new one. Links are followed. OutputError where one
    could not be written, or is no plain file.
    """
    waiting: list[tuple[Path, Path]] = []
    path = Path()
    try:
        for path, content in contents.items():
            _is_there(path)
            temporary, target = _beside(path)
            waiting.append((temporary, target))
            with temporary.open("xb") as file:
                file.write(content)
        for temporary, path in waiting:
            temporary.replace(path)
    except (OSError, ValueError) as error:
        why = "no such folder" if isinstance(error, FileNotFoundError) else reason(error)
        raise OutputError(f"{path}: could not be written ({why})") from error
    finally:
        for temporary, _ in waiting:
            with suppress(OSError):  # it has been renamed, or its folder is none
                temporary.unlink()


def open_new(path: Path, buffering: int = -1) -> IO[bytes]:
    """A file to write to that was not there: ``log-2.mcap`` where there is a ``log.mcap``, and so
    on. OSError where it cannot be made.
    """
    new = path
    number = 1
    while True:
        try:
            return new.open("wb" if new.is_char_device() else "xb", buffering)
        except FileExistsError:
            number += 1
            new = path.with_name(f"{path.stem}-{number}{path.suffix}")


def check_outputs(
    outputs: Sequence[tuple[str, Path | None]],
    inputs: Iterable[Path],
    *,
    make_folders: bool = False,
) -> None:
    """Check, before any work, that outputs can be written and replace nothing that is read;
    OutputError.

    Outputs are the option that asks for each, and the file, None where none was asked for; inputs
    are files, and folders of files, that need not be there. With `make_folders` the outputs'
    folders are made."""
    wanted = [(name, path) for name, path in outputs if path is not None]
    read = [os.path.realpath(path) for path in inputs if "\0" not in str(path)]
    places: dict[str, str] = {}
    for name, path in wanted:
        with refused_as(OutputError, f"{name} {path}: could not be written"):
            is_there = _is_there(path)
        place = os.path.realpath(path)
        for each in read:
            if place == each or (is_there and place.startswith(each + os.sep)):
                raise OutputError(f"{name} would replace {path}, which is read: give another name")
        other = places.setdefault(place, name)
        if other != name:
            raise OutputError(f"{name} and {other} name the same file, {path}: give another name")
    for folder in {path.parent for _, path in wanted}:
        if make_folders:
            make_folder(folder)
        elif not folder.is_dir():
            raise OutputError(f"{folder}: could not be written to (no such folder)")


def make_folder(path: Path) -> None:
    """Make a folder for results, and its parents; OutputError if that or writing there fails."""
    with refused_as(OutputError, f"{path}: wanted a folder to write to"):
        new = [each for each in (path, *path.parents) if not each.exists()]
        path.mkdir(parents=True, exist_ok=True)
        _made.extend(reversed(new))
        tempfile.TemporaryFile(dir=path).close()


def remove_empty_folders() -> None:
    """Remove the folders that `make_folder` has made and in which nothing was written."""
    while _made:
        with suppress(OSError):  # it holds something, or is gone
            _made.pop().rmdir()


def _beside(path: Path) -> tuple[Path, Path]:
    """A new name beside the file that a path leads to, and that file."""
    target = Path(os.path.realpath(path))
    return target.with_name(f".{target.name[:40]}.{os.urandom(4).hex()}"), target


def _is_there(path: Path) -> bool:
    """Whether a file is at a path; OSError for what is not to be replaced: folders, devices, pipes,
    sockets.
    """
    try:
        mode = path.stat().st_mode
    except (FileNotFoundError, NotADirectoryError):
        return False
    if not stat.S_ISREG(mode):
        what = "a folder" if stat.S_ISDIR(mode) else "no plain file"
        raise OSError(errno.EINVAL, f"it is {what}")
    return True
