"""A channel with particles, and its run."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp
from tqdm import tqdm

from examples.polymer.closure import Stress, check_time_step, in_cells, key_of
from examples.polymer.kernels import particles as kernels
from warp_peri.contract import taken
from warp_peri.dynamics.motion import Motion
from warp_peri.errors import InputError
from warp_peri.files.atomic import ArrayFile, write_text
from warp_peri.files.checkpoint import fingerprint
from warp_peri.files.series import write_vtu
from warp_peri.launch import DEVICE, empty, ints, launch, zeros
from warp_peri.points.scattered import neighbours

REACH = 3.0
"""Of the bell, in smoothing lengths."""
SKIN = 0.25
"""By how much neighbours are looked for further, in spacings."""
SHARP = 1 / 3
"""Cancels the third moments of the weight of differences."""


class Particles:
    """The fluid's particles, at rest on a lattice; their images stand for the walls."""

    def __init__(self, flow: ChannelFlow) -> None:
        self.flow, self.t, self.rebuilds = flow, 0.0, 0
        b = flow.spacing
        along = round(flow.length / b)
        self.period = along * b
        X, Y = np.meshgrid((np.arange(along) + 0.5) * b, (np.arange(flow.across) + 0.5) * b)
        self.fluid = X.size
        self.h, self.reach = flow.smoothing * b, REACH * flow.smoothing * b
        most = 2 * self.fluid  # every particle has one image at most
        inside = np.column_stack([X.ravel(), Y.ravel()])
        self._x: wp.array[Any] = wp.array(np.concatenate([inside, 0 * inside]), dtype=wp.vec2d)
        self._v, self._stress = zeros(most, dtype=wp.vec2d), zeros(most, dtype=wp.vec4d)
        self._sigma = zeros(self.fluid, dtype=wp.vec4d)
        self._kappa = zeros(self.fluid, dtype=wp.vec4d)
        self._inverse = zeros(self.fluid, dtype=wp.mat22d)
        self._rho, self._a = zeros(self.fluid), zeros(self.fluid, dtype=wp.vec2d)
        self._mass, self._recorded_for = 1.0, 0.0
        self._find()
        self._gather()
        self._mass = 1 / float(self._rho.numpy().mean())
        self._record()
        self._gather()
        self._forces()

    @property
    def x(self) -> np.ndarray:
        """Positions of the fluid, x not folded into the period, shape [N, 2]."""
        return np.asarray(self._x.numpy()[: self.fluid])

    @property
    def v(self) -> np.ndarray:
        """Velocities of the fluid, shape [N, 2]."""
        return np.asarray(self._v.numpy()[: self.fluid])

    @property
    def rho(self) -> np.ndarray:
        """Densities, shape [N]."""
        return np.asarray(self._rho.numpy())

    @property
    def sigma(self) -> np.ndarray:
        """The polymer's stress (xx, xy, yy, zz), shape [N, 4]."""
        return np.asarray(self._sigma.numpy())

    @property
    def kappa(self) -> np.ndarray:
        """Velocity gradients (xx, xy, yx, yy), shape [N, 4]."""
        return np.asarray(self._kappa.numpy())

    def step(self, stress: Stress, dt: float) -> None:
        """Kick, drift, stress, kick.

        Raises InputError when particles leave the channel or velocities are not finite.
        """
        if dt != self._recorded_for:
            self._record_moves(dt)
        self._kick()
        self._drift()
        self.t += dt
        self._follow(dt)
        self._gather()
        self._sigma.numpy()[:] = stress.advance(self.kappa, dt)
        self._forces()
        self._kick()

    def state(self) -> dict[str, np.ndarray]:
        """What a checkpoint keeps."""
        kept = {"x": self._x, "v": self._v, "sigma": self._sigma, "near": self._near}
        state = {name: np.array(array.numpy()) for name, array in kept.items()}
        return state | {"t": np.array(self.t), "moved": np.array(self._moved)}

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """Go on from it, with the same bits."""
        self._x.assign(state["near"])
        self._find()
        for array, name in ((self._x, "x"), (self._v, "v"), (self._sigma, "sigma")):
            array.assign(state[name])
        self.t, self._moved = float(state["t"]), float(state["moved"])
        self._gather()
        self._forces()

    def _gather(self) -> None:
        """Images of places and velocities; then densities and gradients."""
        for name in ("places", "images", "gather"):
            self._sweeps[name]()

    def _forces(self) -> None:
        """Pressure beside the stress, images of both, accelerations."""
        for name in ("pressure", "images", "push"):
            self._sweeps[name]()

    def _record(self) -> None:
        """Pack the sweeps' arguments once: for 540 particles packing costs more than sweeping."""
        fluid, flow, images = self.fluid, self.flow, [self.fluid, self._parent]
        shape = wp.vec4d(self.period, self.h, self.reach, SHARP)
        numbers = wp.vec3d(flow.sound**2, flow.force, flow.Re)
        near, bonds = [self._row, self._neighbour], [self._bond, self._inverse]
        fields = [*near, self._x, self._v, shape, self._mass]
        pushed = [*near, *bonds, self._stress, shape, self._mass, numbers]
        parts = [self._sigma, self._kappa, self._rho, flow.sound**2, flow.solvent]
        mirrored, behind = [*images, self._x, flow.force], len(self._parent)
        self._sweeps = {
            "places": recorded(kernels.place_images, behind, images, [self._x]),
            "images": recorded(kernels.image_fields, behind, mirrored, [self._v, self._stress]),
            "gather": recorded(kernels.gather, fluid, fields, [*bonds, self._kappa, self._rho]),
            "pressure": recorded(kernels.total_stress, fluid, parts, [self._stress]),
            "push": recorded(kernels.acceleration, fluid, pushed, [self._a]),
        }

    def _record_moves(self, dt: float) -> None:
        self._kick = recorded(kernels.kick, self.fluid, [self._a, dt / 2], [self._v])
        self._drift = recorded(kernels.drift, self.fluid, [self._v, dt], [self._x])
        self._recorded_for = dt

    def _follow(self, dt: float) -> None:
        """Look for neighbours again when two particles may have come nearer than the skin."""
        self._moved += float(np.abs(self.v).max()) * dt
        if not self._moved < self.flow.spacing:
            raise InputError(
                f"channel: velocities are not finite or too large at t = {self.t:.4g}; "
                f"expected a time step up to {self.flow.longest_step:.3g}"
            )
        if self._moved > 0.5 * SKIN * self.flow.spacing:
            self._find()

    def _find(self) -> None:
        y = self.x[:, 1]
        outside = int(((y < 0) | (y > 1)).sum())
        if outside:
            raise InputError(
                f"channel: {outside} particles left through a wall at t = {self.t:.4g}"
            )
        reach = self.reach + SKIN * self.flow.spacing
        parent = np.flatnonzero((y < reach) | (y > 1 - reach))
        self._parent = ints(parent)
        launch(kernels.place_images, len(parent), [self.fluid, self._parent], [self._x])
        x = self._x.numpy()[: self.fluid + len(parent)].copy()
        x[:, 0] %= self.period
        row, neighbour, _ = neighbours(x, reach, (self.period, 8.0))
        self._row, self._neighbour = ints(row[: self.fluid + 1]), ints(neighbour)
        self._bond = empty(len(neighbour), dtype=wp.vec3d)
        self._near = wp.clone(self._x)
        self._moved = 0.0
        self.rebuilds += 1
        self._record()


