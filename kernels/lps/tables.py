"""The sweeps while the law stays as it is: what a bond does is read from a table, not computed.

With k = K W/m bond e holds the vector a = k ξ and the number s = 1/(k r²), so that

  θ_i = c1 Σ a·(u_j − u_i),   (L u)_i = Σ (−c1 (λ−μ) (θ_i + θ_j) − c2 μ s a·(u_j − u_i)) a

are (6) and (9): 24 bytes a bond in double precision and the number of its far end, one stream for
both sweeps. For the processor; four bonds at a time, each with a sum of its own, since one sum
would wait for itself.
"""

from functools import cache
from types import SimpleNamespace

import warp as wp

from warp_peri.kernels.bonds import bonds

DILATATION = """
    const REAL* v = (const REAL*)(u.data + size_t(s) * u.shape[1]);
    const REAL* x = v + DIM * size_t(i);
    REAL t[DIM][4] = {};
    auto add = [&](int e, int l) {
        const REAL* far = v + DIM * size_t(table.ends.data[e]);
        const REAL* a = (const REAL*)(table.vectors.data + e);
        for (int d = 0; d < DIM; ++d)
            t[d][l] += a[d] * (far[d] - x[d]);
    };
    BONDS
    REAL sum = (t[0][0] + t[0][1]) + (t[0][2] + t[0][3]);
    for (int d = 1; d < DIM; ++d)
        sum += (t[d][0] + t[d][1]) + (t[d][2] + t[d][3]);
    theta.data[size_t(s) * theta.shape[1] + i] = REAL(DIM) * sum;
"""
FORCE = """
    const REAL* v = (const REAL*)(u.data + size_t(s) * u.shape[1]);
    const REAL* t = theta.data + size_t(s) * theta.shape[1];
    const REAL* x = v + DIM * size_t(i);
    const REAL own = t[i];
    REAL f[DIM][4] = {};
    auto add = [&](int e, int l) {
        const int j = table.ends.data[e];
        const REAL* far = v + DIM * size_t(j);
        const REAL* a = (const REAL*)(table.vectors.data + e);
        REAL stretch = a[0] * (far[0] - x[0]);
        for (int d = 1; d < DIM; ++d)
            stretch += a[d] * (far[d] - x[d]);
        const REAL density = bulk * (own + t[j]) + shear * (stretch * table.numbers.data[e]);
        for (int d = 0; d < DIM; ++d)
            f[d][l] += density * a[d];
    };
    BONDS
    REAL* out = (REAL*)(Lu.data + size_t(s) * Lu.shape[1] + number);
    for (int d = 0; d < DIM; ++d)
        out[d] = (f[d][0] + f[d][1]) + (f[d][2] + f[d][3]);
"""
BONDS = """
    int e = table.row.data[i];
    const int end = table.row.data[i + 1];
    for (; e + 4 <= end; e += 4)
        for (int l = 0; l < 4; ++l)
            add(e + l, l);
    for (; e < end; ++e)
        add(e, 0);
"""


@cache
def tables(scalar, dimension):
    """The kernels in one precision and dimension."""
    of = bonds(scalar, dimension)
    vec = of.vec

    @wp.struct
    class Table:
        row: wp.array(dtype=wp.int32)
        ends: wp.array(dtype=wp.int32)
        vectors: wp.array(dtype=vec)
        numbers: wp.array(dtype=scalar)

    def native(body):
        body = body.replace("BONDS", BONDS).replace("DIM", str(dimension))
        return body.replace("REAL", f"wp::{scalar.__name__}")

    return SimpleNamespace(
        Table=Table,
        filled=_filled(of),
        dilatation=_dilatation(of, Table, native(DILATATION)),
        force=_force(of, Table, native(FORCE)),
    )


def _filled(of):
    last, xi_of = of.dimension, of.xi_of
    scalar, vec, BondArrays, bond_of = of.scalar, of.vec, of.BondArrays, of.bond_of
    bond_class_of, volume_of, scalar_at = of.bond_class_of, of.volume_of, of.scalar_at

    @wp.kernel(enable_backward=False, module="unique")
    def filled(
        first: wp.int32,
        nodes: wp.array(dtype=wp.int32),
        bonds: BondArrays,
        kw: wp.array(dtype=scalar),
        m: wp.array(dtype=scalar),
        vectors: wp.array(dtype=vec),
        numbers: wp.array(dtype=scalar),
    ):
        """a and s of the bonds of some nodes; zero of broken bonds, which do nothing."""
        i = nodes[first + wp.tid()]
        begin = bonds.row[i]
        skip = bonds.lattice * begin
        v = volume_of(bonds, i)
        for e in range(begin, bonds.row[i + 1]):
            j = bonds.neighbour[e]
            if j >= 0:
                bond = bond_of(bonds, e - skip, i, j)
                k = scalar_at(kw, bond_class_of(bonds, e - skip)) / m[v]
                if k != scalar(0.0):
                    vectors[e] = k * xi_of(bond)
                    numbers[e] = bond[last] / k

    return filled


def _dilatation(of, Table, body):
    scalar, vec = of.scalar, of.vec

    @wp.func_native(body)
    def row_of_bonds(
        s: wp.int32,
        i: wp.int32,
        table: Table,
        u: wp.array2d(dtype=vec),
        theta: wp.array2d(dtype=scalar),
    ): ...

    @wp.kernel(enable_backward=False, module="unique")
    def dilatation(
        first: wp.int32,
        nodes: wp.array(dtype=wp.int32),
        table: Table,
        u: wp.array2d(dtype=vec),
        theta: wp.array2d(dtype=scalar),
    ):
        """θ of some nodes, (6)."""
        s, t = wp.tid()
        row_of_bonds(s, nodes[first + t], table, u, theta)

    return dilatation


def _force(of, Table, body):
    c1, c2 = of.c1, of.c2
    scalar, vec = of.scalar, of.vec

    @wp.func_native(body)
    def row_of_bonds(
        s: wp.int32,
        number: wp.int32,
        i: wp.int32,
        bulk: scalar,
        shear: scalar,
        table: Table,
        u: wp.array2d(dtype=vec),
        theta: wp.array2d(dtype=scalar),
        Lu: wp.array2d(dtype=vec),
    ): ...

    @wp.kernel(enable_backward=False, module="unique")
    def force(
        first: wp.int32,
        nodes: wp.array(dtype=wp.int32),
        table: Table,
        lam: wp.array(dtype=scalar),
        mu: wp.array(dtype=scalar),
        u: wp.array2d(dtype=vec),
        theta: wp.array2d(dtype=scalar),
        Lu: wp.array2d(dtype=vec),
    ):
        """L u of some nodes, (9)."""
        s, t = wp.tid()
        bulk = -c1 * (lam[0] - mu[0])
        shear = -c2 * mu[0]
        row_of_bonds(s, first + t, nodes[first + t], bulk, shear, table, u, theta, Lu)

    return force
