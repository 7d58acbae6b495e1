"""A third-order crystal on a lattice: force, tangent, energy, equilibria (theory.md, N22–N24)."""

from __future__ import annotations

import warnings
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
import torch
import warp as wp
from numpy.typing import ArrayLike

from warp_peri.errors import InputError
from warp_peri.kernels.nonlinear.tensors import tensor_rows
from warp_peri.launch import floats
from warp_peri.micromodulus.law import SAME_SPACING
from warp_peri.micromodulus.operator import TensorOperator
from warp_peri.micromodulus.third_order import ThirdOrderCrystal
from warp_peri.micromodulus.waves import transferred
from warp_peri.models.nonlinear import energy_density
from warp_peri.operator.gradient_sweeps import GradientSweeps
from warp_peri.operator.nonlinear import NonlinearOperator
from warp_peri.points.axis import axis_of
from warp_peri.points.families import bond_classes
from warp_peri.points.lattice import lattice_steps
from warp_peri.points.points import Points
from warp_peri.points.samples import PointsLike, nodes_of
from warp_peri.points.unit_names import check_same
from warp_peri.statics.equilibria import SOLVES
from warp_peri.statics.linear import Inverse
from warp_peri.statics.nonlinear import PlacedThirdOrder

_known: dict[tuple[object, ...], ThirdOrderCrystal] = {}


def crystal_for(model: ThirdOrderCrystal, points: PointsLike) -> ThirdOrderCrystal:
    """The law for the spacing of the points: its tensors transferred, proven anew.

    Constants, smoothing and reach belong to the material; the weights follow the lattice.
    """
    if abs(points.spacing / model.spacing - 1) <= SAME_SPACING:
        return model
    key = (model.content()["sha256"], points.spacing)
    if key not in _known:
        linear = transferred(model.linear, points.spacing)
        there = dict(vars(model)) | {"linear": linear, "proven": {}}
        _known[key] = ThirdOrderCrystal(**there).certified()
    return _known[key]


class TensorSweeps(GradientSweeps):
    """The launches of (N22) over the interior nodes of a lattice.

    Args:
        points: a lattice, all of it in the body.
        model: the law on this spacing.

    Attributes:
        tables: 0, 0, 2 p_in and 2 p_out by class of the longer of the two families, shape [4, C].

    Raises InputError as GradientSweeps does.
    """

    def __init__(self, points: Points, model: ThirdOrderCrystal) -> None:
        super().__init__(points, model.horizon)
        self.kernels = tensor_rows(wp.float64)
        axes = lattice_steps(points)[1]
        steps = np.rint(self.xi @ axes / points.spacing).astype(int)
        law = model.linear
        turned = axes @ law.tensors @ axes.T
        known = {tuple(step): C for step, C in zip(law.steps.tolist(), turned)}
        known |= {tuple(-step): known[tuple(step.tolist())] for step in law.steps}
        self._tensors = np.array([known.get(tuple(s), np.zeros((2, 2))) for s in steps.tolist()])
        self.tables = np.zeros((4, len(self.classes.r)))
        inner = bond_classes(model.spacing, model.reach)
        grid = np.rint(inner.xi / model.spacing).astype(int).tolist()
        own = {tuple(step): c for step, c in zip(grid, inner.bond_class)}
        p = 2 * np.stack(model.weights(inner))
        for step, c in zip(steps.tolist(), self.classes.bond_class):
            if tuple(step) in own:
                self.tables[2:, c] = p[:, own[tuple(step)]]

    def bonds(self, tables: np.ndarray) -> wp.array[Any]:
        """ξ, tensor and weights of one bond of each pair ±ξ, from tables by class [4, C]."""
        half = self._half
        C, p = self._tensors[half], tables[2:, self.classes.bond_class[half]].T
        values = [self.xi[half], C[:, 0], p, C[:, 1, 1:]]
        return floats(np.hstack(values), self.kernels.pair)


