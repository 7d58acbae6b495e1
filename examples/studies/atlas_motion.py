"""Stability atlas: explicit dynamics, waves against phonons, strains beyond the linear range."""

import warnings
from collections.abc import Sequence

import numpy as np
from tqdm import tqdm

import warp_peri as wp
from examples.figures import curves, name_lines, note, panels
from examples.studies.atlas_entry import Entry, entry, words
from tools.graphene import SHEET_CELLS, bond_length, sheet
from tools.lammps_session import CARBON_MASS, POTENTIAL, LammpsSession
from tools.loads import WaveLoad, atom_force
from tools.make_graphene import point_set
from tools.samples import Piece, Sample
from tools.statics import ColouredHessian, ConvergenceError, Statics, find_bonds
from warp_peri import Dataset, Dirichlet, Model, Points, move
from warp_peri.dynamics import verlet
from warp_peri.dynamics.verlet import INERTIA
from warp_peri.lps.model import lps_stencil
from warp_peri.proofs import critical_time_step
from warp_peri.structures.calculators import potential_file

DENSITY = 2147.0
"""Of graphene [kg/m³] where no data set gives one."""
PARTS = (0.95, 0.98, 0.99, 0.995, 1.005, 1.01, 1.02, 1.05)
"""Time steps that are tried, over the proven critical step."""
EV_PER_AMU = 9648.533212
"""1 eV/(Å² amu) in 1/ps²."""


def frequencies(model: Model, spacing: float, density: float, k: np.ndarray) -> np.ndarray:
    """Angular frequencies [1/ps] of both branches at wave vectors k [1/Å], shape [K, 2]."""
    D = lps_stencil(model, spacing).symbol(spacing * k)
    return np.sqrt(np.linalg.eigvalsh(D) / (INERTIA * density))


