"""Dictionaries and solids: places of coefficients, files, what is refused."""

import numpy as np
import pytest

from tests.support.sheets import everything, hgo_dictionary
from warp_peri import InputError, Model
from warp_peri.materials.hyperelastic.energies import (
    Dictionary,
    HyperelasticSolid,
    Term,
    half_family,
    strain_weights,
)


def test_every_coefficient_has_a_label_of_its_own():
    dictionary = everything()
    assert len(set(dictionary.labels)) == len(dictionary)
    assert dictionary.labels[dictionary.first_deviation].startswith("deviation")
    assert dictionary.labels[dictionary.first_term] == "quadratic 11,11"


def test_the_seventy_five_numbers():
    terms = [Term(f"quadratic {pair}") for pair in ("11,11", "22,22", "12,12")]
    dictionary = Dictionary(3.0, ("square", "cube", "tension"), (), tuple(terms))
    assert dictionary.classes == 14
    assert len(dictionary) == 45


def test_terms_without_a_coefficient_can_go():
    solid = HyperelasticSolid(hgo_dictionary(), np.array([0, 0, 0, 0.1, 0.07, 0.0, 0.2]), 0.1)
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


def test_what_no_solid_has_is_refused(tmp_path):
    with pytest.raises(InputError, match="fibre_power: expected an exponent"):
        Term("fibre_power", 0.0, 1.0)
    with pytest.raises(InputError, match="bonds of a half family"):
        Dictionary(3.0, (), ((-1, 0),))
    with pytest.raises(InputError, match="at least one energy"):
        Dictionary()
    with pytest.raises(InputError, match="coefficients: expected finite values, got nan"):
        HyperelasticSolid(hgo_dictionary(), np.full(7, np.nan), 0.1)
    with pytest.raises(InputError, match="coefficients: expected 7 numbers"):
        HyperelasticSolid(hgo_dictionary(), np.ones(6), 0.1)
    Model(0.3, 0.8, 1.0, [1.0], 3.0).save(tmp_path / "other.json")
    with pytest.raises(InputError, match="expected a HyperelasticSolid, got a Model"):
        HyperelasticSolid.load(tmp_path / "other.json")


def test_flags_of_a_file_are_true_or_false(tmp_path):
    path = tmp_path / "solid.json"
    HyperelasticSolid(hgo_dictionary(), np.ones(7), 0.1).save(path)
    path.write_text(path.read_text().replace('"corner": false', '"corner": "no"'))
    with pytest.raises(InputError, match="corner: expected true or false, got 'no'"):
        HyperelasticSolid.load(path)
