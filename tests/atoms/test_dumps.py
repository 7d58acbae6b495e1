"""Trajectories: read by frames, packed, tilted, by ASE; reduced; refused when broken."""

import gzip

import ase
import ase.io
import numpy as np
import torch
import zstandard
from ase.build import bulk
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal

from tests.support import assert_refused, each_refused, parametrize, refused, warned
from tests.support.problems import lattice
from warp_peri import Points
from warp_peri.atoms import coarse_grain, dumps, smoothing_matrix
from warp_peri.atoms.dumps import ReferenceAtoms, coarse_grain_dumps, iter_dump, mean_displacement
from warp_peri.points.points import grid_places

BOX = (12.0, 9.0)
RANDOM = default_rng(0)
REFERENCE = RANDOM.uniform(0, 1, size=(30, 2)) * BOX
U = 0.2 * RANDOM.normal(size=(9, 30, 2))
GRAIN = {"node_area": 9.0, "thickness": 3.35}
SALT = bulk("NaCl", "rocksalt", a=5.6, cubic=True)
POINTS = lattice(2, 1.0, 3.0)
OMEGA = smoothing_matrix(REFERENCE, POINTS.x, radius=5.0, box=BOX, spacing=3.0)
CELL = np.array([[12.0, 0, 0], [3.0, 9.0, 0], [0, 0, 10.0]])
PARTS = RANDOM.uniform(0, 1, size=(20, 3)) * (1, 1, 0)
AT, MOVED = (PARTS @ CELL)[:, :2], 0.4 * RANDOM.normal(size=(20, 2))
EDGES = (PARTS + np.column_stack([MOVED, np.zeros(20)]) @ np.linalg.inv(CELL)) // 1
"""Of the box, by which atoms left it when they moved."""


def frame(x, step=0, columns="id type x y z", box=BOX):
    """A frame as LAMMPS writes it, its atoms in any order."""
    order = default_rng(step).permutation(len(x))
    lines = ["ITEM: TIMESTEP", f"{step}", "ITEM: NUMBER OF ATOMS", f"{len(x)}"]
    lines += ["ITEM: BOX BOUNDS pp pp pp", f"0 {box[0]}", f"0 {box[1]}", "-5 5"]
    lines.append(f"ITEM: ATOMS {columns}")
    lines += [f"{i + 1} 1 {x[i, 0]:.12f} {x[i, 1]:.12f} 0" for i in order]
    return "\n".join(lines) + "\n"


def write(path, steps):
    path.write_text("".join(frame((REFERENCE + U[s % 9]) % BOX, s) for s in steps))
    return path


def test_frames_and_structures_are_read_whatever_they_are_packed_in(tmp_path):
    """Units and time may precede a frame."""
    x, time = (REFERENCE + U[:2]) % BOX, "ITEM: TIME\n0.5\n"
    text = f"ITEM: UNITS\nmetal\n{time}{frame(x[0])}{time}{frame(x[1], 1)}"
    ase.io.write(tmp_path / "a.data", SALT, format="lammps-data", masses=True)
    ase.io.write(tmp_path / "a.cif", SALT)
    for way, packed in {
        "text": bytes, "gz": gzip.compress, "zst": zstandard.compress,
        "UTF-16": lambda raw: raw.decode().encode("utf-16"),
    }.items():  # fmt: skip
        (tmp_path / "a").write_bytes(packed(text.encode()))
        assert_allclose([one.x for one in iter_dump(tmp_path / "a")], x, atol=1e-9)
        for name in ("a.data", "a.cif") if way != "zst" else ():
            path = tmp_path / f"packed_{name}{'.gz' * (way == 'gz')}"
            path.write_bytes(packed((tmp_path / name).read_bytes()))
            assert sorted(dumps.read_structure(path).symbols) == sorted(SALT.symbols)
    ase.io.write(tmp_path / "bare.data", SALT, format="lammps-data")
    with refused(r"bare\.data: expected the masses of the types"):
        dumps.read_structure(tmp_path / "bare.data")
    (tmp_path / "a").write_text("of no kind")
    with refused(r"UnknownFileType.*; expected one of aims, cfg, .* xsf"):
        dumps.read_structure(tmp_path / "a")
    title, many = tmp_path / "a.data", " cut of 1000000 atoms"  # of which a title may tell
    title.write_text(title.read_text().replace("\n", f"{many}\n", 1))
    assert len(dumps.read_structure(title)) == len(SALT)


