"""A channel with particles, and its run."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from scipy.spatial import cKDTree

from examples.polymer.closure import Stress, check_time_step, in_cells
from examples.polymer.kernels import particles as kernels
from warp_peri import InputError
from warp_peri.runtime import DEVICE, ints, launch, zeros

REACH = 3.0
"""Of the bell, in smoothing lengths."""
SKIN = 0.25
"""By how much neighbours are looked for further, in spacings."""
SHARP = 1 / 3
"""Cancels the third moments of the weight of differences."""


class Particles:
    """The fluid's particles, at rest on a lattice; their images stand for the walls.

    Of the fluid alone, and always as they are now: `x`, `v`: positions, not folded into the period,
    and velocities, shape [N, 2]; `rho`: densities, shape [N]; `sigma`: the polymer's stress (xx,
    xy, yy, zz), `kappa`: velocity gradients (xx, xy, yx, yy), shape [N, 4].
    """

    def __init__(self, flow: ChannelFlow) -> None:
        self.flow, self.t = flow, 0.0
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
        self.x, self.v = (one.numpy()[: self.fluid] for one in (self._x, self._v))
        fields = (self._rho, self._sigma, self._kappa)
        self.rho, self.sigma, self.kappa = (one.numpy() for one in fields)
        self._find()
        self._gather()
        self._mass = 1 / float(self.rho.mean())
        self._record()
        self._gather()
        self._forces()

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
        self.sigma[:] = stress.advance(self.kappa, dt)
        self._forces()
        self._kick()

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
        launch(kernels.place_images, len(parent), [self.fluid, self._parent, self._x])
        x = self._x.numpy()[: self.fluid + len(parent)].copy()
        x[:, 0] %= self.period
        x[:, 1] %= 8.0  # images below the wall, far from all others
        tree = cKDTree(x, boxsize=(self.period, 8.0))
        pairs = tree.query_pairs(reach, output_type="ndarray")
        pairs = np.concatenate([pairs, pairs[:, ::-1]])
        pairs = pairs[np.lexsort(pairs.T[::-1])]
        ends = np.searchsorted(pairs[:, 0], np.arange(self.fluid + 1))
        neighbour = pairs[: ends[-1], 1].astype(np.int32)
        self._row, self._neighbour = ints(ends), ints(neighbour)
        self._bond = zeros(len(neighbour), dtype=wp.vec3d)
        self._moved = 0.0
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


def run_channel(
    flow: ChannelFlow, fluid: Any, *, until: float, dt: float, every: int = 10
) -> ChannelRecord:
    """Run from equilibrium.

    Args:
        flow: the channel.
        fluid: a law, dumbbells, or what `in_cells` takes, of `Particles(flow).fluid` particles.
        until: time at the end [t0].
        dt: time step [t0].
        every: steps between two records.

    Raises InputError for a time step beyond `flow.longest_step`, and as Particles.step does.
    """
    check_time_step(dt, flow.longest_step)
    particles, rows = Particles(flow), []
    stress = in_cells(fluid, flow.De, particles.fluid)
    for n in range(round(until / dt)):
        particles.step(stress, dt)
        if (n + 1) % every == 0:
            fields = (particles.x, particles.v, particles.sigma, particles.rho)
            rows.append((particles.t, *(np.array(value) for value in fields)))
    return ChannelRecord(*(np.array(each) for each in zip(*rows)))
