"""Explicit dynamics ρ ü = b − L u on a lattice: velocity Verlet, its time step and its energy.

The step is bounded by the symbol (theory.md, 49–51); the energy that leapfrog keeps is (52).
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from warp_peri.errors import InputError
from warp_peri.models.lps import Model
from warp_peri.operator.symbol import stiffnesses
from warp_peri.points.families import bond_classes
from warp_peri.points.samples import PointsLike
from warp_peri.stability.proof import largest_bound
from warp_peri.transfer.kept import model_at
from warp_peri.transfer.operator import LPSOperator
from warp_peri.transfer.points import model_for

INERTIA = 1e-8
"""1 kg/m³ in TPa ps²/Å²."""


@dataclass(frozen=True)
class Motion:
    """What a run leaves.

    Attributes:
        time: of the records, half a step after each `every` steps [ps], shape [R].
        energy: what leapfrog conserves (theory.md, 52), a mean over interior nodes [TPa], [R].
        u: displacement at the end [Å], shape [N, 2].
        v: velocity at the end [Å/ps], shape [N, 2]; zero on the collar.
    """

    time: np.ndarray
    energy: np.ndarray
    u: np.ndarray
    v: np.ndarray

    @property
    def drift(self) -> float:
        """Largest departure of the energy from its first value, relative."""
        return float(np.abs(self.energy - self.energy[0]).max() / np.abs(self.energy[0]))


def critical_time_step(
    model: Model, *, spacing: float, density: float, allow_uncertified: bool = False
) -> float:
    """Time step [ps] below which velocity Verlet is stable on every part of the lattice (50–51).

    2/ω with ω² = max Λmax D(k)/ρ, the maximum proven over the whole zone and at most 0.1 % too
    large. It holds on any set of nodes with displacement given out to 2δ, and on periodic boxes.

    Args:
        model: certified on some lattice, transferred to others: where D(k) is not positive
            definite, waves grow at any step.
        spacing: of the lattice [Å].
        density: mass per volume [kg/m³].
        allow_uncertified: the model's own numbers, with a warning.

    Raises InputError for a model certified on no lattice, a horizon below one spacing, a
    density not > 0.
    """
    _positive("density", density)
    model = model_at(model, spacing, allow_uncertified=allow_uncertified)
    classes = bond_classes(model.nominal_spacing(spacing), model.horizon)
    stiffest = largest_bound(classes, *stiffnesses(model, classes))
    return float(2 * np.sqrt(INERTIA * density / stiffest))


def velocity_verlet(
    model: Model,
    points: PointsLike,
    u: ArrayLike,
    v: ArrayLike,
    *,
    density: float,
    step: float,
    steps: int,
    b: ArrayLike | None = None,
    every: int = 1,
    allow_uncertified: bool = False,
    allow_unstable: bool = False,
) -> Motion:
    """March ρ ü = b − L u on the interior; the collar stays where it is.

    Only on lattices with full families: elsewhere L is not symmetric and no energy is kept.

    Args:
        model: certified on some lattice, transferred to others.
        points: a lattice; its u and b are not looked at.
        u: displacement at the start [Å], shape [N, 2].
        v: velocity at the start [Å/ps], shape [N, 2]; that of the collar is not looked at.
        density: ρ [kg/m³].
        step: Δt [ps], at most the critical one.
        steps: number of steps.
        b: body force density, constant in time [TPa/Å], shape [N, 2]; none by default.
        every: steps from one record of the energy to the next.
        allow_uncertified: the model's own numbers, with a warning.
        allow_unstable: warn about a step above the critical one instead of raising.

    Raises InputError for scattered points, arrays that do not fit, an uncertified spacing, or a
    step that is too long; it says how long a step may be.
    """
    if points.spacing == 0:
        raise InputError("points: expected a lattice; on scattered points L is not symmetric")
    shape = (len(points.x), 2)
    state = [np.array(field, dtype=float) for field in (u, v, 0 * points.x if b is None else b)]
    for name, field in zip(("u", "v", "b"), state):
        if field.shape != shape or not np.isfinite(field).all():
            raise InputError(
                f"{name}: expected finite values of shape {list(shape)}, got {list(field.shape)}"
            )
    _positive("step", step)
    for name, number in (("steps", steps), ("every", every)):
        if not (isinstance(number, (int, np.integer)) and number >= 1):
            raise InputError(f"{name}: expected a whole number ≥ 1, got {number!r}")
    if not allow_uncertified:
        model = model_for(model, points)
    with warnings.catch_warnings():
        if allow_uncertified:  # LPSOperator below says it once
            warnings.simplefilter("ignore")
        longest = critical_time_step(
            model, spacing=points.spacing, density=density, allow_uncertified=allow_uncertified
        )
    if step > longest:
        message = (
            f"step: expected at most {longest:.6g} ps (2/ω of the stiffest wave), got {step:.6g} "
            "ps, at which waves may grow without bound"
        )
        if not allow_unstable:
            raise InputError(message)
        warnings.warn(message, stacklevel=2)

    operator = LPSOperator(model, points, allow_uncertified=allow_uncertified)
    free = points.interior
    u_all, v_free, load = state[0], state[1][free], state[2][free]
    inertia = INERTIA * density
    constant = operator(np.where(free[:, None], 0.0, u_all)) - load  # collar and load: g at u = 0
    g = operator(u_all) - load
    time, energy = [], []
    for number in range(steps):
        before = u_all[free]
        v_free = v_free - step / (2 * inertia) * g
        u_all[free] = before + step * v_free
        g = operator(u_all) - load
        if number % every == 0:
            kinetic = inertia / 2 * np.vdot(v_free, v_free)
            potential = (np.vdot(before, g) + np.vdot(constant, u_all[free])) / 2
            energy.append((kinetic + potential) / len(before))
            time.append((number + 0.5) * step)
        v_free = v_free - step / (2 * inertia) * g
    v_all = np.zeros_like(u_all)
    v_all[free] = v_free
    return Motion(np.array(time), np.array(energy), u_all, v_all)


def _positive(name: str, value: float) -> None:
    if not (isinstance(value, (int, float, np.number)) and 0 < value < np.inf):
        raise InputError(f"{name}: expected a number > 0, got {value!r}")
