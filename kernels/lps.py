"""The linear solid in two sweeps over bonds, and the sums that its numbers' derivatives are.

Bond e leads from place q to place q + end[e] along ξ; bond[e] holds ξ and 1/r². own[e] = K W/m is
its stiffness and far[e] that of the bond back, of which a sweep that is given one is the transpose:
L, (6) and (9), is its own transpose once each bond reads the values of the bond back. λ − μ
(`bulk`) and μ are one number, or one value a place, each force state its own.

On a lattice all places share the bonds row[0] to row[1], of which own = far. A field lies in
planes: component a of sample s at place q is planes[s, a P + q], and LANES places next to one
another go through a bond together, in vector registers; a bond and its opposite, which follow one
another, go through the operator's sweeps as one. Scattered points, and a lattice with broken
bonds, lie as they are numbered, node by node; each has bonds row[q] to row[q + 1] of its own, and
one lane. Their dilatation is the sum of bent[e]·(u(ξ) − u), bent = d own ξ but where a node has
lost bonds (40–41), and bent_back is minus that of the bond back; without such nodes both are empty.
A broken bond leads nowhere, end[e] = 0, and is 0.

A piece is (first place, first number, count): count ≤ LANES nodes that follow one another in places
and in their numbering. Lanes beyond the count compute what nobody keeps.
"""

from functools import cache
from types import SimpleNamespace

import warp as wp

from warp_peri.kernels.bonds import shared, unpacked

LANES = 16
"""Of double precision: two of the widest registers."""

