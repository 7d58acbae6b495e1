"""A third-order crystal learned by one least squares (theory, N28–N29)."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.optimize import root

from warp_peri.core.elastic import allowed_tensors, from_voigt, turned
from warp_peri.core.grid import grid_of
from warp_peri.core.groups import Symmetry, checked_orientation, point_group, shared_with_nodes
from warp_peri.core.stencil import Basis, invariant_basis
from warp_peri.errors import InputError
from warp_peri.launch import floats
from warp_peri.micromodulus import regression
from warp_peri.micromodulus.regression import Learned
from warp_peri.micromodulus.waves import law_of, solved
from warp_peri.points.families import bond_classes
from warp_peri.points.lattice import lattice_steps
from warp_peri.points.samples import Samples, axis_of
from warp_peri.regression.search import compressed
from warp_peri.third_order.material import ThirdOrderCrystal
from warp_peri.third_order.smoothing import Smoothing, gradient_weights
from warp_peri.third_order.sweeps import GradientSweeps, Numbers

SETTLED = 1e-9
"""Relative, of moduli that are found."""
CONSTANTS = 3
"""Columns of t3, tq2 and q3, the first ones."""
REACH, MODES = 2, 2
"""Spacings that gradients of long waves reach over, and half waves of the fields that see them."""


class NonlinearFeatures:
    """What t3, tq2, q3, λ and μ of Ψ do to L u, each at 1, on one lattice.

    Args:
        points: the lattice, which states the axis of the crystal.
        horizon: δ [Å].
        weights: p_in and p_out by class, each of shape [C].
    """

    def __init__(
        self, points: Samples, horizon: float, weights: tuple[np.ndarray, np.ndarray]
    ) -> None:
        self.sweeps = GradientSweeps(points, horizon, dilates=False)
        none = np.zeros_like(weights[0])
        by_class = torch.from_numpy(2 * np.stack([none, none, *weights]))
        self.tables = self.sweeps.by_pair(by_class).numpy()
        turned = np.exp(-6j * axis_of(points))
        self.numbers = np.zeros((5, 6))
        self.numbers[[0, 1, 3, 4], [2, 3, 0, 1]] = 1.0
        self.numbers[2, 4:] = turned.real, turned.imag

    def __call__(self, u: np.ndarray) -> np.ndarray:
        """Columns of u [Å], shape [S, N, 2], in the order above: shape [S, I, 5, 2]."""
        sweeps = self.sweeps
        field = floats(np.ascontiguousarray(u), sweeps.kernels.vec)
        columns = []
        for numbers in self.numbers:
            columns.append(sweeps.force(field, Numbers(self.tables, 0.0, numbers)).numpy())
        return np.stack(columns, axis=2)


def long_wave_equations(samples: Samples) -> tuple[np.ndarray, np.ndarray]:
    """What long waves say of λ, μ and, beside them, t3, tq2 and q3 (theory, 28a).

    An axis that is not stated is taken along x: λ and μ hardly feel it.

    Returns rows [n, 5] and right sides [n]. Raises InputError for samples that do not carry twice
    the REACH, or see no long waves.
    """
    if samples.points.axis is None:
        samples = replace(samples, points=replace(samples.points, axis=0.0))
    reach = REACH * samples.spacing
    classes = bond_classes(samples.spacing, reach)
    own = classes.weight / classes.r
    own /= (classes.count * classes.r**2) @ own
    one = np.eye(2)
    lame = np.einsum("ij,kl->ijkl", one, one), np.einsum("ik,jl->ijkl", one, one)
    allowed = np.stack([lame[0], lame[1] + lame[1].transpose(0, 1, 3, 2)])
    values, kept, moments = regression.long_wave_rows(samples, allowed, MODES)
    extra = NonlinearFeatures(samples, reach, (own, own))(samples.u)
    axes = lattice_steps(samples.points)[1]
    place = (np.cumsum(samples.interior) - 1)[kept]
    seen = np.einsum("vn,snam,mk->svka", values, extra[:, place], axes, optimize=True)
    y = np.einsum("vn,snk->svk", values, (samples.loads @ axes)[:, kept], optimize=True)
    R = np.concatenate([moments + seen[..., CONSTANTS:], seen[..., :CONSTANTS]], axis=-1)
    return R.reshape(-1, R.shape[-1]), y.ravel()


@dataclass(frozen=True)
class ThirdOrderFit:
    """A learned third-order crystal and how it was learned.

    Attributes:
        material: the law, with its certificate and its guarantee.
        E_res_train: mean relative residual on the training samples.
        largest_gradient: largest |H| of the training samples within reach of the interior.
        seconds: it took.
    """

    material: ThirdOrderCrystal
    E_res_train: float
    largest_gradient: float
    seconds: float


def fit_third_order(
    samples: Samples,
    horizon: float,
    smoothing: Smoothing,
    *,
    form: str = "filtered",
    symmetry: Symmetry = "isotropic",
    orientation: object = None,
    moduli: object = "long waves",
) -> ThirdOrderFit:
    """The tensors and the constants t3, tq2, q3 that fit L u = b on the interior nodes best.

    The residual is linear in all of them; each sample is weighed by 1/‖b‖.

    Args:
        samples: displacements and loads on lattice nodes, whose points state the crystal's axis.
        horizon: length of the longest bond of tensors and gradient.
        smoothing: of the data.
        form: "filtered" or "energy".
        symmetry, orientation: of the tensors, as for learning.fit; long waves must be isotropic.
        moduli: "long waves" holds those with which no long wave is left of the loads (N29), a Voigt
            matrix holds its own.

    Raises InputError for samples that do not carry twice the horizon, do not determine the law, or
    have no load.
    """
    begin = time.perf_counter()
    axes = grid_of(
        samples.points, invariant_basis(horizon / samples.spacing, np.eye(2)[None]).steps
    ).axes
    turn = np.eye(2) if orientation is None else axes.T @ checked_orientation(orientation, 2)
    group = point_group(symmetry, 2)
    shared = shared_with_nodes(group, turn)
    bonds = invariant_basis(horizon / samples.spacing, shared)
    weights = gradient_weights(smoothing, form, bond_classes(samples.spacing, horizon))
    extra = NonlinearFeatures(samples, horizon, weights)(samples.u).transpose(0, 1, 3, 2)
    extra = np.einsum("siam,ak->sikm", extra, axes)
    misfit = None
    if isinstance(moduli, str):
        allowed = allowed_tensors(symmetry, group, turn)
        rows = _rows(samples, bonds, extra, *regression.long_wave_rows(samples, allowed, 0)[:2])
        tensor, misfit = _found_moduli(samples, bonds, shared, rows, allowed)
    else:
        rows = _rows(samples, bonds, extra, np.zeros((0, 0)), np.zeros(0, int))
        tensor = turned(from_voigt(np.asarray(moduli, float)), turn)
    learned, numbers = _at(rows, bonds, shared, tensor, samples.spacing)
    t3, tq2, q3 = numbers[:CONSTANTS]
    record = {
        "from": "fields",
        "loss": learned.loss,
        "long_wave_misfit": misfit,
        "cuts": learned.cuts,
        "numbers": len(bonds.basis) + CONSTANTS,
    }
    linear = law_of(learned, bonds, samples.spacing, samples.points.units, symmetry, turn, {})
    law = ThirdOrderCrystal(
        linear, t3, tq2, q3, smoothing, form, float(horizon), provenance={"fit": record}
    )
    law = law.certified()
    operator = law.on(samples.points, allow_uncertified=True)
    b = samples.loads[:, samples.interior]
    wrong = np.linalg.norm((operator(samples.u) - b).reshape(len(b), -1), axis=1)
    error = float((wrong / np.linalg.norm(b.reshape(len(b), -1), axis=1)).mean())
    largest = float(operator.largest_gradient(samples.u).max())
    return ThirdOrderFit(law, error, largest, time.perf_counter() - begin)


@dataclass(frozen=True)
class _Rows:
    """Columns of the constants, of the basis tensors, of λ and of μ in Ψ, and their right side.

    Attributes:
        R, y: triangular, so that below the constants' own rows stands the loss at their best (N28).
        long, load: the same against the longest test field, [S, V, d, …] (N29).
        weight: 1/‖b‖ of each sample, [S, 1, 1, 1].
    """

    R: np.ndarray
    y: np.ndarray
    long: np.ndarray
    load: np.ndarray
    weight: np.ndarray


def _lame(tensor: np.ndarray) -> np.ndarray:
    return np.array([tensor[0, 0, 1, 1], tensor[0, 1, 0, 1]])


def _at(
    rows: _Rows, bonds: Basis, shared: np.ndarray, tensor: np.ndarray, spacing: float
) -> tuple[Learned, np.ndarray]:
    """The fit with some moduli, and the numbers that belong to all columns."""
    known = _lame(tensor)  # those of the geometric terms are those of the tensors
    y = rows.y - rows.R[:, -2:] @ known
    below = slice(CONSTANTS, -2)
    learned = solved(rows.R[CONSTANTS:, below], y[CONSTANTS:], bonds, shared, tensor, spacing)
    p = learned.p / spacing**2
    top = rows.R[:CONSTANTS]
    best = np.linalg.solve(top[:, :CONSTANTS], y[:CONSTANTS] - top[:, below] @ p)
    return learned, np.concatenate([best, p, known])


def _found_moduli(
    samples: Samples, bonds: Basis, shared: np.ndarray, rows: _Rows, allowed: np.ndarray
) -> tuple[np.ndarray, float]:
    """The moduli with which what the law leaves of the loads has no long waves (N29)."""
    moments = regression.long_wave_rows(samples, allowed, 0)[2] * rows.weight
    own = rows.long[..., -2:] @ np.array([_lame(C) for C in allowed]).T
    R = np.concatenate([moments + own, rows.long[..., :CONSTANTS]], axis=-1)

    def left(c: np.ndarray) -> np.ndarray:
        tensor = np.tensordot(c, allowed, 1)
        numbers = _at(rows, bonds, shared, tensor, samples.spacing)[1]
        return np.asarray(rows.load - rows.long @ numbers)

    def change(c: np.ndarray) -> np.ndarray:
        return regression.moduli_of(R, left(c))[0][: len(c)]

    guess = regression.long_wave_moduli(samples, allowed)[0]
    start = np.linalg.lstsq(allowed.reshape(len(allowed), -1).T, guess.ravel())[0]
    c = root(change, start, tol=SETTLED).x
    misfit = np.linalg.norm(left(c)) / np.linalg.norm(rows.load)
    return np.tensordot(c, allowed, 1), float(misfit)


def _rows(
    samples: Samples, bonds: Basis, extra: np.ndarray, values: np.ndarray, kept: np.ndarray
) -> _Rows:
    """Each sample over its load; test fields, shape [V, n], on nodes by number."""
    nodes = grid_of(samples.points, bonds.steps)
    b = samples.loads[:, samples.interior] @ nodes.axes
    size = np.linalg.norm(b.reshape(len(b), -1), axis=1)
    if not (size > 0).all():
        raise InputError(f"b: expected loads, got none on sample {int(np.argmin(size))}")
    count = bonds.basis.shape[0] + extra.shape[-1]
    step = max(1, regression.CHUNK // (count * b[0].size))
    place = (np.cumsum(samples.interior) - 1)[kept]
    R, y, long, load = np.zeros((0, count)), np.zeros(0), [], []
    for first in range(0, len(b), step):
        some = slice(first, first + step)
        tensors = regression._features(samples.u[some], nodes, bonds)
        parts = [extra[some, ..., :CONSTANTS], tensors, extra[some, ..., CONSTANTS:]]
        columns = np.concatenate(parts, axis=-1) / size[some, None, None, None]
        right = b[some] / size[some, None, None]
        long.append(np.einsum("vn,snka->svka", values, columns[:, place], optimize=True))
        load.append(np.einsum("vn,snk->svk", values, right[:, place], optimize=True))
        R, y = compressed(
            np.concatenate([R, columns.reshape(-1, count)]), np.append(y, right.ravel())
        )
    if len(R) < count:
        raise InputError(f"data: expected enough to tell {count} numbers apart; give more loads")
    weight = (1 / size)[:, None, None, None]
    return _Rows(R, y, np.concatenate(long), np.concatenate(load), weight)
