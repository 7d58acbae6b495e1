"""Quadrature weights of one family."""

import numpy as np
import pytest

from tests.support import reference
from tests.support.problems import QUADRATURE
from warp_peri import InputError
from warp_peri.points.quadrature import quadrature_weights


def lattice_family(horizon):
    steps = np.argwhere(np.ones((13, 13))) - 6
    r = np.hypot(*steps.T)
    return steps[(r > 0) & (r <= horizon)].astype(float)


def scattered_family(bonds, horizon):
    random = np.random.default_rng(1)
    r = horizon * np.sqrt(random.uniform(0.02, 1, bonds))
    angle = random.uniform(0, 2 * np.pi, bonds)
    return np.stack([r * np.cos(angle), r * np.sin(angle)], axis=1)


FAMILIES = {
    **{f"lattice {h:g}": (lattice_family(h), h) for h in (2.0, 2.3, 2.5, 3.0, 4.0, 5.0)},
    "in other units": (25 * lattice_family(3.0), 75.0),
    "scattered": (scattered_family(60, 1.7), 1.7),
}


@pytest.mark.parametrize(("xi", "horizon"), FAMILIES.values(), ids=FAMILIES)
def test_exact_on_the_whole_reproducing_space(xi, horizon):
    W = quadrature_weights(xi, horizon)
    r = np.hypot(*xi.T)
    for a, b in reference.monomials():
        integral = W @ (xi[:, 0] ** a * xi[:, 1] ** b / r**3) / horizon ** (a + b - 1)
        assert integral == pytest.approx(reference.ball_integral(a, b, 1.0), abs=QUADRATURE * np.pi)


@pytest.mark.parametrize(("xi", "horizon"), FAMILIES.values(), ids=FAMILIES)
def test_smallest_norm(xi, horizon):
    W = quadrature_weights(xi, horizon)
    expected = reference.quadrature(xi, horizon)
    np.testing.assert_allclose(W, expected, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("horizon", [2.0, 3.0, 5.0])
def test_lattice_weights_have_the_symmetry_of_the_square(horizon):
    xi = lattice_family(horizon)
    W = quadrature_weights(xi, horizon)
    weight = {tuple(bond): w for bond, w in zip(xi, W)}
    for (a, b), w in weight.items():
        for image in ((-a, b), (a, -b), (b, a)):
            assert weight[image] == pytest.approx(w, abs=1e-12 * W.max())


@pytest.mark.parametrize(
    "xi",
    [lattice_family(1.0), lattice_family(1.5), scattered_family(9, 1.5), [[0.3, 0.4]]],
    ids=["4 bonds", "8 bonds", "9 scattered bonds", "1 bond"],
)
def test_poor_families_are_refused(xi):
    with pytest.raises(InputError, match=rf"exact for a family of {len(xi)} bonds"):
        quadrature_weights(xi, 1.5)


def test_a_family_on_one_line_is_refused():
    line = np.stack([np.delete(np.linspace(-1, 1, 41), 20), np.zeros(40)], axis=1)
    with pytest.raises(InputError, match="no weights are exact"):
        quadrature_weights(line, 1.0)
