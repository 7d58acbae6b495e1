"""What is proven of a spacing holds for every lattice that is taken as that spacing."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg

from tests.support.problems import ROUNDING, lattice, noise
from tests.support.solving import solve, solve_periodic
from warp_peri import InputError, Model, certify
from warp_peri.materials.lps import bernstein_basis, stiffnesses
from warp_peri.materials.lps_matrices import matrices, node_fields
from warp_peri.points.families import bond_classes

SPACING, HORIZON = 5.0, 12.5
WITHIN = [1 - 0.99e-6, 1 - 5e-7, 1 + 5e-7, 1 + 0.99e-6]


@pytest.fixture(scope="module")
def wild():
    """A plain kernel at the bond lengths of the lattice, that swings by a million beside them."""
    r = bond_classes(SPACING, HORIZON).r
    unseen = scipy.linalg.null_space(bernstein_basis(r, HORIZON, 10))
    D = np.ones(11) + 1e6 * unseen.sum(axis=1)
    numbers = {"lam": 0.3, "mu": 0.8, "alpha": 1.0, "D": D, "horizon": HORIZON}
    return Model(**numbers, certified_on=(SPACING,))


def points_of(factor, interior=6):
    points = lattice(interior, HORIZON, SPACING)
    return replace(points, x=factor * points.x, spacing=factor * SPACING)


def laplacian(points):
    """The 5-point Laplacian on the interior, both components."""
    x = points.x[points.interior] / points.spacing
    near = np.abs(np.linalg.norm(x[:, None] - x, axis=-1) - 1) < 0.1
    return np.kron((4 * np.eye(len(x)) - near) / points.spacing**2, np.eye(2))


@pytest.mark.parametrize("factor", WITHIN)
def test_the_bound_is_kept_within_the_tolerance(wild, factor):
    bound = certify(wild, spacing=SPACING).symbol_bound
    assert bound > 0.2
    points = points_of(factor)
    L = matrices(wild, points).operator(wild.lam, wild.mu)
    L = L[:, np.repeat(points.interior, 2)].toarray()
    smallest = scipy.linalg.eigh(L, laplacian(points), eigvals_only=True)[0]
    assert smallest >= bound * (1 - 3e-6)
    assert certify(wild, spacing=SPACING * factor).symbol_bound == bound


@pytest.mark.parametrize("factor", WITHIN)
def test_whoever_asks_gets_the_certified_lattice(wild, factor):
    there, here = points_of(factor), points_of(1.0)
    u = noise(there)
    force = wild.on(there)(u)
    expected = wild.on(here)(u)
    assert force == pytest.approx(expected, rel=0, abs=ROUNDING * np.abs(expected).max())
    b = np.zeros_like(u)
    b[there.interior] = force
    for method in ("lu", "multigrid"):
        solved = solve(wild, there, b, u, method=method)
        assert np.abs(solved - u).max() < 1e-6 * np.abs(u).max()
    stress = node_fields(wild, there, u).stress
    assert stress == pytest.approx(node_fields(wild, here, u).stress, rel=1e-9)
    sheet = noise(here)[:64].reshape(8, 8, 2)
    flat = solve_periodic(wild, sheet, spacing=SPACING * factor)
    assert flat == pytest.approx(solve_periodic(wild, sheet, spacing=SPACING), rel=1e-9)
    v = stiffnesses(wild, bond_classes(SPACING * factor, HORIZON))[0]
    assert v == pytest.approx(stiffnesses(wild, bond_classes(SPACING, HORIZON))[0], rel=1e-4)


@pytest.mark.parametrize("factor", [1 - 1.01e-6, 1 + 1.001e-6, 1 + 1e-3])
def test_beyond_the_tolerance_it_is_another_lattice(wild, factor):
    points = points_of(factor)
    zeros = np.zeros_like(points.x)
    for use in (
        lambda: solve(wild, points, zeros, zeros, transfer=False),
        lambda: wild.on(points, transfer=False),
        lambda: wild.check_spacing(SPACING * factor),
    ):
        with pytest.raises(InputError, match="certified on 5 Å"):
            use()


@pytest.mark.parametrize("certified", [5e-10, 1e-3, 1e6])
@pytest.mark.parametrize("factor", [0.0, 1 - 1e-5, 1 + 1e-5, 16.0])
def test_the_tolerance_has_no_absolute_part(wild, certified, factor):
    model = replace(wild, certified_on=(certified,))
    model.check_spacing(certified)
    with pytest.raises(InputError, match="the model is certified on"):
        model.check_spacing(certified * factor)


@pytest.mark.parametrize("square", [4, 5, 8, 9, 10, 13, 16, 25, 50, 100])
def test_bonds_are_counted_by_whole_numbers(square):
    """A bond as long as the horizon belongs to the family on every lattice within the tolerance."""
    ratio = np.sqrt(square)
    counts = {len(bond_classes(h, 1.0).steps) for h in np.array([1.0, *WITHIN]) / ratio}
    line = np.arange(-10, 11)
    assert counts == {np.count_nonzero(line[:, None] ** 2 + line**2 <= square) - 1}
