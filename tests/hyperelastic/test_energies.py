"""Dictionaries and solids: places of coefficients, files, what is refused."""

import numpy as np
import pytest

from tests.support.sheets import everything, hgo_dictionary
from warp_peri import InputError
from warp_peri.materials.hyperelastic.energies import (
    EnergyTerm,
    Hyperelastic,
    HyperelasticMaterial,
    half_family,
    strain_weights,
)


def test_every_coefficient_has_a_place_and_a_label():
    dictionary = everything()
    assert len(set(dictionary.labels)) == len(dictionary)
    assert dictionary.labels[dictionary.first_deviation].startswith("deviation")
    assert dictionary.labels[dictionary.first_term] == "quadratic 11,11"
    terms = tuple(EnergyTerm(f"quadratic {pair}") for pair in ("11,11", "22,22", "12,12"))
    assert len(Hyperelastic(3.0, ("square", "cube", "tension"), (), terms)) == 14 * 3 + 3


def test_terms_without_a_coefficient_can_go():
    solid = HyperelasticMaterial(hgo_dictionary(), np.array([0, 0, 0, 0.1, 0.07, 0.0, 0.2]), 0.1)
    assert [term.kind for term in solid.sparse.dictionary.terms] == [
        "neo_hookean",
        "fibre_exponential",
    ]
    assert solid.sparse.coefficients.tolist() == [0, 0, 0, 0.1, 0.07, 0.2]


@pytest.mark.parametrize("reach", [2.5, 3.0, 4.0])
def test_weights_reproduce_uniform_strain_and_no_fourth_moment(reach):
    x, y = half_family(reach).T
    w = strain_weights(reach, 4)
    for power, expected in (((2, 0), [1, 0, 0]), ((0, 2), [0, 1, 0]), ((1, 1), [0, 0, 1])):
        np.testing.assert_allclose(2 * (x ** power[0] * y ** power[1]) @ w, expected, atol=1e-9)
    for n in range(5):
        np.testing.assert_allclose((x**n * y ** (4 - n)) @ w, 0, atol=1e-9)


def solid(c):
    return HyperelasticMaterial(hgo_dictionary(), c, 0.1)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: EnergyTerm("ogden"), "kind: expected one of"),
        (lambda: EnergyTerm("fibre_power", 0.0, 1.0), "fibre_power: expected an exponent"),
        (lambda: Hyperelastic(3.0, (), ((-1, 0),)), "bonds of a half family"),
        (lambda: Hyperelastic(), "at least one energy"),
        (lambda: solid(np.full(7, np.nan)), "coefficients: expected finite values, got nan"),
        (lambda: solid(np.ones(6)), "coefficients: expected 7 numbers"),
    ],
)
def test_what_no_solid_has_is_refused(call, words):
    with pytest.raises(InputError, match=words):
        call()


def test_flags_of_a_file_are_true_or_false(tmp_path):
    path = tmp_path / "solid.json"
    solid(np.ones(7)).save(path)
    path.write_text(path.read_text().replace('"corner": false', '"corner": "no"'))
    with pytest.raises(InputError, match="corner: expected true or false, got 'no'"):
        HyperelasticMaterial.load(path)
