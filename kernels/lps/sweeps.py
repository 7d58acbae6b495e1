"""The linear solid in two sweeps over bonds, and the sums that its numbers' derivatives are.

Bond e leads from place q to place q + end[e] along ξ; bond[e] holds ξ and 1/r². own[e] = K W/m is
its stiffness and far[e] that of the bond back. With far = own the sweeps are the operator, (6) and
(9); with the bonds back they are its transpose, so that the gradient to u is the force of the
gradient. λ − μ (`bulk`) and μ are one number, or one value a place, each force state its own.

On a lattice all places share the bonds row[0] to row[1], of which own = far. A field lies in
planes: component a of sample s at place q is planes[s, a P + q], and LANES places next to one
another go through a bond together, in vector registers; a bond and its opposite, which follow one
another, go through the operator's sweeps as one. Scattered points, and a lattice with broken
bonds, lie as they are numbered, node by node; each has bonds row[q] to row[q + 1] of its own, and
one lane. A broken bond leads nowhere, end[e] = 0, and has stiffness 0.

A piece is (first place, first number, count): count ≤ LANES nodes that follow one another in places
and in their numbering. Lanes beyond the count compute what nobody keeps. For the processor only:
plain.py has the same in Warp's own words.
"""

from functools import cache
from types import SimpleNamespace

import warp as wp

from warp_peri.kernels.bonds import shared, unpacked

BYTES = 128
"""Of all lanes together: two of the widest registers."""

