"""Every gradient of every material: force, solve and move against central differences."""

import pytest
import torch

import warp_peri as wp
from tests.conformance.test_gradients import LINEAR, OPERATORS, field
from tests.gradients.cases import CASES, FOUND, MATERIALS, REFUSED, VERBS, WAVES

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")
FIELDS = ("b", "u", "v", "signal")


@pytest.fixture(scope="module")
def made():
    """Every operator once."""
    kept = {}
    return lambda name: kept.setdefault(name, OPERATORS[name]())


LONG = [
    ("solve", "dressed, finite strain"),
    *(("move", name) for name in ("LPS in space", "crystal in space", "dressed, bonds")),
]
CELLS = [
    pytest.param(verb, name, marks=[pytest.mark.slow] * ((verb, name) in LONG), id=f"{verb}-{name}")
    for verb in VERBS
    for name in MATERIALS
]


@pytest.mark.parametrize(("verb", "name"), CELLS)
def test_a_gradient_is_that_of_differences(verb, name, made):
    """1e-8 to what the number is linear in before it is squared, 1e-6 elsewhere."""
    op = made(name)
    if verb == "move" and name not in WAVES:
        FOUND[name, verb] = {f"refused: {REFUSED[name]}": None}
        leaf = torch.from_numpy(field(op)).requires_grad_()
        sizes = {"density": 2000.0, "step": 1e-6, "steps": 2}
        with pytest.raises(wp.InputError, match=REFUSED[name]):
            wp.move(op, wp.Dirichlet(op.points, None, leaf), **sizes)
        return
    found = FOUND[name, verb] = CASES[verb](name, op)
    assert found
    for key, error in found.items():
        linear = key in FIELDS and name in LINEAR
        assert error <= (1e-8 if linear else 1e-6), (verb, name, key)
