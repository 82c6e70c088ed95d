"""What a user names is read with a limit, and whatever is wrong with it is one line."""

import errno
import os
import tomllib
from pathlib import Path

import pytest

from nnpp_edge.profiling.compare import read_report
from nnpp_edge.profiling.profile_file import ProfileError, read_profile
from nnpp_edge.runtime.errors import InvalidQueryError, ModelError, TerrainError
from nnpp_edge.runtime.network.model_file import model_path
from nnpp_edge.runtime.reading import parse, problem_with_file, read_text, reason
from nnpp_edge.terrain.dem import read_dem

ODD = {
    "loop": "symbolic links",
    "x" * 300: "too long",
    "zero\0byte": "null",
    "pipe": "not a regular file",
    "/dev/zero": "not a regular file",
    ".": "a folder",
    "none": "no such file",
}


@pytest.fixture(params=ODD)
def odd(request, tmp_path):
    """A path that no file can be read from, and words on why."""
    (tmp_path / "loop").symlink_to("loop")
    os.mkfifo(tmp_path / "pipe")
    return tmp_path / request.param, ODD[request.param]


def test_no_kind_of_path_makes_a_reader_wait_or_fail_with_anything_but_one_line(odd):
    path, words = odd
    assert words in problem_with_file(path)
    with pytest.raises((OSError, ValueError)):
        read_text(path)
    for read, kind in (
        (read_dem, TerrainError),
        (model_path, ModelError),
        (read_profile, ProfileError),
        (read_report, InvalidQueryError),
    ):
        with pytest.raises(kind) as caught:
            read(path)
        assert "\n" not in str(caught.value)


def test_a_folder_that_may_not_be_entered_is_told(tmp_path, monkeypatch):
    """Root may enter all of them."""

    def guarded(find):
        def forbidding(path, *given, **options):
            if "secret" in str(path):
                raise PermissionError(errno.EACCES, "Permission denied")
            return find(path, *given, **options)

        return forbidding

    monkeypatch.setattr(os, "stat", guarded(os.stat))
    monkeypatch.setattr(Path, "stat", guarded(Path.stat))
    for read, kind in (
        (read_dem, TerrainError),
        (model_path, ModelError),
        (read_profile, ProfileError),
    ):
        with pytest.raises(kind, match="Permission denied"):
            read("secret/file")


def test_a_file_is_read_up_to_a_limit(tmp_path):
    (tmp_path / "file").write_text("ä" * 50)
    assert read_text(tmp_path / "file", 100) == "ä" * 50
    with pytest.raises(OSError, match="longer than 99 bytes"):
        read_text(tmp_path / "file", 99)


def test_what_is_sound_is_parsed_and_a_reason_is_short_however_much_of_a_file_it_quotes():
    assert parse("[1, [2]]") == [1, [2]]
    assert parse("a = 1", tomllib.loads) == {"a": 1}
    assert reason(ValueError(f"the header\n{b'x' * 70_000!r} differs")).startswith(
        "the header b'xxx"
    )
    assert len(reason(ValueError("x" * 70_000))) < 500


def test_a_damaged_profile_is_one_line(tmp_path):
    deep = b"a = " + b"[" * 100_000
    for content, words in ((deep, "too deep"), (b"title = '\xe4'", "utf-8"), (b"title = ", "TOML")):
        (tmp_path / "own.toml").write_bytes(content)
        with pytest.raises(ProfileError, match=words) as caught:
            read_profile(tmp_path / "own.toml")
        assert "\n" not in str(caught.value)
