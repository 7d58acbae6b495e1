"""Crystals: point groups, symmetries shared with a lattice of nodes; elastic tensors and strain.

Every group contains the inversion, C(−ξ) = C(ξ) (theory, T5). Elastic tensors are [d, d, d, d];
Voigt's order is 11, 22, 33, 23, 13, 12, in the plane 11, 22, 12, with engineering shears (T3–T6).
"""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Sequence
from functools import lru_cache
from typing import Any, TypeAlias

import numpy as np
from numpy import ndarray
from numpy.linalg import eigvalsh, inv, lstsq, solve, svd
from numpy.typing import ArrayLike

from warp_peri.errors import InputError, Several, optional
from warp_peri.points.arguments import Pair, checked, typed
from warp_peri.points.points import grid_places, unit_vectors

Symmetry: TypeAlias = str | ndarray | Sequence[ArrayLike]
"""Name of a point group, or rotations of one, shape [G, d, d]."""
TOLERANCE = 1e-5
"""Of the entries of a rotation that maps a lattice onto itself."""
GOLDEN_ANGLE = np.pi * (1 + np.sqrt(5))
MOST = 400
"""Rotations beyond which generators do not close."""

# Generators in the crystal's axes; the principal axis is the third, in two dimensions the normal.
# Twelvefold turns leave an elastic sheet isotropic; in space "isotropic" is cubic with one equation
# more (elastic.allowed_tensors), since no finite group holds the cube's and makes it so.
_PLANE = {
    "1": "", "2": "", "m": "m", "2mm": "m", "4": "4", "4mm": "4 m", "3": "3", "3m": "3 m",
    "6": "6", "6mm": "6 m", "isotropic": "12 m",
}  # fmt: skip
_SOLID = {
    "-1": "", "2/m": "2", "mmm": "2 m", "4/m": "4", "4/mmm": "4 m", "-3": "3", "-3m": "3 m",
    "6/m": "6", "6/mmm": "6 m", "m-3": "2 m cycle", "m-3m": "4 m cycle",
    "isotropic": "4 m cycle",
}  # fmt: skip
_ALIASES = {
    "1": "-1", "2": "2/m", "m": "2/m", "222": "mmm", "mm2": "mmm", "4": "4/m", "-4": "4/m",
    "422": "4/mmm", "4mm": "4/mmm", "-42m": "4/mmm", "-4m2": "4/mmm", "3": "-3", "32": "-3m",
    "3m": "-3m", "6": "6/m", "-6": "6/m", "622": "6/mmm", "6mm": "6/mmm", "-6m2": "6/mmm",
    "-62m": "6/mmm", "23": "m-3", "m3": "m-3", "432": "m-3m", "-43m": "m-3m", "m3m": "m-3m",
}  # fmt: skip
LEAST = {2: "1", 3: "-1"}
CANDIDATES = {
    2: ("isotropic", "4mm", "4", "2mm", "1"),
    3: ("isotropic", "m-3m", "4/mmm", "mmm", "2/m", "-1"),
}
"""Groups that a fit to fields tries, from the largest."""

KNOWN = ("numbers", "initial_magmoms", "initial_charges", "tags", "mmcharges", "type")
COUNTED = ("positions", "id", "spacegroup_kinds")
"""Arrays of an ase.Atoms that calculators go by, and those that number all atoms of a file."""
LATTICE_GROUP = {2: "4mm", 3: "m-3m"}
"""Of a square and of a cubic lattice of nodes."""
PAIRS = {2: ((0, 0), (1, 1), (0, 1)), 3: ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))}
"""Voigt's order."""
SAME = 1e-3
"""What a name does not allow of an elastic tensor may be this, relative to its largest entry."""
BROKEN = 1e-8
"""Relative, that tensors of a symmetry may break it."""
SINGLE = 1e-6
"""Relative, that matrices may be less than symmetric: some roundings in single precision."""
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


def about_third(degrees: float) -> ndarray:
    """Rotation about the third axis, shape [3, 3]."""
    cos, sin = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])


GENERATORS = {str(n): about_third(360 / n) for n in (2, 3, 4, 6, 12)}
GENERATORS |= {"m": np.diag([1.0, -1.0, 1.0]), "cycle": np.eye(3)[[1, 2, 0]]}


