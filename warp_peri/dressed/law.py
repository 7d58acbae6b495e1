"""Dressed solids: numbers, and how fields, phonons and other laws teach them (theory, Dr)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import least_squares

from warp_peri.contract import MaterialFit
from warp_peri.core.elastic import allowed_tensors, from_voigt, turned, voigt
from warp_peri.core.grid import Grid
from warp_peri.core.groups import Symmetry, checked_orientation, point_group, shared_with_nodes
from warp_peri.core.proof import Proof
from warp_peri.core.record import Entry, Length
from warp_peri.core.stencil import Basis, Stencil, invariant_basis
from warp_peri.damage.solid import CrystalBonds
from warp_peri.dressed.body import DressedBody
from warp_peri.dressed.sweeps import (
    AXIS_WEIGHT,
    CRYSTAL_REACH,
    Base,
    ByLayers,
    base,
    bonds,
    composed,
    dilatation_range,
    half,
    spread,
)
from warp_peri.errors import InputError
from warp_peri.lps.model import Model
from warp_peri.micromodulus import regression
from warp_peri.micromodulus.force_constants import ForceConstants
from warp_peri.micromodulus.law import Crystal, StencilMaterial, TensorOperator
from warp_peri.micromodulus.learning import one_set
from warp_peri.micromodulus.waves import LARGEST_WAVE, SAME, carried_symbol, wave_rows
from warp_peri.points.dataset import Dataset
from warp_peri.points.lattice import lattice_steps
from warp_peri.points.points import Points
from warp_peri.points.samples import Samples
from warp_peri.points.unit_names import USUAL, Units, factors
from warp_peri.third_order.fit import fit_third_order
from warp_peri.third_order.smoothing import Smoothing


@dataclass(frozen=True, eq=False, repr=False)
class DressedSolid(StencilMaterial, format="warp_peri.dressed"):
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
            that of 1/r, is a second influence function (theory, Dr26).

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
        """The same law of the even solid as micromodulus tensors of larger range (theory, T)."""
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
    def plain(self) -> Model | CrystalBonds:
        """The base of bonds as a linear solid in which cracks grow: of 1/r, or a crystal (Dr12).

        Raises InputError for elements and for a base of two functions.
        """
        if self.base != "bonds" or self.dilatation != AXIS_WEIGHT:
            kind = "elements" if self.base != "bonds" else "two influence functions"
            raise InputError(f"plain: expected a base of bonds with K(r) = 1/r, got {kind}")
        C = self.elastic
        if self.dimension == 3 or len(self.parts.corners) != EIGHT + 1:
            return CrystalBonds(C, CRYSTAL_REACH * self.spacing, self.units)
        return Model(C[0, 1], C[2, 2], 1.0, np.ones(1), 2 * self.spacing, units=self.units)

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

    def fitting(self, points: Points | Samples) -> Points:
        """Nodes of the law's own spacing, units and axis; InputError for others."""
        return self.crystal.fitting(points)

    def on(  # type: ignore[override]  # of layers, not of rows or FFT
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
                are left out (theory, Dr9). A function of positions [n, d] says which of them lie
                inside; elements are integrated over what does (Dr23). Without it cut bonds are
                refused.
            maps: modulus of each part over that of the even solid, by the part's name ("bulk",
                "shear", …), at the nodes, shape [N], ≥ 0.
            broken: pairs of nodes between which a bond is broken, or an element torn, [n, 2].
            grains: laws, and the number of that which each node belongs to, [N]; as for turned
                grains from_phonons (`orientation`) or `transferred` (`rotation`) make them (Dr24).
            dtype: float64 or float32.

        Raises InputError for another spacing, axis or units, for nodes with cut bonds, for maps
        and pairs that do not fit.
        """
        if edges or maps or broken is not None or grains is not None:
            return DressedBody(
                self, points, edges=edges, maps=maps, broken=broken, grains=grains, dtype=dtype
            )
        law = self.crystal
        why = (
            f"; give a collar {law.horizon:g} wide, or edges=True where the body itself ends there"
        )
        return TensorOperator(
            self.fitting(points), law.stencil, self.tensor(), why=why,
            model=self, dtype=dtype, product=self._layers if self.layered else None,
        )  # fmt: skip

    def _layers(self, nodes: Grid, dtype: Any) -> ByLayers:
        return ByLayers(nodes, self.steps, self.tensors[0], self.parts, self.spacing, dtype=dtype)


def held(tensor: np.ndarray) -> np.ndarray:
    """The Voigt matrix of a tensor without what rounding adds to its zeros."""
    C = voigt(tensor)
    return np.where(np.abs(C) > 1e-9 * np.abs(C).max(), (C + C.T) / 2, 0.0)


EIGHT = 8
"""Bonds of an isotropic sheet."""
REACH = {2: {4: 1.0, 8: 2**0.5, 12: 2.0, 20: 5**0.5}, 3: {6: 1.0, 18: 2**0.5, 26: 3**0.5}}
"""Of G in spacings, by dimension and number of neighbours."""
REACH_OF_MODULI = 3.0
"""Of tensors beside which moduli are found, in spacings."""
CONVERGED = 1e-12
FELT = 1e-6
"""Least change of L u, over the load, by which a number of G is felt."""


def fit(
    samples: Samples,
    kind: str,
    neighbours: int,
    *,
    symmetry: Symmetry,
    orientation: Any = None,
    moduli: Any = "long waves",
    split: bool = False,
    two_functions: bool = False,
) -> DressedSolid:
    """The G that fits L u = b on the interior nodes best; arguments as of laws.Dressed.

    Returns a law with its certificate. Raises InputError for samples that do not carry the reach
    of L or do not determine the law.
    """
    axes = lattice_steps(samples.points)[1]
    d = len(axes)
    turn = np.eye(d)
    if orientation is not None and not np.array_equal(symmetry, "isotropic"):
        turn = axes.T @ checked_orientation(orientation, d)
    group = point_group(symmetry, d)
    if isinstance(moduli, str):
        C = regression.long_wave_moduli(samples, allowed_tensors(symmetry, group, turn))[0]
    elif isinstance(moduli, Smoothing):
        C = third_order_moduli(samples, moduli)
    else:
        C = turned(from_voigt(moduli), turn)
    dressing = _dressing(neighbours, shared_with_nodes(group, turn))
    found = _Monomials(kind, C, dressing, split, samples.spacing, two_functions)
    q, record = found.solve(*regression.rows(samples, found.family))
    record |= {"from": "fields", "samples": len(samples.u)}
    return found.law(q, samples.points.units, symmetry, turn, record)


def third_order_moduli(samples: Samples, smoothing: Smoothing) -> np.ndarray:
    """The isotropic elastic tensor of a sheet's long waves, what is of third order taken off (N29).

    At 2 % of strain third order looks like moduli; a fit that knows it finds them better.
    Raises InputError as fit_third_order does.
    """
    horizon = REACH_OF_MODULI * samples.spacing
    found = fit_third_order(samples, horizon, smoothing, form="energy").material
    return found.linear.tensor()


def from_phonons(
    atoms: ForceConstants,
    spacing: float,
    kind: str = "elements",
    neighbours: int | None = None,
    *,
    symmetry: Symmetry = "auto",
    orientation: Any = None,
    split: bool = True,
    two_functions: bool = False,
    largest_wave: float = LARGEST_WAVE,
    units: Units = USUAL,
) -> DressedSolid:
    """The law that answers plane waves as atoms do, from their force constants alone (T9, T14).

    Args:
        atoms: force constants; the crystal's axes are those of their coordinates.
        spacing: of the nodes, in the unit of length.
        kind, neighbours, split, two_functions: base and dressing, as of laws.Dressed; 12 neighbours
            in the plane and 26 in space by default.
        symmetry: "auto" asks spglib.
        orientation: the crystal's axes in those of the nodes.
        largest_wave: |k| h up to which waves weigh fully; beyond it a tenth.
        units: of the law.

    Returns a law with its certificate, and the elastic constants of the atoms, held. Raises
    InputError for a crystal that is not stable.
    """
    d = atoms.dimension
    length, stress = factors(units, USUAL)
    turn = checked_orientation(orientation, d)
    auto = isinstance(symmetry, str) and symmetry == "auto"
    name: Symmetry = atoms.group() if auto else symmetry
    group = point_group(name, d)
    C = turned(atoms.elastic(allowed_tensors(name, group, np.eye(d))), turn) / stress

    def target(k: np.ndarray) -> np.ndarray:
        D = atoms.effective(k / length @ turn)  # k in the crystal's axes is Rᵗ k
        return np.asarray(turn @ D @ turn.T) * (length**2 / stress)

    shared = shared_with_nodes(group, turn)
    dressing = _dressing(neighbours or {2: 12, 3: 26}[d], shared)
    found = _Monomials(kind, C, dressing, split, spacing, two_functions)
    rows = wave_rows(target, spacing, found.family, shared, largest_wave)
    q, record = found.solve(*rows)
    record |= {"from": "phonons", "largest_wave": largest_wave / spacing}
    return found.law(q, units, name, turn, record)


def transferred(
    law: DressedSolid,
    spacing: float,
    *,
    rotation: Any = None,
    neighbours: int | None = None,
    largest_wave: float = LARGEST_WAVE,
) -> DressedSolid:
    """The law of the same solid on other nodes: a fit to its own symbol, moduli held (T17).

    Args:
        law: to be carried over.
        spacing: of the new nodes.
        rotation: by which the crystal is turned on its nodes, [d, d], or degrees in the plane.
        neighbours: of the new G; as many as the old one's.
        largest_wave: |k| times the larger spacing up to which waves weigh fully.

    Returns a law with its certificate. Raises InputError for neighbours that no G has, and a turn
    that the base does not take.
    """
    crystal, d = law.crystal, law.dimension
    turn = checked_orientation(rotation, d)
    if neighbours is None and abs(spacing / law.spacing - 1) < SAME and (turn == np.eye(d)).all():
        return law.certified()
    orientation = turn @ crystal.orientation
    shared = shared_with_nodes(point_group(law.symmetry, d), orientation)
    dressing = _dressing(neighbours or 2 * len(law.steps), shared)
    C = turned(law.tensor(), turn)
    two = law.dilatation != AXIS_WEIGHT
    found = _Monomials(law.base, C, dressing, len(law.tensors) > 1, spacing, two)
    share = largest_wave * min(1.0, spacing / law.spacing)
    q, record = found.solve(
        *wave_rows(carried_symbol(crystal, turn), spacing, found.family, shared, share)
    )
    record |= {"from": "a law on other nodes", "spacing": law.spacing}
    return found.law(q, law.units, law.symmetry, orientation, record)


def _dressing(neighbours: int, group: np.ndarray) -> Basis:
    known = REACH[group.shape[1]]
    if neighbours not in known:
        raise InputError(
            f"neighbours: expected one of {', '.join(map(str, known))}, got {neighbours!r:.50}"
        )
    return invariant_basis(known[neighbours], group)


class _Monomials:
    """L of a base and a dressing as Σ c_n(q) L_n with c = 1, q_a and q_a q_b of each G (Dr7), and
    with two functions each of them times 1, s and s², s the last of q: p = 1/8 + s (Dr26)."""

    def __init__(
        self,
        kind: str,
        tensor: np.ndarray,
        dressing: Basis,
        split: bool,
        spacing: float,
        two_functions: bool = False,
    ) -> None:
        if two_functions and (split or kind != "bonds"):
            raise InputError("two_functions: expected a base of bonds and split=False")
        self.kind, self.elastic, self.spacing, self.dressing = kind, held(tensor), spacing, dressing
        C = from_voigt(self.elastic)
        K = base(kind, C).stencils
        self.bases = (K if split else K.sum(axis=0, keepdims=True))[:, None]  # [A, powers of s, …]
        self.powers, self.range = np.arange(1), 0.0
        if two_functions:
            self.powers, self.range = np.arange(3), dilatation_range(C)
            less, more = (bonds(C, AXIS_WEIGHT + s).stencils.sum(axis=0) for s in (-0.5, 0.5))
            middle = self.bases[0, 0]
            self.bases = np.array([[middle, more - less, 2 * (more + less) - 4 * middle]])
        self.count = len(dressing.basis)
        d = dressing.dimension
        reach = int(np.abs(dressing.steps).max())
        one = np.zeros((*[2 * reach + 1] * d, d, d))
        one[(reach,) * d] = np.eye(d)
        S = [spread(dressing.steps, basis) - one for basis in dressing.basis]
        self.first, self.second = np.triu_indices(self.count)
        found = []
        for K in self.bases.reshape(-1, *self.bases.shape[2:]):
            left = [composed(K, G) for G in (one, *S)]
            found.append(composed(one, left[0]))
            found += [composed(one, left[a + 1]) + composed(G, left[0]) for a, G in enumerate(S)]
            for a, b in zip(self.first, self.second):
                both = composed(S[a], left[b + 1])
                found.append(both if a == b else both + composed(S[b], left[a + 1]))
        stacked = np.array(found)
        steps = half(np.abs(stacked).sum(axis=0))[0]
        middle = stacked.shape[1] // 2
        basis = -stacked[(slice(None), *(steps + middle).T)] / spacing**2
        self.family = Basis(steps, (basis + basis.swapaxes(2, 3)) / 2, np.zeros(len(steps), int))

    def coefficients(self, x: np.ndarray) -> np.ndarray:
        """c_n(q, s)."""
        q, powers = self._split(x)
        return np.concatenate([np.outer(powers, self._of(p)).ravel() for p in q])

    def slopes(self, x: np.ndarray) -> np.ndarray:
        """∂c_n/∂(q, s)_a, shape [n, a]."""
        (q, powers), n = self._split(x), self.count
        row = 1 + n + np.arange(len(self.first))
        J = np.zeros((len(q), len(powers), 1 + n + len(row), len(q), n))
        for part, p in enumerate(q):
            own = np.zeros((1 + n + len(row), n))
            own[1 + np.arange(n), np.arange(n)] = 1.0
            own[row, self.first] += p[self.second]  # rows differ: no entry meets twice
            own[row, self.second] += p[self.first]
            J[part, :, :, part] = powers[:, None, None] * own
        found = J.reshape(-1, q.size)
        if len(powers) == 1:
            return found
        bent = np.array([0.0, 1.0, 2 * x[-1]])
        return np.column_stack([found, np.outer(bent, self._of(q[0])).ravel()])

    def _split(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """q of each G, [A, numbers], and the powers of s."""
        size = len(self.bases) * self.count
        return x[:size].reshape(-1, self.count), np.append(x[size:], 0.0)[0] ** self.powers

    def _of(self, p: np.ndarray) -> np.ndarray:
        return np.concatenate([[1.0], p, p[self.first] * p[self.second]])

    def solve(self, R: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, dict[str, Any]]:
        """min ‖R c(q, s) − y‖ from G = 1, and what came out."""
        size = float(np.linalg.norm(y))
        if not size > 0:
            raise InputError("data: expected loads, got none")
        R, y = R / size, y / size
        numbers = len(self.bases) * self.count + len(self.powers) // 2
        bound = np.full(numbers, np.inf)
        bound[len(self.bases) * self.count :] = self.range
        found = least_squares(
            lambda q: R @ self.coefficients(q) - y,
            np.zeros(numbers),
            jac=lambda q: R @ self.slopes(q),
            bounds=(-bound, bound),
            xtol=CONVERGED,
            ftol=CONVERGED,
        )
        if np.linalg.svd(found.jac, compute_uv=False).min() < FELT:
            raise InputError(
                f"data: expected enough to tell {numbers} numbers apart; give more loads, "
                "shorter waves or fewer neighbours"
            )
        record = {"loss": float(np.sqrt(2 * found.cost)), "numbers": numbers}
        alone = R @ self.coefficients(np.zeros(numbers)) - y
        return found.x, record | {"loss_of_base": float(np.linalg.norm(alone)), "steps": found.nfev}

    def law(
        self,
        q: np.ndarray,
        units: Units,
        symmetry: Symmetry,
        turn: np.ndarray,
        record: dict[str, Any],
    ) -> DressedSolid:
        """The solid of these numbers, with its certificate."""
        tensors = np.tensordot(self._split(q)[0], self.dressing.basis, 1)
        s = float(q[-1]) if len(self.powers) > 1 else 0.0
        solid = DressedSolid(
            self.spacing, self.kind, self.elastic, self.dressing.steps, tensors, units, symmetry,
            turn, provenance={"fit": record}, dilatation=AXIS_WEIGHT + s,
        )  # fmt: skip
        return solid.certified()


@dataclass(frozen=True)
class Dressed:
    """L = Gᵗ K G: a positive base, its short waves lifted to the atoms' by G (theory, Dr).

    Attributes:
        base: "elements" (multilinear, any elastic tensor), or "bonds", which may break:
            1/r on eight bonds of isotropic sheets, up to three spacings of crystals (Dr28).
        neighbours: of G: 4, 8, 12 or 20 in the plane, 6, 18 or 26 in space.
        symmetry: name of the crystal's point group, or rotations.
        orientation: the crystal's axes in the coordinates of the points, columns of a rotation
            [d, d], or degrees; the points' own axis by default.
        moduli: "long waves" holds those that the longest waves of the fields have, a Voigt matrix
            (crystal's axes) [stress], shape [3, 3], in space [6, 6], its own; of isotropic sheets
            at a percent of strain or more the Smoothing of the data finds better ones (Dr20). They
            are never learned with G: left free they drift.
        split: a G for each part of the base (bulk, shear, …) in place of one.
        two_functions: learn an influence function of the dilatation too, one parameter more; of a
            base of bonds and one G. It keeps what is proven (Dr26).

    `fit` raises InputError for another base, or another number of neighbours.

    >>> wp.fit(samples, wp.Dressed("bonds", neighbours=4)).material.certificate.proven > 0
    True
    """

    base: str = "elements"
    neighbours: int = 8
    symmetry: Symmetry = "isotropic"
    orientation: Any = None
    moduli: Any = "long waves"
    split: bool = False
    two_functions: bool = False

    def poorer(self) -> Dressed:
        """The same law with the next smaller G; InputError where there is none."""
        known = next((known for known in REACH.values() if self.neighbours in known), {})
        fewer = [n for n in known if n < self.neighbours]
        if not fewer:
            raise InputError(f"neighbours: expected more than the fewest, got {self.neighbours}")
        return replace(self, neighbours=max(fewer))

    def learn(self, samples: Samples | Dataset, *, progress: bool | None = None) -> MaterialFit:
        """The fit; errors as of learning.fit. It takes a few steps, with no progress to show."""
        sets = one_set(samples)
        options = vars(self) | {
            "orientation": sets.axis if self.orientation is None else self.orientation
        }
        material = fit(sets, options.pop("base"), options.pop("neighbours"), **options)
        return MaterialFit(material, dict(material.provenance["fit"]))
