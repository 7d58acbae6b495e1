"""Selection of a sheet's material by frames held out, and the selected material's stress curves."""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Callable
from contextlib import nullcontext, suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import torch
from numpy.typing import ArrayLike
from scipy.optimize.elementwise import find_root
from scipy.special import ndtri, stdtrit

from warp_peri.errors import InputError
from warp_peri.files.atomic import finite, locked, parsed, plain, write_json, write_text
from warp_peri.files.checkpoint import fingerprint
from warp_peri.materials.hyperelastic.energies import EnergyTerm, Hyperelastic
from warp_peri.materials.hyperelastic.energy_fit import (
    ThicknessField,
    fibre_families,
    fibre_fan,
    fibres_of,
)
from warp_peri.materials.hyperelastic.from_displacement import (
    INTERPOLATES,
    DisplacementFit,
    check_enough,
    fit_displacement,
    stiffest_deviation,
)
from warp_peri.materials.hyperelastic.operator import HyperelasticMaterial, evaluate_hyperelastic
from warp_peri.points.arguments import Natural, checked, typed, typed_methods
from warp_peri.points.points import Samples, seen_of

COMPRESSIBLE = {"neo_hookean", "volumetric"}
INCOMPRESSIBLE = {"plane_stress", "mooney"}
BULK = 2000.0
"""Of an incompressible mixture, times C1 + C2: a thousand times the shear modulus."""


def kept_fit(
    path: Path | None, key: str, compute: Callable[[], DisplacementFit]
) -> DisplacementFit:
    """Read the fit that a file has of this key, or compute it and write it there."""
    with suppress(OSError, ValueError, TypeError, KeyError):
        if path is not None:
            kept = parsed(path.read_bytes())
            if kept["sha256"] == fingerprint(key, kept["fit"]):
                return _read(kept["fit"])
    found = compute()
    if path is not None:
        content = finite(plain(_content(found)))
        write_json(path, {"fit": content, "sha256": fingerprint(key, content)})
    return found


def _content(fit: DisplacementFit) -> dict[str, Any]:
    return vars(fit) | {
        "material": fit.material.content(),
        "thickness": fit.thickness and vars(fit.thickness),
        "others": [_content(other) for other in fit.others],
        "fields": None,
    }


def _read(content: dict[str, Any]) -> DisplacementFit:
    read = {
        "material": HyperelasticMaterial.from_dict(content["material"]),
        "errors": np.array(content["errors"], float),
        "thickness": content["thickness"] and ThicknessField(**content["thickness"]),
        "others": [_read(other) for other in content["others"]],
    }
    return DisplacementFit(**(content | read))


REACH = 3.0
NEAREST = ((0, 1), (1, 0), (1, 1), (1, -1))
DEVIATIONS = 0.05
"""Least, in units of the initial stiffness."""
STEPS, TOLERANCE = 10, 1e-3
"""Of a fit."""
UNEVEN = 2
"""Degree of the polynomial that is the logarithm of a thickness."""
DIRECTIONS, WORSE = 8, 1.2
"""Least directions that families of fibres are looked for in, and how many times worse than those
they may fit."""
LEAST_FRAMES = 4
SETTINGS = (REACH, NEAREST, DEVIATIONS, STEPS, TOLERANCE, UNEVEN)


@dataclass(frozen=True)
class Candidate:
    """One candidate material of a selection.

    Attributes:
        name, fit: of it, and what was learned; None where it failed.
        held_out: mean relative error of frames that it never saw; infinite where it failed.
        why: it failed, in its own words.
        numbers: that were learned.
    """

    name: str
    fit: DisplacementFit | None
    held_out: float
    why: str = ""
    numbers: int = 0