def grained(dumps, force=None, **how):
    """Samples of dumps of the periodic body."""
    force = np.ones((len(dumps), 30, 2)) if force is None else force
    given = {
        "omega": OMEGA,
        "points": POINTS,
        "atoms": ReferenceAtoms(REFERENCE, box=torch.tensor(BOX, dtype=float)),
    }
    return coarse_grain_dumps(dumps, force=force, **GRAIN | given | how)


def test_averages_smoothing_and_samples_on_nodes(tmp_path):
    path = write(tmp_path / "a.dump", range(6))
    assert_allclose(mean_displacement(path, REFERENCE, box=BOX, skip=2), U[2:6].mean(0), atol=1e-9)
    rest, force = write(tmp_path / "rest.dump", range(6, 9)), RANDOM.normal(size=(1, 30, 2))
    samples = grained([path], force, unloaded=[rest])
    moved = U[:6].mean(0) - U[6:].mean(0)
    u, b = coarse_grain(OMEGA, displacement=moved[None], force=force, **GRAIN)
    assert_allclose(samples.u, u, atol=1e-9)
    assert_allclose(samples.b, b)
    assert list(samples.arrays["load_id"]) == ["a.dump"]


BOUNDS = f"ITEM: BOX BOUNDS pp pp pp\n0 {BOX[0]}\n0 {BOX[1]}\n-5 5\n"
TILTED = f"ITEM: BOX BOUNDS xy xz yz pp pp pp\n0 {BOX[0] + 2} 2\n0 {BOX[1]} 0\n-5 5 0\n"
PLAIN, OTHER_IDS = frame(REFERENCE), frame(REFERENCE, 1).replace("\n30 1 ", "\n31 1 ")


def test_broken_dumps_and_those_that_would_be_misread_are_refused(tmp_path):
    path = tmp_path / "broken.dump"
    for words, text in {
        "frame 2": PLAIN + frame(REFERENCE, 1)[:-200],
        "30 atoms announced, 29 there": PLAIN.rstrip().rsplit("\n", 1)[0] + "\n\n",
        "expected 30 atoms, got 29": frame(REFERENCE[:-1]),
        "expected the columns id, x, .* got mol": frame(REFERENCE, 0, "mol type x y z"),
        "frame 1.*id 7 comes twice": PLAIN.replace("\n30 1 ", "\n7 1 "),
        "frame 2.*expected the ids of frame 1": PLAIN + OTHER_IDS,
        "xu, yu, zu in a tilted box, got x; or x with": PLAIN.replace(BOUNDS, TILTED),
        "units metal or real, got si": "ITEM: UNITS\nsi\n" + PLAIN,
    }.items():  # fmt: skip
        path.write_text(text)
        with refused(words):
            mean_displacement(path, REFERENCE)


def test_options_without_sense_are_refused(tmp_path):
    path, other = write(tmp_path / "a.dump", range(2)), tmp_path / "other.dump"
    other.write_text(OTHER_IDS)
    wide = (BOX[0] * (1 + 2e-5), BOX[1])
    assert_refused({
        "more than 2 frames": lambda: mean_displacement(path, REFERENCE, box=BOX, skip=2),
        "header's 12 x 9 Å, got 12.00024": lambda: mean_displacement(path, REFERENCE, box=wide),
        "ids: expected float values": lambda: mean_displacement(path, REFERENCE, ids=[1j]),
        "no such dump": lambda: mean_displacement(tmp_path / "none.dump", REFERENCE),
        "other.dump: expected the ids of the reference": lambda: grained([path, other]),
        "0, 1 or as many, got 1 and 3": lambda: grained([path], unloaded=3 * [path]),
    })  # fmt: skip
    each_refused(lambda change: grained(["not read"], **change), {
        "^node_area: expected a number > 0": {"node_area": -25.0},
        r"^omega: expected shape \[\d+, 30\]": {"omega": OMEGA.T},
        "^omega: expected a sparse matrix, got ndarray": {"omega": OMEGA.toarray()},
        "^omega: expected float values, got complex": {"omega": 1j * OMEGA},
        r"^omega: expected shape \[1, 30\]": {"points": Points(np.zeros((1, 2)), [True], 0.0)},
        "nodes have no atom": {"omega": 0 * OMEGA},
        r"^force: expected shape \[1, 30, 2\]": {"force": np.ones((1, 29, 2))},
    })  # fmt: skip


