"""Waves on a uniformly strained hyperelastic lattice: which of them lower the energy.

In uniform strain the tangent is one stencil for all nodes, (H20), and linear in the coefficients.
Its symbol over that of the five-point Laplacian, the same for long waves as the acoustic tensor
over |k|², says for a wave whether the lattice is stable against it. Waves are read on a grid: what
is found is a sample, no proof for those between.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from warp_peri.errors import InputError
from warp_peri.points.points import Points
from warp_peri.points.samples import Samples
from warp_peri.tissue.operator import HyperelasticOperator
from warp_peri.tissue.solid import Dictionary, HyperelasticSolid

WAVES = 8
"""Wave numbers along each half axis of the zone."""
STEP = 1e-6
"""Of the differences that make the stencil [spacing]."""
AT_REST = 1 - 1e-5
"""Stretch that stands for rest: fibres are just slack there, which is the softer side."""


@dataclass(frozen=True, eq=False)
class UniformTangents:
    """Stencils of every energy in some uniform strains.

    Attributes:
        stencils: force on every offset, by direction, when the centre moves along another, for
            every energy with coefficient one [1/length²], shape [F, R, 2, 2, K].
        waves: cosines of every wave at every offset over the Laplacian's symbol, shape [Q, R].
    """

    stencils: np.ndarray
    waves: np.ndarray

    @classmethod
    def of(cls, dictionary: Dictionary, spacing: float, strains: np.ndarray) -> UniformTangents:
        """Stencils in strains, given as deformation gradients of shape [F, 2, 2].

        Raises InputError for arrays of another shape or without strains, gradients that are not
        finite or of no positive determinant, and strains in which an energy is no number.
        """
        if np.ndim(strains) != 3 or np.shape(strains)[1:] != (2, 2) or not len(strains):
            raise InputError(
                f"strains: expected shape [F, 2, 2] with F > 0, got {list(np.shape(strains))}"
            )
        if not np.isfinite(strains).all():
            raise InputError("strains: expected finite numbers")
        if not (np.linalg.det(strains) > 0).all():
            raise InputError("strains: expected determinants > 0")
        reach = int(dictionary.reach)
        inner = max(2 * reach, 5)  # two bonds, or three short ones of which one may be of two steps
        side = np.arange(-inner - 2 * reach, inner + 2 * reach + 1)
        steps = np.stack(np.meshgrid(side, side, indexing="ij"), axis=-1).reshape(-1, 2)
        inside: np.ndarray = np.abs(steps).max(axis=1) <= inner
        op = HyperelasticOperator(dictionary, Points(spacing * steps, inside, spacing))
        centre = np.flatnonzero((steps == 0).all(axis=1))[0]
        size = STEP * spacing
        stencils = []
        for F in strains:
            u = op.points.x @ (F - np.eye(2)).T
            columns = []
            for axis in range(2):
                ends = []
                for sign in (1, -1):
                    moved = u.copy()
                    moved[centre, axis] += sign * size
                    ends.append(op.features(moved))
                columns.append((ends[0] - ends[1]) / (2 * size))
            stencils.append(np.stack(columns, axis=-2))
            if not np.isfinite(stencils[-1]).all():
                raise InputError(f"strains: expected energies that are numbers at F = {F.tolist()}")
        k = zone(WAVES)
        laplace = (4 * np.sin(k / 2) ** 2).sum(axis=1) / spacing**2
        return cls(np.array(stencils), np.cos(k @ steps[inside].T) / laplace[:, None])

    def lowest(self, c: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Smaller eigenvalue of the symbol over the Laplacian's, and its direction.

        Returns:
            Ratios [stress], shape [F, Q], and unit vectors, shape [F, Q, 2].
        """
        tangent = np.einsum("frabk,k->frab", self.stencils, c)
        symbol = np.einsum("qr,frab->fqab", self.waves, tangent, optimize=True)
        values, vectors = np.linalg.eigh((symbol + symbol.swapaxes(2, 3)) / 2)
        least: np.ndarray = values[..., 0]
        return least, vectors[..., 0]

    def row(self, strain: int, wave: int, direction: np.ndarray) -> np.ndarray:
        """The ratio of one wave for every energy with coefficient one, shape [K]."""
        whole: np.ndarray = np.einsum(
            "r,rabk,a,b->k", self.waves[wave], self.stencils[strain], direction, direction
        )
        return whole


def zone(count: int) -> np.ndarray:
    """Wave vectors of half a Brillouin zone, without zero, times the spacing, shape [Q, 2]."""
    line = np.linspace(-np.pi, np.pi, 2 * count + 1)
    k = np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1).reshape(-1, 2)
    half: np.ndarray = (k[:, 0] > 1e-9) | ((np.abs(k[:, 0]) <= 1e-9) & (k[:, 1] > 1e-9))
    vectors: np.ndarray = k[half]
    return vectors


def strains_of(op: HyperelasticOperator, samples: Samples, count: int) -> np.ndarray:
    """Strains that the samples hold, as far apart as `count` can be, and rest.

    Logarithmic strains of all nodes with a whole family; each is the one furthest from those
    before it, beginning at rest. For rest stands a stretch of AT_REST: at the kink of a fibre's
    energy a tangent by differences is half as stiff as a taut fibre's, and a slack one has none.

    Returns:
        Stretch tensors U, F = R U, shape [count + 1, 2, 2]; fewer where fewer nodes have a strain.
    """
    E = op.strain(samples.u)[:, op.bonds.whole % 2 == 1].reshape(-1, 3)
    C = np.stack([1 + 2 * E[:, 0], E[:, 2], E[:, 2], 1 + 2 * E[:, 1]], axis=1).reshape(-1, 2, 2)
    squares, axes = np.linalg.eigh(C)
    kept = squares[:, 0] > 0
    squares, axes = squares[kept], axes[kept]
    logs = np.einsum("nij,nj,nkj->nik", axes, 0.5 * np.log(squares), axes).reshape(-1, 4)
    far = (logs**2).sum(axis=1)
    chosen = []
    for _ in range(min(count, len(far))):
        chosen.append(int(np.argmax(far)))
        far = np.minimum(far, ((logs - logs[chosen[-1]]) ** 2).sum(axis=1))
    U = np.einsum("nij,nj,nkj->nik", axes[chosen], np.sqrt(squares[chosen]), axes[chosen])
    return np.concatenate([AT_REST * np.eye(2)[None], U])


def shortest_margin(solid: HyperelasticSolid, strains: np.ndarray) -> np.ndarray:
    """Least ratio [stress] over the grid of waves in each strain, shape [F].

    Negative where one of these waves grows; those between are not looked at.

    Args:
        solid: of the lattice it was learned on.
        strains: deformation gradients, shape [F, 2, 2].

    Raises InputError as UniformTangents.of.
    """
    tangents = UniformTangents.of(solid.dictionary, solid.spacing, strains)
    least: np.ndarray = tangents.lowest(solid.coefficients)[0].min(axis=1)
    return least
