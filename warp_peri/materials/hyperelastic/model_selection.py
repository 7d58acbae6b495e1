"""Selection of a sheet's material by frames held out, and the selected material's stress curves."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any
from xml.etree import ElementTree

import numpy as np
import torch
from numpy import ndarray
from numpy.typing import ArrayLike
from scipy.optimize.elementwise import find_root
from scipy.special import ndtri, stdtrit

from warp_peri.core.torch_bridge import own_torch
from warp_peri.errors import InputError, StrPath, Values
from warp_peri.files.atomic import write_text
from warp_peri.materials.hyperelastic.energies import NEAREST, EnergyTerm, Hyperelastic
from warp_peri.materials.hyperelastic.fibres import fibre_families, fibre_fan, fibres_of
from warp_peri.materials.hyperelastic.operator import HyperelasticMaterial
from warp_peri.materials.hyperelastic.sheet_fit import (
    INTERPOLATES,
    SheetFit,
    check_enough,
    fit_sheet,
)
from warp_peri.points.arguments import Natural, Options, Share, checked, typed, typed_methods
from warp_peri.points.dataset import seen_of
from warp_peri.points.points import Samples

COMPRESSIBLE = {"neo_hookean", "volumetric"}
INCOMPRESSIBLE = {"plane_stress", "mooney"}
BULK = 2000.0
"""Of an incompressible mixture, times C1 + C2: a thousand times the shear modulus."""
REACH = 3.0
STEPS, TOLERANCE = 10, 1e-3
"""Of a fit."""
UNEVEN = 2
"""Degree of the polynomial that is the logarithm of a thickness."""
DIRECTIONS, WORSE = 8, 1.2
"""Least directions that fibre families are looked for in; how many times worse these may fit."""
LEAST_FRAMES = 4


@typed_methods
@dataclass(frozen=True)
class Candidate:
    """One candidate material of a selection.

    Attributes:
        name, fit: of it, and what was learned, whose material has an initial stiffness of one where
            no frame has a pull; None where it failed.
        held_out: mean relative error of frames that it never saw; infinite where it failed.
        why: it failed, in its own words.
        numbers: that were learned.
    """

    name: str
    fit: Any
    held_out: float
    why: str = ""
    numbers: int = 0

    def curves(
        self, stretches: ArrayLike, angle: float = 0.0, level: Share = 0.9
    ) -> tuple[ndarray, ndarray, ndarray]:
        """Nominal stress of uniaxial tension along a direction [rad], and the ends of its band. The
        band is of each learned frame left out, by Student's distribution, of the misfit of frames
        that were never seen, and of the scatter of the scale: no error that all frames share.
        Raises InputError where deviations, which are no material, explain the frames."""
        if (times := self.fit.stiffest_deviation) > INTERPOLATES:
            raise InputError(
                f"frames: deviations came out {times:.0f} times as stiff as the sheet at rest and "
                "explain the frames in the place of a material, which has no curves then"
            )
        fits = self.fit, *self.fit.others
        middle, *values = (uniaxial_stress(one.material, stretches, angle) for one in fits)
        half = np.full_like(middle, np.nan)
        if (n := len(values)) > 1:
            deviation = stdtrit(n - 1, (1 + level) / 2) * np.sqrt(n - 1) * np.std(values, axis=0)
            misfit = np.hypot(self.held_out, self.fit.scatter)
            half = np.hypot(deviation, ndtri((1 + level) / 2) * misfit * middle)
        return middle, middle - half, middle + half


@typed
def select_model(
    frames: Samples,
    *,
    fibres: Natural = 0,
    uneven: bool = True,
    done: Callable[[Candidate], None] = lambda _: None,
    progress: bool = False,
) -> list[Candidate]:
    """Select a sheet's material, learning candidates from every second frame, the last included.

    Args:
        frames: without loads, in the order of the test.
        fibres: directions, at least 8, that families of fibres are looked for in, no more than
            there are interior nodes; 0 for none.
        uneven: whether each is tried with a thickness that varies, too.
        done: called with each candidate as it ends.
        progress: show a bar for each fit, with the candidate's name.

    Returns the candidates, the best first: the one of fewest numbers among those that as many
    independent residuals cannot tell from the least error. One that fails is passed over and says
    why. Raises InputError for fewer than four frames, and where every candidate fails, as it does
    with fewer than ten interior nodes for each of its numbers.
    """
    if len(frames) < LEAST_FRAMES:
        raise InputError(f"frames: expected at least {LEAST_FRAMES}, got {len(frames)}")
    if fibres and not (most := np.count_nonzero(frames.interior)) >= fibres >= DIRECTIONS:
        words = f"0 or at least {DIRECTIONS} directions, at most {most}, one for each interior node"
        raise InputError(f"fibres: expected {words}, got {fibres}")
    pick = np.arange(len(frames))[::-1] % 2 == 0
    moved = frames.u[:, frames.interior].any(axis=(1, 2))  # of rest no error is told
    train, test = frames[pick], frames[~pick & moved]
    matrix, even = EnergyTerm("plane_stress"), Values()
    kinds = {"neo-Hookean": (matrix,), "Mooney-Rivlin": (matrix, EnergyTerm("mooney"))}
    kinds["Yeoh"] = (matrix, *(EnergyTerm("yeoh", exponent=p) for p in (2.0, 3.0)))
    if fibres:
        kinds["families of fibres"] = (matrix, *fibre_fan(fibres, (2.0, 4.0)))
    tried = []
    for degree in (0, UNEVEN) if uneven else (0,):
        for kind, terms in kinds.items():
            name = f"{kind}, heterogeneous" if degree else kind
            dictionary = Hyperelastic(REACH, NEAREST, terms)
            how = {"thickness": degree, "progress": progress and name}
            tried.append(_tried(name, dictionary, train, test, even.get(kind), how))
            done(tried[-1])
            fit = tried[-1].fit
            even[kind] = fit if fit and fit.material.dictionary == dictionary else None
    least = min(candidate.held_out for candidate in tried)
    alike = least * (1 + 2 / np.sqrt(2 * np.count_nonzero(seen_of(test)[:, test.interior])))
    tried.sort(key=lambda candidate: (max(candidate.held_out, alike), candidate.numbers))
    if least == np.inf:
        raise InputError("frames: no material fits them; " + "; ".join(c.why for c in tried))
    return tried


def _tried(
    name: str,
    dictionary: Hyperelastic,
    train: Samples,
    test: Samples,
    start: SheetFit | None,
    how: Options,
) -> Candidate:
    """A candidate, fitted or failed."""
    numbers = len(dictionary) + how["thickness"] * (how["thickness"] + 3) // 2  # of a polynomial
    try:
        check_enough(int(np.count_nonzero(train.interior)), "interior nodes", numbers)
        fit = _learned(train, dictionary, start, how)
        found = fit.material.dictionary
        numbers += len(found) - len(dictionary) + 2 * len(fibres_of(found))
        thickness = None if fit.thickness is None else fit.thickness.at(test.x)
        operator = fit.material.on(test.points, thickness=thickness)
        errors = operator.errors(test, train.u if fit.fields is None else fit.fields)
        if missing := errors["not_solved"]:
            return Candidate(name, fit, np.inf, f"{name}: {missing} frames not solved", numbers)
        return Candidate(name, fit, float(errors["E_u"]), "", numbers)
    except OSError:  # a full disk is no fault of the candidate
        raise
    except Exception as error:  # solvers below run into anything; the others go on
        return Candidate(name, None, np.inf, f"{name}: {error}", numbers)


def _learned(
    train: Samples, dictionary: Hyperelastic, start: SheetFit | None, how: Options
) -> SheetFit:
    """Learn a material; fibres in fixed directions become families, (H15)."""
    how = {"most_steps": STEPS, "tolerance": TOLERANCE, **how}
    wide = fit_sheet(train, dictionary, start=start, **how)
    directions = len({term.angle for term in dictionary.terms if term.is_fibre})
    for within in (1.6 * np.pi / directions, 0.0) if directions else ():
        found, c = fibre_families(wide.material, within=within)
        fit = fit_sheet(train, found, moving=True, start=c, **how)
        if fit.residual < WORSE * wide.residual:
            return fit
    return wide


@typed
@own_torch()
def uniaxial_stress(
    solid: HyperelasticMaterial, stretches: ArrayLike, angle: float = 0.0
) -> ndarray:
    """Nominal stress of a uniform sheet in uniaxial tension along a direction [rad], [stretches].

    The other principal direction is free; shear across them is not let go. Raises InputError for
    stretches at which no width is free of stress.
    """
    c, s, along = np.cos(angle), np.sin(angle), checked("stretches", stretches, shape=("n",))
    if not (along > 0).all():
        raise InputError(f"stretches: expected numbers > 0, got {along.min():g}")
    coefficients = torch.tensor(solid.coefficients)

    def stress(across: ndarray, along: ndarray) -> list[ndarray]:
        """Stresses along the direction and across: slopes of the energy by the two stretches."""
        ends = [torch.tensor(one, requires_grad=True) for one in (along, across)]
        a, b = (one**2 for one in ends)
        q = [c * c * a + s * s * b - 1, s * s * a + c * c * b - 1, 2 * c * s * (a - b)]
        energy = (coefficients @ solid.dictionary.uniform(torch.stack(q) / 2)).sum()
        return [one.numpy() for one in torch.autograd.grad(energy, ends)]

    between = 0.3 / along, np.full_like(along, 1.3)
    found = find_root(lambda *both: stress(*both)[1], between, args=(along,))
    if not found.success.all():
        raise InputError("stretches: expected such as the sheet can have, free across")
    return stress(found.x, along)[0]


def febio_material(solid: HyperelasticMaterial) -> str:
    """Convert the material to an XML element of FEBio's Material section.

    With neo_hookean and volumetric energies it is a mixture of "HGO unconstrained" without fibres
    and "fiber-exp-pow" for each family, which is the learned energy exactly in plane strain. With
    plane_stress and mooney it is an incompressible mixture ("Mooney-Rivlin" and
    "fiber-exp-pow-uncoupled"), the learned energy exactly in plane stress and in the limit of its
    bulk modulus. Deviations, which belong to the lattice, are left out. Raises InputError for a
    solid with energies beside these and fibre exponentials.
    """
    active, fibre = material_terms(solid), "fiber-exp-pow"
    matrix = {t.label: value for t, value in active if t.kind != "fibre_exponential" or t.step}
    c = defaultdict(float, matrix)
    root = ElementTree.Element("material", id="1", name="sheet", type="solid mixture")
    if matrix and set(matrix) <= INCOMPRESSIBLE:
        root.set("type", "uncoupled solid mixture")
        fibre += "-uncoupled"
        _numbers(root, k=BULK * sum(matrix.values()))
        ground = {"c1": c["plane_stress"], "c2": c["mooney"]}
        _numbers(ElementTree.SubElement(root, "solid", type="Mooney-Rivlin"), **ground)
    elif matrix and set(matrix) <= COMPRESSIBLE:
        ground = {"c": 2 * c["neo_hookean"], "k": 2 * c["volumetric"]}
        none = {"k1": 0.0, "k2": 1.0, "gamma": 0.0, "kappa": 0.0}
        _numbers(ElementTree.SubElement(root, "solid", type="HGO unconstrained"), **none, **ground)
    else:
        raise InputError(
            "solid: expected neo_hookean and volumetric, or plane_stress and mooney, and fibre "
            f"exponentials; got {', '.join(sorted({term.label for term, _ in active}))}"
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
def save_febio(solid: HyperelasticMaterial, path: StrPath) -> None:
    """Write the material's FEBio element to a file, whole or not at all."""
    write_text(path, febio_material(solid) + "\n")


@typed
def material_terms(solid: HyperelasticMaterial) -> list[tuple[EnergyTerm, float]]:
    """Strain energies with their coefficients, those at nodes and corners added, bonds apart."""
    sums = defaultdict[EnergyTerm, float](float)
    values = solid.coefficients[solid.dictionary.first_term :].tolist()
    for term, value in zip(solid.dictionary.terms, values):
        sums[replace(term, corner=False, step=() if term.corner else term.step)] += value
    return [(term, value) for term, value in sums.items() if value]


@typed
def in_words(solid: HyperelasticMaterial) -> list[str]:
    """Describe the coefficients in words, one line for each."""
    active, matrix, fibres = material_terms(solid), list[str](), list[str]()
    values = defaultdict(float, {term.label: value for term, value in active})
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
