"""What a bond's scalar force state needs of the displacement, and what its force does to nodes.

A bond is listed once, with its ends i and j; p is its number in the pattern of a family, seen
from i. `number[i, p]` is the bond that leads from node i by p, −1 where none is listed.
Y = ξ + u_j − u_i and M = Y/|Y|. Every kernel gathers: it writes its own place, so there is no order
to depend on.
"""

from functools import cache
from types import SimpleNamespace

import warp as wp


@cache
def sweeps(scalar):
    """The kernels in one precision."""
    vec = wp.types.vector(2, scalar)
    one, two = scalar(1.0), scalar(2.0)

    @wp.struct
    class Lattice:
        xi: wp.array(dtype=vec)
        length: wp.array(dtype=scalar)
        opposite: wp.array(dtype=wp.int32)
        neighbour: wp.array2d(dtype=wp.int32)
        number: wp.array2d(dtype=wp.int32)
        near: wp.array(dtype=wp.int32)
        far: wp.array(dtype=wp.int32)
        place: wp.array(dtype=wp.int32)

    @wp.func
    def across(lattice: Lattice, v: wp.array2d(dtype=vec), s: int, i: int, p: int):
        return v[s, lattice.neighbour[i, p]] - v[s, i]

    @wp.kernel(enable_backward=False)
    def extension(
        first: int, lattice: Lattice, u: wp.array2d(dtype=vec), e: wp.array2d(dtype=scalar)
    ):
        """e = |Y| − |ξ| of every bond, without the cancellation."""
        s, n = wp.tid()
        n += first
        p = lattice.place[n]
        xi = lattice.xi[p]
        eta = u[s, lattice.far[n]] - u[s, lattice.near[n]]
        whole = wp.length(xi + eta) + lattice.length[p]
        e[s, n] = (two * wp.dot(xi, eta) + wp.dot(eta, eta)) / whole

    @wp.kernel(enable_backward=False)
    def average(
        first: int,
        lattice: Lattice,
        nodes: wp.array(dtype=wp.int32),
        e: wp.array2d(dtype=scalar),
        share: wp.array(dtype=scalar),
        theta: wp.array2d(dtype=scalar),
    ):
        """Σ_p share_p e over a node's family: ϑ of (NO3)."""
        s, k = wp.tid()
        k += first
        i = nodes[k]
        total = scalar(0.0)
        for p in range(lattice.xi.shape[0]):
            total += share[p] * e[s, lattice.number[i, p]]
        theta[s, k] = total

    @wp.kernel(enable_backward=False)
    def by_share(
        first: int,
        lattice: Lattice,
        nodes: wp.array(dtype=wp.int32),
        e: wp.array2d(dtype=scalar),
        seed: wp.array2d(dtype=scalar),
        out: wp.array(dtype=scalar),
    ):
        """Σ over samples and nodes of seed e: the derivative of `average` to each share."""
        p = first + wp.tid()
        total = scalar(0.0)
        for s in range(seed.shape[0]):
            for k in range(seed.shape[1]):
                total += seed[s, k] * e[s, lattice.number[nodes[k], p]]
        out[p] = total

    @wp.kernel(enable_backward=False)
    def spread(
        first: int,
        lattice: Lattice,
        row: wp.array(dtype=wp.int32),
        share: wp.array(dtype=scalar),
        seed: wp.array2d(dtype=scalar),
        out: wp.array2d(dtype=scalar),
    ):
        """share seed_i + share seed_j of every bond, added: the adjoint of `average`.

        `row` is the place of a node among those that are averaged, −1 for others.
        """
        s, n = wp.tid()
        n += first
        p = lattice.place[n]
        i, j = row[lattice.near[n]], row[lattice.far[n]]
        total = out[s, n]
        if i >= 0:
            total += share[p] * seed[s, i]
        if j >= 0:
            total += share[lattice.opposite[p]] * seed[s, j]
        out[s, n] = total

    @wp.kernel(enable_backward=False)
    def pull(
        first: int,
        lattice: Lattice,
        nodes: wp.array(dtype=wp.int32),
        u: wp.array2d(dtype=vec),
        tension: wp.array2d(dtype=scalar),
        out: wp.array2d(dtype=vec),
    ):
        """−Σ tension M over the listed bonds of some nodes; the adjoint of the extension too."""
        s, k = wp.tid()
        k += first
        i = nodes[k]
        total = vec()
        for p in range(lattice.xi.shape[0]):
            n = lattice.number[i, p]
            if n >= 0 and n < tension.shape[1]:
                M = wp.normalize(lattice.xi[p] + across(lattice, u, s, i, p))
                total -= tension[s, n] * M
        out[s, k] = total

    @wp.kernel(enable_backward=False)
    def turn(
        first: int,
        lattice: Lattice,
        nodes: wp.array(dtype=wp.int32),
        u: wp.array2d(dtype=vec),
        v: wp.array2d(dtype=vec),
        tension: wp.array2d(dtype=scalar),
        out: wp.array2d(dtype=vec),
    ):
        """−Σ tension Ṁ with Ṁ = (1 − M Mᵗ)(v_j − v_i)/|Y|; symmetric, so its own adjoint."""
        s, k = wp.tid()
        k += first
        i = nodes[k]
        total = vec()
        for p in range(lattice.xi.shape[0]):
            n = lattice.number[i, p]
            if n >= 0 and n < tension.shape[1]:
                Y = lattice.xi[p] + across(lattice, u, s, i, p)
                inverse = one / wp.length(Y)
                M = inverse * Y
                w = across(lattice, v, s, i, p)
                total -= (tension[s, n] * inverse) * (w - wp.dot(M, w) * M)
        out[s, k] = total

    @wp.kernel(enable_backward=False)
    def stretching(
        first: int,
        lattice: Lattice,
        u: wp.array2d(dtype=vec),
        v: wp.array2d(dtype=vec),
        out: wp.array2d(dtype=scalar),
    ):
        """M·(v_j − v_i) of every bond: the rate of the extension, and the adjoint of `pull`."""
        s, n = wp.tid()
        n += first
        i, j = lattice.near[n], lattice.far[n]
        M = wp.normalize(lattice.xi[lattice.place[n]] + u[s, j] - u[s, i])
        out[s, n] = wp.dot(M, v[s, j] - v[s, i])

    return SimpleNamespace(
        vec=vec,
        scalar=scalar,
        Lattice=Lattice,
        extension=extension,
        average=average,
        by_share=by_share,
        spread=spread,
        pull=pull,
        turn=turn,
        stretching=stretching,
    )
