"""From atoms to nodes, against a brute-force sum."""

import numpy as np
import pytest

from tests.support import reference
from tests.support.problems import ROUNDING
from warp_peri import InputError
from warp_peri.atoms import coarse_grain, smoothing_matrix
from warp_peri.atoms.coarse_graining import EV_PER_CUBIC_ANGSTROM, force_on_mesh
from warp_peri.points.outlines import Circle, mesh_outline
from warp_peri.points.outlines import box as rectangle

RANDOM = np.random.default_rng(3)
BOX = (11.0, 13.5)  # not commensurate with the nodes
ATOMS = RANDOM.uniform(0, 1, (40, 2)) * BOX
H = 2.5


HIDDEN = np.ma.masked_array(
    np.ones((1, 40, 2)), mask=np.arange(40)[None, :, None].repeat(2, 2) == 7
)
"""Atom 7 is no data."""


def nodes(low, high):
    return H * np.stack(np.meshgrid(*2 * [np.arange(low, high)], indexing="ij"), -1).reshape(-1, 2)


@pytest.mark.parametrize("shape", ["cone", "paraboloid"])
@pytest.mark.parametrize("box", [None, BOX], ids=["free", "periodic"])
@pytest.mark.parametrize("spacing", [None, H], ids=["given nodes", "infinite lattice"])
def test_is_the_brute_force_sum(shape, box, spacing):
    where = nodes(-2, 6) + 0.1  # beyond the box on both sides
    if box is not None and spacing is None:
        with pytest.raises(InputError, match="nodes: some are periodic images of others"):
            smoothing_matrix(ATOMS, where, radius=4.0, shape=shape, box=box)
        where = nodes(0, 4) + 0.1
    weights = smoothing_matrix(ATOMS, where, radius=4.0, shape=shape, box=box, spacing=spacing)
    expected = reference.smoothing(ATOMS, where, 4.0, shape, box, spacing)
    np.testing.assert_allclose(weights.toarray(), expected, rtol=0, atol=ROUNDING)


@pytest.mark.parametrize("shape", ["cone", "paraboloid"])
def test_every_atom_is_shared_out_completely(shape):
    omega = smoothing_matrix(ATOMS, nodes(-3, 9), radius=4.0, shape=shape, spacing=H)
    np.testing.assert_allclose(omega.sum(axis=0), 1, rtol=ROUNDING)
    few = smoothing_matrix(ATOMS, nodes(0, 6), radius=8.0, shape=shape)
    np.testing.assert_allclose(few.sum(axis=0), 1, rtol=ROUNDING)
    periodic = smoothing_matrix(ATOMS, nodes(0, 4), radius=8.0, shape=shape, box=BOX)
    np.testing.assert_allclose(periodic.sum(axis=0), 1, rtol=ROUNDING)


def test_periodic_images_of_a_commensurate_box_carry_equal_values():
    box, where = (4 * H, 4 * H), nodes(0, 8)
    atoms = ATOMS % box
    omega = smoothing_matrix(atoms, where, radius=4.0, box=box, spacing=H).toarray()
    grid = omega.reshape(8, 8, -1)
    for a, b in ((4, 0), (0, 4), (4, 4)):
        np.testing.assert_allclose(grid[a : a + 4, b : b + 4], grid[:4, :4], atol=ROUNDING)
    np.testing.assert_allclose(grid[:4, :4].sum((0, 1)), 1, rtol=ROUNDING)


@pytest.mark.parametrize("low", [0, -3], ids=["one period", "beyond the box"])
def test_force_is_kept_in_each_period(low):
    """Nodes beyond the box are images of others: no atom is shared out among both."""
    box, where = (4 * H, 4 * H), nodes(low, 4 - low)
    exact = smoothing_matrix(ATOMS % box, where, radius=4.0, box=box, spacing=H)
    inside = ((where > -1e-9) & (where < 4 * H - 1e-9)).all(axis=1)
    np.testing.assert_allclose(exact[inside].sum(axis=0), 1, rtol=ROUNDING)
    if not low:
        omega = smoothing_matrix(ATOMS % box, where, radius=4.0, box=box)
        np.testing.assert_allclose(omega.toarray(), exact.toarray(), rtol=0, atol=ROUNDING)


def test_nodes_beyond_a_box_without_a_spacing_are_refused():
    loose = nodes(-3, 7) + np.random.default_rng(0).normal(size=(100, 2))
    with pytest.raises(InputError, match="nodes: some are periodic images of others"):
        smoothing_matrix(ATOMS, loose, radius=4.0, box=BOX)
    few = smoothing_matrix(ATOMS, loose[45:55] % 5.0, radius=8.0, box=BOX)
    np.testing.assert_allclose(few.sum(axis=0)[few.sum(axis=0) > 0], 1, rtol=ROUNDING)


