"""Third-order constants on micromodulus tensors: force, proof, learning, files."""

from dataclasses import replace

import numpy as np
import pytest
import torch

import warp_peri
from tests.crystal.crystals import cubic_tensor, dispersive
from tests.support.clouds import cloud
from tests.support.nonlinear import LAM, MU, TENSOR, psi, solid
from tests.support.problems import lattice, smooth
from warp_peri import fit
from warp_peri.core.elastic import voigt
from warp_peri.errors import InputError
from warp_peri.materials.crystal_fit import Crystal, fit_dispersion
from warp_peri.materials.third_order import Smoothing, energy_density
from warp_peri.materials.third_order_fit import ThirdOrder
from warp_peri.points.samples import Samples

REACH = 3.0
AXIS = 20.0


@pytest.fixture(scope="module", params=["filtered", "energy"])
def law(request):
    return solid(request.param)


def nodes(interior=5, spacing=1.0, angle=0.0):
    return replace(lattice(interior, REACH * spacing, spacing, angle), axis=AXIS)


def loaded(law, points, size, count=1, seed=0, wave_number=0.8):
    """Smooth fields in equilibrium with a law."""
    u = size * smooth(points.x, count, seed, wave_number=wave_number)
    b = np.zeros_like(u)
    b[:, points.interior] = law.on(points)(u)
    return Samples(points, u, b)


def test_the_energy_is_that_of_the_green_strain(law):
    H = 0.3 * np.random.default_rng(0).normal(size=(20, 2, 2))
    small = (H + H.swapaxes(1, 2)) / 2
    E = torch.from_numpy(small + H.swapaxes(1, 2) @ H / 2)
    numbers = dict(zip(("lam", "mu", "t3", "tq2", "q3"), law.numbers))
    linear = LAM / 2 * np.trace(small, axis1=1, axis2=2) ** 2 + MU * (small**2).sum(axis=(1, 2))
    density = energy_density(E, axis=0.3, **numbers).numpy() - linear
    np.testing.assert_allclose(density, psi(H, law, 0.3), rtol=1e-11)


def test_on_other_spacings_it_keeps_moduli_and_constants_and_is_proven_anew(law):
    fine = lattice(5, REACH, 0.75)
    operator = law.on(replace(fine, axis=AXIS))
    np.testing.assert_allclose(operator.model.numbers, law.numbers, rtol=1e-6)
    assert operator.model.proven_strain(0.75) > 0.3 * law.proven_strain(1.0) > 0
    assert law.proven_strain(0.75) == 0
    with pytest.raises(InputError, match="spacing"):
        law.on(replace(fine, axis=AXIS), transfer=False)(0 * fine.x)


def test_what_made_the_data_is_found_again(law):
    points = nodes(11)
    samples = loaded(law, points, 0.05, count=6)
    recipe = Crystal(REACH, moduli=voigt(TENSOR))
    with pytest.warns(UserWarning, match=r"the training data reach .*; a larger ridge"):
        found = fit(samples, ThirdOrder(recipe, law.smoothing, law.form))
    model = found.material
    assert found.history["largest_gradient"] > model.proven_strain(1.0)
    np.testing.assert_allclose(model.numbers, law.numbers, rtol=1e-6)
    size = np.abs(law.linear.tensors).max()
    np.testing.assert_allclose(model.linear.tensors, law.linear.tensors, atol=1e-7 * size)
    assert found.errors["E_res"] < 1e-8
    assert model.proven["strain"] == pytest.approx(law.proven["strain"], rel=1e-4)


def test_what_does_not_fit_is_refused():
    law, points, other = solid("energy"), nodes(), cubic_tensor(2)
    square = fit_dispersion(dispersive(other), 1.0, REACH, symmetry="4mm", tensor=other)
    with pytest.raises(InputError, match="isotropic long waves"):
        replace(law, linear=square)
    with pytest.raises(InputError, match="certificate"):
        replace(law, linear=replace(law.linear, certificate=None)).on(points)
    with pytest.raises(InputError, match="form"):
        replace(law, form="both")
    for u in (points.x[:-1], points.x[None, :0], np.zeros((0, *points.x.shape))):
        with pytest.raises(InputError, match=r"u: expected float64 of shape \[S, 289, 2\]"):
            law.on(points)(u)
    with pytest.raises(InputError, match="a third-order crystal is for lattices"):
        law.on(cloud(2, REACH))
    samples, linear = loaded(law, points, 0.01), Crystal(REACH)
    for asked, words in (
        ((linear, None), "smoothing"),
        ((Crystal(REACH, moduli=None), Smoothing(2.0)), "moduli"),
        ((linear, Smoothing(2.0), "auto"), "form: expected one of filtered, energy, got 'auto'"),
        ((warp_peri.LPS(REACH), Smoothing(2.0)), "linear: expected Crystal, got LPS"),
    ):
        with pytest.raises(InputError, match=words):
            fit(samples, ThirdOrder(*asked))
    with pytest.raises(InputError, match="one set"):
        fit([samples, samples], ThirdOrder(linear, Smoothing(2.0)))
