"""What is left after a fit, and why: dispersion, anisotropy, nonlinearity, heterogeneity or noise.

Richer models are fitted to the residual one after the other on one half of the samples and judged
on the other half, so that what they explain is there, and not what they have coefficients for.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from warp_peri.errors import InputError
from warp_peri.learning.response import products
from warp_peri.losses.full import sample_weights
from warp_peri.losses.noise import noise_loss
from warp_peri.models.lps import Model
from warp_peri.operator.lps import NodeOperator
from warp_peri.points.families import bond_classes, lattice_steps
from warp_peri.points.samples import Samples

LEAST_SAMPLES = 8
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


def diagnose(model: Model, samples: Samples, noise: Samples | None = None) -> Diagnosis:
    """Tell the causes of the residual of a model on the data it was fitted to.

    Args:
        model: the model, certified on their lattice.
        samples: training samples on a lattice, eight at least.
        noise: fields of noise alone on their nodes.

    Raises InputError for scattered points, too few samples, or no load.
    """
    if samples.spacing == 0 or len(samples) < LEAST_SAMPLES:
        raise InputError(
            f"samples: expected {LEAST_SAMPLES} at least on a lattice, got {len(samples)} at a "
            f"spacing of {samples.spacing:g}"
        )
    (weight,) = sample_weights([samples], normalise=False)
    b = samples.loads[:, samples.interior]
    operator = NodeOperator(model, samples.points, allow_uncertified=True)
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

    Coefficients come from one half of the samples, the numbers from the other, and once more with
    the halves exchanged.
    """
    order = np.random.default_rng(0).permutation(len(left))
    first, second = np.sort(order[::2]), np.sort(order[1::2])
    levels: dict[str, float] = {}
    for fitted, judged in ((first, second), (second, first)):
        best = left[fitted], left[judged]
        base: tuple[Feature, ...] = ()
        for name, features in (
            ("dispersion", (grid.orbits,)),
            ("anisotropy", (grid.pairs,)),
            ("nonlinearity", (grid.quadratic,)),
        ):
            asked = features if name != "nonlinearity" else (*base, *features)
            rows, others = (
                np.concatenate([features(some) for features in asked], axis=-1)
                for some in (fitted, judged)
            )
            tried = min(
                (
                    (left[fitted] - rows @ c, left[judged] - others @ c)
                    for c in _ridges(rows, left[fitted])
                ),
                key=lambda fields: float((fields[1] ** 2).sum()),
            )
            if (tried[1] ** 2).sum() < (best[1] ** 2).sum():
                best, base = tried, asked
            levels[name] = levels.get(name, 0.0) + float((best[1] ** 2).sum())
        local = best[1] - grid.predicted(best[0], fitted, judged)
        lowest = min(float((fit**2).sum()) for fit in (local, best[1]))
        levels["heterogeneity"] = levels.get("heterogeneity", 0.0) + lowest
    return levels


def _ridges(rows: np.ndarray, left: np.ndarray) -> list[np.ndarray]:
    """Coefficients of least squares with each ridge, shape [F]; features that are not there get 0.

    Second differences of smooth fields are nearly the same for all bonds: without a ridge their
    coefficients blow up what is no part of the cause, and on other samples explain less than
    nothing. Which of the few ridges is best is seen on those other samples: one number, which has
    no room to fit what is not there.

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
        slopes = [
            ((np.roll(stress, -1, axis) - np.roll(stress, 1, axis)) / (2 * self.h))[
                :, self.place[:, 0], self.place[:, 1]
            ]
            for axis in (1, 2)
        ]
        zero = np.zeros_like(slopes[0])
        columns = [
            np.stack([slopes[0], zero], axis=2),
            np.stack([zero, slopes[1]], axis=2),
            np.stack([slopes[1], slopes[0]], axis=2),
        ]
        return np.concatenate(columns, axis=-1)

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
        """What coefficients that differ from node to node say of the other half's residual."""
        rows, asked = self.local(fitted), self.local(judged)
        scale = np.sqrt((rows**2).mean(axis=(0, 1))) + TINY
        rows, asked = rows / scale, asked / scale
        gram = np.einsum("snf,sng->nfg", rows, rows)
        gram += RIDGE * np.trace(gram, axis1=1, axis2=2)[:, None, None] * np.eye(rows.shape[-1])
        c = np.linalg.solve(gram, np.einsum("snf,sna->nfa", rows, left))
        force: np.ndarray = np.einsum("snf,nfa->sna", asked, c)
        return force
