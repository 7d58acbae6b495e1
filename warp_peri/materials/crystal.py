"""Crystals of micromodulus tensors: numbers, file, force on nodes (theory, T1–T8, T15, T17)."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, Self

import numpy as np
import scipy.sparse as sp
from numpy import ndarray
from numpy.linalg import inv, norm
from numpy.typing import ArrayLike

from warp_peri.core import elastic
from warp_peri.core.elastic import (
    BROKEN,
    LATTICE_GROUP,
    Symmetry,
    checked_orientation,
    checked_symmetric,
    lattice_group,
    point_group,
    shared_with_nodes,
)
from warp_peri.core.proof import StencilCertificate, check_spacing, largest, prove
from warp_peri.core.record import FieldUnits, Length, Record
from warp_peri.core.stencil import Stencil, elastic_from_brackets
from warp_peri.errors import Arrays, InputError, Rows, Values, hold, warn
from warp_peri.fitting.regression import norms
from warp_peri.points import arguments
from warp_peri.points.arguments import USUAL, Units, checked, shown_moduli, symbols, typed
from warp_peri.points.points import Points, Samples, unsaid
from warp_peri.protocols import OperatorBase, renumbered
from warp_peri.solvers.linear import Inverse, Linear
from warp_peri.solvers.solution import CG, Solution, Solver, by_sample, refuse_solver


class TensorOperator(OperatorBase):
    """Operator L of a stencil material on lattice nodes whose bonds are all whole; made by `on`."""

    is_linear = is_symmetric = True

    def __init__(self, model: StencilMaterial, points: Points, *, dtype: Any = np.float64) -> None:
        self.model, self.points, stencil = model, points, model.stencil
        self.linear = Linear(stencil, points, dtype=dtype, why=f": {model.uncut}")
        self.nodes, self.dtype = self.linear.grid, self.linear.dtype
        self.spacing, self.steps, self.tensors = stencil.spacing, stencil.steps, stencil.tensors

    def force(self, u: ArrayLike) -> ndarray:
        """L u [stress/length] at the interior nodes, [..., I, d], for u [..., N, d]; InputError for
        other shapes or values that are not finite."""
        return elastic.in_shape_of(u, self.linear(self.fields(u)))

    def solve(self, b: ArrayLike, u: ArrayLike, solver: Solver = None) -> Solution:
        """Equilibrium with b on the interior, u given on the collar, [..., N, d], by
        CG(preconditioner, tolerance); InputError as Linear.solve."""
        refuse_solver(solver, (CG,), "a crystal model")
        asked: Any = solver or CG()
        b, u = arguments.checked_fields(self.points, b, u)
        loads, fields = (field.reshape(-1, *self.shape) for field in (b, u))
        if (proven := self.model.statement) is None:
            self.linear.check_definite()
        found, took = self.linear.solve(loads, fields, asked.tolerance, asked.preconditioner)
        method = self.linear.method(asked.preconditioner)
        return by_sample(self, found.reshape(u.shape), self.rhs(b), took, method, proven)

    def inverse(self, loads: int) -> Inverse:
        """Inverse of L on so many interior loads: factorised, or by iteration."""
        return self.linear.cheapest_inverse(loads)

    def solve_periodic(self, b: ArrayLike, solver: Solver = None) -> Solution:
        """Equilibrium with the load b, less its mean, on a period."""
        return self.solve(b, np.zeros(np.shape(b)), solver)

    def vjp(self, u: ArrayLike, w: ArrayLike) -> ndarray:
        """Transposed product Lᵗ w on all nodes, [..., N, d], for w on the interior, at any u."""
        w = self.of_interior(w, u)
        pushed = [self.linear.push(one) for one in w.reshape(-1, *w.shape[-2:])]
        return np.reshape(pushed, (*w.shape[:-2], *self.shape))

    @property
    def learnable(self) -> Arrays:
        """Tensors C(ξ) of half of the bonds [stress/length²], [H, d, d], along the nodes' axes."""
        return {"tensors": self.tensors}

    def at(self, numbers: arguments.Numbers) -> TensorOperator:
        """The operator with other symmetric tensors; nothing is proven of it yet."""
        law, C = self.model, renumbered(self.learnable, numbers)["tensors"]
        held = getattr(law, "stress", None)
        law = CrystalMaterial(self.spacing, self.steps, C, law.units, stress=held)
        return TensorOperator(law, self.points, dtype=self.dtype)

    def by_numbers(self, name: str, u: ArrayLike, w: ArrayLike) -> ndarray:
        """Derivatives of Σ w · L u with respect to the tensors, for u [K, N, d] and w [K, I, d]."""
        A = self.nodes.axes
        fields, weights = (one @ A for one in self.pairs(u, w))
        both = 2 * fields[:, self.ends[0]]
        found = np.array([
            np.einsum("sni,snj->ij", weights, both - fields[:, ahead] - fields[:, behind])
            for ahead, behind in zip(*np.split(self.ends[1:], 2))
        ])  # fmt: skip
        return elastic.symmetric_part(found)

    @cached_property
    def ends(self) -> ndarray:
        """Numbers of the interior nodes and of the far ends of ±steps, [1 + 2 H, I]."""
        nodes, steps = self.nodes, self.steps
        number = np.full(np.prod(nodes.shape), -1)
        number[nodes.place] = nodes.near
        at = np.stack(np.unravel_index(nodes.interior, nodes.shape))
        far = np.concatenate([0 * steps[:1], steps, -steps]).T[:, :, None] + at[:, None]
        return np.asarray(number[np.ravel_multi_index(tuple(far), nodes.shape, "wrap")])

    def energy(self, u: ArrayLike) -> ndarray | float:
        """Energy [stress · length^d] of bonds with an unknown end, [...] (T15); 2D: thickness 1."""
        collar, d = ~self.points.interior, self.nodes.dimension
        ones = np.repeat(np.eye(d)[:, None], self.points.interior.sum(), axis=1)
        ends = -self.vjp(u, ones)[:, collar]  # Σ C(ξ) over unknowns, [d, N − I, d]
        own, given = self.quadratic(u), self.as_fields(u)[..., collar, :]
        bent = np.einsum("...na,ank,...nk->...", given, ends, given, optimize=True)
        return np.asarray(own + self.spacing**d / 2 * bent)[()]

    def gradient(self, u: ArrayLike) -> ndarray:
        """Displacement gradient ∂u_a/∂x_b at interior nodes by least squares, [..., I, d, d]."""
        A, xi, ends = self.nodes.axes, self.spacing * self.steps, np.split(self.ends[1:], 2)
        fields = self.fields(u) @ A
        found = np.zeros((len(fields), self.ends.shape[1], *A.shape))
        for weight, ahead, behind in zip(xi @ inv(2 * xi.T @ xi), *ends):
            found += (fields[:, ahead] - fields[:, behind])[..., None] * weight
        return elastic.in_shape_of(u, A @ found @ A.T)

    def stress(self, u: ArrayLike) -> ndarray:
        """Stress C : ε of `gradient` at the interior nodes [stress], [..., I, d, d]: exact on
        affine fields, on others the stress of the solid that long waves see."""
        C = elastic.turned(self.model.tensor(), self.nodes.axes)
        return np.asarray(np.einsum("abcd,...cd->...ab", C, self.gradient(u), optimize=True))

    def matrix(self) -> sp.csr_array:
        """L as a sparse matrix of all nodes' displacements, shape [d I, d N]."""
        ends, A = self.ends.T, self.nodes.axes
        C = A @ self.tensors @ A.T
        blocks = np.concatenate([2 * C.sum(axis=0)[None], -C, -C])
        starts = np.arange(0, ends.size + 1, len(blocks))
        parts = np.tile(blocks, (len(ends), 1, 1)), ends.ravel(), starts
        shape = len(A) * len(ends), self.points.x.size
        return sp.csr_array(sp.bsr_array(parts, shape=shape))