def box_of_the_stiffest(model: Model, spacing: float) -> tuple[Points, float]:
    """A periodic lattice that holds the stiffest wave, nearly, and its largest frequency · √ρ."""
    part = 48
    p, q = (index / part for index in np.tril_indices(part // 2 + 1))
    k = 2 * np.pi * np.stack([p, q], axis=1)[1:] / spacing
    omega = frequencies(model, spacing, 1.0, k)[:, 1]
    shape = []
    for fraction in k[omega.argmax()] * spacing / (2 * np.pi):
        period = next(n for n in range(1, 49) if abs(n * fraction - round(n * fraction)) < 1e-9)
        shape.append(period * (int(2 * model.horizon / spacing / period) + 1))
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
    growth: dict[str, list[float]] = {}
    sharpness, shapes = {}, []
    for number, (name, solid) in enumerate(models.items()):
        points, stiffest = box_of_the_stiffest(solid, spacing)
        critical = critical_time_step(solid, spacing=spacing, density=DENSITY)
        sharpness[name] = 2 * np.sqrt(DENSITY) / stiffest / critical - 1
        shapes.append(f"{name}: {'×'.join(f'{side / spacing:.0f}' for side in points.box or ())}")
        u = np.random.default_rng(number).normal(size=points.x.shape)
        growth[name] = [
            largest_growth(solid, points, u, part * critical)
            for part in tqdm(PARTS, desc=f"time step, {name}")
        ]
    rest = Dirichlet(points, None, 0 * points.x)
    refused = words(lambda: move(solid, rest, density=DENSITY, step=1.01 * critical, steps=1))
    numbers = {
        "sharpness": max(abs(value) for value in sharpness.values()), "shapes": ", ".join(shapes),
        "below": max(values[PARTS.index(0.99)] for values in growth.values()),
        "above": min(values[PARTS.index(1.01)] for values in growth.values()),
        "least_sharp": min(sharpness.values()), "most_sharp": max(sharpness.values()),
        "femtoseconds": 1000 * critical_time_step(model, spacing=spacing, density=DENSITY),
    }  # fmt: skip
    figure, ax = panels()
    axes = {"xlabel": "time step / proven critical step"}
    axes["ylabel"] = "displacement after 400 steps / at the start"
    curves(ax, "semilogy", PARTS, growth, "o-", **axes)
    ax.axvline(1, color="0.6", linewidth=0.8)
    values = {"part": PARTS, "growth": growth, "sharpness": sharpness}
    return entry("time-step", numbers, [refused], figure, values)


def largest_growth(model: Model, points: Points, u: np.ndarray, step: float) -> float:
    """How much a displacement grows in 400 steps, stable or not."""
    operator = model.on(points)
    body = verlet.Inert(operator, points.interior, DENSITY, 0 * u[points.interior])
    state = body.state(u, 0 * u[points.interior])
    for _ in range(400):
        state = verlet.step(body, state, step)
    return float(np.abs(state.u).max() / np.abs(u).max())


def energy_drift(model: Model, steps: int) -> Entry:
    """The energy that leapfrog keeps, over many steps."""
    spacing, side = 5.0, 10
    nodes = np.argwhere(np.ones((side, side)))
    box = (side * spacing, side * spacing)
    points = Points(spacing * nodes, np.ones(len(nodes), bool), spacing, box=box)
    u = np.random.default_rng(0).normal(size=points.x.shape)
    step = 0.9 * critical_time_step(model, spacing=spacing, density=DENSITY)
    how = {"density": DENSITY, "step": step}
    every = max(1, steps // 1000)
    motion = move(model, Dirichlet(points, None, u), **how, steps=steps, every=every)
    figure, ax = panels()
    ax.plot(motion.time / step, motion.energy / motion.energy[0] - 1, linewidth=0.8)
    ax.set(xlabel="step", ylabel="energy over that of the start, less 1")
    cloud = Points(points.x + 0.1 * u, points.interior, 0.0)
    numbers = {"drift": motion.drift, "steps": steps, "side": side}
    seen = (lambda: move(model, Dirichlet(cloud, None, u), **how, steps=1),)
    values = {"steps": steps, "drift": motion.drift}
    return entry("energy", numbers, seen, figure, values)


def phonons(k: np.ndarray) -> np.ndarray:
    """The two acoustic in-plane branches of the atoms at rest [1/ps], shape [K, 2], at k [1/Å]."""
    potential = potential_file(POTENTIAL)
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
    truth = data.provenance["truth"]
    lam, mu = truth["lambda"], truth["mu"]
    speeds = np.sqrt(np.array([mu, lam + 2 * mu]) / (INERTIA * data.density))
    branches: dict[str, dict[str, np.ndarray]] = {}
    for name, direction in {"zigzag": (1.0, 0.0), "armchair": (0.0, 1.0)}.items():
        k = size[:, None] * np.array(direction)
        learned = frequencies(model, spacing, data.density, k)
        branches[name] = {"k": size, "atoms": phonons(k), "model": learned}
    worst, elastic = {}, {}
    for part in (0.25, 0.5, 1.0):
        within = size <= part * edge * (1 + 1e-9)
        off = [np.abs(b["model"] / b["atoms"] - 1)[within].max() for b in branches.values()]
        worst[part] = float(max(off))
        last = int(50 * part) - 1
        off = [np.abs(speeds * part * edge / b["atoms"][last] - 1).max() for b in branches.values()]
        elastic[part] = float(max(off))
    unstable = Model(model.lam, model.mu, model.alpha, np.array([-1.0, 1.0]), model.horizon)
    numbers = {
        "quarter": worst[0.25], "half": worst[0.5], "whole": worst[1.0], "edge": edge,
        "elastic_half": elastic[0.5], "elastic_whole": elastic[1.0],
        "reach": float(data["train"].arrays["wave_number"].max() / np.sqrt(2)),
    }  # fmt: skip
    figure, ax = panels(7, 4.2)
    branch = branches["zigzag"]  # armchair is the same to the eye
    for number, label in enumerate(("transverse", "longitudinal")):
        colour = f"C{number}"
        ax.plot(size, branch["atoms"][:, number], color=colour)
        ax.plot(size, branch["model"][:, number], "--", color=colour)
        ax.plot(size, speeds[number] * size, ":", color=colour, linewidth=0.8)
        at = (0.45 * edge, branch["atoms"][int(0.45 * len(size)), number])
        shift = ((-12, 12), (12, -14))[1 - number]
        note(ax, label, at, shift, colour, ha="right" if number else "left")
    for style, label in {"-": "atoms", "--": "model", ":": "local elasticity"}.items():
        ax.plot([], [], style, color="0.3", label=label)
    ax.axvline(edge / 2, color="0.7", linewidth=0.8)
    note(ax, "wavelength of four spacings", (edge / 2, 0))
    ax.set(xlabel="wave number [1/Å]", ylabel="angular frequency [1/ps]")
    ax.legend(frameon=False)
    refused = (lambda: critical_time_step(unstable, spacing=spacing, density=DENSITY),)
    values = {"branches": branches, "worst": worst}
    return entry("dispersion", numbers, refused, figure, values)


def strained_samples(
    load: WaveLoad, strains: Sequence[float], body: Piece, statics: Statics
) -> tuple[list[Sample], str]:
    """Equilibria of one load at rising bond strains; ends at the first that is not found."""
    shape = load.shape(statics.reference, body.box)
    unit = atom_force(shape, 3 * np.sqrt(3) / 4 * body.bond**2, 3.35)
    linear = statics.linear_response(unit)
    scale = 1e-6 / np.abs(linear).max()
    per_strain = scale / statics.max_bond_strain(scale * linear)
    samples: list[Sample] = []
    guess, before = linear, 0.0
    for strain in strains:
        amplitude = strain * per_strain
        start = amplitude * linear if before == 0 else guess * (amplitude / before)
        try:
            rest = statics.equilibrium(amplitude * unit, name=load.load_id, guess=start)
        except ConvergenceError as error:
            return samples, str(error)
        guess, before = rest.displacement, amplitude
        reached = statics.max_bond_strain(guess)
        samples.append(
            Sample(statics.reference, guess, rest.force, amplitude, reached, rest.residual)
        )
    return samples, ""


def large_strains(model: Model) -> Entry:
    """Error of the linear model against the amplitude of the load."""
    potential = potential_file(POTENTIAL)
    body = Piece(bond_length(potential), str(potential), cells=SHEET_CELLS)
    positions = body.positions()
    aimed = (0.001, 0.003, 0.01, 0.02, 0.03, 0.05, 0.07, 0.1)
    table: dict[str, dict[str, list[float]]] = {}
    ends = []
    with LammpsSession(positions, box=body.box, potential=potential) as session:
        statics = Statics(positions, box=body.box, session=session)
        for load in (WaveLoad(0, (1, 0)), WaveLoad(0, (0, 1)), WaveLoad(1, (2, 3))):
            bar = tqdm(aimed, desc=f"strains, {load.load_id}")
            samples, end = strained_samples(load, bar, body, statics)
            last = point_set(body, [load] * len(samples), samples, spacing=5.0)
            with warnings.catch_warnings(action="ignore"):
                errors = wp.evaluate(model, last)["E_u_samples"]
            strain = [sample.max_bond_strain for sample in samples]
            table[load.load_id] = {"strain": strain, "E_u": errors}
            ends += [end] if end else []
    steep = max(table, key=lambda name: table[name]["E_u"][-1] / table[name]["E_u"][0])
    percent = {name: 100 * np.array(values) for name, values in table[steep].items()}
    lost = f" Beyond that no equilibrium was found for {len(ends)} of the loads."
    numbers = {
        "load": steep, "first": percent["E_u"][0], "training": percent["E_u"][3],
        "last": percent["E_u"][-1], "training_strain": percent["strain"][3],
        "last_strain": percent["strain"][-1],
        "reach": 100 * max(max(row["strain"]) for row in table.values()),
        "low": 100 * max(row["E_u"][0] for row in table.values()),
        "high": 100 * max(row["E_u"][-1] for row in table.values()), "lost": lost if ends else "",
    }  # fmt: skip
    figure, ax = panels()
    for name, row in table.items():
        label = f"load along {name.replace('k=', 'of wave ')}"
        ax.loglog(100 * np.array(row["strain"]), 100 * np.array(row["E_u"]), "o-", label=label)
    ax.axvline(2, color="0.6", linewidth=0.8)
    ax.set(xlabel="largest bond strain [%] (line: training)", ylabel="error of displacement [%]")
    name_lines(ax)
    seen = (lambda: wp.solve(model, Dirichlet(last, last.loads, last.u)).u,)
    return entry("strain", numbers, seen, figure, {"loads": table, "ends": ends})
