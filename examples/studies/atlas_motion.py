"""Stability atlas: explicit dynamics, waves against phonons, and strains beyond the linear range."""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import matplotlib.pyplot as plt
import numpy as np
from tqdm import tqdm

import warp_peri
from examples.studies.atlas_entry import Entry, words
from tools.graphene import SHEET_CELLS, bond_length, sheet
from tools.hessian import ColouredHessian
from tools.lammps_session import CARBON_MASS, LammpsSession, potential_file
from tools.loads import WaveLoad, atom_force
from tools.make_graphene import point_set
from tools.samples import Body, Sample
from tools.statics import ConvergenceError, Statics, find_bonds
from warp_peri.dynamics.verlet import INERTIA, critical_time_step, velocity_verlet
from warp_peri.models.lps import Model
from warp_peri.operator.symbol import stiffnesses, symbol
from warp_peri.points.dataset import Dataset
from warp_peri.points.families import bond_classes
from warp_peri.points.points import Points
from warp_peri.points.samples import Samples

DENSITY = 2147.0
"""Of graphene [kg/m³] where no data set gives one."""
EV_PER_AMU = 9648.533212
"""1 eV/(Å² amu) in 1/ps²."""


def frequencies(model: Model, spacing: float, density: float, k: np.ndarray) -> np.ndarray:
    """Angular frequencies [1/ps] of both branches at wave vectors k [1/Å], shape [K, 2]."""
    classes = bond_classes(spacing, model.horizon)
    d11, d22, d12 = symbol(classes, k).entries(*stiffnesses(model, classes))
    D = np.stack([d11, d12, d12, d22], axis=-1).reshape(-1, 2, 2)
    return np.sqrt(np.linalg.eigvalsh(D) / (INERTIA * density))


