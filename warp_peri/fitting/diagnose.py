"""What data say of the law that they need: nested rows, each judged on samples left out.

Isotropic ⊂ any moduli ⊂ any tensor for every bond ⊂ products of gradients ⊂ stiffness of each node:
what a family takes off the residual beyond those within it is the share of its cause.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.linalg import null_space

from warp_peri.contract import LINEAR, offered, placed, stencil_of
from warp_peri.core.elastic import allowed_tensors, elastic_from_brackets
from warp_peri.core.grid import grid_of
from warp_peri.core.groups import point_group
from warp_peri.core.stencil import Basis, half_ball, invariant_basis
from warp_peri.errors import InputError, quietly, warn
from warp_peri.fitting.evaluate import ROUNDING
from warp_peri.fitting.rows import forces
from warp_peri.points.lattice import lattice_steps
from warp_peri.points.samples import Samples
from warp_peri.shown import Shown

TINY = 1e-300
LEAST_TOLD = 0.005
"""Of the square: a cause with a smaller share is not told as the next one."""
LEAST_SAMPLES, PARTS = 8, 24
"""And most parts of the samples; each is judged by coefficients from all others."""
MOST = 60_000
"""Nodes of all samples that are looked at; of more a part that is drawn."""
RIDGES = (0.3, 0.1, 0.03, 0.01, 3e-3, 1e-3, 1e-4, 1e-5)
RIDGES_OF_NODES, TURNS = RIDGES[:4], 2
"""Of fits, over the root of their trace: second differences of smooth fields are nearly the same
for all bonds. Of those of single nodes, and turns in which both are fitted to what is left."""
MOSTLY, STRONG, LOUD = 0.8, 0.05, 0.1
"""Of the squared residual, what a number by itself takes; a strain at which stresses of third order
may be as large as linear ones; a residual above which the solid does not describe the data."""
CAUSES = {
    "noise": ("noise in the displacement", "fields of noise in fit(…, noise=…), or longer means"),
    "species": (
        "a displacement that follows the load: forces on the species of a cell that are not spread "
        "as their masses, with which displacement is averaged",
        "forces in proportion to the masses of a cell's species, or equal masses",
    ),
    "dispersion": (
        "short waves: another kernel, or a crystal's six axes, would take it",
        "a smaller spacing of the nodes, or a larger horizon or degree",
    ),
    "anisotropy": (
        "anisotropy: the material is stiffer along some directions than this model can be",
        "Micromodulus(…), whose bonds have stiffnesses of their own, or a smaller symmetry",
    ),
    "nonlinearity": (
        "nonlinearity: forces that grow with the square or the cube of the strain",
        "smaller loads, or third-order constants, ThirdOrder(Micromodulus(…), …)",
    ),
    "heterogeneity": (
        "heterogeneity: stiffness, or the ripple that smoothing leaves, differs from place to "
        "place, and moduli of one solid may be below those of the softest part",
        "fields λ(x), μ(x) of the LPS, model.on(points, lam=…, mu=…), with their gradients, or "
        "where the sheet is uniform a larger smoothing radius and spacing",
    ),
    "unexplained": ("what none of these explains", "smaller, smoother and more loads"),
    "rounding": ("rounding: the model answers the data to all of their digits", "larger loads"),
}
"""What each is, and what to try."""


@dataclass(frozen=True, repr=False)
class Diagnosis(Shown):
    """Where the squared residual of a model on training data comes from.

    Attributes:
        residual: ‖L u − b‖ / ‖b‖ over all samples.
        shares: of its square, by the name of the cause (see CAUSES); they add up to 1. Noise is
            told only where fields of it were given.
    """

    residual: float
    shares: dict[str, float]

    @property
    def causes(self) -> list[str]:
        """Names by share, the largest first; what is unexplained only where nothing is larger."""
        names = sorted(self.shares, key=lambda name: -self.shares[name])
        return names if names[0] == "unexplained" else [n for n in names if n != "unexplained"]

    @property
    def sentence(self) -> str:
        """The largest cause in words, and the next one."""
        name, second = (*self.causes, "unexplained")[:2]
        after = f" Next comes {second}, {100 * self.shares[second]:.0f} %."
        return (
            f"The model leaves {100 * self.residual:.3g} % of the loads; "
            f"{100 * self.shares[name]:.0f} % of its square is {CAUSES[name][0]}."
        ) + after * (self.shares[second] >= LEAST_TOLD)

    @property
    def advice(self) -> str:
        """What to try next where the residual is above LOUD, else empty."""
        if self.residual <= LOUD:
            return ""
        what, attempt = CAUSES[self.causes[0]]
        return (
            f"residual: {100 * self.residual:.3g} % of the loads are left, above {100 * LOUD:g} %: "
            "this solid does not describe these data, though what is proven of it holds. "
            f"The largest part is {what}. Try {attempt}"
        )

    def rows(self) -> list[tuple[str, str]]:
        """What is left, the causes of it, and what to try."""
        shares = [(name, f"{100 * self.shares[name]:.0f} % of its square") for name in self.causes]
        rows = [("left", f"{100 * self.residual:.3g} % of the loads"), *shares]
        return [*rows, ("try next", self.advice)] if self.advice else rows


def diagnose(material: Any, samples: Samples, noise: Samples | None = None) -> Diagnosis:
    """Name the causes of the residual of a material on the data it was fitted to.

    Args:
        material: a linear solid or one with a linear part, or its operator on these points.
        samples: training samples on a lattice in the plane, eight at least.
        noise: fields of noise alone on their nodes.

    Raises InputError for a material without a linear part, scattered points, samples in space, too
    few of them, or no load.

    >>> wp.diagnose(wp.fit(samples, wp.LPS(10.0, wp.Bernstein(0))).material, samples).causes[0]
    'dispersion'
    """
    return _causes(*_residual(material, samples), samples, noise)


def _causes(
    operator: Any, left: np.ndarray, size: float, samples: Samples, noise: Samples | None
) -> Diagnosis:
    """The causes of what is left of ‖b‖², `size`, on the interior."""
    points, u = samples.points, samples.u
    total, inner = float((left**2).sum()), operator(np.where(samples.interior[:, None], u, 0.0))
    residual = float(np.sqrt(total / size))
    if total <= ROUNDING**2 * max(size, float((inner**2).sum())):
        return Diagnosis(residual, {"rounding": 1.0, "unexplained": 0.0})
    made = 0.0
    if noise is not None:
        if what := points.differs_from(noise.points):
            raise InputError(
                f"noise: expected fields on the nodes of the samples, got other {what}"
            )
        made = min(1.0, len(samples) * float((operator(noise.u) ** 2).mean(axis=0).sum()) / total)
    axes, inside = lattice_steps(points)[1], left.shape[1]
    drawn = np.random.default_rng(0).permutation(inside)[: max(1, MOST // len(samples))]
    families = _families(samples, operator, drawn)
    families["species"] = (operator(samples.loads)[:, drawn] @ axes)[..., None]
    strong = total < size * (np.abs(families["nodes"][..., :3]).max() / STRONG) ** 4
    shares = {} if noise is None else {"noise": made}
    for name, taken in _explained(left[:, drawn] @ axes, families, strong=strong).items():
        shares[name] = (1 - made) * taken  # what noise makes, the others would take again
    return Diagnosis(residual, shares | {"unexplained": max(0.0, 1.0 - sum(shares.values()))})


def warn_of_kind(material: Any, samples: Samples, noise: Samples | None = None) -> None:
    """Say where so much is left of data that they ask for another kind of material."""
    try:
        with quietly():  # said by the fit
            operator, left, size = _residual(material, samples)
            loud = (left**2).sum() > LOUD**2 * size
            told = _causes(operator, left, size, samples, noise).advice if loud else ""
    except InputError:  # in space, scattered, too few
        return
    if told:
        warn(told)


def _residual(material: Any, samples: Samples) -> tuple[Any, np.ndarray, float]:
    """The operator on the points, b − L u on their interior, and ‖b‖²; errors of `diagnose`."""
    points, b = samples.points, samples.loads[:, samples.interior]
    if samples.spacing == 0 or len(samples) < LEAST_SAMPLES:
        got = f"{len(samples)} at a spacing of {samples.spacing:g}"
        raise InputError(f"samples: expected {LEAST_SAMPLES} at least on a lattice, got {got}")
    if (d := points.dimension) != 2:
        raise InputError(f"samples: expected samples in the plane, got {d} dimensions")
    if not (size := float((b**2).sum())) > 0:
        raise InputError("samples: expected loads on their interior, got none")
    law = getattr(material, "model", material)
    known = offered(getattr(law, "linear", law), "stencil", "diagnose", LINEAR)
    loose: dict[str, Any] = (
        {"allow_uncertified": True} if callable(known) or hasattr(law, "linear") else {}
    )
    operator = placed(material, points, verb="diagnose", **loose)
    return operator, b - operator(samples.u), size


def _families(samples: Samples, operator: Any, drawn: np.ndarray) -> dict[str, np.ndarray]:
    """Forces of families at interior nodes that are drawn, along the lattice's axes, [S, I, d, n].

    Of "nodes" what each node may weigh as it likes, [S, I, n]: strain and second differences.
    """
    d, h, u = samples.points.dimension, samples.spacing, samples.u
    model = getattr(operator.model, "linear", operator.model)
    stencil, group = stencil_of(model, h, "diagnose")
    inner = invariant_basis(model.horizon / h, group)
    every = invariant_basis(np.sqrt((stencil.steps**2).sum(axis=1).max()), group)
    bonds = invariant_basis(model.horizon / h, np.array([np.eye(d), -np.eye(d)], int))
    symmetry = getattr(model, "symmetry", "isotropic")
    turn = getattr(model, "orientation", np.eye(d))
    allowed = allowed_tensors(symmetry, point_group(symmetry, d), turn)
    allowed = np.linalg.qr(allowed.reshape(len(allowed), -1).T)[0]
    grid = grid_of(samples.points, every.steps, least=stencil.reach)
    grid = replace(grid, interior=grid.interior[drawn])

    def own(bonds: Basis) -> np.ndarray:
        """Columns whose long waves have moduli of the model's own symmetry."""
        C = elastic_from_brackets(bonds.moments())
        C = ((C + C.transpose(0, 3, 4, 1, 2)) / 2).reshape(len(C), -1)
        mix = null_space((C - C @ allowed @ allowed.T).T, 1e-9)
        return np.asarray(forces(u, grid, bonds) @ mix)

    def at(planes: np.ndarray) -> np.ndarray:
        """Planes [S, …, *wide] at the interior nodes, [S, I, …]."""
        whole = (slice(None),) * (planes.ndim - d)
        core = planes[(*whole, *grid.core)] if grid.periodic else planes
        return np.moveaxis(core.reshape(*core.shape[:-d], -1)[..., grid.interior], -1, 1)

    def shifted(planes: np.ndarray, step: np.ndarray) -> np.ndarray:
        return np.roll(planes, tuple(-step), axis=tuple(range(-d, 0)))

    def slopes(planes: np.ndarray) -> list[np.ndarray]:
        return [(shifted(planes, e) - shifted(planes, -e)) / (2 * h) for e in np.eye(d, dtype=int)]

    def products(order: int) -> np.ndarray:
        """Divergences of every stress that is a product of so many entries of the gradient."""
        found = []
        for some in itertools.combinations_with_replacement(range(d * d), order):
            slope = [at(each) for each in slopes(flat[:, list(some)].prod(axis=1))]
            for i, j in itertools.combinations_with_replacement(range(d), 2):
                found.append(np.zeros((*slope[0].shape, d)))
                found[-1][..., i], found[-1][..., j] = slope[j], slope[i]
        return np.stack(found, axis=-1)

    planes = grid.scatter(u)
    H = np.stack(slopes(planes), axis=2)  # ∂u_i/∂x_j, [S, d, d, …]
    flat = H.reshape(len(u), d * d, *H.shape[3:])
    strain = (at(H + H.swapaxes(1, 2)) / 2)[(..., *np.triu_indices(d))]
    seconds = (shifted(planes, s) + shifted(planes, -s) - 2 * planes for s in half_ball(1.5, d))
    few = bonds.basis[bonds.basis[:, (bonds.steps**2).sum(axis=1) <= 2].any(axis=(1, 2, 3))]
    return {
        "nonlinearity": products(2),
        "dispersion": own(inner),
        "anisotropy": forces(u, grid, Basis(bonds.steps, few)),
        "nodes": np.concatenate([strain, *(at(one) / h for one in seconds)], axis=-1),
        "late dispersion": np.concatenate([own(every), own(bonds)], axis=-1),
        "late nonlinearity": products(3),
    }


