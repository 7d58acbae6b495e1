"""Fit of a crystal's material to its structure and calculator, with errors and a figure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import ase
import numpy as np
from matplotlib.figure import Figure
from numpy import ndarray
from numpy.linalg import eigh, eigvalsh, inv, norm

from warp_peri.atoms.calculator_noise import PULLED, SMALLER, by_strains, joined
from warp_peri.atoms.calculators import Asked
from warp_peri.atoms.force_constants import STEP, WIDER, ForceConstants
from warp_peri.atoms.phonons import at_zone_edge, check_phonons, counted, force_constants
from warp_peri.atoms.relaxed import Reference, at_rest, oriented, smallest, usual_spacing
from warp_peri.core.elastic import (
    Symmetry,
    acoustic,
    allowed_tensors,
    brackets_from_elastic,
    compliance,
    directions,
    named_moduli,
    point_group,
    stress_brackets,
    voigt,
)
from warp_peri.core.stencil import half_ball
from warp_peri.errors import Arrays, InputError, Rows, Shown, Values, quietly, warn
from warp_peri.fitting.regression import relative
from warp_peri.materials.crystal import CrystalMaterial
from warp_peri.materials.crystal_fit import check_beside, fit_phonons, symmetry_of
from warp_peri.materials.transfer import WaveSymbol
from warp_peri.points import arguments
from warp_peri.points.arguments import USUAL, Pair, Positive, Units, check_units, offered, typed

PATHS = {2: ("10", "01", "11"), 3: ("100", "110", "111", "001")}
"""Directions that are drawn, along the axes of the nodes."""
REACH = {2: 3.0, 3: 6**0.5}
"""Horizons over the spacing: 28 bonds in the plane, 80 in space."""
WITHIN = 0.02
"""Relative error of the answer to a plane wave that a law is said to hold with."""
MANY = 30
"""Spacings of a cell that is not relaxed, in no horizon."""
RULES = 0.1
"""Of force constants, and of the largest modulus, that broken rules may change."""
APART = 9.0
"""χ² of each modulus by two ways, beyond which their errors do not explain their difference."""
AGREE, TOO_FAR = 0.02, 0.2
"""Relative difference of two ways to the same moduli: worth a word above, refused above."""
SIZES, DIRECTIONS = 80, 60
"""Of the waves that are looked at for it."""
TOLD = 6, 3
"""Wavelengths [spacings] whose error is told."""


@arguments.typed_methods
@dataclass(frozen=True, eq=False, repr=False)
class CrystalFit(Shown):
    """Fitted material of a crystal, what it was learned from, and how it compares.

    Attributes:
        material: the crystal's material with its certificate.
        atoms: force constants of the crystal at rest.
        strained: C_ijkl [TPa] by finite strains of the cell, [d, d, d, d], or None.
        said: notes on what was found or chosen, by name.
    """

    material: CrystalMaterial
    atoms: ForceConstants
    strained: ndarray | None
    said: dict[str, str]

    @property
    def certificate(self) -> Any:
        """Certificate of the material."""
        return self.material.certificate

    @cached_property
    def law(self) -> CrystalMaterial:
        """Fitted material in Å and TPa, the units of the force constants."""
        return self.material.in_units(USUAL)

    @cached_property
    def tensor(self) -> ndarray:
        """Elastic tensor C_ijkl [TPa] of the atoms' long waves, [d, d, d, d]."""
        return self.atoms.elastic(_allowed(self.atoms, self.material.symmetry))

    @cached_property
    def errors(self) -> ndarray:
        """Independent standard errors of `tensor` [TPa], [Q, d, d, d, d], none where unknown. Of an
        exact potential the difference between finite strains and long waves."""
        if self.atoms.doubt is not None:
            return self.atoms.elastic_doubt(_allowed(self.atoms, self.material.symmetry), bent=True)
        found = [] if self.strained is None else [self.strained - self.tensor]
        return np.reshape(found, (-1, *self.tensor.shape))

    @cached_property
    def unsure(self) -> float:
        """Largest relative standard error of a long wave's modulus over all directions."""
        e = directions(DIRECTIONS, self.atoms.dimension)
        size, waves = eigh(self.local(e))
        off = np.einsum("qijkl,nk,nl->qnij", brackets_from_elastic(self.errors), e, e)
        share = np.einsum("nip,qnij,njp->qnp", waves, off, waves)
        return float((norm(share, axis=0) / size).max())

    @cached_property
    def local(self) -> WaveSymbol:
        """Symbol Γ(k) [TPa/Å²] of the local solid with the atoms' moduli, not discretised."""
        brackets = brackets_from_elastic(self.tensor)
        if self.atoms.stress is not None:
            brackets = brackets + stress_brackets(self.atoms.stress)
        return lambda k: acoustic(brackets, k)

    @property
    def wave_lengths(self) -> ndarray:
        """Wavelengths that are compared [spacings], falling to two, shape [80]."""
        return 2 * np.pi / np.linspace(0.05, np.pi, SIZES)

    @cached_property
    def wave_errors(self) -> Arrays:
        """Relative errors, against the atoms, of waves in 60 directions, by material and rival."""
        size = 2 * np.pi / (self.wave_lengths * self.law.spacing)
        k = size[:, None, None] * directions(DIRECTIONS, self.atoms.dimension)
        k = k.reshape(-1, self.atoms.dimension)
        true, found = inv(self.atoms.effective(k)), {}
        for name, symbol in ("law", self.law.symbol), ("local", self.local):
            off = norm(inv(symbol(k)) - true, axis=(1, 2))
            found[name] = (off / norm(true, axis=(1, 2))).reshape(SIZES, -1)
        return found

    @property
    def holds_to(self) -> dict[str, float]:
        """Shortest wavelength [Å] with errors within 2 %, or infinite, by material and rival."""
        found = {}
        for name, off in self.wave_errors.items():
            good = np.argmax(np.append(off.max(axis=1), np.inf) > WITHIN)
            found[name] = float(self.wave_lengths[good - 1] * self.law.spacing) if good else np.inf
        return found

    def directional(self) -> Pair:
        """Angles in the plane of the first and last axis, and Young's modulus along them [GPa]."""
        angle, one = np.linspace(0, 2 * np.pi, 181), np.eye(self.atoms.dimension)
        e = np.outer(np.cos(angle), one[0]) + np.outer(np.sin(angle), one[-1])
        S = compliance(1e3 * self.law.tensor())
        return angle, 1 / np.einsum("ijkl,ni,nj,nk,nl->n", S, e, e, e, e, optimize=True)

    def rows(self) -> Rows:
        held, law, group, content = self.atoms.stress, self.law, self.law.symmetry, self.content()
        shown = [("symmetry", group if isinstance(group, str) else f"{len(group)} rotations")]
        for key, moduli in content["moduli_GPa"].items():
            name = {"law": "model", "atoms": "atoms' long waves"}.get(key, key)
            parts = ", ".join(f"{name} {value:.2f}" for name, value in moduli.items())
            shown.append((f"moduli, {name}", f"{parts} GPa"))
        if bars := content["standard_errors_GPa"]:
            parts = ", ".join(f"{name} {bar:.2g}" for name, bar in bars.items())
            told = f"{parts} GPa; a sound wave's modulus {self.unsure:.2%}"
            shown.append(("standard errors", told))
        if held is not None:
            stress = ", ".join(f"{1e3 * s:.3g}" for s in held[np.triu_indices(len(held))])
            shown.append(("stress held", f"{stress} GPa (upper triangle)"))
        own, local = (
            f"waves of {wave:.3g} Å" if np.isfinite(wave) else "no wave that was looked at"
            for wave in self.holds_to.values()
        )
        within = f"{own}; local elasticity with the same moduli: {local}"
        shown += [
            ("nodes", f"{law.spacing:.4g} Å apart, {law.bonds} bonds up to {law.horizon:.4g} Å"),
            ("proven", content["statement"] or "nothing"),
            (f"within {WITHIN:.0%} down to", within),
        ]
        for n, e in content["wave_errors_percent"].items():
            shown.append((f"error, {n}", f"{e['law']:.2f} %; local elasticity {e['local']:.2f} %"))
        return [*self.said.items(), *shown]

    def plot(self) -> Figure:
        """Draw acoustic branches, Young's modulus by direction, wave errors beside the rival's."""
        figure = Figure(figsize=(11, 3.6), layout="constrained")
        bands = figure.add_subplot(1, 3, 1)
        law, d = self.law, self.atoms.dimension
        reach = np.linspace(0.03, 1, 40) * np.pi / 2
        for number, path in enumerate(PATHS[d]):
            direction = np.array([*map(int, path)])
            k = reach[:, None] / law.spacing * direction / norm(direction)
            branches = self.atoms.effective, law.symbol, self.local
            true, own, local = (np.sqrt(1e3 * eigvalsh(D(k)).clip(0)) for D in branches)
            bands.plot(reach, own, color=f"C{number}", label=[f"[{path}]", *[None] * (d - 1)])
            bands.plot(reach, local, ":", color=f"C{number}", linewidth=0.8)
            bands.plot(reach[::3], true[::3], ".", color=f"C{number}")
        bands.set(xlabel="wave number × spacing", ylabel="root of the wave's stiffness [√GPa / Å]")
        bands.set_title("Waves of model (lines), atoms\n(dots), local elasticity (dotted)")
        bands.legend(frameon=False, title="direction")
        polar: Any = figure.add_subplot(1, 3, 2, projection="polar")
        angle, young = self.directional()
        polar.plot(angle, young)
        polar.set_rlim(min(0.0, 1.1 * young.min()), 1.1 * young.max())
        polar.set_rlabel_position(67.5)
        polar.set_title(f"Young's modulus [GPa] over the\ndirection of the pull, axes 1 and {d}")
        waves = figure.add_subplot(1, 3, 3)
        for off, label in zip(self.wave_errors.values(), ("model", "local elasticity")):
            waves.semilogy(self.wave_lengths, 100 * off.mean(axis=1), label=label)
        waves.set(xlabel="wavelength [spacings]", ylabel="error of displacement [%]", xlim=(2, 20))
        waves.set_title("Error of the answer to waves,\nmean over all directions")
        waves.legend(frameon=False)
        return figure

    def content(self) -> Values:
        """The fit as plain values: Voigt matrices in GPa, lengths in Å, errors in %."""
        proof, told = self.certificate, self.law.certificate
        C = {"law": self.law.tensor(), "atoms": self.tensor}
        C |= {} if self.strained is None else {"finite strains": self.strained}
        bars = with_errors(self.tensor, self.errors) if len(self.errors) else {}
        errors = {}  # means over directions
        for n in TOLD:
            row = np.abs(self.wave_lengths - n).argmin()
            means = {name: float(100 * off[row].mean()) for name, off in self.wave_errors.items()}
            errors[f"waves of {n} spacings"] = means
        return {
            "said": self.said,
            "elastic_tensor_GPa": {key: (1e3 * voigt(v)).tolist() for key, v in C.items()},
            "moduli_GPa": {key: named_moduli(1e3 * v) for key, v in C.items()},
            "standard_errors_GPa": {name: bar for name, (_, bar) in bars.items()},
            "spacing": self.law.spacing,
            "horizon": self.law.horizon,
            "holds_to": self.holds_to,
            "wave_errors_percent": errors,
            "statement": "" if proof is None else proof.statement,  # in the file's units
            "proven_GPa": None if told is None else 1e3 * told.proven,
        }