PLACE = """
    typedef double V VECTOR;
    const int base = piece.c[0], number = piece.c[1], count = COUNT;
    const size_t apart = APART;  // of components
    const auto number_at = [&](const double* f, int to) -> V { return *(const V*)(f + to); };
    const auto component = [&](const double* f, int to, int a) -> V {
        return *(const V*)(f + a * apart + to * NODE);
    };
    const auto of_place = [&](auto& f) { return f.data + size_t(s) * f.shape[1] + base; };
    const auto of_node = [&](auto& f) { return f.data + size_t(s) * f.shape[1] + base * NODE; };
    const auto into = [&](double* out, V value) {
        for (int n = 0; n < count; ++n)
            out[n] = ((const double*)&value)[n];
    };
    const double *bulk_at = bulk.data + base, *mu_at = mu.data + base;
"""
BONDS = """
    for (int e = row.data[FAMILY]; e < row.data[FAMILY + 1]; ++e) {
        const double* v = (const double*)(bond.data + e);
        const double k = own.data[e], l = FAR;
        const int to = end.data[e];
        const auto along = [&](const double* f, const V* x) {  // ξ·(l f(ξ) − k f)
            V sum = 0;
            for (int a = 0; a < DIM; ++a)
                sum += v[a] * (FORWARD ? component(f, to, a) - x[a]
                                       : l * component(f, to, a) - k * x[a]);
            return FORWARD ? k * sum : sum;
        };
"""
OWN = """
    const double* f = of_node(planes);
    V x[DIM];
    for (int a = 0; a < DIM; ++a)
        x[a] = component(f, 0, a);
"""
PAIRS = """
    for (int e = row.data[0]; e < row.data[1]; e += 2) {
        const double* v = (const double*)(bond.data + e);
        const double k = own.data[e];
        const int to = end.data[e];
"""
DILATATION = {
    False: OWN
    + """
    const bool lost = bent.shape[0];
    V total = 0;
    BONDS
        if (FORWARD && lost)
            for (int a = 0; a < DIM; ++a)
                total += bent.data[e].c[a] * (component(f, to, a) - x[a]);
        else
            total += DIM * along(f, x);
    }
    into(of_place(theta), total);
""",
    True: """
    const double* f = of_node(planes);
    V total = 0;
    PAIRS
        for (int a = 0; a < DIM; ++a)
            total += (DIM * k * v[a]) * (component(f, to, a) - component(f, -to, a));
    }
    into(of_place(theta), total);
""",
}
DENSITY = {
    False: """
    const bool lost = bent.shape[0];
    const V mine = BULK(0) * number_at(t, 0);
    BONDS
        const V far = BULK(to) * number_at(t, to);
        const V shear = DIM * (DIM + 2) * v[DIM] * MEAN(to) * along(f, x);
        if (!FORWARD && lost)
            for (int a = 0; a < DIM; ++a)
                out[a] -= WHOLE * (bent.data[e].c[a] * mine + bent_back.data[e].c[a] * far);
        const V spread = FORWARD ? k * (mine + far) : lost ? V(0) : k * mine + l * far;
        const V density = DIM * WHOLE * spread + shear;
""",
    True: """
    PAIRS
        V bent = 0;  // ξ·(μ u(ξ) − μ u) of both
        for (int a = 0; a < DIM; ++a)
            bent += v[a] * BENT;
        const V spread = BULK(to) * number_at(t, to) - BULK(-to) * number_at(t, -to);
        const double shear = DIM * (DIM + 2) * v[DIM] * k;
        const V density = (DIM * WHOLE * k) * spread + SHEAR * bent;
""",
}
BENT = {
    False: "((component(f, to, a) + component(f, -to, a)) - 2 * x[a])",
    True: "(MEAN(to) * (component(f, to, a) - x[a]) + MEAN(-to) * (component(f, -to, a) - x[a]))",
}
FORCE = """
    const double* t = of_place(theta);
    V out[DIM] = {};
    DENSITY
        for (int a = 0; a < DIM; ++a)
            out[a] -= density * v[a];
    }
    double* vector = vectors.data + size_t(s) * vectors.shape[1] + size_t(number) * DIM;
    for (int n = 0; n < count; ++n)
        for (int a = 0; a < DIM; ++a)
            vector[n * DIM + a] = ((const double*)&out[a])[n];
"""
LAID = """
    const double* vector = values.data + size_t(s) * values.shape[1] + size_t(piece.c[1]) * DIM;
    for (int a = 0; a < DIM; ++a) {
        double* plane = planes.data + s * size_t(planes.shape[1]) + a * size_t(theta.shape[1]);
        for (int n = 0; n < piece.c[2]; ++n)
            plane[piece.c[0] + n] = vector[n * DIM + a];
    }
"""
SLOPES = """
    const double *t = of_place(theta), *g = of_node(seeds);
    const V mine = BULK(0) * number_at(t, 0), back = number_at(of_place(tau), 0);
    const V pull = DIM * WHOLE * BULK(0) * back;
    V y[DIM], total = 0;
    for (int a = 0; a < DIM; ++a)
        y[a] = component(g, 0, a);
    BONDS
        V push = 0, ahead = 0;
        for (int a = 0; a < DIM; ++a) {
            push -= v[a] * y[a];
            ahead += v[a] * (component(f, to, a) - x[a]);
        }
        const double shear = DIM * (DIM + 2) * v[DIM];
        const V far = BULK(to) * number_at(t, to);
        const V bar = push * (DIM * WHOLE * (mine + far) + (shear * MEAN(to)) * ahead)
            + pull * ahead;
        total += shear * ahead * along(g, y);
        double* sums = by_own.data + size_t(BLOCK) * by_own.shape[1] + PLACES * e;
        for (int n = 0; n < count; ++n)
            sums[n] += ((const double*)&bar)[n];
    }
    for (int n = 0; n < count; ++n) {
        by_mu.data[base + n] += ((const double*)&total)[n];
        by_bulk.data[base + n] += t[n] * ((const double*)&back)[n];
    }
"""


@cache
def struct(dimension):
    """What a sweep reads: bonds, stiffnesses, moduli."""
    vec, wide = (wp.types.vector(d, wp.float64) for d in (dimension, dimension + 1))
    ints, numbers = wp.array(dtype=wp.int32), wp.array(dtype=wp.float64)

    @wp.struct
    class Law:
        row: ints
        end: ints
        bond: wp.array(dtype=wide)
        own: numbers
        bulk: numbers
        mu: numbers
        bent: wp.array(dtype=vec)
        far: numbers
        bent_back: wp.array(dtype=vec)

    return Law


