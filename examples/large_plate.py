"""A plate of graphene at rest, spread over ranks: an L with a hole, or a square, a disk, a cube.

    mpiexec -n 2 python examples/large_plate.py --sides 128 250 500

No rank has the whole of it. The number of iterations does not grow with the plate or the ranks, and
the answer has the same bits on any number of ranks. At the first size it is held to one process.
"""

import hashlib
import json
import resource
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

import numpy as np

import warp_peri as wp
from examples.figures import save_figure
from tools.options import Options
from warp_peri.errors import exit_status
from warp_peri.ranks import is_first, lattice

SHAPES = ("L", "square", "disk", "cube")
SPACING = 5.0
"""Of nodes [Å]."""


def plate(shape: str, n: int, law, block):
    """n nodes along each side, with the collar that the law asks for."""
    h, collar = law.spacing, int(np.abs(law.steps).max())

    def interior(x: np.ndarray) -> np.ndarray:
        at = x / h - collar - (n - 1) / 2
        inside = (np.abs(at) < n / 2).all(axis=1)
        if shape == "disk":
            inside &= (at**2).sum(axis=1) <= (n / 2) ** 2
        if shape == "L":
            inside &= ~(at > 0).all(axis=1) & (np.linalg.norm(at + n / 4, axis=1) >= n / 10)
        return inside

    return lattice((n + 2 * collar,) * law.dimension, h, interior, block=block)


def given(x: np.ndarray, side: float) -> tuple[np.ndarray, np.ndarray]:
    """A load [TPa/Å], and a displacement [Å] for the collar, from positions alone."""
    at = x / side
    load = np.stack([np.sin(6 * at[:, 0]) * np.cos(3 * at[:, 1]) + 0.3, *at.T[1:] ** 2], axis=1)
    bent = np.stack([at[:, 0] * at[:, 1] + np.sin(4 * at[:, 0]), *(at.T[1:] - at[:, 0] ** 2)], 1)
    return 1e-6 * load, 1e-5 * side * bent


def difference(points, b: np.ndarray, u: np.ndarray, found, law, solver) -> float | None:
    """To the answer of one process, over the largest displacement; on the first rank."""
    x, interior, b, u, found = map(points.gather, (points.x, points.interior, b, u, found))
    if not is_first():
        return None
    alone = wp.solve(law, wp.Dirichlet(wp.Points(x, interior, points.spacing), b, u), solver=solver)
    return float(np.abs(alone.u - found).max() / np.abs(alone.u).max())


def main(argv: list[str] | None = None) -> int:
    parser = Options(__doc__, "large_plate", json=True)
    parser.add("--sides", type=int, nargs="+", default=[128, 250], help="nodes")
    parser.add("--shape", choices=SHAPES, default="L")
    parser.add("--block", type=int, nargs="+", help="nodes of a tile along the first axes")
    parser.add("--tolerance", type=float, default=1e-10, help="of the residual")
    parser.add("--ratio", type=float, help="λ/μ, instead of the learned one")
    args = parser.parse_args(argv)
    model = wp.load(ROOT / "tools" / "solve_model.json")
    lam = model.lam if args.ratio is None else args.ratio * model.mu
    if args.shape == "cube":
        lam = model.mu if args.ratio is None else lam
        model = wp.Model(lam, model.mu, 1.0, np.ones(1), horizon=15.0, dimension=3)
    elif args.ratio is not None:
        numbers_of_K = model.alpha, model.D, model.horizon
        model = wp.Model(lam, model.mu, *numbers_of_K, certified_on=(SPACING,))
    law = wp.micromodulus.tensors_of(model, SPACING)
    of_sizes = "iterations", "residual", "bits", "seconds", "processor", "memory"
    numbers: dict = {name: {} for name in of_sizes}
    solver = wp.Krylov("multigrid", tolerance=args.tolerance)
    alone = wp.Krylov(tolerance=args.tolerance)
    for n in args.sides:
        points = plate(args.shape, n, law, args.block and tuple(args.block))
        b, u = given(points.x, n * law.spacing)
        begin, busy = time.perf_counter(), time.process_time()
        solution = wp.solve(law, wp.Dirichlet(points, b, u), solver=solver)
        numbers["seconds"][n] = round(time.perf_counter() - begin, 2)
        busy = max(points.comm.allgather(time.process_time() - busy))
        numbers["processor"][n] = round(busy, 2)
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        numbers["memory"][n] = numbers["memory_mb"] = round(max(points.comm.allgather(memory)))
        numbers["iterations"][n] = solution.iterations[0]
        numbers["residual"][n] = solution.residual
        if n == args.sides[0]:
            first = points, b, u, solution.u
        numbers["bits"][n] = hashlib.sha256(points.gather(solution.u).tobytes()).hexdigest()[:12]
    points, b, u, found = first
    asked = (law, None) if args.shape == "cube" else (model, alone)
    numbers["difference"] = difference(points, b, u, found, *asked)
    numbers["ranks"] = points.comm.size
    owner = points.gather(np.full(len(points.x), points.comm.rank))
    found = points.gather(np.where(points.interior[:, None], found, np.nan))
    x = points.gather(points.x)
    if not is_first():
        return 0
    from matplotlib.figure import Figure  # the other ranks need no memory for it

    figure = Figure(figsize=(8.4, 3.6), layout="constrained")
    flat = slice(None) if x.shape[1] == 2 else x[:, 2] == np.median(x[:, 2])
    left, right = figure.subplots(1, 2, sharex=True, sharey=True)
    size, at = np.linalg.norm(found, axis=1)[flat], x[flat].T[:2]
    shown = left.scatter(*at, c=size, s=6, marker="s", linewidths=0)
    figure.colorbar(shown, ax=left, label="size of the displacement [Å]")
    left.set(aspect="equal", title="One solve of the whole plate", xlabel="x [Å]", ylabel="y [Å]")
    for rank in range(points.comm.size):
        mine = owner[flat] == rank
        right.scatter(*at[:, mine], s=6, marker="s", linewidths=0, color=f"C{rank}")
        middle = at[:, mine].mean(axis=1)
        right.text(*middle, f"process\n{rank}", ha="center", va="center", color="white")
    right.set(aspect="equal", title="Each process owns a part of the nodes", xlabel="x [Å]")
    save_figure(figure, args.out / "plate.png")
    print(json.dumps(numbers, indent=None if args.json else 1))
    return 0


if __name__ == "__main__":
    sys.exit(exit_status(main))
