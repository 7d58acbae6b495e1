"""Walls of the channel by MSPH as the paper prints them (Appendix A), and by images."""

from itertools import product
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

PERIOD, FORCE = 0.6, 12.0
SMOOTHING, REACH = 1.5, 3.0
"""Length of the Gaussian in spacings, and its cut in lengths, as printed."""
ACROSS, SHIFTS = (15, 30, 60), (0.0, 0.2)
"""Particles from wall to wall, and how far each is shifted, in spacings."""


def msph(x: np.ndarray, at: np.ndarray, h: float) -> np.ndarray:
    """The value and ∂xx + ∂yy at places from values at particles, (A11)–(A18): [2, P, N].

    Moments of the second Taylor expansion with W, ∇W and ∇∇W; equal volumes drop out.
    """
    matrix = np.zeros((2, len(at), len(x)))
    turned = np.column_stack([x[:, 0] % PERIOD, x[:, 1] + 2])  # a period has no room below zero
    places = np.column_stack([at[:, 0] % PERIOD, at[:, 1] + 2])
    near = cKDTree(turned, boxsize=(PERIOD, 8)).query_ball_point(places, REACH * h)
    for row, some in enumerate(near):
        a, b = (x[some] - at[row]).T
        a = a - PERIOD * np.rint(a / PERIOD)
        a, b = a / h, b / h
        W = np.exp(-(a**2) - b**2)
        tests = W * np.stack([1 + 0 * a, a, b, 2 * a**2 - 1, 2 * a * b, 2 * b**2 - 1])
        taylor = np.stack([1 + 0 * a, a, b, a**2 / 2, a * b, b**2 / 2])
        found = np.linalg.solve(tests @ taylor.T, tests)
        matrix[:, row, some] = found[0], (found[3] + found[5]) / h**2
    return matrix


def particles(across: int, shift: float) -> tuple[np.ndarray, np.ndarray]:
    """Fluid particles, and the wall's on the lattice, as far as the Gaussian reaches."""
    b = 1 / across
    along = (np.arange(round(PERIOD * across)) + 0.5) * b
    moves = np.random.default_rng(0).uniform(-shift * b, shift * b, (len(along) * across, 2))
    fluid = np.array(list(product(along, (np.arange(across) + 0.5) * b))) + moves
    depth = (np.arange(int(np.ceil(REACH * SMOOTHING))) + 0.5) * b
    return fluid, np.array(list(product(along, np.concatenate([-depth, 1 + depth]))))


def mirrored(x: np.ndarray) -> np.ndarray:
    """About the nearer wall."""
    y = x[:, 1]
    return np.column_stack([x[:, 0], np.where(y < 0.5, -y, 2 - y)])


def poiseuille(across: int, shift: float, walls: str) -> float:
    """Relative error of the steady velocity, −∇²u = F with no slip, in ℓ2."""
    h = SMOOTHING / across
    fluid, wall = particles(across, shift)
    if walls == "images":
        edge = np.abs(fluid[:, 1] - 0.5) > 0.5 - REACH * h
        behind, of_fluid = mirrored(fluid[edge]), -np.eye(len(fluid))[edge]
    else:
        behind, of_fluid = wall, -msph(fluid, mirrored(wall), h)[0]
    second = msph(np.concatenate([fluid, behind]), fluid, h)[1]
    inside = second[:, : len(fluid)] + second[:, len(fluid) :] @ of_fluid
    u = np.linalg.solve(inside, np.full(len(fluid), -FORCE))
    y = fluid[:, 1]
    exact = FORCE / 2 * y * (1 - y)
    return float(np.linalg.norm(u - exact) / np.linalg.norm(exact))


def study() -> list[dict[str, Any]]:
    """Errors by walls, shift and spacing."""
    return [
        {"walls": walls, "shift": shift, "errors": [poiseuille(n, shift, walls) for n in ACROSS]}
        for walls, shift in product(("MSPH, as printed", "images"), SHIFTS)
    ]


def row_of(found: dict[str, Any]) -> list[str]:
    """A row of the table, with the order of the errors."""
    order = -np.polyfit(np.log(ACROSS), np.log(found["errors"]), 1)[0]
    errors = (f"{100 * error:.2f}" for error in found["errors"])
    return [found["walls"], f"{found['shift']:g}", *errors, f"{order:.1f}"]
