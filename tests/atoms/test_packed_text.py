"""Structures and dumps in the packings and encodings that people have."""

import bz2
import gzip
import lzma

import ase.build
import ase.io
import numpy as np
import pytest

from warp_peri.atoms.dumps import dump_frames
from warp_peri.cli.crystals_sheets import read_structure
from warp_peri.errors import InputError

AS = {
    "as it is": bytes,
    "bz2": bz2.compress,
    "gz": gzip.compress,
    "xz": lzma.compress,
    "UTF-16": lambda raw: raw.decode().encode("utf-16"),
    "UTF-8 with a mark": lambda raw: raw.decode().encode("utf-8-sig"),
}
PACKED = {"bz2": ".bz2", "gz": ".gz", "xz": ".xz"}
SALT = ase.build.bulk("NaCl", "rocksalt", a=5.6, cubic=True)


@pytest.mark.parametrize("way", AS)
@pytest.mark.parametrize(
    ("name", "form"),
    [("a.data", "lammps-data"), ("a.lmp", "lammps-data"), ("POSCAR", "vasp"), ("a.cif", "cif")],
)
def test_a_structure_is_read_whatever_it_is_packed_in(way, name, form, tmp_path):
    options = {"masses": True} if form == "lammps-data" else {}
    ase.io.write(tmp_path / name, SALT, format=form, **options)
    path = tmp_path / ("packed_" * (form != "vasp") + name + PACKED.get(way, ""))
    path.write_bytes(AS[way]((tmp_path / name).read_bytes()))
    found = read_structure(path)
    assert sorted(found.get_chemical_symbols()) == sorted(SALT.get_chemical_symbols())
    np.testing.assert_allclose(found.cell.lengths(), 5.6)


def test_types_without_masses_are_not_taken_for_elements(tmp_path):
    ase.io.write(tmp_path / "a.data", SALT, format="lammps-data")
    with pytest.raises(InputError, match=r"a\.data: expected the masses of the types"):
        read_structure(tmp_path / "a.data")


@pytest.mark.parametrize("way", AS)
def test_a_dump_is_read_whatever_it_is_packed_in(way, tmp_path):
    box = "ITEM: BOX BOUNDS pp pp pp\n0 4\n0 4\n0 4\n"
    text = f"ITEM: TIMESTEP\n0\nITEM: NUMBER OF ATOMS\n1\n{box}ITEM: ATOMS id x y z\n1 .5 1 2\n"
    (tmp_path / "dump").write_bytes(AS[way](text.encode()))
    (frame,) = dump_frames(tmp_path / "dump")
    np.testing.assert_array_equal(frame.x, [[0.5, 1.0]])
