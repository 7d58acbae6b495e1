"""Hyperelastic materials and their lattice operators: force, energy, tangent. torch differentiates
energies by what they see, bonds carry that to their ends."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import compress
from typing import Annotated, Any, ClassVar

import numpy as np
import scipy.sparse as sp
import torch
from numpy import ndarray
from numpy.linalg import lstsq
from numpy.typing import ArrayLike
from scipy.sparse.linalg import LinearOperator
from torch.autograd import grad

from warp_peri.core.record import FieldUnits, Length, Record
from warp_peri.core.torch_bridge import FEW, Swept, own_torch
from warp_peri.errors import InputError, Rows, Values, warn
from warp_peri.fitting.evaluate import errors_of, residuals
from warp_peri.fitting.regression import norms
from warp_peri.fitting.result import LOUD
from warp_peri.materials.hyperelastic.energies import Energy, Hyperelastic, Strain
from warp_peri.materials.hyperelastic.lattice import SMALLEST_AREA, SheetLattice, Sites, softest
from warp_peri.points import arguments
from warp_peri.points.arguments import USUAL, Numbers, Units, checked, plain, shown_moduli, symbols
from warp_peri.points.dataset import seen_of, warn_of_unseen
from warp_peri.points.points import PointsLike, Samples
from warp_peri.protocols import renumbered
from warp_peri.runtime import one_thread
from warp_peri.solvers.equilibria import Descent, Inner, equilibria_of
from warp_peri.solvers.solution import TOLERANCE, Solution, Solver
from warp_peri.solvers.systems import end_of_spectrum, smallest_eigenvalue

BEYOND = 1.1
"""Stretches less one above this many times those of the training data are worth a warning."""
EXPLAINED = 1e-8
"""Part of the loads that a fit has to explain: less is rounding."""
MOST_SHOWN = 8
"""Energies that a solid shows of itself."""


@dataclass(frozen=True, eq=False)
class HyperelasticMaterial(Record, format="warp_peri.hyperelastic", version=2):
    """A hyperelastic material: a dictionary of energies with its coefficients.

    Attributes:
        dictionary: the energies.
        coefficients: one for each [stress], shape [K].
        spacing: of the lattice it was learned on [length]; others take the same coefficients.
        stretch: largest nodal stretch of the data it was learned from, if known.
        provenance: of data and fit; `stresses` says where they are scaled, in no unit.
        units: names of the units of length and stress that it is in, those of its data.

    Raises InputError for coefficients of another number or not finite, and units not known.
    """

    dictionary: Annotated[Hyperelastic, FieldUnits(flat=True)]
    coefficients: Annotated[ndarray, FieldUnits(stress=1)]
    spacing: Length
    stretch: Annotated[float | None, FieldUnits(positive=True)] = None
    provenance: Values = field(default_factory=dict)
    units: Units = USUAL
    dimension: ClassVar[int] = 2

    def __post_init__(self) -> None:
        super().__post_init__()
        checked("coefficients", self.coefficients, shape=(len(self.dictionary),))

    @property
    def sparse(self) -> HyperelasticMaterial:
        """The material without the strain energies whose coefficient is zero."""
        first, c = self.dictionary.first_term, self.coefficients
        terms = [*compress(self.dictionary.terms, c[first:])]
        values = np.append(c[:first], c[first:][c[first:] != 0])
        return replace(self, dictionary=self.dictionary.with_terms(terms), coefficients=values)

    def on(
        self, points: PointsLike, *, thickness: ndarray | None = None
    ) -> HyperelasticSheetOperator:
        """Build the operator on a lattice; thickness of each node [N] or an even sheet (H18)."""
        return HyperelasticSheetOperator(self, points, thickness=thickness)

    def elsewhere(self, length: float, stress: float) -> Values:
        """Provenance naming the units that its records stay in."""
        own = self.provenance
        return {"provenance": own | {"units_before": list(self.units)} | own}

    def rows(self) -> Rows:
        """Name and value of each line of the material's table, the largest energies first."""
        stretch = "not known" if self.stretch is None else f"up to {self.stretch:.3g}"
        rows = [("learned on", f"{self.spacing:g} {symbols(self.units)[0]}")]
        rows += [("stretch of the data", stretch), ("energies", f"{len(self.dictionary)}")]
        if scaled := self.provenance.get("stresses"):  # where no force says what they are in
            rows.append(("stresses", str(scaled)))
        energies = self.dictionary.energies
        for n in np.argsort(-np.abs(self.coefficients))[:MOST_SHOWN]:
            if value := self.coefficients[n]:
                shown = f"{value:.4g}" if scaled else shown_moduli(self.units, (value,))
                rows.append((energies[n].label, shown))
        return rows

    @property
    def horizon(self) -> float:
        """Horizon δ on the lattice of the training data [length]."""
        return self.dictionary.reach * self.spacing


