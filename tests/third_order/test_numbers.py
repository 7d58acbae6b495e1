"""The nonlinear model as numbers: its file, its weights, what is refused."""

import json
from dataclasses import replace

import numpy as np
import pytest

from tests.support.nonlinear import solid
from warp_peri import InputError, load
from warp_peri.materials.third_order import Smoothing
from warp_peri.points.families import bond_classes


def test_numbers_that_are_none_are_refused(tmp_path):
    for value in (np.nan, "1"):
        with pytest.raises(InputError, match="tq2: expected a finite number"):
            replace(solid("energy"), tq2=value)
    with pytest.raises(InputError, match="ridge: expected a number ≥ 0"):
        Smoothing(10.0, -0.1)
    with pytest.raises(InputError, match="radius: expected a number > 0"):
        Smoothing("wide")
    solid("energy").save(tmp_path / "m.json")
    content = json.loads((tmp_path / "m.json").read_text()) | {"linear": {}}
    (tmp_path / "m.json").write_text(json.dumps(content))
    with pytest.raises(InputError, match="linear: format: expected 'warp_peri.micromodulus'"):
        load(tmp_path / "m.json")


@pytest.mark.parametrize("ridge", [0.0, 0.1])
def test_filtered_form_takes_weights_that_undo_the_smoothing(ridge):
    smoothing, classes = Smoothing(10.0, ridge), bond_classes(5.0, 20.0)
    inward, outward = smoothing.weights(classes)
    for number in (0.05, 0.15, 0.25):
        angle = np.linspace(0, 2 * np.pi, 12, endpoint=False)
        k = number * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        sine = 2 * np.sin(k @ classes.xi.T)
        for p, factor, most in (
            (inward, smoothing.inverse, 0.1),  # kept small, for the sake of the proof
            (outward, smoothing.transform, 1e-3),
        ):
            symbol = sine @ (p[classes.bond_class, None] * classes.xi)
            wanted = k * factor(np.array([number]))
            assert np.abs(symbol - wanted).max() <= most * np.abs(wanted).max()
        assert smoothing.transform(np.array([number])) == pytest.approx(
            1 - number**2 * 0.3 * 100 / 4, abs=0.4 * (number * 10 / 3) ** 4
        )
    sigma = classes.count * classes.r**2
    assert [sigma @ p for p in (inward, outward)] == pytest.approx([1, 1])


def test_weights_of_a_gradient_go_to_other_units_and_a_proof_stays():
    model = solid("energy")
    assert model.in_units(("angstrom", "TPa")) is model
    other = model.in_units(("nm", "GPa"))
    here, there = (
        each.weights(bond_classes(h, 3 * h))[0] for each, h in ((model, 1), (other, 0.1))
    )
    np.testing.assert_allclose(there, 100 * here, rtol=1e-9)
    assert (other.proven_strain(0.1), other.proven_strain(0.2)) == (model.proven_strain(1.0), 0)
