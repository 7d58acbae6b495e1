"""The linear peridynamic solid by NumPy, one bond at a time, from the equations of docs/theory."""

from math import comb

import numpy as np


def influence(r, horizon, alpha, D):
    """K(r), (4)."""
    M, t = len(D) - 1, min(r / horizon, 1.0)
    return r**-alpha * sum(D[k] * comb(M, k) * t**k * (1 - t) ** (M - k) for k in range(M + 1))


MONOMIALS = [(p - b, b) for p in range(2, 6) for b in range(p + 1)]
"""Exponents (a, b) of the reproducing space of degree 5, (8)."""


def ball_integral(a, b, horizon):
    """∫ ξ₁ᵃ ξ₂ᵇ / r³ over the ball: the angle by the trapezoid rule, exact for so few waves."""
    angle = 2 * np.pi * np.arange(32) / 32
    around = 2 * np.pi * np.mean(np.cos(angle) ** a * np.sin(angle) ** b)
    return around * horizon ** (a + b - 1) / (a + b - 1)


def quadrature(xi, horizon):
    """Weights of smallest norm among those exact on the reproducing space, (7)."""
    r = np.hypot(*xi.T)
    rows = np.array([xi[:, 0] ** a * xi[:, 1] ** b / r**3 for a, b in MONOMIALS])
    exact = np.array([ball_integral(a, b, horizon) for a, b in MONOMIALS])
    size = np.abs(rows).max(axis=1)
    return np.linalg.pinv(rows / size[:, None], rcond=1e-10) @ (exact / size)


def family(x, i, horizon, box=None):
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
    pairs = zip(*weights(x, i, model, box))
    return 2 * sum(w_j * (xi @ (u[j] - u[i])) for j, xi, w_j in pairs)


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

    images = np.zeros((1, 2)) if box is None else (np.argwhere(np.ones((9, 9))) - 4) * box
    omega = np.zeros((len(nodes), len(atoms)))
    for number, atom in enumerate(atoms):
        for X in atom + images:
            if not (reached := tau(nodes, X)).any():
                continue
            if spacing is None:
                total = sum(tau(nodes, atom + image).sum() for image in images)
            else:
                reach = int(radius / spacing) + 2
                steps = np.argwhere(np.ones(2 * [2 * reach + 1])) - reach
                near = nodes[0] + spacing * np.round((X - nodes[0]) / spacing)
                total = tau(near + spacing * steps, X).sum()
            omega[:, number] += reached / total
    return omega
