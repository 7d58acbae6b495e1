"""Verbs that take every material for which they mean something, and ask of points once."""

import numpy as np
import pytest

import warp_peri as wp
from tests.conformance.test_laws import LAWS, solved_samples
from tests.support.plates import plate
from warp_peri.core import pointwise
from warp_peri.materials import lps_force as bonds
from warp_peri.materials.hyperelastic import operator as tissue

pytestmark = pytest.mark.filterwarnings("ignore:strain:UserWarning")


def of(name, side=4):
    law = LAWS[name]
    material, points = law.material(), law.points(side)
    op = material.on(points)
    return material, op, solved_samples(law, op, points)


@pytest.mark.parametrize("name", LAWS)
def test_errors_are_those_of_the_operator(name):
    material, op, samples = of(name)
    of_material, of_operator = wp.evaluate(material, samples), wp.evaluate(op, samples)
    assert of_material.keys() == of_operator.keys()
    assert of_material["E_u"] == of_operator["E_u"] < 1e-8


def counted(monkeypatch, module, name):
    """How often a function of a module is called from now on."""
    calls, function = [], getattr(module, name)

    def call(*arguments, **options):
        calls.append(name)
        return function(*arguments, **options)

    monkeypatch.setattr(module, name, call)
    return calls


@pytest.mark.parametrize("name", LAWS)
def test_no_samples_have_no_answers(name):
    points = LAWS[name].points(4)
    none = np.empty((0, *points.x.shape))
    found = wp.solve(LAWS[name].material(), wp.Dirichlet(points, none, none))
    assert found.u.shape == none.shape


@pytest.mark.parametrize(
    ("name", "linked"),
    [
        ("LPS", (bonds, "families_of")),
        ("third order, energy", (pointwise, "grid_of")),
        ("hyperelastic", (tissue, "SheetLattice")),
    ],
)
def test_a_material_is_placed_once(name, linked, monkeypatch):
    material, op, samples = of(name)
    made = counted(monkeypatch, *linked)
    op = material.on(samples.points)
    wp.evaluate(op, samples)
    wp.solve(op, wp.Dirichlet(samples.points, samples.b, samples.u))
    assert len(made) == 1


def test_a_linear_part_is_certified_and_its_material_diagnosed():
    material, op, _ = of("LPS")
    expected = wp.certify(material, spacing=1.0)
    assert wp.certify(op) == expected
    cubic, on, samples = of("third order, energy")
    many = wp.Samples(samples.points, *(np.tile(f, (4, 1, 1)) for f in (samples.u, samples.b)))
    assert wp.certify(cubic, spacing=1.0) == wp.certify(on) == wp.certify(cubic.linear, spacing=1)
    assert wp.diagnose(material, many).residual > 1e-3
    assert wp.diagnose(cubic, many).causes == ["rounding"]


def test_what_a_verb_does_not_mean_is_refused_by_name():
    solid, _, samples = of("hyperelastic")
    many = wp.Samples(samples.points, *(np.tile(f, (4, 1, 1)) for f in (samples.u, samples.b)))
    for verb, call in {
        "certify": lambda: wp.certify(solid, spacing=0.1),
        "diagnose": lambda: wp.diagnose(solid, many),
        "prove_uniqueness": lambda: wp.certificates.prove_uniqueness(solid, spacing=0.1),
    }.items():
        with pytest.raises(wp.InputError, match=f"{verb}: expected .*, got HyperelasticMaterial"):
            call()
    with pytest.raises(wp.InputError, match="evaluate: expected a material.*, got Points"):
        wp.evaluate(samples.points, samples)
    with pytest.raises(
        wp.InputError, match="evaluate: transfer: not among .* HyperelasticMaterial"
    ):
        wp.evaluate(solid, samples, transfer=False)


def test_a_body_refuses_what_it_does_not_take():
    material, _, _ = of("LPS")
    body = wp.Body(plate(3.0, 12.0, 2, 8), displacement={"sides": (0, 0)})
    with pytest.raises(wp.InputError, match=r"solver: expected none for a Body.*, got Direct\("):
        wp.solve(material, body, solver=wp.Direct())
    for option in ("transfer", "coupling", "tolerance"):
        with pytest.raises(wp.InputError, match=f"among allow_uncertified, got {option}"):
            wp.solve(material, body, **{option: False})
