"""A third-order crystal learned by one least squares (theory.md, N28–N29)."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from warp_peri.errors import InputError
from warp_peri.losses.nonlinear import CONSTANTS, NonlinearFeatures
from warp_peri.micromodulus import fields
from warp_peri.micromodulus.elastic import allowed_tensors, from_voigt, turned
from warp_peri.micromodulus.family import Family, family
from warp_peri.micromodulus.groups import (
    Symmetry,
    checked_orientation,
    point_group,
    shared_with_nodes,
)
from warp_peri.micromodulus.learning import _law, _solve
from warp_peri.micromodulus.nodes import lay_out
from warp_peri.micromodulus.regression import compressed
from warp_peri.micromodulus.third_order import ThirdOrderCrystal, gradient_weights
from warp_peri.micromodulus.third_order_operator import PlacedCrystal
from warp_peri.micromodulus.third_order_proof import proven_crystal
from warp_peri.models.smoothing import Smoothing
from warp_peri.points.families import bond_classes
from warp_peri.points.samples import Samples


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
        moduli: "long waves" holds those found with the nonlinear terms beside them (N29), a Voigt
            matrix holds its own.

    Raises InputError for samples that do not carry twice the horizon, do not determine the law, or
    have no load.
    """
    begin = time.perf_counter()
    axes = lay_out(samples.points, family(horizon / samples.spacing, np.eye(2)[None]).steps).axes
    turn = np.eye(2) if orientation is None else axes.T @ checked_orientation(orientation, 2)
    group = point_group(symmetry, 2)
    shared = shared_with_nodes(group, turn)
    bonds = family(horizon / samples.spacing, shared)
    weights = gradient_weights(smoothing, form, bond_classes(samples.spacing, horizon))
    extra = NonlinearFeatures(samples, horizon, weights)(samples.u).transpose(0, 1, 3, 2)
    extra = np.einsum("siam,ak->sikm", extra, axes)
    allowed, misfit = allowed_tensors(symmetry, group, turn), None
    if isinstance(moduli, str):
        # λ and μ of the geometric terms are those of the tensors
        beside = np.stack([_geometric(extra, C) for C in allowed], axis=-1)
        beside = np.concatenate([beside, extra[..., :CONSTANTS]], axis=-1)
        tensor, misfit = fields.long_wave_moduli(samples, allowed, beside)
    else:
        tensor = turned(from_voigt(np.asarray(moduli, float)), turn)
    R, y = _rows(samples, bonds, extra[..., :CONSTANTS], _geometric(extra, tensor))
    below, right = R[CONSTANTS:, CONSTANTS:], y[CONSTANTS:]
    learned = _solve(below, right, bonds, shared, tensor, samples.spacing)
    left = y[:CONSTANTS] - R[:CONSTANTS, CONSTANTS:] @ (learned.p / samples.spacing**2)
    t3, tq2, q3 = np.linalg.solve(R[:CONSTANTS, :CONSTANTS], left)
    record = {
        "from": "fields",
        "loss": learned.loss,
        "long_wave_misfit": misfit,
        "cuts": learned.cuts,
        "numbers": len(bonds.basis) + CONSTANTS,
    }
    linear = _law(learned, bonds, samples.spacing, samples.points.units, symmetry, turn, {})
    law = ThirdOrderCrystal(
        linear, t3, tq2, q3, smoothing, form, float(horizon), provenance={"fit": record}
    )
    law = proven_crystal(law)
    operator = PlacedCrystal(law, samples.points, allow_uncertified=True)
    b = samples.loads[:, samples.interior]
    wrong = np.linalg.norm((operator(samples.u) - b).reshape(len(b), -1), axis=1)
    error = float((wrong / np.linalg.norm(b.reshape(len(b), -1), axis=1)).mean())
    largest = float(operator.largest_gradient(samples.u).max())
    return ThirdOrderFit(law, error, largest, time.perf_counter() - begin)


def _geometric(extra: np.ndarray, tensor: np.ndarray) -> np.ndarray:
    """The force that λ and μ of a tensor have in Ψ, shape [S, I, 2]."""
    force: np.ndarray = extra[..., 3:] @ [tensor[0, 0, 1, 1], tensor[0, 1, 0, 1]]
    return force


def _rows(
    samples: Samples, bonds: Family, constants: np.ndarray, known: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Triangular rows of the constants' columns, then the basis tensors', and the right-hand side.

    Below the constants' own rows stands the loss at their best (N28).
    """
    nodes = lay_out(samples.points, bonds.steps)
    b = samples.loads[:, samples.interior] @ nodes.axes
    size = np.linalg.norm(b.reshape(len(b), -1), axis=1)
    if not (size > 0).all():
        raise InputError(f"b: expected loads, got none on sample {int(np.argmin(size))}")
    count = bonds.basis.shape[0] + constants.shape[-1]
    step = max(1, fields.CHUNK // (count * b[0].size))
    R, y = np.zeros((0, count)), np.zeros(0)
    for first in range(0, len(b), step):
        some = slice(first, first + step)
        tensors = fields._features(samples.u[some], nodes, bonds)
        columns = np.concatenate([constants[some], tensors], axis=-1)
        columns = columns / size[some, None, None, None]
        right = (b[some] - known[some]) / size[some, None, None]
        R, y = compressed(
            np.concatenate([R, columns.reshape(-1, count)]), np.append(y, right.ravel())
        )
    if len(R) < count:
        raise InputError(f"data: expected enough to tell {count} numbers apart; give more loads")
    return R, y
