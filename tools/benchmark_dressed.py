"""What a force of a dressed sheet costs, even and with maps, beside bonds and a sparse matrix."""

import functools
import json
from collections.abc import Callable
from typing import Any

import numpy as np

from tools.benchmark_crystals import least
from tools.graphene_phonons import force_constants
from warp_peri import Points
from warp_peri.dressed import DressedSolid, FiniteSolid, from_phonons
from warp_peri.dressed.sweeps import ByLayers
from warp_peri.launch import set_threads
from warp_peri.micromodulus import from_phonons as tensors_from_phonons

LAWS = {"elements, G 8": ("elements", 8), "bonds, G 8": ("bonds", 8), "bonds, G 12": ("bonds", 12)}
TENSORS = 12.5
"""Horizon of tensors on 20 bonds [Å]."""
MATRIX = 4
"""How many times smaller each way the sheet of the sparse matrix is."""


def ways(law: DressedSolid, points: Points) -> dict[str, Callable[[], Any]]:
    """Ways to the same force on one thread; checked against the first."""
    rng = np.random.default_rng(0)
    rows, layers = law.crystal.on(points, method="rows"), law.on(points)
    single = law.on(points, dtype=np.float32)
    planes = layers.nodes.scatter(rng.normal(size=(1, *points.x.shape)))
    found: dict[str, Callable[[], Any]] = {
        "bonds of L by rows": functools.partial(rows.pull, planes),
        "G, K, G": functools.partial(layers.pull, planes),
        "G, K, G, float32": functools.partial(single.pull, planes.astype(np.float32)),
    }
    factors = np.ones((len(law.parts.names), *layers.nodes.wide))
    own = layers.nodes, law.steps, law.tensors[0], law.parts, law.spacing, factors
    found["with maps"] = functools.partial(ByLayers(*own), planes)
    found["with maps, float32"] = functools.partial(ByLayers(*own, np.float32), planes.astype("f4"))
    known = found["bonds of L by rows"]()
    for name, way in found.items():
        off = np.abs(way() - known).max() / np.abs(known).max()
        assert off < (1e-5 if "float32" in name else 1e-12), f"{name}: {off:.1e}"
    return found


def dressed(*, quick: bool) -> None:
    """Print nanoseconds a node of every way, as JSON."""
    side = 200 if quick else 1000
    set_threads(1)
    table: dict[str, dict[str, float]] = {}
    for name, (base, neighbours) in LAWS.items():
        law = from_phonons(
            force_constants(), 5.0, base, neighbours, symmetry="isotropic", split=False
        )
        points = Points.sheet((side, side), law.spacing)
        rounds = 3 if quick else 15
        table[name] = {
            way: 1e9 * least(run, rounds) / side**2 for way, run in ways(law, points).items()
        }
        small = Points.sheet((side // MATRIX,) * 2, law.spacing)
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
