"""Crystals from their answers to waves, and reduced to a plane (theory, T9–T17)."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import numpy as np

from warp_peri.core import elastic
from warp_peri.core.elastic import (
    acoustic,
    allowed_tensors,
    bracket_rows,
    brackets_from_elastic,
    huang_rows,
    stress_brackets,
    turned,
)
from warp_peri.core.groups import (
    Symmetry,
    checked_orientation,
    name_of,
    orbit_grid,
    point_group,
    shared_with_nodes,
)
from warp_peri.core.stencil import Basis, directions, invariant_basis
from warp_peri.errors import InputError
from warp_peri.micromodulus.force_constants import ForceConstants
from warp_peri.micromodulus.law import BROKEN, Crystal
from warp_peri.micromodulus.regression import Learned, learn
from warp_peri.points.arrays import check_positive
from warp_peri.points.unit_names import USUAL, Units, factors, symbols
from warp_peri.regression.search import compressed

FLOOR = 0.3
"""ζ over the softest acoustic modulus."""
WAVES, LARGEST_WAVE = 400, 2.0
"""Waves that a symbol is matched on, and their largest |k| h."""
LONG_WAVES, LONGEST, LONG_WEIGHT = 30, 0.02, 4.0
"""Long waves among the rows, their |k| h, and what they weigh together."""
ENOUGH = 3
"""Numbers for each equation that holds moduli, from which holding them costs short waves little."""
OFF = 0.05
"""Of the largest modulus: what is missed by more is warned of."""
FAR = 1e3
"""Nodes over the cell of the atoms, or the cell over nodes, beyond which units are mistaken."""
ZONE_INTERVALS, ZONE_WEIGHT = {2: 12, 3: 10}, 0.1
"""Of a grid on the rest of the zone."""
SAME = 1e-6
"""Relative, of spacings, and of rotations that leave the crystal as it is on its nodes."""


def fit_symbol(
    target: Callable[[np.ndarray], np.ndarray],
    spacing: float,
    horizon: float,
    *,
    symmetry: Symmetry,
    orientation: Any = None,
    tensor: np.ndarray | None = None,
    stress: np.ndarray | None = None,
    units: Units = USUAL,
    largest_wave: float = LARGEST_WAVE,
    record: dict[str, Any] | None = None,
) -> Crystal:
    """The law whose answers to plane waves are those of a symbol: rows D₀⁻¹ D e − e (T9).

    Args:
        target: D₀(k) [stress/length²] at k [K, d] along the nodes' axes, to [K, d, d].
        spacing, horizon: of the law.
        symmetry: of the crystal, by name or as rotations.
        orientation: the crystal's axes in those of the nodes.
        tensor: elastic tensor along the nodes' axes that is held, [d, d, d, d]; without it Huang's
            relations alone are.
        stress: that the crystal is held under, along the nodes' axes, [d, d].
        largest_wave: |k| h up to which waves weigh fully; beyond it a tenth.
        record: goes into the provenance.
    """
    d = _dimension(target) if tensor is None else len(tensor)
    turn = checked_orientation(orientation, d)
    shared = shared_with_nodes(point_group(symmetry, d), turn)
    bonds = invariant_basis(horizon / spacing, shared)
    R, y = wave_rows(target, spacing, bonds, shared, largest_wave)
    learned = solved(R, y, bonds, shared, tensor, spacing, stress)
    found = {"loss": learned.loss, "cuts": learned.cuts, "numbers": len(bonds.basis)}
    found |= {"moduli_held": tensor is not None, "largest_wave": largest_wave / spacing}
    return law_of(learned, bonds, spacing, units, symmetry, turn, (record or {}) | found, stress)


def _dimension(target: Callable[[np.ndarray], np.ndarray]) -> int:
    """Of the waves that a symbol takes."""
    for d in (2, 3):
        try:
            if target(np.full((1, d), 0.01)).shape == (1, d, d):
                return d
        except ValueError:
            continue
    raise InputError("target: expected k of shape [K, d] to [K, d, d], d = 2 or 3")


def wave_rows(
    target: Callable[[np.ndarray], np.ndarray],
    spacing: float,
    bonds: Basis,
    shared: np.ndarray,
    largest_wave: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Rows D₀⁻¹ D e − e: waves up to the largest, long ones, and lightly the rest of the zone."""
    d = bonds.dimension
    number = np.arange(WAVES)
    size = largest_wave * (0.02 + 0.98 * ((number * 0.6180339887) % 1))
    spread = directions(WAVES, d)
    grid = orbit_grid(ZONE_INTERVALS[d], shared, d)
    blocks = (
        (size[:, None] * spread, 1.0),
        (LONGEST * directions(LONG_WAVES, d), np.sqrt(LONG_WEIGHT)),
        (grid[np.linalg.norm(grid, axis=1) > largest_wave], ZONE_WEIGHT),
    )
    count = len(bonds.basis)
    R, y = np.zeros((0, count)), np.zeros(0)
    for phase, weight in blocks:
        share = weight / np.sqrt(len(phase))
        flexible = np.linalg.inv(target(phase / spacing))
        rows = np.einsum("kij,kajl->kila", flexible, bonds.symbol(phase), optimize=True)
        right = np.tile(np.eye(d).ravel(), len(phase))
        R = np.concatenate([R, share * rows.reshape(-1, count)])
        R, y = compressed(R, np.append(y, share * right))
    return R, y


