"""Nonlinear solids held to what they promise: turned bodies, other lattices, their cost.

Takes the models that examples/nonlinear.py left, prints numbers, and leaves them as JSON.
"""

import dataclasses
import json
import statistics
import sys
import time
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent.parent))

import numpy as np
import torch

import warp_peri as wp
from examples.any_lattice import SmoothedAtoms, lattice
from examples.nonlinear import OUT
from examples.train_graphene import DATA
from tools.make_graphene import REACH, SMOOTHING_RADIUS, graphene_bodies, on_nodes, read_samples
from tools.options import Options
from tools.samples import Sample
from warp_peri import Points, Samples
from warp_peri.errors import exit_status
from warp_peri.files.atomic import write_json
from warp_peri.lps.bonds import Bonds
from warp_peri.lps.operator import lps_force
from warp_peri.regression.losses import class_weights
from warp_peri.third_order.material import NonlinearModel
from warp_peri.third_order.sweeps import GradientSweeps, third_order_force

TURN, CRYSTAL = 10.0, 17.0
"""Degrees that bodies and crystals are turned by."""
LATTICES = {"2.5": (2.5, 0.0), "4": (4.0, 0.0), "4 turned": (4.0, 30.0), "7.5": (7.5, 0.0)}
"""Spacing [Å] and turn [degrees] of lattices that the models are transferred to."""
NODES, REPEATS = 200, 15


def rotation(degrees: float) -> np.ndarray:
    """Turns column vectors to the left."""
    angle = np.deg2rad(degrees)
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def turned_body(model: NonlinearModel, samples: Samples) -> dict[str, float]:
    """E_res of the same equilibria seen after a rigid turn of the deformed body, force only."""
    turn = rotation(TURN)
    operator = model.on(samples)
    straight = model.linear.on(samples)
    u = (samples.x + samples.u) @ turn.T - samples.x
    b = samples.loads[:, samples.interior]
    size = np.linalg.norm(b, axis=(1, 2))

    def error(op: Callable[[np.ndarray], np.ndarray], u: np.ndarray, b: np.ndarray) -> float:
        return float((np.linalg.norm(op(u) - b, axis=(1, 2)) / size).mean())

    return {
        "unturned": error(operator, samples.u, b),
        "turned": error(operator, u, b @ turn.T),
        "turned_linear": error(straight, u, b @ turn.T),
    }


def turned_crystal(model: NonlinearModel, cache: Path, role: str) -> dict[str, float]:
    """E_u where the crystal and its loads lie at an angle to the nodes; also with axis forgotten.

    Patches are taken from the sheet's periodic images, their interior is a disk.
    """
    body, _, samples = read_samples(cache, role)
    reference, displacement, force = images(body.box, samples)
    out = {}
    for name, degrees in (("straight", 0.0), ("turned", CRYSTAL)):
        nodes = turned_nodes(reference, displacement, force, degrees)
        if name == "turned":
            out["axis_forgotten"] = wp.evaluate(model, at_angle(nodes, 0.0))["E_u"]
        out[name] = wp.evaluate(model, nodes)["E_u"]
        out[f"{name}_linear"] = wp.evaluate(model.linear, at_angle(nodes, 0.0))["E_u"]
    return out


def turned_nodes(
    reference: np.ndarray, displacement: np.ndarray, force: np.ndarray, degrees: float
) -> Samples:
    """Atoms of a disk and their loads, turned together against nodes 5 Å apart."""
    turn, disk = rotation(degrees).T, graphene_bodies()[1]
    nodes = on_nodes(disk, reference @ turn, displacement @ turn, force @ turn, spacing=5.0)
    return at_angle(nodes, degrees)


def at_angle(samples: Samples, degrees: float) -> Samples:
    """The samples, of a crystal at an angle to the nodes."""
    points = dataclasses.replace(samples.points, axis=degrees)
    return dataclasses.replace(samples, points=points)


