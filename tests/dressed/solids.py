"""Small dressed solids that the tests of this folder share."""

import itertools

import numpy as np

import warp_peri as wp
from tests.micromodulus.crystals import cubic_tensor
from warp_peri.core.elastic import voigt
from warp_peri.core.groups import point_group
from warp_peri.core.stencil import invariant_basis
from warp_peri.dressed.law import DressedSolid

SPACING = 1.3
ISOTROPIC = {"C11": 1.25, "C12": -0.2, "C44": 0.725}
NAMES = {2: "4mm", 3: "m-3m"}


def solid(d=2, base="elements", reach=2**0.5, size=0.03, split=False, seed=0, dilatation=1 / 8):
    """Of given moduli, under a random G of the symmetry of the nodes."""
    rng = np.random.default_rng(seed)
    dressing = invariant_basis(reach, point_group(NAMES[d], d).astype(int))
    C = voigt(cubic_tensor(d, **ISOTROPIC) if base == "bonds" else cubic_tensor(d))
    count = 3 if split and base == "elements" else 1 + split
    q = size * rng.normal(size=(count, len(dressing.basis)))
    tensors = np.tensordot(q, dressing.basis, 1)
    return DressedSolid(
        SPACING, base, C, dressing.steps, tensors, symmetry=NAMES[d], dilatation=dilatation
    )


def nodes(d, n, kept=None, interior=None):
    """A square or cube of nodes, all interior and all there unless masks say otherwise."""
    x = SPACING * np.array(list(itertools.product(range(n), repeat=d)))
    kept = np.ones(len(x), bool) if kept is None else kept
    inside = np.ones(len(x), bool) if interior is None else interior(x)
    return wp.Points(x[kept], inside[kept], SPACING)


def rigid(points):
    """Shifts and turns of all nodes, [m, N, d]."""
    x = points.x - points.x.mean(axis=0)
    d = x.shape[1]
    found = [np.tile(row, (len(x), 1)) for row in np.eye(d)]
    for a, c in itertools.combinations(range(d), 2):
        turn = np.zeros_like(x)
        turn[:, a], turn[:, c] = x[:, c], -x[:, a]
        found.append(turn)
    return np.array(found)
