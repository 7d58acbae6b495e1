"""Motion of a body whose bonds break: its state, one step, and the ledger of energies.

Velocity Verlet keeps the force of a bond for the second half-kick of the step in which it breaks
and drops it after (theory, C10); work = kinetic + elastic + dissipated is then kept to second
order.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike

from warp_peri.damage.lattice_body import LatticeBody, cracked
from warp_peri.damage.operator import CutOperator, mean_gradients, unit_toughness
from warp_peri.damage.solid import (
    BrittleSolid,
    breaking_time_step,
    check_breakable,
    check_horizon,
    check_no_fail,
)
from warp_peri.errors import InputError
from warp_peri.files.checkpoint import AllNodes
from warp_peri.kernels.damage.motion import halves
from warp_peri.launch import floats, launch_slices, zeros
from warp_peri.points.arrays import check_positive, checked


@dataclass(eq=False)
class BreakingState:
    """What a motion has come to; arrays are Warp's.

    Attributes:
        u, v: displacement and velocity.
        links: which bonds are unbroken, as the operator's `kept` tells.
        force: internal force density over the bonds that are left.
        energy: elastic energy density over them.
        work: done on the body so far and what it started with, per node and area [stress].
        dissipated: energy density of the bonds broken so far [stress].
        whole: bonds that count as undamaged at the start, shape [N].
        time: elapsed.
        steps: taken.
    """

    u: wp.array[Any]
    v: wp.array[Any]
    links: wp.array[Any]
    force: wp.array[Any]
    energy: wp.array[Any]
    work: wp.array[Any]
    dissipated: np.ndarray
    whole: np.ndarray
    time: float = 0.0
    steps: int = 0

    def copy(self) -> BreakingState:
        """The same state in memory of its own."""
        kinds: dict[type, Any] = {wp.array: wp.clone, np.ndarray: np.copy}
        parts = [(name, one, kinds.get(type(one))) for name, one in vars(self).items()]
        return replace(self, **{name: clone(one) for name, one, clone in parts if clone})


SPREAD = 0.25
"""Least eigenvalue of the shape tensor of a node that is corrected in motion, over a whole ball's:
a straight edge has half."""
SHORTER = 0.95
"""Of the step (C9), where bonds are corrected: breaking at random raises Λmax by up to 1.05."""


class SurfaceCorrection:
    """What (C26) adds to force and energy at nodes that lack bonds, as they lose more of them.

    Args:
        operator: of the body.
        links: which bonds are unbroken, as the operator has it.

    Attributes:
        nodes: that lack bonds.
        near: these and the ends of their bonds, where forces change.
    """

    def __init__(self, operator: CutOperator, links: wp.array[Any]) -> None:
        self._operator, self.links = operator, links
        self.nodes = np.zeros(0, int)
        self._kept: list[np.ndarray] = []
        self.lose(np.flatnonzero(~operator.kept(links).all(axis=1)))

    def lose(self, nodes: np.ndarray) -> None:
        """These nodes lack bonds, or more of them."""
        stiffness, share, _ = self._operator.bonded
        body = self._operator.body
        there = self._operator.kept(self.links, nodes[:, None], np.arange(len(share)))
        made = (
            np.where(there, body.neighbour[nodes], nodes[:, None]),
            (there * share)[:, :, None] * body.xi,
            *mean_gradients(body.xi, there, stiffness, share, SPREAD)[1:],
        )
        stay = ~np.isin(self.nodes, nodes)
        every = np.append(self.nodes[stay], nodes)
        order = np.argsort(every)
        before = [one[stay] for one in self._kept] or [one[:0] for one in made]
        self.nodes = every[order]
        self._kept = [np.concatenate(pair)[order] for pair in zip(before, made)]
        ends = np.append(self._kept[0].ravel(), self.nodes)
        number = np.zeros(len(body.x), int)
        number[ends] = 1
        self.near = np.flatnonzero(number)
        number[self.near] = np.arange(len(self.near))
        self._place = number[ends]

    def __call__(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Force density of the nodes `near` and energy density of `nodes`, at a displacement."""
        far, felt, by_bond, squares, lacked = self._kept
        excess, d = self._operator.bonded.excess, u.shape[1]
        apart = u[far] - u[self.nodes, None]
        gradient = (by_bond @ apart).reshape(len(far), -1)
        theta = (felt * apart).reshape(len(far), -1).sum(axis=1)
        stress, more = (squares @ gradient[..., None])[..., 0], (lacked * gradient).sum(axis=1)
        energy = (gradient * stress).sum(axis=1) / 2 + excess * more * (theta + more / 2)
        stress = (stress + excess * (theta + more)[:, None] * lacked).reshape(-1, d, d)
        pulls = by_bond.swapaxes(1, 2) @ stress
        pulls += (excess * more)[:, None, None] * felt
        each = np.append(-pulls.reshape(-1, d), pulls.sum(axis=1), axis=0)
        sums = [np.bincount(self._place, part, len(self.near)) for part in each.T]
        return np.stack(sums, axis=1), energy


