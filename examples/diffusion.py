"""Nonlocal diffusion: orders on lattices and scattered points, a jump, a microstructure, coupling.

Exact solutions are given on the collar; the microstructure is held to finite elements.
"""

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

REDUCED = ("sigma", "epsilon/sigma^3")
"""Units of numbers that have none."""
sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np
from matplotlib.figure import Figure

import warp_peri as wp
from examples.figures import headline, save_figure
from tools.options import Options
from warp_peri import Points
from warp_peri.diffusion import Conductor, CoupledSolid
from warp_peri.errors import exit_status

RATIO = 3.0
"""Horizon over spacing on lattices; 3.5 on scattered points."""
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
    off = wp.solve(Conductor(ratio / cells, units=REDUCED), problem, kappa=kappa).u - exact
    rows = points.interior
    return float(np.linalg.norm(off[rows]) / np.linalg.norm(exact[rows]))


def smooth(cells: int, shift: float) -> float:
    """sin(x + 0.2) cos(2 y) with uniform conductivity."""
    ratio = 3.5 if shift else RATIO
    points = square(cells, ratio, shift)
    exact = np.sin(points.x[:, 0] + 0.2) * np.cos(2 * points.x[:, 1])
    return error(points, ratio, cells, 1.0, exact, 5 * exact)


def jump(cells: int, along: bool = True) -> float:
    """Conductivity 1 left and 10 right of x = 0, in series along bonds or by harmonic means."""
    points = square(cells, RATIO)
    x, y = points.x.T

    def kappa(place: np.ndarray) -> np.ndarray:
        return np.where(place[..., 0] < 0, 1.0, 10.0)

    exact = np.sin(y + 0.3) * (np.cosh(x) + np.sinh(x) / kappa(points.x))
    return error(points, RATIO, cells, kappa if along else kappa(points.x), exact, 0.0)


def flux_jump(cells: int, right: float = 10.0) -> float:
    """A line source: the flux jumps at x = 0, [κ ∂φ/∂x] = 2 sin(y + 0.3), κ 1 left of it.

    The source lies on the two columns of nodes beside the line, half on either.
    """
    points = square(cells, RATIO)
    x, y = points.x.T

    def kappa(place: np.ndarray) -> np.ndarray:
        return np.where(place[..., 0] < 0, 1.0, right)

    flux = np.where(x < 0, 1.0, 3.0)
    exact = np.sin(y + 0.3) * (np.cosh(x) + flux * np.sinh(x) / kappa(points.x))
    source = -2.0 * np.sin(y + 0.3) * (np.abs(x) < points.spacing) / (2 * points.spacing)
    return error(points, RATIO, cells, kappa, exact, source)


def coupled(cells: int) -> tuple[float, float]:
    """Errors of u and φ after two steps of a solution that grows linearly in time."""
    points = square(cells, 2 * RATIO)
    x, y = points.x.T
    h = points.spacing
    u = np.column_stack([np.sin(x) * np.sin(y) + 0.3 * x * x, np.cos(x) * np.cos(y)])
    phi = np.exp(x) * np.cos(y) + 0.2 * x * x
    gradient = np.column_stack([np.exp(x) * np.cos(y) + 0.4 * x, -np.exp(x) * np.sin(y)])
    laplacian = np.column_stack([-2 * u[:, 0] + 0.6 * (1 + x * x), -2 * u[:, 1]])
    rise = np.column_stack([np.full_like(x, 0.6), 0 * x])  # gradient of div u = 0.6 x
    load = -MU * laplacian - (LAM + MU) * rise - COUPLING * gradient
    model = wp.Model(lam=LAM, mu=MU, alpha=1.0, D=np.ones(1), horizon=RATIO * h, units=REDUCED)
    solid = CoupledSolid(model, Conductor(RATIO * h, units=REDUCED), COUPLING, STORAGE)

    def loads(time: float) -> np.ndarray:
        source = STORAGE * phi - COUPLING * 0.6 * x - 0.4 * time
        return np.column_stack([time * load, source])

    fields = np.column_stack([u, phi])
    problem = wp.Dirichlet(points, loads, 0 * fields)
    run = wp.move(solid, problem, step=0.5, steps=2, collar=lambda time: time * fields)
    free = points.interior
    pairs = ((run.u[:, :2], u), (run.u[:, 2], phi))
    return tuple(  # type: ignore[return-value]
        float(np.linalg.norm((a - b)[free]) / np.linalg.norm(b[free])) for a, b in pairs
    )


