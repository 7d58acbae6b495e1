"""What a user writes, with types: every public name once, as in the README.

`make lint` has mypy check this file as a user would; tests/package/test_jobs.py runs it.
"""

import sys
import warnings
from pathlib import Path
from typing import assert_type

import ase
import numpy as np
import torch

import warp_peri
from warp_peri import certificates, methods, transfers
from warp_peri.atoms import CrystalFit
from warp_peri.fe_coupling.body import BodyGradient, Coupling, body_gradient
from warp_peri.fitting.diagnose import Diagnosis
from warp_peri.fitting.settings import Fit
from warp_peri.materials.third_order import ThirdOrderMaterial

HORIZON = 2.5


def samples(model: warp_peri.LPSMaterial, seed: int) -> warp_peri.Samples:
    """Smooth displacements of a lattice and the loads that a model answers them with."""
    x = np.argwhere(np.ones((17, 17))) - 8.0
    points = warp_peri.Points(x=x, interior=np.abs(x).max(axis=1) <= 3, spacing=1.0)
    phase = np.einsum("swa,na->swn", np.random.default_rng(seed).normal(size=(8, 2, 2)), x)
    u = 0.01 * np.stack([np.sin(phase[:, 0]), np.cos(phase[:, 1])], axis=-1)
    b = np.zeros_like(u)
    b[:, points.interior] = assert_type(model.on(points)(u), np.ndarray)
    return warp_peri.Samples(points, u, b)


def learn(folder: Path) -> Fit:
    """Data of a known model to a learned one, by several ways."""
    known = warp_peri.LPSMaterial(
        lam=-0.2, mu=0.7, alpha=1.0, D=np.array([1.0, 0.6]), horizon=HORIZON, certified_on=(1.0,)
    )
    sets = {"train": samples(known, 1), "test": samples(known, 2)}
    warp_peri.save(folder / "data.h5", warp_peri.Dataset(sets, thickness=3.35, density=2200.0))
    data: warp_peri.Dataset = warp_peri.load(folder / "data.h5")
    train = assert_type(data["train"], warp_peri.Samples)
    law = warp_peri.LPS(
        HORIZON, warp_peri.Bernstein(1), conditions=methods.StabilityConditions(zeta=0.01)
    )
    fit = assert_type(warp_peri.fit(train, law), Fit)
    warp_peri.save(folder / "model.json", fit.material)
    assert_type(warp_peri.diagnose(fit.material, train), Diagnosis)
    shape = warp_peri.influence.InfluenceFunction(
        lambda r, length: np.exp(-r / length), {"length": 1.5}, {"length": (0.5, 9.0)}
    )
    by_shape = warp_peri.fit(train, warp_peri.LPS(HORIZON, shape))
    assert_type(by_shape.influence, warp_peri.influence.InfluenceFunction | None)
    family = warp_peri.prediction.Ensemble(warp_peri.LPS(HORIZON, warp_peri.Bernstein(1)))
    members = warp_peri.fit(train, family, validation=data["test"]).material
    answer = warp_peri.predict(members, warp_peri.Dirichlet(train, train.loads[0], train.u[0]))
    assert not isinstance(answer, tuple)
    assert answer.error < 0.1
    print(warp_peri.fit(train, warp_peri.Crystal(HORIZON, "4mm")).material.moduli("GPa"))
    return fit


