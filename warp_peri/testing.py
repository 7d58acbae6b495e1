"""Checks that every material must pass, as functions of a material, points and a field.

Whoever keeps a material in a package of their own calls `check_material` in its tests. Each check
raises AssertionError, with the numbers that differ.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import torch
from numpy import ndarray
from numpy.linalg import norm

from warp_peri.core.elastic import central_weights
from warp_peri.points.arguments import Units, factors
from warp_peri.points.dataset import in_units
from warp_peri.points.points import Points, Samples
from warp_peri.verbs import load, save

STEP = 1e-3
"""Of central differences, as a share of the largest displacement."""
REACH = 4
"""Steps to either side that a central difference takes, of an order twice that."""


def check_material(
    material: Any, points: Points, u: ndarray, *, read: Callable[[Path], Any] = load
) -> None:
    """Run all checks below on a material.

    Args:
        material: what `fit` or `load` gives.
        points: a lattice with a collar, in the material's units.
        u: displacement, shape [N, d], at which it is differentiated.
        read: of its file; `DensityMaterial.read` with the energy.
    """
    operator = material.on(points)
    check_force(operator, u)
    check_energy(operator, u)
    check_product(operator, u)
    check_units(material, points, u)
    check_file(material, points, u, read=read)


def check_force(operator: Any, u: ndarray) -> None:
    """Check the force's shape, that translation causes none, and that fields do not mix."""
    f, shift = operator(u), np.full_like(u, np.abs(u).max())
    assert_near(operator(shift), 0 * u[operator.points.interior], 1e-11, np.abs(f).max())
    assert_near(operator(np.stack([shift, u]))[1], f, 1e-13)


def check_energy(operator: Any, u: ndarray) -> None:
    """Check that the force is the derivative of the energy, where there is one."""
    if operator.energy(u) is None:
        return
    points, v = operator.points, _direction(operator, u, 0)
    work = points.spacing**points.dimension * (operator(u) * v[points.interior]).sum()
    assert_near(work, _slope(lambda t: operator.energy(u + t * v), STEP), 1e-8)


def check_product(
    operator: Any, u: ndarray, *, step: float = STEP, tolerance: float = 1e-8
) -> None:
    """Check that `jvp` is the force's derivative, `vjp` its transpose, and torch's gradient."""
    v, w = _direction(operator, u, 1), np.random.default_rng(2).normal(size=operator(u).shape)
    along, back = operator.jvp(u, v), operator.vjp(u, w)
    assert_near(along, _slope(lambda t: operator(u + t * v), step), tolerance)
    size = float(norm(along) * norm(w))
    assert_near((along * w).sum(), (v * back).sum(), 1e-12, size)
    given = torch.from_numpy(u).requires_grad_()
    (found,) = torch.autograd.grad(operator(given), given, torch.from_numpy(w))
    assert_near(found.numpy(), back, 1e-12)


def check_units(material: Any, points: Points, u: ndarray, other: Units = ("nm", "GPa")) -> None:
    """Check that force, stress and the material are the same after a change of units and back."""
    operator, there = material.on(points), material.in_units(other)
    length, stress = factors(points.units, other)
    samples = in_units(Samples(points, u[None]), other)
    theirs = there.on(samples.points)
    assert_near(theirs(samples.u[0]), operator(u) * stress / length, 1e-12)
    if operator.stress(u) is not None:
        assert_near(theirs.stress(samples.u[0]), operator.stress(u) * stress, 1e-12)
    assert_near(there.in_units(points.units).on(points)(u), operator(u), 1e-13)


def check_file(
    material: Any, points: Points, u: ndarray, *, read: Callable[[Path], Any] = load
) -> None:
    """Check that a material that was saved and read again gives the same bits."""
    with TemporaryDirectory() as folder:
        path = Path(folder, "material.json")
        save(path, material)
        assert_near(read(path).on(points)(u), material.on(points)(u), 0.0)


def assert_near(actual: Any, expected: Any, tolerance: float, size: float | None = None) -> None:
    """Check equal shapes, and numbers within a share of `size`, by default the largest expected."""
    expected = np.asarray(expected)
    limit = tolerance * (np.abs(expected).max(initial=0.0) if size is None else size)
    np.testing.assert_equal(np.shape(actual), expected.shape)
    np.testing.assert_allclose(actual, expected, rtol=0, atol=limit, equal_nan=False)


def _direction(operator: Any, u: ndarray, seed: int) -> ndarray:
    """A rough field on the interior, as large as u."""
    v = np.random.default_rng(seed).uniform(-1, 1, size=u.shape)
    return np.where(operator.points.interior[:, None], v * np.abs(u).max(), 0.0)


def _slope(value: Callable[[float], Any], step: float) -> Any:
    """Derivative at 0 by differences."""
    pairs = enumerate(central_weights(REACH), start=1)
    return sum(c * (value(n * step) - value(-n * step)) for n, c in pairs) / step
