"""Maps of moduli: from fields (Dr13), and what a period of them is as a whole (Dr27)."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from warp_peri.core.elastic import from_voigt, voigt
from warp_peri.dressed.body import DressedBody, Grains
from warp_peri.dressed.law import DressedSolid
from warp_peri.dressed.sweeps import PeriodicElements
from warp_peri.errors import InputError
from warp_peri.points.arrays import checked, is_positive
from warp_peri.points.samples import Samples
from warp_peri.statics.conjugate_gradients import SolveRecord, definite

SMOOTHNESS = tuple(10.0**n for n in range(-5, 2))
"""Tried by cross-validation, in parts of the mean stiffness of a value of the map."""
SINGLE = 0.1
"""With one load, which leaves none to judge by."""
FOLDS = 4
HIDDEN = 0.9
"""Of the radius of smoothing: values closer than that are warned of."""
CONDITION = 1e12
"""Of the normal equations of a density law."""
EXPONENT = 0.5
"""Of D in the weight D^(−1/2) of a residual: D^(−1) fits u better and blurs the map."""


@dataclass(frozen=True, eq=False)
class MapFit:
    """Moduli learned on one sheet.

    Attributes:
        maps: of each part over that of the even solid, at the nodes, [N] each; as DressedSolid.on
            takes them.
        spread: standard deviation of the same values, as if what the fit leaves were noise.
        smoothness: that was taken.
        resolution: side of the square (cube) that one independent value of a map stands for, in the
            unit of length, a mean over the sheet, or the radius of the fields' smoothing where
            that is larger: finer features are blurred.
        history: mean squared residual left out, by smoothness; the share of values that fell below
            zero and were set there.
    """

    maps: dict[str, np.ndarray]
    spread: dict[str, np.ndarray]
    smoothness: float
    resolution: float
    history: dict[str, Any]


def fit_maps(
    samples: Samples,
    solid: DressedSolid,
    *,
    parts: str = "each",
    coarse: int = 2,
    smoothness: float | None = None,
    smoothing: float | None = None,
    grains: Grains | None = None,
) -> MapFit:
    """The moduli of an uneven periodic sheet, G and the even solid held.

    Args:
        samples: displacement and load on a period of whole multiples of `coarse` spacings.
        solid: learned on the even sheet, of elements.
        parts: "each" has a map for each part, "one" the same for all.
        coarse: spacings between the values of a map, linear between.
        smoothness: α of (Dr13); None takes what predicts left-out loads best.
        smoothing: radius that the fields were smoothed over, if they were.
        grains: laws and the number of each node's own, as of DressedSolid.on: the maps are factors
            on theirs, as soft as boundaries are.

    A UserWarning says where values stand closer than the fields' smoothing lets anything be seen.

    Raises InputError for samples that are not periodic or have no loads, and for other parts.
    """
    _warn_of_smoothing(coarse * samples.spacing, smoothing)
    body, kinds = _periodic(solid, samples, grains), _kinds(solid, parts)
    basis, bend = _hats(body, coarse)
    names = solid.parts.names
    grams, sides, size, _ = _normal_equations(body, samples, basis, kinds, known=False)
    penalty = np.kron(np.eye(len(kinds)), bend) * np.trace(sum(grams)) / len(grams[0])
    tried = SMOOTHNESS if smoothness is None and len(size) > 1 else (smoothness or SINGLE,)
    left = {alpha: _left_out(grams, sides, alpha * penalty) for alpha in tried}
    alpha = min(left, key=lambda one: left[one])
    H = sum(grams) + alpha * penalty
    x = np.linalg.solve(H, sum(sides))
    rounding = len(size) * np.finfo(float).eps  # what the difference of large numbers cannot tell
    residual = max(len(size) - 2 * x @ sum(sides) + x @ sum(grams) @ x, rounding)
    inverse = np.linalg.inv(H)
    cover = residual / samples.u.size * np.diag(inverse)
    seen = float(np.einsum("ij,ji->", inverse, sum(grams))) / len(kinds)  # independent values
    volume = len(samples.points.x) * samples.points.spacing**solid.dimension
    below = float((x < 0).mean())
    values, spread = (
        (basis @ v.reshape(len(kinds), -1).T).T for v in (np.maximum(x, 0), np.sqrt(cover))
    )
    place = {a: n for n, kind in enumerate(kinds) for a in kind}
    return MapFit(
        {name: values[place[a]] for a, name in enumerate(names)},
        {name: spread[place[a]] for a, name in enumerate(names)},
        float(alpha),
        max(float((volume / seen) ** (1 / solid.dimension)), smoothing or 0.0),
        {"left_out": {str(a): v for a, v in left.items()}, "below_zero": below},
    )


@dataclass(frozen=True, eq=False)
class DensityLaw:
    """Moduli as a function of a density ρ (1 for the even solid): 1 + Σ_n c_n (1 − ρ)^n (Dr21).

    Attributes:
        coefficients: c of each part, [degree].
        spread: their standard deviations.
        least, most: densities that it was learned on; beyond them the nearest counts.
    """

    coefficients: dict[str, np.ndarray]
    spread: dict[str, np.ndarray]
    least: float
    most: float

    def maps(self, density: ArrayLike) -> dict[str, np.ndarray]:
        """Maps for DressedSolid.on, of densities at the nodes, [N].

        A UserWarning says where densities lie beyond those learned on: a polynomial is none there.
        """
        rho = checked("density", density, float)
        beyond = (rho < self.least) | (rho > self.most)
        if beyond.any():
            warnings.warn(
                f"density: learned from {self.least:.3f} to {self.most:.3f}, got {rho.min():.3f} "
                f"to {rho.max():.3f}; at {int(beyond.sum())} of {rho.size} nodes the nearest is "
                "taken",
                stacklevel=2,
            )
        d = 1 - np.clip(rho, self.least, self.most)
        return {
            name: np.maximum(1 + np.vander(d, len(c) + 1, increasing=True)[:, 1:] @ c, 0)
            for name, c in self.coefficients.items()
        }


def fit_density(
    samples: Samples,
    solid: DressedSolid,
    density: ArrayLike,
    *,
    parts: str = "one",
    degree: int = 2,
) -> DensityLaw:
    """How moduli follow a density, learned on one uneven periodic sheet, for any other.

    Args:
        samples: displacement and load on a period.
        solid: learned on the even sheet, of elements.
        density: over that of the even sheet, at the nodes, [N].
        parts: "one" has the same law for all moduli, "each" one for each part.
        degree: of the polynomial.

    Raises InputError as fit_maps does, and for densities that do not tell the numbers apart.
    """
    body, kinds = _periodic(solid, samples), _kinds(solid, parts)
    rho = checked("density", density, float)
    if rho.shape != (len(samples.points.x),):
        raise InputError(f"density: expected {len(samples.points.x)} numbers, got {rho.shape}")
    powers = np.vander(1 - rho, degree + 1, increasing=True)[:, 1:]
    scale = np.maximum(np.abs(powers).max(axis=0), 1e-300)
    basis = sp.csr_array(powers / scale)
    grams, sides, _, left = _normal_equations(body, samples, basis, kinds, known=True)
    H, y = np.sum(grams, axis=0), np.sum(sides, axis=0)
    if np.linalg.cond(H) > CONDITION:
        raise InputError(f"density: expected one that varies enough for {len(y)} numbers")
    x = np.linalg.solve(H, y)
    cover = max(left - x @ y, 0.0) / samples.u.size * np.diag(np.linalg.inv(H))
    found, spread = (v.reshape(len(kinds), degree) / scale for v in (x, np.sqrt(cover)))
    place = {solid.parts.names[a]: n for n, kind in enumerate(kinds) for a in kind}
    return DensityLaw(
        {name: found[n] for name, n in place.items()},
        {name: spread[n] for name, n in place.items()},
        float(rho.min()),
        float(rho.max()),
    )


def _warn_of_smoothing(apart: float, smoothing: float | None) -> None:
    """Say what smoothing hides. InputError for a radius that is none."""
    if smoothing is None:
        return
    if not is_positive(smoothing):
        raise InputError(f"smoothing: expected a radius > 0, got {smoothing!r}")
    if apart < HIDDEN * smoothing:
        warnings.warn(
            f"coarse: values of the map stand {apart:g} apart, the fields are smoothed over "
            f"{smoothing:g}: what is narrower than that is blurred or not seen, however well the "
            f"loads are met; give {int(np.ceil(HIDDEN * smoothing / apart))} times the spacing",
            stacklevel=3,
        )


def _periodic(solid: DressedSolid, samples: Samples, grains: Grains | None = None) -> DressedBody:
    if samples.points.box is None:
        raise InputError("samples: expected a periodic sheet for a map")
    return DressedBody(solid, samples.points, grains=grains)


def _kinds(solid: DressedSolid, parts: str) -> list[list[int]]:
    """Which parts share a map."""
    if parts not in ("each", "one"):
        raise InputError(f"parts: expected 'each' or 'one', got {parts!r:.50}")
    numbers = list(range(len(solid.parts.names)))
    return [[a] for a in numbers] if parts == "each" else [numbers]


def _normal_equations(
    body: DressedBody, samples: Samples, basis: sp.csr_array, kinds: list[list[int]], *, known: bool
) -> tuple[list[np.ndarray], list[np.ndarray], np.ndarray, float]:
    """AᵗA and Aᵗb of each load (Dr13), sizes of the loads, and Σ bᵗb; b less what the even solid
    answers where that is `known`."""
    weight = _Weight(body)
    loads = samples.loads.reshape(len(samples.u), -1).T
    size = np.linalg.norm(weight(loads), axis=0)
    if not (size > 0).all():
        raise InputError("samples: expected loads, got some that are zero")
    if known:
        loads = loads - (body(samples.u)).reshape(len(samples.u), -1).T
    right = weight(loads) / size
    grams, sides = [], []
    for u, b, norm in zip(samples.u, right.T, size):
        A = weight(_design(body, u, basis, kinds)) / norm
        grams.append(A.T @ A)
        sides.append(A.T @ b)
    return grams, sides, size, float((right**2).sum())


def _left_out(grams: list[np.ndarray], sides: list[np.ndarray], penalty: np.ndarray) -> float:
    """Mean squared residual of loads that a fit has not seen, in FOLDS parts."""
    folds = min(FOLDS, len(grams))
    total = 0.0
    for fold in range(folds):
        out = [n for n in range(len(grams)) if folds > 1 and n % folds == fold]
        kept = [n for n in range(len(grams)) if n not in out]
        x = np.linalg.solve(sum(grams[n] for n in kept) + penalty, sum(sides[n] for n in kept))
        total += sum(1 - 2 * x @ sides[n] + x @ grams[n] @ x for n in out or kept)
    return float(total / len(grams))


def _design(
    body: DressedBody, u: np.ndarray, basis: sp.csr_array, kinds: list[list[int]]
) -> np.ndarray:
    """L u of each value of each map alone, [d N, kinds · values]."""
    base, count = body.model.parts, len(body.points.x)
    to_sites = sp.csr_array(
        (
            np.tile(base.middle, count),
            (np.repeat(np.arange(count), len(base.middle)), body._corner.ravel()),
        ),
        shape=(count, count),
    )
    shares = sp.csr_array(sp.kron(to_sites @ basis, np.ones((len(base.strains), 1))))
    flat = (u @ body.axes).ravel()
    columns = []
    for kind in kinds:
        total: Any = 0.0
        for a in kind:
            G = body.dressings[min(a, len(body.dressings) - 1)]
            strain = (body.strains @ (G @ flat)).reshape(count, -1)
            stress = np.zeros_like(strain)
            for share, M in body.tensors(a):
                stress += share[:, None] * (strain @ M)
            total = total + G.T @ (body.strains.T @ (sp.diags_array(stress.ravel()) @ shares))
        columns.append(total.toarray())
    return np.concatenate(columns, axis=1)


def _hats(body: DressedBody, coarse: int) -> tuple[sp.csr_array, np.ndarray]:
    """Values every so many nodes to all nodes, linear between; and the sum of squared steps."""
    sides = body.sides
    if any(n % coarse for n in sides):
        raise InputError(f"coarse: expected a divisor of {', '.join(map(str, sides))} nodes")
    lines, steps = [], []
    for n in sides:
        t = np.arange(n) / coarse
        low, part = np.floor(t).astype(int), t % 1
        row = np.tile(np.arange(n), 2)
        column = np.append(low, low + 1) % (n // coarse)
        lines.append(sp.csr_array((np.append(1 - part, part), (row, column)), (n, n // coarse)))
        one = np.eye(n // coarse)
        steps.append(2 * one - np.roll(one, 1, axis=0) - np.roll(one, -1, axis=0))
    whole, bend = lines[0], steps[0]
    for line, step in zip(lines[1:], steps[1:]):
        whole = sp.kron(whole, line)
        bend = np.kron(bend, np.eye(len(step))) + np.kron(np.eye(len(bend)), step)
    order = np.ravel_multi_index(tuple(body.grid.T), sides)
    return sp.csr_array(whole)[order], bend


class _Weight:
    """D^(−1/2) of the even solid on a period, on columns [d N, n]."""

    def __init__(self, body: DressedBody) -> None:
        self.sides, h = body.sides, body.points.spacing
        self.place = np.ravel_multi_index(tuple(body.grid.T), self.sides)
        waves = np.meshgrid(*[2 * np.pi * np.fft.fftfreq(n, h) for n in self.sides], indexing="ij")
        D = body.model.symbol(np.stack(waves, axis=-1))
        value, vector = np.linalg.eigh(D)
        value[(0,) * len(self.sides)] = np.inf
        self.root = (vector * value[..., None, :] ** -EXPONENT) @ vector.swapaxes(-1, -2)

    def __call__(self, columns: np.ndarray) -> np.ndarray:
        d = len(self.sides)
        field = np.zeros_like(columns).reshape(-1, d, columns.shape[1])
        field[self.place] = columns.reshape(field.shape)
        wave = np.fft.fftn(field.reshape(*self.sides, *field.shape[1:]), axes=range(d))
        back = np.fft.ifftn(self.root @ wave, axes=range(d)).real
        return np.asarray(back.reshape(field.shape)[self.place].reshape(columns.shape))


STABLE = 1e-12
"""Least eigenvalue of a phase's moduli over its largest."""
SYMMETRIC = 1e-8
"""Relative, by which a matrix may differ from its transpose."""
EVEN = 1e-12
"""Force of a mean strain at the nodes, over the largest modulus, below which the solid is even."""


