"""Files of strangers, given to everything that another library parses: nothing of them runs.

Nor is anything read that nobody named: another crystal's files lie in the working directory.
"""

import bz2
import gzip
import io
import itertools
import lzma
import pickle
import shutil
import sys
import tracemalloc
from pathlib import Path

import h5py
import meshio
import numpy as np
import pytest

import warp_peri as wp
from warp_peri import InputError
from warp_peri.atoms.dumps import dump_frames
from warp_peri.cli.inputs import atom_forces, shape_of
from warp_peri.cli.learn import read_structure
from warp_peri.cli.main import main

EXAMPLES = Path(__file__).parent.parent.parent / "examples" / "phonopy"
MARK = "PWNED"


class Bomb:
    """What a pickle makes when it is read."""

    def __reduce__(self):
        return Path.touch, (Path(MARK),)


def archive(**arrays):
    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


TAGS = [
    f"!!python/object/apply:pathlib.Path.touch [!!python/object/apply:pathlib.Path [{MARK}]]",
    f"!!python/object/apply:os.system ['touch {MARK}']",
    f"a: [1, !!python/object/new:os.system [touch {MARK}]]",
    f"%TAG ! tag:yaml.org,2002:python/\n---\n!object/apply:os.system ['touch {MARK}']",
    "a: !!python/name:os.system",
]
ENTITY = '<?xml version="1.0"?><!DOCTYPE a [<!ENTITY e "x">]><VTKFile type="UnstructuredGrid"/>'
HOSTILE = {
    **{f"tag {n}": text.encode() for n, text in enumerate(TAGS)},
    **{f"tag {n} in UTF-16": text.encode("utf-16") for n, text in enumerate(TAGS)},
    "anchors": b"a: &a [1]\nb: [*a, *a]",
    "brackets": b"[" * 100_000,
    "pickle": pickle.dumps(Bomb()),
    "pickle in an archive": archive(a=np.array([Bomb()], dtype=object)),
    "entity": ENTITY.encode(),
    "entity in UTF-16": ENTITY.encode("utf-16"),
    "nothing": b"",
}
PACKERS = {"": bytes, ".gz": gzip.compress, ".bz2": bz2.compress, ".xz": lzma.compress}
PARSERS = {
    "phonopy.yaml": wp.atoms.from_phonopy,
    "any.yml": wp.atoms.from_phonopy,
    "phonopy_disp.yaml of a folder": lambda path: wp.atoms.from_phonopy(path.parent),
    "a.cif": read_structure,
    "vasprun.xml": read_structure,
    "a.traj": read_structure,
    "a.cell": read_structure,
    "a.json": read_structure,
    "a.db": read_structure,
    "trajectory.traj": lambda path: [*dump_frames(path)],
    "a.xyz": lambda path: [*dump_frames(path)],
    "a.dump": lambda path: [*dump_frames(path)],
    "a.msh": wp.load,
    "a.inp": wp.load,
    "a.vtk": wp.load,
    "a.vtu": wp.load,
    "a.xdmf": wp.load,
    "data.h5": wp.load,
    "model.json": wp.load,
    "fields.mat": wp.atoms.read_fields,
    "force.npz": lambda path: atom_forces(path, 1),
    "force.csv": lambda path: atom_forces(path, 1),
    "K.csv": lambda path: shape_of(str(path), 2.0, 1.0, "Å"),
}


@pytest.fixture
def deep():
    """Python's limit of recursion as symfc sets it, where nested brackets end the process."""
    before = sys.getrecursionlimit()
    sys.setrecursionlimit(100_000)
    yield
    sys.setrecursionlimit(before)


