"""Forces of cut bodies in torch, and bodies with softening bonds under slow loads (C16)."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from typing import Any

import numpy as np
import scipy.sparse as sp
import torch
from numpy import ndarray
from numpy.linalg import norm
from numpy.typing import ArrayLike
from scipy.sparse.linalg import splu
from tqdm import tqdm

from warp_peri.core.torch_bridge import linear, once, with_numbers
from warp_peri.core.torch_bridge import real as real
from warp_peri.errors import InputError, warn
from warp_peri.fracture.body import LatticeBody, cracked, crossing_bonds, size_and_normal
from warp_peri.fracture.bonds import bonds_of, check_breakable, stretch_matrix, stretch_rows
from warp_peri.fracture.materials import BondLaw, pull_of, share_of, slope_of
from warp_peri.fracture.statics import check_no_fail, check_pieces, strain_of
from warp_peri.materials.lps import LPSMaterial
from warp_peri.materials.lps_stages import class_weights
from warp_peri.points.arguments import NotNegative, Numbers, checked, is_tensor
from warp_peri.protocols import renumbered
from warp_peri.solvers.adjoint import in_motion as in_motion
from warp_peri.solvers.motion import Motion
from warp_peri.solvers.systems import definite_factors, symmetric_factors

NEWTON = 40
TOLERANCE = 1e-8
SETTLED = 0.01
"""Change of a bond's share of its pull below which damage counts as at rest."""


def bond_force(
    model: LPSMaterial,
    body: LatticeBody,
    neighbour: ndarray,
    u: torch.Tensor,
    numbers: Numbers,
    pressure: Any = 0.0,
) -> torch.Tensor:
    """Force L u of (C4) on all nodes, [S, N, d], with other parameters; has every derivative.

    numbers: lam, mu, alpha and D as tensors. pressure: additional stress at nodes that resists a
    dilatation [stress], shape [S, N].
    """
    u, numbers = u.double(), {name: value.double() for name, value in numbers.items()}
    classes, d, mu = body.classes, body.dimension, numbers["mu"]
    scale = model.certified_spacing_near(classes.spacing) / classes.spacing  # as bond_weights
    scaled = replace(classes, r=scale * classes.r)
    w = scale**2 * class_weights(scaled, numbers["alpha"], numbers["D"])
    stretch, place = stretch_matrix(body, neighbour)
    node, bond = (torch.from_numpy(one) for one in np.divmod(place, neighbour.shape[1]))
    w, square = w[bond.new_tensor(classes.bond_class)[bond]], torch.from_numpy(body.r**2)[bond]
    e = linear(u.flatten(1), lambda x: x @ stretch.T, lambda y: y @ stretch)
    theta = u.new_zeros(u.shape[:2]).index_add(1, node, d * w * e)
    stress = (numbers["lam"] - mu) * theta + pressure
    pull = d * (d + 2) * mu * w / square * e + d * w * stress[:, node]
    return linear(pull, lambda y: y @ stretch, lambda x: x @ stretch.T).view_as(u)


def crack_load(cut: Any, stress: ndarray, parameters: Numbers) -> torch.Tensor:
    """Crack load as statics.crack_load, differentiable in the given parameters, [N, d]."""
    numbers = {name: real(name, value) for name, value in (cut.learnable | {**parameters}).items()}
    sigma = torch.from_numpy(stress)
    strain = strain_of(sigma, numbers["lam"], numbers["mu"], torch.from_numpy(np.eye(len(stress))))
    u = (sigma.new_tensor(cut.body.x) @ strain)[None]
    whole, broken = (
        bond_force(cut.model, cut.body, table, u, numbers)[0]
        for table in (cut.body.neighbour, cut.neighbour)
    )
    return whole - broken


