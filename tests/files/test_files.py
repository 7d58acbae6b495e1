"""Files are written whole or not at all."""

import json
import os
import stat

import numpy as np
import pytest

from warp_peri.files.whole import whole_file, write_json, write_text


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