def check_explained(residual: float) -> None:
    """Warn of a fit that leaves much of the loads; InputError where it leaves them all, or more."""
    said = f"{100 * residual:.3g} % of the loads are left"
    if residual > 1 - EXPLAINED:
        raise InputError(
            f"samples: expected loads that the energies explain, {said}; are the signs of u and b "
            "right, and stiffness and start not too large?"
        )
    if residual > LOUD:
        warn(f"residual: {said}, above {100 * LOUD:g} %: do other energies describe the sheet?")


Active = list[tuple[Sites, list[Energy]]]
"""Energies by what they see."""


class HyperelasticSheetOperator(Swept):
    """A hyperelastic material on a lattice; forces per reference volume, (H8), at thickness one.

    Args:
        model: the material.
        points: a lattice whose interior has the 2δ collar.
        thickness: of every node, > 0, shape [N]; an even sheet where none is given, (H18).

    Raises InputError for points that are no lattice, in other units, or whose collar is too narrow,
    and a thickness that is not positive. Its `learnable` numbers are the coefficients [stress].
    """

    parts = 9  # bonds, of which a site sees three numbers

    def __init__(
        self, model: HyperelasticMaterial, points: PointsLike, *, thickness: ndarray | None = None
    ) -> None:
        self.points = model.own_nodes(points)
        self.lattice = SheetLattice(self.points, model.dictionary.reach)
        self.interior, self.lift = self.lattice.interior, self.lattice.lift
        self.rough = self.lattice.rough
        if thickness is not None:
            thickness = checked("thickness", thickness, float, (len(self.points.x),)).copy()
            if not thickness.min() > 0:
                raise InputError("thickness: expected finite numbers > 0")
        self._take(model, thickness)

    def _take(self, model: HyperelasticMaterial, thickness: ndarray | None) -> None:
        self.model, self.thickness = model, thickness
        self.learnable, self._last = {"coefficients": model.coefficients}, None
        self.active = self._energies(model.coefficients)
        self.size = max((sites.S.nnz for sites, _ in self.active), default=1)

    def changed(
        self, model: HyperelasticMaterial, thickness: ndarray | None
    ) -> HyperelasticSheetOperator:
        """The operator of another material of the same reach, or thickness, on the same lattice."""
        kind = type(self)
        other = kind.__new__(kind, model, self.points, thickness=thickness)
        vars(other).update(vars(self) | {"_made_of": other._made_of})
        other._take(model, thickness)
        return other

    def _energies(self, c: ndarray) -> Active:
        """The energies whose coefficient is not zero."""
        found = defaultdict[Any, list[Energy]](list)
        for number, energy in enumerate(self.model.dictionary.energies):
            one = energy._replace(number=number, coefficient=float(c[number]))
            for sees in energy.sees if c[number] else ():
                found[sees].append(one)
        return [(self.lattice.sites(*sees), each) for sees, each in found.items()]

    def _stored(self, sites: Sites, each: Any, q: torch.Tensor) -> torch.Tensor:
        """Energy of every site over h², shape [n, S]."""
        E = Strain(q)
        total = sum(e.share(E) for e in each)
        if self.thickness is not None:
            total = torch.from_numpy(self.thickness[sites.pair].mean(axis=0)[:, None]) * total
        return torch.as_tensor(total)

    def _slope(self, sites: Sites, each: Any, q: torch.Tensor, graph: bool = False) -> torch.Tensor:
        """∂U/∂q over h², shape [Q, n, S]; with a graph of q, which becomes a leaf."""
        return grad(self._stored(sites, each, q.requires_grad_()).sum(), q, create_graph=graph)[0]

    def _tension(self, e: ndarray, active: Active) -> ndarray:
        """Tension of bonds e [pairs, S] by the energies, over ξ + η."""
        return sum((s.pull(self._slope(s, each, s.seen(e))) for s, each in active), 0 * e)

    def strain(self, u: ArrayLike) -> ndarray:
        """Nodal Green strain E11, E22, 2 E12, (H3), shape [..., N, 3]; zero near the edge."""
        sites = self.lattice.sites()

        def sweep(u: ndarray) -> ndarray:
            E = np.zeros((*u.shape[:2], 3))
            E[:, sites.pair[0]] = sites.seen(self.lattice.stretched(u)[1]).permute(2, 1, 0)
            return E

        return self._swept(sweep, u)

    def largest_stretch(self, u: ArrayLike) -> float:
        """Largest principal stretch of the nodal strain in fields u [length]."""
        x, y, shear = np.moveaxis(self.strain(u), -1, 0)
        return float(np.sqrt(1 + x + y + np.hypot(x - y, shear)).max())

    def folds(self, u: ndarray) -> float:
        """Number of energy corners at interior nodes that a field [N, 2] turns over, unseen by
        functions of C; infinite where the nodal strain folds, its det C below SMALLEST_AREA."""
        Y, e = self.lattice.stretched(self._one(u)[None])
        if not Strain(self.lattice.sites().seen(e)).area.min() > SMALLEST_AREA:
            return np.inf
        sides = [(s.S @ Y[..., 0]).reshape(3, -1, 2) for s, _ in self.active if s.corner]
        return sum(int((x[:, 0] * y[:, 1] <= x[:, 1] * y[:, 0]).sum()) for x, y, _ in sides)

    def nodal_energy(self, u: ArrayLike) -> ndarray:
        """Energy of every node and the bonds that begin there, over h², shape [..., N]."""

        def sweep(u: ndarray) -> ndarray:
            e, total = self.lattice.stretched(u)[1], np.zeros(u.shape[:2])
            for sites, each in self.active:
                total[:, sites.pair[0]] += self._stored(sites, each, sites.seen(e)).numpy().T
            return total

        return self._swept(sweep, u)

    def energy(self, u: ArrayLike) -> ndarray:
        """Elastic energy U, (H1) [stress · area], shape [...], up to the collar's own part."""
        return np.asarray(self.nodal_energy(u).sum(axis=-1) * self.points.spacing**2)

    def everywhere(self, u: ArrayLike) -> ndarray:
        """Force at all nodes: derivative of U by displacement over h², (H8), shape [..., N, 2]."""

        def sweep(u: ndarray) -> ndarray:
            Y, e = self.lattice.stretched(u)
            return self.lattice.at_ends(self._tension(e, self.active)[:, None] * Y)

        return self._swept(sweep, u)

    def force(self, u: ArrayLike) -> ndarray:
        """Force on the interior nodes [stress / length], shape [..., I, 2]."""
        return self.everywhere(u)[..., self.interior, :]

    def _curved(self, u: ndarray) -> Any:
        """Deformed bonds and their tension at fields, and of each energy ∂²U/∂q² over h², [Q, Q, n,
        S]; kept of the last fields, whose products follow one another."""
        last = self._last
        if last is None or not np.array_equal(last[0], u):
            Y, e = self.lattice.stretched(u)
            tension, curves = 0 * e, []
            for sites, each in self.active:
                stress = self._slope(sites, each, q := sites.seen(e), graph=True)
                tension += sites.pull(stress.detach())
                rows = [grad(s.sum(), q, retain_graph=True)[0].numpy() for s in stress]
                curves.append(np.stack(rows))
            last = self._last = u.copy(), Y, tension, curves  # type: ignore[assignment]
        return last[1:]

    def _product(self, u: ArrayLike, v: ArrayLike) -> ndarray:
        """K v, the derivative of the force along v, (H10), on all nodes, shape [..., N, 2]."""

        def sweep(u: ndarray, v: ndarray) -> ndarray:
            (Y, tension, curves), away = self._curved(u), self.lattice.differences(v)
            along, all_of = np.einsum("pas,pas->ps", Y, away), zip(self.active, curves)
            pulls = (s.pull((H * s.seen(along).numpy()).sum(axis=1)) for (s, _), H in all_of)
            return self.lattice.at_ends(
                tension[:, None] * away + sum(pulls, 0 * tension)[:, None] * Y
            )

        return self._swept(sweep, u, v)

    def jvp(self, u: ArrayLike, v: ArrayLike) -> ndarray:
        """Derivative of the force at u along v, shape [..., I, 2]."""
        return self._product(u, v)[..., self.interior, :]

    def vjp(self, u: ArrayLike, w: ArrayLike) -> ndarray:
        """Transposed tangent, which is symmetric, times w, on all nodes [..., N, 2]."""
        return self._product(u, self.on_all(w))

    def _one(self, u: Any) -> ndarray:
        """One field [N, 2], which may have run away; InputError for others."""
        arguments.check_shape("u", field := plain("u", u), self.shape)
        return field

    def interior_tangent(self, u: ndarray) -> sp.csr_array:
        """Tangent between interior nodes at a field (H10), sparse [2 I, 2 I]."""
        with own_torch(), one_thread(3 * len(self.points.x) < FEW):
            Y, tension, curves = self._curved(self._one(u)[None])
        if not curves:
            raise InputError("coefficients: expected one other than 0")
        inner, both = self.lattice.ends[self.interior], zip(Y[..., 0].T, np.eye(2)[:, None])
        by_u = sum(sp.kron(sp.diags_array(y) @ inner.T, axis) for y, axis in both)
        blocks = ([[sp.diags_array(h) for h in row] for row in H[..., 0]] for H in curves)
        H = sp.block_diag([sp.block_array(each) for each in blocks], format="csr")
        B = sp.vstack([sites.S for sites, _ in self.active], format="csr") @ by_u.tocsr()
        turned = inner @ sp.diags_array(tension[:, 0]) @ inner.T
        return B.T.tocsr() @ (H @ B) + sp.kron(turned, np.eye(2), format="csr")

    def factors(self, u: ndarray, shifts: bool = False) -> tuple[Inner | None, bool]:
        """Inverse of the tangent at a field; see SheetLattice.factors."""
        return self.lattice.factors(self.interior_tangent(u), shifts)

    def smallest_eigenvalue(self, u: ndarray) -> float:
        """Smallest eigenvalue of the tangent between interior nodes at u [stress / length²]; where
        not factorised a number of that sign, no larger if positive."""
        size, u = 2 * len(self.interior), checked("u", u, float, self.shape)
        if self.rough is None:
            if inverse := self.factors(u)[0]:
                return softest(size, inverse, 1e-3)
            return smallest_eigenvalue(self.interior_tangent(u))  # nearest to zero may be another

        def flat(apply: Inner) -> LinearOperator:
            of_flat = lambda p: apply(p.reshape(-1, 2)).ravel()  # noqa: E731
            return LinearOperator((size, size), of_flat, dtype=float)

        K, Minv = flat(lambda p: self.jvp(u, self.on_all(p))), flat(self.rough)
        L = sp.kron(self.lattice.laplacian[:, self.interior], sp.eye(2)).tocsr()
        ratio = end_of_spectrum(K, "SA", M=L, Minv=Minv, tol=1e-2, maxiter=2000)
        return softest(size // 2, self.rough, 1e-4) * ratio

    def features(self, u: ArrayLike, moving: Sequence[int] = ()) -> ndarray:
        """Derivatives of the force by all coefficients, then by angles and exponents of the fibres
        at M indices, shape [..., I, 2, K + 2 M]."""
        K, fibres = len(self.model.dictionary), list(moving)
        every = self._energies(np.ones(K))
        chosen = [(s, e, "coefficient", e.number) for s, each in every for e in each]
        for s, e in ((s, e) for s, each in self.active for e in each if e.number in fibres):
            column = K + fibres.index(e.number)
            chosen += [(s, e, "angle", column), (s, e, "exponent", column + len(fibres))]

        def sweep(u: ndarray) -> ndarray:
            Y, e = self.lattice.stretched(u)
            forces = np.zeros((len(u), len(self.interior), 2, K + 2 * len(fibres)))
            for sites, energy, by, column in chosen:
                q = sites.seen(e).requires_grad_()
                value = torch.tensor(getattr(energy, by), dtype=q.dtype, requires_grad=True)
                number: Any = {by: value}
                stored = self._stored(sites, [energy._replace(**number)], q).sum()
                (slope,) = grad(stored, value, create_graph=True)
                tension = sites.pull(grad(slope, q)[0])
                forces[..., column] += self.lattice.at_ends(tension[:, None] * Y)[:, self.interior]
            return forces

        return self._swept(sweep, u)

    def by_thickness(self, u: ArrayLike, slopes: ndarray) -> ndarray:
        """Derivative of the force by P thickness numbers, [..., I, 2, P]; slopes [N, P]."""
        sheets = (self.changed(self.model, each) for each in slopes.T)
        return np.stack([sheet.force(u) for sheet in sheets], axis=-1)

    def at(self, numbers: Numbers) -> HyperelasticSheetOperator:
        """The operator with other coefficients, on the same lattice."""
        made = renumbered(self.learnable, numbers)
        return self.changed(replace(self.model, **made, provenance={}), self.thickness)

    def by_numbers(self, name: str, u: ndarray, w: ndarray) -> ndarray:
        """Derivatives of Σ w · force(u) by the coefficients [K], for fields [S, N, 2]."""
        u, w = self.pairs(u, w)
        return np.tensordot(w, self.features(u), 3)

    def stress(self, u: ArrayLike) -> ndarray:
        """First Piola stress P = ½ Σ t (ξ + η)⊗ξ of a node's bonds, (H16), shape [..., I, 2, 2], of
        an uneven sheet over a thickness of one; corners carry theirs at their apex."""
        ends, nodal = abs(self.lattice.ends) / 2, [(s, e) for s, e in self.active if not s.corner]

        def sweep(u: ndarray) -> ndarray:
            Y, e = self.lattice.stretched(u)
            bonds = Y[:, :, None] * self.lattice.xi[:, None, :, None]  # (ξ + η)⊗ξ
            pull = self._tension(e, nodal)[:, None, None] * bonds
            P = (ends @ pull.reshape(len(e), -1)).reshape(-1, *pull.shape[1:])
            for sites, each in self.active:
                if sites.corner:
                    slope = self._slope(sites, each, sites.seen(e)).numpy()
                    moments = (sites.S @ bonds.reshape(len(e), -1)).reshape(3, -1, *P.shape[1:])
                    P[sites.pair[0]] += (slope[:, :, None, None] * moments).sum(axis=0)
            return np.asarray(np.moveaxis(P, -1, 0)[:, self.interior])

        return self._swept(sweep, u)

    def warn_beyond(self, u: ndarray) -> None:
        """Warn when fields are stretched beyond the data that the solid was learned from."""
        known = self.model.stretch
        if known and len(u) and (largest := self.largest_stretch(u)) - 1 > BEYOND * (known - 1):
            warn(
                f"stretch: the fields reach {largest:.4g}, the training data {known:.4g}: "
                "nothing is known of the material beyond"
            )

    def solve(self, b: ArrayLike | None, u: ArrayLike, solver: Solver = None) -> Solution:
        """Stable equilibrium under a load, displacement given on the collar.

        b [stress/length], None for no load, and u have shape [N, 2] or [S, N, 2]; the solver is
        Newton(tolerance); the solution's details are a NonlinearRecord for each sample. Warns of
        stretches beyond the training data. Raises NoEquilibriumError where none was found, naming
        the sample; InputError for arrays that do not fit.
        """
        solution = equilibria_of(self, b, u, solver, Descent(self))
        self.warn_beyond(solution.u)
        return solution

    def errors(self, samples: Samples, near: ndarray | None = None) -> Values:
        """Relative ℓ2 errors on the interior, (30) and (31), of samples on the operator's points.

        `near` are fields of other loads, shape [M, N, 2]: each search begins at their combination
        that fits its collar best, at rest where none are given. Returns, as `evaluate` does, E_res
        where there are loads and E_u, None of samples that were not solved; not_solved, the number
        of these, and left_branch, the number of those that another branch may hold. Warns of
        stretches beyond the training data.
        """
        told, found, start, inverse = Values(), [], None, None
        loads = (np.zeros_like(samples.u) if samples.b is None else samples.b)[:, self.interior]
        if samples.b is not None:
            warn_of_unseen(samples)
            told = errors_of("E_res", residuals(self, samples.u, loads), norms(loads))
        for u, b in zip(samples.u, loads):
            if near is not None:
                # the fields that fit u on the collar best, and the lift of what they miss
                given, collar = near[:, ~self.points.interior], u[~self.points.interior].ravel()
                start = np.tensordot(lstsq(given.reshape(len(near), -1).T, collar)[0], near, 1)
                start = start + self.lift(u - start)
                inverse = None if self.rough else self.factors(start)[0]
            found.append(Descent(self).find(b, u, TOLERANCE, start, inverse))
        there = np.array([record.converged for _, record in found])
        fields = np.where(there[:, None, None], [u for u, _ in found], np.nan)
        gaps, seen = fields - samples.u, seen_of(samples)[..., None]
        gaps, u = (each[:, self.interior] for each in (gaps * seen, samples.u * seen))
        told |= errors_of("E_u", norms(gaps), norms(u))
        self.warn_beyond(fields[there])
        return told | {
            "not_solved": int((~there).sum()),
            "left_branch": sum(not one.followed for _, one in found if one.converged),
        }
