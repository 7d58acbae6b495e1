"""Dump files of LAMMPS: read by frames, reduced, coarse-grained, and refused when broken."""

import gzip
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from tests.support.problems import lattice
from warp_peri import InputError, Points
from warp_peri.atoms.coarse_graining import coarse_grain, smoothing_matrix
from warp_peri.atoms.dumps import (
    Atoms,
    coarse_grain_dumps,
    dump_displacement,
    dump_frames,
    dump_masses,
)

BOX = (12.0, 9.0)
random = np.random.default_rng(0)
REFERENCE = random.uniform(0, 1, size=(30, 2)) * BOX


def frame(x, step, columns="id type x y z"):
    """A frame as LAMMPS writes it, its atoms in any order."""
    order = np.random.default_rng(step).permutation(len(x))
    lines = ["ITEM: TIMESTEP", f"{step}", "ITEM: NUMBER OF ATOMS", f"{len(x)}"]
    lines += ["ITEM: BOX BOUNDS pp pp pp", f"0 {BOX[0]}", f"0 {BOX[1]}", "-5 5"]
    lines.append(f"ITEM: ATOMS {columns}")
    lines += [f"{i + 1} 1 {x[i, 0]:.12f} {x[i, 1]:.12f} 0" for i in order]
    return "\n".join(lines) + "\n"


def moved(step):
    """Positions of a frame, inside the box."""
    u = 0.3 * np.random.default_rng(100 + step).normal(size=REFERENCE.shape)
    return (REFERENCE + u) % BOX, u


def positions(path):
    return (frame.x for frame in dump_frames(path))


def write(path, steps, **options):
    text = "".join(frame(moved(step)[0], step, **options) for step in steps)
    if path.suffix == ".gz":
        with gzip.open(path, "wt") as file:
            file.write(text)
    else:
        path.write_text(text)
    return path


@pytest.mark.parametrize("name", ["a.dump", "a.dump.gz"])
def test_frames_come_in_order_with_atoms_by_id(tmp_path, name):
    frames = list(positions(write(tmp_path / name, range(4))))
    assert len(frames) == 4
    for step, x in enumerate(frames):
        np.testing.assert_allclose(x, moved(step)[0], atol=1e-9)


def test_scaled_positions_are_known(tmp_path):
    x = moved(0)[0]
    path = tmp_path / "scaled.dump"
    path.write_text(frame(x / BOX, 0, columns="id type xs ys zs"))
    np.testing.assert_allclose(next(positions(path)), x, atol=1e-9)


def test_average_and_smoothing(tmp_path):
    path = write(tmp_path / "a.dump", range(6))
    fields = [moved(step)[1] for step in range(6)]
    average = dump_displacement(path, REFERENCE, box=BOX, skip=2)
    np.testing.assert_allclose(average, np.mean(fields[2:], axis=0), atol=1e-9)
    smoothed = np.zeros_like(REFERENCE)
    for u in fields:
        smoothed = 0.8 * smoothed + 0.2 * u
    displacement = dump_displacement(path, REFERENCE, box=BOX, iota=0.2)
    np.testing.assert_allclose(displacement, smoothed, atol=1e-9)


def test_memory_does_not_grow_with_the_frames(tmp_path):
    peaks = []
    for count in (4, 60):
        path = write(tmp_path / f"{count}.dump", range(count))
        tracemalloc.start()
        dump_displacement(path, REFERENCE, box=BOX)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.5 * peaks[0]


def test_samples_on_nodes(tmp_path):
    loads = [
        write(tmp_path / f"{name}.dump", steps)
        for name, steps in (("a", range(3)), ("b", range(3, 6)))
    ]
    rest = write(tmp_path / "rest.dump", range(6, 9))
    points = lattice(2, 1.0, 3.0)
    omega = smoothing_matrix(REFERENCE, points.x, radius=5.0, box=BOX, spacing=3.0)
    force = random.normal(size=(2, 30, 2))
    options = {"node_area": 9.0, "thickness": 3.35}
    samples = coarse_grain_dumps(
        loads, omega, points, Atoms(REFERENCE, box=BOX), force=force, unloaded=[rest], **options
    )
    means = [
        np.mean([moved(s)[1] for s in steps], axis=0)
        for steps in (range(3), range(3, 6), range(6, 9))
    ]
    u, b = coarse_grain(omega, displacement=np.stack(means[:2]) - means[2], force=force, **options)
    np.testing.assert_allclose(samples.u, u, atol=1e-9)
    np.testing.assert_allclose(samples.b, b)
    assert list(samples.arrays["load_id"]) == ["a.dump", "b.dump"]
    with pytest.raises(InputError, match="0, 1 or 2 dumps"):
        coarse_grain_dumps(
            loads, omega, points, Atoms(REFERENCE), force=force, unloaded=3 * [rest], **options
        )


