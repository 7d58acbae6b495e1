"""Elements that an outline cuts (theory.md, D23)."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np

from warp_peri.dressed.bases import gauss_shapes
from warp_peri.errors import InputError

FINE = {2: 20, 3: 8}
"""Positions along an axis of an element that are asked whether they lie inside."""
LEAST = 0.02
"""Share of an element below which it is left out."""


def cut_elements(
    x: np.ndarray, axes: np.ndarray, spacing: float, inside: Callable[[np.ndarray], np.ndarray]
) -> np.ndarray:
    """W, ∫ N_g N_g' over the part of each element inside a body, [N, 2^d, 2^d].

    Args:
        x: first corners of the elements, [N, d].
        axes: of the nodes, as columns.
        spacing: h.
        inside: which positions [n, d] lie in the body, [n] bool.

    Raises InputError for a function that says anything else.
    """
    d = len(axes)
    line = (np.arange(FINE[d]) + 0.5) / FINE[d]
    fine = np.array(list(itertools.product(line, repeat=d)))
    shapes = gauss_shapes(fine)
    square = np.einsum("ng,nf->ngf", shapes, shapes).reshape(len(shapes), -1) / len(shapes)
    gram = np.zeros((len(x), 2**d, 2**d))
    for part in np.array_split(np.arange(len(x)), len(x) // 1000 + 1):
        at = x[part, None] + spacing * fine @ axes.T
        said = np.asarray(inside(at.reshape(-1, d)), dtype=bool)
        if said.shape != (at.size // d,):
            raise InputError(f"edges: expected one bool a position, got {list(said.shape)}")
        share = said.reshape(len(part), -1)
        held = np.where(share.mean(axis=1, keepdims=True) < LEAST, 0.0, share)
        gram[part] = (held @ square).reshape(len(part), 2**d, 2**d)
        gram[part[share.all(axis=1)]] = np.eye(2**d) / 2**d
    return gram
