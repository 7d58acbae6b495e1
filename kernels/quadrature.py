"""Quadrature weights of the families of scattered points, a family a thread (theory, 7–8, V4).

W = Qᵀ (Q Qᵀ)⁻¹ c by Cholesky, solved a second time for what the first left, with the rows of Q
computed anew at each pass over the bonds: they need no memory.
"""

from functools import cache

import warp as wp

BODY = """
    const int count = exact.shape[0];  // unknown to the compiler, which would unroll
    const int begin = row.data[i], end = row.data[i + 1];
    static const int power[COUNT][DIM] = POWERS;
    double G[COUNT][COUNT] = {}, q[COUNT], left[COUNT], pull[COUNT];
    auto features = [&](int e) {
        double p[DIM][DEGREE + 1], square = 0.0;
        for (int d = 0; d < DIM; ++d) {
            double a = x.data[neighbour.data[e]].c[d] - x.data[i].c[d];
            if (box.c[0] > 0.0)
                a -= rint(a / box.c[d]) * box.c[d];
            a /= horizon;
            p[d][1] = a;
            square += a * a;
        }
        const double r = sqrt(square);
        for (int d = 0; d < DIM; ++d) {
            const double a = p[d][1];
            p[d][0] = d == 0 ? 1.0 / (r * r * r) : 1.0;
            for (int n = 1; n <= DEGREE; ++n)
                p[d][n] = p[d][n - 1] * a;
        }
        for (int k = 0; k < COUNT; ++k) {
            q[k] = p[0][power[k][0]];
            for (int d = 1; d < DIM; ++d)
                q[k] *= p[d][power[k][d]];
        }
    };
    double volume = horizon, largest = 0.0;
    for (int d = 1; d < DIM; ++d)
        volume *= horizon;
    for (int k = 0; k < count; ++k) {
        left[k] = exact.data[k];
        largest = wp::max(largest, fabs(left[k]));
    }
    for (int e = begin; e < end; ++e) {
        weight.data[e] = 0.0;
        features(e);
        for (int m = 0; m < count; ++m)
            for (int n = 0; n < count; ++n)
                G[m][n] += q[m] * q[n];
    }
    double low = 1e300, high = 0.0;
    for (int m = 0; m < count; ++m)
        for (int n = 0; n <= m; ++n) {
            double sum = G[m][n];
            for (int k = 0; k < n; ++k)
                sum -= G[m][k] * G[n][k];
            if (n < m)
                G[m][n] = sum / G[n][n];
            else if (!(sum > 0.0))
                return -1.0;
            else {
                G[m][m] = sqrt(sum);
                low = wp::min(low, G[m][m]);
                high = wp::max(high, G[m][m]);
            }
        }
    if (!(low > independent * high))
        return -1.0;
    for (int pass = 0; pass < 2; ++pass) {
        for (int m = 0; m < count; ++m) {
            pull[m] = left[m];
            for (int k = 0; k < m; ++k)
                pull[m] -= G[m][k] * pull[k];
            pull[m] /= G[m][m];
        }
        for (int m = count - 1; m >= 0; --m) {
            for (int k = m + 1; k < count; ++k)
                pull[m] -= G[k][m] * pull[k];
            pull[m] /= G[m][m];
        }
        for (int m = 0; m < count; ++m)
            left[m] = exact.data[m];
        for (int e = begin; e < end; ++e) {
            features(e);
            double w = weight.data[e] / volume;
            for (int m = 0; m < count; ++m)
                w += q[m] * pull[m];
            for (int m = 0; m < count; ++m)
                left[m] -= w * q[m];
            for (int d = 0; d < DIM; ++d)
                w *= horizon;
            weight.data[e] = w;
        }
    }
    double worst = 0.0;
    for (int m = 0; m < count; ++m)
        worst = wp::max(worst, fabs(left[m]));
    return worst / largest;
"""


@cache
def family_weights(powers: tuple[tuple[int, ...], ...]):
    """The kernel for monomials of these powers: weights of some nodes' bonds, and their residuals.

    The residual is −1 where the conditions depend on each other and another method must be taken:
    where a pivot of the Gram matrix, by its root, is below `independent` of the largest.
    """
    vec = wp.types.vector(len(powers[0]), wp.float64)
    table = ", ".join("{" + ", ".join(map(str, p)) + "}" for p in powers)
    body = BODY.replace("COUNT", str(len(powers))).replace("DEGREE", str(max(map(sum, powers))))
    body = body.replace("DIM", str(len(powers[0]))).replace("POWERS", "{" + table + "}")

    @wp.func_native(body)
    def of_family(
        i: wp.int32,
        x: wp.array(dtype=vec),
        row: wp.array(dtype=wp.int32),
        neighbour: wp.array(dtype=wp.int32),
        box: vec,
        horizon: wp.float64,
        independent: wp.float64,
        exact: wp.array(dtype=wp.float64),
        weight: wp.array(dtype=wp.float64),
    ) -> wp.float64: ...

    @wp.kernel(enable_backward=False, module="unique")
    def weights(
        first: wp.int32,
        nodes: wp.array(dtype=wp.int32),
        x: wp.array(dtype=vec),
        row: wp.array(dtype=wp.int32),
        neighbour: wp.array(dtype=wp.int32),
        box: vec,
        horizon: wp.float64,
        independent: wp.float64,
        exact: wp.array(dtype=wp.float64),
        weight: wp.array(dtype=wp.float64),
        residual: wp.array(dtype=wp.float64),
    ):
        """Weights of the bonds of one node, and the residual of its conditions."""
        t = first + wp.tid()
        residual[t] = of_family(
            nodes[t], x, row, neighbour, box, horizon, independent, exact, weight
        )

    return weights