def box_of_the_stiffest(model: Model, spacing: float) -> tuple[Points, float]:
    """A periodic lattice that holds the stiffest wave, nearly, and its largest frequency · √ρ."""
    part = 48
    p, q = (index / part for index in np.tril_indices(part // 2 + 1))
    k = 2 * np.pi * np.stack([p, q], axis=1)[1:] / spacing
    omega = frequencies(model, spacing, 1.0, k)[:, 1]
    shape = []
    for fraction in k[omega.argmax()] * spacing / (2 * np.pi):
        size = next(n for n in range(1, part + 1) if abs(n * fraction - round(n * fraction)) < 1e-9)
        while size <= 2 * model.horizon / spacing:
            size += next(
                n for n in range(1, part + 1) if abs(n * fraction - round(n * fraction)) < 1e-9
            )
        shape.append(size)
    steps = np.argwhere(np.ones(shape))
    box = (spacing * shape[0], spacing * shape[1])
    points = Points(spacing * steps, np.ones(len(steps), bool), spacing, box=box)
    return points, float(omega.max())


def critical_step(model: Model) -> Entry:
    """Growth over 400 steps on either side of the proven critical step."""
    spacing = 5.0
    models = {
        "learned": model,
        "1/r, δ = 3h": Model(-0.2, 0.72, 1.0, np.ones(1), 15.0, certified_on=(spacing,)),
        "r^(−2.9), δ = 2h": Model(-0.2, 0.72, 2.9, np.ones(1), 10.0, certified_on=(spacing,)),
    }
    parts = np.array([0.95, 0.98, 0.99, 0.995, 1.005, 1.01, 1.02, 1.05])
    growth: dict[str, list[float]] = {}
    sharpness = {}
    shapes = {}
    figure, ax = plt.subplots(figsize=(6.4, 4.2), layout="constrained")
    refused = ""
    for number, (name, one) in enumerate(models.items()):
        points, stiffest = box_of_the_stiffest(one, spacing)
        critical = critical_time_step(one, spacing=spacing, density=DENSITY)
        sharpness[name] = 2 * np.sqrt(DENSITY) / stiffest / critical - 1
        shapes[name] = "×".join(f"{side / spacing:.0f}" for side in points.box or ())
        u = np.random.default_rng(number).normal(size=points.x.shape)
        growth[name] = []
        for part in tqdm(parts, desc=f"time step, {name}"):
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                found = velocity_verlet(
                    one, points, u, 0 * u, density=DENSITY, step=part * critical, steps=400,
                    allow_unstable=True,
                )  # fmt: skip
            growth[name].append(float(np.abs(found.u).max() / np.abs(u).max()))
        ax.semilogy(parts, growth[name], "o-", label=name)
        rest = 0 * points.x

        def too_long(one=one, points=points, rest=rest, step=1.01 * critical) -> None:
            velocity_verlet(one, points, rest, rest, density=DENSITY, step=step, steps=1)

        refused = words(too_long)
    ax.axvline(1, color="0.6", linewidth=0.8)
    ax.set_xlabel("time step / proven critical step")
    ax.set_ylabel("largest |u| after 400 steps / at the start")
    ax.legend(frameon=False)
    below = max(values[list(parts).index(0.99)] for values in growth.values())
    above = min(values[list(parts).index(1.01)] for values in growth.values())
    text = f"""Velocity Verlet of $\\rho\\ddot u = b - L u$ is stable up to 2/ω of the stiffest wave. The maximum of the
symbol is proven over the whole zone (50–51), not sampled. On periodic boxes that hold the stiffest wave
({", ".join(f"{name}: {shape}" for name, shape in shapes.items())} nodes) random displacements grow at most {below:.2g}-fold in 400 steps at
0.99 of the proven step, and at least {above:.0e}-fold at 1.01. The proven step is shorter than the box's own by
{min(sharpness.values()):.2%} to {max(sharpness.values()):.2%}. For the learned model at 5 Å it is
{1000 * critical_time_step(model, spacing=spacing, density=DENSITY):.1f} fs."""
    return Entry(
        "Explicit dynamics: the critical time step",
        f"right to {max(abs(value) for value in sharpness.values()):.2%}: stable at 0.99, "
        f"grown {above:.0e}-fold after 400 steps at 1.01",
        text,
        [refused],
        figure,
        {"part": parts, "growth": growth, "sharpness": sharpness},
    )


def energy_drift(model: Model, steps: int) -> Entry:
    """The energy that leapfrog keeps, over many steps."""
    spacing, side = 5.0, 10
    at = np.argwhere(np.ones((side, side)))
    box = (side * spacing, side * spacing)
    points = Points(spacing * at, np.ones(len(at), bool), spacing, box=box)
    u = np.random.default_rng(0).normal(size=points.x.shape)
    step = 0.9 * critical_time_step(model, spacing=spacing, density=DENSITY)
    found = velocity_verlet(
        model, points, u, 0 * u, density=DENSITY, step=step, steps=steps,
        every=max(1, steps // 1000),
    )  # fmt: skip
    figure, ax = plt.subplots(figsize=(6.4, 4.2), layout="constrained")
    ax.plot(found.time / step, found.energy / found.energy[0] - 1, linewidth=0.8)
    ax.set_xlabel("step")
    ax.set_ylabel("E(n + ½)/E(½) − 1")
    text = f"""With full lattice families $L$ is symmetric, and (52) is a constant of the discrete motion, not only in the
limit of small steps. Random displacements of the learned model on {side} × {side} periodic nodes at 0.9 of the critical
step keep it to {found.drift:.1e}, relative, over {steps} steps: rounding. On scattered points $L$ is not symmetric and
the run is refused."""
    cloud = Points(points.x + 0.1 * u, points.interior, 0.0)
    return Entry(
        "Explicit dynamics: the energy that leapfrog keeps",
        f"drift {found.drift:.1e} relative over {steps} steps",
        text,
        [words(lambda: velocity_verlet(model, cloud, u, u, density=DENSITY, step=step, steps=1))],
        figure,
        {"steps": steps, "drift": found.drift},
    )


def phonons(k: np.ndarray) -> np.ndarray:
    """The two acoustic in-plane branches of the atoms at rest [1/ps], shape [K, 2], at k [1/Å]."""
    potential = potential_file()
    bond = bond_length(potential)
    positions, box = sheet(bond, cells=(8, 5))
    bonds = find_bonds(positions, box)
    with LammpsSession(positions, box=box, potential=potential) as session:
        hessian = ColouredHessian(bonds, len(positions))(session.forces, positions).toarray()
    i, j = np.concatenate([bonds, bonds[:, ::-1]]).T
    arm = positions[j] - positions[i]
    arm -= box * np.rint(np.divide(arm, box))
    upward = np.zeros(len(positions), bool)
    upward[i[arm[:, 1] > 0.9 * bond]] = True  # one sublattice has its lone bond upwards
    first = [int(np.flatnonzero(upward)[0]), int(np.flatnonzero(~upward)[0])]
    out = []
    for wave in k:
        D = np.zeros((4, 4), complex)
        for s, atom in enumerate(first):
            away = positions - positions[atom]
            away -= box * np.rint(np.divide(away, box))
            phase = np.exp(1j * away @ wave)
            for t, part in enumerate((upward, ~upward)):
                block = hessian[2 * atom : 2 * atom + 2].reshape(2, -1, 2)[:, part]
                D[2 * s : 2 * s + 2, 2 * t : 2 * t + 2] = np.einsum("anb,n->ab", block, phase[part])
        squares = np.linalg.eigvalsh((D + D.conj().T) / 2)[:2]
        out.append(np.sqrt(np.maximum(squares, 0) * EV_PER_AMU / CARBON_MASS))
    return np.array(out)


def dispersion(model: Model, data: Dataset) -> Entry:
    """Waves of the learned model against the lattice's own acoustic branches."""
    spacing = 5.0
    edge = np.pi / spacing
    size = edge * np.linspace(0.02, 1.0, 50)
    figure, axes = plt.subplots(1, 2, figsize=(10.5, 4), layout="constrained")
    table: dict[str, dict[str, np.ndarray]] = {}
    truth = data.provenance["truth"]
    lam, mu = truth["lambda"], truth["mu"]
    speeds = np.sqrt(np.array([mu, lam + 2 * mu]) / (INERTIA * data.density))
    worst: dict[float, float] = {}
    for ax, (name, direction) in zip(axes, {"zigzag": (1.0, 0.0), "armchair": (0.0, 1.0)}.items()):
        k = size[:, None] * np.array(direction)
        atoms, learned = phonons(k), frequencies(model, spacing, data.density, k)
        table[name] = {"k": size, "atoms": atoms, "model": learned}
        for branch, label in enumerate(("transverse", "longitudinal")):
            colour = f"C{branch}"
            ax.plot(size, atoms[:, branch], color=colour, label=f"{label}, atoms")
            ax.plot(size, learned[:, branch], "--", color=colour, label=f"{label}, model")
            ax.plot(size, speeds[branch] * size, ":", color=colour, linewidth=0.8)
        for part in (0.25, 0.5, 1.0):
            here = size <= part * edge * (1 + 1e-9)
            error = float(np.abs(learned / atoms - 1)[here].max())
            worst[part] = max(worst.get(part, 0.0), error)
        ax.set_xlabel("|k| [1/Å], up to π/h of the 5 Å nodes")
        ax.set_ylabel("ω [1/ps]")
        ax.set_title(f"along {name} (dotted: elasticity)")
    axes[0].legend(frameon=False, fontsize="small")
    limit = {
        part: max(
            float(np.abs(speeds * part * edge / one["atoms"][int(50 * part) - 1] - 1).max())
            for one in table.values()
        )
        for part in (0.5, 1.0)
    }
    reach = float(data["train"].arrays["wave_number"].max() / np.sqrt(2))
    text = f"""The learned model moves as $\\rho\\omega^2$ = eigenvalues of $D(k)$, with the data's density and nothing fitted to
motion. Against the in-plane acoustic branches of the atoms (dynamical matrix from LAMMPS forces, along zigzag
and armchair) ω is within {worst[0.25]:.1%} up to a quarter of the nodes' zone, {worst[0.5]:.1%} up to a half, and {worst[1.0]:.1%} up to its
edge at π/h = {edge:.2f} 1/Å. Elasticity with the true constants is {limit[0.5]:.1%} and {limit[1.0]:.1%} off at a half and at the edge.
The training loads reach |k| = {reach:.2f} 1/Å along each axis; beyond, nothing holds the model but the condition
that it be stable, and ω leaves the atoms' on both sides. Plain elasticity is the better guess there."""
    bare = Model(model.lam, model.mu, model.alpha, model.D, model.horizon)
    return Entry(
        "Waves of the learned model against phonons",
        f"ω within {worst[0.5]:.1%} of the atoms' up to half the zone of 5 Å nodes, {worst[1.0]:.0%} up to its edge",
        text,
        [words(lambda: critical_time_step(bare, spacing=spacing, density=DENSITY))],
        figure,
        {"branches": table, "worst": worst},
    )


def strained_samples(
    load: WaveLoad, strains: Sequence[float], body: Body, statics: Statics
) -> tuple[list[Sample], str]:
    """Equilibria of one load at rising bond strains; ends at the first that is not found."""
    unit = atom_force(
        load.shape(statics.reference, body.box), 3 * np.sqrt(3) / 4 * body.bond**2, 3.35
    )
    linear = statics.linear_response(unit)
    scale = 1e-6 / np.abs(linear).max()
    per_strain = scale / statics.max_bond_strain(scale * linear)
    samples, guess, before, end = [], linear, 0.0, ""
    for strain in strains:
        amplitude = strain * per_strain
        start = amplitude * linear if before == 0 else guess * (amplitude / before)
        try:
            rest = statics.equilibrium(amplitude * unit, name=load.load_id, guess=start)
        except ConvergenceError as error:
            end = str(error)
            break
        reached = statics.max_bond_strain(rest.displacement)
        samples.append(
            Sample(
                statics.reference,
                rest.displacement,
                rest.force,
                amplitude,
                reached,
                rest.residual,
            )
        )
        guess, before = rest.displacement, amplitude
    return samples, end


def large_strains(model: Model) -> Entry:
    """Error of the linear model against the amplitude of the load."""
    potential = potential_file()
    body = Body(bond_length(potential), str(potential), cells=SHEET_CELLS)
    positions = body.positions()
    session = LammpsSession(positions, box=body.box, potential=potential)
    statics = Statics(positions, box=body.box, session=session)
    aimed = (0.001, 0.003, 0.01, 0.02, 0.03, 0.05, 0.07, 0.1)
    figure, ax = plt.subplots(figsize=(6.4, 4.2), layout="constrained")
    table: dict[str, dict[str, list[float]]] = {}
    last: Samples | None = None
    ends = []
    for load in (WaveLoad(0, (1, 0)), WaveLoad(0, (0, 1)), WaveLoad(1, (2, 3))):
        samples, end = strained_samples(
            load, tqdm(aimed, desc=f"strains, {load.load_id}"), body, statics
        )
        points = point_set(body, [load] * len(samples), samples, spacing=5.0)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            errors = warp_peri.evaluate(model, points)["E_u_samples"]
        strain = [sample.max_bond_strain for sample in samples]
        table[load.load_id] = {"strain": strain, "E_u": errors}
        ax.loglog(100 * np.array(strain), 100 * np.array(errors), "o-", label=load.load_id)
        last = points
        if end:
            ends.append(end)
    session.close()
    assert last is not None
    points = last
    ax.axvline(2, color="0.6", linewidth=0.8)
    ax.set_xlabel("largest bond strain [%] (line: training)")
    ax.set_ylabel("E_u [%]")
    ax.legend(frameon=False)
    ratio = {name: one["E_u"][-1] / one["E_u"][0] for name, one in table.items()}
    low = max(one["E_u"][0] for one in table.values())
    high = max(one["E_u"][-1] for one in table.values())
    steep = max(ratio, key=lambda name: ratio[name])
    one = table[steep]
    reach = max(max(one["strain"]) for one in table.values())
    lost = f" Beyond that no equilibrium was found for {len(ends)} of the loads." if ends else ""
    text = f"""Atoms stiffen and soften with strain; the model is linear. Three wave loads on the sheet, amplitude raised
until the largest bond strain is {100 * reach:.2g} %: E_u is at most {100 * low:.2g} % at 0.1 % strain and up to {100 * high:.3g} % at the
end. The load {steep} goes from {100 * one["E_u"][0]:.2g} % to {100 * one["E_u"][3]:.2g} % at {100 * one["strain"][3]:.2g} %, the
training strain, and {100 * one["E_u"][-1]:.3g} % at {100 * one["strain"][-1]:.2g} %.{lost} A model trained by `fit` knows the strain of its
data; `solve` and `evaluate` warn at twice that."""
    return Entry(
        "Strains beyond the linear range",
        f"E_u from {100 * one['E_u'][0]:.2g} % at 0.1 % strain to {100 * one['E_u'][-1]:.3g} % at "
        f"{100 * one['strain'][-1]:.2g} % ({steep})",
        text,
        [words(lambda: warp_peri.solve(model, points, points.loads, points.u))],
        figure,
        {"loads": table, "ends": ends},
    )
