"""What a user writes, with types: every public name once, as in the README.

tests/package/test_types.py has mypy check this file as a user would, and runs it.
"""

import sys
import warnings
from pathlib import Path
from typing import assert_type

import numpy as np
import torch

import warp_peri
from warp_peri import stress
from warp_peri.operator.stress import NodeFields

SPACING, HORIZON, DENSITY, THICKNESS = 1.0, 2.5, 2200.0, 3.35


def samples(model: warp_peri.Model, seed: int, *, noise: float = 0.0) -> warp_peri.Samples:
    """Smooth displacements of a lattice and the loads that a model answers them with."""
    generator = np.random.default_rng(seed)
    line = SPACING * np.arange(-8, 9)
    x = np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1).reshape(-1, 2)
    interior = np.abs(x).max(axis=1) <= 3
    points = warp_peri.Points(x=x, interior=interior, spacing=SPACING)
    operator = warp_peri.LPSOperator(model, points)
    waves = generator.normal(size=(8, 2, 2))
    phase = np.einsum("swa,na->swn", waves, x)
    u = 0.01 * np.stack([np.sin(phase[:, 0]), np.cos(phase[:, 1])], axis=-1)
    b = np.zeros_like(u)
    b[:, interior] = assert_type(operator(u), np.ndarray)
    u += noise * generator.normal(size=u.shape)
    return warp_peri.Samples(points, u, b)


def learn(folder: Path) -> warp_peri.Fit:
    """Data of a known model to a learned one."""
    known = warp_peri.Model(
        lam=-0.2,
        mu=0.7,
        alpha=1.0,
        D=np.array([1.0, 0.6]),
        horizon=HORIZON,
        trained_on=(SPACING,),
        certified_on=(SPACING,),
    )
    sets = {"train": samples(known, 1), "test": samples(known, 2)}
    warp_peri.save_dataset(folder / "data.h5", warp_peri.Dataset(sets, THICKNESS, DENSITY))
    data = assert_type(warp_peri.load_dataset(folder / "data.h5"), warp_peri.Dataset)
    train = assert_type(data["train"], warp_peri.Samples)
    fit = warp_peri.fit(
        train,
        HORIZON,
        warp_peri.Bernstein(1),
        method=warp_peri.Constrained(warp_peri.TwoStage(epochs=9), warp_peri.Optimum(jobs=1)),
        conditions=warp_peri.Conditions(zeta=0.01),
    )
    assert_type(fit, warp_peri.Fit)
    assert_type(warp_peri.diagnose(fit.model, train), warp_peri.Diagnosis)
    fit.model.save(folder / "model.json")
    shape = warp_peri.InfluenceFunction(
        lambda r, length: np.exp(-r / length), {"length": 1.5}, {"length": (0.5, 9.0)}
    )
    by_shape = warp_peri.fit(train, horizon=HORIZON, kernel=shape)
    assert_type(by_shape.influence, warp_peri.InfluenceFunction | None)
    noise = warp_peri.Samples(
        train.points, 1e-4 * np.random.default_rng(3).normal(size=train.u.shape)
    )
    sure = assert_type(warp_peri.fit_uncertainty(fit, train, noise), warp_peri.Uncertainty)
    assert_type(sure.deviation(lambda model: model.mu), np.ndarray)
    trials = warp_peri.sweep(
        train, data["test"], folder / "sweep", horizons=[HORIZON], degrees=[0, 1], jobs=1
    )
    assert_type(assert_type(trials, warp_peri.Sweep).cheapest.degree, int)
    return fit


def use(model: warp_peri.Model, test: warp_peri.Samples) -> float:
    """Everything that is done with a model; E_u on a set."""
    certificate = assert_type(warp_peri.certify(model, spacing=SPACING), warp_peri.Certificate)
    assert_type(certificate.holds, bool)
    figures = assert_type(warp_peri.solvability(model, test), warp_peri.Solvability)
    assert_type(figures.symmetric_min, float)

    operator = warp_peri.LPSOperator(model, test)
    tensor = torch.tensor(test.u, requires_grad=True)
    force = assert_type(operator(tensor), torch.Tensor)
    torch.autograd.grad(force.sum(), tensor)

    exact = warp_peri.Iteration(tolerance=1e-10)
    u = assert_type(warp_peri.solve(model, test, test.b, test.u, iteration=exact), np.ndarray)
    fields = assert_type(stress.node_fields(model, test, u), NodeFields)
    assert_type(fields.stress, np.ndarray)
    mu = torch.tensor(model.mu, dtype=torch.float64, requires_grad=True)
    same = warp_peri.equilibrium(
        test,
        torch.tensor(test.loads),
        torch.tensor(test.u),
        warp_peri.Solid(model.lam, mu, model.alpha, model.D),
        horizon=model.horizon,
        method="lu",
    )
    torch.autograd.grad(assert_type(same, torch.Tensor).sum(), mu)
    sheet = np.random.default_rng(0).normal(size=(8, 8, 2))
    assert_type(warp_peri.solve_periodic(model, sheet, spacing=SPACING), np.ndarray)

    step = warp_peri.critical_time_step(model, spacing=SPACING, density=DENSITY)
    motion = warp_peri.velocity_verlet(
        model, test, u[0], np.zeros_like(u[0]), density=DENSITY, step=step / 2, steps=3
    )
    assert_type(assert_type(motion, warp_peri.Motion).drift, float)
    table = warp_peri.evaluate(model, test)
    return float(table["E_u"])


