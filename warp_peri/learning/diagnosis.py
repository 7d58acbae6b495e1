"""What is left after a fit, and why: dispersion, anisotropy, nonlinearity, heterogeneity or noise.

Richer models are fitted to the residual one after the other and judged on samples that were left
out of the fit, so that what they explain is there, and not what they have coefficients for. Two
things are picked on the samples that judge, for all of them at once: which ridge, of nine, and
which of two sets of features.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from warp_peri.contract import linear_part, placed
from warp_peri.errors import InputError
from warp_peri.learning.response import products
from warp_peri.learning.sheet_features import SheetFeatures
from warp_peri.losses.full import sample_weights
from warp_peri.losses.noise import noise_loss
from warp_peri.models.lps import Model
from warp_peri.points.families import bond_classes
from warp_peri.points.samples import Samples
from warp_peri.shown import in_rows

LEAST_SAMPLES = 8
PARTS = 24
"""Most parts of the samples; each is judged by coefficients from all others. With fewer, whole
directions of the waves were in the judged part alone."""
RIDGES = (1.0, 0.3, 0.1, 0.03, 0.01, 3e-3, 1e-3, 1e-4, 1e-5)
"""Of the fits to whole samples that are tried, relative to the largest singular value."""
RIDGES_OF_NODES = (0.3, 0.1, 0.03, 0.01)
"""The same of the fits at single nodes."""
TURNS = 2
"""In which what differs from place to place and what does not are fitted to what the other left."""
STRONG = 0.05
"""A strain at which stresses of third order are no larger than linear ones. What such stresses may
explain is the square of a strain's share of it, and no more."""
TINY = 1e-300
MOSTLY = 0.8
"""Of the squared residual, that one number by itself must take to be its cause: bonds by class,
which are many, could take it too."""
WORDS = {
    "noise": "noise in the displacement",
    "dispersion": "short waves: another kernel, or a crystal's six axes, would take it",
    "anisotropy": "anisotropy: the material is stiffer along some directions than the square",
    "nonlinearity": "nonlinearity: forces that grow with the square or the cube of the strain",
    "species": "a displacement that follows the load: forces on the species of a cell that are not "
    "spread as their masses, with which displacement is averaged",
    "heterogeneity": "heterogeneity: the stiffness, or the ripple that smoothing leaves, differs "
    "from place to place",
    "unexplained": "what none of these explains",
}
LOUD = 0.1
"""Residual above which the solid does not describe the data, whatever is proven of it."""
NEXT = {
    "noise": "fields of noise in the fit, fit(…, noise=…), or longer means",
    "dispersion": "a smaller spacing of the nodes, a larger horizon or degree, or two influence "
    "functions",
    "anisotropy": "Micromodulus(…), whose bonds have stiffnesses of their own: no isotropic solid "
    "has these moduli",
    "nonlinearity": "smaller loads, or the nonlinear solid, ThirdOrder(LPS(…))",
    "species": "forces in proportion to the masses of a cell's species, or equal masses where "
    "forces are equal",
    "heterogeneity": "a larger smoothing radius and spacing, where the sheet is uniform, or parts "
    "of it, each with a solid of its own",
    "unexplained": "smaller and smoother loads, more of them, and a smaller spacing of the nodes",
}


@dataclass(frozen=True, repr=False)
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
    def causes(self) -> list[str]:
        """Names by share, the largest first; what is unexplained is no cause, and is named where
        nothing has a larger share."""
        names = sorted(self.shares, key=lambda name: -self.shares[name])
        return names if names[0] == "unexplained" else [n for n in names if n != "unexplained"]

    @property
    def sentence(self) -> str:
        """The largest cause in words, and the next one."""
        name, second = self.causes[:2]
        return (
            f"The model leaves {100 * self.residual:.3g} % of the loads; "
            f"{100 * self.shares[name]:.0f} % of its square is {WORDS[name]}. "
            f"Next comes {second}, {100 * self.shares[second]:.0f} %."
        )

    @property
    def advice(self) -> str:
        """What to try next where the residual is above LOUD, else empty."""
        if self.residual <= LOUD:
            return ""
        name = self.causes[0]
        return (
            f"residual: {100 * self.residual:.3g} % of the loads are left, above {100 * LOUD:g} %: "
            "this solid does not describe these data, though what is proven of it holds. "
            f"The largest part is {WORDS[name]}. Try {NEXT[name]}"
        )

    def __repr__(self) -> str:
        shares = {name: f"{100 * self.shares[name]:.0f} % of its square" for name in self.causes}
        left = f"{100 * self.residual:.3g} % of the loads"
        rows = [("left", left), *shares.items()]
        return in_rows("Diagnosis", [*rows, ("try next", self.advice)] if self.advice else rows)