@cache
def sweeps(dimension, *, lattice, fields):
    """The kernels, for lattices or lists of bonds, with moduli as numbers or as fields."""
    Law, lanes = struct(dimension), LANES if lattice else 1
    vector = "__attribute__((ext_vector_type(LANES), aligned(sizeof(double))))"
    words = {
        "DENSITY": DENSITY[lattice], "BENT": BENT[fields],
        "SHEAR": "shear" if fields else "(shear * MEAN(to))",
        "PAIRS": PAIRS, "BONDS": BONDS, "VECTOR": vector if lattice else "",
        "COUNT": "piece.c[2]" if lattice else "1", "FAMILY": "0" if lattice else "base",
        "APART": "theta.shape[1]" if lattice else "1", "NODE": "1" if lattice else "DIM",
        "BULK(0)": "number_at(bulk_at, 0)" if fields else "double(1)",
        "BULK(to)": "number_at(bulk_at, to)" if fields else "double(1)",
        "BULK(-to)": "number_at(bulk_at, -to)" if fields else "double(1)",
        "WHOLE": "double(1)" if fields else "bulk.data[0]",
        "MEAN(to)": "(number_at(mu_at, 0) + number_at(mu_at, to))" if fields
        else "(2 * mu.data[0])",
        "MEAN(-to)": "(number_at(mu_at, 0) + number_at(mu_at, -to))",
        "PLACES": str(lanes), "BLOCK": "block" if lattice else "0",
    }  # fmt: skip

    def either(body):
        """As it is, or transposed, which of a lattice is the same; of a lattice half as many lanes
        where that is enough."""
        text = PLACE + body
        for word, meaning in words.items():
            text = text.replace(word, meaning)
        if lattice:
            text = text.replace("FORWARD", "true").replace("FAR", "k")
            half = text.replace("LANES", str(LANES // 2))
            return f"if (piece.c[2] > {LANES // 2}) {{{text}}} else {{{half}}}"
        forward = text.replace("FORWARD", "true").replace("FAR", "k")
        back = text.replace("FORWARD", "false").replace("FAR", "far.data[e]")
        return f"if (far.shape[0] == 0) {{{forward}}} else {{{back}}}"

    def native(text):
        text = text.replace("LANES", str(LANES)).replace("DIM", str(dimension))
        return wp.func_native(unpacked(Law) + text)

    phases = {"laid": LAID, "needed": either(DILATATION[lattice]), "asked": either(OWN + FORCE)}
    swept = _swept(Law, native(shared("planes.shape[0]", **phases)))
    slopes = _slopes(Law, native(either(OWN + SLOPES)))
    return SimpleNamespace(lanes=lanes, swept=swept, slopes=slopes)


def _swept(Law, body):
    """Fields by number into planes; of these dilatations by place, of both forces by number."""
    pieces, table = wp.array(dtype=wp.vec3i), wp.array2d(dtype=wp.float64)

    @body
    def share(
        turns: wp.array(dtype=wp.int32),
        laid: pieces,
        needed: pieces,
        asked: pieces,
        of: Law,
        values: table,
        planes: table,
        theta: table,
        vectors: table,
    ): ...

    @wp.kernel(enable_backward=False, module="unique")
    def swept(
        turns: wp.array(dtype=wp.int32),
        laid: pieces,
        needed: pieces,
        asked: pieces,
        of: Law,
        values: table,
        planes: table,
        theta: table,
        vectors: table,
    ):
        share(turns, laid, needed, asked, of, values, planes, theta, vectors)

    return swept


def _slopes(Law, body):
    table, array = wp.array2d(dtype=wp.float64), wp.array(dtype=wp.float64)

    @body
    def add(
        block: wp.int32,
        s: wp.int32,
        piece: wp.vec3i,
        of: Law,
        planes: table,
        theta: table,
        seeds: table,
        tau: table,
        by_own: table,
        by_mu: array,
        by_bulk: array,
    ): ...

    @wp.kernel(enable_backward=False, module="unique")
    def slopes(
        first: wp.int32,
        ends: wp.array(dtype=wp.int32),
        pieces: wp.array(dtype=wp.vec3i),
        of: Law,
        planes: table,
        theta: table,
        seeds: table,
        tau: table,
        by_own: table,
        by_mu: array,
        by_bulk: array,
    ):
        """Of g · L u: its derivatives to own, by block, bond and lane, to μ and to λ − μ by place.

        g and τ, its dilatation by the transpose, lie as u and θ do.
        """
        block = first + wp.tid()
        for s in range(planes.shape[0]):
            for t in range(ends[block], ends[block + 1]):
                add(block, s, pieces[t], of, planes, theta, seeds, tau, by_own, by_mu, by_bulk)

    return slopes
