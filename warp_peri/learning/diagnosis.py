"""What data say of the law that they need."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import null_space

from warp_peri.contract import linear_part, placed
from warp_peri.errors import InputError
from warp_peri.learning.evaluate import ROUNDING
from warp_peri.learning.response import products
from warp_peri.materials.lps import Model
from warp_peri.points.families import bond_classes
from warp_peri.points.lattice import lattice_steps
from warp_peri.points.samples import Samples
from warp_peri.regression.losses import Products, noise_loss, sample_weights
from warp_peri.shown import in_rows


class SheetFeatures:
    """Features of samples on a lattice.

    Args:
        samples: S fields on a lattice.
        horizon: δ [length].
        dilatation: whether the solid has one; its collar of 2δ bears bonds of bonds then.

    Attributes:
        axes: of the lattice as columns, shape [2, 2].
        place: of the interior nodes in the rectangle of the lattice, shape [I, 2].
    """

    def __init__(self, samples: Samples, horizon: float, *, dilatation: bool = True) -> None:
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
        self._samples, self._horizon, self._dilatation = samples, horizon, dilatation

    @property
    def largest_strain(self) -> float:
        """Largest entry of a strain at an interior node."""
        strain = self._strains()[1][:, self.place[:, 0], self.place[:, 1]]
        return float(np.abs(strain).max())

    def shifted(self, step: tuple[int, int] | np.ndarray) -> np.ndarray:
        """u at the nodes a step away, shape [S, I, 2]."""
        row, column = (self.place + step).T
        values: np.ndarray = self.u[:, row, column]
        return values

    def second(self, step: tuple[int, int] | np.ndarray) -> np.ndarray:
        """u(x + ξ) + u(x − ξ) − 2 u(x), shape [S, I, 2]."""
        away = np.asarray(step)
        bent: np.ndarray = self.shifted(away) + self.shifted(-away) - 2 * self.shifted((0, 0))
        return bent

    def orbits(self) -> np.ndarray:
        """Forces of unit bonds of each class, along the bonds and whole."""
        out = np.zeros((*self.shifted((0, 0)).shape, 2 * (self.kind.max() + 1)))
        for step, kind in zip(self.steps, self.kind):
            d, n = self.second(step), step / np.linalg.norm(step)
            out[..., 2 * kind] += (d @ n)[..., None] * n
            out[..., 2 * kind + 1] += d
        return out

    def kernels(self) -> np.ndarray:
        """What any influence function is made of, (14–17): bonds, and pairs of them through θ.

        Without a dilatation none beside the bonds' own.
        """
        if not self._dilatation:
            return self.orbits()
        forces = Products(self._samples, self._horizon)(self._samples.u)
        along: np.ndarray = np.einsum("sifa,ab->sibf", forces, self.axes)
        return along

    def hexagonal(self) -> np.ndarray:
        """Forces that turn by −4φ with the bond, of sums of classes that short waves alone see.

        A crystal with six axes has them beside those of an isotropic solid; its axes may have any
        angle. On the square's few directions a class by itself would be a stiffness of long waves
        that no such crystal has.
        """
        count = 2 * (self.kind.max() + 1)
        out, moments = np.zeros((*self.shifted((0, 0)).shape, count)), np.zeros((8, count))
        for step, kind in zip(self.steps, self.kind):
            d, angle = self.second(step), 4 * np.arctan2(step[1], step[0])
            c, s = np.cos(angle), np.sin(angle)
            out[..., 2 * kind] += d @ np.array([[c, -s], [-s, -c]])
            out[..., 2 * kind + 1] += d @ np.array([[s, c], [c, -s]])
            moments[:, 2 * kind] += np.outer(np.outer(step, step), [c, -s]).ravel()
            moments[:, 2 * kind + 1] += np.outer(np.outer(step, step), [s, c]).ravel()
        short: np.ndarray = out @ null_space(moments)
        return short

    def pairs(self) -> np.ndarray:
        """Unit bonds, each by itself, with every symmetric matrix."""
        parts = []
        for step in self.steps:
            d = self.second(step)
            zero = np.zeros_like(d[..., 0])
            parts += [
                np.stack([d[..., 0], zero], axis=-1),
                np.stack([zero, d[..., 1]], axis=-1),
                d[..., ::-1],
            ]
        return np.stack(parts, axis=-1)

    def constants(self) -> np.ndarray:
        """Forces of the six constants of a sheet without symmetry."""
        a, c = self.second((1, 0)), self.second((0, 1))
        d = (self.second((1, 1)) - self.second((1, -1))) / 4  # ∂₁∂₂ u h²
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

    def quadratic(self) -> np.ndarray:
        """Divergences of every stress that is a product of two gradients, 30 of them."""
        gradient = self._gradient()
        i, j = np.triu_indices(4)
        stress = gradient[..., i] * gradient[..., j]
        slopes = [self._slope(stress, axis) for axis in (1, 2)]
        zero = np.zeros_like(slopes[0])
        columns = [
            np.stack([slopes[0], zero], axis=2),
            np.stack([zero, slopes[1]], axis=2),
            np.stack([slopes[1], slopes[0]], axis=2),
        ]
        return np.concatenate(columns, axis=-1)

    def invariant(self) -> np.ndarray:
        """Divergences of the second-order stresses of a hexagonal sheet, 6 of them.

        With H = ∇u and the strain e + HᵗH/2 they are those of the two Lamé parameters under
        rotation, and of the four energies of third order: (tr e)³, tr e tr e², and the real and
        imaginary part of (e₁₁ − e₂₂ + 2i e₁₂)³, which has the six-fold axis at any angle. Five are
        independent: by Cayley and Hamilton the second is a sum of the first, third and fourth.
        """
        H, e, q = self._strains()
        turned = [first + H @ known for first, known in zip(_first(q), _first(e))]
        return self._forces([*turned, *_second(e, e)])

    def cubic(self) -> np.ndarray:
        """The same of third order, with the five energies of fourth order, 11 of them."""
        H, e, q = self._strains()
        turned = [H @ first for first in _first(q)]
        turned += [2 * mixed + H @ pure for mixed, pure in zip(_second(e, q), _second(e, e))]
        unit, trace, square = np.eye(2), _trace(e), _trace(e @ e)
        spin = _spin(e)[..., None, None]
        whole = [trace**3 * unit, trace * square * unit + trace**2 * e, square * e]
        whole += [
            part(spin**3) * unit + 3 * trace * known
            for part, known in zip((np.real, np.imag), _second(e, e)[2:])
        ]
        return self._forces([*turned, *whole])

    def local(self) -> np.ndarray:
        """Strains and second differences around each node, shape [S, I, 11]."""
        gradient = self._gradient()[:, self.place[:, 0], self.place[:, 1]]
        strain = np.stack(
            [gradient[..., 0], gradient[..., 3], gradient[..., 1] + gradient[..., 2]], axis=-1
        )
        seconds = [self.second(step) / self.h for step in ((1, 0), (0, 1), (1, 1), (1, -1))]
        return np.concatenate([strain, *seconds], axis=-1)

    def _gradient(self) -> np.ndarray:
        """∂u by central differences everywhere, entries 11, 12, 21, 22: [S, n₁, n₂, 4]."""
        u = self.u
        parts = [(np.roll(u, -1, axis) - np.roll(u, 1, axis)) / (2 * self.h) for axis in (1, 2)]
        return np.concatenate([parts[0], parts[1]], axis=-1)

    def _strains(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """H = ∇u, its symmetric part and HᵗH/2, shape [S, n₁, n₂, 2, 2]."""
        gradient = self._gradient()
        H = gradient.reshape(*gradient.shape[:-1], 2, 2).swapaxes(-1, -2)
        return H, (H + H.swapaxes(-1, -2)) / 2, H.swapaxes(-1, -2) @ H / 2

    def _forces(self, stresses: list[np.ndarray]) -> np.ndarray:
        """Divergences of stresses [S, n₁, n₂, 2, 2]."""
        forces = [self._slope(one[..., 0], 1) + self._slope(one[..., 1], 2) for one in stresses]
        return np.stack(forces, axis=-1)

    def _slope(self, field: np.ndarray, axis: int) -> np.ndarray:
        """Derivative of a field [S, n₁, n₂, …] along an axis at the interior nodes [S, I, …]."""
        by_steps = (np.roll(field, -1, axis) - np.roll(field, 1, axis)) / (2 * self.h)
        at_nodes: np.ndarray = by_steps[:, self.place[:, 0], self.place[:, 1]]
        return at_nodes


def _trace(a: np.ndarray) -> np.ndarray:
    """Of matrices in the last two axes, kept as axes of one."""
    trace: np.ndarray = np.trace(a, axis1=-2, axis2=-1)[..., None, None]
    return trace


def _spin(e: np.ndarray) -> np.ndarray:
    """e₁₁ − e₂₂ + 2i e₁₂, which turns twice as fast as the axes."""
    spin: np.ndarray = e[..., 0, 0] - e[..., 1, 1] + 2j * e[..., 0, 1]
    return spin


def _first(e: np.ndarray) -> list[np.ndarray]:
    """Stresses of (tr e)²/2 and tr e²."""
    return [_trace(e) * np.eye(2), 2 * e]


def _second(a: np.ndarray, b: np.ndarray) -> list[np.ndarray]:
    """Symmetric in both, and for a = b = e stresses of (tr e)³/3, tr e tr e² and Re, Im of z³/6,
    where z is the spin of e."""
    unit, z = np.eye(2), _spin(a) * _spin(b)
    spin = [
        np.stack([p, q, q, -p], axis=-1).reshape(a.shape)
        for p, q in ((z.real, -z.imag), (z.imag, z.real))
    ]
    both = _trace(a @ b) * unit + _trace(a) * b + _trace(b) * a
    return [_trace(a) * _trace(b) * unit, both, *spin]


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
    "rounding": "rounding: the model answers the data to all of their digits",
}
LOUD = 0.1
"""Residual above which the solid does not describe the data, whatever is proven of it."""
NEXT = {
    "noise": "fields of noise in the fit, fit(…, noise=…), or longer means",
    "dispersion": "a smaller spacing of the nodes, a larger horizon or degree, or two influence "
    "functions",
    "anisotropy": "Micromodulus(…), whose bonds have stiffnesses of their own: no isotropic solid "
    "has these moduli",
    "nonlinearity": "smaller loads, or third-order constants, ThirdOrder(Micromodulus(…), …)",
    "species": "forces in proportion to the masses of a cell's species, or equal masses where "
    "forces are equal",
    "heterogeneity": "a larger smoothing radius and spacing, where the sheet is uniform, or parts "
    "of it, each with a solid of its own",
    "unexplained": "smaller and smoother loads, more of them, and a smaller spacing of the nodes",
    "rounding": "larger loads: these are rounding of the forces that cancel in them",
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
        name, second = (*self.causes, "unexplained")[:2]
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
    """Name the causes of the residual of a material on the data it was fitted to.

    Args:
        material: with a linear part, certified on their lattice, or its operator there.
        samples: training samples on a lattice in the plane, eight at least.
        noise: fields of noise alone on their nodes.

    Raises InputError for a material without a linear part, scattered points, samples in space, too
    few of them, or no load.

    >>> wp.diagnose(wp.fit(samples, wp.LPS(10.0, wp.Bernstein(0))).material, samples).causes[0]
    'dispersion'
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
    model = linear_part(material, "diagnose")
    if not isinstance(model, Model):
        raise InputError(f"diagnose: expected an LPS, a Model, got a {type(model).__name__}")
    operator = placed(material, samples.points, verb="diagnose", allow_uncertified=True)
    grid = SheetFeatures(samples, model.horizon, dilatation=not model.bond_based)
    left = (b - operator(samples.u)) @ grid.axes
    size = float((b**2).sum())
    total = float((left**2).sum())
    inner = operator(np.where(samples.interior[:, None], samples.u, 0.0))
    if total <= ROUNDING**2 * max(size, float((inner**2).sum())):
        return Diagnosis(float(np.sqrt(total / size)), {"rounding": 1.0, "unexplained": 0.0})
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
