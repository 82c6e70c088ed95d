"""Writing files whole or not at all, and never over what is read."""

import errno
import os
import secrets
import signal
import stat
import sys
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NoReturn

from nnpp_edge.runtime.errors import NnppEdgeError, OutputError
from nnpp_edge.runtime.reading import reason

Content = bytes | memoryview


def write_whole(path: Path, content: Content) -> None:
    """Put `content` at `path`; as `write_all` for one file."""
    write_all({path: content})


def write_all(contents: Mapping[Path, Content]) -> None:
    """Put each content at its path: all or none, by way of temporary files beside them and then renames.

    A reader finds the old file or the whole new one. Links are followed. A character device, and what stdout or
    stderr goes to, is written to and stays what it is. OutputError where one could not be written, or is a folder, a
    pipe, a socket or a disk.
    """
    staged: list[tuple[Path, Path]] = []
    streams: list[tuple[Path, Content]] = []
    path = Path()
    try:
        for path, content in contents.items():
            if _is_stream(_stands(path)):
                streams.append((path, content))
                continue
            staged.append(_beside(path))
            with staged[-1][0].open("xb") as file:
                file.write(content)
        for path, content in streams:
            _write_in_place(path, content)
        for temporary, path in staged:
            temporary.replace(path)
    except (OSError, ValueError) as error:
        why = "no such folder" if isinstance(error, FileNotFoundError) else reason(error)
        raise OutputError(f"{path}: could not be written ({why})") from error
    finally:
        for temporary, _ in staged:
            with suppress(OSError):  # its folder may be none
                temporary.unlink()


@contextmanager
def staged(path: Path) -> Iterator[Path]:
    """A temporary file's name beside `path`, for what is written as a stream: renamed at the end, or removed.

    For the main thread: SIGTERM is an error here, and ends the process. OutputError as of `write_all`.
    """

    def end(number: int, frame: object) -> NoReturn:
        raise SystemExit(128 + number)

    temporary, target = _beside(path)
    before = signal.signal(signal.SIGTERM, end)
    try:
        if _is_stream(_stands(path)):
            raise OSError(errno.EINVAL, "it is no plain file")
        yield temporary
        temporary.replace(target)
    except (OSError, ValueError) as error:
        if isinstance(error, NnppEdgeError):
            raise
        raise OutputError(f"{path}: could not be written ({reason(error)})") from error
    finally:
        signal.signal(signal.SIGTERM, before)
        with suppress(OSError):
            temporary.unlink()


def check_outputs(
    outputs: Sequence[tuple[str, Path | None]], inputs: Iterable[Path], *, make_folders: bool = False
) -> None:
    """OutputError, before any work, for outputs that could not be written or would replace what is read.

    Outputs are the option that asks for each, and the file, None where none was asked for; inputs are files, and
    folders of files, that need not be there. With `make_folders` the outputs' folders are made.
    """
    wanted = [(name, path) for name, path in outputs if path is not None]
    read = [os.path.realpath(path) for path in inputs if "\0" not in str(path)]
    places: dict[str, str] = {}
    for name, path in wanted:
        try:
            stands = _stands(path)
        except (OSError, ValueError) as error:
            raise OutputError(f"{name} {path}: could not be written ({reason(error)})") from error
        if _is_stream(stands):
            continue
        place = os.path.realpath(path)
        if any(_same(place, each) or (stands and place.startswith(each + os.sep)) for each in read):
            raise OutputError(f"{name} would replace {path}, which is read: give another name")
        if (other := places.setdefault(place, name)) != name:
            raise OutputError(f"{name} and {other} name the same file, {path}: give another name")
    for folder in {path.parent for _, path in wanted}:
        if make_folders:
            make_folder(folder)
        elif not folder.is_dir():
            raise OutputError(f"{folder}: could not be written to (no such folder)")


def make_folder(path: Path) -> None:
    """Make a folder for results, and its parents; OutputError if it cannot be made or written to."""
    try:
        path.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=path).close()
    except (OSError, ValueError) as error:
        raise OutputError(f"{path}: wanted a folder to write to ({reason(error)})") from error


@contextmanager
def temporary_folder() -> Iterator[Path]:
    """A folder that is gone afterwards; OutputError where there is room for none, or for what is put into it."""
    try:
        with tempfile.TemporaryDirectory() as folder:
            yield Path(folder)
    except NnppEdgeError:
        raise
    except OSError as error:
        raise OutputError(f"temporary files could not be written, set TMPDIR ({reason(error)})") from error


def _beside(path: Path) -> tuple[Path, Path]:
    """A new name beside the file that a path leads to, and that file."""
    target = Path(os.path.realpath(path))
    return target.with_name(f".{target.name[:40]}.{secrets.token_hex(4)}"), target


def _stands(path: Path) -> os.stat_result | None:
    """The kind of file at a path; OSError for what is neither to be replaced nor to be written to."""
    try:
        found = path.stat()
    except (FileNotFoundError, NotADirectoryError):
        return None
    kinds = {stat.S_ISDIR: "a folder", stat.S_ISFIFO: "a pipe", stat.S_ISSOCK: "a socket", stat.S_ISBLK: "a disk"}
    for is_kind, kind in kinds.items():
        if is_kind(found.st_mode) and _own(found) is None:
            raise OSError(errno.EINVAL, f"it is {kind}")
    return found


def _is_stream(found: os.stat_result | None) -> bool:
    """Whether it is written to as it is: a device, or our own stdout or stderr."""
    return found is not None and (stat.S_ISCHR(found.st_mode) or _own(found) is not None)


def _own(found: os.stat_result) -> int | None:
    """The descriptor, 1 or 2, of our own stream that goes to this file or pipe."""
    for descriptor in (1, 2) if not stat.S_ISCHR(found.st_mode) else ():
        try:
            if os.path.samestat(found, os.fstat(descriptor)):
                return descriptor
        except OSError:  # it is closed
            continue
    return None


def _write_in_place(path: Path, content: Content) -> None:
    """Write to a device, or to where one of our streams goes, after what the stream holds."""
    sys.stdout.flush()
    own = _own(path.stat())
    with open(path if own is None else own, "wb", buffering=0, closefd=own is None) as stream:
        rest = memoryview(content)
        while rest:
            rest = rest[stream.write(rest) :]


def _same(one: str, other: str) -> bool:
    """Whether two resolved paths lead to one file, also by hard links."""
    try:
        return one == other or Path(one).samefile(other)
    except OSError:
        return one == other