def point_group(symmetry: Symmetry, dimension: int) -> ndarray:
    """Matrices of a point group, as "4mm" or "m3m", in the crystal's axes with the inversion, [G,
    d, d]; InputError for an unknown name, or matrices that are not rotations."""
    if isinstance(symmetry, str):
        table, aliases = (_PLANE, {}) if dimension == 2 else (_SOLID, _ALIASES)
        words = table.get(aliases.get(symmetry, symmetry))
        if words is None:
            raise InputError(f"symmetry: expected one of {', '.join(table)}, got {symmetry!r}")
        named = [GENERATORS[word][:dimension, :dimension] for word in words.split()]
        return _closed(named, dimension)
    given = checked("symmetry", symmetry, float, ("G", dimension, dimension))
    off = np.abs(given @ given.mT - np.eye(dimension)).max()
    if off > TOLERANCE:
        raise InputError(f"symmetry: expected rotations, got matrices off by {off:.1e}")
    return _closed(list(given), dimension)


def name_of(group: ndarray) -> Symmetry:
    """Name of a point group along its usual axes; the matrices where there is none."""
    d = group.shape[1]
    for name in reversed(_PLANE if d == 2 else _SOLID):
        known = point_group(name, d)
        if name != "isotropic" and len(known) == len(group):
            off = np.abs(group[:, None] - known).max(axis=(2, 3)).min(axis=1)
            if off.max() < TOLERANCE:
                return name
    return group


def _closed(generators: list[ndarray], dimension: int) -> ndarray:
    """All products of the generators and the inversion."""
    found = [np.eye(dimension), -np.eye(dimension)]
    waiting = list(found)
    while waiting:
        last = waiting.pop()
        for g in generators:
            new = g @ last
            if np.abs(found - new).max(axis=(1, 2)).min() > 10 * TOLERANCE:
                found.append(new)
                waiting.append(new)
                if len(found) > MOST:
                    raise InputError("symmetry: expected a finite group of rotations")
    return np.array(found)


def shared_with_nodes(group: ndarray, orientation: ndarray) -> ndarray:
    """Symmetries that a square or cubic lattice of nodes shares with a crystal's group: integer
    matrices in the nodes' axes, [g, d, d] (theory, T5)."""
    turned = orientation @ group @ orientation.T
    whole = np.rint(turned)
    return np.asarray(whole[np.abs(turned - whole).max(axis=(1, 2)) < TOLERANCE].astype(np.int64))


def lattice_group(dimension: int) -> ndarray:
    """All symmetries of a square or cubic lattice, integer matrices, shape [g, d, d]."""
    return shared_with_nodes(point_group(LATTICE_GROUP[dimension], dimension), np.eye(dimension))


def checked_orientation(orientation: Any, dimension: int) -> ndarray:
    """Rotation from the crystal's axes to the nodes', of degrees or a matrix; else InputError."""
    given = checked("orientation", np.eye(dimension) if orientation is None else orientation)
    if given.ndim == 0:
        return about_third(float(given))[:dimension, :dimension]
    one = np.eye(dimension)
    if given.shape != one.shape or np.abs(given @ given.T - one).max() > TOLERANCE:
        words = f"degrees, or a rotation of shape [{dimension}, {dimension}]"
        raise InputError(f"orientation: expected {words}, got {given.tolist()!r:.80}")
    return given


def kinds_of(atoms: Any, names: Sequence[str] | None = None) -> Pair:
    """Numbers that tell the atoms of an ase.Atoms apart, [n], and a first atom of each kind. Atoms
    of one kind agree, to three decimals, in the named arrays, or all but those of COUNTED."""
    told = []
    for name, values in atoms.arrays.items():
        if name not in COUNTED if names is None else name in names:
            values = np.round(values, 3) if values.dtype.kind == "f" else values
            told.append(np.unique(values, axis=0, return_inverse=True)[1].reshape(-1))
    _, first, kinds = np.unique(np.transpose(told), axis=0, return_index=True, return_inverse=True)
    return kinds.reshape(-1), first