def from_phonons(
    atoms: ForceConstants,
    spacing: float,
    horizon: float,
    *,
    symmetry: Symmetry = "auto",
    orientation: Any = None,
    hold_moduli: bool | None = None,
    largest_wave: float = LARGEST_WAVE,
    units: Units = USUAL,
) -> Crystal:
    """The law that answers plane waves as atoms do, from their force constants alone (T14).

    Args:
        atoms: force constants; the crystal's axes are those of their coordinates.
        spacing, horizon: of the nodes and of the longest bond, in the unit of length.
        symmetry: "auto" asks spglib.
        orientation: the crystal's axes in those of the nodes.
        hold_moduli: hold the elastic constants exactly, or let long waves weigh four times; None
            holds them where a family has ENOUGH numbers for each.
        units: of the law.

    Returns a law with its certificate. Raises InputError for a crystal that is not stable.
    """
    check_positive("spacing", spacing)
    check_positive("horizon", horizon)
    d = atoms.dimension
    length, stress = factors(units, USUAL)
    turn = checked_orientation(orientation, d)
    auto = isinstance(symmetry, str) and symmetry == "auto"
    name: Symmetry = name_of(atoms.group()) if auto else symmetry
    cell = atoms.volume ** (1 / d) if d == 3 else (atoms.volume / (atoms.thickness or 1.0)) ** 0.5
    if not 1 / FAR < spacing * length / cell < FAR:
        raise InputError(
            f"spacing: expected nodes about as far apart as a cell of the atoms is long, "
            f"{cell / length:.3g} {symbols(units)[0]}, got {spacing:g}"
        )

    def target(k: np.ndarray) -> np.ndarray:
        D = atoms.effective(k / length @ turn)  # k in the crystal's axes is Rᵗ k
        return np.asarray(turn @ D @ turn.T) * (length**2 / stress)

    group = point_group(name, d)
    allowed = allowed_tensors(name, group, np.eye(d))
    if hold_moduli is None:
        moments = invariant_basis(horizon / spacing, shared_with_nodes(group, turn)).moments()
        hold_moduli = len(moments) >= ENOUGH * np.linalg.matrix_rank(bracket_rows(moments))
    C = atoms.elastic(allowed)  # also where it is not held: refuses what is no elastic solid
    tensor = turned(C, turn) / stress if hold_moduli else None
    held = None if atoms.stress is None else turn @ atoms.stress @ turn.T / stress
    law = fit_symbol(
        target,
        spacing,
        horizon,
        symmetry=name,
        orientation=turn,
        tensor=tensor,
        stress=held,
        units=units,
        largest_wave=largest_wave,
        record={"from": "phonons"},
    )
    true = turned(C, turn) / stress
    off = float(np.abs(law.tensor() - true).max() / np.abs(true).max())
    if off > OFF:
        warnings.warn(
            f"moduli: with {law.bonds} bonds they are up to {off:.0%} of the largest away from "
            "those of the atoms; a longer horizon, or hold_moduli=True, brings them back",
            stacklevel=2,
        )
    return law


