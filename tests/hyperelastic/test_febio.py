"""The material as FEBio's energy: its own formula gives the learned energy back."""

from xml.etree import ElementTree

import numpy as np
import pytest

from tests.support.sheets import hgo_dictionary, square
from warp_peri.materials.hyperelastic.energies import EnergyTerm, Hyperelastic
from warp_peri.materials.hyperelastic.febio import febio_material, in_words, save_febio
from warp_peri.materials.hyperelastic.operator import HyperelasticMaterial

SOLID = HyperelasticMaterial(
    hgo_dictionary(), np.array([0.3] * 4 + [0.0713, 0.0780, 0.2]), 0.1
)  # deviations vanish in uniform strain


def of_febio(text, F):
    """Energy of "HGO unconstrained" and "fiber-exp-pow" in plane strain, from FEBio's manual."""
    C, J = F.T @ F, np.linalg.det(F)
    total = 0.0
    for solid in ElementTree.fromstring(text).iter("solid"):
        p = {child.tag: float(child.text) for child in solid if child.tag != "fiber"}
        if solid.get("type") == "HGO unconstrained":
            total += p["c"] / 2 * (np.trace(C) + 1 - 3) - p["c"] * np.log(J)
            total += p["k"] / 2 * ((J**2 - 1) / 2 - np.log(J))
        else:
            theta = np.deg2rad(float(solid.find("fiber/theta").text))
            n = np.array([np.cos(theta), np.sin(theta)])
            x = max(n @ C @ n - 1, 0.0)
            scale = p["ksi"] / (p["alpha"] * p["beta"])
            total += scale * np.expm1(p["alpha"] * x ** p["beta"])
    return total


def test_the_energy_is_the_learned_one():
    F = np.array([[0.8, 0.0], [0.3, 1.4]])
    op = SOLID.on(square(1))
    (learned,) = op.nodal_energy(op.points.x @ (F - np.eye(2)).T)[op.interior]
    assert of_febio(febio_material(SOLID), F) == pytest.approx(float(learned), rel=1e-10)


def test_a_sheet_in_plane_stress_becomes_incompressible(tmp_path):
    terms = (
        EnergyTerm("plane_stress"),
        EnergyTerm("mooney"),
        EnergyTerm("fibre_exponential", 0.5, 2.0),
    )
    solid = HyperelasticMaterial(Hyperelastic(3.0, (), (), terms), np.array([3.5, 1.5, 15.0]), 0.1)
    save_febio(solid, tmp_path / "sheet.xml")
    root = ElementTree.parse(tmp_path / "sheet.xml").getroot()
    assert root.get("type") == "uncoupled solid mixture"
    assert [float(root.find(f"solid/{name}").text) for name in ("c1", "c2")] == [3.5, 1.5]
    assert in_words(solid) == [
        "incompressible matrix: shear modulus 10 (Mooney and Rivlin: C1 = 3.5, C2 = 1.5)",
        "fibres at 28.6°: k1 = 15, k2 = 2",
    ]
    words = in_words(SOLID)
    assert words[0] == "matrix: shear modulus 0.1426, volumetric coefficient 0.078"
    assert words[1].startswith("as the published energy: E = 0.3279, ν = 0.15")
