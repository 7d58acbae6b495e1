"""K u of multilinear elements whose moduli vary, a plane of them at a time (theory, Dr22, Dr27).

For the processor only: the loops over lanes are C++, which Warp's compiler turns into vectors.
"""

from functools import cache
from types import SimpleNamespace

import warp as wp

from warp_peri.kernels.micromodulus.rows import BYTES

PLANE = """
    const size_t start = size_t(x) * plane;
    const REAL* u = planes.data + size_t(s) * planes.shape[1] + start;
    REAL* out = force.data + size_t(s) * force.shape[1] + start;
    const int offset[CORNERS] = {OFFSETS};
    for (int base = 0; base < count; base += LANES) {
        REAL m[ENTRIES][LANES], r[FORCES][LANES];
        for (int k = 0; k < ENTRIES; ++k) {
            for (int l = 0; l < LANES; ++l)
                m[k][l] = REAL(0);
            for (int p = 0; p < factors.shape[0]; ++p) {
                const REAL c = table.data[size_t(p) * ENTRIES + k];
                if (c == REAL(0))
                    continue;
                const REAL* f = factors.data + size_t(p) * factors.shape[1] + start + base;
                for (int l = 0; l < LANES; ++l)
                    m[k][l] += c * f[l];
            }
        }
        for (int l = 0; l < LANES; ++l) {
            const REAL* v = u + base + l;
            BODY
        }
        const int some = count - base < LANES ? count - base : LANES;
        for (int n = 0; n < FORCES; ++n) {
            REAL* f = out + base + offset[n % CORNERS] + size_t(n / CORNERS) * places;
            for (int l = 0; l < some; ++l)
                f[l] += r[n][l];
        }
    }
"""


def _butterflies(lines, name, dimension, forward):
    """Sums and differences along every axis of the corners' values; or back, of those."""
    for axis in range(dimension):
        for low in (c for c in range(2**dimension) if not c >> axis & 1):
            high = low | 1 << axis
            one, other = (f"{name}{axis}_{c}" for c in (low, high))
            new, next_ = (f"{name}{axis + 1}_{c}" for c in (low, high))
            signs = ("+", "-") if forward else ("-", "+")
            first, second = (other, one) if forward else (one, other)
            lines.append(f"const REAL {new} = {first} {signs[0]} {second};")
            lines.append(f"const REAL {next_} = {first} {signs[1]} {second};")


@cache
def element_planes(scalar, dimension, pairs, entries):
    """K u of multilinear squares or cubes, h = 1, a plane of elements for each thread (Dr27).

    Components are as many as `pairs` name, (i, j) for each row of a modulus: of gradient j of
    component i and, where i ≠ j, of i of j. `entries` are the (row, column), row ≤ column, of a
    modulus that are not zero. Displacement is taken on a box one wider than the elements, and
    forces are added there: planes beside one another must not be swept at once.
    """
    lanes, d = BYTES // wp.types.type_size_in_bytes(scalar), dimension
    corners, parts = 2**d, 1 + max(i for i, _ in pairs)
    strides = ("plane", "row", "1")[:: 1 if d == 3 else 2]
    offsets = [" + ".join(["0", *(strides[a] for a in range(d) if c >> a & 1)])
               for c in range(corners)]  # fmt: skip
    place, lines = {pair: k for k, pair in enumerate(entries)}, []
    for i in range(parts):
        for c in range(corners):
            lines.append(f"const REAL h{i}x0_{c} = v[{i} * places + offset[{c}]];")
        _butterflies(lines, f"h{i}x", d, True)
    pulls = {}  # of the modes of every component
    for m in range(corners - 1):
        felt = {}  # rows of the strain's part along this monomial, and what they are made of
        for row, (i, j) in enumerate(pairs):
            terms = {(i, m | 1 << j)} if not m >> j & 1 else set()
            if i != j and parts > 1 and not m >> i & 1:
                terms.add((j, m | 1 << i))
            if terms:
                felt[row] = sorted(terms)
        for row, terms in felt.items():
            made = " + ".join(f"h{i}x{d}_{c}" for i, c in terms)
            lines.append(f"const REAL e{m}_{row} = {made};")
        weight = f"REAL({0.25 ** (d - 1) / 3.0 ** m.bit_count()!r})"
        for row, terms in felt.items():
            products = [
                f"m[{place[min(row, other), max(row, other)]}][l] * e{m}_{other}"
                for other in felt
                if (min(row, other), max(row, other)) in place
            ]
            lines.append(f"const REAL t{m}_{row} = {weight} * ({' + '.join(products)});")
            for term in terms:
                pulls.setdefault(term, []).append(f"t{m}_{row}")
    for i in range(parts):
        for c in range(corners):
            lines.append(f"const REAL b{i}x0_{c} = {' + '.join(pulls.get((i, c), ['REAL(0)']))};")
        _butterflies(lines, f"b{i}x", d, False)
        lines.extend(f"r[{i * corners + c}][l] = b{i}x{d}_{c};" for c in range(corners))
    text = PLANE.replace("BODY", "\n            ".join(lines)).replace(
        "OFFSETS", ", ".join(offsets)
    )
    for word, value in (("ENTRIES", len(entries)), ("FORCES", parts * corners),
                        ("CORNERS", corners), ("LANES", lanes)):  # fmt: skip
        text = text.replace(word, str(value))

    @wp.func_native(text.replace("REAL", f"wp::{scalar.__name__}"))
    def one_plane(
        s: wp.int32,
        x: wp.int32,
        plane: wp.int32,
        row: wp.int32,
        places: wp.int32,
        count: wp.int32,
        table: wp.array2d(dtype=scalar),
        factors: wp.array2d(dtype=scalar),
        planes: wp.array2d(dtype=scalar),
        force: wp.array2d(dtype=scalar),
    ): ...

    @wp.kernel(enable_backward=False, module="unique")
    def swept(
        first: wp.int32,
        begin: wp.int32,
        plane: wp.int32,
        row: wp.int32,
        places: wp.int32,
        count: wp.int32,
        table: wp.array2d(dtype=scalar),
        factors: wp.array2d(dtype=scalar),
        planes: wp.array2d(dtype=scalar),
        force: wp.array2d(dtype=scalar),
    ):
        s, t = wp.tid()
        x = begin + 2 * (first + t)
        one_plane(s, x, plane, row, places, count, table, factors, planes, force)

    return SimpleNamespace(swept=swept, lanes=lanes)
