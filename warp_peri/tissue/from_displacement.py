"""A hyperelastic solid from displacement alone: no load is known, so only ratios can be learned.

The loss is the error of the solved displacement, (H12); its derivatives go through the equilibrium
(H13), and every step is a linear least-squares problem with signs. Coefficients are scaled to an
initial stiffness of one; a known force sets the scale afterwards. A sheet that is not even has a
thickness, (H18), learned with the material or, for another sheet of a known one, alone.
"""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import Any

import numpy as np

from warp_peri.errors import InputError
from warp_peri.points.arrays import is_number
from warp_peri.points.samples import Samples, seen_of
from warp_peri.tissue.displacement_search import DisplacementFit, Search
from warp_peri.tissue.operator import HyperelasticOperator
from warp_peri.tissue.solid import Dictionary, HyperelasticSolid
from warp_peri.tissue.stress import piola_stress
from warp_peri.tissue.thickness import Thickness

__all__ = [
    "DisplacementFit",
    "check_identifiable",
    "fit_displacement",
    "fit_thickness",
    "scaled_by_force",
]

INTERPOLATES = 50.0
"""Times as stiff as the sheet at rest: such deviations fill in the collar as a stiff plate does."""
NODES = 10
"""Measured components, or nodes inside, for each number that is learned, at least."""
AFFINE = 1e-6
"""A set of frames whose distance from affine displacement is below this fraction says nothing."""


def fit_displacement(
    frames: Samples,
    dictionary: Dictionary,
    *,
    stiffness: float | tuple[float, float] = 0.05,
    moving: bool = False,
    start: np.ndarray | None = None,
    thickness: int = 0,
    most_steps: int = 15,
    tolerance: float = 1e-4,
    progress: bool | str = False,
) -> DisplacementFit:
    """Learn from displacement on a lattice whose collar is data and whose interior carries no load.

    Args:
        frames: samples without loads.
        dictionary: energies that are safe with coefficients ≥ 0.
        stiffness: least coefficient of the deviations, in units of the initial stiffness, or the
            least and the greatest: what is held low does not fit the frames in place of a material.
        moving: whether angles and exponents of fibres are unknowns too.
        start: coefficients to begin with, shape [K]; those of least equation error where none.
        thickness: degree of the polynomial that is the logarithm of the sheet's thickness, (H18);
            0 for an even sheet.
        most_steps: of Gauss and Newton.
        tolerance: ends when a step lowers the loss by less than this fraction.
        progress: show a bar on stderr; a text is its name.

    Warns where deviations come out so stiff that they, and not a material, explain the frames.
    Raises InputError for frames with loads, affine frames, a frame at rest, fewer than ten measured
    components inside, of all frames, for each energy, energies that guarantee nothing, and numbers
    that make no sense; NoEquilibrium where no frame has one at the start.
    """
    check_unloaded(frames)
    if not dictionary.guaranteed:
        raise InputError(
            "dictionary: expected energies that are convex and stress-free at rest only"
        )
    check_identifiable(frames)
    uneven = Thickness.over(frames.x, thickness) if thickness else None
    numbers = len(dictionary)
    count = 2 * np.count_nonzero(seen_of(frames)[:, frames.interior])
    if count < NODES * numbers:
        raise InputError(
            f"frames: expected {NODES * numbers} measured components inside for {numbers} numbers, "
            f"got {count}"
        )
    bounds = bounds_of(stiffness)
    search = Search(frames, dictionary, bounds, moving, uneven)
    if start is None:
        c = search.equation_error()
    else:
        if np.shape(start) != (len(dictionary),):
            raise InputError(f"start: expected {len(dictionary)} coefficients, got {start!r:.60}")
        c = search.scaled(np.clip(start, search.lower, search.upper))
    fit = search.descended(c, most_steps, tolerance, progress)
    warn_of_interpolation(fit.material)
    return fit


def fit_thickness(
    frames: Samples,
    solid: HyperelasticSolid,
    degree: int = 2,
    *,
    most_steps: int = 10,
    tolerance: float = 1e-4,
    progress: bool = False,
) -> DisplacementFit:
    """The thickness (H18) of a sheet whose material is known, from its own displacement.

    Args:
        frames: samples without loads.
        solid: the material; its coefficients stay, scaled to an initial stiffness of one.
        degree: of the polynomial.
        most_steps, tolerance, progress: as in fit_displacement.

    Raises InputError for frames with loads, none, or a frame at rest, and for another degree;
    NoEquilibrium where no frame has one in an even sheet.
    """
    check_unloaded(frames)
    uneven = Thickness.over(frames.x, degree)
    search = Search(frames, solid.dictionary, (0.0, np.inf), False, uneven, held=True)
    return search.descended(search.scaled(solid.coefficients), most_steps, tolerance, progress)