SAME_AXIS = 1e-3
"""Of the directions of a crystal, as rotations, that count as one."""


class StencilMaterial(Record):
    """A linear material defined by its stencil on one lattice: a frozen dataclass with `eq=False`
    of numbers, among them `horizon`, `units`, `certificate`, which makes its `stencil` of them."""

    if TYPE_CHECKING:
        certificate: StencilCertificate | None

        @property
        def horizon(self) -> float: ...
        @property
        def stencil(self) -> Stencil: ...

    @property
    def dimension(self) -> int:
        """Dimension of space: 2 or 3."""
        return self.stencil.dimension

    @property
    def group(self) -> ndarray:
        """Rotations and mirrors of the lattice that leave the stencil unchanged, [g, d, d]."""
        turns = lattice_group(self.dimension)
        return turns[[self.stencil.asymmetry(turn[None]) <= BROKEN for turn in turns]]

    def symbol(self, k: ndarray) -> ndarray:
        """Symbol D(k) = 2 Σ_half C(ξ)(1 − cos k·ξ) (T2) at wave vectors k [..., d]; [..., d, d]."""
        k = checked("k", k, float, (..., self.dimension))
        D = self.stencil.symbol(k.reshape(-1, self.dimension) * self.stencil.spacing)
        return D.reshape(*k.shape, self.dimension)

    def tensor(self) -> ndarray:
        """Elastic tensor C_ijkl of long waves along the nodes' axes [stress], [d, d, d, d] (T4)."""
        held = getattr(self, "stress", None)  # adds to brackets (T19)
        brackets = self.stencil.brackets - (0 if held is None else elastic.stress_brackets(held))
        C = elastic_from_brackets(brackets)
        return np.asarray((C + C.transpose(2, 3, 0, 1)) / 2)

    def elastic_tensor(self, unit: str | None = None) -> ndarray:
        """Voigt matrix of long waves along the nodes' axes, 3 × 3 in the plane (11, 22, 12), 6 × 6
        in space, in the law's stress unit or another, as "GPa"; InputError for an unknown unit."""
        return elastic.voigt(self.tensor()) * self._stress(unit)

    def _stress(self, unit: str | None) -> float:
        return 1.0 if unit is None else arguments.factors(self.units, (self.units[0], unit))[1]

    def certified(self) -> Self:
        """The material with its certificate; `certificate.holds` says whether a proof was found."""
        return replace(self, certificate=prove(self.stencil, self.group))  # type: ignore[type-var]

    @property
    def statement(self) -> str | None:
        """Sentence on what is proven of these numbers, or None."""
        proof = self.certificate
        if proof is None or not (proof.holds and self.stands):
            return None
        return f"one stable answer: D(k) ≥ {proof.proven:.3g} s(k) for all k"

    def max_symbol_eigenvalue(self) -> float:
        """Upper bound of Λmax D(k) over all waves [stress / length²], for time steps (T21)."""
        return largest(self.stencil, self.group)

    @property
    def uncut(self) -> str:
        """Reason why no bonds of this material may be cut."""
        return (
            f"a {type(self).__name__} is a stencil of whole families; give a collar "
            f"{self.horizon:g} wide"
        )

    def fitting(self, points: Points | Samples) -> Points:
        """The nodes, checked for the material's spacing, units and axis; InputError for others."""
        nodes = self.own_nodes(points)
        check_spacing(self.stencil.spacing, nodes.spacing, "the points have")
        return nodes

    def on(self, points: Points | Samples, *, dtype: Any = np.float64) -> TensorOperator:
        """Build the operator on nodes of the material's own spacing, its steps along their axes;
        for other spacings, and for a crystal that stays when the lattice turns, see
        transfer_to_lattice.

        Args:
            points: lattice nodes with a collar, or periodic, in the material's units.
            dtype: float64 or float32.

        Raises InputError for another spacing or other units, and for nodes whose bonds are cut.
        """
        return TensorOperator(self, self.fitting(points), dtype=dtype)


