"""The LPS operator on lattices of any spacing, and on points that are none."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from warp_peri.errors import InputError
from warp_peri.launch import DEVICE
from warp_peri.lps.matrices import matrices
from warp_peri.lps.model import Model
from warp_peri.lps.operator import NodeOperator
from warp_peri.points.arrays import plain
from warp_peri.points.quadrature import DEGREE
from warp_peri.points.samples import PointsLike, nodes_of
from warp_peri.transfer.cache import model_for


class LPSOperator(NodeOperator):
    """The operator of a model's material on points of any kind (theory, M2–M5).

    ``op(u)`` is L u [TPa/Å] of the model there, on interior nodes; in equilibrium it is b. On
    scattered points each family has weights of its own, of which nothing is proven: they ask for
    allow_uncertified.

    Args:
        model: certified on some lattice; on others it is transferred, which is said once.
        points: a lattice or scattered points.
        quadrature_degree: of the polynomials that the weights are exact for.
        transfer: False refuses what the model itself is not certified on.
        allow_uncertified: the model's own numbers, with a warning.
        device: where the kernels run, as for Bonds.

    Attributes:
        home: the model that was given.
        points: the nodes that were given.
        model: the one that is used.
        bonds: of the nodes.

    Raises InputError for a point set that does not carry the horizon, an uncertified spacing
    without a transfer, and scattered points without allow_uncertified.
    """

    def __init__(
        self,
        model: Model,
        points: PointsLike,
        *,
        quadrature_degree: int = DEGREE,
        transfer: bool = True,
        allow_uncertified: bool = False,
        device: str = DEVICE,
    ) -> None:
        self.home = model
        model.check_dimension(points)
        super().__init__(
            model_for(model, points, transfer=transfer, allow_uncertified=allow_uncertified),
            points,
            quadrature_degree=quadrature_degree,
            allow_uncertified=allow_uncertified,
            device=device,
        )
        self.points = nodes_of(points)

    def matrix(self) -> sp.csr_array:
        """L as a sparse matrix of all nodes' displacements, shape [d I, d N]."""
        found = matrices(self.model, self.points, quadrature_degree=self.quadrature_degree)
        return found.operator(self.model.lam, self.model.mu)

    def load(self, b: np.ndarray) -> np.ndarray:
        """What the operator equals in equilibrium with b [TPa/Å], on the interior nodes.

        Raises InputError for another shape than [N, d] or [S, N, d].
        """
        b, (nodes, d) = plain("b", b), self.points.x.shape
        if b.ndim not in (2, 3) or b.shape[-2:] != (nodes, d):
            raise InputError(
                f"b: expected shape [S, {nodes}, {d}] or [{nodes}, {d}], got {list(b.shape)}"
            )
        return b[..., self.points.interior, :]