def by_spglib(ask: str, crystal: Several, precision: float, **how: bool) -> Any:
    """Call spglib's `ask` on a crystal (edges of its cell as rows [Å], fractional coordinates,
    species), sites within `precision` [Å]; InputError where spglib is missing, or finds nothing."""
    spglib = optional(
        "spglib",
        "symmetry: auto asks spglib for the group of a structure: pip install "
        "'warp_peri[crystals]', or name the group",
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of how it will report errors one day
        found = getattr(spglib, ask)(crystal, symprec=precision, **how)
    if found is None:
        raise InputError("symmetry: spglib finds none of this structure")
    return found


def primitive_cell(crystal: Several, precision: float) -> Any:
    """Primitive cell of a crystal, in the axes given."""
    return by_spglib("standardize_cell", crystal, precision, to_primitive=True, no_idealize=True)


def group_of_structure(
    cell: ndarray, fractions: ndarray, species: ndarray, *, precision: float = 1e-4
) -> ndarray:
    """Point group of an atomic structure in the axes of its cell, [G, d, d]; as by_spglib."""
    # of the primitive cell: a larger one hides turns that are no whole numbers of its edges
    small = primitive_cell((np.asarray(cell, float), fractions, species), precision)
    found, edges = by_spglib("get_symmetry", small, precision), np.array(small[0]).T
    return point_group(edges @ found["rotations"].astype(float) @ inv(edges), 3)


def canonical(vectors: ndarray, group: ndarray, margin: float | ndarray = 0.0) -> ndarray:
    """Whether each vector [K, d], or some of its cell of half side `margin`, lies in one cone whose
    images under the group fill space: nearest to one direction in general position (T12)."""
    direction = np.array([1.0, 0.6137, 0.2719])[: vectors.shape[1]]
    kept = np.ones(len(vectors), bool)
    for face in np.unique(np.round(direction - direction @ group, 12), axis=0):
        kept &= vectors @ face + margin * np.abs(face).sum() >= -1e-12
    return kept


def orbit_grid(intervals: int, group: ndarray, dimension: int) -> ndarray:
    """Grid points on [−π, π]^d, one of each orbit, without 0, shape [K, d]; read only."""
    return _orbits(intervals, group.astype(np.int64).tobytes(), dimension)


@lru_cache(maxsize=8)
def _orbits(intervals: int, bytes_of_group: bytes, dimension: int) -> ndarray:
    group = np.frombuffer(bytes_of_group, np.int64).reshape(-1, dimension, dimension)
    grid = grid_places(dimension * (2 * intervals + 1,)) - intervals
    grid = grid[canonical(grid.astype(float), group) & grid.any(axis=1)]
    wave = grid * (np.pi / intervals)
    wave.flags.writeable = False
    return wave


def directions(count: int, dimension: int) -> ndarray:
    """Unit vectors spread evenly over half the circle, or over the sphere, shape [count, d]."""
    number = np.arange(count) + 0.5
    if dimension == 2:
        return unit_vectors(np.pi * number / count)
    z = 1 - 2 * number / count
    angle = GOLDEN_ANGLE * number
    r = np.sqrt(1 - z * z)
    return np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1)


def brackets_from_elastic(tensor: ndarray) -> ndarray:
    """Brackets [ij, kl] = (C_ikjl + C_iljk)/2 of an elastic tensor: the inverse of (T4)."""
    return symmetric_part(np.einsum("...agbl->...abgl", tensor))


def stress_brackets(stress: ndarray) -> ndarray:
    """Brackets δ_ij σ_kl that a held stress adds to those of a crystal (T19)."""
    return np.asarray(np.einsum("ij,kl->ijkl", np.eye(len(stress)), stress))


def bracket_rows(brackets: ndarray) -> ndarray:
    """All independent entries [ij, kl] of P bracket tensors, shape [E, P]."""
    return voigt(brackets).reshape(len(brackets), -1).T


def huang_rows(brackets: ndarray) -> ndarray:
    """Huang's relations [ij, kl] − [kl, ij] = 0 of P bracket tensors, shape [E, P]."""
    pairs = voigt(brackets)
    first, second = np.triu_indices(pairs.shape[-1], 1)
    return np.asarray((pairs - pairs.mT)[:, first, second].T)


def voigt(tensor: ndarray) -> ndarray:
    """Voigt matrix of tensors [..., d, d, d, d], 3 × 3 in the plane, 6 × 6 in space."""
    i, j = np.transpose(PAIRS[tensor.shape[-1]])
    return tensor[..., i[:, None], j[:, None], i, j]


def plane_isotropic(lam: float, mu: float) -> ndarray:
    """Voigt matrix of λ and μ in the plane [stress], shape [3, 3]."""
    C = np.diag([lam + 2 * mu, lam + 2 * mu, mu])
    C[0, 1] = C[1, 0] = lam
    return C


