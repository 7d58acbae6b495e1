"""An uneven sheet of finite elements: what an even material and a thickness make of it."""

from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("skfem")

from tests.support.sheets import NEAREST, square, waves
from tools.hyperelastic_elements import Elements, quadrilaterals
from tools.hyperelastic_energies import plane_stress_hgo
from tools.make_leaflet import Leaflet
from warp_peri.materials.hyperelastic.energies import EnergyTerm, Hyperelastic
from warp_peri.materials.hyperelastic.from_displacement import fit_displacement, fit_thickness
from warp_peri.materials.hyperelastic.placed import evaluate_hyperelastic
from warp_peri.points.samples import Samples

MATRIX = Hyperelastic(3.0, (), NEAREST, (EnergyTerm("plane_stress"), EnergyTerm("volumetric")))
POINTS = square(5)


def thickness(x, uneven):
    """No exponential of a polynomial."""
    return Leaflet(uneven=uneven).thickness(x - POINTS.x.mean(axis=0))


def frames(uneven, seeds):
    """Frames of a stretched sheet of elements."""
    mesh = Elements(quadrilaterals(8, 1.6))
    mesh.dx = mesh.dx * thickness(mesh.quadrature, uneven)
    fields = []
    for seed in seeds:
        edge = mesh.x @ np.array([[-0.05, 0.05], [0.0, 0.25]])
        edge += waves(SimpleNamespace(x=mesh.x), 0.1, seed)
        given = edge.ravel()[mesh.edge]
        u = mesh.solve(plane_stress_hgo(1.0), np.zeros(2 * mesh.nodes), mesh.edge, given, steps=2)
        fields.append(mesh.sample(u, POINTS.x))
    return Samples(POINTS, np.stack(fields))


@pytest.mark.filterwarnings("ignore:stretch")  # the second sheet is pulled farther
def test_a_thickness_is_told_from_the_material():
    train, test, other = frames(0.4, (0, 1)), frames(0.4, (2,)), frames(-0.4, (3, 4))
    with pytest.warns(UserWarning, match="is the sheet heterogeneous"):
        fit_displacement(train, MATRIX, most_steps=6)
    even = fit_displacement(train, MATRIX, most_steps=6, stiffness=(0.05, 5.0))
    fit = fit_displacement(train, MATRIX, thickness=2, most_steps=6)
    as_even = evaluate_hyperelastic(even.material, test)["E_u"]
    as_thick = evaluate_hyperelastic(fit.material, test, thickness=fit.thickness.at(test.x))["E_u"]
    assert as_thick < as_even / 4
    gap = np.log(fit.thickness.at(test.x) / thickness(test.x, 0.4))[test.interior]
    assert np.ptp(gap) < 0.02
    assert np.ptp(np.log(thickness(POINTS.x[test.interior], 0.4))) > 0.3
    first, second = (Samples(POINTS, u[None]) for u in other.u)
    own = fit_thickness(first, fit.material)
    carried = evaluate_hyperelastic(fit.material, second)["E_u"]
    with_own = evaluate_hyperelastic(fit.material, second, thickness=own.thickness.at(POINTS.x))[
        "E_u"
    ]
    assert with_own < carried / 20