def test_masses_by_type_in_the_order_of_ids(tmp_path):
    path, text = tmp_path / "types.dump", frame(REFERENCE[:5], 3, "type id x y z").splitlines()
    text[9:] = [f"{1 + (i % 3 == 0)} {i + 1} 0 0 0" for i in (4, 3, 2, 1, 0)]
    path.write_text("\n".join(text) + "\n")
    assert_array_equal(dumps.read_masses(path, [10.8, 14.0]), [14, 10.8, 10.8, 14, 10.8])
    with refused("each of the types 1 to 2 .* got 1"):
        dumps.read_masses(path, [10.8])
    path.write_text(frame(REFERENCE, 0, "id element x y z").replace(" 1 ", " B "))
    with refused("expected the columns id and type, got id element x y z"):
        dumps.read_masses(path, [10.8])


def test_scaled_and_unwrapped_positions(tmp_path):
    path, drift = tmp_path / "a.dump", np.array([0.7 * BOX[0], 0.0])
    text = frame(REFERENCE / BOX, 0, "id type xs ys zs")
    path.write_text(text.replace(f"0 {BOX[0]}\n", f"-3 {BOX[0] - 3}\n"))
    assert_allclose(next(iter_dump(path)).x, REFERENCE - [3, 0], atol=1e-9)
    path.write_text(frame(REFERENCE + drift, 0, "id type xu yu zu").replace(BOUNDS, TILTED))
    moved = mean_displacement(path, REFERENCE)  # by more than half a box
    assert_allclose(moved, np.tile(drift, (30, 1)), atol=1e-9)
    with refused("orthogonal box in the dump, got a tilted one"):
        mean_displacement(path, REFERENCE, box=BOX)


@parametrize("name", ["a@0.extxyz", "a@0.traj"])
def test_trajectories_of_ase_and_wrapped_atoms_of_a_tilted_box(tmp_path, name):
    """Refused where nothing says where they were; by their images as they moved."""
    path, across = tmp_path / name, MOVED - (EDGES @ CELL)[:, :2]

    def write(fields, images=()):
        x = [np.column_stack([AT + u, np.zeros(20)]) for u in fields]
        atoms = [ase.Atoms("B10N10", positions=one, cell=CELL, pbc=True) for one in x]
        for one, image in zip(atoms, images):
            one.arrays |= dict(zip(("ix", "iy", "iz"), image.T.astype(int)))
        ase.io.write(path, atoms)

    assert EDGES.any()
    write([across])
    with refused("beyond half the box; are they wrapped"):
        mean_displacement(path, AT)
    write([0 * MOVED, across])
    with refused(r"frame 2 .*jump by an edge of the tilted box"):
        list(iter_dump(path))
    if name != "a@0.traj":  # which has no columns but ASE's own
        write([0 * MOVED, across], [0 * EDGES, EDGES])
        with warned("unwrapped by the images"):
            found = mean_displacement(path, AT, skip=1)
        assert_allclose(found, MOVED, atol=1e-7)
    write([0 * MOVED, MOVED])
    assert_allclose(mean_displacement(path, AT, skip=1), MOVED, atol=1e-7)
    assert list(next(iter_dump(path)).types) == 10 * [1] + 10 * [2]


def test_torn_sheets_and_loads_that_are_not_shared_by_mass_are_told(tmp_path):
    x = grid_places((8, 8)).astype(float) * 2.5
    points = Points(np.array([[8.0, 8.0]]), np.array([True]), 0.0)
    omega = smoothing_matrix(x, points.x, radius=8.0)

    def grained(name, moved, force, mass):
        (tmp_path / name).write_text(frame(x + moved, 0, "id type xu yu zu"))
        atoms, how = ReferenceAtoms(x, mass), {"force": force[None], **GRAIN}
        coarse_grain_dumps([tmp_path / name], omega, points, atoms, **how)

    mass, along = np.resize([10.0, 20.0], 64), np.ones((64, 1)) * [1.0, 0.5]
    torn = np.where(x[:, :1] > 9, 2.0, 0.0) * [1.0, 0.0]
    grained("whole.dump", 0.1 * x, mass[:, None] * along, mass)
    grained("whole.dump", 0.1 * x, along, np.linspace(10, 20, 64))  # none of which is a species
    with warned(r"torn.dump: 16 of 64 atoms are 50% or more further"):
        grained("torn.dump", torn, 0 * along, mass)
    with warned("masses 10, 20 carry loads per mass of 1, 0.5, relative"):
        grained("whole.dump", 0.1 * x, along, mass)
    with refused(r"mass: expected shape \[64\]"):
        grained("whole.dump", 0.1 * x, along, mass[:3])