def diagnose(material: Any, samples: Samples, noise: Samples | None = None) -> Diagnosis:
    """Tell the causes of the residual of a material on the data it was fitted to.

    Args:
        material: with a linear part, certified on their lattice, or its operator there.
        samples: training samples on a lattice in the plane, eight at least.
        noise: fields of noise alone on their nodes.

    Raises InputError for a material without a linear part, scattered points, samples in space, too
    few of them, or no load.
    """
    if samples.spacing == 0 or len(samples) < LEAST_SAMPLES:
        raise InputError(
            f"samples: expected {LEAST_SAMPLES} at least on a lattice, got {len(samples)} at a "
            f"spacing of {samples.spacing:g}"
        )
    if samples.points.dimension != 2:
        raise InputError(
            f"samples: expected samples in the plane, got {samples.points.dimension} dimensions; "
            "no cause is known in space"
        )
    (weight,) = sample_weights([samples], normalise=False)
    b = samples.loads[:, samples.interior]
    model: Model = linear_part(material, "diagnose")
    operator = placed(material, samples.points, verb="diagnose", allow_uncertified=True)
    grid = SheetFeatures(samples, model.horizon, dilatation=not model.bond_based)
    left = (b - operator(samples.u)) @ grid.axes
    size = float((b**2).sum())
    total = float((left**2).sum())
    shares: dict[str, float] = {}
    if noise is not None:
        c = products(model, bond_classes(samples.spacing, model.horizon))
        R = noise_loss(noise, samples, model.horizon, weight)
        shares["noise"] = min(1.0, float(np.sum((R @ c) ** 2)) * size / max(total, TINY))
    strong = total < size * (grid.largest_strain / STRONG) ** 4
    followed = (operator(samples.loads) @ grid.axes)[..., None]
    for name, taken in _explained(grid, left, followed, strong=strong).items():
        shares[name] = taken / max(total, TINY)
    rest = 1.0 - shares.get("noise", 0.0)  # what noise makes, the others would take again
    shares = {name: value if name == "noise" else rest * value for name, value in shares.items()}
    shares["unexplained"] = max(0.0, 1.0 - sum(shares.values()))
    return Diagnosis(float(np.sqrt(total / size)), shares)


class _Fit:
    """One cause's features of all samples, and their coefficients by all samples but a part.

    Second differences of smooth fields are nearly the same for all bonds: without a ridge their
    coefficients blow up what is no part of the cause, and on other samples explain less than
    nothing. Which of the few ridges is best is seen on those other samples: one number for all of
    them, which has little room to fit what is not there.

    Args:
        rows: features, shape [S, I, 2, F]; or [S, I, F], where each node and direction has
            coefficients of its own. Those that are zero get 0.
        parts: of the samples.
    """

    def __init__(self, rows: np.ndarray, parts: list[np.ndarray]) -> None:
        scale = np.sqrt((rows**2).sum(axis=tuple(range(rows.ndim - 1))))
        rows = rows / np.where(scale > 0, scale, np.inf)
        self.of_nodes, self.parts = rows.ndim == 3, parts
        if self.of_nodes:
            self.rows = rows.swapaxes(0, 1)[:, :, None]  # [groups, S, equations, F]
        else:
            self.rows = rows.reshape(1, len(rows), -1, rows.shape[-1])
        grams = self.rows.swapaxes(-1, -2) @ self.rows
        whole = grams.sum(axis=1)
        self.axes = [np.linalg.eigh(whole - grams[:, part].sum(axis=1)) for part in parts]

    def predicted(self, field: np.ndarray, number: int, ridge: float) -> np.ndarray:
        """What the coefficients by all but one part say of all samples, shape [S, I, 2]."""
        if self.of_nodes:
            asked = field.swapaxes(0, 1)[:, :, None]
        else:
            asked = field.reshape(1, len(field), -1, 1)
        size, turn = self.axes[number]
        along = self.rows.swapaxes(-1, -2) @ asked
        along = along.sum(axis=1) - along[:, self.parts[number]].sum(axis=1)
        least = ridge**2 * size[:, -1:] + TINY
        c = turn @ (turn.swapaxes(-1, -2) @ along / (np.maximum(size, 0) + least)[..., None])
        said: np.ndarray = self.rows @ c[:, None]
        return said[:, :, 0].swapaxes(0, 1) if self.of_nodes else said.reshape(field.shape)


