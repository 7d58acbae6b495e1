"""Trajectories of other formats: packed, tilted, by ASE."""

import ctypes
import gzip

import ase
import ase.io
import numpy as np
import pytest

from warp_peri import InputError
from warp_peri.atoms.calculators import lammps_class
from warp_peri.atoms.dumps import dump_displacement, dump_frames

CELL = np.array([[12.0, 0, 0], [3.0, 9.0, 0], [0, 0, 10.0]])
random = np.random.default_rng(1)
PARTS = random.uniform(0, 1, size=(20, 3)) * (1, 1, 0)
REFERENCE = (PARTS @ CELL)[:, :2]
MOVED = 0.4 * random.normal(size=(20, 2))


@pytest.fixture(scope="module")
def dumps(tmp_path_factory):
    """One frame of a tilted box by LAMMPS itself: text, text by gzip and zstd."""
    folder = tmp_path_factory.mktemp("dumps")
    lammps = lammps_class()(cmdargs=["-log", "none", "-screen", "none", "-nocite"])
    for line in (
        "units metal",
        "atom_modify map array",
        "region cell prism 0 12 0 9 -5 5 3 0 0",
        "create_box 1 cell",
        "mass 1 12.0",
    ):
        lammps.command(line)
    x = np.column_stack([REFERENCE, np.zeros(20)])
    lammps.create_atoms(20, list(range(1, 21)), [1] * 20, x.ravel().tolist())
    lammps.command("pair_style zero 2.0")
    lammps.command("pair_coeff * *")
    lammps.command("run 0")
    x[:, :2] += MOVED
    lammps.scatter_atoms("x", 1, 3, x.ctypes.data_as(ctypes.POINTER(ctypes.c_double)))
    lammps.command("run 0")
    columns = "id type x y z ix iy iz"
    lammps.command(f"write_dump all custom {folder}/images.dump {columns} modify units yes")
    lammps.command(f"write_dump all custom {folder}/plain.dump id type x y z")
    lammps.close()
    text = (folder / "images.dump").read_bytes()
    (folder / "images.dump.gz").write_bytes(gzip.compress(text))
    zstandard = pytest.importorskip("zstandard")
    (folder / "images.zst").write_bytes(zstandard.compress(text))
    return folder


@pytest.mark.parametrize("name", ["images.dump", "images.dump.gz", "images.zst"])
def test_images_unwrap_a_tilted_box_and_a_line_says_so(dumps, name):
    with pytest.warns(UserWarning, match="unwrapped by the images"):
        u = dump_displacement(dumps / name, REFERENCE)
    np.testing.assert_allclose(u, MOVED, atol=1e-4)
    with pytest.warns(UserWarning, match="unwrapped"):
        frame = next(dump_frames(dumps / name))
    np.testing.assert_allclose(frame.cell, CELL, atol=1e-12)
    assert frame.box is None


def test_wrapped_atoms_of_a_tilted_box_without_images_are_refused(dumps):
    with pytest.raises(InputError, match="xu, yu, zu in a tilted box, got x; or x with the images"):
        next(dump_frames(dumps / "plain.dump"))


WRAPPED = (PARTS + np.column_stack([MOVED, np.zeros(20)]) @ np.linalg.inv(CELL)) // 1
"""Edges of the box by which atoms left it when they moved."""


def write_wrapped(path, fields, images=None):
    """Frames of a tilted box with its atoms inside, in a format that is not LAMMPS's."""
    frames = [np.column_stack([REFERENCE + u, np.zeros(20)]) for u in fields]
    atoms = [ase.Atoms("C20", positions=x, cell=CELL, pbc=True) for x in frames]
    for one, image in zip(atoms, [] if images is None else images):
        for name, column in zip(("ix", "iy", "iz"), image.T.astype(int)):
            one.arrays[name] = column
    ase.io.write(path, atoms)


@pytest.mark.parametrize("name", ["a.extxyz", "a.traj"])
def test_wrapped_atoms_of_a_tilted_box_are_never_taken_for_moved_ones(tmp_path, name):
    """Refused where nothing says where they were; by their images, the same as LAMMPS's own."""
    assert WRAPPED.any()
    across = MOVED - (WRAPPED @ CELL)[:, :2]
    write_wrapped(tmp_path / name, [across])
    with pytest.raises(InputError, match="beyond half the box; are they wrapped"):
        dump_displacement(tmp_path / name, REFERENCE)
    write_wrapped(tmp_path / name, [0 * MOVED, across])
    with pytest.raises(InputError, match="frame 2 .*jump by an edge of the tilted box"):
        list(dump_frames(tmp_path / name))
    if name != "a.traj":  # which has no columns but ASE's own
        write_wrapped(tmp_path / name, [0 * MOVED, across], [0 * WRAPPED, WRAPPED])
        with pytest.warns(UserWarning, match="unwrapped by the images"):
            found = dump_displacement(tmp_path / name, REFERENCE, skip=1)
        np.testing.assert_allclose(found, MOVED, atol=1e-7)
    write_wrapped(tmp_path / name, [0 * MOVED, MOVED])
    np.testing.assert_allclose(
        dump_displacement(tmp_path / name, REFERENCE, skip=1), MOVED, atol=1e-7
    )


@pytest.mark.parametrize("name", ["a.extxyz", "a.traj"])
def test_trajectories_of_ase(tmp_path, name):
    x = np.column_stack([REFERENCE, np.zeros(20)])
    frames = [ase.Atoms("B10N10", positions=x + step, cell=20 * np.eye(3)) for step in (0.0, 0.25)]
    ase.io.write(tmp_path / name, frames)
    np.testing.assert_allclose(dump_displacement(tmp_path / name, REFERENCE, skip=1), 0.25)
    assert list(next(dump_frames(tmp_path / name)).types) == 10 * [1] + 10 * [2]
