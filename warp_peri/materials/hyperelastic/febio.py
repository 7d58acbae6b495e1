"""A hyperelastic solid as a material that FEBio reads, where one fits."""

from __future__ import annotations

import os
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np

from warp_peri.errors import InputError
from warp_peri.files.atomic import write_text
from warp_peri.materials.hyperelastic.energies import FIBRES, EnergyTerm
from warp_peri.materials.hyperelastic.operator import HyperelasticMaterial
from warp_peri.points.arguments import typed

COMPRESSIBLE = {"neo_hookean", "volumetric"}
INCOMPRESSIBLE = {"plane_stress", "mooney"}


def febio_material(solid: HyperelasticMaterial) -> str:
    """The material as an XML element of FEBio's Material section.

    With neo_hookean and volumetric energies it is a mixture of "HGO unconstrained" without fibres
    and "fiber-exp-pow" for each family, which is the learned energy exactly in plane strain. With
    plane_stress and mooney it is an incompressible mixture ("Mooney-Rivlin" and
    "fiber-exp-pow-uncoupled"), the learned energy exactly in plane stress and in the limit of its
    bulk modulus, which is set to a thousand times the shear modulus. Deviations, which
    belong to the lattice, are left out.

    Args:
        solid: whose only other energies are fibre exponentials.

    Raises InputError for a solid with bonds or with energies that FEBio has no name for.
    """
    if np.any(solid.coefficients[: solid.dictionary.first_deviation]):
        raise InputError("solid: expected no bond energies, which FEBio does not know")
    active = material_terms(solid)
    matrix = {term.kind: value for term, value in active if term.kind != "fibre_exponential"}
    if not matrix or not (set(matrix) <= COMPRESSIBLE or set(matrix) <= INCOMPRESSIBLE):
        raise InputError(
            "solid: expected neo_hookean and volumetric, or plane_stress and mooney, and fibre "
            f"exponentials; got {', '.join(sorted({term.kind for term, _ in active}))}"
        )
    root = _ground(matrix)
    kind = "fiber-exp-pow-uncoupled" if set(matrix) <= INCOMPRESSIBLE else "fiber-exp-pow"
    for term, value in active:
        if term.kind == "fibre_exponential":
            fibre = ElementTree.SubElement(root, "solid", type=kind)
            for key, number in (("ksi", value), ("alpha", term.exponent), ("beta", 2.0)):
                _number(fibre, key, number)
            axis = ElementTree.SubElement(fibre, "fiber", type="angles")
            _number(axis, "theta", np.rad2deg(term.angle))
            _number(axis, "phi", 90.0)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode")


def _ground(matrix: dict[str, float]) -> ElementTree.Element:
    """The mixture with its matrix."""
    if set(matrix) <= INCOMPRESSIBLE:
        numbers = {"c1": matrix.get("plane_stress", 0.0), "c2": matrix.get("mooney", 0.0)}
        root = ElementTree.Element("material", id="1", name="sheet", type="uncoupled solid mixture")
        _number(root, "k", 2000 * sum(numbers.values()))
        ground = ElementTree.SubElement(root, "solid", type="Mooney-Rivlin")
    else:
        root = ElementTree.Element("material", id="1", name="sheet", type="solid mixture")
        ground = ElementTree.SubElement(root, "solid", type="HGO unconstrained")
        numbers = {"k1": 0.0, "k2": 1.0, "gamma": 0.0, "kappa": 0.0}
        numbers |= {"c": 2 * matrix.get("neo_hookean", 0.0), "k": 2 * matrix.get("volumetric", 0.0)}
    for key, value in numbers.items():
        _number(ground, key, value)
    return root


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
    values = dict.fromkeys(COMPRESSIBLE | INCOMPRESSIBLE, 0.0)
    matrix, fibres = list[str](), list[str]()
    for term, value in material_terms(solid):
        if term.kind in values:
            values[term.kind] = value
        elif value > 0 and term.kind in FIBRES:
            told = (
                "{:.4g}, power {:.3g}" if term.kind == "fibre_power" else "k1 = {:.4g}, k2 = {:.3g}"
            )
            at = np.rad2deg(np.mod(term.angle, np.pi))
            fibres.append(f"fibres at {at:.1f}°: {told.format(value, term.exponent)}")
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


def _number(parent: ElementTree.Element, key: str, value: float) -> None:
    ElementTree.SubElement(parent, key).text = repr(float(value))
