"""Diagnosis of what residuals say of the law: nested rows, each judged on samples left out.

What a family of forces takes off the residual beyond those before it is the share of its cause.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations_with_replacement
from typing import Any

import numpy as np
from numpy import ndarray
from numpy.linalg import norm, pinv, qr, solve, svd, trace

from warp_peri.core.elastic import allowed_tensors, symmetric_part
from warp_peri.core.proof import stencil_of
from warp_peri.core.stencil import Basis, elastic_from_brackets, grid_of, half_ball, invariant_basis
from warp_peri.errors import InputError, Rows, Shown
from warp_peri.fitting.evaluate import ROUNDING
from warp_peri.fitting.long_waves import gradients
from warp_peri.fitting.regression import forces, norms
from warp_peri.fitting.result import LOUD, check_noise, left_by
from warp_peri.points.arguments import typed
from warp_peri.points.dataset import warn_of_unseen
from warp_peri.points.points import Samples

TINY, LEAST_SAMPLES, PARTS, MOST = 1e-300, 8, 24, 60_000
"""Beside zero; samples at least; parts left out in turn; nodes of all samples, drawn of more."""
LEAST_TOLD, MOSTLY, STRONG = 0.005, 0.8, 0.05
"""Of the square, what is told as next, and what is one number's; strain where cubes matter."""
RIDGES, OF_NODES = (0.3, 0.1, 0.03, 0.01, 3e-3, 1e-3, 1e-4, 1e-5), 4
"""Of fits, over the root of their trace: second differences of smooth fields are nearly the same
for all bonds. How many of them single nodes are fitted with."""
SYMMETRIC = np.array([[[1, 0], [0, 0]], [[0, 1], [1, 0]], [[0, 0], [0, 1]]])
CAUSES = {
    "noise": "noise in the displacement. Try longer means; a fit without noise=…, by "
    "loss='residual' or by TwoStage is biased by it",
    "species": "a displacement that follows the load: species of a cell are forced unlike their "
    "masses. Try forces in proportion to the masses of a cell's species, or equal masses",
    "dispersion": "short waves: another kernel, or a crystal's six axes, would take it. Try a "
    "smaller spacing of the nodes, or a larger horizon or degree",
    "anisotropy": "anisotropy: the material is stiffer along some directions than this model can "
    "be. Try Crystal(…), whose bonds have stiffnesses of their own, or a smaller symmetry",
    "nonlinearity": "nonlinearity: forces that grow with the square or the cube of the strain. Try "
    "smaller loads, or third-order constants, ThirdOrder(Crystal(…), …)",
    "heterogeneity": "heterogeneity: stiffness, or the ripple that smoothing leaves, is another in "
    "places, and moduli of one solid may be below those of the softest part. Try fields λ(x), μ(x) "
    "of the LPS, model.on(points, lam=…, mu=…), or a larger smoothing radius",
    "unexplained": "what none of these explains. Try smaller, smoother and more loads",
    "rounding": "rounding: the model answers the data to all of their digits. Try larger loads",
}
"""What each is, and what to try."""


