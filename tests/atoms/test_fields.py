"""Fields on nodes from .mat files that the tests write: shapes, versions, refusals."""

import h5py
import numpy as np
import pytest
from scipy.io import savemat

import warp_peri as wp
from tests.support.sheets import square
from warp_peri import InputError
from warp_peri.atoms import read_fields

NODES = square(9, spacing=5.0)
RANDOM = np.random.default_rng(0)
U, B = RANDOM.standard_normal((2, 3, len(NODES.x), 2))
ORDER = RANDOM.permutation(len(NODES.x))


def written(path, **variables):
    savemat(path, variables)
    return path


def in_hdf5(path, **variables):
    """As MATLAB writes version 7.3: a header before HDF5, and arrays with their axes reversed."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, value in variables.items():
            file[name] = value.T
    with open(path, "r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")
    return path


def packed(path, **variables):
    savemat(path, variables, do_compression=True)
    return path


@pytest.mark.parametrize("write", [written, packed, in_hdf5])
def test_coordinates_displacements_and_forces(tmp_path, write):
    """Nodes in any order, as the file has them; others of its variables are not looked at."""
    given = {"coords": NODES.x[ORDER] - 50.0, "disps": U[:, ORDER], "forces": B[:, ORDER]}
    path = write(tmp_path / "a.mat", mass=np.full((1, len(NODES.x)), 83.75), **given)
    samples = read_fields(path, factor=0.5)
    assert samples.points.units == wp.Points(NODES.x, NODES.interior, 5.0, units="reduced").units
    np.testing.assert_allclose(samples.x, NODES.x[ORDER] - 50.0, atol=1e-12)
    np.testing.assert_array_equal(samples.u, U[:, ORDER])
    np.testing.assert_array_equal(samples.b, 0.5 * B[:, ORDER])
    np.testing.assert_array_equal(samples.interior, NODES.interior[ORDER])


@pytest.mark.parametrize("shape", [(3, -1), (3, 2, -1), (3, 2 * 21, 21), (3, 2, 21, 21)])
def test_components_first_on_a_square(tmp_path, shape):
    path = written(tmp_path / "a.mat", u=U.swapaxes(1, 2).reshape(shape))
    samples = read_fields(path, displacement="u", load=None, positions=5.0, units=("mm", "MPa"))
    assert samples.b is None
    np.testing.assert_array_equal(samples.u, U)
    np.testing.assert_allclose(samples.x, NODES.x)


def test_one_sample(tmp_path):
    path = written(tmp_path / "a.mat", coords=NODES.x, disps=U[0], forces=B[0])
    np.testing.assert_array_equal(read_fields(path).u, U[:1])


GOOD = {"coords": NODES.x, "disps": U, "forces": B}


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"forces": None}, "expected forces, an array of numbers, among coords, disps"),
        ({"disps": U[:, 1:]}, "disps: expected two components of 441 nodes, got"),
        ({"disps": "text"}, "expected disps, an array of numbers, among"),
        ({"disps": np.full_like(U, np.nan)}, "u: "),
        ({"coords": NODES.x + 0.3 * RANDOM.uniform(-1, 1, NODES.x.shape)}, "square lattice"),
        ({"coords": NODES.x[:-1]}, "two components of 440 nodes"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("write", [written, in_hdf5])
def test_what_is_missing_or_of_another_shape_is_refused(tmp_path, write, changed, said):
    given = {name: value for name, value in (GOOD | changed).items() if value is not None}
    if write is in_hdf5 and isinstance(given["disps"], str):
        given["disps"] = np.array([b"text"])
    with pytest.raises(InputError, match=said):
        read_fields(write(tmp_path / "a.mat", **given))


def test_no_mat_file_no_square_and_no_interior(tmp_path):
    (tmp_path / "a.mat").write_text("x, y\n0, 1\n")
    for name in ("a.mat", "none.mat"):
        with pytest.raises(InputError, match=r"cannot be read as a \.mat file"):
            read_fields(tmp_path / name)
    cut = written(tmp_path / "cut.mat", u=U[:, 1:].swapaxes(1, 2))
    with pytest.raises(InputError, match="a square number of nodes"):
        read_fields(cut, displacement="u", load=None, positions=5.0)
    whole = written(tmp_path / "whole.mat", **GOOD)
    with pytest.raises(InputError, match="within 22 spacings around them, got none of 21 × 21"):
        read_fields(whole, reach=11)


@pytest.mark.parametrize(
    ("how", "said"),
    [
        ({"reach": -1}, "reach: expected a whole number > 0, got -1"),
        ({"reach": 1.5}, "reach: expected a whole number > 0, got 1.5"),
        ({"reach": 10**6}, "none of 21 × 21"),
        ({"factor": "a"}, "factor: expected a finite number, got 'a'"),
        ({"positions": -5.0}, r"positions: expected a name or a spacing > 0, got -5.0"),
    ],
)
def test_numbers_of_no_sense_are_refused(tmp_path, how, said):
    path = written(tmp_path / "a.mat", disps=U, forces=B, coords=NODES.x)
    with pytest.raises(InputError, match=said):
        read_fields(path, **how)


def test_arrays_that_no_memory_holds_or_that_are_none(tmp_path):
    with h5py.File(tmp_path / "huge.mat", "w") as file:
        file.create_dataset("disps", shape=(2, 10**9, 10**6), dtype="f8", chunks=(1, 100, 100))
    with h5py.File(tmp_path / "none.mat", "w") as file:
        file["disps"] = h5py.Empty("f8")
    for name, said in {
        "huge": "disps: expected arrays of at most 1048576 bytes",
        "none": "expected disps, an array of numbers",
    }.items():
        with pytest.raises(InputError, match=said):
            read_fields(tmp_path / f"{name}.mat", load=None, positions=1.0)
