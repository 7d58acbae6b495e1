"""Solids that break, crystals among them: their numbers, and the fractions of bonds they need.

Theory.md, C1–C3: with w ≥ 0 the energy of a node is between d(d+2)μ/2 and d²κ/2 times
Σ w e²/r² whatever bonds are broken, κ = λ + 2μ/d; of a sheet 4μ and 2(λ+μ).
"""

from __future__ import annotations

import itertools
import warnings
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike
from scipy.optimize import lsq_linear

from warp_peri.core.elastic import compliance, from_voigt
from warp_peri.core.groups import lattice_group
from warp_peri.core.proof import largest
from warp_peri.core.record import Entry, Length, OnLinear, Positive, Record
from warp_peri.core.stencil import Stencil, in_half
from warp_peri.damage.lattice_body import LatticeBody
from warp_peri.damage.operator import SplitBonds, bond_weights, stiffness_across
from warp_peri.errors import InputError
from warp_peri.lps.model import Model, stencil_of
from warp_peri.points.families import BondClasses, bond_classes
from warp_peri.points.points import Points
from warp_peri.points.unit_names import USUAL, Units
from warp_peri.statics.direct import pivots, symmetric_factors

ROUNDING = 1e-12
"""Relative, of weights: below it a bond is without force, whatever its sign."""


def check_breakable(model: Model | CrystalBonds, classes: BondClasses) -> None:
    """Refuse a model whose bonds must not break (theory, C3).

    Raises InputError with what positive and negative bonds across a line carry, for an influence
    function that changes sign on the lattice, or two of them.
    """
    if isinstance(model, CrystalBonds):
        return
    w = bond_weights(model, classes)
    if (w >= -ROUNDING * np.abs(w).max()).all():
        return
    plus, minus = stiffness_across(model, classes)
    raise InputError(
        "model: its influence function changes sign on the lattice of spacing "
        f"{classes.spacing:g}: bonds across a line carry {plus:.4g} s² and {minus:.4g} s², and "
        "breaking some of them leaves energies below zero; bonds may break in a positive kernel "
        "(positive_kernel keeps its moduli)"
    )


def check_horizon(model: Model | CrystalBonds, body: LatticeBody) -> None:
    """Refuse a body whose bonds are not those of the model's ball."""
    if not np.isclose(body.classes.horizon, model.horizon, rtol=1e-9):
        raise InputError(
            f"body: expected the horizon {model.horizon:g}, got {body.classes.horizon:g}"
        )


def check_no_fail(no_fail: ArrayLike | None, count: int) -> np.ndarray:
    """Nodes whose bonds do not break, shape [N] bool; InputError for numbers or another shape."""
    safe = np.zeros(count, bool) if no_fail is None else np.asarray(no_fail)
    if safe.shape != (count,) or safe.dtype != bool:
        raise InputError(
            f"no_fail: expected shape [{count}] of bool, got {list(safe.shape)} of {safe.dtype}"
        )
    return safe


def energy_bounds(model: Model) -> tuple[float, float]:
    """Least and largest energy of a node over Σ w e²/r² of its unbroken bonds [stress] (C2)."""
    d = model.dimension
    shear = d * (d + 2) * model.mu / 2
    ends = shear, d * d / 2 * (model.lam + 2 * model.mu / d)
    return min(ends), max(ends)


def largest_stiffness(model: Model | CrystalBonds, classes: BondClasses) -> float:
    """A proven upper bound of Λmax L of every body on the lattice under any breaking (C9).

    max(μ, κ d / (d + 2)) max_k Λmax Γ(k), κ = λ + 2 μ/d, [stress / length²]; the model must be
    breakable. Of a crystal's bonds as (C29) says.
    """
    check_breakable(model, classes)
    if isinstance(model, CrystalBonds):
        return model.largest_stiffness(classes)
    w = bond_weights(model, classes)
    v = np.bincount(classes.bond_class, w) / classes.count
    d = model.dimension
    gamma = largest(stencil_of(classes, v, v, 0.0), lattice_group(d))
    return energy_bounds(model)[1] / (d * (d + 2) / 2) * gamma


def breaking_time_step(model: Model | CrystalBonds, classes: BondClasses, density: float) -> float:
    """Time step below which velocity Verlet is stable under any breaking (C9)."""
    return float(2 * np.sqrt(density / largest_stiffness(model, classes)))