def with_errors(C: ndarray, errors: ndarray) -> dict[str, tuple[float, float]]:
    """Elastic moduli [GPa] of C [TPa] by name, each with its standard error of [Q, d, d, d, d]."""
    M = 1e3 * norm(voigt(errors), axis=0)
    at, moduli = ("123456" if len(C) == 3 else "124").index, named_moduli(1e3 * C)
    return {name: (c, float(M[at(name[1]), at(name[2])])) for name, c in moduli.items()}


def _written(C: ndarray, errors: ndarray) -> str:
    moduli = with_errors(C, errors).items()
    return ", ".join(f"{name} {value:.2f} ± {bar:.2g}" for name, (value, bar) in moduli) + " GPa"


def _allowed(atoms: ForceConstants, symmetry: Symmetry) -> ndarray:
    return allowed_tensors(symmetry, np.eye(atoms.dimension))


@typed
def fit_crystal(
    atoms: ase.Atoms,
    calculator: Any = None,
    *,
    thickness: Positive | None = None,
    hold: Sequence[str] = (),
    spacing: Positive | None = None,
    horizon: Positive | None = None,
    supercell: Sequence[int] | None = None,
    symmetry: Symmetry = "auto",
    units: Units | str = USUAL,
) -> CrystalFit:
    """Fit a material to a crystal's structure and its calculator.

    The structure is relaxed, checked (forces, stress, imaginary phonons) and reduced to its
    smallest cell. The material is learned from force constants and compared under all waves.

    Args:
        atoms: periodic in space, or in a plane with vacuum (8 Å) or without a period across.
        calculator: of ASE; None takes the one of the atoms.
        thickness: of a sheet [Å]; by default from the lowest to the highest nucleus and a van der
            Waals radius beyond each.
        hold: strains that are not relaxed: of xx, yy, zz, yz, xz, xy, or "all".
        spacing: of the nodes [Å]; by default the edge of a cube as large as the conventional cell,
            of a sheet the longer edge of its smallest rectangle.
        horizon: of the longest bond [Å]; by default 3 spacings, in space √6.
        supercell: repeats of the smallest cell for force constants; by default until forces end.
        symmetry: "auto" asks spglib, or a point group by name.
        units: of the material: "ase", "metal", "si", or names of a length and a stress.

    Moduli of long waves whose error is 2 % against finite strains are warned of. Raises InputError
    for what is no crystal, does not relax, has imaginary phonons, or moduli whose error is 20 %.

    >>> from ase.build import bulk; from ase.calculators.emt import EMT
    >>> round(wp.fit_crystal(bulk("Al"), EMT()).material.moduli("GPa")["C11"])
    53
    """
    units = check_units(units)
    offered(atoms, "get_positions", "fit_crystal", "an ase.Atoms")
    calculator = Asked(atoms.calc if calculator is None else calculator)
    _check_asked(atoms, thickness, spacing, horizon, supercell, symmetry)
    reference = at_rest(atoms, calculator, thickness=thickness, hold=hold)
    constants, said = force_constants(reference, calculator, supercell)
    group = symmetry_of(constants, symmetry)
    constants, strained, taken = with_strains(constants, reference, calculator, group)
    said = reference.said | said | taken
    if strained is not None:
        waves = constants.elastic(_allowed(constants, group))
        off = np.abs(waves - strained).max() / np.abs(strained).max()
        if off > AGREE:
            told = (
                f"those of long waves are {off:.1%} off those of finite strains: forces reach "
                f"further than {said['force constants']}, or the calculator is not that precise"
            )
            if off > TOO_FAR:
                raise InputError(f"moduli: {told}")
            warn(f"moduli: {told}")
            said["moduli disagree"] = told
    return _learned(constants, spacing, horizon, group, units, said, strained)