@pytest.mark.filterwarnings("ignore")  # parsers leave files open
@pytest.mark.parametrize("name", PARSERS)
def test_no_file_runs_or_passes(name, deep, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    packers = itertools.cycle([*PACKERS.items()][1:])
    for n, content in enumerate(HOSTILE.values()):
        for ending, packed in (("", bytes), next(packers)):
            path = tmp_path / f"{n}{ending}" / (name.split()[0] + ending)
            path.parent.mkdir()
            path.write_bytes(packed(content))
            with pytest.raises(InputError):
                PARSERS[name](path)
    assert not [*tmp_path.rglob(MARK)]


@pytest.mark.parametrize("ending", PACKERS)
@pytest.mark.parametrize("tag", range(len(TAGS)))
def test_the_command_runs_no_file(tag, ending, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / f"phonopy.yaml{ending}"
    path.write_bytes(PACKERS[ending](TAGS[tag].encode()))
    assert main(["learn", str(path), "--out", "o"]) == 2
    assert "without tags and anchors" in capsys.readouterr().err
    assert not (tmp_path / MARK).exists()


@pytest.mark.parametrize("ending", [".gz", ".bz2", ".xz"])
@pytest.mark.parametrize("name", ["phonopy.yaml", "a.cif", "force.csv", "a.vtu", "K.csv"])
def test_what_unpacks_to_more_than_is_read_is_refused(name, ending, tmp_path, monkeypatch):
    monkeypatch.setattr("warp_peri.files.foreign.LARGEST", 10**5)
    path = tmp_path / (name + ending * (not name.endswith((".vtu", "K.csv"))))
    path.write_bytes(PACKERS[ending](bytes(3 * 10**7)))
    tracemalloc.start()
    with pytest.raises(InputError, match="expected at most 100000 bytes, unpacked too, got more"):
        PARSERS[name](path)
    assert tracemalloc.get_traced_memory()[1] < 2e7
    tracemalloc.stop()


def test_settings_are_of_a_file_that_ends(capsys, monkeypatch):
    monkeypatch.setattr("warp_peri.files.foreign.LARGEST", 10**5)
    assert main(["learn", "--config", "/dev/zero"]) == 2
    assert "expected at most 100000 bytes" in capsys.readouterr().err


@pytest.mark.parametrize("place", ["/etc/passwd", "../secret.h5", "nowhere.h5", "secret.h5"])
def test_a_mesh_names_no_file_elsewhere(place, tmp_path):
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
    folder = tmp_path / "in"
    folder.mkdir()
    triangles = [("triangle", np.array([[0, 1, 2], [0, 2, 3]]))]
    meshio.write(folder / "m.xdmf", meshio.Mesh(square, triangles))
    assert len(wp.load(folder / "m.xdmf").x) == 4
    shutil.copy(folder / "m.h5", tmp_path / "secret.h5")
    with h5py.File(folder / "secret.h5", "w") as file:
        for name in ("data0", "data1"):
            file[name] = h5py.ExternalLink("../secret.h5", name)
    text = (folder / "m.xdmf").read_text()
    (folder / "m.xdmf").write_text(text.replace("m.h5", place))
    with pytest.raises(InputError, match=r"HDF5 beside it|in the file itself, got a link"):
        wp.load(folder / "m.xdmf")


@pytest.mark.parametrize("claims", [(10**14,), (10**7, 3, 3)])
def test_force_constants_claim_no_memory(claims, tmp_path):
    shutil.copy(EXAMPLES / "copper" / "phonopy_disp.yaml", tmp_path)
    with h5py.File(tmp_path / "force_constants.hdf5", "w") as file:
        file.create_dataset("force_constants", claims, "f8", chunks=True)
    with pytest.raises(InputError, match="expected arrays of at most"):
        wp.atoms.from_phonopy(tmp_path)


@pytest.fixture
def elsewhere(tmp_path, monkeypatch):
    """A working directory with everything that phonopy looks for, of magnesium oxide."""
    phonopy = pytest.importorskip("phonopy")
    file_io = pytest.importorskip("phonopy.file_IO")
    folder = tmp_path / "elsewhere"
    shutil.copytree(EXAMPLES / "magnesia", folder)
    known = phonopy.load(
        folder / "phonopy_disp.yaml",
        force_sets_filename=folder / "FORCE_SETS",
        born_filename=folder / "BORN",
        is_compact_fc=False,
    )
    file_io.write_FORCE_CONSTANTS(7 * known.force_constants, folder / "FORCE_CONSTANTS")
    with h5py.File(folder / "force_constants.hdf5", "w") as file:
        file["force_constants"] = 7 * known.force_constants
    monkeypatch.chdir(folder)
    return folder


@pytest.mark.filterwarnings("ignore:.* no BORN is there")
@pytest.mark.parametrize("crystal", ["copper", "magnesia"])
def test_nothing_of_the_working_directory_is_read(crystal, elsewhere, tmp_path):
    """The other files there would fit, in size too; a folder without forces has none."""
    folder = tmp_path / "mine"
    folder.mkdir()
    shutil.copy(EXAMPLES / crystal / "phonopy_disp.yaml", folder)
    with pytest.raises(InputError, match="expected FORCE_CONSTANTS or FORCE_SETS beside it"):
        wp.atoms.from_phonopy(folder)
    shutil.copy(EXAMPLES / crystal / "FORCE_SETS", folder)
    found = wp.atoms.from_phonopy(folder)
    assert found.polar is None
    there = {path.name for path in elsewhere.iterdir()}
    for name in ("FORCE_SETS", "FORCE_CONSTANTS", "force_constants.hdf5", "BORN"):
        (elsewhere / name).unlink()
    wanted = wp.atoms.from_phonopy(folder)
    assert there - {path.name for path in elsewhere.iterdir()}
    for mine, yours in zip(vars(found).values(), vars(wanted).values()):
        if isinstance(mine, np.ndarray):
            np.testing.assert_array_equal(mine, yours)