def solved(
    R: np.ndarray,
    y: np.ndarray,
    bonds: Basis,
    shared: np.ndarray,
    tensor: np.ndarray | None,
    spacing: float,
    stress: np.ndarray | None = None,
) -> Learned:
    """The numbers in units of stress, of tensors C h²: rows are in stress over length²."""
    held = stress_brackets(np.zeros([bonds.dimension] * 2) if stress is None else stress)
    moments = bonds.moments()
    size = np.abs(moments).max()  # rows that vanish by symmetry are rounding beside it
    R = R / spacing**2
    if tensor is None:
        p = np.linalg.lstsq(R, y)[0]
        estimate = np.tensordot(p, moments, 1)
        equal = huang_rows(moments) / size, huang_rows(held[None])[:, 0] / size
    else:
        estimate = brackets_from_elastic(tensor) + held
        equal = bracket_rows(moments) / size, bracket_rows(estimate[None])[:, 0] / size
    soft = np.linalg.eigvalsh(acoustic(estimate, directions(400, bonds.dimension)))[:, 0].min()
    if not soft > 0:
        raise InputError(
            f"moduli: expected a stable crystal, got a sound wave of stiffness {soft:.3g}"
        )
    return learn(R, y, bonds, shared, equal=equal, floor=FLOOR * float(soft))


def law_of(
    learned: Learned,
    bonds: Basis,
    spacing: float,
    units: Units,
    symmetry: Symmetry,
    turn: np.ndarray,
    record: dict[str, Any],
    stress: np.ndarray | None = None,
) -> Crystal:
    """The law with these numbers, and its certificate."""
    tensors = np.tensordot(learned.p, bonds.basis, 1) / spacing**2
    law = Crystal(
        spacing, bonds.steps, tensors, units, symmetry, turn, None, {"fit": record}, stress
    )
    return law.certified()


def transferred(
    law: Crystal,
    spacing: float,
    *,
    rotation: Any = None,
    horizon: float | None = None,
    largest_wave: float = LARGEST_WAVE,
) -> Crystal:
    """The law of the same crystal on other nodes: a fit to its own symbol, moduli held (T17).

    Args:
        law: to be carried over.
        spacing: of the new nodes.
        rotation: by which the crystal is turned on its nodes, [d, d], or degrees in the plane:
            C(Rξ) is R C(ξ) Rᵗ, so that its symbol is R D(Rᵗ k) Rᵗ.
        horizon: of the new law; as many spacings as the old one.
        largest_wave: |k| times the larger spacing up to which waves weigh fully.

    Returns a law with its certificate. Raises InputError where the symbol is not positive.
    """
    check_positive("spacing", spacing)
    if horizon is not None:
        check_positive("horizon", horizon)
    d = law.dimension
    turn = checked_orientation(rotation, d)
    orientation = turn @ law.orientation
    held = None if law.stress is None else turn @ law.stress @ turn.T
    still = shared_with_nodes(turn[None], np.eye(d)).any()
    if still and abs(spacing / law.spacing - 1) < SAME and horizon is None:
        steps = np.rint(law.steps @ turn.T).astype(int)
        tensors = turn @ law.tensors @ turn.T
        same = Crystal(
            law.spacing, steps, tensors, law.units, law.symmetry, orientation, None,
            law.provenance, held,
        )  # fmt: skip
        return same.certified()

    wanted = law.horizon / law.spacing * spacing if horizon is None else horizon
    return fit_symbol(
        carried_symbol(law, turn),
        spacing,
        wanted,
        symmetry=law.symmetry,
        orientation=orientation,
        tensor=turned(law.tensor(), turn),
        stress=held,
        units=law.units,
        largest_wave=largest_wave * min(1.0, spacing / law.spacing),
        record={"from": "a law on other nodes", "spacing": law.spacing},
    )