def use(model: warp_peri.LPSMaterial, test: warp_peri.Samples) -> float:
    """Everything that is done with a model; E_u on a set."""
    certificate = assert_type(warp_peri.certify(model, spacing=1.0), certificates.Certificate)
    assert_type(certificate.holds, bool)
    operator, tensor = model.on(test), torch.tensor(test.u, requires_grad=True)
    torch.autograd.grad(assert_type(operator(tensor), torch.Tensor).sum(), tensor)
    assert_type([*warp_peri.TorchModule(model, test).parameters()], list[torch.nn.Parameter])
    problem, exact = warp_peri.Dirichlet(test, test.b, test.u), warp_peri.CG(tolerance=1e-10)
    solution = assert_type(warp_peri.solve(model, problem, solver=exact), warp_peri.Solution)
    assert_type((solution.stress(), solution.residual), tuple[np.ndarray, float])
    mu = torch.tensor(model.mu, dtype=torch.float64, requires_grad=True)
    same = warp_peri.solve(model, problem, solver=warp_peri.Direct(), parameters={"mu": mu})
    torch.autograd.grad(same.u.sum(), mu)
    sheet, load = warp_peri.Points.sheet((8, 8), 1.0), test.u[0, :64] - test.u[0, :64].mean(axis=0)
    assert_type(warp_peri.solve(model, warp_peri.Periodic(sheet, load)), warp_peri.Solution)
    step = certificates.critical_time_step(model, spacing=1.0, density=2200.0) / 2
    start = warp_peri.Dirichlet(test, None, solution.u[0])
    motion = warp_peri.simulate(operator, start, density=2200.0, step=step, steps=3)
    assert_type(assert_type(motion, warp_peri.Motion).drift, float)
    assert_type(transfers.on_lattice(model, spacing=0.5), warp_peri.LPSMaterial)
    positive = warp_peri.LPSMaterial(lam=0.3, mu=0.3, alpha=1.0, D=np.ones(1), horizon=HORIZON)
    cut = warp_peri.Cracked(test.points, u=test.u[0], cracks=[[(-1.0, 0.5), (1.0, 0.5)]])
    assert_type(warp_peri.solve(positive, cut).residual, float)
    return float(warp_peri.evaluate(model, test)["E_u"])


def sheared(E: torch.Tensor, mu: torch.Tensor) -> torch.Tensor:
    """An energy of one's own: of Green strains, by torch."""
    return mu * (E * E).sum((-1, -2))


def nonlinear(train: warp_peri.Samples) -> None:
    """An energy of one's own, three more numbers, and up to which strain solutions are unique."""
    own = warp_peri.DensityMaterial.of(sheared, 1.0, {"mu": 0.7})
    warp_peri.fit(train, warp_peri.Density(sheared, 1.0, own.parameters))
    law = warp_peri.ThirdOrder(warp_peri.Crystal(HORIZON), methods.Smoothing(4.0))
    model: ThirdOrderMaterial = assert_type(warp_peri.fit(train, law), Fit).material
    assert_type(certificates.prove_uniqueness(model, spacing=1.0), certificates.Uniqueness)
    problem = warp_peri.Dirichlet(train, train.loads, train.u)
    assert_type(warp_peri.solve(model, problem, solver=warp_peri.Newton()), warp_peri.Solution)


def body(model: warp_peri.LPSMaterial, path: Path) -> float:
    """A body from a mesh file; for type checkers, as it needs the extra `bodies` to run."""
    mesh: warp_peri.Mesh = warp_peri.load(path)
    problem = warp_peri.Body(
        mesh,
        displacement={"left": (0.0, 0.0)},
        traction={"right": lambda x, normal: 0.005 * normal},
        coupling=Coupling(spacing=1.0),
    )
    solved = warp_peri.solve(model, problem).details
    gradient = body_gradient(solved, [[1.0, 0.0]], [[1.0, 0.0]])
    return assert_type(gradient, BodyGradient).along(traction={"right": (1.0, 0.0)})


def from_structure(atoms: ase.Atoms, calculator: object) -> None:
    """A crystal of someone's own; calculators have no types."""
    print(assert_type(warp_peri.fit_crystal(atoms, calculator), CrystalFit))


def main(folder: Path) -> None:
    warp_peri.runtime.set_num_threads(1)
    learn(folder)
    data: warp_peri.Dataset = warp_peri.load(folder / "data.h5")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a linear law made the data
        nonlinear(data["train"])
    assert use(warp_peri.load(folder / "model.json"), data["test"]) < 1e-6
    try:
        warp_peri.load(folder / "none.json")
    except warp_peri.InputError as error:
        print(error)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
