"""The two halves of a step of velocity Verlet with held components, and the work done in them."""

from functools import cache
from types import SimpleNamespace

import warp as wp


@cache
def halves(dimension: int):
    """The kernels in one dimension."""
    vec = wp.types.vector(dimension, wp.float64)

    @wp.func
    def free_of(held: vec):
        free = vec()
        for a in range(dimension):
            free[a] = wp.float64(1.0) - held[a]
        return free

    @wp.kernel(enable_backward=False)
    def kick_and_drift(
        first: wp.int32,
        step: wp.float64,
        inertia: wp.float64,
        share: wp.float64,
        speed: wp.float64,
        force: wp.array(dtype=vec),
        load: wp.array(dtype=vec),
        held: wp.array(dtype=vec),
        grip: wp.array(dtype=vec),
        v: wp.array(dtype=vec),
        work: wp.array(dtype=wp.float64),
        u: wp.array(dtype=vec),
    ):
        """v += Δt/(2ρ) (f + share b), u += Δt v; held components (held = 1) move at speed × grip.

        Work: b·Δu of the load on free components, and the first half of −f·Δu of the hands that
        hold the others.
        """
        i = first + wp.tid()
        free = free_of(held[i])
        kick = step / (wp.float64(2.0) * inertia) * (force[i] + share * load[i])
        w = wp.cw_mul(free, v[i] + kick) + speed * wp.cw_mul(held[i], grip[i])
        du = step * w
        v[i] = w
        u[i] = u[i] + du
        hands = wp.float64(0.5) * wp.dot(wp.cw_mul(held[i], force[i]), du)
        work[i] = work[i] + share * wp.dot(wp.cw_mul(free, load[i]), du) - hands

    @wp.kernel(enable_backward=False)
    def second_kick(
        first: wp.int32,
        step: wp.float64,
        inertia: wp.float64,
        share: wp.float64,
        force: wp.array(dtype=vec),
        load: wp.array(dtype=vec),
        held: wp.array(dtype=vec),
        v: wp.array(dtype=vec),
        work: wp.array(dtype=wp.float64),
    ):
        """v += Δt/(2ρ) (f + share b), the force at the new place, of bonds that break now too."""
        i = first + wp.tid()
        free = free_of(held[i])
        w = v[i]
        hands = wp.float64(0.5) * step * wp.dot(wp.cw_mul(held[i], force[i]), w)
        work[i] = work[i] - hands
        kick = step / (wp.float64(2.0) * inertia) * (force[i] + share * load[i])
        v[i] = w + wp.cw_mul(free, kick)

    return SimpleNamespace(kick_and_drift=kick_and_drift, second_kick=second_kick)