class PlacedCrystal(PlacedThirdOrder):
    """A third-order crystal on a lattice, its tensors transferred where need be.

    Args:
        model: the law.
        points: lattice nodes with a collar as wide as the tensors' bonds and twice the gradient's.
        transfer: False refuses spacings that are not the law's own.
        allow_uncertified: take tensors that hold no certificate, with a warning.
        radius: largest |H| that the stress sees (N10); 0 for none.

    ``op(u)`` takes and gives NumPy arrays, u [length] of shape [..., N, 2] to [..., I, 2].

    Raises InputError for scattered points, other units, nodes without that collar, and a law that
    is not certified.
    """

    def __init__(
        self,
        model: ThirdOrderCrystal,
        points: PointsLike,
        *,
        transfer: bool = True,
        allow_uncertified: bool = False,
        radius: float = 0.0,
    ) -> None:
        self.home: Any = model
        self.points = nodes_of(points)
        check_same(model.units, self.points.units)
        if not self.points.spacing > 0:
            raise InputError("points: a third-order crystal is for lattices, got scattered points")
        here = crystal_for(model, self.points) if transfer else model
        if abs(self.points.spacing / here.spacing - 1) > SAME_SPACING:
            raise InputError(
                f"spacing: the law is for {here.spacing:g}, the points have "
                f"{self.points.spacing:g}, and transfer=False"
            )
        proof = here.linear.certificate
        if proof is None or not proof.holds:
            said = "the tensors hold no certificate on this lattice"
            if not allow_uncertified:
                raise InputError(f"certificate: {said}; allow_uncertified=True takes them")
            warnings.warn(f"certificate: {said}", stacklevel=3)
        self.model: Any = here
        self.radius = float(radius)
        self.sweeps: Any = TensorSweeps(self.points, here)
        self.tables = torch.from_numpy(self.sweeps.tables)
        self.bulk = torch.zeros(1, dtype=torch.float64)
        axis = axis_of(self.points) if here.q3 else 0.0
        self.numbers = torch.from_numpy(here.numbers_at(axis))
        self._matrices = None

    @cached_property
    def straight(self) -> TensorOperator:  # type: ignore[override]
        """The tensors alone."""
        return self.model.linear.on(self.points)  # type: ignore[no-any-return]

    def __call__(self, u: np.ndarray) -> np.ndarray:  # type: ignore[override]
        """L u, minus the internal force density [stress/length], at the interior nodes."""
        if isinstance(u, torch.Tensor):
            raise InputError("u: a third-order crystal takes NumPy arrays, got a torch tensor")
        return np.asarray(NonlinearOperator.__call__(self, u))

    def tangent(self, u: ArrayLike) -> sp.csr_array:
        """∂(L u)/∂u at a field [N, 2], without clipping: sparse, shape [2 I, 2 N] (N5)."""
        return sp.csr_array(self._linear_matrix + super().tangent(u))

    def clipped(self, radius: float) -> PlacedCrystal:
        """The same with stresses of gradients clipped to a radius (N10)."""
        return PlacedCrystal(
            self.model, self.points, transfer=False, allow_uncertified=True, radius=radius
        )

    def inverse(self, loads: int) -> Inverse:
        """L⁻¹ of the tensors, of a load on the interior: factorised, or by iteration."""
        return self.straight.linear.cheapest_inverse(SOLVES * loads)

    def energy(self, u: np.ndarray) -> np.ndarray | None:
        """Of the energy form [stress · length²], shape [...], up to what the collar alone has: its
        derivative to the interior displacement is h² L u (N24). None of the filtered form."""
        if self.model.form != "energy":
            return None
        H, _ = self.gradients(u)
        own = energy_density(H, self.numbers.numpy()).sum(axis=-1) * self.model.spacing**2
        return np.asarray(self.straight.energy(u) + own)

    def stress(self, u: np.ndarray) -> np.ndarray:
        """σ of the tensors and P of Ψ [stress] at the interior nodes, [..., I, 2, 2]."""
        _, P = self.gradients(u)
        inside = self.points.interior[self.sweeps.full]
        return np.asarray(self.straight.stress(u) + P[..., inside, :, :])

    @cached_property
    def _linear_matrix(self) -> sp.csr_array:
        """L of the tensors, shape [2 I, 2 N]."""
        return self.straight.matrix()
