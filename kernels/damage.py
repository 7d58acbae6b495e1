"""Solids whose bonds break: forces and energies over unbroken bonds of a lattice body, by rows, the
breaking of bonds, and the two halves of a step with the work done in them.

The table of the ball holds per bond ξ, a = d w, k = 2 d (d + 2) μ w / r² and the e at which it
breaks; with e = ξ·(u_j − u_i) (theory, C1–C4)

    θ_i = Σ a e,   f_i = Σ [(λ−μ) a (θ_i + θ_j) + k e] ξ,   w_i = (λ−μ) θ_i²/2 + Σ k e²/4.

Nodes lie at places of a rectangle of P; component a of u at place q is planes[a P + q], and bond b
leads from q to q + offset[b]. A piece is (first place, row) of LANES places that go through a bond
together, in vector registers; number[q] is 1 + the node at a place, 0 where there is none. Bit l of
bits[row B + b] says that the body has bond b at lane l, unbroken: one 16-bit word instead of
sixteen numbers of neighbours. A bond that is gone adds zero, so that the sums of a node are the
same additions in the same order whatever lies beside it, on any number of threads or ranks.
For the processor only: vectors are those of Warp's compiler.
"""

from functools import cache
from types import SimpleNamespace

import warp as wp

from warp_peri.kernels.bonds import shared, unpacked

LANES = 16
"""Places of a piece, and bits of a word."""

S = wp.float64
TYPES = """
    typedef double V __attribute__((ext_vector_type(16)));
    typedef double At __attribute__((ext_vector_type(16), aligned(8)));  // at any place
    typedef bool Bits __attribute__((ext_vector_type(16)));
    const int bonds = offset.shape[0];
    const size_t places = planes.shape[0] / DIM;
"""
PIECE = """
    const int base = piece.c[0];
    const double* field = planes.data + base;
    wp::uint16* left = bits.data + size_t(piece.c[1]) * bonds;
    V own[DIM];
    for (int a = 0; a < DIM; ++a)
        own[a] = *(const At*)(field + a * places);
"""
STRETCHED = """
        const wp::uint16 word = left[b];
        if (word == 0)
            continue;
        const Bits there = __builtin_bit_cast(Bits, word);
        const double* bond = table.data[b].c;
        const int step = offset.data[b];
        V e = bond[0] * (*(const At*)(field + step) - own[0]);
        for (int a = 1; a < DIM; ++a)
            e += bond[a] * (*(const At*)(field + a * places + step) - own[a]);
        e = there ? e : V(0.0);
"""
LAID_OUT = """
    for (int l = 0; l < 16; ++l) {
        const int i = number.data[piece.c[0] + l] - 1;
        for (int a = 0; a < DIM; ++a)
            if (i >= 0)
                planes.data[a * places + piece.c[0] + l] = u.data[i].c[a];
    }
"""
DILATATION = (
    PIECE
    + """
    V total = 0.0;
    for (int b = 0; b < bonds; ++b) {"""
    + STRETCHED
    + """
        total += bond[DIM] * e;
    }
    *(At*)(theta.data + base) = total;
"""
)
FORCE = (
    PIECE
    + """
    V f[DIM] = {}, w = 0.0, dilated = 0.0;
    if (excess != 0.0)
        dilated = *(const At*)(theta.data + base);
    wp::uint16 losing = 0;
    for (int b = 0; b < bonds; ++b) {"""
    + STRETCHED
    + """
        V pull = bond[DIM + 1] * e;
        w += pull * e;
        if (excess != 0.0) {
            pull += excess * bond[DIM] * (dilated + *(const At*)(theta.data + base + step));
            pull = there ? pull : V(0.0);
        }
        for (int a = 0; a < DIM; ++a)
            f[a] += pull * bond[a];
        if (!breaking)
            continue;
        const Bits over = __builtin_convertvector(e > V(bond[DIM + 2]), Bits) & there;
        const wp::uint16 beyond = __builtin_bit_cast(wp::uint16, over);
        for (int l = 0; beyond >> l; ++l)
            if (beyond >> l & 1 && !no_fail.data[base + l] && !no_fail.data[base + step + l]) {
                left[b] &= ~(1 << l);
                losing |= 1 << l;
            }
    }
    w = 0.25 * w + 0.5 * excess * dilated * dilated;
    lost.data[piece.c[1]] = losing;
    double out[DIM + 1][16];
    *(At*)out[DIM] = w;
    for (int a = 0; a < DIM; ++a)
        *(At*)out[a] = f[a];
    for (int l = 0; l < 16; ++l) {
        const int i = number.data[base + l] - 1;
        if (i < 0)
            continue;
        for (int a = 0; a < DIM; ++a)
            force.data[i].c[a] = out[a][l];
        energy.data[i] = out[DIM][l];
    }
"""
)


@cache
def sweep(dimension: int):
    """The kernel in one dimension: u by node into its planes, θ by place, then f and w by node.

    Of all bonds, those that break now included; excess is λ − μ. Bonds beyond their limit lose
    their bit; lost has a bit for each lane that loses one.
    """
    vec, bond_type = wp.types.vector(dimension, S), wp.types.vector(dimension + 3, S)

    @wp.struct
    class Cut:
        laid: wp.array(dtype=wp.vec2i)
        dilating: wp.array(dtype=wp.vec2i)
        pulling: wp.array(dtype=wp.vec2i)
        offset: wp.array(dtype=wp.int32)
        table: wp.array(dtype=bond_type)
        number: wp.array(dtype=wp.int32)
        no_fail: wp.array(dtype=wp.uint8)
        excess: S
        breaking: wp.int32
        planes: wp.array(dtype=S)
        theta: wp.array(dtype=S)
        lost: wp.array(dtype=wp.uint16)
        u: wp.array(dtype=vec)
        bits: wp.array(dtype=wp.uint16)
        force: wp.array(dtype=vec)
        energy: wp.array(dtype=S)

    phases = shared(laid=LAID_OUT, dilating=DILATATION, pulling=FORCE)

    @wp.func_native((unpacked(Cut) + TYPES + phases).replace("DIM", str(dimension)))
    def swept(turns: wp.array(dtype=wp.int32), of: Cut): ...

    @wp.kernel(enable_backward=False, module="unique")
    def sweep(turns: wp.array(dtype=wp.int32), of: Cut):
        swept(turns, of)

    return SimpleNamespace(vec=vec, bond=bond_type, Cut=Cut, sweep=sweep)


@cache
def halves(dimension: int):
    """The kernels in one dimension."""
    vec = wp.types.vector(dimension, wp.float64)

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
        free = vec(wp.float64(1.0)) - held[i]
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
        free = vec(wp.float64(1.0)) - held[i]
        w = v[i]
        hands = wp.float64(0.5) * step * wp.dot(wp.cw_mul(held[i], force[i]), w)
        work[i] = work[i] - hands
        kick = step / (wp.float64(2.0) * inertia) * (force[i] + share * load[i])
        v[i] = w + wp.cw_mul(free, kick)

    return SimpleNamespace(kick_and_drift=kick_and_drift, second_kick=second_kick)
