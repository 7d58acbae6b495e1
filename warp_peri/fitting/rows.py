"""Rows of a basis: ‖R p − y‖² = Σ ‖L u − b‖² over all samples, in as few rows as that takes."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import scipy.linalg

from warp_peri.core.grid import Grid, grid_of
from warp_peri.core.stencil import Basis
from warp_peri.points.points import Samples

BLOCK = 2**22
"""Numbers of a block of rows before it is compressed."""


def rows(
    samples: Samples,
    bonds: Basis,
    *,
    weight: np.ndarray | None = None,
    extra: np.ndarray | None = None,
    least: int | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """R [n, P + E] and y [n] of numbers p = C h² [stress] on a basis, then of extra columns.

    Args:
        samples: displacements and loads on lattice nodes, along whose axes the basis is.
        bonds: the family.
        weight: of each sample, shape [S].
        extra: forces of other numbers that a law is linear in, along the axes, [S, I, d, E].
        least: as of grid_of.

    Raises InputError as grid_of does, and for samples without loads.
    """
    R, y = np.zeros((0, 0)), np.zeros(0)
    for some, F, b in swept(samples, bonds, extra, least):
        if weight is not None:
            F *= weight[some, None, None, None]
            b *= weight[some, None, None]
        flat = F.reshape(-1, F.shape[-1])
        flat = np.concatenate([R, flat]) if len(R) else flat
        R, y = compressed(flat, np.append(y, b.ravel()))
    return R, y


def swept(
    samples: Samples, bonds: Basis, extra: np.ndarray | None = None, least: int | None = None
) -> Iterator[tuple[slice, np.ndarray, np.ndarray]]:
    """By blocks of samples: which, the columns at the interior nodes [S, I, d, P + E], the loads.

    Both along the lattice's axes; arguments and errors as of rows.
    """
    nodes = grid_of(samples.points, bonds.steps, least=least)
    b = samples.loads[:, samples.interior] @ nodes.axes
    count = len(bonds.basis) + (0 if extra is None else extra.shape[-1])
    step = max(1, BLOCK // (count * b[0].size))
    for some in (slice(first, first + step) for first in range(0, len(b), step)):
        F = forces(samples.u[some], nodes, bonds)
        F /= samples.spacing**2
        yield some, F if extra is None else np.concatenate([F, extra[some]], axis=-1), b[some]


def forces(u: np.ndarray, nodes: Grid, bonds: Basis) -> np.ndarray:
    """h² L u of every basis tensor at the interior nodes, along the axes, shape [S, I, d, P]."""
    planes, d = nodes.scatter(u).swapaxes(0, 1), nodes.dimension
    stride = np.cumprod((1, *nodes.wide[:0:-1]))[::-1]
    place = np.array(np.unravel_index(nodes.interior, nodes.shape)) + nodes.reach * nodes.periodic
    planes, at = planes.reshape(d, len(u), -1).transpose(2, 0, 1), stride @ place
    planes = np.ascontiguousarray(planes)
    F, inner = np.zeros((len(bonds.basis), len(at), d, len(u))), 2 * planes[at]
    for step, tensors in zip(stride @ bonds.steps.T, bonds.basis.swapaxes(0, 1)):
        pulled = inner - planes[at + step] - planes[at - step]
        for a, k, j in np.argwhere(tensors):
            F[a, :, k] += tensors[a, k, j] * pulled[:, j]
    return F.transpose(3, 1, 2, 0)


def over_loads(samples: Samples) -> np.ndarray:
    """Weights 1/‖b‖ of each sample, shape [S]; one without load is left out."""
    size = load_sizes(samples)
    return np.asarray(np.divide(1, size, out=0 * size, where=size > 0))


def load_sizes(samples: Samples) -> np.ndarray:
    """‖b‖ of each sample on its interior, shape [S]."""
    return norms(samples.loads[:, samples.interior])


def norms(fields: np.ndarray) -> np.ndarray:
    """‖·‖ of each of S fields, shape [S, ...] to [S]."""
    return np.asarray(np.linalg.norm(fields.reshape(len(fields), -1), axis=1))


def compressed(R: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """As few rows with the same least squares."""
    if len(R) <= R.shape[1] + 1:
        return R, y
    factor = scipy.linalg.qr(np.column_stack([R, y]), mode="r", overwrite_a=True)[0]
    factor = factor[: R.shape[1] + 1]
    return factor[:, :-1], factor[:, -1]