@dataclass(frozen=True, eq=False)
class CrystalMaterial(StencilMaterial, format="warp_peri.micromodulus"):
    """A crystal on one square or cubic lattice of nodes: a micromodulus tensor for every bond.

    Steps and tensors are along the axes of the nodes; C(−ξ) = C(ξ).

    Attributes:
        spacing: of the nodes, h, in the unit of length.
        steps: ξ/h of one half of the bonds, shape [H, d] of whole numbers, d = 2 or 3.
        tensors: C(ξ), in stress over length², shape [H, d, d], symmetric, of any sign.
        units: names of the units of length and stress.
        symmetry: name of the crystal's point group, or rotations, shape [G, d, d].
        orientation: the crystal's axes in those of the nodes, as columns; degrees in the plane.
        certificate: what is proven of the symbol; None where nothing was asked.
        provenance: how it came to be; plain JSON values.
        stress: that the crystal is held under, along the nodes' axes [stress], [d, d]; or None.

    Raises InputError for shapes that do not fit, steps given twice, tensors that are not symmetric
    or do not have the stated symmetry.
    """

    spacing: Length
    steps: ndarray
    tensors: Annotated[ndarray, FieldUnits(length=-2, stress=1)]
    units: Units = USUAL
    symmetry: Symmetry = ""
    orientation: Any = None
    certificate: StencilCertificate | None = None
    provenance: Values = field(default_factory=dict)
    stress: Annotated[ndarray | None, FieldUnits(stress=1, omit=True)] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        steps, tensors, stress = self.steps, self.tensors, self.stress
        d = steps.shape[-1]
        if d not in (2, 3) or not len(steps) or tensors.shape != (*steps.shape, d):
            raise InputError(
                "steps, tensors: expected shapes [H, d] and [H, d, d], d = 2 or 3, got "
                f"{list(steps.shape)} and {list(tensors.shape)}"
            )
        whole = np.rint(steps).astype(np.int64)
        both = {tuple(step) for step in np.concatenate([whole, -whole]).tolist()}
        if (whole != steps).any() or len(both) != 2 * len(whole) or not whole.any(axis=1).all():
            raise InputError("steps: expected whole numbers, one of ξ and −ξ, each once and not 0")
        turn = checked_orientation(self.orientation, d)
        hold(self, steps=whole, tensors=checked_symmetric("tensors", tensors), orientation=turn)
        if stress is not None:
            hold(self, stress=checked_symmetric("stress", stress, (d, d)))
        if isinstance(self.symmetry, str) and not self.symmetry:
            hold(self, symmetry=elastic.LEAST[d])
        if (broken := self.stencil.asymmetry(self.group)) > BROKEN:
            raise InputError(f"symmetry: the tensors break it by {broken:.1e} of the largest")

    @property
    def bonds(self) -> int:
        """Number of bonds of a node."""
        return 2 * len(self.steps)

    @property
    def horizon(self) -> float:
        """Length of the longest bond."""
        return self.spacing * float(norms(self.steps).max())

    @property
    def group(self) -> ndarray:
        """Symmetries that the nodes and the crystal share: integer matrices, shape [g, d, d]."""
        return shared_with_nodes(point_group(self.symmetry, self.dimension), self.orientation)

    @property
    def stencil(self) -> Stencil:
        """The stencil of spacing, steps and tensors."""
        return Stencil(self.spacing, self.steps, self.tensors)

    def moduli(self, unit: str | None = None) -> dict[str, float]:
        """Nonzero elastic constants by name in the crystal's own axes, as C11, C12, C44 of a cubic
        one; in the plane C44 is the shear modulus."""
        own = elastic.turned(self.tensor(), self.orientation.T)
        return elastic.named_moduli(own * self._stress(unit))

    def rows(self) -> Rows:
        """Name and value of each line of the crystal's summary table."""
        length, constants = symbols(self.units)[0], self.moduli()
        symmetry = self.symmetry if isinstance(self.symmetry, str) else "rotations"
        proof = self.certificate
        return [
            ("symmetry", f"{symmetry}, {self.dimension} dimensions"),
            (", ".join(constants), shown_moduli(self.units, constants.values())),
            ("bonds", f"{self.bonds}, up to {self.horizon:.4g} {length}"),
            ("nodes", f"{self.spacing:g} {length} apart"),
            ("proven", proof.statement if proof and self.stands else "nothing"),
        ]

    def _surface_traction(self) -> float:
        """Largest traction per radian [stress] of a turned body where a face cuts bonds (T16):
        |[ij, kl] W_jk n_l| over faces n along the axes and turns W in coordinate planes."""
        B = self.stencil.brackets
        return float(norm(B - B.swapaxes(1, 2), axis=0).max())

    @property
    def uncut(self) -> str:
        """Reason why no bonds may be cut, with the figure of `_surface_traction`."""
        return (
            "a crystal model is not objective there (a turned face feels up to "
            f"{self._surface_traction():.3g} {symbols(self.units)[1]} per radian); give a collar "
            f"{self.horizon:g} wide"
        )

    def fitting(self, points: Points | Samples) -> Points:
        """The nodes, checked for the crystal's axis too; an assumed axis is warned of once."""
        nodes = super().fitting(points)
        if str(self.symmetry) == "isotropic":
            return nodes
        d, axes, stated = self.dimension, nodes.lattice.axes, nodes.axis is not None
        same = self.orientation @ point_group(self.symmetry, d)
        there = axes.T @ checked_orientation(nodes.axis, d)
        off = np.abs(same - there).max(axis=(1, 2)).min() > SAME_AXIS
        if off and stated:
            angle = np.degrees(np.arccos(np.clip((np.trace(there) - (d - 2)) / 2, -1, 1)))
            raise InputError(
                f"axis: the crystal stands at {angle:.4g}° to these nodes, not as in the model; "
                "transfer_to_lattice(law, spacing, rotation=…) turns it"
            )
        turned = off or np.abs(axes - np.eye(d)).max() > SAME_AXIS
        if turned and not stated and unsaid(nodes):
            warn(
                "axis: lattice or crystal are turned, and the points do not state how the "
                "crystal lies: taken as on its nodes in the model; Points(…, axis=…) states it"
            )
        return nodes

    def summary(self) -> Values:
        """Symmetry, moduli, lattice and proof of the crystal as plain values."""
        return {
            "format": "crystal",
            "symmetry": self.symmetry if isinstance(self.symmetry, str) else "rotations",
            **{name: getattr(self, name) for name in ("spacing", "horizon", "bonds", "units")},
            "moduli": self.moduli(),
            "certificate": self.certificate and self.certificate.content(),
        }


@typed
def crystal_from_lps(model: Any, spacing: float) -> CrystalMaterial:
    """Convert an LPS on a lattice spacing into a crystal, exactly, with bonds up to 2δ. Raises
    InputError for other materials, and a spacing without bonds."""
    if not callable(made := getattr(model, "stencil", None)):
        raise InputError(f"model: expected a linear peridynamic solid, got {type(model).__name__}")
    stencil = made(spacing)
    law = CrystalMaterial(
        spacing, stencil.steps, stencil.tensors, model.units, LATTICE_GROUP[model.dimension],
        provenance={"fit": {"from": "linear peridynamic solid"}},
    )  # fmt: skip
    return law.certified()
