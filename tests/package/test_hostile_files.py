"""Files of strangers, given to all that parses: nothing runs, is read besides, or takes memory."""

import bz2
import gzip
import io
import lzma
import os
import pickle
import sys
import tracemalloc
from itertools import cycle
from pathlib import Path
from shutil import copy

import h5py
import meshio
import numpy as np
import pytest

from tests.support import filterwarnings, parametrize, refused
from warp_peri import InputError, atoms, load
from warp_peri.atoms.dumps import iter_dump, read_structure
from warp_peri.cli.train import atom_forces
from warp_peri.files.atomic import check_xml, read_arrays
from warp_peri.points.dataset import load_dataset

MARK = "PWNED"


class Bomb:
    """What a pickle makes when it is read."""

    def __reduce__(self):
        return Path.touch, (Path(MARK),)


def archive(**arrays):
    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


TAGS = (
    f"!!python/object/apply:pathlib.Path.touch [!!python/object/apply:pathlib.Path [{MARK}]]",
    f"a: [1, !!python/object/new:os.system [touch {MARK}]]",
    f"%TAG ! tag:yaml.org,2002:python/\n---\n!object/apply:os.system ['touch {MARK}']",
    "a: !!python/name:os.system",
)
ENTITY = '<?xml version="1.0"?><!DOCTYPE a [<!ENTITY e "x">]><VTKFile type="UnstructuredGrid"/>'
HOSTILE = [
    *(text.encode(code) for text in (*TAGS, ENTITY) for code in ("utf-8", "utf-16")),
    b"anchors: &a [1]\nb: [*a, *a]", b"[" * 100_000, pickle.dumps(Bomb()), b"",
    archive(a=np.array([Bomb()], dtype=object)), archive(a=np.ones(300))[:-900],
]  # fmt: skip
PACKERS = {".gz": gzip.compress, ".bz2": bz2.compress, ".xz": lzma.compress}
DUMPS, MESHES = ("a.traj", "a.xyz", "a.dump"), ("a.msh", "a.inp", "a.vtk", "a.vtu", "a.xdmf")
CRYSTALS = ("a.cif", "vasprun.xml", "a.traj", "a.cell", "a.json", "a.db")
PARSERS = [
    *(("phonopy.yaml", atoms.from_phonopy), ("any.yml", atoms.from_phonopy)),
    ("phonopy_disp.yaml", lambda path: atoms.from_phonopy(path.parent)),
    *((name, read_structure) for name in CRYSTALS),
    *((name, lambda path: [*iter_dump(path)]) for name in DUMPS),
    *((name, load) for name in (*MESHES, "data.h5", "model.json")),
    ("set.h5", load_dataset),
    *(("fields.mat", atoms.read_mat), ("a.npz", read_arrays)),
    *((name, lambda path: atom_forces(path, 1)) for name in ("force.npz", "force.csv")),
]


@pytest.fixture
def deep():
    """Python's limit of recursion as symfc sets it, where nested brackets end the process."""
    before = sys.getrecursionlimit()
    sys.setrecursionlimit(100_000)
    yield
    sys.setrecursionlimit(before)


@filterwarnings("ignore")  # parsers leave files open
@parametrize(("name", "parse"), PARSERS)
def test_no_file_runs_or_passes(name, parse, deep, here):
    """Nor a pipe, which would be waited for."""
    packers = cycle(PACKERS.items())
    error = ValueError if parse is read_arrays else InputError
    for n, content in enumerate(HOSTILE):
        for ending, packed in (("", bytes), next(packers)):
            path = here / f"{n}{ending}" / (name + ending)
            path.parent.mkdir()
            path.write_bytes(packed(content))
            with pytest.raises(error):
                parse(path)
    (here / "pipe").mkdir()
    os.mkfifo(here / "pipe" / name)
    with pytest.raises(error):
        parse(here / "pipe" / name)
    assert not [*here.rglob(MARK)]


