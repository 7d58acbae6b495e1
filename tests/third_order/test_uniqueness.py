"""The guarantee of uniqueness: its bounds are bounds, and what it promises is seen."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse.linalg import splu

from tests.support.nonlinear import FORMS, psi, solid
from tests.support.problems import lattice, noise
from warp_peri.certificates import prove_uniqueness
from warp_peri.materials.third_order import (
    PlacedThirdOrder,
    curvature_bound,
    largest_parts,
    proven_kappa,
)
from warp_peri.points.families import bond_classes

HORIZON = 3.0
SIGNS = ((1, 1), (1, -1), (-1, 1), (-1, -1))


def certified(form):
    """A model and its guarantee."""
    model = solid(form)
    return model, prove_uniqueness(model, spacing=1.0)


def balls(count, seed=0):
    """Random matrices of norm 1, shape [count, 2, 2]."""
    H = np.random.default_rng(seed).normal(size=(count, 2, 2))
    return H / np.linalg.norm(H, axis=(1, 2))[:, None, None]


def test_homogeneous_parts_stay_below_their_bounds_and_come_close():
    model, _ = certified("energy")
    parts = largest_parts(model)
    H = balls(20_000)
    sizes = np.array([1.0, -1.0, 2.0, -2.0, 0.5, 3.0])
    values = np.stack([psi(size * H, model) for size in sizes])
    degrees = np.arange(3, 7)
    by_degree = np.linalg.lstsq(sizes[:, None] ** degrees, values, rcond=None)[0]
    largest = np.abs(by_degree).max(axis=1)
    assert (largest <= parts).all()
    assert (largest >= 0.9 * np.array(parts)).all()


def test_curvature_stays_below_its_bound_and_comes_close():
    model, _ = certified("energy")
    parts = largest_parts(model)
    step, e = 1e-4, np.eye(4).reshape(4, 2, 2)
    for strain in (0.01, 0.05):
        H = strain * balls(2000)
        second = np.empty((len(H), 4, 4))  # Ψ″ by differences of the energy
        for a, b in np.ndindex(4, 4):
            corners = [s * t * psi(H + step * (s * e[a] + t * e[b]), model) for s, t in SIGNS]
            second[:, a, b] = sum(corners) / (4 * step**2)
        worst = np.abs(np.linalg.eigvalsh(second)).max()
        bound = curvature_bound(parts, strain)
        assert 0.7 * bound <= worst <= bound


@pytest.mark.parametrize("form", FORMS)
def test_kappa_is_a_bound_over_the_whole_zone(form):
    model, proof = certified(form)
    classes = bond_classes(1.0, HORIZON)
    stencil, group = model.linear.stencil, model.linear.group
    k = np.random.default_rng(1).uniform(-np.pi, np.pi, size=(4000, 2))
    k = np.concatenate([k, 1e-3 * k])
    smallest = np.linalg.eigvalsh(model.linear.symbol(k))[:, 0]
    pull = 2 * np.sin(k @ classes.xi.T)
    for p, kappa in zip(model.weights(classes), (proof.kappa_in, proof.kappa_out)):
        gradient = pull @ (p[classes.bond_class][:, None] * classes.xi)
        sampled = np.sqrt(((gradient**2).sum(axis=1) / smallest).max())
        assert sampled <= kappa <= 1.05 * sampled
    negative = replace(stencil, tensors=-stencil.tensors)
    assert proven_kappa(negative, group, classes, model.weights(classes)[0]) == np.inf


class Iteration:
    """u ← u + L_LPS⁻¹ (b − L u) with clipping, under a random load and collar."""

    def __init__(self, model, strain, points, seed):
        self.operator, self.inside = PlacedThirdOrder(model, points), points.interior
        self.strain = strain
        at_rest = self.operator.straight.matrix()
        self.stiffness = at_rest.tocsc()[:, np.repeat(self.inside, 2)]
        self.factors = splu(self.stiffness)
        self.load = 0.02 * noise(points, seed=seed)[self.inside]
        self.collar = 0.02 * noise(points, seed=seed + 1)

    def start(self, size, random):
        field = self.collar.copy()
        field[self.inside] = size * random.normal(size=(self.inside.sum(), 2))
        return field

    def __call__(self, field):
        left = self.load - self.operator.force(field, radius=self.strain)
        moved = field.copy()
        moved[self.inside] += self.factors.solve(left.ravel()).reshape(-1, 2)
        return moved

    def energy(self, difference):
        flat = difference[self.inside].ravel()
        return np.sqrt(flat @ (self.stiffness @ flat))


@pytest.mark.parametrize("form", FORMS)
def test_the_clipped_iteration_contracts_from_anywhere(form):
    """In the energy norm, by no more than C κ κ, on random domains, to one answer."""
    model, proof = certified(form)
    assert proof.strain > 0.003
    rate = proof.curvature * proof.kappa_in * proof.kappa_out
    assert rate < 1
    for seed in range(2):
        random = np.random.default_rng(seed)
        mask = random.uniform(size=(5, 5)) < 0.7
        mask[2, 2] = True
        iteration = Iteration(model, proof.strain, lattice(mask, HORIZON), seed)
        one, other = (iteration.start(size, random) for size in (0.1, 30.0))
        for _ in range(3):
            before, one, other = iteration.energy(one - other), iteration(one), iteration(other)
            assert iteration.energy(one - other) <= rate * before
        for _ in range(60):
            one, other = iteration(one), iteration(other)
        assert np.abs(other - one).max() <= 1e-9 * np.abs(one).max()


def test_a_planted_violation_takes_the_guarantee_away():
    model, proof = certified("energy")
    softer = replace(model, tq2=10 * model.tq2)
    assert prove_uniqueness(softer, spacing=1.0).strain < proof.strain / 5
    turned = model.linear.tensors.copy()
    longest = np.abs(model.linear.steps).max(axis=1) == 3
    turned[longest] -= 0.2 * np.eye(2)
    indefinite = replace(model, linear=replace(model.linear, tensors=turned, certificate=None))
    waves = np.random.default_rng(2).uniform(-np.pi, np.pi, size=(4000, 2))
    assert np.linalg.eigvalsh(indefinite.linear.symbol(waves)).min() < 0
    nothing = prove_uniqueness(indefinite, spacing=1.0)
    assert nothing.strain == 0
    assert nothing.statement == "Nothing is proven on the lattice of spacing 1 Å."
    assert "at most one solution has |H| ≤" in proof.statement