def recorded(kernel: Any, dim: int, inputs: list[Any], outputs: list[Any]) -> Callable[[], None]:
    """A launch with its arguments packed once, to be called again and again."""
    kernel.module.load(outputs[0].device)
    command = wp.launch(
        kernel, dim=dim, inputs=inputs, outputs=outputs, device=DEVICE, record_cmd=True
    )
    return command.launch


@dataclass(frozen=True)
class ChannelFlow:
    """What is printed for the channel, unless said.

    Args:
        De: relaxation time over t0.
        Re: Reynolds number.
        sound: artificial speed of sound Cs.
        force: body force along x.
        across: particles from wall to wall.
        length: of the period along x, in widths.
        smoothing: length of the bell, in spacings.
        solvent: its viscosity β over that of the polymer (Oldroyd-B and the like).

    Raises InputError for numbers that are not positive or not finite, fewer than 10 particles
    across or no whole number of them, or a period shorter than twice the reach.
    """

    De: float
    Re: float = 1e-2
    sound: float = 10.0
    force: float = 12.0
    across: int = 30
    length: float = 0.6
    smoothing: float = 1.5
    solvent: float = 0.0

    def __post_init__(self) -> None:
        numbers = (self.De, self.Re, self.sound, self.length, self.smoothing)
        positive = all(math.isfinite(n) and n > 0 for n in numbers) and self.solvent >= 0
        finite = math.isfinite(self.solvent) and math.isfinite(self.force)
        if not (positive and finite and self.across >= 10 and self.across == int(self.across)):
            raise InputError(
                f"channel: expected numbers above 0 and 10 particles across, got {self}"
            )
        reach = (REACH * self.smoothing + SKIN) / self.across
        if not 2 * reach < self.length:
            raise InputError(f"channel: expected a period above {2 * reach:.3g}, got {self.length}")

    def moved(self, material: Any, options: dict[str, Any]) -> Motion:
        """From rest, of a law, of dumbbells or of what `in_cells` takes.

        The options are those of run_channel: `until`, `dt`, `every`, `checkpoint`, `progress`. The
        histories, by particle, are x and u [T, N, 2], stress [T, N, 4] and density [T, N]; the
        details are a ChannelRecord.
        """
        (how,) = taken(options, "move", run_channel)
        run = run_channel(self, in_cells(material, self.De, Particles(self).fluid), **how)
        history = {"u": run.v, "x": run.x, "stress": run.sigma, "density": run.rho}
        return Motion(run.t, run.v[-1], None, history, run)

    @property
    def spacing(self) -> float:
        """Between particles at the start."""
        return 1 / self.across

    @property
    def longest_step(self) -> float:
        """Δt beyond which sound, shear waves or the solvent's diffusion outrun a spacing."""
        wave = self.sound**2 / self.Re + 2 / (self.De * self.Re)
        diffusion = 4 * self.solvent / (self.Re * self.spacing**2)
        return 1 / (math.sqrt(wave) / self.spacing + diffusion)


