"""Diagnosis of what residuals say of the law: nested rows, each judged on samples left out.

What a family of forces takes off the residual beyond those before it is the share of its cause:
products of gradients, any isotropic bonds, any tensor for every bond, a stiffness of each node.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.linalg import null_space

from warp_peri.core.elastic import allowed_tensors, point_group
from warp_peri.core.stencil import Basis, elastic_from_brackets, grid_of, invariant_basis
from warp_peri.errors import InputError, Shown
from warp_peri.fitting.evaluate import ROUNDING
from warp_peri.fitting.long_waves import gradients
from warp_peri.fitting.regression import forces
from warp_peri.fitting.settings import LOUD, check_noise, left_by
from warp_peri.points.arguments import typed
from warp_peri.points.points import Samples, lattice_steps
from warp_peri.protocols import stencil_of

TINY = 1e-300
LEAST_TOLD = 0.005
"""Of the square: a cause with a smaller share is not told as the next one."""
LEAST_SAMPLES, PARTS = 8, 24
"""And most parts of the samples; each is judged by coefficients from all others."""
MOST = 60_000
"""Nodes of all samples that are looked at; of more a part that is drawn."""
RIDGES = (0.3, 0.1, 0.03, 0.01, 3e-3, 1e-3, 1e-4, 1e-5)
RIDGES_OF_NODES = RIDGES[:4]
"""Of fits, over the root of their trace: second differences of smooth fields are nearly the same
for all bonds. Of those of single nodes."""
MOSTLY, STRONG = 0.8, 0.05
"""Of the squared residual, what a number takes by itself; a strain where third order matters."""
CAUSES = {
    "noise": ("noise in the displacement", "fields of noise in fit(…, noise=…), or longer means"),
    "species": (
        "a displacement that follows the load: species of a cell are forced unlike their masses",
        "forces in proportion to the masses of a cell's species, or equal masses",
    ),
    "dispersion": (
        "short waves: another kernel, or a crystal's six axes, would take it",
        "a smaller spacing of the nodes, or a larger horizon or degree",
    ),
    "anisotropy": (
        "anisotropy: the material is stiffer along some directions than this model can be",
        "Crystal(…), whose bonds have stiffnesses of their own, or a smaller symmetry",
    ),
    "nonlinearity": (
        "nonlinearity: forces that grow with the square or the cube of the strain",
        "smaller loads, or third-order constants, ThirdOrder(Crystal(…), …)",
    ),
    "heterogeneity": (
        "heterogeneity: stiffness, or the ripple that smoothing leaves, is another in places, and "
        "moduli of one solid may be below those of the softest part",
        "fields λ(x), μ(x) of the LPS, model.on(points, lam=…, mu=…), or a larger smoothing radius",
    ),
    "unexplained": ("what none of these explains", "smaller, smoother and more loads"),
    "rounding": ("rounding: the model answers the data to all of their digits", "larger loads"),
}
"""What each is, and what to try."""


@dataclass(frozen=True, repr=False)
class Diagnosis(Shown):
    """Causes of the squared residual of a model on training data.

    Attributes:
        residual: ‖L u − b‖ / ‖b‖ over all samples.
        shares: of its square, by the name of the cause (see CAUSES); they add up to 1. Noise is
            told only where fields of it were given.
    """

    residual: float
    shares: dict[str, float]

    @property
    def causes(self) -> list[str]:
        """Causes by share, the largest first; "unexplained" only where nothing is larger."""
        names = sorted(self.shares, key=lambda name: -self.shares[name])
        return names if names[0] == "unexplained" else [n for n in names if n != "unexplained"]

    @property
    def sentence(self) -> str:
        """Sentence on the two largest causes."""
        name, second = (*self.causes, "unexplained")[:2]
        after = f" Next comes {second}, {100 * self.shares[second]:.0f} %."
        return (
            f"The model leaves {100 * self.residual:.3g} % of the loads; "
            f"{100 * self.shares[name]:.0f} % of its square is {CAUSES[name][0]}."
        ) + after * (self.shares[second] >= LEAST_TOLD)

    @property
    def advice(self) -> str:
        """Advice on what to try where the residual is above LOUD, else empty."""
        if self.residual <= LOUD:
            return ""
        what, attempt = CAUSES[self.causes[0]]
        return (
            f"residual: {100 * self.residual:.3g} % of the loads are left, above {100 * LOUD:g} %: "
            "this solid does not describe these data, though what is proven of it holds. "
            f"The largest part is {what}. Try {attempt}"
        )

    def rows(self) -> list[tuple[str, str]]:
        """Table of the residual, its causes, and what to try."""
        shares = [(name, f"{100 * self.shares[name]:.0f} % of its square") for name in self.causes]
        rows = [("left", f"{100 * self.residual:.3g} % of the loads"), *shares]
        return [*rows, ("try next", self.advice)] if self.advice else rows


@typed
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
    if samples.spacing == 0 or len(samples) < LEAST_SAMPLES:
        got = f"{len(samples)} at a spacing of {samples.spacing:g}"
        raise InputError(f"samples: expected {LEAST_SAMPLES} at least on a lattice, got {got}")
    if (d := samples.points.dimension) != 2:
        raise InputError(f"samples: expected samples in the plane, got {d} dimensions")
    operator, left, residual = left_by(material, samples, "diagnose")
    total, shares = float((left**2).sum()), {}
    inner = operator(np.where(samples.interior[:, None], samples.u, 0.0))
    if residual <= ROUNDING or total <= ROUNDING**2 * float((inner**2).sum()):
        return Diagnosis(residual, {"rounding": 1.0, "unexplained": 0.0})
    if noise is not None:
        check_noise(noise, samples)
        made = len(samples) * float((operator(noise.u) ** 2).mean(axis=0).sum()) / total
        shares["noise"] = min(1.0, made)
    rest = 1 - sum(shares.values())  # what noise makes, the others would take again
    axes, most = lattice_steps(samples.points)[1], max(1, MOST // len(samples))
    drawn = np.random.default_rng(0).permutation(left.shape[1])[:most]
    species = (operator(samples.loads)[:, drawn] @ axes)[..., None]
    families = [("species", species), *_families(samples, operator, drawn, residual)]
    for name, taken in _explained(left[:, drawn] @ axes, families).items():
        shares[name] = rest * taken
    return Diagnosis(residual, shares | {"unexplained": max(0.0, 1.0 - sum(shares.values()))})


def _families(
    samples: Samples, operator: Any, drawn: np.ndarray, residual: float
) -> list[tuple[str, np.ndarray]]:
    """Forces of families at the drawn interior nodes, along the lattice's axes, [S, I, d, n]; of
    heterogeneity what each node may weigh as it likes, [S, I, n]. Bonds of twice the horizon and
    products of three gradients, which are many, get what single nodes leave."""
    d, h, u = samples.points.dimension, samples.spacing, samples.u
    model = getattr(operator.model, "linear", operator.model)
    stencil, group = stencil_of(model, h, "diagnose")
    far = max(np.sqrt((stencil.steps**2).sum(axis=1).max()), model.horizon / h)
    symmetry = getattr(model, "symmetry", "isotropic")
    turn = getattr(model, "orientation", np.eye(d))
    allowed = allowed_tensors(symmetry, point_group(symmetry, d), turn)
    allowed = np.linalg.qr(allowed.reshape(len(allowed), -1).T)[0]
    near = invariant_basis(1.5, np.array([np.eye(d), -np.eye(d)], int))
    grid = grid_of(samples.points, invariant_basis(far, group).steps, least=stencil.reach)
    grid = replace(grid, interior=grid.interior[drawn])

    def own(horizon: float) -> np.ndarray:
        """Forces of bonds whose long-wave moduli have the model's own symmetry."""
        bonds = invariant_basis(horizon, group)
        C = elastic_from_brackets(bonds.moments())
        C = ((C + C.transpose(0, 3, 4, 1, 2)) / 2).reshape(len(C), -1)
        mix = null_space((C - C @ allowed @ allowed.T).T, 1e-9)
        return np.asarray(forces(u, grid, bonds) @ mix)

    def products(order: int) -> np.ndarray:
        """Divergences of all stresses that are products of `order` entries of the gradient."""
        columns = []
        for some in itertools.combinations_with_replacement(range(d * d), order):
            slope = sum(
                flat[..., [*some[:n], *some[n + 1 :]]].prod(axis=-1)[..., None] * slopes[:, :, one]
                for n, one in enumerate(some)
            )
            for i, j in itertools.combinations_with_replacement(range(d), 2):
                columns.append(np.zeros(slope.shape))
                columns[-1][..., i], columns[-1][..., j] = slope[..., j], slope[..., i]
        return np.stack(columns, axis=-1)

    each = np.einsum("bx,ij->bxij", np.eye(len(near.steps)), np.eye(d))
    second = forces(u, grid, Basis(near.steps, each)) / h  # minus second differences, [S, I, d, B]
    H = gradients(samples, np.flatnonzero(samples.interior)[drawn], 1)
    strain = ((H + H.swapaxes(-1, -2)) / 2)[(..., *np.triu_indices(d))]
    bends = np.linalg.pinv(np.einsum("bj,bk->bjk", near.steps, near.steps).reshape(-1, d * d))
    slopes = (-second / h @ bends.T).reshape(*H.shape, d).reshape(*H.shape[:2], d * d, d)
    flat = H.reshape(*H.shape[:2], -1)
    families = [
        ("nonlinearity", products(2)),
        ("dispersion", own(model.horizon / h)),
        ("anisotropy", forces(u, grid, near)),
        ("heterogeneity", np.concatenate([strain, second.reshape(*second.shape[:2], -1)], axis=-1)),
        ("dispersion", own(far)),
    ]
    strong = residual < (np.abs(strain).max() / STRONG) ** 2
    return [*families, ("nonlinearity", products(3))] if strong else families