def test_an_atom_on_a_node_and_one_at_the_radius():
    omega = smoothing_matrix([[0.0, 0.0], [4.0, 0.0]], [[0.0, 0.0], [1.0, 0.0]], radius=4.0)
    np.testing.assert_allclose(omega.toarray(), [[4 / 7, 0], [3 / 7, 1]], atol=ROUNDING)


def test_an_atom_that_no_node_reaches_is_left_out():
    for atoms, box in ((ATOMS, None), ([[50.0, 50.0]], None), ([[50.0, 50.0]], (100.0, 100.0))):
        far = smoothing_matrix(atoms, nodes(0, 2) - 90.0, radius=4.0, box=box, spacing=H)
        assert far.shape == (4, len(atoms))
        assert abs(far).sum() == 0


def test_force_is_conserved():
    force = RANDOM.normal(size=(2, 40, 2))
    omega = smoothing_matrix(ATOMS, nodes(-3, 9), radius=4.0, spacing=H)
    omega = omega[np.flatnonzero(omega.sum(axis=1))]
    _, b = coarse_grain(omega, displacement=0 * force, force=force, node_area=H**2, thickness=3.35)
    total = b.sum(axis=1) * H**2 * 3.35 / 0.1602176634  # back to eV/Å
    np.testing.assert_allclose(total, force.sum(axis=1), rtol=0, atol=1e-11)


def test_fields_are_the_printed_sums():
    displacement, force = RANDOM.normal(size=(2, 3, 40, 2))
    mass = RANDOM.uniform(1, 3, 40)
    omega = smoothing_matrix(ATOMS, nodes(0, 4), radius=5.0)
    u, b = coarse_grain(
        omega, displacement=displacement, force=force, mass=mass, node_area=6.0, thickness=2.0
    )
    dense = omega.toarray()
    for s in range(3):
        for i in range(16):
            share = dense[i] * mass
            expected = (share[:, None] * displacement[s]).sum(0) / share.sum()
            np.testing.assert_allclose(u[s, i], expected, rtol=0, atol=ROUNDING)
            expected = (dense[i][:, None] * force[s]).sum(0) * 0.1602176634 / (6.0 * 2.0)
            np.testing.assert_allclose(b[s, i], expected, rtol=0, atol=ROUNDING)


def test_a_rigid_displacement_stays_as_it_is_whatever_the_masses():
    omega = smoothing_matrix(ATOMS, nodes(0, 4), radius=5.0)
    rigid = np.broadcast_to([0.3, -0.2], (1, 40, 2))
    u, _ = coarse_grain(
        omega,
        displacement=rigid,
        force=0 * rigid,
        mass=RANDOM.uniform(1, 9, 40),
        node_area=1.0,
        thickness=1.0,
    )
    np.testing.assert_allclose(u, rigid[:, :16], rtol=ROUNDING)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"shape": "disk"}, "shape: expected one of cone, paraboloid, got 'disk'"),
        ({"radius": 0.0}, "radius: expected a length > 0"),
        ({"radius": np.nan}, "radius: expected a length > 0"),
        ({"radius": np.inf}, "radius: expected a length > 0"),
        ({"radius": 1.7}, "radius: expected more than spacing/√2 = 1.768"),
        ({"spacing": 0.0}, "spacing: expected a length > 0"),
        ({"spacing": -1.0}, "spacing: expected a length > 0"),
        ({"spacing": 2.4}, "nodes: expected a square lattice of spacing 2.4"),
        ({"nodes": np.ones((3, 3))}, r"nodes: expected shape \[N, 2\]"),
        ({"nodes": np.empty((0, 2))}, r"nodes: expected shape \[N, 2\] with N > 0"),
        ({"atoms": [[0.0, np.nan]]}, "atoms: expected finite values"),
        ({"box": (0.0, 10.0)}, "box: expected two periods > 0"),
        ({"box": (10.0, -10.0)}, "box: expected two periods > 0"),
        ({"box": (np.nan, 10.0)}, "box: expected two periods > 0"),
        ({"box": (10.0,)}, "box: expected two periods > 0"),
    ],
)
def test_bad_input_is_refused(change, words):
    given = {"atoms": ATOMS, "nodes": nodes(0, 4), "radius": 4.0, "spacing": H} | change
    with pytest.raises(InputError, match=words):
        smoothing_matrix(given.pop("atoms"), given.pop("nodes"), **given)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"displacement": np.ones((40, 2))}, r"displacement: expected shape \[S, 40, 2\]"),
        ({"force": np.ones((1, 39, 2))}, r"force: expected shape \[1, 40, 2\], got \[1, 39, 2\]"),
        ({"force": np.full((1, 40, 2), np.nan)}, "force: expected finite values"),
        ({"displacement": np.full((1, 40, 2), np.inf)}, "displacement: expected finite values"),
        ({"force": np.ones((2, 40, 2))}, r"force: expected shape \[1, 40, 2\], got \[2, 40, 2\]"),
        (
            {"displacement": np.ones((1, 40, 2)) * 1j},
            "displacement: expected float values, got comp",
        ),
        ({"force": HIDDEN}, r"force: .* got 2 of 80 masked, the first at index \[0, 7, 0\]"),
        ({"mass": HIDDEN[0, :, 0]}, r"mass: .* got 1 of 40 masked, the first at index \[7\]"),
        ({"mass": np.ones(3)}, r"mass: expected shape \[40\], got \[3\]"),
        ({"mass": np.nan}, "mass: expected finite values"),
        ({"mass": -np.ones(40)}, "mass: expected values > 0"),
        ({"node_area": 0.0}, "node_area: expected values > 0"),
        ({"thickness": np.nan}, "thickness: expected values > 0"),
    ],
)
def test_bad_fields_are_refused(change, words):
    omega = smoothing_matrix(ATOMS, nodes(0, 4), radius=5.0)
    fields = {"displacement": np.ones((1, 40, 2)), "force": np.ones((1, 40, 2))}
    with pytest.raises(InputError, match=words):
        coarse_grain(omega, **{**fields, "node_area": 6.25, "thickness": 3.35, **change})