def nonlinear(train: warp_peri.Samples, folder: Path) -> None:
    """Three more numbers, and up to which strain solutions are unique."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a linear law made the data
        kernel = warp_peri.Bernstein(1, two_functions=True)
        fit = warp_peri.fit(train, HORIZON, kernel, nonlinear=warp_peri.Nonlinear())
    model = assert_type(assert_type(fit, warp_peri.NonlinearFit).model, warp_peri.NonlinearModel)
    assert_type(warp_peri.Smoothing(4.0).inverse(np.array([0.1])), np.ndarray)
    figures = assert_type(warp_peri.uniqueness(model, spacing=SPACING), warp_peri.Uniqueness)
    assert_type(figures.strain, float)
    model.save(folder / "nonlinear.json")
    model = warp_peri.load_nonlinear(folder / "nonlinear.json")
    assert_type(warp_peri.NonlinearOperator(model, train)(train.u), np.ndarray)
    records: list[warp_peri.NonlinearRecord] = []
    solved = warp_peri.solve_nonlinear(model, train, train.loads, train.u, records=records)
    assert_type(solved, np.ndarray)


def body(model: warp_peri.Model, path: Path) -> float:
    """A body from a mesh file; for type checkers, as it needs the extra `bodies` to run."""
    mesh = assert_type(warp_peri.load_mesh(path), warp_peri.Mesh)
    solution = warp_peri.solve_body(
        model,
        mesh,
        displacement={"left": (0.0, 0.0)},
        traction={"right": lambda x, normal: 0.005 * normal},
        coupling=warp_peri.Coupling(spacing=SPACING),
    )
    u, _ = assert_type(solution, warp_peri.BodySolution).on_corners()
    assert_type(u, np.ndarray)
    gradient = warp_peri.body_gradient(solution, solution.u_rim, solution.u_bulk)
    return assert_type(gradient, warp_peri.BodyGradient).along(traction={"right": (1.0, 0.0)})


def coarse(atoms: np.ndarray, nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Atoms to nodes."""
    omega = warp_peri.smoothing_matrix(atoms, nodes, radius=3.0)
    fields = np.zeros((1, len(atoms), 2))
    return warp_peri.coarse_grain(
        omega, displacement=fields, force=fields, node_area=SPACING**2, thickness=THICKNESS
    )


def main(folder: Path) -> None:
    warp_peri.set_threads(1)
    learn(folder)
    model = assert_type(warp_peri.load_model(folder / "model.json"), warp_peri.Model)
    data = warp_peri.load_dataset(folder / "data.h5")
    test = data["test"]
    nonlinear(data["train"], folder)
    print(use(model, test))
    fine = assert_type(warp_peri.on_lattice(model, spacing=SPACING / 2), warp_peri.Model)
    print(fine.transferred_from, warp_peri.model_for(model, test).horizon)
    print(warp_peri.one_kernel(model, horizon=3 * SPACING).certified_on)
    assert_type(warp_peri.onto_lattice(test, spacing=SPACING), warp_peri.Samples)
    x = SPACING * np.argwhere(np.ones((41, 41), bool)) - 20 * SPACING
    wide = warp_peri.Points(x, np.abs(x).max(axis=1) <= 3, SPACING)
    through = warp_peri.ThroughLattice(model, wide, spacing=SPACING)
    print(assert_type(through.figures().smallest_eigenvalue, float))
    coarse(test.x, test.x[test.interior])
    scene = warp_peri.Scene(size=(100.0, 100.0), shortest_wave=50.0)
    choice = assert_type(warp_peri.choose_model(tolerance=0.05, scene=scene), warp_peri.Choice)
    print(assert_type(choice.method, str))
    try:
        warp_peri.load_model(folder / "none.json")
    except warp_peri.InputError as error:
        print(error)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