def _check_asked(
    atoms: ase.Atoms, thickness: Any, spacing: Any, horizon: Any, supercell: Any, symmetry: Any
) -> None:
    """Raise InputError, before a calculator works, for what no cell near the given one can have."""
    with quietly():
        cell, flat = oriented(atoms, True, thickness)
    cell, d = smallest(cell, flat), 3 - flat
    size = norm(np.cross(*cell.cell[:2])) if flat else abs(cell.get_volume())
    if supercell is not None:
        counted("supercell", supercell, len(cell), flat=flat)
    if str(symmetry) != "auto":
        point_group(symmetry, d)
    check_beside(h := spacing or usual_spacing(cell, flat), float(size ** (1 / d)))
    if horizon is not None:
        near = (size / len(cell)) ** (1 / d)  # a disordered cell may relax to one of an atom
        if not spacing and horizon < near / 2:
            raise InputError(f"horizon: expected at least one spacing, {near:.3g} Å, got {horizon}")
        if spacing or horizon > MANY * h:
            half_ball(horizon / h, d)


def with_strains(
    atoms: ForceConstants, reference: Reference, calculator: Any, symmetry: Symmetry
) -> tuple[ForceConstants, ndarray | None, dict[str, str]]:
    """Join force constants with finite strains under noise; also returns these moduli and notes."""
    allowed, noise, rough = _allowed(atoms, symmetry), reference.noise, reference.noise.rough > 0
    found = by_strains(reference.cell, calculator, noise, atoms, allowed)
    if found is None or noise.rounding:
        return atoms, None if found is None else found[0], {}
    # what is unstable within its errors is refused only if strains do not mend it
    alone = _written(atoms.nearest_elastic(allowed)[0], atoms.elastic_doubt(allowed))
    new, chi, moved = joined(atoms, allowed, *found, shared=SMALLER * rough)
    check_phonons(new)
    sizes = f"strains of {noise.strain * PULLED[0]:.2g} to {noise.strain:.2g}"
    why = "forces leave the supercell" + " or are not linear" * rough
    believed = "they agree" if chi <= APART else f"strains are believed: {why}"
    told = {
        "moduli, force constants alone": alone,
        "moduli, finite strains alone": f"{_written(*found)}, {sizes}",
        "both": f"χ² = {chi:.2g} for each modulus: {believed}; Φ moved by {moved:.1e}",
    }
    return new, found[0], told


