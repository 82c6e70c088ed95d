"""Files are written whole or not at all, all or none, and never over what is read."""

import os
import socket

import pytest

from nnpp_edge.files import check_outputs, make_folder, write_all, write_whole
from nnpp_edge.runtime.errors import OutputError


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_of_several_files_all_are_written_or_none(tmp_path):
    (tmp_path / "old").write_bytes(b"old")
    (tmp_path / "folder").mkdir()
    with pytest.raises(OutputError, match=r"folder: could not be written \(it is a folder\)"):
        write_all({tmp_path / "old": b"new", tmp_path / "folder": b"any"})
    assert (tmp_path / "old").read_bytes() == b"old"
    assert names(tmp_path) == ["folder", "old"]
    write_all({tmp_path / "old": b"new", tmp_path / "more": b"more"})
    assert [(tmp_path / name).read_bytes() for name in ("old", "more")] == [b"new", b"more"]


def test_pipes_sockets_and_devices_are_neither_replaced_nor_waited_for(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "null").symlink_to("/dev/null")
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(tmp_path / "socket"))
    for kind in ("pipe", "socket", "null"):
        with pytest.raises(OutputError, match="it is no plain file"):
            write_whole(tmp_path / kind, b"any")
        assert not (tmp_path / kind).is_file()


def test_a_link_stays_a_link(tmp_path):
    (tmp_path / "file").write_bytes(b"old")
    (tmp_path / "link").symlink_to("file")
    write_whole(tmp_path / "link", b"new")
    assert (tmp_path / "link").is_symlink() and (tmp_path / "file").read_bytes() == b"new"


def test_a_name_as_long_as_names_may_be_is_written(tmp_path):
    write_whole(tmp_path / ("x" * 255), b"any")
    assert names(tmp_path) == ["x" * 255]


@pytest.mark.parametrize("name", ["x" * 256, "loop", "zero\0byte"])
def test_names_that_no_file_can_have_are_refused_in_one_line(tmp_path, name):
    (tmp_path / "loop").symlink_to("loop")
    for refused in (
        lambda: write_whole(tmp_path / name, b"any"),
        lambda: check_outputs([("--plot", tmp_path / name)], []),
        lambda: make_folder(tmp_path / name),
    ):
        with pytest.raises(OutputError) as caught:
            refused()
        assert "\n" not in str(caught.value)


def test_an_output_that_is_an_input_is_refused_by_any_of_its_names(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    dem = tmp_path / "dem.npz"
    dem.write_bytes(b"heights")
    (tmp_path / "link").symlink_to(dem)
    (tmp_path / "set").mkdir()
    (tmp_path / "set" / "shard").write_bytes(b"samples")
    for output in ("dem.npz", "./set/../dem.npz", "link", "set/shard"):
        with pytest.raises(OutputError, match="--plot would replace"):
            check_outputs([("--plot", tmp_path / output)], [dem, tmp_path / "set"])
    with pytest.raises(OutputError, match="--html and --json name the same file"):
        check_outputs([("--json", tmp_path / "a"), ("--html", tmp_path / "set" / ".." / "a")], [])
    check_outputs([("--plot", tmp_path / "set" / "new"), ("--json", None)], [dem, tmp_path / "set"])


def test_the_folder_of_an_output_is_there_or_made(tmp_path):
    with pytest.raises(OutputError, match="could not be written"):
        check_outputs([("--plot", tmp_path / "none" / "a")], [])
    check_outputs([("--plot", tmp_path / "none" / "a")], [], make_folders=True)
    assert (tmp_path / "none").is_dir()