def negative_eigenvalues(matrix: sp.sparray) -> int:
    """How many eigenvalues of the symmetric part of a sparse matrix are below zero.

    By the signs of LDLᵗ (Sylvester's law of inertia), the factors without exchange of rows.

    Raises InputError for a singular matrix, as of a body that moves freely.
    """
    symmetric = sp.csc_matrix((matrix + matrix.T) / 2)
    try:
        factors = symmetric_factors(symmetric)
    except RuntimeError as error:
        raise InputError(f"operator: it is singular ({error})") from None
    signed = pivots(factors)
    if signed is None:
        raise InputError("operator: a pivot is zero; its eigenvalues cannot be counted by signs")
    return int(np.count_nonzero(signed < 0))


def check_cut(matrix: sp.sparray) -> None:
    """Refuse a cut operator with eigenvalues below zero, naming how many there are."""
    count = negative_eigenvalues(matrix)
    if count:
        raise InputError(
            f"crack: the operator with these bonds cut has {count} negative eigenvalues; a model "
            "that changes sign does not carry this crack (positive_kernel keeps its moduli)"
        )


CRITERIA = ("toughness", "critical_stretch", "critical_energy")


@dataclass(frozen=True, eq=False, repr=False)
class BrittleSolid(OnLinear, format="warp_peri.brittle_solid", version=2):
    """What breaks, and when.

    Attributes:
        model: moduli and a positive influence function, the same for the dilatation.
        density: ρ, mass per volume.
        toughness: G_c [stress · length]; the lattice's critical stretch follows from it (C6).
        critical_stretch: s₀ itself, instead of G_c.
        critical_energy: energy density of a bond over its quadrature weight at which it breaks
            [stress / length^d], instead of both (C8).
        tension_only: bonds in compression do not break.

    Raises InputError unless exactly one of the three criteria is given and all numbers are > 0.
    """

    model: Model
    density: Annotated[float, Entry(length=-2, stress=1, positive=True)]
    toughness: Annotated[float | None, Entry(length=1, stress=1, positive=True)] = None
    critical_stretch: Annotated[float | None, Entry(positive=True)] = None
    critical_energy: Annotated[float | None, Entry(stress=1, volume=-1, positive=True)] = None
    tension_only: bool = True

    def __post_init__(self) -> None:
        super().__post_init__()
        given = [name for name in CRITERIA if getattr(self, name) is not None]
        if len(given) != 1:
            names = ", ".join(given) or "none"
            raise InputError(f"criterion: expected one of {', '.join(CRITERIA)}, got {names}")

    @property
    def linear(self) -> Model:
        """The solid before anything breaks."""
        return self.model

    def longest_step(self, spacing: float) -> float:
        """Time step on a lattice that is stable whatever breaks (theory, C9)."""
        classes = bond_classes(spacing, self.model.horizon, dimension=self.dimension)
        return breaking_time_step(self.model, classes, self.density)

    @property
    def by_energy(self) -> bool:
        """Whether bonds break by their energy instead of their stretch."""
        return self.critical_energy is not None

    @classmethod
    def today(cls, content: dict[str, Any]) -> dict[str, Any]:
        """Files of version 1 kept neither units nor records of the model: it is in Å and TPa."""
        if content.get("version") != 1:
            return content
        warnings.warn("it names no units: taken as Å and TPa", stacklevel=3)
        names = {"lam": "lambda", "mu": "mu", "alpha": "alpha", "D": "D", "horizon": "horizon"}
        if missing := [key for key in names.values() if key not in content]:
            raise InputError(f"missing keys: {', '.join(missing)}")
        model = Model(**{name: content.pop(key) for name, key in names.items()})
        return content | {"version": cls.VERSION, "model": model.content()}


EVEN = 0.2
"""Weight of one critical stretch for all bonds beside the energies of planes."""
NEARLY = 1e-3
"""Weight of evenness beside what stiffnesses are to sum up to, before its part is taken off."""
SAME = 1e-6
"""Relative, of moduli that are one."""


def _nearest(
    rows: np.ndarray, y: np.ndarray, least: float, even: float, spare: np.ndarray | None = None
) -> np.ndarray:
    """x of min ‖rows x − spare z − y‖² + even² mean (x − 1)², over x ≥ least and z ≥ 0."""
    count = len(rows.T)
    spare = np.zeros((len(y), 0)) if spare is None else spare
    weight = even / np.sqrt(count) * np.eye(count, count + len(spare.T))
    both = np.vstack([np.hstack([rows, -spare]), weight])
    wanted = np.concatenate([y, weight.sum(axis=1)])
    lowest = np.where(np.arange(len(both.T)) < count, least, 0.0)
    return np.asarray(lsq_linear(both, wanted, (lowest, np.inf), tol=ROUNDING).x[:count])