@dataclass(frozen=True)
class ChannelRecord:
    """What the fluid's particles did.

    Args:
        t: times [T].
        x: positions [T, N, 2].
        v: velocities [T, N, 2].
        sigma: stress of the polymer [T, N, 4].
        rho: densities [T, N].
    """

    t: np.ndarray
    x: np.ndarray
    v: np.ndarray
    sigma: np.ndarray
    rho: np.ndarray

    def centre(self) -> np.ndarray:
        """Mean u of the particles next to the middle, at all times."""
        gap = np.abs(self.x[:, :, 1] - 0.5)
        near = gap < gap.min(axis=1, keepdims=True) + 1e-3
        return np.asarray((self.v[:, :, 0] * near).sum(axis=1) / near.sum(axis=1))

    def profile(self, bins: int) -> tuple[np.ndarray, np.ndarray]:
        """Heights of equal bins [bins], and the mean u of the particles in them [T, bins].

        NaN where there are none. Raises InputError for fewer bins than one.
        """
        if bins < 1:
            raise InputError(f"bins: expected 1 or more, got {bins}")
        heights = (np.arange(bins) + 0.5) / bins
        place = np.clip((self.x[:, :, 1] * bins).astype(int), 0, bins - 1)
        count = np.array([np.bincount(row, minlength=bins) for row in place])
        total = [np.bincount(row, v[:, 0], bins) for row, v in zip(place, self.v)]
        return heights, np.array(total) / np.where(count, count, np.nan)

    def save_csv(self, path: str | os.PathLike[str], bins: int = 30) -> None:
        """A line a time: t, then the mean u in bins from wall to wall, nan in empty ones."""
        heights, u = self.profile(bins)
        head = "# time in t0 = L/U; u in U at y = " + ",".join(f"{y:.6g}" for y in heights)
        rows = [",".join(f"{x:.12g}" for x in (t, *now)) for t, now in zip(self.t, u)]
        write_text(path, "\n".join([head, *rows]) + "\n")

    def save_vtu(self, folder: str | os.PathLike[str]) -> list[Path]:
        """One file a time, flow_0000.vtu and so on. Raises InputError without meshio."""
        paths = []
        for n, (x, v, s, rho) in enumerate(zip(self.x, self.v, self.sigma, self.rho)):
            data = {"velocity": v, "density": rho}
            data |= {f"stress_{name}": s[:, i] for i, name in enumerate(("xx", "xy", "yy", "zz"))}
            cells = "vertex", np.arange(len(x))[:, None]
            paths.append(write_vtu(Path(folder) / f"flow_{n:04d}.vtu", x, cells, data))
        return paths


