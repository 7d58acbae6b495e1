"""Equilibria of the neural operator: two ways to them, and their derivatives."""

import numpy as np
import pytest
import torch

from examples.reproduce.descent import polak_ribiere
from tests.support.problems import lattice
from warp_peri.errors import InputError
from warp_peri.neural.material import NeuralOperator
from warp_peri.neural.placed import NeuralEquilibrium, evaluate
from warp_peri.points.points import Points
from warp_peri.points.samples import Samples
from warp_peri.solvers.equilibria import Equilibria

HORIZON = 3.0


def problem(precision=torch.float64):
    """A stable material, and displacement on the collar."""
    points = lattice(4, HORIZON)
    material = NeuralOperator(HORIZON, (6, 8), (10, 12), anisotropic=True, proportional=True)
    placed = material.to(precision).on(points)
    u = 0.03 * np.random.default_rng(1).normal(size=points.x.shape)
    u[points.interior] = 0
    return material, placed, u


def unbalanced(placed, u):
    """The force on the interior as a function of its displacement."""
    rows, field = torch.as_tensor(placed.bonds.rows), torch.as_tensor(u)
    return lambda inner: placed(field.index_copy(0, rows, inner))


def test_newton_and_conjugate_gradients_meet():
    _, placed, u = problem()
    found = NeuralEquilibrium(placed).from_rest(np.zeros_like(u), u, tolerance=1e-11)
    assert found.converged
    assert found.steps < 25
    again = NeuralEquilibrium(placed).solve(np.zeros_like(u), u, tolerance=1e-11)
    np.testing.assert_allclose(again.u, found.u, atol=1e-9 * abs(found.u).max())
    assert abs(placed(found.u)).max() < 1e-10 * abs(placed(u)).max()
    with torch.no_grad():
        inner, record = polak_ribiere(
            unbalanced(placed, u), torch.zeros(16, 2, dtype=torch.float64), tolerance=1e-10
        )
    assert record.converged
    np.testing.assert_allclose(inner, found.u[placed.bonds.rows], atol=1e-9 * abs(found.u).max())


def test_a_load_is_balanced():
    _, placed, u = problem()
    rows = placed.bonds.rows
    wanted = u.copy()
    wanted[rows] = 0.02 * np.random.default_rng(2).normal(size=(16, 2))
    b = np.zeros_like(u)
    b[rows] = placed(wanted)
    found = NeuralEquilibrium(placed).solve(b, u, tolerance=1e-12)
    np.testing.assert_allclose(found.u, wanted, atol=1e-9)


def test_the_way_from_rest(monkeypatch):
    """Uniform strain on the collar is found at once; where a search fails, in two parts."""
    _, placed, _ = problem()
    search, find, calls = NeuralEquilibrium(placed), Equilibria._found, []
    collar = ~placed.points.interior[:, None]
    stretched = placed.points.x @ np.array([[0.5, 0.1], [0.0, -0.2]])
    found = search.from_rest(0 * stretched, collar * stretched)
    assert found.steps == 1
    np.testing.assert_allclose(found.u, stretched, atol=1e-7)

    def failing(self, *given):
        calls.append(given)
        inner = find(self, *given)
        if len(calls) == 1:
            given[-1].residual = 1.0
        return inner

    monkeypatch.setattr(Equilibria, "_found", failing)
    uneven = stretched + 0.02 * np.sin(placed.points.x)
    again = search.from_rest(0 * stretched, uneven)
    assert len(calls) == 3
    assert again.converged
    assert abs(placed(again.u)).max() < 1e-6 * abs(placed(collar * uneven)).max()


def test_rounding_of_single_precision_is_an_equilibrium():
    """Its residual stays above the default tolerance, and is that of the numbers themselves."""
    _, exact, u = problem()
    b = np.zeros_like(u)
    expected = NeuralEquilibrium(exact).solve(b, u).u
    _, placed, _ = problem(torch.float32)
    found = NeuralEquilibrium(placed).solve(b, u)
    assert found.converged
    np.testing.assert_allclose(found.u, expected, atol=1e-5 * abs(expected).max())


def gradient(material, loss):
    material.zero_grad()
    loss()
    return torch.cat([part.grad.ravel() for part in material.parameters()])


def test_factors_survive_other_numbers():
    """A training changes the material under the search; old factors are only slower."""
    material, placed, u = problem()
    search = NeuralEquilibrium(placed)
    with torch.no_grad():
        for part in material.parameters():
            part *= 1.3
    found = search.solve(np.zeros_like(u), u, tolerance=1e-10)
    fresh = NeuralEquilibrium(placed).solve(np.zeros_like(u), u, tolerance=1e-10)
    assert found.converged
    np.testing.assert_allclose(found.u, fresh.u, atol=1e-9)


def test_a_sheet_without_a_collar_is_not_solved_for():
    """Its displacement is known up to a motion; its residual is told alone."""
    points = Points(np.argwhere(np.ones((7, 7))).astype(float), np.ones(49, bool), 1.0, box=(7, 7))
    material = NeuralOperator(HORIZON, (6, 8), (10, 12)).double()
    u = 0.03 * np.sin(2 * np.pi * points.x / 7)[None]
    errors = evaluate(material, Samples(points, u, 1.1 * material.on(points)(u)))
    assert errors["E_res"] == pytest.approx(1 / 11)
    assert "E_u" not in errors
    with pytest.raises(InputError, match="expected a collar"):
        material.on(points).rest(0 * u, u)


def test_what_is_refused():
    _, placed, u = problem()
    with pytest.raises(InputError, match="b: expected shape"):
        NeuralEquilibrium(placed).solve(np.zeros(3), u)
    for load, given, words in (
        (u[:3], u, "expected shape"),
        (np.stack([u, u]), u, "expected shape"),
        (np.nan * u, u, "expected finite"),
        (u, np.nan * u, "expected finite"),
    ):
        with pytest.raises(InputError, match=words):
            placed.rest(load, given)