PLACE = """
    typedef REAL V VECTOR;
    const int base = piece.c[0], number = piece.c[1], count = COUNT;
    const size_t apart = APART;  // of components
    const auto number_at = [&](const REAL* f, int to) -> V { return *(const V*)(f + to); };
    const auto component = [&](const REAL* f, int to, int a) -> V {
        return *(const V*)(f + a * apart + to * NODE);
    };
    const auto of_place = [&](auto& f) { return f.data + size_t(s) * f.shape[1] + base; };
    const auto of_node = [&](auto& f) { return f.data + size_t(s) * f.shape[1] + base * NODE; };
    const auto into = [&](REAL* out, V value) {
        for (int n = 0; n < count; ++n)
            out[n] = ((const REAL*)&value)[n];
    };
    const REAL *bulk_at = bulk.data + base, *mu_at = mu.data + base;
"""
BONDS = """
    for (int e = row.data[FAMILY]; e < row.data[FAMILY + 1]; ++e) {
        const REAL* v = (const REAL*)(bond.data + e);
        const REAL k = own.data[e], l = FAR;
        const int to = end.data[e];
        const auto along = [&](const REAL* f, const V* x) {  // ξ·(l f(ξ) − k f)
            V sum = 0;
            for (int a = 0; a < DIM; ++a)
                sum += v[a] * (ALIKE ? component(f, to, a) - x[a]
                                     : l * component(f, to, a) - k * x[a]);
            return sum;
        };
"""
OWN = """
    const REAL* f = of_node(planes);
    V x[DIM];
    for (int a = 0; a < DIM; ++a)
        x[a] = component(f, 0, a);
"""
PAIRS = """
    for (int e = row.data[0]; e < row.data[1]; e += 2) {
        const REAL* v = (const REAL*)(bond.data + e);
        const REAL k = own.data[e];
        const int to = end.data[e];
"""
DILATATION = {
    False: OWN
    + """
    V total = 0;
    BONDS
        total += (ALIKE ? REAL(DIM) * k : REAL(DIM)) * along(f, x);
    }
    into(of_place(theta), total);
""",
    True: """
    const REAL* f = of_node(planes);
    V total = 0;
    PAIRS
        for (int a = 0; a < DIM; ++a)
            total += (REAL(DIM) * k * v[a]) * (component(f, to, a) - component(f, -to, a));
    }
    into(of_place(theta), total);
""",
}
DENSITY = {
    False: """
    const V mine = BULK(0) * number_at(t, 0);
    BONDS
        const V far = BULK(to) * number_at(t, to);
        const auto shear = REAL(DIM * (DIM + 2)) * v[DIM] * MEAN(to);
        const V density = ALIKE ? (SPREAD * k) * (mine + far) + k * shear * along(f, x)
                                : SPREAD * (k * mine + l * far) + shear * along(f, x);
""",
    True: """
    PAIRS
        V bent = 0;  // ξ·(μ u(ξ) − μ u) of both
        for (int a = 0; a < DIM; ++a)
            bent += v[a] * BENT;
        const V spread = BULK(to) * number_at(t, to) - BULK(-to) * number_at(t, -to);
        const REAL shear = REAL(DIM * (DIM + 2)) * v[DIM] * k;
        const V density = (SPREAD * k) * spread + SHEAR * bent;
""",
}
BENT = {
    False: "((component(f, to, a) + component(f, -to, a)) - 2 * x[a])",
    True: "(MEAN(to) * (component(f, to, a) - x[a]) + MEAN(-to) * (component(f, -to, a) - x[a]))",
}
FORCE = """
    const REAL* t = of_place(theta);
    V out[DIM] = {};
    DENSITY
        for (int a = 0; a < DIM; ++a)
            out[a] -= density * v[a];
    }
    REAL* vector = vectors.data + size_t(s) * vectors.shape[1] + size_t(number) * DIM;
    for (int n = 0; n < count; ++n)
        for (int a = 0; a < DIM; ++a)
            vector[n * DIM + a] = ((const REAL*)&out[a])[n];
"""
LAID = """
    const REAL* vector = values.data + size_t(s) * values.shape[1] + size_t(piece.c[1]) * DIM;
    for (int a = 0; a < DIM; ++a) {
        REAL* plane = planes.data + s * size_t(planes.shape[1]) + a * size_t(theta.shape[1]);
        for (int n = 0; n < piece.c[2]; ++n)
            plane[piece.c[0] + n] = vector[n * DIM + a];
    }
"""
SLOPES = """
    const REAL *t = of_place(theta), *g = of_node(seeds);
    const V mine = BULK(0) * number_at(t, 0), back = number_at(of_place(tau), 0);
    const V pull = SPREAD * BULK(0) * back;
    V y[DIM], bar = 0, total = 0;
    for (int a = 0; a < DIM; ++a)
        y[a] = component(g, 0, a);
    BONDS
        V push = 0, ahead = 0;
        for (int a = 0; a < DIM; ++a) {
            push -= v[a] * y[a];
            ahead += v[a] * (component(f, to, a) - x[a]);
        }
        const REAL shear = REAL(DIM * (DIM + 2)) * v[DIM];
        const V far = BULK(to) * number_at(t, to);
        bar += push * (SPREAD * (mine + far) + (shear * MEAN(to)) * ahead) + pull * ahead;
        total += (ALIKE ? k * shear : shear) * ahead * along(g, y);
        KEEP
    }
    for (int n = 0; n < count; ++n) {
        by_mu.data[base + n] += ((const REAL*)&total)[n];
        by_bulk.data[base + n] += t[n] * ((const REAL*)&back)[n];
    }
"""
KEEP = {
    True: """
        if (e + 1 == row.data[1] || slot.data[e + 1] != slot.data[e]) {
            REAL* sums = by_own.data + size_t(block) * by_own.shape[1] + LANES * slot.data[e];
            for (int n = 0; n < count; ++n)
                sums[n] += ((const REAL*)&bar)[n];
            bar = 0;
        }""",
    False: """
        by_own.data[e] += to == 0 ? 0 : bar;
        bar = 0;""",
}
SCALED = """
    REAL sum = 0;
    for (int e = row.data[base]; e < row.data[base + 1]; ++e)
        sum += by_own.data[e] * own.data[e];
    for (int e = row.data[base]; e < row.data[base + 1]; ++e)
        by_own.data[e] = (by_own.data[e] - sum / bond.data[e].c[DIM]) / m.data[base];
"""


@cache
def struct(scalar, dimension):
    """What a sweep reads: bonds, stiffnesses, moduli; `slot` of a lattice is the class of each bond
    and m, of a list of bonds, the weighted volume of each node."""
    vec = wp.types.vector(dimension + 1, scalar)
    ints, numbers = wp.array(dtype=wp.int32), wp.array(dtype=scalar)

    @wp.struct
    class Law:
        row: ints
        end: ints
        slot: ints
        bond: wp.array(dtype=vec)
        own: numbers
        far: numbers
        m: numbers
        bulk: numbers
        mu: numbers

    return Law


