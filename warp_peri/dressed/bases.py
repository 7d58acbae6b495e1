"""Positive bases: strains of a site of nodes, and what each part of them costs (D1–D4)."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from warp_peri.core.elastic import PAIRS, named_symmetry, voigt
from warp_peri.errors import InputError

KINDS = ("elements", "bonds")
EQUAL = 1e-6
"""Eigenvalues of an elastic tensor within this of one another, of the largest, are one part."""
NOTHING = 1e-14
"""Relative, of entries that are rounding."""
AXIS_WEIGHT, DIAGONAL_WEIGHT = 1 / 8, 1 / 16
"""w of the bonds (1, 0) and (1, 1): K(r) = 1/r with Σ w r² = 1 and equal moduli every way."""


@dataclass(frozen=True, eq=False)
class Base:
    """K = Σ over sites of Bᵗ (Σ_a m_a M_a) B / h², every M_a ⪰ 0: K ⪰ 0 for all m_a ≥ 0.

    One site a node x: its strains are B · u(x + corners)/h.

    Attributes:
        kind: "elements" or "bonds".
        corners: in spacings, shape [P, d].
        strains: B, shape [S, P, d]; one whose nodes are not all there is left out.
        parts: M_a, shape [A, S, S].
        moduli: m_a [stress] of the even solid, shape [A].
        names: of the parts, as "bulk" and "shear".
        middle: how much each corner says of a site's own modulus, shape [P].
    """

    kind: str
    corners: np.ndarray
    strains: np.ndarray
    parts: np.ndarray
    moduli: np.ndarray
    names: tuple[str, ...]
    middle: np.ndarray

    @cached_property
    def touched(self) -> np.ndarray:
        """Which corners a strain is made of, shape [S, P] bool."""
        return np.asarray(np.abs(self.strains).max(axis=2) > NOTHING)

    @cached_property
    def matrices(self) -> np.ndarray:
        """Bᵗ M_a B of a whole site, shape [A, P, d, P, d]."""
        B = self.strains
        return np.asarray(np.einsum("spi,ast,tqj->apiqj", B, self.parts, B, optimize=True))

    @cached_property
    def stencils(self) -> np.ndarray:
        """K_a h² of the even solid, F(ξ) with (K u)(x) = Σ F(ξ) u(x + ξ), [A, (2r + 1)^d, d, d]."""
        d = self.corners.shape[1]
        step = self.corners[None] - self.corners[:, None]
        reach = int(np.abs(step).max())
        found = np.zeros((len(self.moduli), *[2 * reach + 1] * d, d, d))
        for p, q in itertools.product(range(len(self.corners)), repeat=2):
            found[(slice(None), *(step[p, q] + reach))] += self.matrices[:, p, :, q]
        return np.asarray(found * self.moduli.reshape(-1, *[1] * (d + 2)))


def base(kind: str, tensor: np.ndarray, dilatation: float = AXIS_WEIGHT) -> Base:
    """The base of a name for an elastic tensor [stress] along the nodes' axes, [d, d, d, d].

    "elements": squares or cubes of multilinear displacement, any tensor; their parts are what the
    tensor's eigenstrains store (D2). "bonds": a linear peridynamic solid with K(r) = 1/r on eight
    bonds in the plane, isotropic, which may break (D3). `dilatation` is the weight in θ of its
    bonds along the axes; 1/8 is that of 1/r, another a second influence function (D26).

    Raises InputError for another name, a tensor that is not stable, and one that a base cannot
    have.
    """
    if kind not in KINDS:
        raise InputError(f"base: expected one of {', '.join(KINDS)}, got {kind!r:.50}")
    if kind == "elements":
        if dilatation != AXIS_WEIGHT:
            raise InputError("dilatation: expected a base of bonds, got elements")
        return _elements(tensor)
    found = bonds(tensor, dilatation)
    reach = dilatation_range(tensor)
    if not abs(dilatation - AXIS_WEIGHT) <= reach:
        raise InputError(
            f"dilatation: expected a weight within {reach:.3g} of {AXIS_WEIGHT}, beyond which a "
            f"broken body may be unstable, got {dilatation:g}"
        )
    return found


def _elements(tensor: np.ndarray) -> Base:
    d = tensor.shape[0]
    moduli, shapes, names = _eigenstrains(tensor)
    corner = np.array(list(itertools.product((0, 1), repeat=d)))
    side = 2 * corner - 1
    strains, count = [], 2**d
    for point in itertools.product((-(3**-0.5), 3**-0.5), repeat=d):
        factor = (1 + side * point) / 2
        slope = [side[:, a] * np.prod(np.delete(factor, a, axis=1), axis=1) for a in range(d)]
        for i, j in PAIRS[d]:
            strain = np.zeros((count, d))
            strain[:, i] += slope[j] * (1.0 if i == j else 0.5**0.5)
            if i != j:
                strain[:, j] += slope[i] * 0.5**0.5
            strains.append(strain)
    parts = [np.kron(np.eye(count), shape) / count for shape in shapes]
    middle = np.full(count, 1 / count)
    return Base("elements", corner, np.array(strains), np.array(parts), moduli, names, middle)


def gauss_shapes(at: np.ndarray) -> np.ndarray:
    """N_g: what a strain of an element is at positions in it, [n, d] from 0 to 1, of those at its
    Gauss points: exact, for strains are multilinear. [n, 2^d]."""
    d = at.shape[1]
    points = np.array(list(itertools.product((-(3**0.5), 3**0.5), repeat=d)))
    return np.asarray(np.prod(1 + points * (2 * at[:, None] - 1), axis=2) / 2**d)


def _eigenstrains(tensor: np.ndarray) -> tuple[np.ndarray, list[np.ndarray], tuple[str, ...]]:
    """C = Σ_a m_a P_a with projections P_a, in the order 11, 22, …, √2·12, and their names."""
    d = tensor.shape[0]
    scale = np.where(np.arange(len(PAIRS[d])) < d, 1.0, 2**0.5)
    value, vector = np.linalg.eigh(voigt(tensor) * np.outer(scale, scale))
    if not value[0] > 0:
        raise InputError(f"moduli: expected a stable crystal, got an eigenvalue of {value[0]:.3g}")
    groups = np.split(np.arange(len(value)), np.flatnonzero(np.diff(value) > EQUAL * value[-1]) + 1)
    moduli, shapes, names = [], [], []
    for n, group in enumerate(groups):
        shape = vector[:, group] @ vector[:, group].T
        moduli.append(value[group].mean())
        shapes.append(shape)
        even = np.where(np.arange(len(value)) < d, d**-0.5, 0.0)
        if len(group) == 1 and np.abs(shape - np.outer(even, even)).max() < EQUAL:
            names.append("bulk")
        elif np.abs(shape @ even).max() > EQUAL:
            names.append(f"mixed {n + 1}")
        else:
            names.append("tetragonal" if np.abs(shape[d:, d:]).max() < EQUAL else "shear")
    if len(set(names)) < len(names):
        names = [f"{name} {n + 1}" for n, name in enumerate(names)]
    return np.array(moduli), shapes, tuple(names)


def dilatation_range(tensor: np.ndarray) -> float:
    """How far the weight of D26 may be from 1/8: M = 1 + 64 (p − 1/8)² ≤ 2 μ/(μ − λ)."""
    C = voigt(tensor)
    lam, shear = C[0, 1], C[2, 2]
    return float(np.sqrt((lam + shear) / (shear - lam)) / 8) if lam < shear else np.inf


def bonds(tensor: np.ndarray, dilatation: float = AXIS_WEIGHT) -> Base:
    """Eight bonds of an isotropic tensor; the first modulus is negative beyond dilatation_range."""
    if tensor.shape[0] != 2 or named_symmetry(tensor) != "isotropic":
        raise InputError(
            "base: bonds are for isotropic sheets, got an elastic tensor that is "
            f"{named_symmetry(tensor)} in {tensor.shape[0]} dimensions; take elements"
        )
    C = voigt(tensor)
    shear, bulk = C[2, 2], (C[0, 0] + C[0, 1]) / 2
    corner = np.array([(0, 0), *(v for v in np.ndindex(3, 3) if v != (1, 1))])
    corner[1:] -= 1
    length = np.linalg.norm(corner[1:], axis=1)
    w = np.where(length == 1, AXIS_WEIGHT, DIAGONAL_WEIGHT)
    strains = np.zeros((8, 9, 2))
    for j, direction in enumerate(corner[1:] / length[:, None]):
        strains[j, 0], strains[j, j + 1] = -direction, direction
    across = AXIS_WEIGHT - dilatation / 2
    p = np.where(length == 1, dilatation, across)
    theta = np.outer(2 * p * length, 2 * p * length)
    M = float((p**2 * length**2 / w).sum())
    parts = np.array([theta, 8 * np.diag(w) - 2 / M * theta])
    moduli = np.array([bulk - 2 * shear * (1 - 1 / M), shear])
    names = ("bulk" if dilatation == AXIS_WEIGHT else "dilatation", "shear")
    return Base("bonds", corner, strains, parts, moduli, names, np.eye(9)[0])


def composed(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """The stencil of one convolution after another, both of shape [(2r + 1)^d, d, d]."""
    d = first.shape[-1]
    out = np.zeros((*(a + b - 1 for a, b in zip(first.shape[:d], second.shape[:d])), d, d))
    for at in np.ndindex(*first.shape[:d]):
        if first[at].any():
            part = tuple(slice(a, a + n) for a, n in zip(at, second.shape[:d]))
            out[part] += first[at] @ second
    return out


def spread(steps: np.ndarray, tensors: np.ndarray) -> np.ndarray:
    """u(x) − Σ C(ξ)(u(x) − u(x + ξ)) as a stencil, of one half [H, d], [H, d, d]."""
    d, reach = steps.shape[1], int(np.abs(steps).max())
    found = np.zeros((*[2 * reach + 1] * d, d, d))
    for sign in (1, -1):
        for step, C in zip(sign * steps, tensors):
            found[tuple(step + reach)] += C
    found[(reach,) * d] = np.eye(d) - 2 * tensors.sum(axis=0)
    return found


def half(stencil: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Steps [H, d] and C(ξ) = −F(ξ) [H, d, d] of one half of a stencil, without empty ones."""
    d = stencil.shape[-1]
    reach = stencil.shape[0] // 2
    steps = np.array(list(np.ndindex(*stencil.shape[:d]))) - reach
    tensors = -stencil.reshape(-1, d, d)
    side = steps @ stencil.shape[0] ** np.arange(d)[::-1] > 0
    kept = side & (np.abs(tensors).max(axis=(1, 2)) > NOTHING * np.abs(tensors).max())
    return steps[kept], (tensors[kept] + tensors[kept].transpose(0, 2, 1)) / 2
