"""A crystal of third order on a lattice: energy density, equilibria (N1–N12, N24)."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property, lru_cache, partial
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import ArrayLike

from warp_peri.contract import stencil_of
from warp_peri.core.pointwise import Pointwise
from warp_peri.core.proof import largest
from warp_peri.errors import InputError
from warp_peri.points.families import bond_classes
from warp_peri.points.lattice import lattice_steps
from warp_peri.points.samples import PointsLike, axis_of, nodes_of
from warp_peri.statics.equilibria import SOLVES, equilibria_of, figures_of
from warp_peri.statics.linear import Inverse, bonds_within
from warp_peri.statics.solution import Solution, Solver

if TYPE_CHECKING:
    from warp_peri.third_order.material import ThirdOrderCrystal


MEASURES = torch.tensor([[1, 0, 0, 1], [0.5, 0, 0, -0.5], [0, 0.5, 0.5, 0]], dtype=torch.float64)
"""Of E00, E01, E10 and E11 the trace t and the deviator a, b."""


@lru_cache(maxsize=64)
def _moduli(axis: float) -> torch.Tensor:
    """∂W/∂(t, a, b) as t, a, b times 1, t², a² and b² have it of λ, μ, t3, tq2, q3, [3, 4, 5]."""
    moduli, c, s = torch.zeros(3, 4, 5, dtype=torch.float64), np.cos(6 * axis), np.sin(6 * axis)
    moduli[0, 0, :2], moduli[1:, 0, 1] = 0.5, 2.0
    moduli[0, 1, 2] = moduli[0, 2, 3] = moduli[0, 3, 3] = 1.0
    moduli[1:, 2:, 4] = torch.tensor([[c, -3 * c], [3 * s, -s]])
    return moduli


def energy_density(
    E: torch.Tensor, *, axis: float, lam: Any, mu: Any, t3: Any, tq2: Any, q3: Any
) -> Any:
    """The energy (N3) [stress] of Green strains E [..., 2, 2], of a crystal at `axis` [rad]."""
    given = (lam, mu, t3, tq2, q3)
    if any(map(torch.is_tensor, given)):
        numbers = torch.stack([torch.as_tensor(n, dtype=torch.float64) for n in given])
    else:
        numbers = torch.tensor(given, dtype=torch.float64)
    moduli = _moduli(axis) @ numbers
    v = MEASURES @ E.flatten(-2).movedim(-1, 0).reshape(4, -1)
    return (v * (moduli[:, :1] * v + moduli[:, 1:] @ (v * v))).sum(0).reshape(E.shape[:-2])


def gradient_stencil(
    points: PointsLike, reach: float, p: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Steps [B, 2] and weights 2 p ξ [1, B, 2] of H (N1), of p by class, in the points' axes."""
    classes, (_, axes) = bond_classes(points.spacing, reach), lattice_steps(nodes_of(points))
    return classes.steps, 2 * p[classes.bond_class, None] * (classes.xi @ axes.T)[None]


class PlacedThirdOrder(Pointwise):
    """Minus the internal force density of a solid of third order; b in equilibrium.

    Args:
        material: certified on some lattice.
        points: a lattice, whose interior has a collar as wide as the linear part needs and twice
            the gradient's horizon; their axis is that of the crystal, x where none is stated, which
            is said once.
        transfer: False refuses lattices that the material itself is not certified on.
        allow_uncertified: take what holds no certificate, with a warning.

    Attributes:
        home: the material that was given.
        model: the one that is used, its linear part transferred where need be.

    Raises InputError for scattered points, nodes without the collar, other units, and an
    uncertified spacing.
    """

    def __init__(
        self,
        material: ThirdOrderCrystal,
        points: PointsLike,
        *,
        transfer: bool = True,
        allow_uncertified: bool = False,
    ) -> None:
        self.home = material
        given = {"transfer": transfer, "allow_uncertified": allow_uncertified}
        self.model = here = material.at(nodes_of(points), **given)
        stated = here.q3 or nodes_of(points).axis is not None
        axis = axis_of(points) if stated else 0.0
        p_in, p_out = here.weights(bond_classes(here.spacing, here.reach))
        steps, weights = gradient_stencil(points, here.reach, p_in)
        back = None if p_in is p_out else gradient_stencil(points, here.reach, p_out)[1]
        lam, mu = here.lame
        super().__init__(
            points,
            here.horizon,
            partial(energy_density, lam=lam, mu=mu, axis=axis),
            steps,
            weights,
            back=back,
            stencil=here.linear.stencil,
            numbers={name: getattr(here, name) for name in ("t3", "tq2", "q3")},
        )

    @cached_property
    def straight(self) -> Any:
        """The linear part alone, on the same nodes."""
        return self.model.linear.on(self.points)

    def at(self, numbers: Mapping[str, Any]) -> PlacedThirdOrder:
        """The same with other constants, of which nothing is proven."""
        own: dict[str, Any] = {name: float(value) for name, value in numbers.items()}
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # said of this one
            given: dict[str, Any] = {"transfer": False, "allow_uncertified": True}
            return PlacedThirdOrder(replace(self.model, **own, proven={}), self.points, **given)

    def energy(self, u: ArrayLike) -> np.ndarray | None:
        """Of the linear part, and h² Σ Ψ(H) [stress · length²], shape [...], up to what the collar
        alone has: its derivative to the interior displacement is h² L u (N1, N24). None of the
        filtered form."""
        own = super().energy(u)
        return None if own is None else np.asarray(own + self.straight.energy(u))

    def stress(self, u: ArrayLike) -> np.ndarray:
        """σ of the linear part and P of Ψ [stress] at the interior nodes, [..., I, 2, 2] (N2)."""
        return np.asarray(self.straight.stress(u) + super().stress(u))

    def stiffest_wave(self) -> float:
        """A bound on the eigenvalues of the tangent [stress / length²] up to the proven strain, for
        time steps: twice that of the linear part (N15).

        Raises InputError for the filtered form, which has no energy that a motion could keep.
        """
        if self.model.form != "energy":
            raise InputError(
                "move: expected form='energy', got 'filtered', whose force is no gradient: its "
                "waves would gain or lose energy"
            )
        return 2 * largest(*stencil_of(self.model.linear, self.points.spacing, "move"))

    def inverse(self, loads: int) -> Inverse:
        """L⁻¹ of the linear part, of a load on the interior: factorised, or by iteration."""
        bonds = bonds_within(self.model.horizon, self.points.spacing)
        inverse: Inverse = self.straight.linear.cheapest_inverse(SOLVES * loads, bonds)
        return inverse

    def figures(self, solution: Solution) -> dict[str, Any]:
        """What solves took, and whether their answers are the only ones, for `evaluate`."""
        return figures_of(solution.details)

    def rest(self, b: ArrayLike, u: ArrayLike, solver: Solver = None) -> Solution:
        """Equilibrium with b on the interior, u given on the collar.

        Args:
            b: body force density [stress/length], [N, 2] or [S, N, 2]; only interior values count.
            u: displacement [length], same shape; only collar values count.
            solver: Newton(…).

        A UserWarning says where |H| exceeds the proven strain, so that another solution is not
        ruled out. The details of the solution are one NonlinearRecord for each sample.

        Raises InputError for arrays that do not fit, and a sample for which no equilibrium was
        found.
        """
        proven = self.model.proven_strain(self.points.spacing)
        return equilibria_of(self, b, u, solver, proven)
