"""What a user writes, with types: every public name once, as in the README.

tests/package/test_types.py has mypy check this file as a user would, and runs it.
"""

import sys
import warnings
from pathlib import Path
from typing import assert_type

import ase
import numpy as np
import torch

import warp_peri
from warp_peri import methods, proofs, transfers
from warp_peri.atoms import LearnedCrystal
from warp_peri.contract import MaterialFit
from warp_peri.fe_coupling.body import BodyGradient, Coupling, body_gradient
from warp_peri.fitting.diagnose import Diagnosis
from warp_peri.fitting.result import Fit
from warp_peri.materials.third_order import ThirdOrderCrystal

SPACING, HORIZON, DENSITY, THICKNESS = 1.0, 2.5, 2200.0, 3.35


def samples(model: warp_peri.Model, seed: int, *, noise: float = 0.0) -> warp_peri.Samples:
    """Smooth displacements of a lattice and the loads that a model answers them with."""
    generator = np.random.default_rng(seed)
    line = SPACING * np.arange(-8, 9)
    x = np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1).reshape(-1, 2)
    interior = np.abs(x).max(axis=1) <= 3
    points = warp_peri.Points(x=x, interior=interior, spacing=SPACING)
    operator = model.on(points)
    waves = generator.normal(size=(8, 2, 2))
    phase = np.einsum("swa,na->swn", waves, x)
    u = 0.01 * np.stack([np.sin(phase[:, 0]), np.cos(phase[:, 1])], axis=-1)
    b = np.zeros_like(u)
    b[:, interior] = assert_type(operator(u), np.ndarray)
    u += noise * generator.normal(size=u.shape)
    return warp_peri.Samples(points, u, b)


def learn(folder: Path) -> Fit:
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
    warp_peri.save(folder / "data.h5", warp_peri.Dataset(sets, THICKNESS, DENSITY))
    data: warp_peri.Dataset = warp_peri.load(folder / "data.h5")
    train = assert_type(data["train"], warp_peri.Samples)
    fit = warp_peri.fit(
        train,
        warp_peri.LPS(
            HORIZON,
            warp_peri.Bernstein(1),
            method=methods.Constrained(seed=9, optimum=methods.Optimum()),
            conditions=methods.Conditions(zeta=0.01),
        ),
    )
    assert_type(fit, Fit)
    one = samples(known, 3)
    loads = np.zeros_like(one.u[0]) if one.b is None else one.b[0]
    one_load = warp_peri.Dirichlet(one, loads, one.u[0])
    family = warp_peri.prediction.Family(warp_peri.LPS(HORIZON, warp_peri.Bernstein(1)))
    members = warp_peri.fit(train, family, validation=data["test"]).material
    answer = warp_peri.predict(members, one_load)
    assert not isinstance(answer, tuple)
    assert answer.error < 0.1
    assert_type(warp_peri.diagnose(fit.material, train), Diagnosis)
    warp_peri.save(folder / "model.json", fit.material)
    shape = warp_peri.shapes.InfluenceFunction(
        lambda r, length: np.exp(-r / length), {"length": 1.5}, {"length": (0.5, 9.0)}
    )
    by_shape = warp_peri.fit(train, warp_peri.LPS(HORIZON, shape))
    assert_type(by_shape.influence, warp_peri.shapes.InfluenceFunction | None)
    law = warp_peri.LPS(HORIZON, warp_peri.Bernstein(1))
    sure = assert_type(methods.resample_loads(train, law), methods.Resampled)
    assert_type(sure.deviation(lambda model: model.mu), np.ndarray)
    trials = methods.sweep(
        train, data["test"], folder / "sweep", horizons=[HORIZON], degrees=[0, 1], jobs=1
    )
    assert_type(assert_type(trials, methods.Sweep).cheapest.degree, int)
    return fit


def use(model: warp_peri.Model, test: warp_peri.Samples) -> float:
    """Everything that is done with a model; E_u on a set."""
    certificate = assert_type(warp_peri.certify(model, spacing=SPACING), proofs.Certificate)
    assert_type(certificate.holds, bool)
    figures = assert_type(proofs.solvability(model, test), proofs.Solvability)
    assert_type(figures.symmetric_min, float)

    operator = model.on(test)
    tensor = torch.tensor(test.u, requires_grad=True)
    force = assert_type(operator(tensor), torch.Tensor)
    torch.autograd.grad(force.sum(), tensor)
    module = warp_peri.Module(model, test)
    assert_type(list(module.parameters()), list[torch.nn.Parameter])

    problem = warp_peri.Dirichlet(test, test.b, test.u)
    exact = warp_peri.Krylov(tolerance=1e-10)
    solution = assert_type(warp_peri.solve(model, problem, solver=exact), warp_peri.Solution)
    assert_type(solution.stress(), np.ndarray)
    assert_type(solution.residual, float)
    again = warp_peri.solve(operator, problem, solver=warp_peri.Direct())
    assert_type(again.proven, str | None)
    mu = torch.tensor(model.mu, dtype=torch.float64, requires_grad=True)
    solid = methods.Solid(model.lam, mu, model.alpha, model.D)
    same = warp_peri.solve(model, problem, solver=warp_peri.Direct(), parameters=solid)
    torch.autograd.grad(same.u.sum(), mu)
    sheet = warp_peri.Points.sheet((8, 8), SPACING)
    load = np.random.default_rng(0).normal(size=(64, 2))
    assert_type(warp_peri.solve(model, warp_peri.Periodic(sheet, load)), warp_peri.Solution)

    step = proofs.critical_time_step(model, spacing=SPACING, density=DENSITY)
    start = warp_peri.Dirichlet(test, None, solution.u[0])
    motion = warp_peri.move(operator, start, density=DENSITY, step=step / 2, steps=3)
    assert_type(assert_type(motion, warp_peri.Motion).drift, float)
    table = warp_peri.evaluate(model, test)
    return float(table["E_u"])


