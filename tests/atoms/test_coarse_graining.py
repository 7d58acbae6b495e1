"""From atoms to nodes, against a brute-force sum; fields on nodes from .mat files."""

import h5py
import numpy as np
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from scipy.io import savemat

from tests.support import each_refused, parametrize, reference, refused
from tests.support.problems import ROUNDING
from tests.support.sheets import square
from warp_peri.atoms import coarse_grain, read_mat, smoothing_matrix
from warp_peri.points.points import grid_places

RANDOM = default_rng(3)
BOX = (11.0, 13.5)  # not commensurate with the nodes
ATOMS = RANDOM.uniform(0, 1, (40, 2)) * BOX
H = 2.5
nodes = lambda low, high: H * (grid_places((high - low,) * 2) + low)
NODES = square(9, spacing=5.0)
LOADED = {"disps": RANDOM.normal(size=(3, len(NODES.x), 2)), "coords": NODES.x}
LOADED["forces"] = 2 * LOADED["disps"]


@parametrize(
    ("shape", "box", "spacing"),
    [("cone", None, None), ("cone", None, H), ("cone", BOX, H), ("paraboloid", BOX, None)],
)
def test_is_the_brute_force_sum(shape, box, spacing):
    """Of nodes beyond the box on both sides, where their spacing is known; of images by twos."""
    where, radius = (nodes(0, 4), 8.0) if shape == "paraboloid" else (nodes(-2, 6), 4.0)
    how = {"radius": radius, "shape": shape, "box": box, "spacing": spacing}
    weights = smoothing_matrix(ATOMS, where + 0.1, **how)
    expected = reference.smoothing(ATOMS, where + 0.1, *how.values())
    assert_allclose(weights.toarray(), expected, rtol=0, atol=ROUNDING)


def test_every_atom_is_shared_out_completely_among_the_nodes_of_a_period():
    """Nodes beyond the box are images of others, and carry the same; far atoms are left out."""
    periodic = smoothing_matrix(ATOMS, nodes(0, 4), radius=8.0, box=BOX).toarray()
    away = smoothing_matrix(ATOMS - 1e7 * np.array(BOX), nodes(0, 4), radius=8.0, box=BOX)
    assert_allclose(away.toarray(), periodic, atol=1e-6)
    box = (4 * H, 4 * H)
    wide = smoothing_matrix(ATOMS % box, nodes(-3, 7), radius=4.0, box=box, spacing=H)
    grid = wide.toarray().reshape(10, 10, -1)
    assert_allclose(grid[3:7, 3:7].sum((0, 1)), 1, rtol=ROUNDING)
    assert_allclose(grid[4:, 4:], grid[:6, :6], atol=ROUNDING)
    for atoms, period in ((ATOMS, None), ([[50.0, 50.0]], (100.0, 100.0))):
        far = smoothing_matrix(atoms, nodes(0, 2) - 90.0, radius=4.0, box=period, spacing=H)
        assert (far.shape, abs(far).sum()) == ((4, len(atoms)), 0)


OMEGA = smoothing_matrix(ATOMS, nodes(0, 4), radius=5.0)


def test_fields_are_the_printed_sums():
    displacement, force = RANDOM.normal(size=(2, 3, 40, 2))
    mass = RANDOM.uniform(1, 3, 40)
    how = {"mass": mass, "node_area": 6.0, "thickness": 2.0}
    u, b = coarse_grain(OMEGA, displacement=displacement, force=force, **how)
    dense = OMEGA.toarray()
    expected = np.einsum("ia,a,sad->sid", dense, mass, displacement) / (dense @ mass)[:, None]
    assert_allclose(u, expected, rtol=0, atol=ROUNDING)
    expected = np.einsum("ia,sad->sid", dense, force) * 0.1602176634 / (6.0 * 2.0)
    assert_allclose(b, expected, rtol=0, atol=ROUNDING)
    rigid = np.broadcast_to([0.3, -0.2], (1, 40, 2))  # stays as it is, whatever the masses
    u, _ = coarse_grain(OMEGA, displacement=rigid, force=0 * rigid, **how)
    assert_allclose(u, rigid[:, :16], rtol=ROUNDING)


