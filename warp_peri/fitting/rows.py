"""Training sets as rows of a basis: ‖R p − y‖² = Σ ‖L u − b‖² in as few rows as that takes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import scipy.linalg

from warp_peri.core.stencil import Basis, Grid, grid_of
from warp_peri.errors import InputError
from warp_peri.points.dataset import Dataset
from warp_peri.points.points import Samples
from warp_peri.points.unit_names import check_units


def listed(
    samples: Samples | Dataset | Sequence[Samples] | None,
    name: str = "samples",
    *,
    space: bool = False,
) -> list[Samples]:
    """One set, several or none as a list; of a Dataset `train`, or its only set; InputError, which
    begins with the name, for anything else, and for sets in space unless `space`."""
    if samples is None:
        return []
    if isinstance(samples, Dataset):
        samples = samples.obvious("train")
    sets = [samples] if isinstance(samples, Samples) else samples
    if not isinstance(sets, Sequence) or not all(isinstance(each, Samples) for each in sets):
        raise InputError(
            f"{name}: expected Samples (nodes with u and b), or a list of them, got "
            f"{type(samples).__name__}"
        )
    if not space and any(each.points.dimension != 2 for each in sets):
        raise InputError(f"{name}: expected a sheet; in space LPS and Crystal are learned")
    return list(sets)


def sample_weights(sets: Sequence[Samples], *, normalise: bool) -> list[np.ndarray]:
    """Weights f² / Σ f² ‖b‖² of each sample's ‖L u − b‖² in the loss, one array [S] a set; f = 1,
    or 1/‖b‖ with `normalise`. InputError for no samples or loads; normalised, for any zero load."""
    if not sets:
        raise InputError("points: expected at least one training set, got none")
    named = {" and ".join(check_units(points.points.units)) for points in sets}
    if len(named) > 1:
        raise InputError(f"units: expected the same for all sets, got {', '.join(sorted(named))}")
    factors, total = [], 0.0
    for points in sets:
        if len(points) == 0:
            raise InputError("the training set has no samples")
        load = load_sizes(points)
        if not load.any():
            raise InputError("the training set has no loads on its interior")
        if normalise and not load.all():
            raise InputError(f"sample {int(np.argmin(load))} has no load and cannot be normalised")
        factors.append(1 / load if normalise else np.ones(len(points)))
        total += float(((factors[-1] * load) ** 2).sum())
    return [factor**2 / total for factor in factors]


def check_noise(noise: Samples, points: Samples) -> None:
    """Raise InputError for noise on other nodes than its training set's."""
    if len(noise) == 0:
        raise InputError("noise: expected at least one field, got none")
    mine, its = points.points, noise.points
    if its.units != mine.units:
        raise InputError(
            f"units: expected the same for all sets, got {its.units} of noise and {mine.units}"
        )
    near = its.x.shape == mine.x.shape and np.allclose(its.x, mine.x, 0, 1e-6 * mine.spacing)
    if not (near and np.array_equal(its.interior, mine.interior)):
        raise InputError(
            f"noise: expected the {len(mine.x)} nodes of the training set, got {len(its.x)} others"
        )


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
    """Rows R [n, P + E] and y [n] for numbers p = C h² [stress] on a basis, then of extra columns.

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
    """Iterate over blocks of samples: the slice, columns at the interior nodes [S, I, d, P + E] and
    loads, along the lattice's axes; arguments and errors as of rows."""
    nodes = grid_of(samples.points, bonds.steps, least=least)
    b = samples.loads[:, samples.interior] @ nodes.axes
    count = len(bonds.basis) + (0 if extra is None else extra.shape[-1])
    step = max(1, BLOCK // (count * b[0].size))
    for some in (slice(first, first + step) for first in range(0, len(b), step)):
        F = forces(samples.u[some], nodes, bonds)
        F /= samples.spacing**2
        yield some, F if extra is None else np.concatenate([F, extra[some]], axis=-1), b[some]


def forces(u: np.ndarray, nodes: Grid, bonds: Basis) -> np.ndarray:
    """Forces h² L u of every basis tensor at the interior nodes, along the axes, [S, I, d, P]."""
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
    """Norm ‖b‖ of each sample's interior load, shape [S]."""
    return norms(samples.loads[:, samples.interior])


def norms(fields: np.ndarray) -> np.ndarray:
    """Norm of each of S fields, shape [S, ...] to [S]."""
    return np.asarray(np.linalg.norm(fields.reshape(len(fields), -1), axis=1))


def compressed(R: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compress rows R, y to as few with the same least squares."""
    if len(R) <= R.shape[1] + 1:
        return R, y
    factor = scipy.linalg.qr(np.column_stack([R, y]), mode="r", overwrite_a=True)[0]
    factor = factor[: R.shape[1] + 1]
    return factor[:, :-1], factor[:, -1]


KNOWN = 0.1
"""Directions of which a larger part of the data's squares than 1 − KNOWN is noise are left out."""


def without_noise(R: np.ndarray, y: np.ndarray, noise: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows of ‖R p − y‖² less ‖N p‖², what noise in u adds to it, as a square again (theory,
    36–37).

    Loads carry no noise, so that the difference is a quadratic form of p that has the minimum of
    ‖√(1−ν) Vᵗ R p − (1−ν)^(−½) Uᵗ y‖² and a constant. Directions of which less than KNOWN is not
    noise count nothing; p are to be the numbers of the law. No squares are subtracted, so that
    digits are kept.
    """
    left, size, right = np.linalg.svd(R, full_matrices=False)
    kept = size > np.finfo(float).eps * R.shape[1] * size[0]
    left, size, right = left[:, kept], size[kept], right[kept]
    root, axes = np.linalg.svd((noise @ right.T) / size)[1:]
    share = np.pad(root**2, (0, len(axes) - len(root)))
    along = axes @ (left.T @ y)
    known = 1 - share > KNOWN
    gain = np.sqrt(1 - share[known])
    form = gain[:, None] * (axes[known] * size) @ right
    along = along[known] / gain
    rest = np.sqrt(max(0.0, float(y @ y - along @ along)))  # a constant: no weight in the minimum
    return np.vstack([form, np.zeros(R.shape[1])]), np.append(along, rest)