def test_nodes_without_atoms_are_named():
    omega = smoothing_matrix(ATOMS, [*nodes(0, 4), [99.0, 99.0]], radius=5.0)
    fields = np.ones((1, 40, 2))
    with pytest.raises(InputError, match="1 nodes have no atom .* the first is 16"):
        coarse_grain(omega, displacement=fields, force=fields, node_area=1.0, thickness=1.0)


HOLE = mesh_outline(rectangle(60.0, 50.0), [Circle(12.0, size=5.0)], size=8.0)
"""A plate around a hole."""
BODY = RANDOM.uniform(-0.5, 0.5, (2000, 2)) * (60.0, 50.0)
BODY = BODY[np.hypot(*BODY.T) > 11.5]  # some of them in the hole
PUSH = RANDOM.normal(size=BODY.shape)


def work_of(b, v):
    """∫ b · v dx for b and v linear on the triangles, by the midpoints of their sides [TPa Å³]."""
    corners = HOLE.x[HOLE.triangles]
    area = np.linalg.det(corners[:, 1:] - corners[:, :1]) / 2
    middles = (corners + np.roll(corners, 1, axis=1)) / 2
    products = (b(middles.reshape(-1, 2)) * v(middles.reshape(-1, 2))).sum(axis=1)
    return area @ products.reshape(-1, 3).mean(axis=1)


@pytest.mark.parametrize(
    "v",
    [
        pytest.param(lambda x: 0 * x + (1.0, 0.0), id="force along x"),
        pytest.param(lambda x: 0 * x + (0.0, 1.0), id="force along y"),
        pytest.param(lambda x: x[:, ::-1] * (-1.0, 1.0), id="moment"),
        pytest.param(lambda x: x @ [[0.3, -1.0], [0.7, 0.2]] + 0.5, id="any affine field"),
    ],
)
def test_force_on_a_mesh_with_a_hole_does_the_work_of_the_atoms(v):
    assert (HOLE.holding(BODY) < 0).sum() > 5
    b = force_on_mesh(HOLE, BODY, PUSH, thickness=2.0)
    expected = np.vdot(PUSH, v(BODY))
    work = work_of(b, v) * 2.0 / EV_PER_CUBIC_ANGSTROM
    assert work == pytest.approx(expected, abs=1e-9 * np.abs(PUSH).sum())


def test_force_on_a_mesh_is_no_weaker_beside_edges():
    line = np.arange(-29.75, 30, 0.5)
    x = np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1).reshape(-1, 2)
    x = x[HOLE.holding(x) >= 0]

    def given(x):
        return x @ [[0.1, 0.2], [-0.3, 0.4]] + (20.0, 30.0)

    b = force_on_mesh(HOLE, x, 0.25 * given(x) / EV_PER_CUBIC_ANGSTROM, thickness=1.0)
    np.testing.assert_allclose(b(HOLE.x), given(HOLE.x), rtol=0.05)


@pytest.mark.parametrize(
    ("atoms", "force", "thickness", "message"),
    [
        ([[0.0, 20.0], [90.0, 0.0]], np.ones((2, 2)), 1.0, "atoms: 1 lie outside the mesh"),
        ([[0.0, 20.0]], np.ones((2, 2)), 1.0, r"force: expected shape \[1, 2\], got \[2, 2\]"),
        ([[0.0, 20.0]], [[np.nan, 0]], 1.0, "force: expected finite values"),
        ([[0.0, 20.0]], [[1.0, 0]], 0.0, "thickness: expected a length > 0"),
    ],
)
def test_what_cannot_push_a_mesh(atoms, force, thickness, message):
    with pytest.raises(InputError, match=message):
        force_on_mesh(HOLE, atoms, force, thickness=thickness)