def test_what_cannot_be_smoothed_is_refused():
    given = {"atoms": ATOMS, "nodes": nodes(0, 4), "radius": 4.0, "spacing": H}
    each_refused(lambda change: smoothing_matrix(**given | change), {
        "radius: expected more than spacing/√2 = 1.768": {"radius": 1.7},
        "nodes: expected a square lattice of spacing 2.4": {"spacing": 2.4},
        r"nodes: expected shape \[N, 2\] with N > 0": {"nodes": np.empty((0, 2))},
        "box: expected two periods > 0": {"box": (10.0, -10.0)},
        "box: expected an array": {"box": [[1, 2], [3]]},
        r"within 1e\+09 periods of one another": {"box": BOX, "atoms": [[1e12, 0.0]]},
        "radius: expected at most .* nodes": {"box": BOX, "radius": 1e9},
        "spacing: expected at most .* nodes": {"nodes": [[0, 0]], "spacing": 1e-6},
        "some are periodic images of others": {"nodes": nodes(-3, 7), "box": BOX, "spacing": None},
    })  # fmt: skip
    fields = dict.fromkeys(("displacement", "force"), np.ones((1, 40, 2)))
    fields |= {"node_area": 6.25, "thickness": 3.35}
    hidden = np.ma.ones((1, 40, 2))
    hidden[:, 7] = np.ma.masked
    each_refused(lambda change: coarse_grain(**{"omega": OMEGA} | fields | change), {
        r"displacement: expected shape \[S, 40, 2\]": {"displacement": np.ones((40, 2))},
        r"force: expected shape \[1, 40, 2\], got \[2, 40, 2\]": {"force": np.ones((2, 40, 2))},
        r"force: .* got 2 of 80 masked, the first at index \[0, 7, 0\]": {"force": hidden},
        "mass: expected values > 0": {"mass": -np.ones(40)},
        "mass: expected float values, got": {"mass": [1.0, [2.0]]},
        r"1 nodes have no atom .* the first is 16":
            {"omega": smoothing_matrix(ATOMS, [*nodes(0, 4), [99.0, 99]], radius=5.0)},
    })  # fmt: skip


def in_hdf5(path, variables):
    """As MATLAB writes version 7.3: a header before HDF5, and arrays with their axes reversed."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, value in variables.items():
            file[name] = value.T
    with open(path, "r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")


@parametrize("write", [savemat, in_hdf5])
def test_mat_files_have_nodes_in_any_order_and_components_first_or_last(tmp_path, write):
    path, order = tmp_path / "a.mat", RANDOM.permutation(len(NODES.x))
    u = LOADED["disps"]
    shuffled = {"coords": NODES.x[order] - 50.0, "disps": u[:, order], "forces": u[:, order]}
    write(path, shuffled | {"mass": np.ones((1, 9))})
    samples = read_mat(path, factor=0.5)
    assert_allclose(samples.x, NODES.x[order] - 50.0, atol=1e-12)
    assert_array_equal(samples.u, u[:, order])
    assert_array_equal(samples.b, 0.5 * u[:, order])
    assert_array_equal(samples.interior, NODES.interior[order])
    for shape in ((3, -1), (3, 2 * 21, 21), (3, 2, 21, 21)):
        write(path, {"u": u.swapaxes(1, 2).reshape(shape)})
        samples = read_mat(path, displacement="u", load=None, positions=5.0)
        assert samples.b is None
        assert_array_equal(samples.u, u)
    for changed, how, said in (
        ({"forces": None}, {}, "expected forces, an array of numbers, among .*coords"),
        ({"disps": u[:, 1:]}, {}, "disps: expected two components of 441 nodes, got"),
        ({"coords": NODES.x + RANDOM.uniform(0, 1, NODES.x.shape)}, {}, "square lattice"),
        ({"disps": u[:, 1:]}, {"load": None, "positions": 5.0}, "components of 441 nodes, got"),
        ({"disps": u.reshape(3, 9, 49, 2)}, {"load": None, "positions": 5.0}, "a square sheet"),
        ({}, {"load": None, "factor": 3.0}, "factor: expected a load that it multiplies"),
        ({}, {"reach": 11}, "within 22 spacings around some, got none of 21 × 21"),
    ):
        write(path, {name: v for name, v in (LOADED | changed).items() if v is not None})
        with refused(said):
            read_mat(path, **how)
    path.write_text("x, y\n0, 1\n")
    with refused(r"cannot be read as a \.mat file"):
        read_mat(path)
    with h5py.File(path, "w") as file:
        file.create_dataset("disps", shape=(2, 10**9, 10**6), dtype="f8", chunks=(1, 100, 100))
    with refused("disps: expected arrays of at most 1048576 bytes"):
        read_mat(path, load=None, positions=1.0)
    with refused("positions: expected a finite number or a text, got inf"):
        read_mat(path, load=None, positions=np.inf)
