"""Flow between two plates, one-dimensional: velocity on faces, stress in cells, leapfrog (F11).

Lengths in the gap, time in t0, stress in η/t0.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from tqdm import tqdm

from examples.polymer.closure import Stress, check_time_step, in_cells, key_of
from examples.polymer.laws import shear
from warp_peri.contract import taken
from warp_peri.dynamics.motion import Motion
from warp_peri.errors import InputError
from warp_peri.files.atomic import ArrayFile, write_text
from warp_peri.files.checkpoint import fingerprint


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

    def moved(self, material: Any, options: dict[str, Any]) -> Motion:
        """From rest, of a law, of dumbbells or of what `in_cells` takes.

        The options are those of run_plane: `until`, `dt`, `every`, `checkpoint`, `progress`. The
        histories are u [T, cells + 1] on faces and stress [T, cells, 4] in cells; the details are
        Profiles.
        """
        (how,) = taken(options, "move", run_plane)
        run = run_plane(self, in_cells(material, self.De, self.cells), **how)
        return Motion(run.t, run.u[-1], None, {"u": run.u, "stress": run.stress}, run)

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

    def save_csv(self, path: str | os.PathLike[str]) -> None:
        """A line a time: t, then u on all faces."""
        faces = np.linspace(0, 1, self.u.shape[1])
        head = "# time in t0 = L/U; u in U at y = " + ",".join(f"{y:.6g}" for y in faces)
        rows = [",".join(f"{x:.12g}" for x in (t, *u)) for t, u in zip(self.t, self.u)]
        write_text(path, "\n".join([head, *rows]) + "\n")


def run_plane(
    flow: PlaneFlow,
    stress: Stress,
    *,
    until: float,
    dt: float,
    every: int = 1,
    checkpoint: str | os.PathLike[str] | None = None,
    progress: bool = False,
) -> Profiles:
    """Run from rest.

    Args:
        flow: what moves the fluid.
        stress: what is in its cells, at rest.
        until: time at the end [t0].
        dt: time step [t0].
        every: steps between two records.
        checkpoint: file written at every record; a run that finds its own goes on from it.
        progress: whether to show a bar.

    Raises InputError for a time step beyond `flow.longest_step`, a checkpoint of another run, or a
    flow that blows up: the last good state is in the checkpoint.
    """
    _check(flow, until, dt, every)
    steps, dy = round(until / dt), 1 / flow.cells
    key = (
        ""
        if checkpoint is None
        else fingerprint(replace(flow, force=still, top=still), dt, every, key_of(stress))
    )
    moved: list[tuple[float, float]] = []  # force and wall of all steps
    u, sigma = np.zeros(flow.cells + 1), np.zeros((flow.cells, 4))
    times, us, sigmas = [0.0], [u.copy()], [sigma.copy()]
    first = 0
    file = ArrayFile(checkpoint, key, "another flow, fluid or time step")
    if (kept := file.read(_made)) is not None:
        first, past, u, sigma, times, us, sigmas, state = kept
        _extend(moved, flow, dt, first)
        _check_history(file, past, moved, dt)
        stress.restore(state)

    def slope(t: float) -> np.ndarray:
        total = sigma[:, 1] + flow.solvent * np.diff(u) / dy
        return (np.diff(total) / dy + flow.force(t)) / flow.Re

    for n in tqdm(range(first, steps), disable=not progress, desc="plane flow", initial=first):
        h = dt / 2 if n == 0 else dt
        u[1:-1] += h * slope(n * dt)
        u[-1] = flow.top((n + 0.5) * dt)
        sigma = stress.advance(shear(np.diff(u) / dy), dt)
        if (n + 1) % every:
            continue
        if not np.isfinite(u).all():
            raise InputError(f"plane flow: velocities are not finite at t = {(n + 1) * dt:.4g}")
        now = u.copy()
        now[1:-1] += dt / 2 * slope((n + 1) * dt)
        times.append((n + 1) * dt)
        us.append(now)
        sigmas.append(sigma.copy())
        if checkpoint is not None:
            _extend(moved, flow, dt, n + 1)
            rows = {"t": times, "us": us, "sigmas": sigmas, "moved": moved}
            file.write(rows | {"step": n + 1, "u": u, "sigma": sigma, "state": stress.state()})
    asked = 1 + steps // every  # a checkpoint may have gone further
    return Profiles(*(np.array(rows[:asked]) for rows in (times, us, sigmas)))


def _check(flow: PlaneFlow, until: float, dt: float, every: int) -> None:
    check_time_step(dt, flow.longest_step)
    if every < 1 or not (math.isfinite(until) and until > 0):
        raise InputError(f"run: expected until > 0 and every ≥ 1, got {until} and {every}")


def _made(kept: dict[str, np.ndarray]) -> tuple[Any, ...]:
    """Steps done, force and wall until then, and what run_plane goes on from."""
    first = int(kept["step"])
    fields = (kept[name].copy() for name in ("u", "sigma"))
    rows = (list(kept[name]) for name in ("t", "us", "sigmas"))
    return first, kept["moved"].reshape(first + 1, 2), *fields, *rows, kept["state"]


def _extend(known: list[tuple[float, float]], flow: PlaneFlow, dt: float, steps: int) -> None:
    """Add force and wall, as so many steps and their last record ask for them, to those known."""
    for n in range(len(known), steps + 1):
        known.append((float(flow.force(n * dt)), float(flow.top((n - 0.5) * dt)) if n else 0.0))


def _check_history(
    file: ArrayFile, kept: np.ndarray, own: list[tuple[float, float]], dt: float
) -> None:
    """Refuse a checkpoint whose force or wall was another, naming which and from when on."""
    differ = np.argwhere(np.reshape(own, (-1, 2)) != kept)
    if len(differ):
        n, which = differ[0]
        raise InputError(
            f"{file.path}: the checkpoint of {file.other}; what differs: "
            f"{('force', 'top')[which]}, from t = {n * dt:g} on ({kept[n, which]:g} there, "
            f"{own[n][which]:g} here)"
        )