def images(
    box: tuple[float, float] | None, samples: Sequence[Sample]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions, displacements and forces of the atoms, periodic images with them."""
    x = samples[0].reference
    displacement = np.stack([sample.displacement for sample in samples])
    force = np.stack([sample.force for sample in samples])
    if box is None:
        return x, displacement, force
    reach = REACH + SMOOTHING_RADIUS
    most = [int(np.ceil(reach / side)) + 1 for side in box]
    steps = np.stack(np.meshgrid(*(np.arange(-n, n + 1) for n in most)), axis=-1).reshape(-1, 1, 2)
    far = (x + steps * np.array(box)).reshape(-1, 2)
    near = np.hypot(*far.T) < reach
    copies = (1, len(steps), 1)
    return far[near], np.tile(displacement, copies)[:, near], np.tile(force, copies)[:, near]


def other_lattices(model: NonlinearModel, atoms: SmoothedAtoms) -> dict[str, Any]:
    """E_u and proven strain of the model on lattices that it was transferred to."""
    table = {}
    for name, (spacing, degrees) in LATTICES.items():
        points = lattice(spacing, degrees)
        row: dict[str, float] = {}
        for kind, role in (("patches", "val"), ("disks", "test")):
            samples = atoms.on(points, role)
            row[kind] = wp.evaluate(model, samples)["E_u"]
            row[f"{kind}_linear"] = wp.evaluate(model.linear, samples)["E_u"]
            row["proven"] = model.on(samples).model.proven_strain(spacing)
        table[name] = row
    return table


def costs(model: NonlinearModel) -> dict[str, float]:
    """Force, and with all gradients, over the linear part: medians of processor time."""
    steps = np.argwhere(np.ones((NODES, NODES)))
    h = model.linear.certified_on[0]
    points = Points(h * steps, np.ones(len(steps), bool), h, box=(h * NODES, h * NODES))
    bonds, sweeps = Bonds(points, model.horizon), GradientSweeps(points, model.horizon)
    random = np.random.default_rng(0)
    u, g = (torch.from_numpy(random.normal(size=points.x.shape)) for _ in range(2))
    solid = model.linear.solid.map(
        lambda value: torch.tensor(np.atleast_1d(value), dtype=torch.float64, requires_grad=True)
    )
    weights = [torch.from_numpy(p).requires_grad_() for p in model.weights(sweeps.classes)]
    numbers = torch.tensor(model.numbers, requires_grad=True)
    u = (0.01 * u).requires_grad_()

    def linear() -> torch.Tensor:
        return lps_force(bonds, u, solid)

    def nonlinear() -> torch.Tensor:
        w, p = (class_weights(sweeps.classes, solid.alpha, D) for D in (solid.D, solid.dilatation))
        bond = 16 * solid.mu * w / torch.from_numpy(sweeps.classes.r) ** 2
        tables = sweeps.by_pair(torch.stack([bond, 2 * p, 2 * weights[0], 2 * weights[1]]))
        return third_order_force(sweeps, u, tables, solid.lam - solid.mu, numbers)

    def graded(force: Callable[[], torch.Tensor], leaves: list[torch.Tensor]) -> None:
        torch.autograd.grad((force() * g).sum(), leaves, allow_unused=True)

    leaves = [u, *solid.values()]
    jobs: dict[str, Callable[[], Any]] = {
        "force_linear": lambda: linear().detach(),
        "force": lambda: nonlinear().detach(),
        "gradient_linear": lambda: graded(linear, leaves),
        "gradient": lambda: graded(nonlinear, [*leaves, *weights, numbers]),
    }
    seconds: dict[str, list[float]] = {name: [] for name in jobs}
    for turn in range(REPEATS + 1):
        for name, job in jobs.items():
            begin = time.process_time()
            job()
            if turn:  # the first compiles
                seconds[name].append(time.process_time() - begin)
    medians = {name: statistics.median(times) for name, times in seconds.items()}
    return {
        "force": medians["force"] / medians["force_linear"],
        "force_and_gradient": medians["gradient"] / medians["gradient_linear"],
        **{f"seconds_{name}": value for name, value in medians.items()},
    }


def main(arguments: list[str] | None = None) -> int:
    parser = Options(__doc__, json=True)
    parser.add("--models", type=Path, default=OUT, help="folder of the models")
    parser.add("--data", type=Path, default=DATA)
    given = parser.parse_args(arguments)
    numbers: dict[str, Any] = {}
    data, cache = wp.load(given.data), given.data.with_suffix(".cache")
    atoms = SmoothedAtoms(cache)
    for name in ("energy", "filtered"):
        model = wp.load(given.models / f"{name}.json")
        with warnings.catch_warnings(action="ignore", category=UserWarning):
            numbers[name] = {
                "turned_body": turned_body(model, data["val"]),
                "turned_disks": turned_crystal(model, cache, "test"),
                "turned_patches": turned_crystal(model, cache, "val"),
                "cost": costs(model),
            }
            there = other_lattices(model, atoms)
            numbers[name] |= {f"lattice {key} Å": row for key, row in there.items()}
    write_json(given.models / "checks.json", numbers)
    if given.json:
        print(json.dumps(numbers))
        return 0
    for name, checks in numbers.items():
        for check, values in checks.items():
            line = ", ".join(f"{key} {value:.4g}" for key, value in values.items())
            print(f"{name}: {check}: {line}")
    return 0


if __name__ == "__main__":
    sys.exit(exit_status(main))
