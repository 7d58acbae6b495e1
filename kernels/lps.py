"""The linear solid in two sweeps over bonds, and the sums that its numbers' derivatives are.

Bond e leads from place q to place q + end[e] along ξ; bond[e] holds ξ and 1/r². own[e] = K W/m is
its stiffness. A sweep that is given the number back[e] of the bond back is the transpose: L, (6)
and (9), is its own transpose once each bond reads the values of the bond back. λ − μ (`bulk`) and
μ are one number, or one value a place, each force state its own.

On a lattice all places share the bonds row[0] to row[1], as stiff as those back. A field lies in
planes: component a of sample s at place q is planes[s, a P + q], and LANES places next to one
another go through a bond together, in vector registers; a bond and its opposite, which follow one
another, go through the operator's sweeps as one. Scattered points, and a lattice with broken
bonds, lie as they are numbered, node by node; each has bonds row[q] to row[q + 1] of its own, and
one lane. Their dilatation is the sum of bent[e]·(u(ξ) − u), bent = d own ξ but where a node has
lost bonds (40–41), and transposed minus that of the bond back; without such nodes bent is empty.
A broken bond leads nowhere, end[e] = 0, and is 0.

A piece is (first place, first number, count): count ≤ LANES nodes that follow one another in places
and in their numbering. Lanes beyond the count compute what nobody keeps.
"""

from functools import cache
from types import SimpleNamespace

import warp as wp

from warp_peri.kernels.bonds import shared, unpacked

ints, numbers = wp.array(dtype=wp.int32), wp.array(dtype=wp.float64)
pieces, table = wp.array(dtype=wp.vec3i), wp.array2d(dtype=wp.float64)
LANES = 16
"""Of double precision: two of the widest registers."""

PLACE = """
    typedef double V VECTOR;
    const int base = piece.c[0], number = piece.c[1], count = COUNT;
    const size_t apart = APART;  // of components
    const bool lost = bent.shape[0];
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
    const auto modulus = [&](auto& f, int to) -> V {
        return FIELDS ? number_at(f.data + base, to) : V(f.data[0]);
    };
    const auto own_bulk = [&](int to) -> V { return FIELDS ? modulus(bulk, to) : V(1); };
    const auto both = [&](int to) -> V { return modulus(mu, 0) + modulus(mu, to); };
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
    const V mine = own_bulk(0) * number_at(t, 0);
    BONDS
        const V far = own_bulk(to) * number_at(t, to);
        const V shear = DIM * (DIM + 2) * v[DIM] * both(to) * along(f, x);
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
        const V spread = own_bulk(to) * number_at(t, to) - own_bulk(-to) * number_at(t, -to);
        const double shear = DIM * (DIM + 2) * v[DIM] * k;
        const V density = (DIM * WHOLE * k) * spread + SHEAR * bent;
""",
}
BENT = {
    False: "((component(f, to, a) + component(f, -to, a)) - 2 * x[a])",
    True: "(both(to) * (component(f, to, a) - x[a]) + both(-to) * (component(f, -to, a) - x[a]))",
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
    const V mine = own_bulk(0) * number_at(t, 0), pulled = number_at(of_place(tau), 0);
    const V pull = DIM * WHOLE * own_bulk(0) * pulled;
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
        const V far = own_bulk(to) * number_at(t, to);
        const V bar = push * (DIM * WHOLE * (mine + far) + (shear * both(to)) * ahead)
            + pull * ahead;
        total += shear * ahead * along(g, y);
        double* sums = by_own.data + size_t(BLOCK) * by_own.shape[1] + PLACES * e;
        for (int n = 0; n < count; ++n)
            sums[n] += ((const double*)&bar)[n];
    }
    for (int n = 0; n < count; ++n) {
        by_mu.data[base + n] += ((const double*)&total)[n];
        by_bulk.data[base + n] += t[n] * ((const double*)&pulled)[n];
    }
"""


@cache
def struct(dimension):
    """What a sweep reads: bonds, stiffnesses, moduli."""
    vec, wide = (wp.types.vector(d, wp.float64) for d in (dimension, dimension + 1))

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


@wp.struct
class Balls:
    """Bonds row[q] to row[q + 1] of each ball, the lengths they have, their W, 0 of broken bonds,
    and W r² of all."""

    row: ints
    length: wp.array(dtype=wp.int64)
    weight: numbers
    square: numbers


@wp.kernel(enable_backward=False)
def stiffnesses(first: wp.int32, of: Balls, K: numbers, own: numbers, m: numbers):
    """W K/m of the bonds of each ball, m = Σ W r² K its weighted volume (5), 1 for 0."""
    q = first + wp.tid()
    total = wp.float64(0.0)
    for e in range(of.row[q], of.row[q + 1]):
        k = K[of.length[e]]
        own[e] = of.weight[e] * k
        total += of.square[e] * k
    m[q] = wp.where(total == wp.float64(0.0), wp.float64(1.0), total)
    for e in range(of.row[q], of.row[q + 1]):
        own[e] = own[e] / m[q]


@wp.kernel(enable_backward=False)
def by_influence(first: wp.int32, of: Balls, own: numbers, m: numbers, by: numbers):
    """Derivatives to K of each bond in the place of those to W K/m."""
    q = first + wp.tid()
    pulled = wp.float64(0.0)
    for e in range(of.row[q], of.row[q + 1]):
        pulled += by[e] * own[e]
    for e in range(of.row[q], of.row[q + 1]):
        by[e] = (of.weight[e] * by[e] - pulled * of.square[e]) / m[q]


@wp.struct
class Sums:
    """Derivatives of g · L u to own, by block, bond and lane, to μ and to λ − μ by place; g and τ,
    its dilatation by the transpose, lie as u and θ do."""

    planes: table
    theta: table
    seeds: table
    tau: table
    by_own: table
    by_mu: numbers
    by_bulk: numbers


@cache
def sweeps(dimension, *, lattice, fields):
    """The kernels, for lattices or lists of bonds, with moduli as numbers or as fields."""
    Law, lanes = struct(dimension), LANES if lattice else 1
    vector = "__attribute__((ext_vector_type(LANES), aligned(sizeof(double))))"
    words = {
        "DENSITY": DENSITY[lattice], "BENT": BENT[fields],
        "SHEAR": "shear" if fields else "(shear * both(to))",
        "PAIRS": PAIRS, "BONDS": BONDS, "VECTOR": vector if lattice else "",
        "COUNT": "piece.c[2]" if lattice else "1", "FAMILY": "0" if lattice else "base",
        "APART": "theta.shape[1]" if lattice else "1", "NODE": "1" if lattice else "DIM",
        "WHOLE": "double(1)" if fields else "bulk.data[0]", "FIELDS": str(int(fields)),
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

    @native(unpacked(Sums, "sums") + either(OWN + SLOPES))
    def add(block: wp.int32, s: wp.int32, piece: wp.vec3i, of: Law, sums: Sums): ...

    @wp.kernel(enable_backward=False, module="unique")
    def slopes(first: wp.int32, ends: ints, given: pieces, of: Law, sums: Sums):
        block = first + wp.tid()
        for s in range(sums.planes.shape[0]):
            for t in range(ends[block], ends[block + 1]):
                add(block, s, given[t], of, sums)

    return SimpleNamespace(lanes=lanes, swept=swept, slopes=slopes)


def _swept(Law, body):
    """Fields by number into planes; of these dilatations by place, of both forces by number."""

    @body
    def share(
        turns: ints,
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
        turns: ints,
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
