"""The LPS operator on lattices of any spacing, and on points that are none."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import scipy.sparse as sp
import torch
from numpy.typing import ArrayLike

from warp_peri.core.tensors import linear
from warp_peri.errors import InputError
from warp_peri.launch import DEVICE
from warp_peri.lps.matrices import matrices
from warp_peri.lps.model import Model
from warp_peri.lps.operator import NodeOperator
from warp_peri.points.arrays import plain
from warp_peri.points.quadrature import DEGREE
from warp_peri.points.samples import PointsLike, nodes_of
from warp_peri.transfer.cache import model_for
from warp_peri.transfer.carrier import Carrier


class LPSOperator(NodeOperator):
    """The operator of a model's material on points of any kind (theory, M2–M7).

    On a lattice ``op(u)`` is L u [TPa/Å] of the model there, on interior nodes; in equilibrium it
    is b. On scattered points it is Tᵗ L T u, symmetric and definite, and in equilibrium Tᵗ b: a
    node's share of the load around it, not b at the node. ``op.load(b)`` is what ``op(u)`` equals
    in equilibrium on both. Weights of each scattered family on its own, through Warp's tape, are
    what allow_uncertified gives there: nothing is proven of them.

    Args:
        model: certified on some lattice; on others it is transferred, which is said once. One that
            is certified nowhere is proven there and then for scattered points.
        points: a lattice or scattered points, which a lattice of half their spacing carries.
        quadrature_degree: of the polynomials that the weights are exact for.
        transfer: False refuses what the model itself is not certified on.
        allow_uncertified: the model's own numbers, with a warning.
        device: where the kernels run, as for Bonds.
        carrier: T of these points, through which the model is taken as it is.

    Attributes:
        home: the model that was given.
        points: the nodes that were given.
        model: the one that is used.
        bonds: of the lattice that L is taken on.
        carrier: T; None on a lattice.

    Raises InputError for a point set that does not carry the horizon (on scattered points as
    Carrier does), or an uncertified spacing without a transfer.
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
        carrier: Carrier | None = None,
    ) -> None:
        self.carrier = carrier
        self.home, nodes = model, nodes_of(points)
        model.check_dimension(points)
        if carrier is not None or (points.spacing == 0 and transfer and not allow_uncertified):
            self.carrier = carrier or Carrier(model, points)
            here, points = model if carrier else self.carrier.model, self.carrier.lattice
        else:
            here = model_for(model, points, transfer=transfer, allow_uncertified=allow_uncertified)
        super().__init__(
            here,
            points,
            quadrature_degree=quadrature_degree,
            allow_uncertified=allow_uncertified,
            device=device,
        )
        self.points = nodes

    def force(self, u: ArrayLike) -> np.ndarray:
        """L u, or Tᵗ L T u, on the interior nodes, shape [..., I, d]; InputError as `op(u)`."""
        if self.carrier is None:
            return super().force(u)
        u = plain("u", u)
        self.check(u)
        return _applied(self.carrier.unknown.T, super().force(_applied(self.carrier.T, u)))

    def product_transpose(self, u: Any, w: ArrayLike) -> np.ndarray:
        """Lᵗ w on all nodes, shape [..., N, d], of w on the interior [..., I, d], whatever u."""
        if self.carrier is None:
            return super().product_transpose(u, w)
        on_lattice = super().product_transpose(u, _applied(self.carrier.unknown, plain("w", w)))
        return _applied(self.carrier.T.T, on_lattice)

    def force_with(self, u: torch.Tensor, numbers: dict[str, torch.Tensor]) -> torch.Tensor:
        """The force of fields [S, N, d] with other numbers, differentiable once in all."""
        if self.carrier is None:
            return super().force_with(u, numbers)

        def through(matrix: sp.csr_array, x: torch.Tensor) -> torch.Tensor:
            return linear(x, partial(_applied, matrix), partial(_applied, matrix.T))

        force = super().force_with(through(self.carrier.T, u), numbers)
        return through(self.carrier.unknown.T, force)

    def matrix(self) -> sp.csr_array:
        """L as a sparse matrix of all nodes' displacements, shape [d I, d N], on a lattice."""
        found = matrices(self.model, self.points, quadrature_degree=self.quadrature_degree)
        return found.operator(self.model.lam, self.model.mu)

    def load_transpose(self, w: ArrayLike) -> np.ndarray:
        """`load` transposed, of w on the interior [..., I, d], on all nodes [..., N, d]."""
        if self.carrier is None:
            return self.on_all(w)
        return self.carrier.load_transpose(np.asarray(w))

    def load(self, b: np.ndarray) -> np.ndarray:
        """What the operator equals in equilibrium with b [TPa/Å], on the interior nodes.

        Args:
            b: at the nodes, shape [N, d] or [S, N, d]; on scattered points also at the places of
                the lattice, shape [Y, 2] or [S, Y, 2], as Carrier.load takes it.

        Raises InputError for other shapes.
        """
        b, (nodes, d) = plain("b", b), self.points.x.shape
        if self.carrier is None:
            if b.ndim not in (2, 3) or b.shape[-2:] != (nodes, d):
                raise InputError(
                    f"b: expected shape [S, {nodes}, {d}] or [{nodes}, {d}], got {list(b.shape)}"
                )
            return b[..., self.points.interior, :]
        carried = self.carrier.load(b[None] if b.ndim == 2 else b)
        return carried[0] if b.ndim == 2 else carried


def _applied(matrix: sp.csr_array, field: np.ndarray) -> np.ndarray:
    """A matrix by the nodes of fields, shape [..., N, 2] to [..., Y, 2]."""
    columns = np.moveaxis(field, -2, 0)
    product = np.asarray(matrix @ columns.reshape(len(columns), -1))
    return np.moveaxis(product.reshape(len(product), *columns.shape[1:]), 0, -2)