@typed
def crystal_from_force_constants(
    atoms: ForceConstants,
    *,
    spacing: Positive | None = None,
    horizon: Positive | None = None,
    symmetry: Symmetry = "auto",
    units: Units | str = USUAL,
) -> CrystalFit:
    """Fit a material to known force constants, as of `from_phonopy`; arguments as of `fit_crystal`.
    Raises InputError for a crystal with imaginary phonons."""
    check_phonons(atoms)
    group = symmetry_of(atoms, symmetry)
    if atoms.doubt is not None:
        allowed = _allowed(atoms, group)
        errors = replace(atoms, cut=None).elastic_doubt(allowed, bent=True)
        share = np.abs(errors).max(initial=0.0) / np.abs(atoms.elastic(allowed)).max()
        share = max(share, relative(atoms.doubt, atoms.values))
        if share > RULES:
            raise InputError(
                f"force constants: rules that they break (space group, rotations, …) leave them or "
                f"moduli unsure by {share:.0%}; expected less than {RULES:.0%}"
            )
    return _learned(atoms, spacing, horizon, group, check_units(units), {}, None)


def _learned(
    atoms: ForceConstants,
    spacing: float | None,
    horizon: float | None,
    symmetry: Symmetry,
    units: Units,
    said: dict[str, str],
    strained: ndarray | None,
) -> CrystalFit:
    """Fit the material; adds notes on force constants that depend on the supercell or the step."""
    said = said | ({} if atoms.thickness is None else {"thickness": f"{atoms.thickness:.4g} Å"})
    said["at the supercell's edge"] = f"{atoms.edge:.1%} of Σ |Φ| r²"
    if atoms.doubt is not None:
        said["force constants' error"] = f"{relative(atoms.doubt, atoms.values):.1e} of Φ"
        soft, error, most = at_zone_edge(atoms)
        edge = f"{soft:.3f} ± {error:.2g} THz and more; standard errors up to {most:.2g} THz"
        said["phonons at the zone's edge"] = edge
    if atoms.change is not None:
        change = f"by {atoms.change:.1e} of the largest from steps of {STEP:g} to "
        said["force constants change"] = f"{change}{WIDER * STEP:g} Å"
    cell = ase.Atoms(atoms.species, positions=atoms.positions, cell=atoms.cell, pbc=True)
    h = spacing or usual_spacing(cell, atoms.dimension == 2)
    law = fit_phonons(atoms, h, horizon or h * REACH[atoms.dimension], symmetry=symmetry)
    found = CrystalFit(law, atoms, strained, said)
    if len(found.errors):  # relative, of any sound wave
        law = replace(law, provenance=law.provenance | {"moduli_error": found.unsure})
    return replace(found, material=law.in_units(units))
