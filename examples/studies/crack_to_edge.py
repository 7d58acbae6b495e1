"""Cracks that reach a free edge: what they release as the ligament shrinks, and branches to it.

G of a crack in the middle of a strip, whose tips go to both edges, and of one from an edge to the
other, against handbooks, as cut, with the shift of the tip, and with the surface correction (C26).
Then the energy that a crack adds to a pulled strip which branches at ± 45° and goes to the edge by
both arms, against quadratic elements that are refined at the tip (`--branches`, needs scikit-fem).

python examples/studies/crack_to_edge.py [--branches]
"""

import json
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent.parent))

import numpy as np

import warp_peri as wp
from examples.static_crack import REDUCED
from tools.options import Options
from warp_peri.damage import Cracked, energy_release, rectangle, tip_shift
from warp_peri.errors import exit_status

WIDE = 26
"""Spacings of the strip, or of half of it."""
LEFT = (13, 8, 6, 4)
"""Ligaments, in spacings."""


def intensity(kind: str, share: float) -> float:
    """K over σ√(πa) by share of the width; H. Tada and others, 2000: 0.1 % and 0.5 %."""
    t = np.pi * share / 2
    if kind == "to both edges":
        return float((1 - 0.025 * share**2 + 0.06 * share**4) / np.sqrt(np.cos(t)))
    bent = 0.752 + 2.02 * share + 0.37 * (1 - np.sin(t)) ** 3
    return float(np.sqrt(np.tan(t) / t) * bent / np.cos(t))


def pulled(width: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nodes of a strip three times as long, a unit tension on its ends, and components that keep
    it from drifting."""
    x = rectangle(width, 3 * width, 1.0)
    free = np.ones(x.shape, bool)
    back = np.argsort(np.abs(x - [x[:, 0].max(), 0]).sum(axis=1))
    free[back[0]], free[back[1], 0] = False, False
    return x, np.where(np.abs(x[:, 1:]) > 1.5 * width - 1, np.sign(x) * (0.0, 1.0), 0.0), free


def released(model: wp.Model, kind: str, left: int, shift: float, *, corrected: bool) -> float:
    """G over the handbook's, of a ligament of so many spacings; corrected by five lengths."""
    both = kind == "to both edges"
    width, a = WIDE * (1 + both), WIDE - left
    x, b, free = pulled(width)
    points = wp.Points(x, np.ones(len(x), bool), 1.0, units=REDUCED)
    start = -width / 2 - 1
    cracks = [
        [[(-a - d, 0), (a + d, 0)] if both else [(start, 0), (a + d - width / 2, 0)]]
        for d in range(-1 - corrected, 2 + corrected)
    ]
    strip = Cracked(points, b, free=free, corrected=corrected)
    G = energy_release(model, strip, cracks, shift=shift)
    return G * model.E / (np.pi * a * intensity(kind, a / WIDE) ** 2)


def in_elements(model: wp.Model, width: int, start: float, along: float, levels: int = 6) -> float:
    """Energy that the branched crack adds to a strip under unit tension, by half of it.

    From the left edge to `start` on y = 0, then at 45° by `along` in x and in y.
    """
    import skfem as fem
    from skfem.helpers import ddot, sym_grad, trace

    half, high, lam, mu = width / 2, 1.5 * width, model.lam, model.mu
    rows = np.append(np.arange(0, half, 0.5), np.arange(half, high + 0.5))
    mesh = fem.MeshTri.init_tensor(np.arange(-half, half + 0.25, 0.5), rows)
    for level in range(levels):
        middle = mesh.p[:, mesh.t].mean(axis=1)
        away = np.hypot(middle[0] - start - along, middle[1] - along)
        mesh = mesh.refined(np.flatnonzero(away < 4 * 0.6**level))
    (x, y), ends = mesh.p, mesh.t.copy()
    cut = np.flatnonzero((np.abs(y - x + start) < 1e-9) & (y < along - 1e-9) & (x > start - 1e-9))
    twin = np.arange(len(x))
    twin[cut] = len(x) + np.arange(len(cut))
    below = y[ends].mean(axis=0) < x[ends].mean(axis=0) - start
    ends[:, below] = twin[ends[:, below]]
    mesh = fem.MeshTri(np.hstack([mesh.p, mesh.p[:, cut]]), ends)
    element = fem.ElementVector(fem.ElementTriP2())
    basis = fem.Basis(mesh, element, intorder=4)

    @fem.BilinearForm
    def energy(u, v, w):
        e, f = sym_grad(u), sym_grad(v)
        return lam * trace(e) * trace(f) + 2 * mu * ddot(e, f)

    top = mesh.facets_satisfying(lambda x: np.abs(x[1] - high) < 1e-9)
    pull = fem.LinearForm(lambda v, w: v[1]).assemble(fem.FacetBasis(mesh, element, facets=top))
    ahead = mesh.facets_satisfying(lambda x: (x[1] < 1e-9) & (x[0] > start))
    corner = basis.nodal_dofs[0, [np.argmax(mesh.p[0] - mesh.p[1])]]
    held = np.concatenate([basis.get_dofs(ahead).all("u^2"), corner])
    u = fem.solve(*fem.condense(energy.assemble(basis), pull, D=held))
    return float(pull @ u - width * high / model.E)


def added(model: wp.Model, start: float, along: float, *, corrected: bool) -> float:
    """The same of nodes a spacing apart."""
    width = 2 * WIDE
    x, b, free = pulled(width)
    points = wp.Points(x, np.ones(len(x), bool), 1.0, units=REDUCED)
    arms = [[(-WIDE - 1, 0), (start, 0), (start + along, side * along)] for side in (1, -1)]
    found = []
    for cracks in ([], arms):
        problem = Cracked(points, b, cracks=cracks, free=free, corrected=corrected)
        found.append(float(np.vdot(b, wp.solve(model, problem).u)) / 2)
    return found[1] - found[0]


def main(argv: list[str] | None = None) -> int:
    parser = Options(__doc__)
    parser.add("--left", type=int, nargs="+", default=list(LEFT), help="ligaments, in spacings")
    parser.add("--branches", action="store_true", help="branched cracks instead")
    args = parser.parse_args(argv)
    table: dict[str, dict[str, list[float]]] = {}
    known: dict[int, float] = {}
    for ratio in (2.0, 3.0):
        model = wp.Model(lam=1.0, mu=1.0, alpha=1.0, D=np.ones(1), horizon=ratio, units=REDUCED)
        if args.branches:  # a start between the nodes' diagonals
            row = table[f"branches, horizon {ratio:g}h: as cut, corrected"] = {}
            for left in args.left:
                along = WIDE - 0.5 - left
                known.setdefault(left, in_elements(model, 2 * WIDE, 0.5, along))
                row[f"{left}h left"] = [
                    100 * (added(model, 0.5, along, corrected=one) / known[left] - 1)
                    for one in (False, True)
                ]
            continue
        cut, other = (tip_shift(model, 1.0, corrected=one) for one in (False, True))
        for kind in ("to both edges", "from an edge to the other"):
            row = table[f"{kind}, horizon {ratio:g}h: as cut, shift, corrected"] = {}
            for left in args.left:
                ways = ((0.0, False), (cut, False), (other, True))
                row[f"{left}h left"] = [
                    100 * (released(model, kind, left, by, corrected=one) - 1) for by, one in ways
                ]
    print(json.dumps(table, indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(exit_status(main))
