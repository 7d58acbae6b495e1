"""Flow between two plates: velocity on faces, stress in cells, leapfrog (theory, F11).

Lengths in the gap, time in t0, stress in η/t0.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from examples.polymer.closure import check_time_step, in_cells
from examples.polymer.laws import shear
from warp_peri import InputError


def still(t: float) -> float:
    """Nothing moves, nothing pulls."""
    return 0.0


@dataclass(frozen=True)
class PlaneFlow:
    """What moves the fluid.

    Args:
        De: relaxation time over t0.
        Re: Reynolds number.
        cells: across the gap.
        force: body force along x at a time.
        top: velocity of the upper wall at a time; the lower one is at rest.
        solvent: its viscosity β over that of the polymer (Oldroyd-B and the like).

    Raises InputError for numbers that are not positive, or fewer than 4 cells.
    """

    De: float
    Re: float
    cells: int = 128
    force: Callable[[float], float] = field(default=still)
    top: Callable[[float], float] = field(default=still)
    solvent: float = 0.0

    def __post_init__(self) -> None:
        if not (self.De > 0 and self.Re > 0 and self.cells >= 4 and self.solvent >= 0):
            raise InputError(
                "plane flow: expected De > 0, Re > 0, 4 cells or more and solvent ≥ 0, got "
                f"{self.De}, {self.Re}, {self.cells}, {self.solvent}"
            )

    @property
    def longest_step(self) -> float:
        """Δt beyond which the leapfrog of the linear law is unstable (F12)."""
        dy = 1 / self.cells
        wave = dy * math.sqrt(self.De * self.Re)
        if self.solvent == 0:
            return wave
        return 1 / (1 / wave + 2 * self.solvent / (self.Re * dy**2))

    @property
    def faces(self) -> np.ndarray:
        """Where u is, shape [cells + 1]."""
        return np.linspace(0, 1, self.cells + 1)


@dataclass(frozen=True)
class Profiles:
    """What came of it: times [T], u [T, cells + 1] on faces, σ [T, cells, 4] in cells."""

    t: np.ndarray
    u: np.ndarray
    stress: np.ndarray


def run_plane(flow: PlaneFlow, fluid: Any, *, until: float, dt: float, every: int = 1) -> Profiles:
    """Run from equilibrium.

    Args:
        flow: what moves the fluid.
        fluid: a law, dumbbells, or what `in_cells` takes.
        until: time at the end [t0].
        dt: time step [t0].
        every: steps between two records.

    Raises InputError for a time step beyond `flow.longest_step`, or a flow that blows up.
    """
    check_time_step(dt, flow.longest_step)
    steps, dy, stress = round(until / dt), 1 / flow.cells, in_cells(fluid, flow.De, flow.cells)
    u, sigma = np.zeros(flow.cells + 1), np.zeros((flow.cells, 4))
    rows = [(0.0, u.copy(), sigma.copy())]

    def slope(t: float) -> np.ndarray:
        total = sigma[:, 1] + flow.solvent * np.diff(u) / dy
        return (np.diff(total) / dy + flow.force(t)) / flow.Re

    for n in range(steps):
        u[1:-1] += (dt / 2 if n == 0 else dt) * slope(n * dt)
        u[-1] = flow.top((n + 0.5) * dt)
        sigma = stress.advance(shear(np.diff(u) / dy), dt)
        if (n + 1) % every:
            continue
        if not np.isfinite(u).all():
            raise InputError(f"plane flow: velocities are not finite at t = {(n + 1) * dt:.4g}")
        now = u.copy()
        now[1:-1] += dt / 2 * slope((n + 1) * dt)
        rows.append(((n + 1) * dt, now, sigma.copy()))
    return Profiles(*(np.array(each) for each in zip(*rows)))
