"""References of strips and a bar with cracks against quadratic elements refined at the tips."""

import numpy as np
import pytest

from tests.known_problems.rows import chosen
from tests.known_problems.statics import plane

fem = pytest.importorskip("skfem")
helpers = pytest.importorskip("skfem.helpers")
WIDE, HIGH, LEVELS, STEP = 26.0, 78.0, 8, 0.02
"""The strip or half of it, half its height, how often its tip is refined, shift of the tip."""


def potential(mesh, tip, kind):
    """Potential energy of half a strip under unit tension, or of half a bar that is bent."""
    lam, mu = plane(1.0, 0.3).C12, plane(1.0, 0.3).C44
    element = fem.ElementVector(fem.ElementTriP2())
    basis = fem.Basis(mesh, element, intorder=4)

    @fem.BilinearForm
    def energy(u, v, w):
        e, f = (helpers.sym_grad(field) for field in (u, v))
        trace = helpers.trace
        return lam * trace(e) * trace(f) + 2 * mu * helpers.ddot(e, f)

    top = mesh.facets_satisfying(lambda x: np.abs(x[1] - HIGH) < 1e-9)
    pull = fem.LinearForm(lambda v, w: v[1]).assemble(fem.FacetBasis(mesh, element, facets=top))
    bent = kind.startswith("bend")  # half a unit force on the middle, against a support
    ends = [basis.nodal_dofs[0, [np.argmin(np.abs(mesh.p.T - x).sum(axis=1))]]
            for x in ([WIDE, 0], [0, 2 * WIDE])]  # fmt: skip
    if bent:
        pull = -0.5 * (np.arange(len(pull)) == ends[0])
    side = 1 if kind == "double edge crack" else -1  # of the tip where the ligament is
    whole = mesh.facets_satisfying(lambda x: (x[1] < 1e-12) & (side * (tip - x[0]) > 0))
    held = [basis.get_dofs(whole).all("u^2")]
    if bent:
        held.append(ends[1])
    else:
        middle = mesh.facets_satisfying(lambda x: x[0] < 1e-12)
        held.append(basis.get_dofs(middle).all("u^1"))
    u = fem.solve(*fem.condense(energy.assemble(basis), pull, D=np.concatenate(held)))
    return -pull @ u / 2


@pytest.mark.parametrize("kind", ["double edge crack", "bend bar of ASTM E399"])
def test_references_are_what_refined_elements_say(kind):
    tip = WIDE / 2
    mesh = fem.MeshTri.init_tensor(np.linspace(0, WIDE, 13), np.linspace(0, HIGH, 22))
    for level in range(1, LEVELS + 1):
        away = np.hypot(*(mesh.p[:, mesh.t].mean(axis=1) - [[tip], [0]]))
        mesh = mesh.refined(np.flatnonzero(away < WIDE * 0.6**level))
    energies = []
    for shift in (-STEP, STEP):
        moved = mesh.p.copy()
        moved[0] += shift * np.clip((10 - np.hypot(moved[0] - tip, moved[1])) / 8, 0, 1)
        energies.append(potential(fem.MeshTri(moved, mesh.t), tip + shift, kind))
    longer = -1 if kind == "double edge crack" else 1
    G = -2 * longer * (energies[1] - energies[0]) / (2 * STEP)  # of both halves
    (row,) = (one for one in chosen([f"{kind}: LPS"]) if one.problem == kind)
    size = WIDE / 16 if kind.startswith("bend") else 1 / (np.pi * tip)
    assert np.sqrt(G * size) == pytest.approx(row.reference, rel=2e-3)
