"""Dump files of LAMMPS: read by frames, reduced, coarse-grained, and refused when broken."""

import gzip
import tracemalloc

import numpy as np
import pytest

from tests.problems import lattice
from warp_peri import InputError
from warp_peri.coarse_graining import coarse_grain, smoothing_matrix
from warp_peri.dumps import (
    coarse_grain_dumps,
    dump_displacement,
    dump_masses,
    dump_positions,
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
    found = list(dump_positions(write(tmp_path / name, range(4))))
    assert len(found) == 4
    for step, x in enumerate(found):
        np.testing.assert_allclose(x, moved(step)[0], atol=1e-9)


def test_scaled_positions_are_known(tmp_path):
    x = moved(0)[0]
    path = tmp_path / "scaled.dump"
    path.write_text(frame(x / BOX, 0, columns="id type xs ys zs"))
    np.testing.assert_allclose(next(dump_positions(path)), x, atol=1e-9)


def test_average_and_smoothing(tmp_path):
    path = write(tmp_path / "a.dump", range(6))
    fields = [moved(step)[1] for step in range(6)]
    average = dump_displacement(path, REFERENCE, box=BOX, skip=2)
    np.testing.assert_allclose(average, np.mean(fields[2:], axis=0), atol=1e-9)
    smoothed = np.zeros_like(REFERENCE)
    for u in fields:
        smoothed = 0.8 * smoothed + 0.2 * u
    found = dump_displacement(path, REFERENCE, box=BOX, iota=0.2)
    np.testing.assert_allclose(found, smoothed, atol=1e-9)


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
    found = coarse_grain_dumps(
        loads, omega, points, reference=REFERENCE, force=force, unloaded=[rest], box=BOX, **options
    )
    means = [
        np.mean([moved(s)[1] for s in steps], axis=0)
        for steps in (range(3), range(3, 6), range(6, 9))
    ]
    u, b = coarse_grain(omega, displacement=np.stack(means[:2]) - means[2], force=force, **options)
    np.testing.assert_allclose(found.u, u, atol=1e-9)
    np.testing.assert_allclose(found.b, b)
    assert list(found.samples["load_id"]) == ["a.dump", "b.dump"]
    with pytest.raises(InputError, match="0, 1 or 2 dumps"):
        coarse_grain_dumps(
            loads, omega, points, reference=REFERENCE, force=force, unloaded=3 * [rest], **options
        )


BROKEN = {
    "empty": ("", "no 'ITEM: TIMESTEP'"),
    "something else": ("x,y\n1,2\n", "expected 'ITEM: TIMESTEP'"),
    "cut": (frame(REFERENCE, 0)[:-200], "frame 1"),
    "second frame cut": (frame(REFERENCE, 0) + frame(REFERENCE, 1)[:-200], "frame 2"),
    "not a number": (frame(REFERENCE, 0).replace("1 1 ", "1 1 nan ", 1), "frame 1"),
    "fewer atoms": (frame(REFERENCE[:-1], 0), "expected 30 atoms, got 29"),
}


@pytest.mark.parametrize(("text", "words"), BROKEN.values(), ids=BROKEN)
def test_broken_dumps_are_named(tmp_path, text, words):
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
