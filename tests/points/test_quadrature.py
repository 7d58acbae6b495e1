"""Weights of one family: exact on the singular reproducing space, and of smallest norm."""

from itertools import product
from math import gamma

import numpy as np
import pytest

from tests.support import reference
from warp_peri import InputError
from warp_peri.points.families import quadrature_weights


def lattice_family(horizon, d=2):
    steps = np.argwhere(np.ones(d * (13,))) - 6
    r = np.linalg.norm(steps, axis=1)
    return steps[(r > 0) & (r <= horizon)].astype(float)


def scattered_family(bonds, horizon, d=2):
    random = np.random.default_rng(1)
    away = random.normal(size=(bonds, d))
    r = horizon * random.uniform(0.02, 1, (bonds, 1)) ** (1 / d)
    return r * away / np.linalg.norm(away, axis=1, keepdims=True)


def moment(powers):
    """∫ of a monomial over r³ over the unit ball, by Γ functions (Folland)."""
    if any(n % 2 for n in powers):
        return 0.0
    halves = [(n + 1) / 2 for n in powers]
    return 2 * np.prod([*map(gamma, halves)]) / gamma(sum(halves)) / (sum(powers) + len(powers) - 3)


FAMILIES = {
    **{f"lattice {h:g}": (lattice_family(h), h) for h in (2.0, 5.0)},
    "scattered": (scattered_family(60, 1.7), 1.7),
    "cubic 3": (lattice_family(3.0, 3), 3.0),
    "scattered in space": (scattered_family(200, 1.7, 3), 1.7),
}


@pytest.mark.parametrize(("xi", "horizon"), FAMILIES.values(), ids=FAMILIES)
def test_weights_are_exact_and_of_smallest_norm(xi, horizon):
    W, d = quadrature_weights(xi, horizon), xi.shape[1]
    powers = [p for p in product(range(6), repeat=d) if 4 - d <= sum(p) <= 5]
    rows = np.array([(xi**p).prod(1) / horizon ** sum(p) for p in powers])
    rows /= (np.linalg.norm(xi, axis=1) / horizon) ** 3
    exact = np.array([moment(p) for p in powers])
    np.testing.assert_allclose(rows @ W / horizon**d, exact, rtol=0, atol=1e-10 * np.pi)
    least = np.linalg.pinv(rows, rcond=1e-10) @ exact * horizon**d
    np.testing.assert_allclose(W, least, atol=1e-9 * np.abs(least).max())
    if d == 2:
        np.testing.assert_allclose(W, reference.quadrature(xi, horizon), atol=1e-9 * W.max())


def test_families_that_are_poor_or_on_a_line_are_refused():
    line = np.delete(np.linspace(-1, 1, 41), 20)[:, None] * [1.0, 0.0]
    for xi in (lattice_family(1.5), scattered_family(9, 1.5), lattice_family(1.75, 3), line):
        with pytest.raises(InputError, match=f"exact for a family of {len(xi)} bonds"):
            quadrature_weights(xi, 1.75)
