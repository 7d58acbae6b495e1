"""Files are written whole or not at all."""

import json
import os
import socket
import stat

import numpy as np
import pytest

from warp_peri.errors import InputError
from warp_peri.files.atomic import whole_file, write_json, write_text


def test_a_file_appears_under_its_name_with_common_rights(tmp_path):
    path = tmp_path / "new folder" / "a.txt"
    write_text(path, "β\n")
    assert path.read_text(encoding="utf-8") == "β\n"
    mask = os.umask(0)
    os.umask(mask)
    assert stat.S_IMODE(path.stat().st_mode) == 0o666 & ~mask
    assert list(path.parent.iterdir()) == [path]


def test_the_old_file_is_there_until_the_new_one_is_whole(tmp_path):
    path = tmp_path / "a.txt"
    write_text(path, "old")
    with whole_file(path) as temporary:
        temporary.write_text("new")
        assert path.read_text() == "old"
        assert temporary.parent == path.parent
    assert path.read_text() == "new"


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), KeyboardInterrupt()])
@pytest.mark.parametrize("exists", [True, False])
def test_a_failed_write_leaves_what_was_there(tmp_path, error, exists):
    path = tmp_path / "a.txt"
    if exists:
        path.write_text("old")

    def write():
        with whole_file(path) as temporary:
            temporary.write_text("half of it")
            raise error

    with pytest.raises(type(error)):
        write()
    assert [file.read_text() for file in tmp_path.iterdir()] == ["old"] * exists


def test_json_takes_numpy_and_refuses_what_is_no_number(tmp_path):
    path = tmp_path / "a.json"
    write_json(path, {"a": np.arange(3), "b": (np.float64(0.1), {"c": np.bool_(True)})})
    assert json.loads(path.read_text()) == {"a": [0, 1, 2], "b": [0.1, {"c": True}]}
    before = path.read_bytes()
    for bad in (np.nan, np.array([np.inf])):
        with pytest.raises(ValueError, match="JSON compliant"):
            write_json(path, {"a": bad})
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_a_link_stays_and_what_it_points_at_is_written(tmp_path):
    target, link, broken = tmp_path / "target.txt", tmp_path / "link.txt", tmp_path / "broken.txt"
    target.write_text("old")
    link.symlink_to(target)
    broken.symlink_to(tmp_path / "new" / "far.txt")
    write_text(link, "new")
    write_text(broken, "far")
    assert link.is_symlink()
    assert broken.is_symlink()
    assert target.read_text() == "new"
    assert (tmp_path / "new" / "far.txt").read_text() == "far"


def made(kind, path):
    """Something that is no regular file."""
    if kind == "folder":
        path.mkdir()
    elif kind == "pipe":
        os.mkfifo(path)
    elif kind == "socket":
        with socket.socket(socket.AF_UNIX) as listener:
            listener.bind(path.name)
    elif kind == "link to a device":
        path.symlink_to(os.devnull)
    else:
        path.symlink_to(path)
    return path


@pytest.mark.parametrize("kind", ["folder", "pipe", "socket", "link to a device", "circle"])
def test_what_is_no_regular_file_is_left_alone(tmp_path, monkeypatch, kind):
    monkeypatch.chdir(tmp_path)  # names of sockets are short
    path = made(kind, tmp_path / "a")
    before = os.lstat(path)
    null = os.stat(os.devnull)
    with pytest.raises(InputError, match=r"a: (expected a file or a new name, got|cannot be)"):
        write_text(path, "text")
    assert os.lstat(path) == before
    assert stat.S_ISCHR(null.st_mode)
    assert os.stat(os.devnull).st_ino == null.st_ino
    assert list(tmp_path.iterdir()) == [path]