@typed_methods
@dataclass(frozen=True)
class ModelSelection:
    """Candidates, the best first: the one of fewest numbers among those that as many independent
    residuals cannot tell from the least error."""

    candidates: list[Candidate]

    @property
    def best(self) -> Candidate:
        """The best candidate."""
        return self.candidates[0]

    @property
    def fit(self) -> Any:
        """The best candidate's DisplacementFit."""
        return self.best.fit

    @property
    def material(self) -> Any:
        """The best candidate's material; its initial stiffness is one where no frame has a pull."""
        return self.fit.material

    def curves(
        self, stretches: ArrayLike, angle: float = 0.0, level: float = 0.9
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Nominal stress of uniaxial tension along a direction [rad], and the ends of its band. The
        band is of each learned frame left out, by Student's distribution, of the misfit of frames
        that were never seen, and of the scatter of the scale: no error that all frames share.
        Raises InputError where deviations, which are no material, explain the frames."""
        n = len(others := [other.material for other in self.fit.others])
        if (times := stiffest_deviation(self.fit)) > INTERPOLATES:
            raise InputError(
                f"frames: deviations came out {times:.0f} times as stiff as the sheet at rest and "
                "explain the frames in the place of a material, which has no curves then"
            )
        middle = uniaxial_stress(self.material, stretches, angle)
        if n < 2:
            return middle, np.full_like(middle, np.nan), np.full_like(middle, np.nan)
        values = np.array([uniaxial_stress(other, stretches, angle) for other in others])
        deviation = stdtrit(n - 1, (1 + level) / 2) * np.sqrt(n - 1) * values.std(axis=0)
        misfit = np.hypot(self.best.held_out, self.fit.scatter)
        half = np.hypot(deviation, ndtri((1 + level) / 2) * misfit * middle)
        return middle, middle - half, middle + half


@typed
def select_model(
    frames: Samples,
    *,
    fibres: Natural = 0,
    uneven: bool = True,
    folder: str | os.PathLike[str] | None = None,
    done: Callable[[Candidate], None] = lambda _: None,
    progress: bool = False,
) -> ModelSelection:
    """Select a sheet's material, learning candidates from every second frame, the last included.

    Args:
        frames: without loads, in the order of the test.
        fibres: directions, at least 8, that families of fibres are looked for in; 0 for none.
        uneven: whether each is tried with a thickness that varies, too.
        folder: keeps each fit as it ends; those of the same frames and settings are reused.
        done: called with each candidate as it ends.
        progress: show a bar for each fit, with the candidate's name, and what the folder held.

    A candidate that fails is passed over and says why; from a folder it is tried again. Raises
    InputError for fewer than four frames, where every candidate fails, as it does with fewer than
    ten interior nodes for each of its numbers, or for a folder that another job writes to.
    """
    if len(frames) < LEAST_FRAMES:
        raise InputError(f"frames: expected at least {LEAST_FRAMES}, got {len(frames)}")
    pick = np.arange(len(frames))[::-1] % 2 == 0
    train, test = frames[pick], frames[~pick]
    tried: list[Candidate] = []
    with locked(folder) if folder is not None else nullcontext():
        for name, (terms, degree) in _candidates(fibres, uneven).items():
            key = fingerprint(SETTINGS, frames, terms, degree)
            stem = f"{name.replace(', ', '_').replace(' ', '_')}_{key[:12]}"
            path = None if folder is None else Path(folder) / f"{stem}.fit.json"
            dictionary = Hyperelastic(REACH, (), NEAREST, terms)
            even = (c.fit for c in tried if c.fit and c.fit.material.dictionary == dictionary)
            learn = partial(
                fit_displacement, train, stiffness=DEVIATIONS, thickness=degree, most_steps=STEPS,
                tolerance=TOLERANCE, progress=progress and name,
            )  # fmt: skip
            fit = partial(
                kept_fit, path, key, partial(_learned, learn, dictionary, next(even, None))
            )
            tried.append(_tried(name, fit, dictionary, degree, train, test))
            done(tried[-1])
    least = min(candidate.held_out for candidate in tried)
    alike = least * (1 + 2 / np.sqrt(2 * np.count_nonzero(seen_of(test)[:, test.interior])))
    tried.sort(key=lambda c: (c.held_out > alike, c.held_out if c.held_out > alike else c.numbers))
    if tried[0].fit is None:
        raise InputError("frames: no material fits them; " + "; ".join(c.why for c in tried))
    return ModelSelection(tried)


def _candidates(fibres: int, uneven: bool) -> dict[str, tuple[tuple[EnergyTerm, ...], int]]:
    """Terms and thickness degree of the candidates by name."""
    matrix = EnergyTerm("plane_stress")
    kinds = {"neo-Hookean": (matrix,), "Mooney-Rivlin": (matrix, EnergyTerm("mooney"))}
    kinds["Yeoh"] = (matrix, *(EnergyTerm("yeoh", exponent=p) for p in (2.0, 3.0)))
    if fibres:
        kinds["families of fibres"] = (matrix, *fibre_fan(max(fibres, DIRECTIONS), (2.0, 4.0)))
    found = {name: (terms, 0) for name, terms in kinds.items()}
    if uneven:
        found |= {f"{name}, heterogeneous": (terms, UNEVEN) for name, terms in kinds.items()}
    return found


def _tried(
    name: str,
    learn: Callable[[], DisplacementFit],
    dictionary: Hyperelastic,
    degree: int,
    train: Samples,
    test: Samples,
) -> Candidate:
    """A candidate, fitted or failed."""
    numbers = len(dictionary) + (len(ThicknessField.over(train.x, degree).names) if degree else 0)
    try:
        check_enough(int(np.count_nonzero(train.interior)), "interior nodes", numbers)
        fit = learn()
        found = fit.material.dictionary
        numbers += len(found) - len(dictionary) + 2 * len(fibres_of(found))
        thickness = None if fit.thickness is None else fit.thickness.at(test.x)
        near = train.u if fit.fields is None else fit.fields
        errors: Any = evaluate_hyperelastic(fit.material, test, thickness=thickness, near=near)
        if missing := errors["not_solved"]:
            return Candidate(name, fit, np.inf, f"{name}: {missing} frames not solved", numbers)
        return Candidate(name, fit, float(errors["E_u"]), "", numbers)
    except OSError:  # a full disk is no fault of the candidate
        raise
    except Exception as error:  # solvers below run into anything; the others go on
        return Candidate(name, None, np.inf, f"{name}: {error}", numbers)


def _learned(
    learn: Callable[..., DisplacementFit], dictionary: Hyperelastic, start: DisplacementFit | None
) -> DisplacementFit:
    """Learn a material; fibres in fixed directions become families, (H15)."""
    wide = learn(dictionary, start=start)
    directions = len({term.angle for term in dictionary.terms if term.is_fibre})
    for within in (1.6 * np.pi / directions, 0.0) if directions else ():
        found, c = fibre_families(wide.material, within=within)
        fit = learn(found, moving=True, start=c)
        if fit.history[-1] < WORSE * wide.history[-1]:
            return fit
    return wide


@typed
def uniaxial_stress(
    solid: HyperelasticMaterial, stretches: ArrayLike, angle: float = 0.0
) -> np.ndarray:
    """Nominal stress of a uniform sheet under uniaxial tension along a direction [rad],
    [stretches].

    The other principal direction is free; shear across them is not let go. Raises InputError for
    stretches at which no width is free of stress.
    """
    c, s, along = np.cos(angle), np.sin(angle), checked("stretches", stretches)
    if not (along > 0).all():
        raise InputError(f"stretches: expected numbers > 0, got {along.min():g}")
    coefficients = torch.from_numpy(solid.coefficients)

    def stress(across: np.ndarray, along: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Stresses along the direction and across."""
        a, b = along**2, across**2
        E = (
            np.stack([c * c * a + s * s * b - 1, s * s * a + c * c * b - 1, 2 * c * s * (a - b)])
            / 2
        )
        q = torch.from_numpy(E).requires_grad_()
        energy = (coefficients @ solid.dictionary.uniform(q)).sum()
        x, y, shear = torch.autograd.grad(energy, q)[0].numpy()
        turn = 2 * c * s * shear
        return along * (c * c * x + s * s * y + turn), across * (s * s * x + c * c * y - turn)

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
    solid with bonds, or with energies beside these and fibre exponentials.
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
    """Write the material's FEBio element to a file, whole or not at all."""
    write_text(path, febio_material(solid) + "\n")


@typed
def material_terms(solid: HyperelasticMaterial) -> list[tuple[EnergyTerm, float]]:
    """Strain energies with their coefficients, those at nodes and corners added."""
    sums: dict[EnergyTerm, float] = {}
    values = solid.coefficients[solid.dictionary.first_term :].tolist()
    for term, value in zip(solid.dictionary.terms, values):
        own = replace(term, corner=False)
        sums[own] = sums.get(own, 0.0) + value
    return [(term, value) for term, value in sums.items() if value]


@typed
def in_words(solid: HyperelasticMaterial) -> list[str]:
    """Describe the coefficients in words, one line for each."""
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
