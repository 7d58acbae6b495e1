"""What forces of dressed sheets cost, beside bonds and a sparse matrix; effective tensors."""

import functools
import json
import time
from collections.abc import Callable
from importlib.util import find_spec
from typing import Any

import numpy as np

from tools.benchmark_crystals import least as least_by
from tools.graphene_phonons import force_constants
from warp_peri import Points
from warp_peri.core.elastic import PAIRS, voigt
from warp_peri.dressed import DressedSolid, FiniteSolid, effective, from_phonons, torn
from warp_peri.launch import set_threads
from warp_peri.micromodulus import from_phonons as tensors_from_phonons

least = functools.partial(least_by, clock=time.process_time)
"""By the processor's time, which other work on the machine hardly changes."""
LAWS = {"elements, G 8": ("elements", 8), "bonds, G 8": ("bonds", 8), "bonds, G 12": ("bonds", 12)}
TENSORS = 12.5
"""Horizon of tensors on 20 bonds [Å]."""
MATRIX = 4
"""How many times smaller each way the sheet of the sparse matrix is."""


def ways(law: DressedSolid, points: Points) -> dict[str, Callable[[], Any]]:
    """Ways to the same force on one thread, and of bodies that vary and end; checked."""
    rng = np.random.default_rng(0)
    rows, layers = law.crystal.on(points, method="rows"), law.on(points)
    planes = layers.nodes.scatter(rng.normal(size=(1, *points.x.shape)))
    found: dict[str, Callable[[], Any]] = {
        "bonds of L by rows": functools.partial(rows.pull, planes),
        "G, K, G": functools.partial(layers.pull, planes),
    }
    if law.dimension == 2:
        single = law.on(points, dtype=np.float32)
        found["G, K, G, float32"] = functools.partial(single.pull, planes.astype(np.float32))
    known = found["bonds of L by rows"]()
    for name, way in found.items():
        off = np.abs(way() - known).max() / np.abs(known).max()
        assert off < (1e-5 if "float32" in name else 1e-12), f"{name}: {off:.1e}"
    x, h = points.x, law.spacing
    ends = Points(x, points.interior, h)
    maps = {name: rng.uniform(0.5, 1.5, len(x)) for name in law.parts.names}
    far = np.linalg.norm(x - x.mean(axis=0), axis=1) > 0.2 * np.ptp(x[:, 0])
    bodies = {
        "maps": law.on(points, maps=maps),
        "edges": law.on(ends, edges=True),
        "a hole": law.on(Points(x[far], points.interior[far], h), edges=True),
        "two grains": law.on(points, grains=([law, law], (x[:, 0] > x[:, 0].mean()).astype(int))),
    }
    if law.dimension == 2:
        across = 0.25 * np.ptp(x[:, 0]) * np.array([[1, 2], [3, 2]])
        bodies["a crack"] = law.on(ends, edges=True, broken=torn(ends, [across]))
    for name, body in bodies.items():
        found[name] = functools.partial(body.in_turn, rng.normal(size=(body.points.x.size, 1)))
    return found


def block_of_elements() -> DressedSolid:
    """A solid in space under a G of 26 neighbours."""
    steps = np.array([step for step in np.ndindex(3, 3, 3) if step > (1, 1, 1)]) - 1
    tensors = np.broadcast_to(0.01 * np.eye(3), (1, len(steps), 3, 3))
    return DressedSolid(1.0, "elements", isotropic_matrix(1.0, 1.0), steps, tensors)