@dataclass(frozen=True, repr=False)
class Diagnosis(Shown):
    """Causes of the squared residual of a model on training data.

    Attributes:
        residual: ‖L u − b‖ / ‖b‖ over all samples.
        shares: of its square, by cause (see CAUSES), together 1; noise only with fields of it.
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
        rows, share = dict(self.rows()), self.shares[second]
        told = (
            f"The model leaves {rows['left']}; {rows[name]} is {CAUSES[name].partition('. ')[0]}."
        )
        return told + f" Next comes {second}, {100 * share:.0f} %." * (share >= LEAST_TOLD)

    @property
    def advice(self) -> str:
        """Advice on what to try where the residual is above LOUD, else empty."""
        return (self.residual > LOUD) * (
            f"residual: {100 * self.residual:.3g} % of the loads are left, above {100 * LOUD:g} %: "
            "this solid does not describe these data, though what is proven of it holds. "
            f"The largest part is {CAUSES[self.causes[0]]}"
        )

    def rows(self) -> Rows:
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
    few of them, no load, or displacements that the material answers with no force.

    >>> wp.diagnose(wp.fit(samples, wp.LPS(10.0, wp.Bernstein(0))).material, samples).causes[0]
    'dispersion'
    """
    if samples.spacing == 0 or len(samples) < LEAST_SAMPLES:
        got = f"{len(samples)} at a spacing of {samples.spacing:g}"
        raise InputError(f"samples: expected {LEAST_SAMPLES} at least on a lattice, got {got}")
    if (d := samples.dimension) != 2:
        raise InputError(f"samples: expected samples in the plane, got {d} dimensions")
    if noise is not None:
        check_noise(noise, samples)
    warn_of_unseen(samples)
    operator, left, residual = left_by(material, samples, "diagnose")
    total, shares = float((left**2).sum()), dict[str, float]()
    inner = operator(np.where(samples.interior[:, None], samples.u, 0.0))
    if residual <= ROUNDING or total <= ROUNDING**2 * (inner**2).sum():
        return Diagnosis(residual, {"rounding": 1.0, "unexplained": 0.0})
    if norm(samples.loads[:, samples.interior] - left) <= ROUNDING * norm(inner):
        raise InputError("samples: expected displacements with forces, got none, or affine ones")
    if noise is not None:
        made = len(samples) * float((operator(noise.u) ** 2).mean(axis=0).sum()) / total
        shares["noise"] = min(1.0, made)
    others = 1 - sum(shares.values())  # what noise makes, the others would take again
    drawn = np.random.default_rng(0).permutation(left.shape[1])[: max(1, MOST // len(samples))]
    rest = y = left[:, drawn] @ samples.lattice.axes
    rows, total = np.empty((*y.shape, 0)), float((y**2).sum())
    for name, columns in _families(samples, operator, drawn, residual):
        nodes = columns.ndim == 3  # get what those before leave, others are fitted with those
        more = columns if nodes else np.append(rows, columns, axis=-1)
        there = _left_out(more, rest if nodes else y)
        gain = float((rest**2).sum() - (there**2).sum()) / total
        if taken := gain > MOSTLY * (name == "species"):
            rest, y, rows = (there, there, rows) if nodes else (there, y, more)
        shares[name] = shares.get(name, 0.0) + taken * others * gain
    return Diagnosis(residual, shares | {"unexplained": max(0.0, 1.0 - sum(shares.values()))})


def _families(samples: Samples, operator: Any, drawn: ndarray, residual: float) -> Any:
    """Causes and forces that they could add at the drawn interior nodes, along the lattice's axes,
    [S, I, d, n], or each node's own, [S, I, n]. Bonds of twice the horizon and products of three
    gradients, which are many, get what single nodes leave."""
    d, h, u = samples.dimension, samples.spacing, samples.u
    model = getattr(operator.model, "linear", operator.model)
    stencil, group = stencil_of(model, h, "diagnose")
    far = max(norms(stencil.steps).max(), model.horizon / h)
    symmetry = getattr(model, "symmetry", "isotropic")
    allowed = allowed_tensors(symmetry, getattr(model, "orientation", np.eye(d)))
    allowed = qr(allowed.reshape(len(allowed), -1).T)[0]
    bonds, wide = (invariant_basis(r, group) for r in (model.horizon / h, far))
    grid = grid_of(samples.points, wide.steps, least=stencil.reach)
    grid = replace(grid, interior=grid.interior[drawn])

    def own(bonds: Basis) -> Any:
        """Forces of bonds whose long-wave moduli have the model's own symmetry."""
        C = elastic_from_brackets(bonds.moments()).reshape(-1, d * d, d * d)
        C = (C + C.mT).reshape(len(C), -1)
        size, mixes = svd((C - C @ allowed @ allowed.T).T)[1:]
        return forces(u, grid, bonds) @ mixes[np.sum(size > 1e-9 * np.abs(C).max()) :].T

    def tensors(vectors: ndarray) -> Any:
        """Products of vectors [S, I, d, n] with each symmetric tensor."""
        return np.einsum("mij,sxjn->sxinm", SYMMETRIC, vectors).reshape(*vectors.shape[:3], -1)

    near = half_ball(1.5, d)
    second = forces(u, grid, Basis(near, np.eye(len(near))[..., None, None] * np.eye(d)))
    bends = -pinv(np.einsum("bj,bk->bjk", near, near).reshape(-1, d * d))
    bent = np.einsum("jkb,sxib->sxkij", bends.reshape(d, d, -1), second)  # second derivatives
    H = gradients(samples, np.flatnonzero(samples.interior)[drawn], 1)
    strain = symmetric_part(H)[(..., *np.triu_indices(d))]
    # imaginary parts of products are derivatives: of stresses that are products of gradients
    stepped = (H[:, :, None] + 1e-30j * bent).reshape(*H.shape[:2], d, -1)
    pairs, triples = (np.array([*combinations_with_replacement(range(d * d), n)]) for n in (2, 3))
    yield "species", (operator(samples.loads)[:, drawn] @ grid.axes)[..., None]
    yield "nonlinearity", tensors(stepped[..., pairs].prod(axis=-1).imag)
    yield "dispersion", own(bonds)
    yield "anisotropy", tensors(second)
    yield "heterogeneity", np.append(strain, second.reshape(*strain.shape[:2], -1), axis=-1)
    yield "dispersion", own(wide)
    if residual < (np.abs(strain).max() / STRONG) ** 2:
        yield "nonlinearity", tensors(stepped[..., triples].prod(axis=-1).imag)


def _left_out(rows: ndarray, left: ndarray) -> ndarray:
    """Residuals of left [S, I, d] with the best ridge, of each sample by the fit outside its part,
    to rows [S, I, d, n], or to [S, I, n] with numbers of every node's own."""
    y = left.reshape((*left.shape[:2], 1, -1) if rows.ndim == 3 else (len(left), 1, -1, 1))
    rows = rows.reshape(*y.shape[:3], -1)
    rows = rows / np.maximum(np.sqrt((rows**2).sum(axis=(0, 1, 2))), TINY)
    gram, side = rows.mT @ rows, rows.mT @ y
    ridges = np.reshape(RIDGES[: OF_NODES if y.shape[2] == 1 else None], (-1, 1, 1, 1))
    order, found = np.random.default_rng(0).permutation(len(y)), np.stack([y] * len(ridges))
    for part in (order[k::PARTS] for k in range(min(PARTS, len(y)))):
        A, b = (of.sum(axis=0) - of[part].sum(axis=0) for of in (gram, side))
        unit = trace(A)[..., None, None]
        c = solve(A + (ridges**2 * unit + TINY) * np.eye(len(A[0])), b)
        found[:, part] -= rows[part] @ c[:, None]
    return np.asarray(min(found, key=lambda rest: (rest**2).sum()).reshape(left.shape))
