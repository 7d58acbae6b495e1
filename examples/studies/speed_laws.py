"""The chart's laws beside the linear solid: third order, tensors, dressed, predict, a network."""

import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

import warp_peri as wp
from examples.predict import rich_law
from tools import make_graphene as making
from tools.loads import DESIGNED
from tools.make_scenes import DISK, make_scenes
from tools.make_strained import strained_file
from tools.samples import read_sample
from warp_peri import Samples
from warp_peri.choice import gradient_size
from warp_peri.methods import Optimum, Smoothing
from warp_peri.prediction import Family

Solver = Callable[[np.ndarray, np.ndarray], np.ndarray]
ROOT = Path(__file__).resolve().parent.parent.parent
NETWORK = ROOT / "examples" / "neural_weights" / "graphene.json"
"""The printed neural operator, as it was trained on all seventy loads in 25 minutes."""
TOLERANCES = (0.10, 0.05, 0.02, 0.01, 0.005)
STRAINS = (0.01, 0.05, 0.10)
"""Largest bond strains of the disks that say how errors grow with strain."""


def laws() -> dict[str, tuple[str, Any, float]]:
    """Label: kind, law and horizon [Å], all on nodes 5 Å apart."""
    two = wp.Bernstein(10, two_functions=True)
    linear = wp.LPS(20.0, two, method=Optimum(moduli="isotropic"), normalise=True)
    tensors = wp.Micromodulus(15.0, normalise=True)
    return {
        "third order, energy form, δ = 20": ("third order", wp.ThirdOrder(linear), 20.0),
        "third order, filtered, δ = 25": ("third order", rich_law(), 25.0),
        "third order on tensors, 28 bonds": (
            "third order",
            wp.ThirdOrder(tensors, Smoothing(10.0)),
            15.0,
        ),
        "tensors, 20 bonds": ("tensors", wp.Micromodulus(12.5), 12.5),
        "tensors, 28 bonds": ("tensors", wp.Micromodulus(15.0), 15.0),
        "dressed, 8 neighbours": ("dressed", wp.Dressed(), 7.1),
    }


def learned(train: Samples, val: Samples) -> Iterator[tuple[str, str, Any, float, float]]:
    """Label, kind, material, horizon, and seconds of its fit."""
    for label, (kind, law, horizon) in laws().items():
        material, seconds = _timed_fit(train, law)
        yield label, kind, material, horizon, seconds
    family, seconds = _timed_fit(train, Family(rich_law()), validation=val)
    yield "predict", "predict", family, 25.0, seconds


def _timed_fit(samples: Samples, law: Any, **options: Any) -> tuple[Any, float]:
    start = time.perf_counter()
    with warnings.catch_warnings(action="ignore"):
        material = wp.fit(samples, law, progress=False, **options).material
    return material, time.perf_counter() - start


def by_rest(material: Any) -> Callable[[Samples], Solver]:
    """A material placed once, and its own equilibrium; of one load or a stack."""

    def prepare(points: Samples) -> Solver:
        with warnings.catch_warnings(action="ignore"):
            operator = material.on(points.points)

        def solve(b: np.ndarray, u: np.ndarray) -> np.ndarray:
            with warnings.catch_warnings(action="ignore"):
                answer = np.asarray(operator.rest(b, u).u)
            return answer[..., points.interior, :]

        return solve

    return prepare


def by_predict(family: Any, tolerance: float) -> Callable[[Samples], Solver]:
    """Answers of a family within a tolerance."""

    def prepare(points: Samples) -> Solver:
        placed = family.with_doubts(points.points)

        def solve(b: np.ndarray, u: np.ndarray) -> np.ndarray:
            answers = wp.predict(placed, wp.Dirichlet(points.points, b, u), tolerance)
            each = answers if isinstance(answers, tuple) else (answers,)
            found = np.stack([one.u[points.interior] for one in each])
            return found if b.ndim == 3 else found[0]

        return solve

    return prepare


def rows(
    train: Samples, val: Samples
) -> Iterator[tuple[str, str, float, str, Callable[[Samples], Solver], float]]:
    """Label, kind, horizon, method, how it is solved, and seconds of the fit."""
    for label, kind, material, horizon, seconds in learned(train, val):
        if kind != "predict":
            yield f"{label}, h = 5", kind, horizon, "rest", by_rest(material), seconds
            continue
        for tolerance in TOLERANCES:
            name = f"predict at {100 * tolerance:g} %"
            yield name, kind, horizon, "predict", by_predict(material, tolerance), seconds
    network = wp.load(NETWORK)
    seconds = float(network.provenance["seconds"])
    yield "neural operator, δ = 20", "network", 20.0, "network", by_rest(network), seconds


def two_loads(cache: Path) -> Samples:
    """The designed loads, each both ways, on nodes 5 Å apart."""
    sheet, _ = making.graphene_bodies()
    samples = making.solve_all({sheet: DESIGNED}, cache, 1, False)[sheet]
    return making.point_set(sheet, DESIGNED, samples, spacing=5.0)


def strained_disks(file: Path, spacing: float) -> list[tuple[float, Samples]]:
    """Disks of growing strain on nodes so far apart [Å]: mean |H|, and samples."""
    make_scenes(file)  # what is there is read
    _, disk = making.graphene_bodies()
    found = []
    for strain in STRAINS:
        paths = [strained_file(file.with_suffix(".cache"), disk, one, strain) for one in DISK]
        samples = [one for one in map(read_sample, paths) if one is not None]
        points = making.point_set(disk, DISK, samples, spacing=spacing)
        found.append((mean_gradient(points), points))
    return found


def mean_gradient(points: Samples) -> float:
    """Root mean square of |grad u| of all samples."""
    return float(np.sqrt(np.mean([gradient_size(points, u) ** 2 for u in points.u])))
