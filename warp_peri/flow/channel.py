"""A channel of smoothed particles in Warp: periodic along x, walls at y = 0 and 1 (F25–F29).

Lengths in the channel's width, time in t0, stress in η/t0.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from warp_peri.errors import InputError
from warp_peri.flow.closure import Stress
from warp_peri.kernels.flow import particles as kernels
from warp_peri.launch import DEVICE, empty, ints, launch, zeros
from warp_peri.points.scattered import neighbours

if TYPE_CHECKING:
    from warp_peri.flow.channel_run import ChannelFlow

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
    return command.launch  # type: ignore[no-any-return]