class _Fit:
    """Coefficients of rows [G, S, E, F] by all samples but a part; each of G groups has its own."""

    def __init__(self, rows: np.ndarray, parts: list[np.ndarray]) -> None:
        size = np.sqrt((rows**2).sum(axis=(0, 1, 2)))
        self.rows, self.parts = rows / np.where(size > 0, size, np.inf), parts
        self.grams = self._others(self.rows)

    def _others(self, right: np.ndarray) -> np.ndarray:
        """Rows times right sides [G, S, E, D] over the samples outside each part, [K, G, F, D]."""
        each = self.rows.swapaxes(-1, -2) @ right
        inside = np.array([each[:, part].sum(axis=1) for part in self.parts])
        return np.asarray(each.sum(axis=1) - inside)

    def _solved(self, along: np.ndarray, grams: np.ndarray, ridge: float) -> np.ndarray:
        least = ridge**2 * np.trace(grams, axis1=-2, axis2=-1) + TINY
        G = grams + least[..., None, None] * np.eye(grams.shape[-1])
        return np.asarray(np.linalg.solve(G, along))

    def said(self, right: np.ndarray, k: int, ridge: float) -> np.ndarray:
        """Of all samples, by those outside a part."""
        c = self._solved(self._others(right)[k], self.grams[k], ridge)
        return np.asarray(self.rows @ c[:, None])

    def best(self, right: np.ndarray) -> tuple[float, float]:
        """The square that is left on samples left out with the best ridge, and that ridge."""
        along, found = self._others(right), []
        for ridge in RIDGES:
            c = self._solved(along, self.grams, ridge)[:, :, None]
            left = (right[:, p] - self.rows[:, p] @ one for p, one in zip(self.parts, c))
            found.append((sum(float((one**2).sum()) for one in left), ridge))
        return min(found)


