"""A third-order crystal as numbers: its energy, its weights, other lattices, learning, refusals."""

from copy import deepcopy
from dataclasses import replace

import numpy as np

from tests.crystal.crystals import cubic_tensor, dispersive
from tests.support import approx, assert_refused, near, parametrize, refused, sup, warned
from tests.support.clouds import cloud
from tests.support.nonlinear import FORMS, TENSOR, solid
from tests.support.problems import OTHER, lattice, loaded, smooth
from warp_peri import Crystal, ThirdOrder, fit
from warp_peri.core.elastic import voigt
from warp_peri.materials.crystal_fit import fit_dispersion
from warp_peri.materials.third_order import Smoothing
from warp_peri.points.families import bond_classes

REACH = 3.0
POINTS = replace(lattice(11, REACH), axis=20.0)


def made(law, size, count):
    return loaded(law.on(POINTS), size * smooth(POINTS.x, count, wave_number=0.8))


def test_on_other_spacings_and_in_other_units_it_keeps_what_is_the_materials():
    law, fine = solid("energy"), replace(lattice(5, REACH, 0.75), axis=20.0)
    there = law.on(fine).model
    assert there.numbers == approx(law.numbers, rel=1e-6, abs=0)
    assert there.proven_strain(0.75) > 0.3 * law.proven_strain(1.0) > law.proven_strain(0.75) == 0
    own = replace(law, linear=replace(law.linear, tensors=2 * law.linear.tensors))
    assert deepcopy(law).on(fine).model.lame == there.lame
    near(own.on(fine).model.lame, 2 * np.array(law.lame), 1e-6)
    other = law.in_units(OTHER)
    assert (other.proven_strain(0.1), other.proven_strain(0.2)) == (law.proven_strain(1.0), 0)


@parametrize("ridge", [0.0, 0.1])
def test_filtered_form_takes_weights_that_undo_the_smoothing(ridge):
    smoothing, classes = Smoothing(10.0, ridge), bond_classes(5.0, 20.0)
    weights = smoothing.weights(classes)
    angle = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    for number in (0.05, 0.15, 0.25):
        k = number * np.c_[np.cos(angle), np.sin(angle)]
        sine = 2 * np.sin(k @ classes.xi.T)
        small = number**2 * 0.3 * 100 / 4  # of a cone, to fourth order
        known = smoothing.transform(np.array([number]))
        assert known == approx(1 - small, abs=0.4 * (number * 10 / 3) ** 4)
        # that of the data is kept small, for the sake of the proof
        for p, factor, most in zip(weights, (smoothing.inverse(number), known), (0.1, 1e-3)):
            wanted = k * factor
            wrong = sine @ (p[classes.bond_class, None] * classes.xi) - wanted
            assert sup(wrong) <= most * sup(wanted)
    assert [classes.count * classes.r**2 @ p for p in weights] == approx([1, 1])


@parametrize("form", FORMS)
def test_what_made_the_data_is_found_again(form):
    law = solid(form)
    recipe = ThirdOrder(Crystal(REACH, moduli=voigt(TENSOR)), law.smoothing, form)
    with warned(r"the training data reach .*; a larger ridge"):
        found = fit(made(law, 0.05, 6), recipe)
    model = found.material
    assert found.history["largest_gradient"] > model.proven_strain(1.0)
    assert model.numbers == approx(law.numbers, rel=1e-6, abs=0)
    near(model.linear.tensors, law.linear.tensors, 1e-7)
    assert found.errors["E_res"] < 1e-8
    near(model.proven["strain"], law.proven["strain"], 1e-4)
    hexagonal = replace(recipe, linear=replace(recipe.linear, symmetry="6mm"))
    found = fit(made(law, 1e-3, 6), hexagonal).material
    assert found.on(POINTS) is not None  # whose axis is that of the data
    with refused("axis: the crystal stands at"):
        found.on(replace(POINTS, axis=0.0))


def test_what_does_not_fit_is_refused():
    law, one = solid("energy"), made(solid("energy"), 0.01, 1)
    C, linear, smoothed = cubic_tensor(2), Crystal(REACH), Smoothing(2.0)
    square = fit_dispersion(dispersive(C), 1.0, REACH, symmetry="4mm", tensor=C)
    unturned = replace(one, points=replace(one.points, axis=None))
    uncertified = replace(law, linear=replace(law.linear, certificate=None))
    assert_refused({
        "isotropic long waves": lambda: replace(law, linear=square),
        "certificate": lambda: uncertified.on(POINTS),
        "form: expected one of filtered, energy, got 'both'": lambda: replace(law, form="both"),
        r"\[S, 529, 2\], S ≥ 1": lambda: law.on(POINTS)(POINTS.x[None, :0]),
        "crystal is for lattices": lambda: law.on(cloud(2, REACH)),
        "transfer=False, and": lambda: law.on(lattice(2, REACH, 0.75), transfer=False),
        "moduli: expected some":
            lambda: fit(one, ThirdOrder(Crystal(REACH, moduli=None), smoothed)),
        "one set": lambda: fit(2 * [one], ThirdOrder(linear, smoothed)),
        "axis: expected Points.* orientation is given":
            lambda: fit(unturned, ThirdOrder(Crystal(REACH, orientation=np.eye(2)), smoothed)),
    })  # fmt: skip
