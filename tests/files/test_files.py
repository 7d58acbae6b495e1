"""Files are written whole or not at all; units are those of the file."""

import json
import os
import stat

import numpy as np
import pytest

from tests.support import of_json, refused, warned
from warp_peri import load
from warp_peri.diffusion import DiffusionMaterial
from warp_peri.files.atomic import whole_file, write_json, write_text


def test_a_file_appears_whole_under_its_name_with_common_rights(tmp_path):
    path = tmp_path / "new folder" / "a.txt"
    write_text(path, "β\n")
    mask = os.umask(0)
    os.umask(mask)
    assert stat.S_IMODE(path.stat().st_mode) == 0o666 & ~mask
    with whole_file(path) as temporary:
        temporary.write_text("new")
        assert path.read_text(encoding="utf-8") == "β\n"
    assert path.read_text() == "new"
    assert list(path.parent.iterdir()) == [path]


def test_a_failed_write_leaves_what_was_there(tmp_path):
    path = tmp_path / "a.txt"

    def write(error):
        with whole_file(path) as temporary:
            temporary.write_text("half of it")
            raise error

    for exists in (False, True):
        for error in (OSError, KeyboardInterrupt):
            if exists:
                path.write_text("old")
            with pytest.raises(error):
                write(error)
            assert [file.read_text() for file in tmp_path.iterdir()] == ["old"] * exists


def test_json_takes_numpy_and_refuses_what_is_no_number(tmp_path):
    path = tmp_path / "a.json"
    write_json(path, {"a": np.arange(3), "b": (np.float64(0.1), {"c": np.bool_(True)})})
    assert of_json(path) == {"a": [0, 1, 2], "b": [0.1, {"c": True}]}
    with pytest.raises(ValueError, match="JSON compliant"):
        write_json(path, {"a": np.array([np.inf])})
    assert list(tmp_path.iterdir()) == [path]


def test_a_link_stays_and_what_is_no_regular_file_is_left_alone(tmp_path):
    link, pipe, device, folder, circle = (tmp_path / name for name in "lpdfc")
    link.symlink_to(tmp_path / "new" / "far.txt")
    write_text(link, "far")
    assert link.is_symlink()
    assert (tmp_path / "new" / "far.txt").read_text() == "far"
    os.mkfifo(pipe)
    device.symlink_to(os.devnull)
    folder.mkdir()
    circle.symlink_to(circle)
    for path in (pipe, device, folder, circle):
        before = os.lstat(path)
        with refused(r": (expected a file or a new name, got|cannot be)"):
            write_text(path, "text")
        assert os.lstat(path) == before
    assert stat.S_ISCHR(os.stat(os.devnull).st_mode)


def test_files_without_units_say_that_they_are_taken_for_granted(tmp_path):
    path = tmp_path / "kept.json"
    DiffusionMaterial(3.0, 2.0, 1.3, [1.0, 0.4], ("mm", "GPa")).save(path)
    content = of_json(path)
    bare = {key: value for key, value in content.items() if not key.endswith(("_unit", "sha256"))}
    path.write_text(json.dumps(bare))
    with warned(r"kept.json: it names no units: taken as Å and TPa"):
        found = load(path)
    assert found.units == ("angstrom", "TPa")
    path.write_text(json.dumps({**bare, "length_unit": "mm"}))
    with refused("stress_unit: expected one of"):
        load(path)