@cache
def sweeps(scalar, dimension, *, lattice, fields):
    """The kernels, for lattices or lists of bonds, with moduli as numbers or as fields."""
    Law = struct(scalar, dimension)
    lanes = BYTES // wp.types.type_size_in_bytes(scalar) if lattice else 1
    vector = "__attribute__((ext_vector_type(LANES), aligned(sizeof(REAL))))"
    words = {
        "DENSITY": DENSITY[lattice], "BENT": BENT[fields],
        "SHEAR": "shear" if fields else "(shear * MEAN(to))",
        "PAIRS": PAIRS, "BONDS": BONDS, "KEEP": KEEP[lattice], "VECTOR": vector if lattice else "",
        "COUNT": "piece.c[2]" if lattice else "1", "FAMILY": "0" if lattice else "base",
        "APART": "theta.shape[1]" if lattice else "1", "NODE": "1" if lattice else "DIM",
        "BULK(0)": "number_at(bulk_at, 0)" if fields else "REAL(1)",
        "BULK(to)": "number_at(bulk_at, to)" if fields else "REAL(1)",
        "BULK(-to)": "number_at(bulk_at, -to)" if fields else "REAL(1)",
        "SPREAD": "REAL(DIM)" if fields else "(REAL(DIM) * bulk.data[0])",
        "MEAN(to)": "(number_at(mu_at, 0) + number_at(mu_at, to))" if fields
        else "(2 * mu.data[0])",
        "MEAN(-to)": "(number_at(mu_at, 0) + number_at(mu_at, -to))",
    }  # fmt: skip
    numbers = {"DIM": dimension, "LANES": lanes, "REAL": f"wp::{scalar.__name__}"}

    def either(body):
        """With bonds that are their own bonds back, as all of a lattice are, or not; of a lattice
        half as many lanes where that is enough."""

        def of(alike, text):
            return text.replace("ALIKE", alike).replace("FAR", "k" if alike == "true" else back)

        back, text = "far.data[e]", PLACE + body
        for word, meaning in words.items():
            text = text.replace(word, meaning)
        if lattice:
            text = of("true", text)
            half = text.replace("LANES", "LANES / 2")
            return f"if (piece.c[2] > LANES / 2) {{{text}}} else {{{half}}}"
        return f"if (far.shape[0] == 0) {{{of('true', text)}}} else {{{of('false', text)}}}"

    def native(text):
        for word, value in numbers.items():
            text = text.replace(word, str(value))
        return wp.func_native(unpacked(Law) + text)

    phases = {"laid": LAID, "needed": either(DILATATION[lattice]), "asked": either(OWN + FORCE)}
    return SimpleNamespace(
        Law=Law,
        lanes=lanes,
        swept=_swept(scalar, Law, native(shared("planes.shape[0]", **phases))),
        slopes=_slopes(scalar, Law, lattice, *map(native, (
            either(OWN + SLOPES).replace("LANES / 2 * slot", "LANES * slot"),
            "const int base = piece.c[0];" + SCALED,
        ))),
    )  # fmt: skip


def _swept(scalar, Law, body):
    """Fields by number into planes; of these dilatations by place, of both forces by number."""
    pieces, table = wp.array(dtype=wp.vec3i), wp.array2d(dtype=scalar)

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


def _slopes(scalar, Law, lattice, piecewise, scaled):
    table, array = wp.array2d(dtype=scalar), wp.array(dtype=scalar)

    @piecewise
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

    @scaled
    def to_stiffness(piece: wp.vec3i, of: Law, by_own: table): ...

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
        """Of g · L u: its derivatives to own, by block, class and lane, to μ and to λ − μ by place.

        g and τ, its dilatation by the transpose, lie as u and θ do. Of lists the derivative to K W
        of each bond, [1, E], which the weighted volume divides.
        """
        block = first + wp.tid()
        for s in range(planes.shape[0]):
            for t in range(ends[block], ends[block + 1]):
                add(block, s, pieces[t], of, planes, theta, seeds, tau, by_own, by_mu, by_bulk)
        if wp.static(not lattice):
            for t in range(ends[block], ends[block + 1]):
                to_stiffness(pieces[t], of, by_own)

    return slopes