def test_a_document_type_is_found_behind_what_is_no_xml():
    with refused("without a document type"):
        check_xml("a.vtu", b"<!-- -- -->" + ENTITY.encode())


@parametrize("name", ["phonopy.yaml", "a.cif", "force.csv", "a.vtu"])
def test_what_unpacks_to_more_than_is_read_is_refused(name, tmp_path, monkeypatch):
    monkeypatch.setattr("warp_peri.files.atomic.LARGEST", 10**5)
    path = tmp_path / (name + ".xz" * (name != "a.vtu"))
    path.write_bytes(lzma.compress(bytes(3 * 10**7)))
    tracemalloc.start()
    with refused("expected at most 100000 bytes, unpacked too, got more"):
        dict(PARSERS)[name](path)
    assert tracemalloc.get_traced_memory()[1] < 2e7
    tracemalloc.stop()


MANY = "99_999_999_999"
YAML = "points:\n- symbol: Al\n  coordinates: [ {}, 0.0, 0.0 ]\n"
CLAIMS = [
    *(("phonopy.yaml", YAML.format(x), "finite numbers") for x in (".nan", "-.INF", "1e999")),
    ("a.xyz", "1000000000000\n\nH 0 0 0\n", "cannot be read"),
    ("a.xyz", "1\nProperties=species:S:1:pos:R:1000000000\nH 0 0 0\n", "cannot be read"),
    ("a.xyz", "1\n\nH 0 0 0\n99999999999\n\n", "frame 2 cannot be read .*as it claims"),
    ("a.xyz", r"1|Properties=a:R:2\000000000|H".replace("|", "\n"), "as it claims"),
    ("a.dump", 10**6 * "\0", "cannot be read"),
    *((f"b.{end}", f"{MANY}\n\nH 0 0 0\n", "that are there") for end in ("xyz", "extxyz")),
    ("b.cfg", f"Number of particles = {MANY}\n", "that are there"),
    ("b.dump", f"ITEM: TIMESTEP\n0\nITEM: NUMBER OF ATOMS\n{MANY}\n element", "that are there"),
    ("b.data", f"xlo xhi\n{MANY} atoms\n\n Masses\n\nAtoms # atomic\n", "that are there"),
    ("POSCAR", f"Cu\n1\n4 0 0\n0 4 0\n0 0 4\n{MANY}\nDirect\n", "that are there"),
    ("b.restart", "&A", "one of aims, .*, got cp2k-restart; ase.io.read gives Atoms"),
    ("b.dat", "%block lock species \ninclude_file /etc/passwd\n", "got onetep-in"),
]


@parametrize(("name", "text", "words"), CLAIMS)
def test_numbers_that_are_none_and_atoms_that_are_only_claimed(name, text, words, tmp_path):
    (tmp_path / name).write_text(text)
    with refused(words):
        dict(PARSERS).get(name, read_structure)(tmp_path / name)


@parametrize("place", ["/etc/passwd", "../secret.h5", "nowhere.h5", "secret.h5"])
def test_a_mesh_names_no_file_elsewhere(place, tmp_path):
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
    folder = tmp_path / "in"
    folder.mkdir()
    triangles = [("triangle", np.array([[0, 1, 2], [0, 2, 3]]))]
    meshio.write(folder / "m.xdmf", meshio.Mesh(square, triangles))
    assert len(load(folder / "m.xdmf").x) == 4
    copy(folder / "m.h5", tmp_path / "secret.h5")
    with h5py.File(folder / "secret.h5", "w") as file:
        for name in ("data0", "data1"):
            file[name] = h5py.ExternalLink("../secret.h5", name)
    (folder / "m.xdmf").write_text((folder / "m.xdmf").read_text().replace("m.h5", place))
    with refused(r"HDF5 beside it|in the file itself, got a link"):
        load(folder / "m.xdmf")
