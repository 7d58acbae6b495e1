"""The residual of a nine-point stencil on masked nodes."""

import warp as wp


@wp.kernel
def residual(
    first: int,
    stencil: wp.array4d(dtype=wp.float32),
    mask: wp.array2d(dtype=wp.bool),
    r: wp.array3d(dtype=wp.float32),
    u: wp.array3d(dtype=wp.float32),
    out: wp.array3d(dtype=wp.float32),
):
    """r − A u at one node, zero outside the mask; fields have shape [2, n₁, n₂]."""
    node = first + wp.tid()
    m = mask.shape[1]
    i = node // m
    j = node % m
    if not mask[i, j]:
        out[0, i, j] = wp.float32(0.0)
        out[1, i, j] = wp.float32(0.0)
        return
    first_part = r[0, i, j]
    second_part = r[1, i, j]
    for a in range(3):
        p = i + a - 1
        if p >= 0 and p < mask.shape[0]:
            for b in range(3):
                q = j + b - 1
                if q >= 0 and q < m:
                    x = u[0, p, q]
                    y = u[1, p, q]
                    first_part -= stencil[0, 0, a, b] * x + stencil[0, 1, a, b] * y
                    second_part -= stencil[1, 0, a, b] * x + stencil[1, 1, a, b] * y
    out[0, i, j] = first_part
    out[1, i, j] = second_part