def crystal(train: warp_peri.Samples) -> None:
    """A tensor for every bond."""
    law = warp_peri.Micromodulus(HORIZON, "4mm", moduli=None)
    material = warp_peri.fit(train, law).material
    print(material.moduli("GPa"))


def sheared(E: torch.Tensor, mu: torch.Tensor) -> torch.Tensor:
    """An energy of one's own: of Green strains, by torch."""
    return mu * (E * E).sum((-1, -2))


def own(train: warp_peri.Samples) -> None:
    """Its parameter, learned from forces."""
    material = warp_peri.DensityMaterial.of(sheared, SPACING, {"mu": 0.7})
    fit = warp_peri.fit(train, warp_peri.Density(sheared, SPACING, material.parameters))
    print(fit.material.parameters)


def nonlinear(train: warp_peri.Samples, folder: Path) -> None:
    """Three more numbers, and up to which strain solutions are unique."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a linear law made the data
        law = warp_peri.ThirdOrder(warp_peri.Micromodulus(HORIZON), methods.Smoothing(4.0))
        fit = assert_type(warp_peri.fit(train, law), MaterialFit)
    model: ThirdOrderCrystal = fit.material
    assert_type(methods.Smoothing(4.0).inverse(np.array([0.1])), np.ndarray)
    figures = assert_type(proofs.uniqueness(model, spacing=SPACING), proofs.Uniqueness)
    assert_type(figures.strain, float)
    warp_peri.save(folder / "nonlinear.json", model)
    model = warp_peri.load(folder / "nonlinear.json")
    model.on(train)(train.u)
    problem = warp_peri.Dirichlet(train, train.loads, train.u)
    assert_type(warp_peri.solve(model, problem, solver=warp_peri.Newton()), warp_peri.Solution)


def body(model: warp_peri.Model, path: Path) -> float:
    """A body from a mesh file; for type checkers, as it needs the extra `bodies` to run."""
    mesh: warp_peri.Mesh = warp_peri.load(path)
    problem = warp_peri.Body(
        mesh,
        displacement={"left": (0.0, 0.0)},
        traction={"right": lambda x, normal: 0.005 * normal},
        coupling=Coupling(spacing=SPACING),
    )
    solved = warp_peri.solve(model, problem).details
    gradient = body_gradient(solved, solved.u_rim, solved.u_bulk)
    return assert_type(gradient, BodyGradient).along(traction={"right": (1.0, 0.0)})


def cracked(points: warp_peri.Points, u: np.ndarray) -> float:
    """A cut body at rest."""
    solid = warp_peri.Model(lam=0.3, mu=0.3, alpha=1.0, D=np.ones(1), horizon=HORIZON)
    problem = warp_peri.Cracked(points, u=u, cracks=[[(-1.0, 0.5), (1.0, 0.5)]])
    return assert_type(warp_peri.solve(solid, problem), warp_peri.Solution).residual


def coarse(atoms: np.ndarray, nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Atoms to nodes."""
    omega = warp_peri.atoms.smoothing_matrix(atoms, nodes, radius=3.0)
    fields = np.zeros((1, len(atoms), 2))
    return warp_peri.atoms.coarse_grain(
        omega, displacement=fields, force=fields, node_area=SPACING**2, thickness=THICKNESS
    )


def main(folder: Path) -> None:
    warp_peri.launch.set_threads(1)
    learn(folder)
    model: warp_peri.Model = warp_peri.load(folder / "model.json")
    data: warp_peri.Dataset = warp_peri.load(folder / "data.h5")
    test = data["test"]
    nonlinear(data["train"], folder)
    crystal(data["train"])
    own(data["train"])
    print(use(model, test))
    print(cracked(test.points, test.u[0]))
    fine = assert_type(transfers.on_lattice(model, spacing=SPACING / 2), warp_peri.Model)
    print(fine.transferred_from, model.on(test).model.horizon)
    assert_type(transfers.onto_lattice(test, spacing=SPACING), warp_peri.Samples)
    x = SPACING * np.argwhere(np.ones((41, 41), bool)) - 20 * SPACING
    wide = warp_peri.Points(x, np.abs(x).max(axis=1) <= 3, SPACING)
    print(model.on(wide).model.horizon)
    coarse(test.x, test.x[test.interior])
    try:
        warp_peri.load(folder / "none.json")
    except warp_peri.InputError as error:
        print(error)


def from_structure(atoms: ase.Atoms, calculator: object) -> None:
    """A crystal of someone's own; calculators have no types."""
    print(assert_type(warp_peri.from_atoms(atoms, calculator), LearnedCrystal))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