class BreakingBody:
    """A brittle solid on a lattice body, with its loads: what `step` marches.

    Args:
        solid: the solid; its influence function must be positive on the lattice.
        body: nodes and bonds, of the solid's horizon.
        no_fail: nodes whose bonds do not break, shape [N] bool.
        load: body force density b [stress / length], shape [N, d].
        held: components of the displacement that are prescribed, shape [N] or [N, d] bool.
        grip: velocity of held components, shape [N, d]; zero by default, and where not held.
        ramp: share of load and grip at a time; 1 by default.
        corrected: bonds that a node lacks take the mean gradient of those that it has (C26).

    Attributes:
        longest_step: Δt proven stable under any breaking (theory, C9); where bonds are corrected
            a little less, measured.
        stretch: critical stretch; None where bonds break by energy.
        exchange: sends for the displacement of nodes that another process moves, and gives what
            waits for it; None where none does.

    Raises InputError for a model that changes sign, another horizon, or arrays that do not fit.
    """

    def __init__(
        self,
        solid: BrittleSolid,
        body: LatticeBody,
        *,
        no_fail: ArrayLike | None = None,
        load: ArrayLike | None = None,
        held: ArrayLike | None = None,
        grip: ArrayLike | None = None,
        ramp: Callable[[float], float] | None = None,
        corrected: bool = False,
    ) -> None:
        check_breakable(solid.model, body.classes)
        check_horizon(solid.model, body)
        self.solid, self.body, self.ramp = solid, body, ramp
        self.stretch, limits = criterion(solid, body)
        count = len(body.x)
        self.no_fail = check_no_fail(no_fail, count)
        self.operator = CutOperator(
            solid.model,
            body,
            limits=limits,
            by_energy=solid.by_energy,
            tension_only=solid.tension_only,
            no_fail=self.no_fail,
        )
        if grip is not None and held is None:
            raise InputError("grip: expected held components too, whose velocity it is")
        d = body.dimension
        held = np.zeros((count, d), bool) if held is None else checked("held", held, bool)
        held = np.repeat(held[:, None], d, axis=1) if held.ndim == 1 else held
        self.load, self.held, self.grip = (
            self._padded(name, field)
            for name, field in (("load", load), ("held", held.astype(float)), ("grip", grip))
        )
        self.longest_step = breaking_time_step(solid.model, body.classes, solid.density)
        self.corrected = corrected
        self._correction: SurfaceCorrection | None = None
        if corrected:
            self.longest_step *= SHORTER
            if solid.by_energy:
                raise InputError(
                    "corrected: expected a linear peridynamic solid whose bonds break at a stretch"
                )
        if not (ramp is None or callable(ramp)):
            raise InputError(f"ramp: expected a function of time, got {ramp!r:.50}")
        self.exchange: Callable[[wp.array[Any]], Callable[[], None]] | None = None

    def _padded(self, name: str, field: ArrayLike | None) -> wp.array[Any]:
        count, d = self.body.x.shape
        values: np.ndarray = np.zeros((count, d))
        if field is not None:
            values[:] = checked(name, field, float, (count, d))
        return floats(values, self.operator.vector)

    def share(self, time: float) -> float:
        """The ramp at a time; InputError where it is no number."""
        ramp, name = self.ramp, f"ramp at t = {time:g}"
        return 1.0 if ramp is None else float(checked(name, ramp(time), float, ()))

    def start(
        self,
        *,
        u: ArrayLike | None = None,
        v: ArrayLike | None = None,
        cracks: Sequence[ArrayLike] = (),
        count_cracks: bool = False,
    ) -> BreakingState:
        """A state at time zero.

        Args:
            u, v: displacement and velocity, shape [N, d]; zero by default.
            cracks: polylines, in space flat polygons, open from the start, shape [P, d] each.
            count_cracks: whether the bonds they cut count as damage.

        Raises InputError when u alone is beyond the criterion: such a body breaks at rest.
        """
        fields = self._padded("u", u), self._padded("v", v)
        neighbour = cracked(self.body, cracks)
        links = self.operator.links(neighbour)
        count = len(self.body.x)
        force, energy = zeros(count, dtype=self.operator.vector), zeros(count)
        if u is not None:
            broken = self.operator.sweep(
                fields[0], self.operator.links(neighbour), force, energy, breaking=True
            )
            if len(broken):
                raise InputError(
                    f"criterion: bonds of {len(broken)} nodes are beyond it in the displacement "
                    "at rest, before anything moves"
                )
        self.operator.sweep(fields[0], links, force, energy)
        self.correct(fields[0], links, force, energy)
        whole = (self.body.neighbour >= 0).sum(axis=1) if count_cracks else (neighbour >= 0).sum(1)
        kinetic = self.solid.density / 2 * np.square(fields[1].numpy()).sum(axis=1)
        work = floats(kinetic + energy.numpy())
        return BreakingState(
            *fields, links, force, energy, work, np.zeros(count), whole.astype(float)
        )

    def correct(
        self,
        u: wp.array[Any],
        links: wp.array[Any],
        force: wp.array[Any],
        energy: wp.array[Any],
        lost: np.ndarray | None = None,
    ) -> Callable[[], None]:
        """Add to force and energy what bonds that are lacked do; what takes it off again.

        lost: nodes that have lost bonds since the last call.
        """
        if not self.corrected:
            return lambda: None
        if self._correction is None or self._correction.links is not links:  # of another state
            self._correction = SurfaceCorrection(self.operator, links)
        correction = self._correction
        if lost is not None:
            correction.lose(lost)
        more, stored = correction(u.numpy())
        nodes, near, forces, energies = (
            correction.nodes,
            correction.near,
            force.numpy(),
            energy.numpy(),
        )
        plain = forces[near], energies[nodes]  # to have the same bits wherever nothing breaks
        forces[near] += more
        energies[nodes] += stored

        def less() -> None:
            forces[near], energies[nodes] = plain

        return less

    def damage(self, state: BreakingState) -> np.ndarray:
        """φ, the share of bonds that a node has lost, shape [N]."""
        left = self.operator.kept(state.links).sum(axis=1)
        phi: np.ndarray = 1 - left / np.maximum(state.whole, 1)
        return phi

    def neighbour(self, state: BreakingState) -> np.ndarray:
        """Neighbours with broken bonds as −1 − j, shape [N, B]."""
        table = self.body.neighbour
        return np.where(self.operator.kept(state.links) | (table < 0), table, -1 - table)

    def displacement(self, state: BreakingState) -> np.ndarray:
        """u, shape [N, d]; shares the state's memory."""
        field: np.ndarray = state.u.numpy()
        return field

    def velocity(self, state: BreakingState) -> np.ndarray:
        """v, shape [N, d]; shares the state's memory."""
        field: np.ndarray = state.v.numpy()
        return field

    def ledger(self, state: BreakingState, nodes: Any = None) -> list[float]:
        """Time, work, kinetic, elastic and dissipated energy [stress · volume] of this state, in a
        sheet per thickness [stress · area]; of the own nodes of all processes, where `nodes` says
        which those are. work = kinetic + elastic + dissipated."""
        body, density = self.body, self.solid.density
        nodes = AllNodes(len(body.x)) if nodes is None else nodes
        kinetic = density / 2 * np.square(state.v.numpy()).sum(axis=1)
        fields = (state.work.numpy(), kinetic, state.energy.numpy(), state.dissipated)
        sums = nodes.sum(np.stack([field[nodes.own] for field in fields], axis=1))
        return [state.time, *(body.spacing**body.dimension * sums).tolist()]


