"""A tabulated rate advanced in Warp, all cells in one launch."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp
from scipy.interpolate import CubicSpline

from warp_peri.kernels.flow.rate_tables import heun_steps
from warp_peri.launch import DEVICE, floats, zeros


class RateMarch:
    """Heun steps of n states by tables that stay on the device.

    Args:
        n: states.
        splines: one of three values for each of the seven inputs, on equal knots.
        middle: what is added to their sum, shape [3].
        kinematics: whether the flow's own part is added.
    """

    def __init__(
        self, n: int, splines: list[CubicSpline], middle: np.ndarray, kinematics: bool
    ) -> None:
        widths = np.array([spline.x[1] - spline.x[0] for spline in splines])
        powers = widths[:, None] ** np.arange(3, -1, -1)
        table = np.array([np.moveaxis(spline.c, 1, 0) for spline in splines])
        low = np.array([spline.x[0] for spline in splines])
        self._K, self._C = zeros(n, dtype=wp.vec4d), zeros(n, dtype=wp.vec4d)
        self._table = floats(np.ascontiguousarray(table * powers[:, None, :, None]), wp.vec3d)
        self._low, self._scale = floats(low), floats(1 / widths)
        heun_steps.module.load(DEVICE)
        fixed: list[Any] = [self._table, self._low, self._scale, wp.vec3d(*middle)]
        self._first = 2 + len(fixed)
        self._launch = wp.launch(
            heun_steps, dim=n, inputs=[self._K, *fixed, float(kinematics), 0.0, 0],
            outputs=[self._C], device=DEVICE, record_cmd=True,
        )  # fmt: skip

    def __call__(self, K: np.ndarray, C: np.ndarray, h: float, parts: int) -> np.ndarray:
        """C [n, 4] after `parts` steps of h relaxation times under K [n, 4] held."""
        self._K.numpy()[:] = K
        self._C.numpy()[:] = C
        self._launch.set_param_at_index(self._first, h)
        self._launch.set_param_at_index(self._first + 1, parts)
        self._launch.launch()
        return np.array(self._C.numpy())
