"""Nonlocal diffusion: orders on lattices and scattered points, a jump, a line source, coupling.

Exact solutions are given on the collar.
"""

from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections.abc import Callable
from typing import Any

import numpy as np

import warp_peri as wp
from warp_peri import Points
from warp_peri.diffusion import DiffusionMaterial, ThermoelasticMaterial

REDUCED = ("sigma", "epsilon/sigma^3")  # units of numbers that have none
RATIO, SIDES = 3.0, (8, 16, 32)
"""Horizon over spacing on lattices, 3.5 on scattered points; nodes per unit length."""
LAM, MU, COUPLING, STORAGE = 1.5, 1.0, 0.7, 0.3


def square(cells: int, reach: float, shift: float = 0.0, seed: int = 0) -> Points:
    """The square |x| < 1 and its collar, 1/cells apart, moved at random by shift spacings."""
    h, pad = 1 / cells, int(np.ceil(reach + 2 * shift + 1))
    steps = np.argwhere(np.ones(2 * [2 * (cells + pad)])) - (cells + pad) + 0.5
    inside = (np.abs(steps) < cells).all(axis=1)
    if shift:
        steps = steps + np.random.default_rng(seed).uniform(-shift, shift, steps.shape)
    return Points(h * steps, inside, 0.0 if shift else h, units=REDUCED)


def error(points: Points, ratio: float, cells: int, kappa: Any, exact: np.ndarray, g: Any) -> float:
    """Relative l2 error of a steady solution with the source g [N]."""
    problem = wp.Dirichlet(points, np.broadcast_to(g, exact.shape), exact)
    off = (
        wp.solve(DiffusionMaterial(ratio / cells, 1.0, units=REDUCED), problem, kappa=kappa).u
        - exact
    )
    return float(np.linalg.norm(off) / np.linalg.norm(exact[points.interior]))  # 0 on the collar


def smooth(cells: int, shift: float) -> float:
    """sin(x + 0.2) cos(2 y) with uniform conductivity."""
    ratio = 3.5 if shift else RATIO
    points = square(cells, ratio, shift)
    exact = np.sin(points.x[:, 0] + 0.2) * np.cos(2 * points.x[:, 1])
    return error(points, ratio, cells, 1.0, exact, 5 * exact)


def jump(cells: int, right: float = 10.0, flux: float = 1.0, *, along: bool = True) -> float:
    """Conductivity 1 left of x = 0 and `right` of it, in series along bonds or by harmonic means.

    With a flux of 3 right of the line [κ ∂φ/∂x] = 2 sin(y + 0.3): a line source, half of it on
    either column of nodes beside the line.
    """
    points = square(cells, RATIO)
    x, y = points.x.T

    def kappa(place: np.ndarray) -> np.ndarray:
        return np.where(place[..., 0] < 0, 1.0, right)

    exact = np.sin(y + 0.3) * (
        np.cosh(x) + np.where(x < 0, 1.0, flux) * np.sinh(x) / kappa(points.x)
    )
    source = (1 - flux) * np.sin(y + 0.3) * (np.abs(x) < points.spacing) / (2 * points.spacing)
    return error(points, RATIO, cells, kappa if along else kappa(points.x), exact, source)


def coupled(cells: int) -> tuple[float, float]:
    """Errors of u and φ after two steps of a solution that grows linearly in time."""
    points = square(cells, 2 * RATIO)
    (x, y), h = points.x.T, points.spacing
    u = np.column_stack([np.sin(x) * np.sin(y) + 0.3 * x * x, np.cos(x) * np.cos(y)])
    phi = np.exp(x) * np.cos(y) + 0.2 * x * x
    gradient = np.column_stack([np.exp(x) * np.cos(y) + 0.4 * x, -np.exp(x) * np.sin(y)])
    laplacian = np.column_stack([-2 * u[:, 0] + 0.6 * (1 + x * x), -2 * u[:, 1]])
    rise = np.column_stack([np.full_like(x, 0.6), 0 * x])  # gradient of div u = 0.6 x
    load = -MU * laplacian - (LAM + MU) * rise - COUPLING * gradient
    model = wp.LPSMaterial(LAM, MU, 1.0, np.ones(1), horizon=RATIO * h, units=REDUCED)
    heat = DiffusionMaterial(RATIO * h, 1.0, units=REDUCED)
    solid = ThermoelasticMaterial(model, heat, COUPLING, STORAGE)

    def loads(time: float) -> np.ndarray:
        source = STORAGE * phi - COUPLING * 0.6 * x - 0.4 * time
        return np.column_stack([time * load, source])

    fields = np.column_stack([u, phi])
    problem = wp.Dirichlet(points, loads, 0 * fields)
    run = wp.simulate(solid, problem, step=0.5, steps=2, collar=lambda time: time * fields)
    pairs = (
        (a[points.interior], b[points.interior]) for a, b in ((run.u[:, :2], u), (run.u[:, 2], phi))
    )
    of_u, of_phi = (float(np.linalg.norm(a - b) / np.linalg.norm(b)) for a, b in pairs)
    return of_u, of_phi


if __name__ == "__main__":
    ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter).parse_args()
    cases: dict[str, Callable[[int], Any]] = {
        "smooth": lambda n: smooth(n, 0.0),
        "smooth, scattered": lambda n: smooth(n, 0.2),
        "κ jumps 1:10, in series": jump,
        "κ jumps 1:10, harmonic": lambda n: jump(n, along=False),
        "flux jumps": lambda n: jump(n, flux=3.0),
        "coupled, u": lambda n: coupled(n)[0],
        "coupled, φ": lambda n: coupled(n)[1],
    }
    for name, run in cases.items():
        errors = [run(n) for n in SIDES]
        order = -np.polyfit(np.log(SIDES), np.log(errors), 1)[0]
        print(f"{name:26}", *(f"{e:.1e}" for e in errors), f"order {order:.2f}")