BROKEN = {
    "empty": ("", "found no frame"),
    "something else": ("x,y\n1,2\n", "expected 'ITEM: TIMESTEP'"),
    "cut": (frame(REFERENCE, 0)[:-200], "frame 1"),
    "second frame cut": (frame(REFERENCE, 0) + frame(REFERENCE, 1)[:-200], "frame 2"),
    "not a number": (frame(REFERENCE, 0).replace("1 1 ", "1 1 nan ", 1), "frame 1"),
    "fewer atoms": (frame(REFERENCE[:-1], 0), "expected 30 atoms, got 29"),
}


BOUNDS = f"ITEM: BOX BOUNDS pp pp pp\n0 {BOX[0]}\n0 {BOX[1]}\n-5 5\n"
TILTED = f"ITEM: BOX BOUNDS xy xz yz pp pp pp\n0 {BOX[0] + 2} 2\n0 {BOX[1]} 0\n-5 5 0\n"
OTHER_IDS = frame(REFERENCE, 1).replace("\n30 1 ", "\n31 1 ")
MISREAD = {
    "no id": (frame(REFERENCE, 0, columns="mol type x y z"), "expected the column id, got mol"),
    "id twice": (frame(REFERENCE, 0).replace("\n30 1 ", "\n7 1 "), "frame 1.*id 7 comes twice"),
    "other ids": (frame(REFERENCE, 0) + OTHER_IDS, "frame 2.*expected the ids of frame 1"),
    "tilted": (frame(REFERENCE, 0).replace(BOUNDS, TILTED), "xu, yu, zu in a tilted box, got x"),
    "units": ("ITEM: UNITS\nsi\n" + frame(REFERENCE, 0), "units metal or real, got si"),
}


@pytest.mark.parametrize(
    ("text", "words"), [*BROKEN.values(), *MISREAD.values()], ids=[*BROKEN, *MISREAD]
)
def test_broken_dumps_and_those_that_would_be_misread_are_refused(tmp_path, text, words):
    path = tmp_path / "broken.dump"
    path.write_text(text)
    with pytest.raises(InputError, match=words):
        dump_displacement(path, REFERENCE)


def test_options_without_sense_are_refused(tmp_path):
    path = write(tmp_path / "a.dump", range(2))
    for options, words in (
        ({"skip": 2}, "more than 2 frames"),
        ({"skip": -1}, "≥ 0"),
        ({"iota": 0.0}, "0 < ι ≤ 1"),
    ):
        with pytest.raises(InputError, match=words):
            dump_displacement(path, REFERENCE, **options)
    with pytest.raises(InputError, match="no such dump"):
        dump_displacement(tmp_path / "none.dump", REFERENCE)


def test_masses_by_type_in_the_order_of_ids(tmp_path):
    path = tmp_path / "types.dump"
    text = frame(REFERENCE, 3, columns="type id x y z").splitlines()
    text[9:] = [f"{1 + (i % 3 == 0)} {i + 1} 0 0 0" for i in (4, 3, 2, 1, 0)]
    text[3] = "5"
    path.write_text("\n".join(text) + "\n")
    np.testing.assert_array_equal(dump_masses(path, [10.8, 14.0]), [14, 10.8, 10.8, 14, 10.8])
    with pytest.raises(InputError, match="each of the types 1 to 2 .* got 1"):
        dump_masses(path, [10.8])


def test_masses_need_types(tmp_path):
    path = tmp_path / "typeless.dump"
    path.write_text(frame(REFERENCE, 0, columns="id element x y z").replace(" 1 ", " B "))
    with pytest.raises(InputError, match="expected the columns id and type, got id element x y z"):
        dump_masses(path, [10.8])


def test_unwrapped_positions_of_a_tilted_box_are_free_of_it(tmp_path):
    path = tmp_path / "a.dump"
    path.write_text(frame(REFERENCE, 0, columns="id type xu yu zu").replace(BOUNDS, TILTED))
    np.testing.assert_allclose(next(positions(path)), REFERENCE, atol=1e-9)
    with pytest.raises(InputError, match="orthogonal box in the dump, got a tilted one"):
        dump_displacement(path, REFERENCE, box=BOX)


def test_dumps_of_one_call_have_one_set_of_ids(tmp_path):
    path, other = write(tmp_path / "a.dump", [0]), tmp_path / "other.dump"
    other.write_text(OTHER_IDS)
    points = lattice(2, 1.0, 3.0)
    omega = smoothing_matrix(REFERENCE, points.x, radius=4.0, box=BOX, spacing=3.0)
    options = {"node_area": 9.0, "thickness": 3.35}
    for dumps, more in (([path, other], {}), ([path], {"unloaded": [other]}), ([other], {})):
        ids = np.arange(1, 31) if dumps == [other] else None
        atoms = Atoms(REFERENCE, ids=ids, box=BOX)
        force = np.ones((len(dumps), 30, 2))
        with pytest.raises(InputError, match=r"other.dump: expected the ids of the reference"):
            coarse_grain_dumps(dumps, omega, points, atoms, force=force, **options, **more)