def carried_symbol(law: Crystal, turn: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """D(k) of a crystal turned on its nodes, for k [..., d] of any other nodes."""

    def symbol(k: np.ndarray) -> np.ndarray:
        # beyond the zone of coarser nodes their symbol repeats; the local limit goes on there
        near = _inside(k @ turn, law.spacing)
        D = law.symbol(near) * ((k**2).sum(axis=1) / (near**2).sum(axis=1))[:, None, None]
        return np.asarray(turn @ D @ turn.T)

    return symbol


def _inside(k: np.ndarray, spacing: float) -> np.ndarray:
    """Wave vectors drawn back along themselves to |k| h = LARGEST_WAVE."""
    size = np.linalg.norm(k, axis=1, keepdims=True) * spacing
    return np.asarray(k * np.minimum(1.0, LARGEST_WAVE / np.maximum(size, 1e-300)))


def plane_strain(law: Crystal, normal: int = 2) -> Crystal:
    """The law of fields that do not change along an axis of the nodes: bonds summed along it.

    Exactly what the law in space does with such fields, at all wavelengths.

    Args:
        law: in space.
        normal: axis of the nodes, 0, 1 or 2.

    Raises InputError for a law in the plane, another axis, and a crystal that such fields push out
    of the plane: a mirror or a twofold turn about the normal forbids it.
    """
    kept = _kept(law, normal)
    sums: dict[tuple[int, ...], np.ndarray] = {}
    for step, C in zip(law.steps[:, kept].tolist(), law.tensors):
        if any(step):
            key = max(tuple(step), tuple(-s for s in step))
            sums[key] = sums.get(key, np.zeros((3, 3))) + C
    tensors = np.array(list(sums.values()))
    pushed = np.abs(tensors[:, kept, normal]).max()
    if pushed > BROKEN * np.abs(tensors).max():
        raise InputError(
            f"normal: expected an axis with a mirror or a twofold turn, got one along which fields "
            f"of the plane push (by {pushed / np.abs(tensors).max():.1e} of the tensors)"
        )
    turns = law.orientation @ point_group(law.symmetry, 3) @ law.orientation.T
    turns = turns[np.abs(np.abs(turns[:, normal, normal]) - 1) < BROKEN][:, kept][:, :, kept]
    flat = Crystal(
        law.spacing,
        np.array(list(sums)),
        tensors[:, kept][:, :, kept],
        law.units,
        turns,
        provenance=law.provenance,
        stress=None if law.stress is None else law.stress[np.ix_(kept, kept)],
    )
    return flat.certified()


def plane_stress(law: Crystal, normal: int = 2) -> Crystal:
    """The law of a thin sheet of a crystal in space, free of stress across an axis of its nodes.

    Its moduli are a Schur complement; at short waves it answers as that elastic solid does, for
    what a sheet's faces do there is no property of the crystal. Bonds are those of `plane_strain`.

    Raises InputError as `plane_strain` does.
    """
    kept = _kept(law, normal)
    order = [*kept, normal]
    C = elastic.plane_stress(law.tensor()[np.ix_(order, order, order, order)])
    brackets = elastic.brackets_from_elastic(C)
    flat = plane_strain(law, normal)
    return fit_symbol(
        lambda k: elastic.acoustic(brackets, k),
        law.spacing,
        flat.horizon,
        symmetry=flat.symmetry,
        tensor=C,
        units=law.units,
        record={"from": "plane stress"},
    )


def _kept(law: Crystal, normal: int) -> list[int]:
    if law.dimension != 3 or normal not in (0, 1, 2):
        raise InputError(
            f"normal: expected axis 0, 1 or 2 of a model in space, got {normal!r:.20} of one in "
            f"{law.dimension} dimensions"
        )
    return [axis for axis in range(3) if axis != normal]