@dataclass(frozen=True, eq=False, repr=False)
class CrystalBonds(Record, format="warp_peri.crystal_bonds"):
    """A linear solid of any plane tensor, or of a cubic crystal in space, whose bonds may break.

    The bonds carry a tensor that is symmetric in all indices, a dilatation carries the rest (C28).
    Whatever is broken, the energy is a sum of squares.

    Attributes:
        elastic: Voigt matrix [stress] along the nodes' axes, 3 × 3 or 6 × 6.
        horizon: δ [length], of three spacings or so.
        units: names of the units of length and stress.

    Raises InputError for a crystal that is not stable, and one whose C_iijj − C_ijij differ.
    """

    elastic: Annotated[np.ndarray, Entry(stress=1)]
    horizon: Length
    units: Units = USUAL

    def __post_init__(self) -> None:
        super().__post_init__()
        compliance(self.tensor())
        self._split()

    @property
    def dimension(self) -> int:
        """2 or 3."""
        return 2 if len(self.elastic) == 3 else 3

    @property
    def linear(self) -> CrystalBonds:
        """Itself."""
        return self

    def tensor(self) -> np.ndarray:
        """C_ijkl along the nodes' axes [stress], shape [d, d, d, d]."""
        return from_voigt(self.elastic)

    def check_dimension(self, points: Points) -> None:
        """Raise InputError for points of another dimension."""
        if points.x.shape[1] != self.dimension:
            raise InputError(
                f"points: expected {self.dimension} dimensions, the crystal's, got shape "
                f"{list(points.x.shape)}"
            )

    def _split(self) -> tuple[np.ndarray, float]:
        """C − x δ δ, symmetric in all indices, and x."""
        C, d = self.tensor(), self.dimension
        pairs = list(itertools.combinations(range(d), 2))
        x = float(np.mean([C[i, i, j, j] - C[i, j, i, j] for i, j in pairs]))
        S = C - x * np.einsum("ij,kl->ijkl", np.eye(d), np.eye(d))
        even = (S + S.transpose(0, 2, 1, 3) + S.transpose(0, 3, 2, 1)) / 3
        if np.abs(S - even).max() > SAME * np.abs(C).max():
            raise InputError(
                "elastic: expected C_iijj − C_ijij alike for all axes, as of sheets and of cubic "
                "crystals; of others bonds and a dilatation do not make the tensor"
            )
        return even, x

    def bonds(self, classes: BondClasses) -> SplitBonds:
        """Stiffness, share in the dilatation, and excess, of the bonds of a ball.

        Raises InputError for a tensor that no bonds of the ball have, all of them pulling.
        """
        S, excess = self._split()
        d, xi, r = self.dimension, classes.xi, classes.r[classes.bond_class]
        index = list(itertools.combinations_with_replacement(range(d), 4))
        A = np.array([np.prod(xi[:, one], axis=1) for one in index])
        y, size = np.array([S[one] for one in index]), np.abs(S).max()
        prior = np.maximum(classes.weight[classes.bond_class], 0) / r**3  # K(r) = 1/r
        prior *= np.einsum("iijj", S) / (prior @ r**4)
        rows, wanted = A * prior / size, y / size
        share = _nearest(rows, wanted, 0.0, NEARLY)
        felt = rows * (share > NEARLY)
        better = share + np.linalg.lstsq(felt, wanted - rows @ share, rcond=None)[0]
        found = prior * (better if (better >= 0).all() else share)
        if np.abs(A @ found - y).max() > SAME * np.abs(y).max():
            raise InputError(
                f"elastic: no bonds up to {classes.horizon:g} on a lattice of spacing "
                f"{classes.spacing:g} have it, all of them pulling; take a longer horizon"
            )
        stretch = np.einsum("ijkk->ij", compliance(S))  # what unit pressure of the bonds does
        return SplitBonds(found, found * np.einsum("bi,ij,bj->b", xi, stretch, xi), excess)

    def largest_stiffness(self, classes: BondClasses) -> float:
        """A proven upper bound of Λmax L of every body under any breaking (C29)."""
        found, _, excess = self.bonds(classes)
        xi, half = classes.xi, in_half(classes.steps)
        tensors = 2 * found[half, None, None] * xi[half, :, None] * xi[half, None]
        stencil = Stencil(classes.spacing, classes.steps[half], tensors)
        group = [g for g in lattice_group(self.dimension) if stencil.asymmetry(g[None]) < SAME]
        soft = float(np.einsum("iijj", compliance(self._split()[0])))
        return max(1.0, 1 + excess * soft) * largest(stencil, np.array(group))