def microstructure(cells: int, grains: int = 12, seed: int = 0) -> tuple[float, Any]:
    """Random round grains, 20 times the matrix, against quadratic finite elements."""
    from skfem import Basis, BilinearForm, ElementQuad2, MeshQuad, condense, solve
    from skfem.helpers import dot, grad

    random = np.random.default_rng(seed)
    middle, radius = random.uniform(-0.9, 0.9, (grains, 2)), random.uniform(0.1, 0.25, grains)

    def kappa(place: np.ndarray) -> np.ndarray:
        away = np.linalg.norm(place[..., None, :] - middle, axis=-1)
        return np.where((away < radius).any(axis=-1), 20.0, 1.0)

    mesh = MeshQuad.init_tensor(*2 * [np.linspace(-1.5, 1.5, 12 * cells // 4 + 1)])
    basis = Basis(mesh, ElementQuad2(), intorder=6)

    @BilinearForm
    def conduction(u, v, w):
        return kappa(np.moveaxis(np.asarray(w.x), 0, -1)) * dot(grad(u), grad(v))

    phi = basis.doflocs[0] * 1.0  # φ = x on the outer edge
    phi = solve(*condense(conduction.assemble(basis), x=phi, D=basis.get_dofs()))
    points = square(cells, RATIO)
    exact = basis.probes(points.x.T) @ phi
    problem = wp.Dirichlet(points, None, exact)
    solved = wp.solve(Conductor(RATIO / cells, units=REDUCED), problem, kappa=kappa).u
    free = points.interior
    off = np.linalg.norm((solved - exact)[free]) / np.linalg.norm(exact[free])
    return float(off), (points.x, kappa(points.x), solved, free)


def order(cells: list[int], errors: list[float]) -> float:
    """Fitted order of an error in the spacing."""
    return float(-np.polyfit(np.log(cells), np.log(errors), 1)[0])


def study(cells: list[int], run: Callable[[int], float]) -> dict[str, Any]:
    """Errors by spacing and their order."""
    errors = [run(n) for n in cells]
    return {"errors": dict(zip(map(str, cells), errors)), "order": order(cells, errors)}


def draw(
    path: Path, x: np.ndarray, kappa: np.ndarray, solved: np.ndarray, free: np.ndarray
) -> None:
    """Conductivity and solution of the plate with grains."""
    figure = Figure(figsize=(9, 3.8), layout="constrained")
    shown = {"conductivity / the plate's": kappa, "temperature, x₁ on the outer edge": solved}
    for ax, (name, values) in zip(figure.subplots(1, 2, sharey=True), shown.items()):
        size = (180 / np.sqrt(free.sum())) ** 2  # of a node in the panel [points²]
        drawn = ax.scatter(*x[free].T, c=values[free], s=1.6 * size, marker="s", linewidths=0)
        ax.set(aspect="equal", xlabel="x₁ / half side")
        figure.colorbar(drawn, ax=ax, label=name)
    figure.axes[0].set_ylabel("x₂ / half side")
    headline(figure, "Temperature hardly varies inside grains that conduct better than the plate")
    save_figure(figure, path)


def main(argv: list[str] | None = None) -> int:
    parser = Options(__doc__, "diffusion", json=True)
    parser.add("--cells", type=int, nargs="+", default=[8, 16, 32], help="per unit length")
    parser.add("--microstructure", type=int, default=32, help="its cells, 0 for none")
    args = parser.parse_args(argv)
    if min(args.cells) < 4 or len(set(args.cells)) < 2:
        parser.error(f"--cells: expected two numbers ≥ 4 or more, got {args.cells}")
    cells = args.cells
    numbers: dict[str, Any] = {
        "smooth": study(cells, lambda n: smooth(n, 0.0)),
        "smooth, scattered": study(cells, lambda n: smooth(n, 0.2)),
        "jump, series": study(cells, jump),
        "jump, harmonic": study(cells, lambda n: jump(n, along=False)),
        "flux jumps": study(cells, flux_jump),
    }
    both = [coupled(n) for n in cells]
    for place, name in enumerate(("coupled, u", "coupled, φ")):
        errors = [pair[place] for pair in both]
        numbers[name] = {
            "errors": dict(zip(map(str, cells), errors)),
            "order": order(cells, errors),
        }
    if args.microstructure:
        numbers["microstructure"], fields = microstructure(args.microstructure)
        draw(args.out / "diffusion.png", *fields)
    print(json.dumps(numbers, ensure_ascii=False, indent=None if args.json else 1))
    return 0


if __name__ == "__main__":
    sys.exit(exit_status(main))