def _explained(left: np.ndarray, families: list[tuple[str, np.ndarray]]) -> dict[str, float]:
    """Part of ‖residual‖², [S, I, d], that each cause takes, at least zero. Each family is fitted
    with all before it but the nodes, which get what those leave."""
    y = rest = left.reshape(1, len(left), -1, 1)
    rows, whole, taken = y[..., :0], float((y**2).sum()), dict.fromkeys(dict(families), 0.0)
    for name, columns in families:
        more = rows
        if columns.ndim == 3:
            split = rest.reshape(left.shape).swapaxes(0, 1)[:, :, None]
            there = _left_out(columns.swapaxes(0, 1)[:, :, None], split, RIDGES_OF_NODES)
            there = there[:, :, 0].swapaxes(0, 1).reshape(y.shape)
        else:
            more = np.append(rows, columns.reshape(*y.shape[:3], -1), axis=-1)
            there = _left_out(more, y, RIDGES)
        before = float((rest**2).sum())
        gain = before - float((there**2).sum())
        if gain > MOSTLY * before * (name == "species"):
            taken[name] += gain / whole
            rest, rows = there, more
            y = rest if columns.ndim == 3 else y
    return taken


def _left_out(rows: np.ndarray, y: np.ndarray, ridges: Sequence[float]) -> np.ndarray:
    """Residuals of y [G, S, E, D] by rows [G, S, E, F] with the best ridge, of each sample by the
    fit outside its part; each of G groups has its own numbers."""
    size = np.sqrt((rows**2).sum(axis=(0, 1, 2)))
    rows = rows / np.where(size > 0, size, np.inf)
    gram, side = rows.swapaxes(-1, -2) @ rows, rows.swapaxes(-1, -2) @ y
    order, count = np.random.default_rng(0).permutation(len(y[0])), min(PARTS, len(y[0]))
    found = [y.copy() for _ in ridges]
    for part in (order[k::count] for k in range(count)):
        A, b = (of.sum(axis=1) - of[:, part].sum(axis=1) for of in (gram, side))
        unit = np.trace(A, axis1=-2, axis2=-1)[..., None, None] * np.eye(len(size))
        for rest, ridge in zip(found, ridges):
            c = np.linalg.solve(A + ridge**2 * unit + TINY * np.eye(len(size)), b)
            rest[:, part] -= rows[:, part] @ c[:, None]
    return min(found, key=lambda rest: float((rest**2).sum()))