@typed
def voigt_to_tensor(moduli: ndarray) -> ndarray:
    """Elastic tensor [d, d, d, d] of a Voigt matrix; InputError unless symmetric and finite."""
    matrix = checked("moduli", moduli)
    if matrix.shape not in ((3, 3), (6, 6)):
        raise InputError(f"moduli: expected 3 × 3 or 6 × 6, got {list(matrix.shape)}")
    checked_symmetric("moduli", matrix)
    d = 2 if len(matrix) == 3 else 3
    (i, j), place = np.transpose(PAIRS[d]), np.zeros((d, d), int)
    place[i, j] = place[j, i] = np.arange(len(matrix))
    return matrix[place[:, :, None, None], place]


def turned(tensor: ndarray, rotation: ndarray) -> ndarray:
    """Elastic tensor of a rotated crystal: R R R R C."""
    R = 4 * [rotation]
    return np.asarray(np.einsum("ai,bj,ck,dl,ijkl->abcd", *R, tensor, optimize=True))


def allowed_tensors(symmetry: Symmetry, orientation: ndarray) -> ndarray:
    """Basis of the elastic tensors that a crystal's group allows, nodes' axes, [m, d, d, d, d]."""
    d = len(orientation)
    if isinstance(symmetry, str) and symmetry == "isotropic" and d == 3:
        one = np.eye(3)
        bulk = np.einsum("ij,kl->ijkl", one, one)
        across = bulk.swapaxes(1, 2)  # δ_ik δ_jl
        return np.array([bulk, across + across.swapaxes(2, 3)])
    basis = []
    for m, n in zip(*np.triu_indices(len(PAIRS[d]))):
        one = np.zeros(2 * (len(PAIRS[d]),))
        one[m, n] = one[n, m] = 1.0
        basis.append(voigt_to_tensor(one).ravel())
    group = point_group(symmetry, d)
    pairs = np.einsum("gai,gbj->gabij", group, group).reshape(len(group), d * d, d * d)
    mean = np.einsum("gmn,gop->monp", pairs, pairs, optimize=True) / len(group)
    _, sizes, rows = svd(basis @ mean.reshape(d**4, d**4).T, full_matrices=False)
    found = rows[sizes > 1e-9 * sizes[0]].reshape(-1, d, d, d, d)
    return np.array([turned(tensor, orientation) for tensor in found])


def acoustic(brackets: ndarray, e: ndarray) -> ndarray:
    """Acoustic tensor Q(e) = [ij, kl] e_k e_l, D(k) at long waves, shape [K, d, d]."""
    return np.asarray(np.einsum("ijkl,nk,nl->nij", brackets, e, e, optimize=True))


def q1_tensors(elastic: ndarray) -> Pair:
    """Steps and C(ξ) h² [H, d, d] [stress] of Q1 elements of side h, two Gauss points an axis."""
    d = len(elastic)
    corner = grid_places((2,) * d)
    side = 2 * corner - 1
    stiffness = np.zeros((len(corner), d, len(corner), d))
    for point in itertools.product((-(3**-0.5), 3**-0.5), repeat=d):
        factor = (1 + side * point) / 2
        slope = np.stack(
            [side[:, a] * np.prod(np.delete(factor, a, axis=1), axis=1) for a in range(d)], axis=1
        )  # per side length, at one of 2^d points of weight 2^−d
        stiffness += np.einsum("pj,qn,ijmn->piqm", slope, slope, elastic, optimize=True) / 2**d
    found: dict[tuple[int, ...], ndarray] = {}
    for a, b in itertools.product(range(len(corner)), repeat=2):
        step = tuple((corner[b] - corner[a]).tolist())
        if step > (0,) * d:
            found[step] = found.get(step, np.zeros((d, d))) - stiffness[a, :, b, :]
    return np.array(list(found)), symmetric_part(np.array(list(found.values())))


def central_weights(reach: int) -> ndarray:
    """Weights w with u′ ≈ Σ w_m (u(m) − u(−m)), m = 1 … reach unit spacings, of order 2 reach."""
    m = np.arange(1, reach + 1)
    ways = np.cumprod((reach + 1 - m) / (reach + m))  # r!²/((r − m)! (r + m)!)
    return -((-1.0) ** m) * ways / m


def difference_tensors(elastic: ndarray, reach: int) -> Pair:
    """Steps and C(ξ) h² of central differences of order 2 reach, as q1_tensors."""
    d, ways = len(elastic), [*enumerate(central_weights(reach), 1)]
    unit = np.eye(d, dtype=int)
    found = [
        (step * unit[a], 2 * weight / step * elastic[:, a, :, a])
        for a in range(d)
        for step, weight in ways
    ]
    for a, b in itertools.combinations(range(d), 2):
        mixed = elastic[:, a, :, b] + elastic[:, b, :, a]
        for (i, one), (j, two), sign in itertools.product(ways, ways, (1, -1)):
            found.append((i * unit[a] + sign * j * unit[b], sign * one * two * mixed))
    steps, tensors = map(np.array, zip(*found))
    return steps, symmetric_part(tensors)


