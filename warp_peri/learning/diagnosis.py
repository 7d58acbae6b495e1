"""What is left after a fit, and why: dispersion, anisotropy, nonlinearity, heterogeneity or noise.

Richer models are fitted to the residual one after the other and judged on samples that were left
out of the fit, so that what they explain is there, and not what they have coefficients for. Two
things are picked on the samples that judge, for all of them at once: which ridge, of ten, and which
of two sets of features.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from warp_peri.contract import linear_part, placed
from warp_peri.errors import InputError
from warp_peri.learning.response import products
from warp_peri.losses.full import sample_weights
from warp_peri.losses.noise import noise_loss
from warp_peri.models.lps import Model
from warp_peri.points.families import bond_classes
from warp_peri.points.lattice import lattice_steps
from warp_peri.points.samples import Samples

LEAST_SAMPLES = 8
FOLDS = 6
"""Parts of the samples; each is judged by coefficients from all others."""
RIDGE = 1e-2
"""Of the fits at single nodes, relative to the sum of their squared features."""
RIDGES = (1.0, 0.3, 0.1, 0.03, 0.01, 3e-3, 1e-3, 1e-4, 1e-6, 1e-8)
"""Of the fits to whole samples that are tried, relative to the largest singular value."""
TINY = 1e-300
Feature: TypeAlias = Callable[[np.ndarray], np.ndarray]
WORDS = {
    "noise": "noise in the displacement",
    "dispersion": "short waves: another kernel of the same symmetry would take it",
    "anisotropy": "anisotropy: the material is stiffer along some directions than the square",
    "nonlinearity": "nonlinearity: forces that grow with the square of the strain",
    "heterogeneity": "heterogeneity: the stiffness, or the ripple that smoothing leaves, differs "
    "from place to place",
    "unexplained": "what none of these explains",
}
LOUD = 0.1
"""Residual above which the solid does not describe the data, whatever is proven of it."""
NEXT = {
    "noise": "fields of noise in the fit (noise=…, loss='corrected' or 'output'), or longer means",
    "dispersion": "a smaller spacing of the nodes, a larger horizon or degree, or two influence "
    "functions",
    "anisotropy": "a micromodulus, whose bonds have stiffnesses of their own: no isotropic solid "
    "has these moduli",
    "nonlinearity": "smaller loads, or the nonlinear solid (nonlinear=…)",
    "heterogeneity": "a larger smoothing radius and spacing, where the sheet is uniform, or parts "
    "of it, each with a solid of its own",
    "unexplained": "smaller and smoother loads, more of them, and a smaller spacing of the nodes",
}


@dataclass(frozen=True)
class Diagnosis:
    """Where the squared residual of a model on training data comes from.

    Attributes:
        residual: ‖L u − b‖ / ‖b‖ over all samples.
        shares: of its square, by the name of the cause (see WORDS); they add up to 1. Noise is
            told only where fields of it were given.
    """

    residual: float
    shares: dict[str, float]

    @property
    def sentence(self) -> str:
        """The largest cause in words."""
        name = max(self.shares, key=lambda key: self.shares[key])
        return (
            f"The model leaves {100 * self.residual:.3g} % of the loads; "
            f"{100 * self.shares[name]:.0f} % of its square is {WORDS[name]}."
        )

    @property
    def advice(self) -> str:
        """What to try next where the residual is above LOUD, else empty."""
        if self.residual <= LOUD:
            return ""
        name = max(self.shares, key=lambda key: self.shares[key])
        return (
            f"residual: {100 * self.residual:.3g} % of the loads are left, above {100 * LOUD:g} %: "
            "this solid does not describe these data, though what is proven of it holds. "
            f"Most of it is {WORDS[name]}. Try {NEXT[name]}"
        )


def diagnose(material: Any, samples: Samples, noise: Samples | None = None) -> Diagnosis:
    """Tell the causes of the residual of a material on the data it was fitted to.

    Args:
        material: with a linear part, certified on their lattice, or its operator there.
        samples: training samples on a lattice, eight at least.
        noise: fields of noise alone on their nodes.

    Raises InputError for a material without a linear part, scattered points, too few samples, or
    no load.
    """
    if samples.spacing == 0 or len(samples) < LEAST_SAMPLES:
        raise InputError(
            f"samples: expected {LEAST_SAMPLES} at least on a lattice, got {len(samples)} at a "
            f"spacing of {samples.spacing:g}"
        )
    (weight,) = sample_weights([samples], normalise=False)
    b = samples.loads[:, samples.interior]
    model: Model = linear_part(material, "diagnose")
    operator = placed(material, samples.points, verb="diagnose", allow_uncertified=True)
    grid = _Grid(samples, model.horizon)
    left = (b - operator(samples.u)) @ grid.axes
    size = float((b**2).sum())
    total = float((left**2).sum())
    shares: dict[str, float] = {}
    if noise is not None:
        c = products(model, bond_classes(samples.spacing, model.horizon))
        R = noise_loss(noise, samples, model.horizon, weight)
        shares["noise"] = min(1.0, float(np.sum((R @ c) ** 2)) * size / max(total, TINY))
    level = total
    for name, below in _levels(grid, left).items():
        shares[name], level = max(0.0, level - below) / max(total, TINY), below
    rest = 1.0 - shares.get("noise", 0.0)  # what noise makes, the others would take again
    shares = {name: value if name == "noise" else rest * value for name, value in shares.items()}
    shares["unexplained"] = max(0.0, 1.0 - sum(shares.values()))
    return Diagnosis(float(np.sqrt(total / size)), shares)


def _levels(grid: _Grid, left: np.ndarray) -> dict[str, float]:
    """‖residual‖² after each cause is taken off, one after the other; none makes it larger.

    It is the sum over parts of the samples, each with coefficients from all others; the ridge and
    the set of features of a cause are those with the least sum. Nonlinearity comes first: a linear
    solid's forces change sign with u, so products of gradients take nothing of it, while bonds of
    their own follow a few nonlinear samples. Anisotropy comes with bonds by class, in which it is
    seen among what differs from place to place.
    """
    every = np.arange(len(left))
    order = np.random.default_rng(0).permutation(len(left))
    parts = [np.sort(order[k::FOLDS]) for k in range(FOLDS)]
    best = [left.copy() for _ in parts]  # of all samples, by the coefficients of each part
    levels: dict[str, float] = {}

    def judged(fields: list[np.ndarray]) -> float:
        return sum(float((field[part] ** 2).sum()) for field, part in zip(fields, parts))

    causes: tuple[tuple[str, tuple[tuple[Feature, ...], ...]], ...] = (
        ("nonlinearity", ((grid.invariant,), (grid.quadratic,))),
        ("dispersion", ((grid.orbits,),)),
        ("anisotropy", ((grid.constants, grid.orbits), (grid.pairs,))),
    )
    for name, sets in causes:
        tried = [best]
        for features in sets:
            rows = np.concatenate([feature(every) for feature in features], axis=-1)
            ridges = [
                _ridges(np.delete(rows, part, axis=0), np.delete(field, part, axis=0))
                for part, field in zip(parts, best)
            ]
            tried += [[field - rows @ c for field, c in zip(best, same)] for same in zip(*ridges)]
        best = min(tried, key=judged)
        levels[name] = judged(best)
    local = [field.copy() for field in best]
    for part, field in zip(parts, local):
        fitted = np.setdiff1d(every, part)
        field[part] -= grid.predicted(field[fitted], fitted, part)
    levels["heterogeneity"] = min(judged(local), judged(best))
    return levels


def _ridges(rows: np.ndarray, left: np.ndarray) -> list[np.ndarray]:
    """Coefficients of least squares with each ridge, shape [F]; features that are not there get 0.

    Second differences of smooth fields are nearly the same for all bonds: without a ridge their
    coefficients blow up what is no part of the cause, and on other samples explain less than
    nothing. Which of the few ridges is best is seen on those other samples: one number for all of
    them, which has little room to fit what is not there.

    Args:
        rows: features, shape [S, I, 2, F]; they are scaled to one size.
        left: residual, shape [S, I, 2].
    """
    scale = np.sqrt((rows**2).sum(axis=(0, 1, 2)))
    scale = np.where(scale > 0, scale, np.inf)
    flat = (rows / scale).reshape(-1, rows.shape[-1])
    axes, size, turn = np.linalg.svd(flat, full_matrices=False)
    along = axes.T @ left.ravel()
    return [
        turn.T @ (size / (size**2 + (ridge * size[0]) ** 2 + TINY) * along) / scale
        for ridge in RIDGES
    ]


class _Grid:
    """Differences of the displacement on a lattice, along its own axes, at the interior nodes."""

    def __init__(self, samples: Samples, horizon: float) -> None:
        steps, self.axes = lattice_steps(samples)
        classes = bond_classes(samples.spacing, horizon)
        pad = int(np.abs(classes.steps).max()) + 2
        shape = (*(steps.max(axis=0) + 1 + 2 * pad), 2)
        u = np.zeros((len(samples), *shape))
        place = steps + pad
        u[:, place[:, 0], place[:, 1]] = samples.u @ self.axes
        self.u, self.h = u, samples.spacing
        self.place = place[samples.interior]
        half = (classes.steps[:, 0] > 0) | ((classes.steps[:, 0] == 0) & (classes.steps[:, 1] > 0))
        self.steps, self.kind = classes.steps[half], classes.bond_class[half]

    def shifted(self, some: np.ndarray, step: tuple[int, int] | np.ndarray) -> np.ndarray:
        """u of some samples at the nodes a step away, shape [S, I, 2]."""
        row, column = (self.place + step).T
        values: np.ndarray = self.u[some][:, row, column]
        return values

    def second(self, some: np.ndarray, step: np.ndarray) -> np.ndarray:
        """u(x + ξ) + u(x − ξ) − 2 u(x), shape [S, I, 2]."""
        middle = self.shifted(some, (0, 0))
        bent: np.ndarray = self.shifted(some, step) + self.shifted(some, -step) - 2 * middle
        return bent

    def orbits(self, some: np.ndarray) -> np.ndarray:
        """Forces of unit bonds of each class, along the bonds and whole: [S, I, 2, F]."""
        out = np.zeros((len(some), len(self.place), 2, 2 * (self.kind.max() + 1)))
        for step, kind in zip(self.steps, self.kind):
            d, n = self.second(some, step), step / np.linalg.norm(step)
            out[..., 2 * kind] += (d @ n)[..., None] * n
            out[..., 2 * kind + 1] += d
        return out

    def pairs(self, some: np.ndarray) -> np.ndarray:
        """The same for each bond by itself, with every symmetric matrix: [S, I, 2, F]."""
        parts = []
        for step in self.steps:
            d = self.second(some, step)
            zero = np.zeros_like(d[..., 0])
            parts += [
                np.stack([d[..., 0], zero], axis=-1),
                np.stack([zero, d[..., 1]], axis=-1),
                d[..., ::-1],
            ]
        return np.stack(parts, axis=-1)

    def gradient(self, some: np.ndarray) -> np.ndarray:
        """∂u by central differences everywhere, entries 11, 12, 21, 22: [S, n₁, n₂, 4]."""
        u = self.u[some]
        parts = [(np.roll(u, -1, axis) - np.roll(u, 1, axis)) / (2 * self.h) for axis in (1, 2)]
        return np.concatenate([parts[0], parts[1]], axis=-1)

    def quadratic(self, some: np.ndarray) -> np.ndarray:
        """Divergences of every stress that is a product of two gradients: [S, I, 2, 30]."""
        gradient = self.gradient(some)
        i, j = np.triu_indices(4)
        stress = gradient[..., i] * gradient[..., j]
        slopes = [self.slope(stress, axis) for axis in (1, 2)]
        zero = np.zeros_like(slopes[0])
        columns = [
            np.stack([slopes[0], zero], axis=2),
            np.stack([zero, slopes[1]], axis=2),
            np.stack([slopes[1], slopes[0]], axis=2),
        ]
        return np.concatenate(columns, axis=-1)

    def constants(self, some: np.ndarray) -> np.ndarray:
        """Forces of the six constants of a sheet without symmetry, [S, I, 2, 6]."""
        a, c = (self.second(some, np.array(step)) for step in ((1, 0), (0, 1)))
        d = self.second(some, np.array((1, 1))) - self.second(some, np.array((1, -1)))
        d = d / 4  # ∂₁∂₂ u h²
        zero, one, two = np.zeros_like(a[..., 0]), 0, 1
        forces = (
            (a[..., one], zero),
            (zero, c[..., two]),
            (d[..., two], d[..., one]),
            (c[..., one] + d[..., two], d[..., one] + a[..., two]),
            (2 * d[..., one] + a[..., two], a[..., one]),
            (c[..., two], c[..., one] + 2 * d[..., two]),
        )
        return np.stack([np.stack(force, axis=-1) for force in forces], axis=-1)

    def invariant(self, some: np.ndarray) -> np.ndarray:
        """Divergences of the second-order stresses of a hexagonal sheet: [S, I, 2, 6].

        With H = ∇u and its strain e, those of the two Lamé parameters under rotation, of the
        energies (tr e)³ and tr e tr e², and of the real and imaginary part of
        (e₁₁ − e₂₂ + 2i e₁₂)³, which has the six-fold axis at any angle. Five are independent: by
        Cayley and Hamilton the second is a sum of the first, the third and the fourth.
        """
        gradient = self.gradient(some)
        H = gradient.reshape(*gradient.shape[:-1], 2, 2).swapaxes(-1, -2)
        e, unit = (H + H.swapaxes(-1, -2)) / 2, np.eye(2)
        turned = H.swapaxes(-1, -2) @ H
        trace, of_turned, of_square = (
            np.trace(of, axis1=-2, axis2=-1)[..., None, None] for of in (e, turned, e @ e)
        )
        square = (e[..., 0, 0] - e[..., 1, 1] + 2j * e[..., 0, 1]) ** 2
        spin = [
            np.stack([p, q, q, -p], axis=-1).reshape(H.shape)
            for p, q in ((square.real, -square.imag), (square.imag, square.real))
        ]
        stresses = (
            of_turned / 2 * unit + trace * H,
            turned + 2 * H @ e,
            trace**2 * unit,
            of_square * unit + 2 * trace * e,
            *spin,
        )
        forces = [
            self.slope(stress[..., 0], 1) + self.slope(stress[..., 1], 2) for stress in stresses
        ]
        return np.stack(forces, axis=-1)

    def slope(self, field: np.ndarray, axis: int) -> np.ndarray:
        """Derivative of a field [S, n₁, n₂, …] along an axis at the interior nodes [S, I, …]."""
        by_steps = (np.roll(field, -1, axis) - np.roll(field, 1, axis)) / (2 * self.h)
        at_nodes: np.ndarray = by_steps[:, self.place[:, 0], self.place[:, 1]]
        return at_nodes

    def local(self, some: np.ndarray) -> np.ndarray:
        """Strains and second differences around each node, shape [S, I, 11]."""
        gradient = self.gradient(some)[:, self.place[:, 0], self.place[:, 1]]
        strain = np.stack(
            [gradient[..., 0], gradient[..., 3], gradient[..., 1] + gradient[..., 2]], axis=-1
        )
        seconds = [
            self.second(some, np.array(step)) / self.h for step in ((1, 0), (0, 1), (1, 1), (1, -1))
        ]
        return np.concatenate([strain, *seconds], axis=-1)

    def predicted(self, left: np.ndarray, fitted: np.ndarray, judged: np.ndarray) -> np.ndarray:
        """What coefficients that differ from node to node say of the residual of other samples."""
        rows, asked = self.local(fitted), self.local(judged)
        scale = np.sqrt((rows**2).mean(axis=(0, 1))) + TINY
        rows, asked = rows / scale, asked / scale
        gram = np.einsum("snf,sng->nfg", rows, rows)
        gram += RIDGE * np.trace(gram, axis1=1, axis2=2)[:, None, None] * np.eye(rows.shape[-1])
        c = np.linalg.solve(gram, np.einsum("snf,sna->nfa", rows, left))
        force: np.ndarray = np.einsum("snf,nfa->sna", asked, c)
        return force
