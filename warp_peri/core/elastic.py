"""Elastic tensors: from the tensors of bonds, as Voigt matrices, and what is read off them.

An elastic tensor has the shape [d, d, d, d] here; Voigt's order is 11, 22, 33, 23, 13, 12, and 11,
22, 12 in the plane, with engineering shear strains (theory, T3–T6).
"""

from __future__ import annotations

import numpy as np

from warp_peri.core.groups import Symmetry, point_group
from warp_peri.core.stencil import directions
from warp_peri.errors import InputError
from warp_peri.points.arguments import typed
from warp_peri.points.arrays import checked

PAIRS = {2: ((0, 0), (1, 1), (0, 1)), 3: ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))}
"""Voigt's order."""
DIRECTIONS = 2880
"""Along which extremes are looked for; in the plane every sixteenth of a degree."""
SAME = 1e-3
"""What a name does not allow of an elastic tensor may be this, relative to its largest entry."""
NAMES = {
    2: {"isotropic": "isotropic", "square": "4mm", "orthotropic": "2mm"},
    3: {"isotropic": "isotropic", "cubic": "m-3m", "hexagonal": "6/mmm", "tetragonal": "4/mmm",
        "orthotropic": "mmm"},
}  # fmt: skip
"""What elastic tensors are called, and the groups that leave them as they are, largest first."""
KEPT: dict[str, tuple[str, ...]] = dict.fromkeys(
    ("isotropic", "square", "cubic"), ("C11", "C12", "C44")
)
KEPT |= dict.fromkeys(("hexagonal", "tetragonal"), ("C11", "C12", "C13", "C33", "C44", "C66"))
"""Elastic constants that symmetry leaves, once each, by its name."""


def elastic_from_brackets(brackets: np.ndarray) -> np.ndarray:
    """C_ijkl = [ik, jl] + [jk, il] − [jl, ik] of brackets [ij, kl], same shape (T4).

    Symmetric as an elastic tensor is where Huang's relations hold.
    """
    first = np.einsum("...abgl->...agbl", brackets)
    second = np.einsum("...bgal->...agbl", brackets)
    third = np.einsum("...blag->...agbl", brackets)
    tensor: np.ndarray = first + second - third
    return tensor


def brackets_from_elastic(tensor: np.ndarray) -> np.ndarray:
    """[ij, kl] = (C_ikjl + C_iljk)/2, what an elastic solid has: the inverse of (T4)."""
    plain = np.einsum("...agbl->...abgl", tensor)
    brackets: np.ndarray = (plain + plain.swapaxes(-1, -2)) / 2
    return brackets


def stress_brackets(stress: np.ndarray) -> np.ndarray:
    """δ_ij σ_kl, what a stress that a crystal is held under adds to [ij, kl] (T19)."""
    return np.asarray(np.einsum("ij,kl->ijkl", np.eye(len(stress)), stress))


def bracket_rows(brackets: np.ndarray) -> np.ndarray:
    """All independent [ij, kl] of each of P tensors, shape [E, P]."""
    return _independent(brackets).reshape(len(brackets), -1).T


def huang_rows(brackets: np.ndarray) -> np.ndarray:
    """[ij, kl] − [kl, ij] of each of P tensors, shape [E, P]: Huang's relations set them to 0."""
    pairs = _independent(brackets)
    first, second = np.triu_indices(pairs.shape[-1], 1)
    return np.asarray((pairs - pairs.swapaxes(1, 2))[:, first, second].T)


def _independent(brackets: np.ndarray) -> np.ndarray:
    """[ij, kl] for i ≤ j and k ≤ l, shape [P, pairs, pairs]."""
    i, j = np.triu_indices(brackets.shape[-1])
    return np.asarray(brackets[:, i[:, None], j[:, None], i, j])


def voigt(tensor: np.ndarray) -> np.ndarray:
    """Elastic tensor [..., d, d, d, d] as a matrix, 3 × 3 in the plane and 6 × 6 in space."""
    i, j = np.transpose(PAIRS[tensor.shape[-1]])
    return np.asarray(tensor[..., i[:, None], j[:, None], i, j])


def plane_isotropic(lam: float, mu: float) -> np.ndarray:
    """The elastic matrix of λ and μ in the plane [stress], Voigt, shape [3, 3]."""
    C = np.diag([lam + 2 * mu, lam + 2 * mu, mu])
    C[0, 1] = C[1, 0] = lam
    return C


@typed
def voigt_to_tensor(moduli: np.ndarray) -> np.ndarray:
    """The elastic tensor [d, d, d, d] of a symmetric Voigt matrix.

    Raises InputError for another shape, a matrix that is not symmetric or not finite.
    """
    matrix = checked("moduli", moduli)
    if matrix.shape not in ((3, 3), (6, 6)):
        raise InputError(f"moduli: expected 3 × 3 or 6 × 6, got {list(matrix.shape)}")
    if np.abs(matrix - matrix.T).max() > 1e-8 * np.abs(matrix).max():
        raise InputError("moduli: expected a symmetric matrix")
    d = 2 if len(matrix) == 3 else 3
    (i, j), place = np.transpose(PAIRS[d]), np.zeros((d, d), int)
    place[i, j] = place[j, i] = np.arange(len(matrix))
    return np.asarray(matrix[place[:, :, None, None], place])


