"""A dressed solid: L = Σ Gᵗ K G, a positive base between two short convolutions (theory.md, D5)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike

from warp_peri.core.elastic import from_voigt, voigt
from warp_peri.core.grid import Grid
from warp_peri.core.groups import Symmetry
from warp_peri.core.proof import Proof
from warp_peri.core.record import Entry, Length, Record
from warp_peri.core.stencil import Stencil
from warp_peri.dressed.bases import AXIS_WEIGHT, Base, base, composed, half, spread
from warp_peri.dressed.body import DressedBody
from warp_peri.dressed.sweeps import ByLayers
from warp_peri.errors import InputError
from warp_peri.micromodulus.law import Crystal
from warp_peri.micromodulus.operator import TensorOperator
from warp_peri.models.lps import Model
from warp_peri.points.points import Points
from warp_peri.points.samples import Samples
from warp_peri.points.unit_names import USUAL, Units


@dataclass(frozen=True, eq=False, repr=False)
class DressedSolid(Record, format="warp_peri.dressed"):
    """The law of a solid on one square or cubic lattice of nodes.

    Attributes:
        spacing: of the nodes, h, in the unit of length.
        base: "elements" or "bonds".
        elastic: Voigt matrix [stress] of the even solid along the nodes' axes.
        steps: ξ/h of one half of the neighbours of G, shape [H, d].
        tensors: g(ξ), of one G for the whole base or of one for each of its parts: shape
            [1 or A, H, d, d]. (G u)(x) = u(x) − Σ g(ξ)(u(x) − u(x + ξ)).
        units: names of the units of length and stress.
        symmetry: name of the crystal's point group, or rotations, shape [G, d, d].
        orientation: the crystal's axes in those of the nodes, as columns, or degrees in the plane.
        certificate: what is proven of the symbol of the even solid; None where nothing was asked.
        provenance: how it came to be; plain JSON values.
        dilatation: weight of the bonds along the axes in θ, of a base of bonds; another than 1/8,
            that of 1/r, is a second influence function (theory.md, D26).

    Raises InputError for a base that is not known or that the moduli do not fit, and for steps and
    tensors that are none.
    """

    spacing: Length
    base: str
    elastic: Annotated[np.ndarray, Entry(stress=1)]
    steps: Annotated[np.ndarray, Entry(key="neighbours")]
    tensors: Annotated[np.ndarray, Entry(key="dressing")]
    units: Units = USUAL
    symmetry: Symmetry = ""
    orientation: Any = None
    certificate: Proof | None = None
    provenance: dict[str, Any] = field(default_factory=dict)
    dilatation: Annotated[float, Entry(later=True)] = AXIS_WEIGHT
    ORDER = ("spacing", "symmetry", "orientation", "certificate", "provenance", "base", "elastic",
             "neighbours", "dressing", "dilatation")  # fmt: skip

    def __post_init__(self) -> None:
        super().__post_init__()
        set_, steps, tensors = object.__setattr__, self.steps, self.tensors
        if steps.ndim != 2 or (np.rint(steps) != steps).any():
            raise InputError(f"steps: expected whole numbers of shape [H, d], got {steps!r:.60}")
        set_(self, "steps", steps.astype(int))
        shape = (len(steps), self.dimension, self.dimension)
        if steps.shape[1:] != (self.dimension,) or tensors.shape[1:] != shape:
            raise InputError(
                f"tensors: expected shape [1 or A, {len(steps)}, {self.dimension}, "
                f"{self.dimension}], got {list(tensors.shape)}"
            )
        if len(tensors) not in (1, len(self.parts.moduli)):
            raise InputError(
                f"tensors: expected one G, or one for each of {', '.join(self.parts.names)}, got "
                f"{len(tensors)}"
            )
        set_(self, "orientation", self.crystal.orientation)

    @property
    def dimension(self) -> int:
        """2 or 3."""
        return 2 if len(self.elastic) == 3 else 3

    @property
    def horizon(self) -> float:
        """Length of the longest bond of L, which a collar must hold."""
        return self.crystal.horizon

    @cached_property
    def parts(self) -> Base:
        """The base with its parts."""
        return base(self.base, from_voigt(self.elastic), self.dilatation)

    @cached_property
    def crystal(self) -> Crystal:
        """The same law of the even solid as micromodulus tensors of larger range (theory.md, T)."""
        K = self.parts.stencils
        if len(self.tensors) == 1:
            K = K.sum(axis=0, keepdims=True)
        each = [
            composed(G, composed(one, G))
            for one, G in zip(K, (spread(self.steps, g) for g in self.tensors))
        ]
        steps, tensors = half(np.sum(each, axis=0))
        return Crystal(
            self.spacing, steps, tensors / self.spacing**2, self.units, self.symmetry,
            self.orientation, self.certificate, self.provenance,
        )  # fmt: skip

    @property
    def stencil(self) -> Stencil:
        """That of the even solid."""
        return self.crystal.stencil

    @property
    def group(self) -> np.ndarray:
        """What nodes and crystal share, as of a Crystal."""
        return self.crystal.group

    @property
    def layered(self) -> bool:
        """Whether L is swept as G, K, G: of one G whose reach, with the base's, is that of L."""
        if len(self.tensors) > 1 or not len(self.steps):
            return False
        reach = 2 * np.abs(self.steps).max() + self.parts.stencils.shape[1] // 2
        return bool(np.abs(self.crystal.steps).max() == reach)

    @property
    def plain(self) -> Model:
        """The base of bonds as a linear solid with K(r) = 1/r, in which cracks grow (D12).

        Raises InputError for elements and for a base of two functions.
        """
        if self.base != "bonds" or self.dilatation != AXIS_WEIGHT:
            kind = "elements" if self.base != "bonds" else "two influence functions"
            raise InputError(f"plain: expected a base of bonds with K(r) = 1/r, got {kind}")
        C = self.elastic
        return Model(C[0, 1], C[2, 2], 1.0, np.ones(1), 2 * self.spacing, units=self.units)

    def symbol(self, k: np.ndarray) -> np.ndarray:
        """D(k) = Σ G K G [stress/length²], at k of shape [..., d], shape [..., d, d]."""
        return self.crystal.symbol(k)

    def stiffest_wave(self) -> float:
        """A bound on Λmax D(k) over all waves [stress / length²], for time steps (T21)."""
        return self.crystal.stiffest_wave()

    def tensor(self) -> np.ndarray:
        """C_ijkl of long waves along the nodes' axes [stress]: the base's own."""
        return from_voigt(self.elastic)

    def moduli(self, unit: str | None = None) -> dict[str, float]:
        """Elastic constants by name, as of a Crystal; InputError for a unit not known."""
        return self.crystal.moduli(unit)

    def rows(self) -> list[tuple[str, str]]:
        """What to know at a glance: name and value, those of the even solid last."""
        parts = ", ".join(self.parts.names)
        kind = self.base if self.dilatation == AXIS_WEIGHT else f"{self.base} of two functions"
        base = ("base", f"{kind}: {parts}")
        dressing = ("dressing", f"{2 * len(self.steps)} neighbours, {len(self.tensors)} G")
        proven = "nothing" if self.certificate is None else self.certificate.statement
        return [base, dressing, *self.crystal.rows()[:-1], ("proven", proven)]

    def certified(self) -> DressedSolid:
        """The law with its certificate; `certificate.holds` says whether one was found."""
        return replace(self, certificate=self.crystal.certified().certificate)

    def on(
        self,
        points: Points | Samples,
        *,
        edges: bool | Callable[[np.ndarray], np.ndarray] = False,
        maps: Mapping[str, ArrayLike] | None = None,
        broken: ArrayLike | None = None,
        grains: tuple[Sequence[DressedSolid], ArrayLike] | None = None,
        dtype: Any = np.float64,
    ) -> Any:
        """The operator on nodes of the law's own spacing, its steps along their axes.

        Args:
            points: lattice nodes with a collar as wide as the horizon, or periodic.
            edges: nodes end where the body does: strains and rows of G that would reach beyond it
                are left out (theory.md, D9). A function of positions [n, d] says which of them lie
                inside; elements are integrated over what does (D23). Without it cut bonds are
                refused.
            maps: modulus of each part over that of the even solid, by the part's name ("bulk",
                "shear", …), at the nodes, shape [N], ≥ 0.
            broken: pairs of nodes between which a bond is broken, or an element torn, [n, 2].
            grains: laws, and the number of that which each node belongs to, [N]; as for turned
                grains from_phonons (`orientation`) or `transferred` (`rotation`) make them (D24).
            dtype: float64, or float32 of even solids and of sheets with maps that nothing cuts.

        Raises InputError for another spacing, axis or units, for nodes with cut bonds, for maps
        and pairs that do not fit.
        """
        if edges or maps or broken is not None or grains is not None:
            return DressedBody(
                self, points, edges=edges, maps=maps, broken=broken, grains=grains, dtype=dtype
            )
        law = self.crystal

        def layers(nodes: Grid, dtype: Any) -> ByLayers:
            return ByLayers(
                nodes, self.steps, self.tensors[0], self.parts, self.spacing, dtype=dtype
            )

        why = (
            f"; give a collar {law.horizon:g} wide, or edges=True where the body itself ends there"
        )
        return TensorOperator(
            law.fitting(points), law.stencil, self.tensor(), why=why,
            model=self, dtype=dtype, product=layers if self.layered else None,
        )  # fmt: skip


def held(tensor: np.ndarray) -> np.ndarray:
    """The Voigt matrix of a tensor without what rounding adds to its zeros."""
    C = voigt(tensor)
    return np.where(np.abs(C) > 1e-9 * np.abs(C).max(), (C + C.T) / 2, 0.0)
