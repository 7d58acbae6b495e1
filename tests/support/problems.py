"""Problems defined once: lattices, kernels and fields."""

from dataclasses import replace

import numpy as np
from numpy import array, cos, eye, ones, pi, sin
from numpy.random import default_rng

from tests.support import sup
from warp_peri import LPSMaterial, Points, Samples
from warp_peri.points.points import grid_places

ROUNDING = 1e-12
"""Two ways of computing the same number; relative to its size."""

LAM, MU = 0.3, 0.8
AXIS = 0.3
"""Of the crystal on all lattices [rad]; linear solids know of none."""

OTHER = ("nm", "GPa")
"""Units that points and laws are not in by default."""

KERNELS = {
    "1/r": {"alpha": 1.0, "D": [1.0]},
    "steep": {"alpha": 2.9, "D": [1.0]},
    "positive": {"alpha": 0.7, "D": [0.2, 1.0, 0.4, 0.1]},
    "sign-changing": {"alpha": 1.6, "D": [1.0, 0.4, -0.35, 0.15, -0.1]},
    "growing": {"alpha": -0.5, "D": [1.0, 0.3, 0.6]},
}
"""Influence functions of several kinds."""
everywhere = lambda x, spacing=1.0, **told: Points(x, ones(len(x), bool), spacing, **told)
"""Points without a collar."""
within = lambda x, reach: Points(x, np.abs(x).max(1) < reach, 1.0)
"""Points whose interior is nearer to the middle than a reach along each axis."""
on_interior = lambda points, inside, beside=0.0: np.where(points.interior[:, None], inside, beside)
"""Values of the interior, and others beside it."""
cut = lambda points, outside: replace(points, interior=points.interior & ~outside, outside=outside)
"""Points with an interior less what is outside of the body."""
normal = lambda shape, seed=0: default_rng(seed).normal(size=shape)
"""Normal random numbers."""
STENCILS = {2: (1 / 2,), 4: (2 / 3, -1 / 12), 8: (4 / 5, -1 / 5, 4 / 105, -1 / 280)}
fitted_order = lambda spacings, errors: np.polyfit(np.log(spacings), np.log(errors), 1)[0]
"""Slope of the error over the spacing on logarithmic axes."""


def kernel(name, horizon, spacing=1.0, lam=LAM, mu=MU):
    """The model of a named kernel, taken as certified on the spacing."""
    spacings = {"trained_on": (spacing,), "certified_on": (spacing,)}
    return LPSMaterial(lam=lam, mu=mu, horizon=horizon, **KERNELS[name], **spacings)


def rotation(angle, d=2):
    """A turn about the third axis, shape [d, d]."""
    R = eye(d)
    R[:2, :2] = [[cos(angle), -sin(angle)], [sin(angle), cos(angle)]]
    return R


def lattice(interior, horizon, spacing=1.0, angle=0.0, origin=0.0):
    """A lattice around interior nodes (a number or a mask), and the 2δ collar they need."""
    mask = ones((interior, interior), bool) if np.ndim(interior) == 0 else array(interior)
    pad = int(np.ceil(2 * horizon / spacing))
    mask = np.pad(mask, pad)
    x, axis = spacing * (grid_places(mask.shape) - pad), None
    if mask.ndim == 2:
        x, axis = x @ rotation(angle).T, np.rad2deg(AXIS)
    return Points(x + origin, mask.ravel(), spacing, axis=axis)


def assert_balanced(force):
    """That forces on all that they pull at have no sum."""
    assert sup(force.sum(0)) <= 1e-12 * np.abs(force).sum()


def ell():
    """An interior that is no square: an L with a hole."""
    mask = ones((5, 4), bool)
    mask[3:, 2:] = False
    mask[1, 1] = False
    return mask


def periodic(shape, spacing=1.0):
    """A periodic lattice, all of it interior, and its box."""
    points = Points.sheet(shape, spacing, axis=np.rad2deg(AXIS) if len(shape) == 2 else None)
    return points, points.box


def partly_periodic():
    """Periodic, with an interior of nine columns."""
    return replace(periodic((20, 30))[0], interior=np.arange(600) % 30 < 9)


def renumbered(points, order):
    """Points in another order."""
    return replace(points, x=points.x[order], interior=points.interior[order])


def noise(points, samples=None, seed=0):
    """Random displacements, the harshest field there is; shape [N, d] without `samples`."""
    return normal(points.x.shape if samples is None else (samples, *points.x.shape), seed)


def smooth(x, samples, seed=0, wave_number=1.2):
    """Random sums of plane waves of at most the given wave number; shape [S, N, d]."""
    random, d = default_rng(seed), x.shape[1]
    k = random.uniform(-1, 1, size=(samples, 4, d)) * wave_number
    amplitude = random.normal(size=(samples, 4, d))
    phase = random.uniform(0, 2 * pi, size=(samples, 4, 1))
    return np.einsum("swn,swa->sna", cos(np.einsum("swa,na->swn", k, x) + phase), amplitude)


def loaded(operator, u):
    """Fields [S, N, d] and the loads that hold them."""
    return Samples(operator.points, u, operator.on_all(operator(u)))


def manufactured(model, points, samples, seed=0, wave_number=1.2, **options):
    """Samples in exact equilibrium with a model: any smooth u, and b = L u."""
    return loaded(model.on(points, **options), smooth(points.x, samples, seed, wave_number))


def slope(function, step, order=8):
    """Derivative of a function of a number, at zero."""
    return difference(lambda t: function(t[0]), [0.0], step, order)[0]


def difference(function, point, step, order=8):
    """Derivatives of a function of a vector by central differences; shape [vector, …]."""
    point = np.asarray(point, dtype=float)
    out = []
    for e in eye(len(point)) * step:
        pairs = enumerate(STENCILS[order], start=1)
        out.append(
            sum(c * (function(point + n * e) - function(point - n * e)) for n, c in pairs) / step
        )
    return array(out)
