"""Maps of moduli from fields: linear least squares under a dressing that is known (Dr13)."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from warp_peri.dressed.body import DressedBody, Grains
from warp_peri.dressed.law import DressedSolid
from warp_peri.errors import InputError
from warp_peri.points.arrays import checked, is_positive
from warp_peri.points.samples import Samples

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