def run_channel(
    flow: ChannelFlow,
    stress: Stress,
    *,
    until: float,
    dt: float,
    every: int = 10,
    checkpoint: str | os.PathLike[str] | None = None,
    progress: bool = False,
) -> ChannelRecord:
    """Run from rest.

    Args:
        flow: the channel.
        stress: what its particles, `Particles(flow).fluid` of them, are made of; at rest.
        until: time at the end [t0].
        dt: time step [t0].
        every: steps between two records.
        checkpoint: file written at every tenth record, and with the last record when a run fails; a
            run that finds its own goes on from it.
        progress: whether to show a bar.

    Raises InputError for a time step beyond `flow.longest_step`, a run shorter than one record, a
    checkpoint of another run, and as Particles.step does.
    """
    _check(flow, until, dt, every)
    particles, steps = Particles(flow), round(until / dt)
    key = "" if checkpoint is None else fingerprint(flow, dt, every, key_of(stress))
    kept: dict[str, list[Any]] = {name: [] for name in ("t", "x", "v", "sigma", "rho")}
    first, own = 0, {f"particles_{name}": name for name in particles.state()}
    file = ArrayFile(checkpoint, key, "another channel, fluid or time step")

    def made(arrays: dict[str, np.ndarray]) -> tuple[Any, ...]:
        state = {name: arrays[long] for long, name in own.items()}
        return int(arrays["done"]), state, arrays["stress"], {n: list(arrays[n]) for n in kept}

    if (found := file.read(made)) is not None:
        first, there, fluid, kept = found
        particles.restore(there)
        stress.restore(fluid)

    def state(done: int) -> dict[str, Any]:
        content = {name: np.array(rows) for name, rows in kept.items()}
        now = particles.state()
        content |= {long: now[name] for long, name in own.items()}
        return content | {"stress": stress.state(), "done": done}

    good = state(first) if checkpoint is not None else {}
    bar = tqdm(range(first, steps), disable=not progress, desc="channel", initial=first)
    try:
        for n in bar:
            particles.step(stress, dt)
            if (n + 1) % every:
                continue
            row = (particles.t, particles.x, particles.v, particles.sigma, particles.rho)
            for name, value in zip(kept, row):
                kept[name].append(np.array(value))
            if checkpoint is None:
                continue
            good = state(n + 1)
            if (n + 1) % (10 * every) == 0 or n + 1 == steps:
                file.write(good)
    except InputError:
        file.write(good)
        raise
    asked = steps // every  # a checkpoint may have gone further
    return ChannelRecord(*(np.array(rows[:asked]) for rows in kept.values()))


def _check(flow: ChannelFlow, until: float, dt: float, every: int) -> None:
    check_time_step(dt, flow.longest_step)
    if every < 1 or not until >= every * dt * (1 - 1e-9) or until == np.inf:
        raise InputError(
            f"run: expected every ≥ 1 and until of so many steps of {dt:g} or more, got {every} "
            f"and {until}"
        )