class _Search:
    """Causes taken off a residual one after the other, and what each leaves on samples left out.

    Args:
        left: residual, shape [S, I, 2].

    Attributes:
        parts: of the samples; each is judged by coefficients from all others.
        level: ‖residual‖² that is left, summed over the parts.
        chosen: features with their ridge, and what they say of all samples by part.
    """

    def __init__(self, left: np.ndarray) -> None:
        order = np.random.default_rng(0).permutation(len(left))
        count = min(PARTS, len(left))
        self.parts = [np.sort(order[k::count]) for k in range(count)]
        self.left, self.level = left, float((left**2).sum())
        self._best = [left.copy() for _ in self.parts]
        self.chosen: list[tuple[_Fit, float, list[np.ndarray]]] = []

    def take(self, *sets: tuple[Callable[[], np.ndarray], ...]) -> float:
        """What the best set of features with its best ridge takes off; never less than nothing."""
        before, now = self.level, self._best
        for features in sets:
            fit = _Fit(np.concatenate([feature() for feature in features], axis=-1), self.parts)
            for ridge in RIDGES:
                tried = [
                    field - fit.predicted(field, number, ridge) for number, field in enumerate(now)
                ]
                judged = sum(
                    float((field[part] ** 2).sum()) for field, part in zip(tried, self.parts)
                )
                if judged < self.level:
                    self.level, self._best, last = judged, tried, (fit, ridge)
        if self.level < before:
            said = [old - new for old, new in zip(now, self._best)]
            self.chosen.append((*last, said))
        return before - self.level

    def with_nodes(self, local: _Fit) -> float:
        """What is left if coefficients of single nodes come to the features that were chosen.

        Both are fitted together, in turns: short waves of a sheet of two phases, taken off by
        themselves, would leave what no node can say.
        """
        levels = [self.level]
        for ridge in RIDGES_OF_NODES:
            total = 0.0
            for number, part in enumerate(self.parts):
                uniform = [said[number] for *_, said in self.chosen]
                own = local.predicted(self.left - sum(uniform), number, ridge)
                for _ in range(TURNS):
                    for k, (fit, known, _) in enumerate(self.chosen):
                        rest = self.left - own - sum(uniform) + uniform[k]
                        uniform[k] = fit.predicted(rest, number, known)
                    own = local.predicted(self.left - sum(uniform), number, ridge)
                total += float(((self.left - own - sum(uniform))[part] ** 2).sum())
            levels.append(total)
        return min(levels)


def _explained(
    grid: SheetFeatures, left: np.ndarray, followed: np.ndarray, *, strong: bool
) -> dict[str, float]:
    """What each cause takes of ‖residual‖², one after the other; none less than nothing.

    A displacement that follows the load is one number, L applied to the load, and is taken where it
    explains nearly all.
    Products of two gradients come first: a linear solid's forces change sign with u, so they take
    nothing of it, while bonds of their own follow a few nonlinear samples. Anisotropy comes with
    bonds by class, in which it is seen among what differs from place to place. Products of three
    gradients, which change sign with u too and ask for a `strong` strain, and the many features
    that reach far could follow what belongs to others: they get only what these leave.
    """
    search = _Search(left)
    alone, bonds = (_Search(left).take((each,)) for each in (lambda: followed, grid.orbits))
    species = alone > MOSTLY * max(search.level, bonds)
    taken = {
        "species": search.take((lambda: followed,)) if species else 0.0,
        "nonlinearity": search.take((grid.invariant,), (grid.quadratic,)),
        "dispersion": search.take((grid.orbits,)),
        "anisotropy": search.take((grid.constants, grid.orbits), (grid.pairs,)),
    }
    local = _Fit(grid.local(), search.parts)
    below = search.with_nodes(local)
    taken["heterogeneity"] = search.level - below
    late = {
        "nonlinearity": search.take((grid.cubic,)) if strong else 0.0,
        "dispersion": search.take((grid.kernels, grid.hexagonal)),
    }
    share = (below - min(below, search.with_nodes(local))) / max(sum(late.values()), TINY)
    for name, gain in late.items():
        taken[name] += share * gain
    return taken