def dressed(*, quick: bool) -> None:
    """Print nanoseconds a node of every way, as JSON."""
    side = 200 if quick else 1000
    set_threads(1)
    table: dict[str, dict[str, float]] = {}
    laws = {
        name: from_phonons(
            force_constants(), 5.0, base, neighbours, symmetry="isotropic", split=False
        )
        for name, (base, neighbours) in LAWS.items()
    } | {"elements in space, G 26": block_of_elements()}
    for name, law in laws.items():
        d, rounds = law.dimension, 3 if quick else 15
        across = side if d == 2 else round(side ** (2 / 3))
        points = lattice(across, law)
        table[name] = {
            way: 1e9 * least(run, rounds) / len(points.x) for way, run in ways(law, points).items()
        }
        small = lattice(across // MATRIX, law)
        L = law.on(small).matrix()
        v = np.random.default_rng(0).normal(size=L.shape[1])
        table[name]["SciPy CSR"] = 1e9 * least(lambda: L @ v, rounds) / len(small.x)  # noqa: B023
    turning = FiniteSolid(5.0, -0.197, 0.722, -0.120, 0.034, 0.047, -0.44, -7.32, 1.11)
    small = Points.sheet((side // MATRIX,) * 2, turning.spacing)
    body, u = turning.on(small), 0.01 * np.random.default_rng(0).normal(size=small.x.shape)
    table["finite strain"] = {"elements": 1e9 * least(lambda: body(u), rounds) / len(small.x)}
    tensors = tensors_from_phonons(force_constants(), 5.0, TENSORS, symmetry="isotropic")
    operator = tensors.on(Points.sheet((side, side), tensors.spacing), method="rows")
    planes = np.random.default_rng(0).normal(size=(1, 2, *operator.nodes.wide))
    seconds = least(lambda: operator.pull(planes), rounds)
    table["tensors, 20 bonds"] = {"bonds of L by rows": 1e9 * seconds / side**2}
    print(json.dumps({"side": side, "nanoseconds a node": table}, indent=1))


def lattice(side: int, law: DressedSolid) -> Points:
    """A period of so many nodes each way."""
    d, h = law.dimension, law.spacing
    x = h * np.indices((side,) * d).reshape(d, -1).T
    return Points(x, np.ones(len(x), bool), h, box=(side * h,) * d)


CONTRASTS = (2, 20)
RESIDUAL = 1e-8
"""Of every load, relative; of both."""


def spheres(side: int) -> np.ndarray:
    """Six spheres of one seed in a period of side³ elements: 1 inside, 0 elsewhere."""
    rng = np.random.default_rng(4)
    x = (np.indices((side,) * 3).reshape(3, -1).T + 0.5) / side
    found = np.zeros(len(x), bool)
    for middle, radius in zip(rng.random((6, 3)), rng.uniform(0.15, 0.25, 6)):
        apart = (x - middle + 0.5) % 1 - 0.5
        found |= (apart**2).sum(axis=1) < radius**2
    return found.reshape((side,) * 3).astype(int)


def in_mugrid(phases: np.ndarray, contrast: float) -> tuple[np.ndarray, list[int]]:
    """The same tensor as Voigt's matrix, and iterations, by muGrid: the same elements, mean solid,
    loads and tolerance."""
    import muGrid
    from muGrid.Preconditioners import make_reference_stiffness_preconditioner
    from muGrid.Solvers import conjugate_gradients

    comm = muGrid.Communicator()
    operator = muGrid.IsotropicStiffnessOperator(3, [1.0] * 3)
    engine = muGrid.FFTEngine(list(phases.shape), comm, ghosts=operator)
    moduli = engine.real_space_field("moduli")  # λ = μ
    moduli.p[:] = np.where(phases, contrast, 1.0)
    engine.communicate_ghosts(moduli)
    mean = float(moduli.p.mean())
    evened = make_reference_stiffness_preconditioner(
        engine, nb_components=3, element=muGrid.FEMElement.q1, grid_spacing=[1.0] * 3,
        lambda_ref=mean, mu_ref=mean,
    )  # fmt: skip
    b, u = (engine.real_space_field(name, components=(3,)) for name in "bu")

    def product(given: Any, found: Any) -> None:
        engine.communicate_ghosts(given)
        operator.apply(given, moduli, moduli, found)

    C, took = np.empty((6, 6)), []
    for n, (i, j) in enumerate(PAIRS[3]):
        E = np.zeros((3, 3))
        E[i, j] = E[j, i] = 1.0 if i == j else 0.5
        operator.apply_macro_rhs(moduli, moduli, E.ravel(), b)
        b.p[:] *= -1
        u.set_zero()
        count = [0]
        conjugate_gradients(
            comm, engine.real_space_collection, b, u, product, evened, rtol=RESIDUAL,
            callback=lambda number, *_: count.__setitem__(0, number),  # noqa: B023
        )  # fmt: skip
        took.append(count[0])
        engine.communicate_ghosts(u)
        stress = np.reshape(operator.average_stress(u, moduli, moduli, E.ravel()), (3, 3))
        C[:, n] = [stress[pair] / phases.size for pair in PAIRS[3]]
    return C, took


def varying(*, quick: bool, sides: tuple[int, ...] = ()) -> None:
    """Print iterations and processor seconds of effective tensors in space, as JSON.

    One thread of both; muGrid beside where it is installed, round by round in one process.
    """
    set_threads(1)
    rival = find_spec("muGrid") is not None
    table = []
    for side in sides or ((16, 32) if quick else (32, 64, 128)):
        phases, rounds = spheres(side), 1 if side > 64 else 2
        for contrast in CONTRASTS:
            C = isotropic_matrix(1.0, 1.0)
            seconds: dict[str, list[float]] = {"warp_peri": [], "muGrid": []}
            row: dict[str, Any] = {"side": side, "contrast": contrast}
            effective([C, contrast * C], phases[:4, :4, :4])  # compiles
            for _ in range(rounds):
                start = time.process_time()
                ours = effective([C, contrast * C], phases, tolerance=RESIDUAL)
                seconds["warp_peri"].append(time.process_time() - start)
                row["iterations"] = ours.iterations
                if rival:
                    start = time.process_time()
                    theirs, row["iterations of muGrid"] = in_mugrid(phases, contrast)
                    seconds["muGrid"].append(time.process_time() - start)
                    own = voigt(ours.tensor)
                    row["apart"] = float(np.abs(theirs - own).max() / own.max())
            row |= {f"seconds of {name}": min(times) for name, times in seconds.items() if times}
            if rival:
                row["ratio"] = row["seconds of warp_peri"] / row["seconds of muGrid"]
            table.append(row)
    print(json.dumps({"residual": RESIDUAL, "muGrid": rival, "table": table}, indent=1))


def isotropic_matrix(lam: float, mu: float) -> np.ndarray:
    """Voigt's matrix in space."""
    C = np.diag([2 * mu] * 3 + [mu] * 3)
    C[:3, :3] += lam
    return C