def compliance(tensor: ndarray) -> ndarray:
    """Compliance S_ijkl with ε = S σ; InputError for a singular elastic tensor."""
    d, matrix = len(tensor), voigt(tensor)
    if not eigvalsh(matrix).min() > 0:
        raise InputError("moduli: expected a stable crystal, got an elastic tensor that is none")
    engineering = np.where(np.arange(len(matrix)) < d, 1.0, 0.5)
    return voigt_to_tensor(inv(matrix) * np.outer(engineering, engineering))


def named_symmetry(tensor: ndarray) -> str:
    """Symmetry of an elastic tensor in the axes it is given in: a key of NAMES, or "lower"."""
    d, tiny = len(tensor), SAME * np.abs(voigt(tensor)).max()
    for name, symmetry in NAMES[d].items():
        allowed = allowed_tensors(symmetry, np.eye(d)).reshape(-1, d**4)
        held = lstsq(allowed.T, tensor.ravel())[0] @ allowed
        if np.abs(tensor.ravel() - held).max() <= tiny:
            return name
    return "lower"


def named_moduli(tensor: ndarray) -> dict[str, float]:
    """Nonzero elastic constants by name, equal ones once; in the plane C44 is the shear modulus."""
    M, label = voigt(tensor), "123456" if len(tensor) == 3 else "124"
    found = {f"C{label[m]}{label[n]}": float(M[m, n]) for m, n in zip(*np.triu_indices(len(M)))}
    if (name := named_symmetry(tensor)) in KEPT:
        return {constant: found[constant] for constant in KEPT[name]}
    tiny = SAME * 1e-3 * np.abs(M).max()
    return {constant: value for constant, value in found.items() if abs(value) > tiny}


def plane_stress(tensor: ndarray) -> ndarray:
    """Plane-stress tensor of a sheet free of stresses 33, 23 and 13: a Schur complement (T6)."""
    M = voigt(tensor)
    kept, free = [0, 1, 5], [2, 3, 4]
    inner = solve(M[np.ix_(free, free)], M[np.ix_(free, kept)])
    return voigt_to_tensor(symmetric_part(M[np.ix_(kept, kept)] - M[np.ix_(kept, free)] @ inner))


def symmetric_part(A: ndarray) -> ndarray:
    """Symmetric part (A + Aᵗ)/2 of matrices [..., d, d]."""
    return np.asarray(A + A.mT) / 2


def checked_symmetric(name: str, given: Any, shape: Any = None) -> ndarray:
    """Symmetric part of matrices [..., d, d], in single precision too; InputError as `checked`, and
    for others."""
    A = checked(name, given, float, shape)
    if np.abs(A - A.mT).max() > SINGLE * np.abs(A).max():
        raise InputError(f"{name}: expected symmetric matrices")
    return symmetric_part(A)


def times(A: ndarray, B: ndarray) -> ndarray:
    """Matrix products A B, each [d, d, ...]."""
    return np.asarray(np.einsum("ab...,bc...->ac...", A, B))


def symmetric(A: ndarray) -> ndarray:
    """Symmetric part (A + Aᵗ)/2 of matrices [d, d, ...]."""
    return np.asarray(A + A.swapaxes(0, 1)) / 2


def in_shape_of(u: Any, values: Any) -> ndarray:
    """Values of fields, [S, n, ...], in the leading shape of the fields u, [..., N, d]."""
    return np.reshape(values, (*np.shape(u)[:-2], *np.shape(values)[1:]))


def contracted(C: ndarray, X: ndarray) -> ndarray:
    """Tensor C [d, d, ...] times X, summed over all its other axes; tensordot takes longer."""
    of = C[0, 0]
    found = C.reshape(-1, of.size) @ X.reshape(of.size, -1)
    return np.reshape(found, C.shape[:2] + X.shape[of.ndim :])


def strain_rate(H: ndarray, X: ndarray) -> ndarray:
    """Derivative of the Green strain at H along X, each [d, d, ...]."""
    return symmetric(X + times(H.swapaxes(0, 1), X))


def strain(H: ndarray) -> ndarray:
    """Green strain (H + Hᵗ + HᵗH)/2 of gradients [d, d, ...]."""
    return strain_rate(H / 2, H)