@dataclass(frozen=True, eq=False)
class Effective:
    """What a varying periodic solid is as a whole, along the axes of its elements.

    Attributes:
        tensor: effective elastic tensor [stress], shape [d, d, d, d]; of conductivities [d, d].
        iterations: of conjugate gradients, one number a load: 11, 22, 33, 23, 13, 12 in turn, in
            the plane 11, 22, 12; of conductivities a gradient along each axis.
        residual: the largest of the loads', relative.
    """

    tensor: np.ndarray
    iterations: tuple[int, ...]
    residual: float
    _elements: PeriodicElements = field(repr=False)
    _answers: np.ndarray = field(repr=False)
    _units: tuple[float, float] = field(repr=False)

    def fields(self, strain: ArrayLike) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Local fields under a mean strain [d, d], or a mean gradient [d] of conduction.

        Returns what displacement is beyond that of the mean strain at the nodes [length], shape
        [*sides, d], and means over each element: strain and stress [stress], [*sides, d, d] both.
        Of conduction they are a potential [*sides], a gradient and κ times it, [*sides, d].

        Raises InputError for another shape.
        """
        elements, (stress, spacing) = self._elements, self._units
        d, vectors = len(elements.sides), elements.components > 1
        E = checked("strain", strain, float, (d, d) if vectors else (d,))
        if vectors and np.abs(E - E.T).max() > SYMMETRIC * np.abs(E).max():
            raise InputError("strain: expected a symmetric mean strain")
        mean = np.array([E[i, j] * (1 + (i != j)) if vectors else E[j] for i, j in elements.pairs])
        u = np.tensordot(mean, self._answers, 1)
        local = elements.strain(u) + mean.reshape(-1, *[1] * d)
        pulled = elements.stress(local) * stress
        if not vectors:
            return u[0] * spacing, np.moveaxis(local, 0, -1), np.moveaxis(pulled, 0, -1)
        both = np.empty((2, *elements.sides, d, d))
        for (i, j), e, s in zip(elements.pairs, local, pulled):
            both[0, ..., i, j] = both[0, ..., j, i] = e / (1 + (i != j))
            both[1, ..., i, j] = both[1, ..., j, i] = s
        return np.moveaxis(u, 0, -1) * spacing, both[0], both[1]


def effective(
    solid: DressedBody | ArrayLike,
    phases: ArrayLike | None = None,
    *,
    factors: ArrayLike | None = None,
    spacing: float = 1.0,
    tolerance: float = 1e-8,
) -> Effective:
    """The effective tensor of a period of elements whose moduli vary, and its local fields.

    Each load is a mean strain, met by conjugate gradients with the mean solid's inverse before
    them. Iterations do not grow with the period, and with contrast as its root (theory, Dr27).
    Sources: H. Moulinec and P. Suquet, Comput. Methods Appl. Mech. Eng. 157, 1998; F. Willot,
    C. R. Mécanique 343, 2015; R. J. Leute et al., J. Comput. Phys. 453, 2022.

    Args:
        solid: a dressed body on a period, with maps or grains; or the moduli of P phases, Voigt's
            matrices [P, 3, 3] or [P, 6, 6], [stress]; or conductivities [P, d, d].
        phases: number of the phase of each element, [n₁, n₂] or [n₁, n₂, n₃]; of moduli alone.
        factors: > 0, on the moduli of each element, same shape; of moduli alone.
        spacing: side of an element [length]; a dressed body has its own.
        tolerance: of each load's relative residual.

    One G of a dressing changes no effective tensor, for u and G u have the same mean strain;
    displacement is then that of the base, G u. Raises InputError for a body that is cut, split or
    not of elements, for moduli that are not stable, and for phases and factors that do not fit.
    """
    if isinstance(solid, DressedBody):
        if phases is not None or factors is not None:
            raise InputError("phases, factors: expected none beside a dressed body, which has its")
        tables, shares = _of_body(solid)
        spacing = solid.points.spacing
    else:
        tables, shares = _of_phases(solid, phases, factors)
    if not (is_positive(spacing) and is_positive(tolerance) and tolerance < 1):
        raise InputError(
            "spacing, tolerance: expected a length > 0 and a number between 0 and 1, got "
            f"{spacing!r:.50}, {tolerance!r:.50}"
        )
    scale, weight = float(np.abs(tables).max()), float(shares.max())
    elements = PeriodicElements(tables / scale, shares / weight)
    count, loads = shares[0].size, len(elements.pairs)
    answers = np.zeros((loads, elements.components, *elements.sides))
    forces, tensor = np.empty_like(answers), elements.mean.copy()
    took, left = [], 0.0
    for n, u in enumerate(answers):
        forces[n] = -elements(elements.affine(n))
        record = SolveRecord()
        if np.linalg.norm(forces[n]) > EVEN * count**0.5:
            u[:], record = definite(elements, elements.evened, forces[n], tolerance)
        took.append(record.iterations)
        left = max(left, record.residual)
        pulled = elements(u) / count
        for m in range(n + 1):  # the energy of both, whose error is that of u squared
            crossed = np.vdot(forces[m], u) + np.vdot(forces[n], answers[m])
            tensor[m, n] += np.vdot(answers[m], pulled) - crossed / count
            tensor[n, m] = tensor[m, n]
    tensor *= scale * weight
    whole = tensor if elements.components == 1 else from_voigt(tensor)
    units = scale * weight, float(spacing)
    return Effective(whole, tuple(took), left, elements, answers, units)


def _of_body(body: DressedBody) -> tuple[np.ndarray, np.ndarray]:
    """Voigt matrices of the parts of all grains, and the share of each at the elements."""
    law = body.model
    whole = body.points.box is not None and len(body.grid) == np.prod(body.sides)
    whole = whole and body.gram is None and bool(body._there.all())
    if law.base != "elements" or len(law.tensors) > 1 or not whole:
        raise InputError(
            "solid: expected elements under one G that fill a period, none cut or broken"
        )
    if not body.factors.min() > 0:
        raise InputError(f"maps: expected numbers > 0, the smallest is {body.factors.min():g}")
    return body.phases(range(len(body.factors)))


def _of_phases(
    moduli: ArrayLike, phases: ArrayLike | None, factors: ArrayLike | None
) -> tuple[np.ndarray, np.ndarray]:
    """The moduli of phases, and 1 or a factor where an element is of each; checked."""
    if phases is None:
        raise InputError("phases: expected the number of the phase of each element, got None")
    number = checked("phases", phases, float)
    d, tables = number.ndim, checked("solid", moduli, float)
    sizes = {2: (2, 3), 3: (3, 6)}.get(d, ())
    if tables.ndim == 5 and tables.shape[1:] == (d,) * 4:
        tables = voigt(tables)
    if tables.ndim != 3 or tables.shape[1] not in sizes or tables.shape[1] != tables.shape[2]:
        raise InputError(
            "solid, phases: expected moduli [P, 3, 3] with phases [n1, n2], or [P, 6, 6] with "
            "[n1, n2, n3], or conductivities [P, d, d], got "
            f"{list(tables.shape)} with {list(number.shape)}"
        )
    whole = number.astype(int)
    if (
        not number.size
        or (whole != number).any()
        or not 0 <= whole.min() <= whole.max() < len(tables)
    ):
        raise InputError(
            f"phases: expected whole numbers from 0 to {len(tables) - 1}, got shape "
            f"{list(number.shape)} and {number.min(initial=0):g} to {number.max(initial=0):g}"
        )
    for n, C in enumerate(tables):
        value = np.linalg.eigvalsh((C + C.T) / 2)
        if np.abs(C - C.T).max() > SYMMETRIC * np.abs(C).max() or not value[0] > STABLE * value[-1]:
            raise InputError(
                f"solid[{n}]: expected a symmetric positive definite matrix, its eigenvalues are "
                f"{value[0]:.3g} to {value[-1]:.3g}"
            )
    shares = (np.arange(len(tables)).reshape(-1, *[1] * d) == whole).astype(float)
    if factors is not None:
        scale = checked("factors", factors, float)
        if scale.shape != number.shape or not scale.min() > 0:
            raise InputError(
                f"factors: expected numbers > 0, shape {list(number.shape)}, got "
                f"{list(scale.shape)}, the smallest {scale.min(initial=np.inf):g}"
            )
        shares *= scale
    return (tables + tables.swapaxes(1, 2)) / 2, shares
