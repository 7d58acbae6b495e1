"""The linear peridynamic solid by NumPy, one bond at a time, from the equations of docs/theory."""

from itertools import product
from math import comb, gamma

import numpy as np
from numpy.linalg import norm, pinv

from warp_peri.points.points import grid_places


def influence(r, horizon, alpha, D):
    """K(r), (4)."""
    M, t = len(D) - 1, min(r / horizon, 1.0)
    return r**-alpha * sum(D[k] * comb(M, k) * t**k * (1 - t) ** (M - k) for k in range(M + 1))


def moment(powers):
    """∫ of a monomial over r³ over the unit ball, by Γ functions (Folland)."""
    if any(n % 2 for n in powers):
        return 0.0
    halves = [(n + 1) / 2 for n in powers]
    return 2 * np.prod([*map(gamma, halves)]) / gamma(sum(halves)) / (sum(powers) + len(powers) - 3)


def reproducing(e):
    """Monomials over r³ of bonds of the unit ball, to degree 5 (8), and their integrals over it."""
    d = e.shape[1]
    powers = [p for p in product(range(6), repeat=d) if 4 - d <= sum(p) <= 5]
    rows = [(e**p).prod(1) for p in powers] / norm(e, axis=1) ** 3
    return rows, np.array([moment(p) for p in powers])


def quadrature(xi, horizon):
    """Weights of smallest norm among those exact on the reproducing space, (7)."""
    rows, exact = reproducing(xi / horizon)
    return pinv(rows, rcond=1e-10) @ exact * horizon ** xi.shape[1]


def family(x, i, horizon, box):
    """Neighbours of node i and the bonds to them, through the nearest periodic image."""
    bonds = x - x[i]
    if box is not None:
        bonds = bonds - np.round(bonds / box) * box
    r = np.hypot(*bonds.T)
    near = np.flatnonzero((r > 0) & (r <= horizon * (1 + 1e-6)))
    return near, bonds[near]


def weights(x, i, model, box=None):
    """Neighbours and bonds of node i, and K W / m."""
    near, bonds = family(x, i, model.horizon, box)
    W = quadrature(bonds, model.horizon)
    K = [influence(np.hypot(*xi), model.horizon, model.alpha, model.D) for xi in bonds]
    m = sum(k * (xi @ xi) * w for k, xi, w in zip(K, bonds, W))  # (5)
    return near, bonds, [k * w / m for k, w in zip(K, W)]


def dilatation(x, i, model, u, box=None):
    """θ of node i, (6)."""
    return 2 * sum(w_j * (xi @ (u[j] - u[i])) for j, xi, w_j in zip(*weights(x, i, model, box)))


def operator(x, interior, model, u, box=None):
    """L u on the interior nodes, (9)."""
    theta = {}
    out = []
    for i in np.flatnonzero(interior):
        near, bonds, w = weights(x, i, model, box)
        for j in (i, *near):
            if j not in theta:
                theta[j] = dilatation(x, j, model, u, box)
        force = np.zeros(2)
        for j, xi, w_j in zip(near, bonds, w):
            force -= 2 * (model.lam - model.mu) * w_j * xi * (theta[i] + theta[j])
            force -= 16 * model.mu * w_j * xi * (xi @ (u[j] - u[i])) / (xi @ xi)
        out.append(force)
    return np.array(out)


def smoothing(atoms, nodes, radius, shape, box=None, spacing=None):
    """ω, (1), by sums over nodes and images; over all of a lattice where its spacing is known."""

    def tau(x, X):
        r = np.hypot(*(x - X).T)
        return np.maximum(0.0, radius - r if shape == "cone" else radius**2 - r**2)

    images = np.zeros((1, 2)) if box is None else (grid_places((9, 9)) - 4) * box
    omega = np.zeros((len(nodes), len(atoms)))
    for number, atom in enumerate(atoms):
        for X in atom + images:
            if not (reached := tau(nodes, X)).any():
                continue
            if spacing is None:
                total = sum(tau(nodes, atom + image).sum() for image in images)
            else:
                reach = int(radius / spacing) + 2
                steps = grid_places(2 * [2 * reach + 1]) - reach
                near = nodes[0] + spacing * np.round((X - nodes[0]) / spacing)
                total = tau(near + spacing * steps, X).sum()
            omega[:, number] += reached / total
    return omega
