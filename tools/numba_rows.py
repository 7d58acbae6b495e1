"""The force on a periodic square lattice in Numba, row by row, for its compiler to make vectors."""

from collections.abc import Callable
from typing import Any

import numpy as np

from tools import numba_rival
from tools.rivals import Tables


def numba_rows(t: Tables, dtype: Any) -> Callable[[], np.ndarray]:
    """Forward on side × side nodes numbered row by row, K of the classes computed every time.

    Its best form: products and sums contracted, images of rows in a loop of their own, K on one
    thread.
    """
    import numba

    side = round(np.sqrt(len(t.u)))
    family = t.row[1] - t.row[0]
    xi = np.ascontiguousarray(t.xi[:family])
    steps = np.rint(xi / np.abs(xi[xi != 0]).min()).astype(np.int64)
    reach = int(np.abs(steps).max())
    influence = numba_rival.influence_loop(t, dtype)
    bond_class, r = t.bond_class[:family], t.r.astype(dtype)
    ring, width = 2 * reach, side + 4 * reach
    bonds = np.column_stack([xi, 1 / (xi**2).sum(axis=1)]).astype(dtype)
    planes = np.zeros((3, width, width), dtype)
    out = np.empty((side, side, 2), dtype)
    u = t.u.reshape(side, side, 2).astype(dtype)
    lam, mu = dtype(t.lam), dtype(t.mu)
    jit = numba.njit(parallel=True, fastmath=True, error_model="numpy")
    made = (of(numba.prange) for of in (_laid_out, _dilatation, _force))
    laid_out, dilatation, force = map(jit, made)

    def forward() -> np.ndarray:
        kw = influence()
        k = kw[bond_class]
        m = (k * r[bond_class] ** 2).sum()
        laid_out(u, planes, ring)
        dilatation(steps, bonds, 2 / m * k, planes, reach)
        force(steps, bonds, -2 * (lam - mu) / m * k, -16 * mu / m * k, planes, ring, out)
        return out.reshape(-1, 2)

    return forward


def _laid_out(prange: Any) -> Callable[..., None]:
    def laid_out(u, planes, ring):
        side, rows = len(u), planes.shape[1]
        for i in prange(rows):
            own = u[(i - ring) % side]
            for c in range(side):
                planes[0, i, ring + c] = own[c, 0]
                planes[1, i, ring + c] = own[c, 1]
            for a in range(2):
                planes[a, i, :ring] = planes[a, i, side : side + ring]
                planes[a, i, ring + side :] = planes[a, i, ring : 2 * ring]

    return laid_out


def _dilatation(prange: Any) -> Callable[..., None]:
    def dilatation(steps, bonds, factor, planes, margin):
        rows = planes.shape[1] - 2 * margin
        for n in prange(rows):
            i = n + margin
            total = np.zeros(rows, planes.dtype)
            x, y = (planes[0, i, margin : margin + rows], planes[1, i, margin : margin + rows])
            for p in range(len(steps)):
                j, shift = i + steps[p, 0], margin + steps[p, 1]
                vx, vy = planes[0, j, shift : shift + rows], planes[1, j, shift : shift + rows]
                a, b, k = bonds[p, 0], bonds[p, 1], factor[p]
                for c in range(rows):
                    total[c] += k * (a * (vx[c] - x[c]) + b * (vy[c] - y[c]))
            planes[2, i, margin : margin + rows] = total

    return dilatation


def _force(prange: Any) -> Callable[..., None]:
    def force(steps, bonds, bulk, shear, planes, margin, out):
        side = len(out)
        for n in prange(side):
            i = n + margin
            fx, fy = np.zeros(side, planes.dtype), np.zeros(side, planes.dtype)
            x, y = planes[0, i, margin : margin + side], planes[1, i, margin : margin + side]
            theta = planes[2, i, margin : margin + side]
            for p in range(len(steps)):
                j, shift = i + steps[p, 0], margin + steps[p, 1]
                vx, vy = planes[0, j, shift : shift + side], planes[1, j, shift : shift + side]
                far = planes[2, j, shift : shift + side]
                a, b = bonds[p, 0], bonds[p, 1]
                push, pull = bulk[p], shear[p] * bonds[p, 2]
                for c in range(side):
                    stretch = a * (vx[c] - x[c]) + b * (vy[c] - y[c])
                    density = push * (theta[c] + far[c]) + pull * stretch
                    fx[c] += density * a
                    fy[c] += density * b
            out[n, :, 0] = fx
            out[n, :, 1] = fy

    return force