class SoftBody:
    """Bond-based body whose bonds soften and fail by one law.

    Args:
        model: λ = μ, positive on the lattice.
        body, law, cracks, no_fail: as of `grow`; the law is that of the bonds.
        held: components of the displacement that are given, shape [N, d] bool.

    Attributes:
        node, bond: where a bond begins, and its number in the ball; each bond once, [E].
        rows: s r² of each bond as a matrix [length²], [E, d N].
        stiffness, square, breakable: k [stress/length^4], r² [length²], and which may fail, [E].
        free: components that are not given, flat [d N].

    Raises InputError for another model, and for a piece of the body that nothing holds.

    Arguments of `pull`: u are given components at unit load, [N, d], the others where the first
    solve begins; line is straight, in space a flat polygon; at the share `stop` of the largest
    force it ends; parameters are softness, stretch or tail. It returns a motion whose time is the
    load, with the histories load, force, normal to its line per thickness, and broken bonds. With
    parameters, or a tensor as u, force and the last u are tensors, differentiable once along the
    path taken: which bonds failed when counts, how often a load was settled does not. A body apart
    along the line has force 0; without an equilibrium before, the curve ends with a warning. Raises
    InputError for loads that do not rise, a line that no bond crosses, a first load without an
    equilibrium, and derivatives to bonds that break at once.
    """

    def __init__(
        self,
        model: LPSMaterial,
        body: LatticeBody,
        law: BondLaw,
        held: ndarray,
        *,
        cracks: Sequence[ArrayLike] = (),
        no_fail: ndarray | None = None,
    ) -> None:
        check_breakable(model, body.classes)
        safe, table = check_no_fail(no_fail, len(body.x)), cracked(body, cracks)
        self.body, self.law, self.held = body, law, held
        check_pieces(body, table, held)
        node, bond = np.nonzero(table > np.arange(len(table))[:, None])  # each bond once
        far = table[node, bond]
        self.node, self.bond = node, bond
        self.rows = stretch_rows(body, node, bond, far)
        self.stiffness = 2 * bonds_of(model, body.classes).stiffness[bond]
        self.square = body.r[bond] ** 2
        self.breakable = ~(safe[node] | safe[far])
        self.free = ~held.ravel()

    def rest(self, u: ndarray, share: ndarray) -> ndarray:
        """Displacement at rest, flat [d N], by Newton's method from u with the given components.
        `share` is what is left of the pull of each bond."""
        softness = self.law.softness
        for _ in range(NEWTON):
            d = self.rows @ u
            s = np.maximum(d / self.square, 0)
            weak = np.exp(-softness * s)
            total = self.rows.T @ (self.stiffness * share * d * weak)
            force = total[self.free]
            if norm(force) <= TOLERANCE * norm(total):
                return u
            slope = share * weak * np.maximum(1 - softness * s, 0.02)
            try:
                factors = symmetric_factors(self.tangent(slope))
            except RuntimeError as error:
                raise InputError(f"operator: parts of the body hang loose ({error})") from None
            u = u.copy()
            u[self.free] -= factors.solve(force)
        raise InputError("softening: no equilibrium was found; the body may have come apart")

    def tangent(self, slope: ndarray) -> sp.csc_array:
        """Tangent between free components, of the bonds' slopes relative to their stiffness."""
        K = self.rows.T @ (sp.diags_array(self.stiffness * slope) @ self.rows)
        return sp.csc_array(sp.csr_array(K)[self.free][:, self.free])

    def levers(self, line: ArrayLike) -> ndarray:
        """Weights of bonds in the force per thickness normal to a line, tension positive, [E]."""
        crossing, ends = crossing_bonds(self.body, line, "line"), checked("line", line)
        if self.body.dimension == 2 and len(ends) != 2:
            raise InputError(f"line: expected two ends, got {len(ends)} corners")
        if not (cut := crossing[self.node, self.bond]).any():
            raise InputError("line: no bond of the body crosses it, so no force can be read there")
        rise = cut * np.abs(self.body.xi[self.bond] @ size_and_normal(ends)[1])
        cell = self.body.spacing**self.body.dimension
        return np.asarray(cell * rise * self.stiffness * self.square)

    def pull(
        self,
        u: Any,
        *,
        loads: ArrayLike,
        line: ArrayLike,
        stop: NotNegative = 0.7,
        progress: bool = False,
        parameters: Numbers | None = None,
    ) -> Motion:
        """Raise the load step by step; at each, let bonds fail until none does; see the class."""
        loads = checked("loads", loads, float, ("n",))
        if not (len(loads) and loads[0] >= 0 and (np.diff(loads) > 0).all()):
            raise InputError(f"loads: expected factors that rise from ≥ 0, got {loads.tolist()}")
        levers = torch.from_numpy(self.levers(line))
        soft, asked, given, *law = self._learned(u, parameters)
        start = checked("u", given.detach().numpy(), float, self.held.shape).ravel()
        given = torch.where(torch.from_numpy(self.held), given, 0.0).ravel()
        damage = [levers.new_ones(len(levers)), levers.new_zeros(len(levers))]
        field, before, rows, forces = given, 0.0, list[tuple[float, int]](), list[Any]()
        unstable = list[float]()
        for load in tqdm(loads.tolist(), disable=not progress, unit="load"):
            at = field.detach().numpy() * (load / before) if before else load * start
            at = np.where(self.free, at, load * given.detach().numpy())
            try:
                field, s = soft._settled(at, load * given, damage, law)
                share, worst = damage
                if asked and len(unstable) < 2:
                    stable = soft._stable(s.detach(), worst, share.detach())
                    unstable = [] if stable else [*unstable, load]
                    if len(unstable) == 2:
                        warn(
                            f"loads {before:g} and {load:g}: the body stays unstable and may tear "
                            "another way; derivatives from here on are larger: end the loads before"
                        )
                forces.append((levers * share * pull_of(s, law[0], torch)).sum())
            except InputError as error:
                share = damage[0]
                if share[levers > 0].any():
                    if not rows:
                        raise
                    warn(f"load {load:g} and beyond are left out: {error}")
                    break
                forces.append(0 * levers.sum())  # nothing is left across the line
            rows.append((load, int((share == 0).sum())))
            before = load
            if 0 < max(forces) * stop > forces[-1] or not share[levers > 0].any():
                break
        load, broken = np.array(rows).T
        nothing = sum(one.flatten()[:0].sum() for one in law)  # the graph of what was not felt yet
        force, end = torch.stack(forces) + nothing, (field + nothing).reshape(self.held.shape)
        force, end = (force, end) if asked else (force.numpy(), end.numpy())
        return Motion(
            load, end, None, {"load": load, "force": force, "broken": broken}, axis="load"
        )

    def _settled(
        self, at: ndarray, given: torch.Tensor, damage: list[torch.Tensor], law: Sequence[Any]
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Displacement u [d N] and s where no bond fails further; updates share and worst."""
        change, breakable = 1.0, torch.from_numpy(self.breakable)
        while not change < SETTLED:
            share, worst = damage
            at = self.rest(at, share.detach().numpy())
            field = self._at_rest(at, share, law[0], given)
            s = self._stretch(field)
            worst = torch.maximum(worst, s).where(breakable, 0.0)
            lasting = torch.minimum(share_of(worst, law[0], law[1], law[2], torch), share)
            change, damage[:] = float((share - lasting).max().detach()), (lasting, worst)
        return field, s

    @property
    def learnable(self) -> dict[str, float]:
        """Learnable parameters of the law by name."""
        return vars(self.law)

    def at(self, numbers: Numbers) -> SoftBody:
        """Body with other parameters of its law."""
        soft = copy(self)
        soft.law = BondLaw(**renumbered(self.learnable, numbers))
        return soft

    def _learned(self, u: Any, parameters: Numbers | None) -> tuple[Any, ...]:
        """Body with these parameters, whether derivatives are asked for, u and the parameters."""
        asked = parameters is not None or is_tensor(u)
        soft, numbers = with_numbers(self, parameters or {})
        if asked and soft.law.tail == 0 and np.isfinite(soft.law.stretch):
            raise InputError("tail: expected > 0 for a gradient, which an abrupt break has not")
        own = (numbers.get(name, real(name, value)) for name, value in soft.learnable.items())
        same = lambda *x: x  # noqa: E731
        return soft, asked, *once(same, lambda _, *upstream: upstream, real("u", u), *own)

    def _stretch(self, u: torch.Tensor) -> torch.Tensor:
        """Stretch s of each bond at u, flat [d N]."""
        return linear(u, self.rows.dot, self.rows.T.dot) / torch.from_numpy(self.square)

    def _stable(self, s: torch.Tensor, worst: torch.Tensor, share: torch.Tensor) -> bool:
        """Hill's test: whether the tangent is positive definite with failing bonds failing on."""
        law, fails = self.law, ((s == worst) & (worst > self.law.stretch)).numpy()
        slope = share.numpy() * slope_of(s.numpy(), law.softness)
        if fails.any():
            slope[fails & (slope > 0)] = -float(law.pull(np.array(law.stretch))) / law.tail
        return definite_factors(self.tangent(slope)) is not None

    def _at_rest(
        self, u: ndarray, share: torch.Tensor, softness: torch.Tensor, given: torch.Tensor
    ) -> torch.Tensor:
        """Displacement u at rest [d N], with the derivatives of a Newton step of length zero."""
        left, factors = share.detach().numpy(), list[Any]()

        def inverse(g: ndarray) -> ndarray:
            if not factors:
                slope = slope_of((self.rows @ u) / self.square, self.law.softness)
                factors.append(splu(self.tangent(left * slope)))
            w = np.zeros_like(g)
            w[self.free] = factors[0].solve(g[self.free])
            return w

        field = torch.where(torch.from_numpy(self.free), torch.from_numpy(u), given)
        full = torch.from_numpy(self.stiffness * self.square)
        pull = full * share * pull_of(self._stretch(field), softness, torch)
        return field - linear(linear(pull, self.rows.T.dot, self.rows.dot), np.zeros_like, inverse)