@dataclass(frozen=True, eq=False, repr=False)
class BrittleCrystal(OnLinear, format="warp_peri.brittle_crystal"):
    """A crystal whose bonds break at a stretch by direction, from the energies of its faces (C30).

    Attributes:
        model: the crystal before anything breaks.
        density: ρ, mass per volume.
        normals: of planes, along the nodes' axes, of any length, shape [P, d], the second axis
            among them; equivalent planes are to be named each.
        energies: of both faces of these planes over their area, 2γ [stress · length], shape [P].
        spent: what a growing crack spends over the energies of its faces (C7), which
            apparent_toughness measures.
        tension_only: bonds in compression do not break.

    Raises InputError for planes without normal or energy.
    """

    model: CrystalBonds
    density: Annotated[float, Entry(length=-2, stress=1, positive=True)]
    normals: np.ndarray
    energies: Annotated[np.ndarray, Entry(length=1, stress=1)]
    spent: Positive = 1.0
    tension_only: bool = True
    by_energy = False

    def __post_init__(self) -> None:
        super().__post_init__()
        d, size = self.model.dimension, np.linalg.norm(self.normals, axis=-1)
        if self.normals.shape != (len(self.energies), d) or not len(size) or not (size > 0).all():
            raise InputError(
                f"normals: expected one of {d} numbers, not all zero, for each of "
                f"{len(self.energies)} energies, got shape {list(self.normals.shape)}"
            )
        if not (self.energies > 0).all():
            raise InputError(f"energies: expected numbers > 0, got {self.energies.min():g}")
        object.__setattr__(self, "normals", self.normals / size[:, None])
        if not np.abs(self.normals[:, 1]).max() > 1 - SAME:
            raise InputError(
                "normals: expected the second axis among them, across which cracks run"
            )

    @property
    def linear(self) -> CrystalBonds:
        """The solid before anything breaks."""
        return self.model

    @property
    def toughness(self) -> float:
        """2γ of the plane across the second axis [stress · length]."""
        return float(self.energies[np.abs(self.normals[:, 1]).argmax()])

    def longest_step(self, spacing: float) -> float:
        """Time step on a lattice that is stable whatever breaks (theory, C9)."""
        classes = bond_classes(spacing, self.model.horizon, dimension=self.dimension)
        return breaking_time_step(self.model, classes, self.density)

    def stretches(self, classes: BondClasses) -> np.ndarray:
        """Critical stretch of each bond of a ball, shape [B]; inf of one without force.

        As near to one stretch as the energies let it be; a cut between node rows across the second
        axis spends its own 2γ, the dilatation's part included.
        """
        found, share, excess = self.model.bonds(classes)
        omega, r2 = self._bond_energies(classes, found), classes.r[classes.bond_class] ** 2
        live = found > ROUNDING * found.max()
        e = np.sqrt(np.where(live, omega, 0) / np.where(live, found, 1))
        rows = classes.steps[:, 1]
        crossing = [np.sum((share * e)[rows > k]) for k in range(int(rows.max()))]
        cut = np.sum((rows * omega)[rows > 0]) + excess * np.square(crossing).sum()
        even = np.sqrt(self.toughness / (classes.spacing * cut * self.spent))
        return np.asarray(np.where(live, even * e / r2, np.inf))

    def _bond_energies(self, classes: BondClasses, stiffness: np.ndarray) -> np.ndarray:
        """ω [stress] of the bonds of a ball, Σ |n·ξ| ω / 2 ≥ 2γ(n), or nearly (C30), shape [B]."""
        even = stiffness * classes.r[classes.bond_class] ** 4
        each = np.abs(self.normals @ classes.xi.T) / 2 * even / self.energies[:, None]
        own = np.abs(self.normals[:, 1]).argmax()
        each /= each[own].sum()
        others = np.delete(np.eye(len(each)), own, axis=1)  # by how much these cost more
        share = _nearest(each, np.ones(len(each)), 1.0, EVEN, spare=others)
        return np.asarray(even * share)


def positive_kernel(model: Model, horizon: float) -> Model:
    """λ and μ of a model with K = 1/r, which has them exactly on every lattice (C7).

    This is how a model whose influence function changes sign goes to fracture.
    """
    return Model(
        model.lam, model.mu, 1.0, np.ones(1), horizon, units=model.units, dimension=model.dimension
    )


def continuum_stretch(model: Model, toughness: float) -> float:
    """s₀ of the continuum for a toughness G_c (theory, C5, V5), N. Trask and others 2019.

    In three dimensions G_c is energy over the area of the crack. λ = μ is the bond-based solid.
    """
    lam, mu = model.lam, model.mu
    if model.dimension == 3:
        unit = (3 * mu + (3 / 4) ** 4 * (lam - mu)) * model.horizon
    else:
        unit = (6 * mu / np.pi + 16 / (9 * np.pi**2) * (lam - mu)) * model.horizon
    return float(np.sqrt(toughness / unit))
