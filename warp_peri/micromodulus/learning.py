"""Laws learned from fields, from phonons, or from the symbol of another law (theory.md, T7–T10)."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from warp_peri.errors import InputError
from warp_peri.micromodulus import fields
from warp_peri.micromodulus.elastic import (
    acoustic,
    allowed_tensors,
    bracket_rows,
    brackets_from_elastic,
    from_voigt,
    huang_rows,
    stress_brackets,
    turned,
)
from warp_peri.micromodulus.family import Family, family
from warp_peri.micromodulus.force_constants import ForceConstants
from warp_peri.micromodulus.groups import (
    CANDIDATES,
    LEAST,
    Symmetry,
    checked_orientation,
    name_of,
    orbit_grid,
    point_group,
    shared_with_nodes,
)
from warp_peri.micromodulus.law import Crystal
from warp_peri.micromodulus.regression import Learned, compressed, directions, learn
from warp_peri.points.arrays import is_positive
from warp_peri.points.lattice import lattice_steps
from warp_peri.points.samples import Samples
from warp_peri.points.unit_names import USUAL, Units, factors, symbols

FLOOR = 0.3
"""ζ over the softest acoustic modulus."""
AS_GOOD = 1.02
"""A group is taken while the loss with it is at most so many times that of the best group,"""
SMALL = 0.003
"""and this much of the loads."""
MUCH, MUCH_OF_ALL = 1.5, 0.01
"""The same of one that is told: data contradict it beyond that."""
LONG_WAVE_MODULI, POOR = "long waves", 0.1
"""Moduli that fields tell, and the part of the loads of long waves that they may leave unsaid."""
ABSURD = 10.0
"""Times the loads, that no law leaves of data in its own units, however noisy."""
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


def fit(
    samples: Samples,
    horizon: float,
    *,
    symmetry: Symmetry = "auto",
    orientation: Any = None,
    moduli: Any = "long waves",
    normalise: bool = False,
) -> Crystal:
    """The micromodulus tensors that fit L u = b on the interior nodes best.

    Args:
        samples: displacements and loads on lattice nodes.
        horizon: length of the longest bond.
        symmetry: name of the crystal's point group, rotations, or "auto": the largest group of the
            nodes with which the fit is as good as without one.
        orientation: the crystal's axes in the coordinates of the points, as columns, or degrees;
            without it the nodes' axes.
        moduli: "long waves" holds the moduli that fields.long_wave_moduli finds, None holds
            Huang's relations alone, and a Voigt matrix (crystal's axes) holds its own.
        normalise: weigh each sample by 1/‖b‖.

    Returns a law with its certificate. `provenance["fit"]` has the loss, the group's loss over that
    of the best group (`symmetry_ratio`), cuts and numbers.

    Raises InputError for samples that do not carry the horizon or do not determine the law. A
    UserWarning says where data contradict the symmetry that is told, and where long waves are too
    few or too short to tell moduli.
    """
    axes = lattice_steps(samples.points)[1]
    d = len(axes)
    turn = np.eye(d) if orientation is None else axes.T @ checked_orientation(orientation, d)
    if not is_positive(horizon):
        raise InputError(f"horizon: expected a number > 0, got {horizon!r:.60}")
    if not (moduli is None or isinstance(moduli, str)):
        moduli = from_voigt(moduli)
        if len(moduli) != d:
            raise InputError(f"moduli: expected those of {d} dimensions, got {len(moduli)}")
    elif moduli not in (None, LONG_WAVE_MODULI):
        raise InputError(
            f"moduli: expected {LONG_WAVE_MODULI!r}, None or a Voigt matrix, got {moduli!r:.60}"
        )
    reach = horizon / samples.spacing
    name, ratio = _judged(samples, reach, turn, normalise, symmetry)
    group = point_group(name, d)
    shared = shared_with_nodes(group, turn)
    bonds = family(reach, shared)
    R, y = fields.rows(samples, bonds, normalise=normalise)
    C, misfit = None, None
    if isinstance(moduli, str):
        C, misfit = fields.long_wave_moduli(samples, allowed_tensors(name, group, turn))
        if misfit > POOR:
            warnings.warn(
                f"moduli: those of the longest waves leave {misfit:.0%} of what these loads do to "
                "them, and may be as far off: give them, or loads of longer waves on more nodes",
                stacklevel=4,
            )
    elif moduli is not None:
        C = turned(moduli, turn)
    learned = _solve(R, y, bonds, shared, C, samples.spacing)
    if not learned.loss < ABSURD:
        raise InputError(
            f"data: the law leaves {learned.loss:.3g} times the loads themselves; are moduli in "
            f"{symbols(samples.points.units)[1]}, and loads the forces on the nodes?"
        )
    record = {
        "from": "fields",
        "loss": learned.loss,
        "symmetry_ratio": ratio,
        "long_wave_misfit": misfit,
        "cuts": learned.cuts,
        "numbers": len(bonds.basis),
        "moduli_held": C is not None,
    }
    return _law(learned, bonds, samples.spacing, samples.points.units, name, turn, record)


def _judged(
    samples: Samples, reach: float, turn: np.ndarray, normalise: bool, told: Symmetry
) -> tuple[Symmetry, float | None]:
    """The symmetry that is told, or the largest group that costs nothing; and what it costs.

    It is to cost nothing in L u = b, nor in the moduli of long waves. Each half of the samples is
    judged by the fit of the other, and the best of all groups is what others are held against:
    hundreds of numbers without symmetry fit few samples too well. The figure is the larger of both
    losses over the best, None where the data do not determine the group. A UserWarning says
    where data contradict the symmetry that is told.
    """
    d, auto = len(turn), isinstance(told, str) and told == "auto"
    if len(samples) < 2 and not auto:
        return told, None
    none = point_group(LEAST[d], d)
    least, any_tensor = family(reach, none.astype(int)), allowed_tensors(LEAST[d], none, turn)
    u, b = samples.u, samples.loads
    halves = [Samples(samples.points, u[n::2], b[n::2]) for n in range(min(2, len(u)))]
    equations = [fields.rows(half, least, normalise=normalise) for half in halves]
    R = np.concatenate([rows for rows, _ in equations])
    if auto and np.linalg.matrix_rank(R) < R.shape[1]:
        raise InputError(
            f"data: expected enough to tell {R.shape[1]} numbers without any symmetry apart; name "
            "one, or give more loads"
        )
    try:
        long = [fields.long_wave_equations(half, any_tensor) for half in halves]
    except InputError:  # too few nodes to see long waves on
        long = []

    def losses(name: Symmetry) -> np.ndarray:
        group = point_group(name, d)
        bonds = family(reach, shared_with_nodes(group, turn))
        allowed = allowed_tensors(name, group, turn)
        return np.array(
            [
                _crossed(equations, np.einsum("anij,bnij->ba", bonds.basis, least.basis)),
                _crossed(long, np.einsum("aijkl,bijkl->ba", allowed, any_tensor)) if long else 0.0,
            ]
        )

    found = {name: losses(name) for name in CANDIDATES[d]}
    own = None if auto else found[told] if isinstance(told, str) and told in found else losses(told)
    best = np.min([*found.values(), *([] if own is None else [own])], axis=0)
    if own is None:
        costs_nothing = (name for name in found if (found[name] <= AS_GOOD * best + SMALL).all())
        told = next(costs_nothing, LEAST[d])
        own = found[told]
    elif np.isfinite(own).all() and (own > MUCH * best + MUCH_OF_ALL).any():
        worst = int(np.argmax(own - best))
        what = ("L u = b", "the moduli of long waves")[worst]
        warnings.warn(
            f"symmetry: the data contradict what is told: in {what} it leaves {own[worst]:.1%} of "
            f"the loads, another group {best[worst]:.1%}; symmetry='auto' looks for it",
            stacklevel=5,
        )
    if not np.isfinite(own).all():
        return told, None
    return told, float((own / np.maximum(best, SMALL)).max())


def _crossed(equations: Sequence[tuple[np.ndarray, ...]], mix: np.ndarray) -> float:
    """‖R M p − y‖ / ‖y‖, of each part with the p of the other; of one part with its own.

    Infinite where a part does not determine p.
    """
    parts = [(R @ mix, y) for R, y in equations]
    if any(np.linalg.matrix_rank(R) < R.shape[1] for R, _ in parts):
        return np.inf
    fits = [np.linalg.lstsq(R, y)[0] for R, y in parts]
    left = np.concatenate([R @ p - y for (R, y), p in zip(parts, fits[::-1])])
    return float(np.linalg.norm(left) / np.linalg.norm(np.concatenate([y for _, y in parts])))


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
    bonds = family(horizon / spacing, shared)
    R, y = wave_rows(target, spacing, bonds, shared, largest_wave)
    learned = _solve(R, y, bonds, shared, tensor, spacing, stress)
    found = {"loss": learned.loss, "cuts": learned.cuts, "numbers": len(bonds.basis)}
    found |= {"moduli_held": tensor is not None, "largest_wave": largest_wave / spacing}
    return _law(learned, bonds, spacing, units, symmetry, turn, (record or {}) | found, stress)


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
    bonds: Family,
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
    for what, value in (("spacing", spacing), ("horizon", horizon)):
        if not is_positive(value):
            raise InputError(f"{what}: expected a number > 0, got {value!r}")
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
        moments = family(horizon / spacing, shared_with_nodes(group, turn)).moments()
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


def _solve(
    R: np.ndarray,
    y: np.ndarray,
    bonds: Family,
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


def _law(
    learned: Learned,
    bonds: Family,
    spacing: float,
    units: Units,
    symmetry: Symmetry,
    turn: np.ndarray,
    record: dict[str, Any],
    stress: np.ndarray | None = None,
) -> Crystal:
    tensors = np.tensordot(learned.p, bonds.basis, 1) / spacing**2
    law = Crystal(
        spacing, bonds.steps, tensors, units, symmetry, turn, None, {"fit": record}, stress
    )
    return law.certified()


SAME = 1e-6
"""Relative, of spacings, and of rotations that leave the crystal as it is on its nodes."""


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
    for what, value in (("spacing", spacing), ("horizon", horizon)):
        if not (is_positive(value) or (value is None and what == "horizon")):
            raise InputError(f"{what}: expected a number > 0, got {value!r:.60}")
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
