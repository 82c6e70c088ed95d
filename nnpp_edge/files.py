"""Writing files whole or not at all."""

import secrets
from pathlib import Path

from nnpp_edge.runtime.errors import OutputError


def write_whole(path: Path, content: bytes | memoryview) -> None:
    """Put `content` at `path` by way of a temporary file beside it, then a rename.

    A reader finds the old file or the whole new one.

    Raises
    ------
    OutputError
        It could not be written; what stood there is untouched.
    """
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(4)}")
    try:
        try:
            with temporary.open("xb") as file:
                file.write(content)
            temporary.replace(path)
        finally:
            temporary.unlink(missing_ok=True)
    except OSError as error:
        raise OutputError(f"{path}: could not be written ({_reason(error)})") from error


def make_folder(path: Path) -> None:
    """Make a folder for results, and its parents; OutputError if it cannot be made or written to."""
    try:
        path.mkdir(parents=True, exist_ok=True)
        probe = path / f".{secrets.token_hex(4)}"
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise OutputError(f"{path}: wanted a folder to write to ({_reason(error)})") from error


def _reason(error: OSError) -> str:
    """What went wrong, in one line and without the temporary file's name."""
    return " ".join((error.strerror or str(error)).split())
