"""Every gradient of every material: force, solve and simulate against central differences."""

from pathlib import Path
from re import MULTILINE, findall

import pytest

import warp_peri as wp
from tests.gradients import cases
from tests.support import filterwarnings, parametrize, refused, slow
from tests.support.fields import tensor
from tests.support.materials import FLOWS, LINEAR, OPERATORS, operator

pytestmark = filterwarnings("ignore::UserWarning")
NO_STEP = "expected a linear solid or a crystal"
REFUSED = {
    "third order, filtered": "form='energy', got 'filtered', whose force is no gradient",
    "neural operator": NO_STEP,
    "neural operator, frozen": NO_STEP,
    "hyperelastic": NO_STEP,
    "scattered, own weights": "expected a lattice, got scattered points",
    "cut": "simulate: expected a Cracked of a BrittleMaterial",
}
"""Materials whose waves have no proven step, and what `simulate` says of them."""
ELSEWHERE = {
    "BrittleMaterial": "at rest it is its model, and in steps it has no gradient",
    "SofteningMaterial": "tests/fracture/test_softening.py: pulls, to 1e-6",
    "EnsembleMaterial": "its operator is that of a member, which the table has",
    "NeuralFile": "a file of the neural operator",
}
"""Records of the library without rows, and why."""
QUICK = {
    "force": {*OPERATORS},
    "solve": {"LPS", "crystal", "crystal, periodic", "own", "LPS, broken bonds", "conductor", "cut",
              "crystal in space", "density"},
    "simulate": {"LPS", "LPS in space", "third order, energy", *FLOWS, *REFUSED},
}  # fmt: skip
"""Cells of the table that do not take seconds; `pytest tests/gradients -m ""` runs all."""


@parametrize(
    ("verb", "name"),
    [
        pytest.param(verb, name, marks=[slow] * (name not in QUICK[verb]))
        for verb in QUICK
        for name in OPERATORS
    ],
)
def test_a_gradient_is_that_of_differences(verb, name):
    """1e-8 to what the number is linear in before it is squared, 1e-6 elsewhere."""
    op = operator(name)
    if verb == "simulate" and name in REFUSED:
        leaf = tensor(op).requires_grad_()
        sizes = {"density": 2000.0, "step": 1e-6, "steps": 2}
        with refused(REFUSED[name]):
            wp.simulate(op, wp.Dirichlet(op.points, None, leaf), **sizes)
        return
    found = getattr(cases, verb)(name, op)
    assert found
    for key, error in found.items():
        linear = key in ("b", "u", "v", "signal", "collar") and name in LINEAR
        assert error <= (1e-8 if linear else 1e-6), (key, found)


def test_no_material_of_the_library_lacks_its_rows():
    files = Path(wp.__file__).parent.rglob("*.py")
    texts = "".join(path.read_text(encoding="utf-8") for path in files)
    kinds = set(findall(r'^class (\w+)\([^)]*format="warp_peri', texts, MULTILINE))
    shown = set()
    for op in map(operator, OPERATORS):
        shown |= {type(one).__name__ for one in (op.model, getattr(op, "home", None))}
    assert kinds - shown == set(ELSEWHERE)