def turned(tensor: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """The tensor of a turned crystal: R R R R C."""
    R = rotation
    return np.asarray(np.einsum("ai,bj,ck,dl,ijkl->abcd", R, R, R, R, tensor, optimize=True))


def invariant_tensors(group: np.ndarray) -> np.ndarray:
    """A basis of the elastic tensors that a group leaves as they are, shape [m, d, d, d, d]."""
    d = group.shape[-1]
    basis = []
    for m, n in zip(*np.triu_indices(len(PAIRS[d]))):
        one = np.zeros(2 * (len(PAIRS[d]),))
        one[m, n] = one[n, m] = 1.0
        basis.append(voigt_to_tensor(one).ravel())
    pairs = np.einsum("gai,gbj->gabij", group, group).reshape(len(group), d * d, d * d)
    mean = np.einsum("gmn,gop->monp", pairs, pairs, optimize=True) / len(group)
    flat = np.array(basis) @ mean.reshape(d**4, d**4).T
    _, sizes, rows = np.linalg.svd(flat, full_matrices=False)
    return np.asarray(rows[sizes > 1e-9 * sizes[0]].reshape(-1, d, d, d, d))


def allowed_tensors(symmetry: Symmetry, group: np.ndarray, orientation: np.ndarray) -> np.ndarray:
    """Elastic tensors that a crystal may have, in the axes of the nodes, [m, d, d, d, d]."""
    d = group.shape[-1]
    if isinstance(symmetry, str) and symmetry == "isotropic" and d == 3:
        one = np.eye(3)
        bulk = np.einsum("ij,kl->ijkl", one, one)
        shear = np.einsum("ik,jl->ijkl", one, one) + np.einsum("il,jk->ijkl", one, one)
        return np.array([bulk, shear])
    return np.array([turned(tensor, orientation) for tensor in invariant_tensors(group)])


def acoustic(brackets: np.ndarray, e: np.ndarray) -> np.ndarray:
    """Q(e) = [ij, kl] e_k e_l, what D(k) is at long waves, shape [K, d, d]."""
    return np.asarray(np.einsum("ijkl,nk,nl->nij", brackets, e, e, optimize=True))


def compliance(tensor: np.ndarray) -> np.ndarray:
    """S_ijkl, so that ε = S σ; InputError for a tensor that has none."""
    d = tensor.shape[0]
    matrix = voigt(tensor)
    if not np.linalg.eigvalsh(matrix).min() > 0:
        raise InputError("moduli: expected a stable crystal, got an elastic tensor that is none")
    engineering = np.where(np.arange(len(matrix)) < d, 1.0, 0.5)
    return voigt_to_tensor(np.linalg.inv(matrix) * np.outer(engineering, engineering))


def extremes(tensor: np.ndarray) -> tuple[list[float], list[float]]:
    """Smallest and largest Young's modulus and Poisson's number over all directions, [E], [ν].

    Along a dense set of directions; across each, ν is a quadratic form whose extremes are exact.
    """
    d, S = tensor.shape[0], compliance(tensor)
    if d == 2:
        angle = np.pi * np.arange(DIRECTIONS) / DIRECTIONS
        e = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    else:  # with those of a cube's edges, faces and corners, where a cubic crystal has its extremes
        e = np.array([v for v in np.ndindex(3, 3, 3) if v != (1, 1, 1)], dtype=float) - 1
        e = np.concatenate([e / np.linalg.norm(e, axis=1)[:, None], directions(DIRECTIONS, d)])
    across = np.linalg.svd(e[:, None])[2][:, 1:]  # [n, d − 1, d], at right angles to e
    long = np.einsum("ijkl,ni,nj,nk,nl->n", S, e, e, e, e, optimize=True)
    wide = np.einsum("ijkl,ni,nj,nak,nbl->nab", S, e, e, across, across, optimize=True)
    nu = np.linalg.eigvalsh(-wide / long[:, None, None])
    return [float(1 / long.max()), float(1 / long.min())], [float(nu.min()), float(nu.max())]


def named_symmetry(tensor: np.ndarray) -> str:
    """What an elastic tensor looks like in the axes it is given in.

    "isotropic", "cubic", "square", "hexagonal" (about the third axis), "tetragonal",
    "orthotropic", or "lower".
    """
    d, tiny = tensor.shape[0], SAME * np.abs(voigt(tensor)).max()
    for name, symmetry in NAMES[d].items():
        allowed = allowed_tensors(symmetry, point_group(symmetry, d), np.eye(d)).reshape(-1, d**4)
        held = np.linalg.lstsq(allowed.T, tensor.ravel(), rcond=None)[0] @ allowed
        if np.abs(tensor.ravel() - held).max() <= tiny:
            return name
    return "lower"


def named_moduli(tensor: np.ndarray) -> dict[str, float]:
    """Elastic constants by name that are not zero, those that symmetry makes equal once.

    In the plane C44 is the shear modulus, as for the other laws.
    """
    M, label = voigt(tensor), "123456" if len(tensor) == 3 else "124"
    found = {f"C{label[m]}{label[n]}": float(M[m, n]) for m, n in zip(*np.triu_indices(len(M)))}
    if (name := named_symmetry(tensor)) in KEPT:
        return {constant: found[constant] for constant in KEPT[name]}
    tiny = SAME * 1e-3 * np.abs(M).max()
    return {constant: value for constant, value in found.items() if abs(value) > tiny}


def plane_stress(tensor: np.ndarray) -> np.ndarray:
    """The plane tensor of a sheet free of stresses 33, 23 and 13: a Schur complement (T6)."""
    M = voigt(tensor)
    kept, free = [0, 1, 5], [2, 3, 4]
    inner = np.linalg.solve(M[np.ix_(free, free)], M[np.ix_(free, kept)])
    schur = M[np.ix_(kept, kept)] - M[np.ix_(kept, free)] @ inner
    return voigt_to_tensor((schur + schur.T) / 2)