def criterion(solid: BrittleSolid, body: LatticeBody) -> tuple[float | None, np.ndarray]:
    """Critical stretch, None by energy, and the limit of each bond of the ball, shape [B]."""
    if solid.critical_energy is not None:
        return None, solid.critical_energy * body.classes.weight[body.classes.bond_class]
    stretch = solid.critical_stretch
    if solid.toughness is not None:
        stretch = float(np.sqrt(solid.toughness / unit_toughness(solid.model, body.classes)))
    if stretch is None:
        raise InputError("solid: expected a critical stretch, an energy or a toughness")
    return stretch, stretch * body.r**2


def check_step(body: BreakingBody, dt: float, *, allow_unstable: bool = False) -> None:
    """Refuse, or warn about, a step beyond what is proven stable under any breaking."""
    check_positive("step", dt)
    if dt <= body.longest_step:
        return
    message = (
        f"step: expected at most {body.longest_step:.6g}, the longest that is stable whatever "
        f"breaks, got {dt:.6g}"
    )
    if not allow_unstable:
        raise InputError(message)
    warnings.warn(message, stacklevel=3)


def step(body: BreakingBody, state: BreakingState, dt: float) -> BreakingState:
    """Advance a state by dt, in place, and return it; `state.copy()` keeps one.

    dt is not looked at: `check_step` and `run` refuse one that is too long.
    """
    operator, count = body.operator, len(body.body.x)
    density, kernels = body.solid.density, halves(body.body.dimension)
    share, later = (body.share(time) for time in (state.time, state.time + dt))
    launch_slices(
        kernels.kick_and_drift,
        count,
        (dt, density, share, later, state.force, body.load, body.held, body.grip),
        (state.v, state.work, state.u),
    )
    arrive = None if body.exchange is None else body.exchange(state.u)
    fields = state.u, state.links, state.force, state.energy
    lost = operator.sweep(*fields, breaking=True, arrive=arrive)
    less = body.correct(*fields)
    launch_slices(
        kernels.second_kick,
        count,
        (dt, density, later, state.force, body.load, body.held),
        (state.v, state.work),
    )
    if len(lost):
        full = state.energy.numpy()[lost]
        less()
        operator.again(state.links, lost, state.force, state.energy)
        body.correct(*fields, lost)
        state.dissipated[lost] += full - state.energy.numpy()[lost]
    state.time += dt
    state.steps += 1
    return state