def bounds_of(stiffness: float | tuple[float, float]) -> tuple[float, float]:
    """Least and greatest coefficient of the deviations; InputError where they are none."""
    given: Any = (stiffness, np.inf) if is_number(stiffness) else stiffness
    if not (isinstance(given, (tuple, list)) and len(given) == 2 and all(map(is_number, given))):
        raise InputError(f"stiffness: expected one number or two, got {stiffness!r:.60}")
    least, greatest = float(given[0]), float(given[1])
    if not (0 <= least <= greatest and least < np.inf):
        raise InputError(f"stiffness: expected 0 ≤ least ≤ greatest, got {stiffness!r:.60}")
    return least, greatest


def check_unloaded(frames: Samples) -> None:
    """Raise InputError where the interior carries a load."""
    if frames.b is not None and np.any(frames.b[:, frames.interior]):
        raise InputError("frames: expected no load on the interior; with loads use fit_energy")


def check_identifiable(frames: Samples) -> None:
    """Raise InputError where every frame is affine: any homogeneous body could have moved so."""
    design = np.concatenate([np.ones((len(frames.x), 1)), frames.x], axis=1)
    bent = 0.0
    for u in frames.u:
        rest = u - design @ np.linalg.lstsq(design, u, rcond=None)[0]
        size = float(np.linalg.norm(u))
        bent = max(bent, float(np.linalg.norm(rest)) / size if size > 0 else 0.0)
    if len(frames) == 0 or bent < AFFINE:
        raise InputError(
            "frames: expected displacement that is not affine; a homogeneous body of any material "
            "follows affine edges, so that such frames say nothing about it"
        )


def stiffest_deviation(solid: HyperelasticSolid) -> float:
    """Largest of the deviations, in units of an initial stiffness of one."""
    dictionary = solid.dictionary
    deviations = solid.coefficients[dictionary.first_deviation : dictionary.first_term]
    return float(deviations.max(initial=0.0))


def warn_of_interpolation(solid: HyperelasticSolid) -> None:
    """Warn where the deviations of a solid with an initial stiffness of one outweigh it by far."""
    stiffest = stiffest_deviation(solid)
    if stiffest > INTERPOLATES:
        warnings.warn(
            f"deviations came out {stiffest:.0f} times as stiff as the sheet at rest: they "
            "interpolate the collar, whatever the material; is the sheet uneven (thickness=), or "
            "were the frames smoothed?",
            stacklevel=3,
        )


def scaled_by_force(
    solid: HyperelasticSolid,
    frames: Samples,
    forces: np.ndarray,
    *,
    width: float,
    axis: int = 0,
    thickness: np.ndarray | None = None,
) -> HyperelasticSolid:
    """The same solid with the scale that measured forces give.

    Args:
        solid: known up to its scale.
        frames: that the forces belong to.
        forces: pull along the axis on a section across it, over the thickness, shape [S]
            in stress times length.
        width: of that section in the reference [length], > 0; the stress on it is taken as that of
            the interior.
        axis: 0 for x, 1 for y.
        thickness: of every node over that which the forces are divided by, shape [N]; one for none.

    Raises InputError for forces of another number, another axis or width, or where the solid
    carries no force.
    """
    if axis not in (0, 1) or not 0 < width < np.inf:
        raise InputError(f"axis, width: expected 0 or 1 and a length > 0, got {axis} and {width}")
    forces = np.asarray(forces, float)
    if forces.shape != (len(frames),) or not np.isfinite(forces).all():
        raise InputError(f"forces: expected {len(frames)} finite numbers")
    op = HyperelasticOperator(solid.dictionary, frames, thickness=thickness)
    carried = np.array(
        [
            width * piola_stress(op, u, solid.coefficients)[op.interior, axis, axis].mean()
            for u in frames.u
        ]
    )
    size = float(carried @ carried)
    if not size > 0 or not float(carried @ forces) > 0:
        raise InputError("forces: expected a pull with the sign of the solid's stress")
    factor = float(carried @ forces) / size
    known = {name: value for name, value in solid.provenance.items() if name != "stresses"}
    return replace(solid, coefficients=factor * solid.coefficients, provenance=known)