def _explained(
    left: np.ndarray, families: dict[str, np.ndarray], *, strong: bool
) -> dict[str, float]:
    """The part of ‖residual‖², of shape [S, I, d], that each cause takes; none less than nothing.

    Each family is fitted with all before it. Short waves of any tensors and forces that grow with
    the cube of a `strong` strain are many, and could follow what belongs to single nodes: they get
    what these leave. Both are fitted in turns.
    """
    samples, y = len(left), left.reshape(1, len(left), -1, 1)
    order, count = np.random.default_rng(0).permutation(samples), min(PARTS, samples)
    parts = [np.sort(order[k::count]) for k in range(count)]
    fit, level, ridge = _Fit(y[..., :0], parts), float((y**2).sum()), 1.0
    local = _Fit(families["nodes"].swapaxes(0, 1)[:, :, None], parts)
    taken = dict.fromkeys(families, 0.0)

    def take(name: str, least: float = 0.0) -> None:
        nonlocal fit, level, ridge
        more = _Fit(np.append(fit.rows, families[name].reshape(*y.shape[:3], -1), axis=-1), parts)
        there, best = more.best(y)
        if level - there > least:
            taken[name], fit, level, ridge = level - there, more, there, best

    def with_nodes() -> float:
        levels = [level]
        for each in RIDGES_OF_NODES:
            levels.append(0.0)
            for k, part in enumerate(parts):
                own = rest = np.zeros_like(left)
                for _ in range(TURNS):
                    rest = left - fit.said(y - own.reshape(y.shape), k, ridge).reshape(left.shape)
                    own = local.said(rest.swapaxes(0, 1)[:, :, None], k, each)[:, :, 0]
                    own = own.swapaxes(0, 1)
                levels[-1] += float(((rest - own)[part] ** 2).sum())
        return min(levels)

    take("species", MOSTLY * level)
    for name in ("nonlinearity", "dispersion", "anisotropy"):
        take(name)
    below = with_nodes()
    taken["heterogeneity"] = level - below
    late = ["late dispersion", *(["late nonlinearity"] if strong else [])]
    for name in late:
        take(name)
    share = (below - min(below, with_nodes())) / max(sum(taken[name] for name in late), TINY)
    for name in late:
        taken[name.removeprefix("late ")] += share * taken[name]
    total = max(float((y**2).sum()), TINY)
    return {name: taken[name] / total for name in CAUSES if name in taken}
