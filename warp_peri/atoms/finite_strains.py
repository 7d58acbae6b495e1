"""Elastic constants by finite strains, with their errors, and force constants joined with them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import ase
import numpy as np

from warp_peri.atoms.calculator_noise import (
    EV_IN_TPA,
    PULLED,
    SMALLER,
    TIMES,
    strained,
    unit_strains,
)
from warp_peri.atoms.force_constants import ForceConstants, relaxing
from warp_peri.core.elastic import PAIRS, voigt


def by_strains(
    cell: ase.Atoms,
    calculator: Any,
    largest: float,
    atoms: ForceConstants,
    allowed: np.ndarray,
    *,
    rough: bool = False,
) -> tuple[np.ndarray, np.ndarray] | None:
    """C_ijkl [TPa] by finite strains, atoms relaxed by force constants, and standard errors.

    By differences of the second Piola–Kirchhoff stress S = det F · F⁻¹ σ F⁻ᵗ, so that the stress of
    a crystal that is held counts as (T19) has it.

    Args:
        cell: at rest.
        calculator: with forces and stress; None is returned where it has none.
        largest: strain.
        atoms: force constants.
        allowed: elastic tensors of the symmetry, shape [m, d, d, d, d].
        rough: whether slopes depend on the size of strains: those of the whole size are taken then,
            and how those of each smaller one differ are the last errors.

    Returns [d, d, d, d] and [Q, d, d, d, d].
    """
    d, e = atoms.dimension, largest * np.array(PULLED)
    try:
        S, F = _under_strain(cell, calculator, e, atoms)
    except NotImplementedError:
        return None
    means = (S.sum(axis=0) / 2).reshape(len(e), -1)
    even = np.linalg.lstsq(np.column_stack([e**0, e**2]), means)[0]
    slope, error, gain = _slope((S[0] - S[1]) / 2, e, rough)
    few = [slice(k, k + 1) for k in range(SMALLER)] if rough else [slice(0, 2)]
    short, _, wider = zip(*(_slope((S[0] - S[1])[k] / 2, e[k], rough) for k in few))
    onto = np.linalg.pinv(voigt(allowed).reshape(len(allowed), -1).T)
    C, *off = (np.tensordot(onto @ one.ravel(), allowed, 1) for one in (slope, *(slope - short)))
    errors = [*np.tensordot(error * onto.T, allowed, 1)]
    seen = TIMES * error * wider[0] / gain * np.linalg.norm(onto, "nuc")
    if not rough and np.linalg.norm(onto @ (slope - short[0]).ravel()) > seen:
        errors.append(off[0])
    # a stress that is left strains the crystal; how stiffness goes with strain is in even parts
    rest = even[0].reshape(len(PAIRS[d]), -1).mean(axis=0)
    if atoms.stress is not None:
        rest = rest - [atoms.stress[pair] for pair in PAIRS[d]]
    strain = np.abs(np.linalg.solve(voigt(C), rest)).max()
    errors.append(2 * np.abs(even[1]).max() / np.abs(C).max() * strain * C)
    if len(cell) > 1:
        push, tau, _ = _slope((F[0] - F[1]) / 2, e, rough)
        Lambda = np.zeros((len(cell), 3, d, d))
        for kind, (i, j) in enumerate(PAIRS[d]):
            Lambda[..., i, j] = Lambda[..., j, i] = push[kind]
        taken, more = _relaxed(atoms, Lambda, tau, allowed)
        errors += [*more]
        for one in () if atoms.doubt is None else atoms.doubt:
            errors.append(taken - _relaxed(atoms, Lambda, tau, allowed, atoms.values + one)[0])
        C = C - taken
    return C, np.array([*errors, *off] if rough else errors)


def _under_strain(
    cell: ase.Atoms, calculator: Any, e: np.ndarray, atoms: ForceConstants
) -> tuple[np.ndarray, np.ndarray]:
    """S [TPa] and forces on atoms [eV/Å] under all strains of sizes e, either sign, one after one.

    Returns shapes [2, E, kinds of strain, components] and [2, E, kinds, n, 3].
    """
    d, n, flat = atoms.dimension, len(cell), atoms.thickness is not None
    G = np.eye(3) + np.einsum("e,s,kij->eksij", e, [1, -1], unit_strains(d))
    many = cell.repeat((2, 2, 1 if flat else 2))
    each = strained(calculator, many, G.reshape(-1, 3, 3))
    stresses, pushes = zip(*((one.get_stress(voigt=False), one.get_forces()) for one in each))
    tall = EV_IN_TPA * (cell.cell[2, 2] / atoms.thickness if flat else 1.0)
    back, place = np.linalg.inv(G), tuple(np.transpose(PAIRS[d]))
    pulled = np.linalg.det(G)[..., None, None] * back @ np.reshape(stresses, G.shape) * tall
    S = (pulled @ back.swapaxes(-1, -2))[..., *place].transpose(2, 0, 1, 3)
    mean = np.reshape(pushes, (*G.shape[:3], -1, n, 3)).mean(axis=3)
    return S, mean.transpose(2, 0, 1, 3, 4)


def _slope(y: np.ndarray, e: np.ndarray, secant: bool) -> tuple[np.ndarray, float, float]:
    """Slopes of y = a e + b e³, y [E, ...], their standard error, and that over the error of y.

    Of a secant b is zero.
    """
    X = e[:, None] if secant else np.column_stack([e, e**3])
    flat, P = y.reshape(len(e), -1), np.linalg.pinv(X)
    free = flat.shape[1] * max(len(e) - X.shape[1], 1)
    left = np.linalg.norm(flat - X @ P @ flat) / np.sqrt(free)
    gain = float(np.linalg.norm(P[0]))
    return (P[0] @ flat).reshape(y.shape[1:]), float(left) * gain, gain


def _relaxed(
    atoms: ForceConstants,
    push: np.ndarray,
    error: float,
    allowed: np.ndarray,
    values: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """What atoms that relax take off C [TPa], of the symmetry, and its standard errors.

    push: forces on atoms for a strain [eV/Å], shape [n, 3, d, d]; error: of one of its components.
    """
    n, d, m = len(push), atoms.dimension, atoms.moving
    push = (push - push.mean(axis=0))[:, :m].reshape(n * m, d, d)
    stiff = atoms.moments(values)[0][:, :m, :, :m].reshape(n * m, n * m)
    moved = np.tensordot(relaxing(stiff, m), push, 1)
    size = EV_IN_TPA / atoms.volume
    onto = np.linalg.pinv(allowed.reshape(len(allowed), -1).T)
    taken = onto @ np.einsum("Iab,Icd->abcd", push, moved).ravel() * size
    each = np.einsum("mabcd,Icd->Iabm", onto.reshape(allowed.shape), moved).reshape(-1, len(onto))
    return np.tensordot(taken, allowed, 1), np.tensordot(2 * size * error * each, allowed, 1)


def joined(
    atoms: ForceConstants,
    allowed: np.ndarray,
    C: np.ndarray,
    errors: np.ndarray,
    *,
    shared: int = 0,
) -> tuple[ForceConstants, float, float]:
    """Force constants moved by their own errors until their moduli agree with others (R. Kalman).

    Args:
        atoms: force constants with `doubt`.
        allowed: elastic tensors of the symmetry, shape [m, d, d, d, d].
        C, errors: of finite strains, as `by_strains` gives them.
        shared: how many of the last errors are of both, so that joining makes them no smaller.

    Returns them, χ² between both for each modulus, and how far Φ moved. Errors of force constants
    are widened by √χ² above one, for what they know nothing of: a supercell that forces leave.
    """
    onto = np.linalg.pinv(allowed.reshape(len(allowed), -1).T)
    own, both = np.split(onto @ errors.reshape(len(errors), -1).T, [len(errors) - shared], axis=1)
    other, seen = onto @ C.ravel(), onto @ atoms.nearest_elastic(allowed)[0].ravel()
    off = other - seen

    def compared() -> tuple[np.ndarray, float]:
        J = onto @ atoms.elastic_doubt(allowed).reshape(-1, onto.shape[1]).T
        return J, float(off @ np.linalg.pinv(J @ J.T + own @ own.T) @ off) / len(allowed)

    J, chi = compared()
    wider = chi
    if atoms.spread is not None:  # moduli would else tell how all of Φ changes with displacements
        atoms = replace(atoms, doubt=atoms.spread, spread=None)
        J, wider = compared()
    doubt, J = (max(1.0, wider**0.5) * np.asarray(one) for one in (atoms.doubt, J))
    gain = J.T @ np.linalg.pinv(J @ J.T + own @ own.T)
    values, step = atoms.values, np.zeros(len(doubt))
    for _ in range(3):  # moduli bend a little in Φ where atoms of a cell relax
        step = gain @ (other - seen + J @ step)
        values = atoms.values + np.tensordot(step, doubt, 1)
        seen = onto @ atoms.nearest_elastic(allowed, values)[0].ravel()
    parts, vectors = np.linalg.eigh(np.eye(len(doubt)) - gain @ J)
    left = (vectors * np.sqrt(np.clip(parts, 0, None))).T, (np.linalg.pinv(J) @ both).T
    after = np.tensordot(np.concatenate(left), doubt, 1)
    moved = float(np.linalg.norm(values - atoms.values) / np.linalg.norm(atoms.values))
    return replace(atoms, values=values, doubt=after), chi, moved