def test_a_box_is_the_header_s(tmp_path):
    path = write(tmp_path / "a.dump", [0])
    dump_displacement(path, REFERENCE, box=(BOX[0] * (1 + 5e-6), BOX[1]))
    with pytest.raises(InputError, match="expected the header's 12 x 9 Å, got 12.00024 x 9 Å"):
        dump_displacement(path, REFERENCE, box=(BOX[0] * (1 + 2e-5), BOX[1]))


def test_scaled_positions_start_at_the_corner_of_the_box(tmp_path):
    path = tmp_path / "a.dump"
    text = frame(REFERENCE / BOX, 0, columns="id type xs ys zs")
    path.write_text(text.replace(f"0 {BOX[0]}\n", f"-3 {BOX[0] - 3}\n"))
    np.testing.assert_allclose(next(positions(path)), REFERENCE - [3, 0], atol=1e-9)


def test_units_and_time_may_precede_a_frame(tmp_path):
    path = tmp_path / "a.dump"
    time = "ITEM: TIME\n0.5\n"
    x = [moved(step)[0] for step in (0, 1)]
    path.write_text(f"ITEM: UNITS\nmetal\n{time}{frame(x[0], 0)}{time}{frame(x[1], 1)}")
    np.testing.assert_allclose(list(positions(path)), x, atol=1e-9)


def test_types_are_not_needed(tmp_path):
    path = tmp_path / "a.dump"
    text = frame(REFERENCE, 0, columns="id x y z").splitlines()
    text[9:] = [" ".join([row.split()[0], *row.split()[2:]]) for row in text[9:]]
    path.write_text("\n".join(text) + "\n")
    np.testing.assert_allclose(next(positions(path)), REFERENCE, atol=1e-9)
    with pytest.raises(InputError, match="expected the columns id and type, got id x y z"):
        dump_masses(path, [1.0])


def test_wrapped_atoms_need_a_box(tmp_path):
    path = write(tmp_path / "a.dump", range(2))
    with pytest.raises(InputError, match="beyond half the box; are they wrapped"):
        dump_displacement(path, REFERENCE)
    assert np.abs(dump_displacement(path, REFERENCE, box=BOX)).max() < 2


def test_a_torn_sheet_is_remarked(tmp_path):
    """Half of the atoms moved away from the other half; a stretch of a tenth says nothing."""
    x = np.argwhere(np.ones((8, 8))).astype(float) * 2.5
    points = Points(np.array([[8.0, 8.0]]), np.array([True]), 0.0)
    omega = smoothing_matrix(x, points.x, radius=8.0)

    def grained(name, moved, **options):
        frame = "ITEM: TIMESTEP\n0\nITEM: NUMBER OF ATOMS\n64\nITEM: BOX BOUNDS pp pp pp\n"
        frame += 3 * "-99 99\n" + "ITEM: ATOMS id type xu yu zu\n"
        rows = (f"{n + 1} 1 {a} {b} 0\n" for n, (a, b) in enumerate(x + moved))
        (tmp_path / name).write_text(frame + "".join(rows))
        return coarse_grain_dumps(
            [tmp_path / name], omega, points, Atoms(x), force=np.zeros((1, 64, 2)),
            node_area=6.25, thickness=1.0,
        )  # fmt: skip

    grained("whole.dump", 0.1 * x)
    with pytest.warns(UserWarning, match="torn.dump: 16 of 64 atoms are 50% or more further"):
        grained("torn.dump", np.where(x[:, :1] > 9, 2.0, 0.0) * [1.0, 0.0])


def test_loads_that_are_not_shared_by_mass_are_told(tmp_path):
    """Twice as heavy atoms in turn: equal forces are told of, those by mass are not."""
    dump = write(tmp_path / "a.dump", [0])
    points = lattice(2, 1.0, 3.0)
    omega = smoothing_matrix(REFERENCE, points.x, radius=5.0, box=BOX, spacing=3.0)
    mass = np.resize([10.0, 20.0], 30)
    atoms = Atoms(REFERENCE, box=BOX, mass=mass)

    def grained(force):
        coarse_grain_dumps(
            [dump], omega, points, atoms, force=force[None], node_area=9.0, thickness=3.35
        )

    along = np.ones((30, 1)) * [1.0, 0.5]
    with pytest.warns(UserWarning, match="masses 10, 20 carry loads per mass of 1, 0.5, relative"):
        grained(along)
    grained(mass[:, None] * along)
    atoms = replace(atoms, mass=np.linspace(10, 20, 30))
    grained(along)  # none of which is a species
    none = {"force": np.zeros((0, 30, 2)), "node_area": 9.0, "thickness": 3.35}
    with pytest.raises(InputError, match="dumps: expected one or more, got none"):
        coarse_grain_dumps([], omega, points, atoms, **none)


def test_unwrapped_atoms_may_drift_by_more_than_half_a_box(tmp_path):
    path, drift = tmp_path / "a.dump", np.array([0.7 * BOX[0], 0.0])
    path.write_text(frame(REFERENCE + drift, 0, columns="id type xu yu zu"))
    moved = dump_displacement(path, REFERENCE)
    np.testing.assert_allclose(moved, np.tile(drift, (30, 1)), atol=1e-9)
