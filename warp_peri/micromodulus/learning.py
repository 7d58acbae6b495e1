"""Crystals learned from fields (theory, T7–T8)."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from warp_peri.contract import MaterialFit
from warp_peri.core.elastic import allowed_tensors, from_voigt, turned
from warp_peri.core.groups import (
    CANDIDATES,
    LEAST,
    Symmetry,
    checked_orientation,
    point_group,
    shared_with_nodes,
)
from warp_peri.core.stencil import invariant_basis
from warp_peri.errors import InputError
from warp_peri.micromodulus import regression
from warp_peri.micromodulus.law import Crystal
from warp_peri.micromodulus.waves import law_of, solved
from warp_peri.points.arrays import check_positive
from warp_peri.points.dataset import Dataset
from warp_peri.points.lattice import check_lattice, lattice_steps
from warp_peri.points.samples import Samples, part
from warp_peri.points.unit_names import symbols

AS_GOOD = 1.02
"""A group is taken while the loss with it is at most so many times that of the best group,"""
SMALL = 0.003
"""and this much of the loads."""
MUCH, MUCH_OF_ALL = 1.5, 0.01
"""The same of one that is told: data contradict it beyond that."""
LONG_WAVE_MODULI, POOR = "long waves", 0.1
"""Moduli that fields tell, and the part of the loads of long waves that they may leave unsaid."""
AGREE, SPREADS = 0.02, 2.0
"""Of the largest modulus, and spreads between halves of the samples, by which long waves of two
laws may differ."""
ENOUGH = 8
"""Samples whose halves tell how far moduli are unsure."""
ABSURD = 10.0
"""Times the loads, that no law leaves of data in its own units, however noisy."""


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
        horizon: δ, length of the longest bond [length of the points].
        symmetry: name of the crystal's point group, rotations, or "auto": the largest group of the
            nodes with which the fit is as good as without one.
        orientation: the crystal's axes in the coordinates of the points, as columns, or degrees;
            without it the nodes' axes.
        moduli: "long waves" holds the moduli that regression.long_wave_moduli finds, None holds
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
    check_positive("horizon", horizon)
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
    bonds = invariant_basis(reach, shared)
    R, y = regression.rows(samples, bonds, normalise=normalise)
    C, misfit = None, None
    if isinstance(moduli, str):
        C, misfit = regression.long_wave_moduli(samples, allowed_tensors(name, group, turn))
        if misfit > POOR:
            warnings.warn(
                f"moduli: those of the longest waves leave {misfit:.0%} of what these loads do to "
                "them, and may be as far off: give them, or loads of longer waves on more nodes",
                stacklevel=4,
            )
    elif moduli is not None:
        C = turned(moduli, turn)
    learned = solved(R, y, bonds, shared, C, samples.spacing)
    if not learned.loss < ABSURD:
        raise InputError(
            f"data: the model leaves {learned.loss:.3g} times the loads themselves; are moduli in "
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
    return law_of(learned, bonds, samples.spacing, samples.points.units, name, turn, record)


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
    least, any_tensor = (
        invariant_basis(reach, none.astype(int)),
        allowed_tensors(LEAST[d], none, turn),
    )
    u, b = samples.u, samples.loads
    halves = [Samples(samples.points, u[n::2], b[n::2]) for n in range(min(2, len(u)))]
    equations = [regression.rows(half, least, normalise=normalise) for half in halves]
    R = np.concatenate([rows for rows, _ in equations])
    if auto and np.linalg.matrix_rank(R) < R.shape[1]:
        raise InputError(
            f"data: expected enough to tell {R.shape[1]} numbers without any symmetry apart; name "
            "one, or give more loads"
        )
    try:
        long = [regression.long_wave_equations(half, any_tensor) for half in halves]
    except InputError:  # too few nodes to see long waves on
        long = []

    def losses(name: Symmetry) -> np.ndarray:
        group = point_group(name, d)
        bonds = invariant_basis(reach, shared_with_nodes(group, turn))
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


def long_waves_of_data(
    moduli: dict[str, float], samples: Samples, horizon: float
) -> tuple[dict[str, float], str]:
    """Moduli of long waves that samples have, by tensors, and a line where a fit's are others.

    Args:
        moduli: C11, C12, C44 of the fit [stress].
        samples: that it was learned from.
        horizon: of the tensors, as of the fit.

    Nothing of scattered points, space, or data whose long waves do not tell; the line is for what
    is more than two spreads between halves of the samples, and 2 % of the largest modulus, off.
    """
    if samples.spacing == 0 or samples.points.dimension != 2 or len(samples) < ENOUGH:
        return {}, ""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            law = fit(samples, horizon)
            halves = [
                fit(part(samples, slice(n, None, 2)), horizon, symmetry=law.symmetry)
                for n in (0, 1)
            ]
    except (InputError, UserWarning):
        return {}, ""
    C, one, other = (np.asarray(each.elastic_tensor()) for each in (law, *halves))
    a, b, c = (moduli[name] for name in ("C11", "C12", "C44"))
    off = np.abs(np.array([[a, b, 0], [b, a, 0], [0, 0, c]]) - C)
    best = {name: float(value) for name, value in law.moduli().items()}
    if not (off > np.maximum(SPREADS / 2 * np.abs(one - other), AGREE * C.max())).any():
        return best, ""
    unit = symbols(samples.points.units)[1]
    told = [", ".join(f"{k} {v:.4g}" for k, v in each.items()) for each in (moduli, best)]
    return best, (
        f"moduli: of long waves the fit has {told[0]} {unit}, a crystal model has {told[1]}, "
        "more apart than their spread: --law tensors, Micromodulus(…), has them"
    )


@dataclass(frozen=True)
class Micromodulus:
    """A tensor C(ξ) for every bond, of any crystal in the plane or in space (theory, T).

    Attributes:
        horizon: length of the longest bond [length].
        symmetry: name of the crystal's point group, rotations, or "auto": the largest group with
            which the fit is as good as without one.
        orientation: the crystal's axes in the coordinates of the points, columns of a rotation
            [d, d], or degrees; the points' own axis by default.
        moduli: "long waves" holds those that a fit of long waves finds, None holds none, a Voigt
            matrix (crystal's axes) [stress], shape [3, 3], in space [6, 6], holds its own.
        normalise: weigh each sample by 1/‖b‖.

    `fit` raises InputError for several sets, scattered points, or a symmetry that is none.

    >>> wp.fit(samples, wp.Micromodulus(12.5, "4mm")).material.certificate.proven > 0
    True
    """

    horizon: float
    symmetry: Symmetry = "auto"
    orientation: Any = None
    moduli: Any = "long waves"
    normalise: bool = False

    def learn(self, samples: Samples | Dataset, *, progress: bool | None = None) -> MaterialFit:
        """The fit; errors as of learning.fit. It is one least squares, with no progress to show."""
        sets = one_set(samples)
        stated = sets.axis if self.orientation is None else self.orientation
        material = fit(sets, **(vars(self) | {"orientation": stated}))
        return MaterialFit(material, dict(material.provenance["fit"]))


def one_set(samples: Any) -> Samples:
    """The samples of one set; of a Dataset `train`, or its only set."""
    if isinstance(samples, (list, tuple)) and len(samples) != 1:
        raise InputError(f"samples: expected one set for a crystal model, got {len(samples)}")
    given = samples[0] if isinstance(samples, (list, tuple)) else samples
    if isinstance(given, Dataset):
        return given.obvious("train")
    if not isinstance(given, Samples):
        raise InputError(f"samples: expected Samples, got {type(given).__name__}")
    check_lattice(given)
    return given
