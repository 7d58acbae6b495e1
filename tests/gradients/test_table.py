"""Every gradient of every material: force, solve and move against central differences."""

import re
from pathlib import Path

import pytest
import torch

import warp_peri as wp
from tests.conformance.test_gradients import LINEAR, OPERATORS, field
from tests.gradients.cases import CASES, ELSEWHERE, FLOWS, MATERIALS, REFUSED, WAVES

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")
FIELDS = ("b", "u", "v", "signal", "collar")


@pytest.fixture(scope="module")
def made():
    """Every operator once."""
    kept = {}
    return lambda name: kept.setdefault(name, OPERATORS[name]())


SOLVED_LONG = ("LPS in space", "third order, filtered",
               "neural operator", "coupled", "scattered, own weights",
               "third order, energy", "hyperelastic", "LPS, bond-based",
               "neural operator, frozen")  # fmt: skip
MOVED = ("LPS",)
LONG = [
    *(("solve", name) for name in SOLVED_LONG),
    *(("simulate", name) for name in WAVES if name not in MOVED),
]
"""Cells of the table that take seconds; `pytest tests/gradients -m ""` runs all."""
CELLS = [
    pytest.param(verb, name, marks=[pytest.mark.slow] * ((verb, name) in LONG), id=f"{verb}-{name}")
    for verb in CASES
    for name in MATERIALS
]


@pytest.mark.parametrize(("verb", "name"), CELLS)
def test_a_gradient_is_that_of_differences(verb, name, made):
    """1e-8 to what the number is linear in before it is squared, 1e-6 elsewhere."""
    op = made(name)
    if verb == "simulate" and name not in WAVES + FLOWS:
        leaf = torch.from_numpy(field(op)).requires_grad_()
        sizes = {"density": 2000.0, "step": 1e-6, "steps": 2}
        with pytest.raises(wp.InputError, match=REFUSED[name]):
            wp.simulate(op, wp.Dirichlet(op.points, None, leaf), **sizes)
        return
    found = CASES[verb](name, op)
    assert found
    for key, error in found.items():
        linear = key in FIELDS and name in LINEAR
        assert error <= (1e-8 if linear else 1e-6), (verb, name, key)


def test_no_material_of_the_library_lacks_its_rows(made):
    files = Path(wp.__file__).parent.rglob("*.py")
    texts = "".join(path.read_text(encoding="utf-8") for path in files)
    kinds = set(re.findall(r'^class (\w+)\([^)]*format="warp_peri', texts, re.MULTILINE))
    shown = set()
    for op in map(made, MATERIALS):
        shown |= {type(one).__name__ for one in (op.model, getattr(op, "home", None))}
    assert kinds - shown == set(ELSEWHERE)
