"""A hyperelastic solid as a material that FEBio reads, where one fits."""

from __future__ import annotations

import os
from collections import defaultdict
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np

from warp_peri.errors import InputError
from warp_peri.files.atomic import write_text
from warp_peri.materials.hyperelastic.energies import EnergyTerm
from warp_peri.materials.hyperelastic.operator import HyperelasticMaterial
from warp_peri.points.arguments import typed

COMPRESSIBLE = {"neo_hookean", "volumetric"}
INCOMPRESSIBLE = {"plane_stress", "mooney"}
BULK = 2000.0
"""Of an incompressible mixture, times C1 + C2: a thousand times the shear modulus."""


def febio_material(solid: HyperelasticMaterial) -> str:
    """The material as an XML element of FEBio's Material section.

    With neo_hookean and volumetric energies it is a mixture of "HGO unconstrained" without fibres
    and "fiber-exp-pow" for each family, which is the learned energy exactly in plane strain. With
    plane_stress and mooney it is an incompressible mixture ("Mooney-Rivlin" and
    "fiber-exp-pow-uncoupled"), the learned energy exactly in plane stress and in the limit of its
    bulk modulus. Deviations, which belong to the lattice, are left out.

    Raises InputError for a solid with bonds, or with energies beside these and fibre exponentials.
    """
    if np.any(solid.coefficients[: solid.dictionary.first_deviation]):
        raise InputError("solid: expected no bond energies, which FEBio does not know")
    active, fibre = material_terms(solid), "fiber-exp-pow"
    matrix = {term.kind: value for term, value in active if term.kind != "fibre_exponential"}
    c = defaultdict(float, matrix)
    root = ElementTree.Element("material", id="1", name="sheet", type="solid mixture")
    if matrix and set(matrix) <= INCOMPRESSIBLE:
        root.set("type", "uncoupled solid mixture")
        fibre += "-uncoupled"
        _numbers(root, k=BULK * sum(matrix.values()))
        ground = {"c1": c["plane_stress"], "c2": c["mooney"]}
        _numbers(ElementTree.SubElement(root, "solid", type="Mooney-Rivlin"), **ground)
    elif matrix and set(matrix) <= COMPRESSIBLE:
        ground = {"k1": 0.0, "k2": 1.0, "gamma": 0.0, "kappa": 0.0}
        ground |= {"c": 2 * c["neo_hookean"], "k": 2 * c["volumetric"]}
        _numbers(ElementTree.SubElement(root, "solid", type="HGO unconstrained"), **ground)
    else:
        raise InputError(
            "solid: expected neo_hookean and volumetric, or plane_stress and mooney, and fibre "
            f"exponentials; got {', '.join(sorted({term.kind for term, _ in active}))}"
        )
    for term, value in active:
        if term.kind == "fibre_exponential":
            family = ElementTree.SubElement(root, "solid", type=fibre)
            _numbers(family, ksi=value, alpha=term.exponent, beta=2.0)
            axis = ElementTree.SubElement(family, "fiber", type="angles")
            _numbers(axis, theta=np.rad2deg(term.angle), phi=90.0)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode")


def _numbers(parent: ElementTree.Element, **numbers: float) -> None:
    for key, value in numbers.items():
        ElementTree.SubElement(parent, key).text = repr(float(value))


@typed
def save_febio(solid: HyperelasticMaterial, path: str | os.PathLike[str]) -> None:
    """Write that element to a file, whole or not at all."""
    write_text(path, febio_material(solid) + "\n")


@typed
def material_terms(solid: HyperelasticMaterial) -> list[tuple[EnergyTerm, float]]:
    """Energies of uniform strain with their coefficients; nodes and corners are one material."""
    sums: dict[EnergyTerm, float] = {}
    values = solid.coefficients[solid.dictionary.first_term :].tolist()
    for term, value in zip(solid.dictionary.terms, values):
        own = replace(term, corner=False)
        sums[own] = sums.get(own, 0.0) + value
    return [(term, value) for term, value in sums.items() if value]


@typed
def in_words(solid: HyperelasticMaterial) -> list[str]:
    """What the coefficients say, one line for each number."""
    active, matrix, fibres = material_terms(solid), list[str](), list[str]()
    values = defaultdict(float, {term.kind: value for term, value in active})
    told = {"fibre_power": "{:.4g}, power {:.3g}", "fibre_exponential": "k1 = {:.4g}, k2 = {:.3g}"}
    for term, value in active:
        if value > 0 and term.is_fibre:
            at = np.rad2deg(np.mod(term.angle, np.pi))
            fibres.append(f"fibres at {at:.1f}°: {told[term.kind].format(value, term.exponent)}")
    if values["neo_hookean"]:
        shear, bulk = 2 * values["neo_hookean"], values["volumetric"]
        ratio = 3 * bulk / shear  # (1 + ν)/(1 − 2ν) of the published energy
        nu = (ratio - 1) / (2 * ratio + 1)
        matrix.append(f"matrix: shear modulus {shear:.4g}, volumetric coefficient {bulk:.4g}")
        matrix.append(f"as the published energy: E = {2 * shear * (1 + nu):.4g}, ν = {nu:.3g}")
    C1, C2 = values["plane_stress"], values["mooney"]
    if C1 or C2:
        more = f" (Mooney and Rivlin: C1 = {C1:.4g}, C2 = {C2:.4g})" if C2 else ""
        matrix.append(f"incompressible matrix: shear modulus {2 * (C1 + C2):.4g}{more}")
    return matrix + fibres
