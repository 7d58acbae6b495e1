"""The stencil of multilinear elements for an elastic tensor: a local rival, and coarse grids."""

from __future__ import annotations

import itertools

import numpy as np


def q1_tensors(elastic: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Steps [H, d] of one half and C(ξ) h² [stress], [H, d, d], of Q1 elements of C_ijkl.

    Two Gauss points an axis, squares or cubes of side h; C(ξ) = C(−ξ) is symmetric since an element
    is its own image in its middle.
    """
    d = elastic.shape[0]
    corner = np.array(list(itertools.product((0, 1), repeat=d)))
    side = 2 * corner - 1
    stiffness = np.zeros((len(corner), d, len(corner), d))
    for point in itertools.product((-(3**-0.5), 3**-0.5), repeat=d):
        factor = (1 + side * point) / 2
        slope = np.stack(
            [side[:, a] * np.prod(np.delete(factor, a, axis=1), axis=1) for a in range(d)], axis=1
        )  # per side length, at one of 2^d points of weight 2^−d
        stiffness += np.einsum("pj,qn,ijmn->piqm", slope, slope, elastic, optimize=True) / 2**d
    found: dict[tuple[int, ...], np.ndarray] = {}
    for a, b in itertools.product(range(len(corner)), repeat=2):
        step = tuple((corner[b] - corner[a]).tolist())
        if step > (0,) * d:
            found[step] = found.get(step, np.zeros((d, d))) - stiffness[a, :, b, :]
    steps = np.array(list(found))
    tensors = np.array(list(found.values()))
    return steps, (tensors + tensors.transpose(0, 2, 1)) / 2
