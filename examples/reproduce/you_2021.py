"""You et al. (2021), computed: every table of the page on the paper, printed as Markdown.

    python examples/reproduce/you_2021.py table_3 table_4      (default: every table)

Takes data/graphene_0K.h5, made by `make graphene`. Tables of known kernels take minutes, a run of
Algorithm 1 four minutes of a core, the tables at 300 K an hour of LAMMPS, whose runs are kept in
data/. docs/record/you_2021.json has what came out.
"""

import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

import numpy as np
import scipy.sparse as sp
import torch
from scipy.optimize import least_squares

import warp_peri as wp
from examples.exact import continuum_symbol
from examples.prose import Table, print_tables, printed
from tools import thermal
from tools.cache import read_record
from tools.graphene import bond_length
from tools.lammps_session import LammpsSession
from tools.loads import TEST, TRAINING, VALIDATION
from tools.make_graphene import graphene_bodies, on_nodes, solve_all
from tools.make_thermal import data_set, make_thermal, run_all
from tools.statics import ColouredHessian, find_bonds, settled
from tools.thermal import Bath, Plan, Task, ThermalRun
from warp_peri import Bernstein, Dataset, Points, Samples
from warp_peri.errors import exit_status
from warp_peri.files.atomic import read_arrays
from warp_peri.fitting.regression import sample_weights
from warp_peri.materials.lps import bernstein_basis
from warp_peri.materials.lps_law import Products
from warp_peri.materials.lps_stages import class_weights
from warp_peri.methods import GaussNewton, SweepResult, TwoStage
from warp_peri.points.families import BondClasses
from warp_peri.points.points import grid_points, nearest

PRINTED_TABLE_3 = {
    0: (12.5, 13.91, 17.54, 16.31, 14.49, 1.0),
    5: (12.5, 10.42, 12.19, 13.02, 7.69, 0.6933),
    10: (20.0, 9.81, 11.72, 13.28, 7.16, 0.6704),
    15: (22.5, 9.80, 11.61, 13.50, 7.22, 0.6731),
    20: (25.0, 9.75, 11.89, 13.53, 7.00, 0.6729),
}
"""δ* [Å], E_res train, E_u train, E_res val, E_u val [%], AvgE by degree, as printed (0 K)."""
DATA = ROOT / "data" / "graphene_0K.h5"
CACHE, SWEEPS = DATA.with_suffix(".cache"), ROOT / "runs"
SETS = ("train", "val", "test")
FREE = GaussNewton(moduli=None)
ERRORS = ("E_res train", "E_u train", "E_res val", "E_u val")
ALL_ERRORS = ("E_res train", "E_res val", "E_u train", "E_u val", "E_u test")
COLUMNS = ["E_res train", "E_res val", "E_u train", "E_u val", "E_u disks"]
TABLE_3_AT_300 = {
    0: (12.5, 13.46, 31.33, 20.15, 14.86, 1.0),
    5: (12.5, 10.50, 13.80, 17.83, 9.66, 0.6784),
    10: (20.0, 9.79, 13.32, 18.11, 9.08, 0.6549),
    15: (20.0, 9.82, 13.16, 18.08, 8.88, 0.6505),
    20: (25.0, 9.81, 13.36, 18.34, 9.23, 0.6609),
}


@cache
def data() -> Dataset:
    """Graphene at 0 K."""
    read: Dataset = wp.load(DATA)
    return read


def fitted(
    samples: Samples | Sequence[Samples], horizon: float, degree: int, method: Any = FREE
) -> Any:
    """A fit as the paper's: its residual loss, free moduli."""
    law = wp.LPS(horizon, Bernstein(degree), method)
    return wp.fit(samples, law, progress=False)


def errors_of(model: Any, sets: Mapping[str, Samples]) -> dict[str, Any]:
    """E_res and E_u of each set in ℓ2, root mean squares, absolute residuals [GPa/Å].

    NaN where a set cannot be solved.
    """
    row: dict[str, Any] = {}
    for name, samples in sets.items():
        try:
            table = wp.evaluate(model, samples, allow_uncertified=True, transfer=False)
        except wp.InputError:  # indefinite: nothing is solved
            table = {}
        for key in ("E_res", "E_u"):
            each = np.array(table.get(f"{key}_samples", [np.nan]), dtype=float)
            row[f"{key} {name}"] = table.get(key, np.nan)
            row[f"{key}_rms {name}"] = np.sqrt(np.nanmean(each**2))
        row[f"absolute {name}"] = 1e3 * table.get("E_res_abs", np.nan)
    return row


def percent(values: Sequence[float]) -> list[str]:
    """Errors in %."""
    return ["–" if np.isnan(value) else f"{100 * value:.2f}" for value in values]


def cold() -> dict[str, Samples]:
    """Sets at 0 K."""
    return {name: data()[name] for name in SETS}


# A kernel that is known: 1/r

LAM, MU, HORIZON, LENGTH, AMPLITUDE = 0.1010, 0.4545, 12.5, 100.0, 0.1
DEGREES = (0, 2, 4, 6, 8, 10, 15, 20)
BY_ADAM = (0, 4, 10, 20)
KERNEL_DEGREE = 10
RATE, STEPS = 1e-3, 2_000
"""Of Adam; the source prints neither for these tests."""
QUADRATURE_DEGREES = {5.0: 5, 2.5: 11, 1.25: 13}
"""Highest odd degree up to 13 that the families of each spacing [Å] carry."""


def manufactured(spacing: float) -> Samples:
    """The 70 samples on one grid, with a collar of twice the horizon.

    A quarter of the domain, by symmetry, holds what there is to see; about 400 of its nodes are
    used.
    """
    collar = int(np.ceil(2 * HORIZON / spacing))
    x = grid_points(spacing * np.arange(-collar, int(LENGTH / 2 / spacing) + collar + 1), 2)
    inside = ((x >= 0) & (x <= LENGTH / 2)).all(axis=1)
    every = max(1, round(2.5 / spacing))
    steps = np.rint(x / spacing).astype(int)
    interior = inside & (steps % every == 0).all(axis=1)
    u, b = [], []
    for axis in range(2):
        for p in np.ndindex(6, 6):
            if p == (0, 0):
                continue
            k = 2 * np.pi * np.array(p) / LENGTH
            D = continuum_symbol(k, LAM, MU, HORIZON)
            even, odd = np.cos(k * x).prod(axis=1), -np.sin(k * x).prod(axis=1)
            field = np.zeros((2, len(x)))
            field[axis] = AMPLITUDE * even
            load = np.empty((2, len(x)))
            load[axis] = AMPLITUDE * D[axis, axis] * even
            load[1 - axis] = AMPLITUDE * D[0, 1] * odd
            u.append(field.T)
            b.append(load.T)
    return Samples(Points(x, interior, spacing), np.array(u), np.array(b))


class Reduced(NamedTuple):
    """The residual in few rows, ‖R (p, 1)‖² of the products p of bond classes."""

    classes: BondClasses
    R: np.ndarray


def relative_residual(reduced: Reduced, alpha: float, D: np.ndarray) -> float:
    """‖L u − b‖/‖b‖ over all samples, at the given λ and μ."""
    return float(np.linalg.norm(_residual(reduced, alpha, D)))


def _residual(reduced: Reduced, alpha: float, D: np.ndarray) -> np.ndarray:
    exponent = torch.tensor(alpha, dtype=torch.float64)
    R = torch.from_numpy(np.asarray(reduced.R))
    return np.asarray(_products(reduced, R, exponent, torch.from_numpy(D)))


def _products(
    reduced: Reduced, R: torch.Tensor, alpha: torch.Tensor, D: torch.Tensor
) -> torch.Tensor:
    w = class_weights(reduced.classes, alpha, D)
    i, j = np.triu_indices(len(w))
    return R @ torch.cat([MU * w, (LAM - MU) * w[i] * w[j], torch.ones(1, dtype=torch.float64)])


def positive_fit(
    reduced: Reduced, degree: int, *, learn_alpha: bool, seed: int
) -> tuple[float, np.ndarray]:
    """α (1 unless learned) and D ≥ 0 at the optimum from a random start."""
    start = np.random.default_rng(seed).uniform(size=degree + 1)
    low, high = np.zeros(degree + 1), np.full(degree + 1, np.inf)
    if learn_alpha:
        start, low, high = np.append(start, 2.0), np.append(low, -3.0), np.append(high, 2.999)

    def residual(y: np.ndarray) -> np.ndarray:
        return _residual(reduced, *((y[-1], y[:-1]) if learn_alpha else (1.0, y)))

    options = {"xtol": 1e-9, "ftol": 1e-9, "gtol": 1e-14, "max_nfev": 150}
    y = least_squares(residual, start, bounds=(low, high), **options).x
    return (float(y[-1]), y[:-1]) if learn_alpha else (1.0, y)


def adam_fit(
    reduced: Reduced, degree: int, *, learn_alpha: bool, seed: int
) -> tuple[float, np.ndarray]:
    """α (1 unless learned) and D ≥ 0 where Adam ends, as the prediction step is printed."""
    start = torch.from_numpy(np.random.default_rng(seed).uniform(size=degree + 2))
    D, exponent = start[:-1].clone(), start[-1].clone()
    learned = [D, exponent] if learn_alpha else [D]
    for part in learned:
        part.requires_grad_()
    R = torch.from_numpy(np.asarray(reduced.R))

    def alpha() -> torch.Tensor:
        return 3 - torch.relu(3 - exponent) if learn_alpha else torch.ones_like(exponent)

    optimizer = torch.optim.Adam(learned, lr=RATE)
    for _ in range(STEPS):
        optimizer.zero_grad()
        loss = _products(reduced, R, alpha(), torch.relu(D)).square().sum()
        loss.backward()
        optimizer.step()
    with torch.no_grad():
        return float(alpha()), torch.relu(D).numpy()


def kernel(alpha: float, D: np.ndarray, r: np.ndarray) -> np.ndarray:
    """K at r [Å], scaled to the weighted volume of 1/r in the continuum."""
    radius, weight = np.polynomial.legendre.leggauss(60)
    radius, weight = (radius + 1) * HORIZON / 2, weight * HORIZON / 2
    values = radius**-alpha * (bernstein_basis(radius, HORIZON, len(D) - 1) @ D)
    volume = weight @ (values * radius**3)
    K = r**-alpha * (bernstein_basis(r, HORIZON, len(D) - 1) @ D)
    return K * (HORIZON**3 / 3 / volume)


@cache
def grid(spacing: float, quadrature_degree: int) -> Reduced:
    """The reduced loss of the 70 samples on one grid."""
    samples = manufactured(spacing)
    weight = sample_weights([samples], normalise=False)[0]
    products = Products(samples, HORIZON, quadrature_degree=quadrature_degree)
    rows = products.rows(weight)
    return Reduced(products.classes, np.column_stack([rows.R, -rows.y]))


def known_kernel() -> Table:
    """Figures 2 and 3: losses by degree and spacing h [Å], and the error of K at degree 10."""
    columns = {
        (h, learned, adam): column(h, learned, adam)
        for h in QUADRATURE_DEGREES
        for learned in (False, True)
        for adam in (False, True)
    }
    names = [
        f"h = {h:g}, {'α learned' if learned else 'α = 1'}{', Adam' if adam else ''}"
        for h, learned, adam in columns
    ]
    rows = ["1/r itself", *(f"M = {degree}" for degree in DEGREES), "error of K, M = 10"]
    return ["", *names], [[row, *(c.get(row, "–") for c in columns.values())] for row in rows]


def column(h: float, learn_alpha: bool, adam: bool) -> dict[str, str]:
    """Losses on one grid, by least squares on weights of the highest degree that families allow,
    or by Adam on quintic ones as printed."""
    reduced = grid(h, 5 if adam else QUADRATURE_DEGREES[h])
    find = adam_fit if adam else positive_fit
    found = {"1/r itself": f"{relative_residual(reduced, 1.0, np.ones(1)):.2e}"}
    for degree in BY_ADAM if adam else DEGREES:
        parameters = find(reduced, degree, learn_alpha=learn_alpha, seed=0)
        found[f"M = {degree}"] = f"{relative_residual(reduced, *parameters):.2e}"
        if degree == KERNEL_DEGREE:
            r = np.linspace(5.0, HORIZON, 200)
            off = np.linalg.norm(kernel(*parameters, r) * r - 1) / np.sqrt(len(r))
            found["error of K, M = 10"] = f"{off:.3f}"
    return found


# Data and smoothing


def loads() -> Table:
    """Figure 5, Tables 1 and 2: samples, nodes and largest bond strain [%] of each set."""
    rows = []
    for name in data():
        samples = data()[name]
        largest = 100 * samples.arrays["max_bond_strain"]
        sizes = [f"{len(samples)}", f"{samples.spacing:g}", f"{samples.interior.sum()}"]
        rows.append([name, *sizes, f"{largest.min():.2f} to {largest.max():.2f}"])
    return ["set", "samples", "spacing", "nodes inside", "largest bond strain"], rows


RADIUS, SPACING, BEYOND = 10.0, 5.0, (10.0, 15.0, 20.0)


def forces_between_nodes(folder: Path) -> dict[str, Any]:
    """f(y, x) of (2.8) by distance, under one training load, of atoms made linear at rest.

    A pair of atoms pulls by −H (U′ − U), H the block of the energy's Hessian.
    """
    body = graphene_bodies()[0]
    (sample,) = solve_all({body: [TRAINING[7]]}, folder, 1, False)[body]
    X, U, atoms = sample.reference, sample.displacement, len(sample.reference)
    with LammpsSession(X, box=body.box, potential=body.potential) as session:
        hessian = ColouredHessian(find_bonds(X, body.box), atoms)(session.forces, X)
    blocks = sp.bsr_array(sp.csr_array(hessian), blocksize=(2, 2))
    first = np.repeat(np.arange(atoms), np.diff(blocks.indptr))
    pull = -np.einsum("nij,nj->ni", blocks.data, U[blocks.indices] - U[first])
    apart = nearest(X[blocks.indices] - X[first], body.box)
    nodes = grid_points(SPACING * np.arange(-9, 10), 2)
    inner = np.abs(nodes).max(axis=1) <= 20.0  # whose partners, to 25 Å, are all among the nodes
    omega = wp.atoms.smoothing_matrix(X, nodes, radius=RADIUS, box=body.box, spacing=SPACING)
    places = first, blocks.indices
    pulls = (sp.csr_array((pull[:, c], places), (atoms, atoms)) for c in (0, 1))
    f = np.stack([(omega[inner] @ one @ omega.T).toarray() for one in pulls], axis=-1)
    size = np.linalg.norm(f, axis=2)
    distance = np.linalg.norm(nodes[None] - nodes[inner][:, None], axis=2)
    there = size > 1e-12 * size.max()
    return {
        "share": [float(size[distance > r].sum() / size.sum()) for r in BEYOND],
        "farthest": float(distance[there].max()),
        "atoms": float(np.linalg.norm(apart, axis=1).max()),
        "bond": bond_length(body.potential),
    }


def coarse_graining() -> Table:
    """Forces between nodes (2.8), the horizon (2.9), and a paraboloid for the cone."""
    found, change = forces_between_nodes(CACHE), data().provenance["u_change_cone_to_paraboloid"]
    shares = [
        [f"part of Σ‖f(y, x)‖ beyond {r:g} Å", "–", f"{100 * share:.2g} %"]
        for r, share in zip(BEYOND, found["share"])
    ]
    reach = 2 * RADIUS + found["atoms"]
    return ["", "printed", "here"], [
        ["δ = 2R + d", f"{2 * RADIUS + 1.46:.2f} Å, d = 1.46 Å the bond", f"{reach:.2f} Å"],
        ["bond", "1.46 Å", f"{found['bond']:.4f} Å"],
        ["farthest atoms that pull", "–", f"{found['atoms']:.2f} Å"],
        ["farthest nodes that pull", "–", f"{found['farthest']:.2f} Å"],
        *shares,
        ["u by a paraboloid: longest wave", "about 0.3 %", f"{100 * change['longest_wave']:.2f} %"],
        ["mean over training", "–", f"{100 * change['training_mean']:.1f} %"],
        ["largest", "–", f"{100 * change['largest']:.0f} %"],
    ]


# Algorithm 1


@cache
def one_run(seed: int, moved: float = 0.0) -> list[dict[str, Any]]:
    """Constants, epochs and errors after prediction and correction of one run of Algorithm 1.

    `moved` multiplies each displacement that is learned from by a random 1 ± moved.
    """
    samples = data()["train"]
    factors = 1 + moved * np.random.default_rng(0).uniform(-1, 1, samples.u.shape)
    method = TwoStage(seed, outer_iterations=100)
    found = fitted(replace(samples, u=samples.u * factors), 20.0, 10, method)
    rows = []
    for stage in found.history:
        p, units = stage.parameters, found.material.units
        model = wp.LPSMaterial(p.lam, p.mu, p.alpha, np.asarray(p.D), 20.0, units=units)
        row = {"lam": p.lam, "mu": p.mu, "alpha": p.alpha, "epochs": len(stage.loss)}
        rows.append(row | errors_of(model, cold()))
    return rows


CONSTANTS = ("lam", "mu", "alpha")


def algorithm_1() -> Table:
    """Algorithm 1, δ = 20 Å, M = 10, five seeds: median constants; least / median / largest [%]."""
    runs = [one_run(seed)[-1] for seed in range(5)]
    cells = [f"{np.median([found[key] for found in runs]):.2f}" for key in CONSTANTS]
    for key in ALL_ERRORS:
        values = [found[key] for found in runs]
        cells.append(" / ".join(percent(np.nanquantile(values, (0, 0.5, 1)).tolist())))
    rows = [["as printed", *cells], *printed("you_2021", "algorithm_1")]
    return ["", "λ", "μ", "α", *COLUMNS], rows


def algorithm_1_steps() -> Table:
    """The runs as printed after either step; in the last the displacements are moved by 1e-12."""
    rows = []
    for seed, moved in [*((seed, 0.0) for seed in range(5)), (0, 1e-12)]:
        name = f"{seed}, u moved" if moved else f"{seed}"
        for step, row in zip(("prediction", "correction"), one_run(seed, moved)):
            constants = [f"{row['epochs']}", *(f"{row[key]:.2f}" for key in CONSTANTS)]
            rows.append([name, step, *constants, *percent([row[key] for key in ALL_ERRORS])])
    return ["seed", "after", "epochs", "λ", "μ", "α", *COLUMNS], rows


# Sweeps over horizons and degrees


@cache
def swept(temperature: int) -> SweepResult:
    """Algorithm 2 at 0 K, or at 300 K smoothed as printed; fits are kept in runs/."""
    own = data() if temperature == 0 else warm()["iota", 1.0]
    how: dict[str, Any] = {"test": own["test"], "jobs": -1, "progress": True}
    how |= {"noise": own["noise"]} if "noise" in own else {}
    return wp.methods.sweep(own["train"], own["val"], folder_of(temperature), **how)


def folder_of(temperature: int) -> Path:
    """Where the fits of a sweep are kept."""
    return SWEEPS / f"graphene_{temperature}K_sweep"


def metric() -> Table:
    """(6.1): the mean ℓ2 error, then the mean of its square, both in %."""
    laws = {
        "linear solid": wp.LPS(20.0),
        "third order, with energy": wp.ThirdOrder(
            wp.Crystal(15.0), wp.methods.Smoothing(10.0, 0.2), "energy"
        ),
        "crystal": wp.Crystal(12.5),
    }
    rows = []
    for name, law in laws.items():
        found = errors_of(wp.fit(data()["train"], law).material, cold())
        for kind, sets in (("E_res", SETS[:2]), ("E_u", SETS)):
            pairs = [(found[f"{kind} {n}"], found[f"{kind}_rms {n}"]) for n in sets]
            cells = [f"{100 * value:.2f}, {100 * rms**2:.4f}" for value, rms in pairs]
            rows.append([name, kind, *cells, *["–"] * (len(SETS) - len(cells))])
    return ["", "", "training", "validation", "disks"], rows + printed("you_2021", "metric")


def rows_by_degree(found: SweepResult, printed: Mapping[int, Sequence[float]]) -> list[list[str]]:
    """Every degree at its δ*, with the printed numbers in brackets."""
    rows = []
    for trial, average in zip(found.by_degree, found.average):
        errors = [trial.E_res_train, trial.E_u_train, trial.E_res_val, trial.E_u_val]
        ours = [f"{trial.horizon:g}", *percent(errors), f"{average:.4f}"]
        cells = [f"{a} ({b:g})" for a, b in zip(ours, printed[trial.degree])]
        rows.append([f"{trial.degree}", *cells])
    return rows


def table_3() -> Table:
    """Table 3 at 0 K: here, and printed in brackets."""
    return ["M", "δ*", *ERRORS, "AvgE"], rows_by_degree(swept(0), PRINTED_TABLE_3)


@cache
def swept_as_printed() -> SweepResult:
    """Algorithm 2 at 0 K by Algorithm 1 as printed: 35 fits with ReLU, dense conditions and the
    paper's hundred rounds, two hours of one core, kept in runs/."""
    law, own = wp.LPS(20.0, method=TwoStage(outer_iterations=100)), data()
    sets, folder = (own["train"], own["val"]), SWEEPS / "graphene_0K_as_printed"
    return wp.methods.sweep(*sets, folder, test=own["test"], law=law, jobs=1, progress=True)


def table_3_as_printed() -> Table:
    """Table 3 at 0 K by Algorithm 1 as printed: here, and printed in brackets."""
    return ["M", "δ*", *ERRORS, "AvgE"], rows_by_degree(swept_as_printed(), PRINTED_TABLE_3)


def pairs_as_printed() -> Table:
    """E_u on disks of every δ (down) and M (across) by Algorithm 1 as printed, [%]."""
    return pairs_of(swept_as_printed(), "E_u_test")


def pairs() -> Table:
    """E_u [%] on validation of every δ (down) and M (across)."""
    return pairs_of(swept(0), "E_u_val")


def pairs_of(found: SweepResult, error: str) -> Table:
    """One error [%] of every δ (down) and M (across)."""
    values = {(trial.horizon, trial.degree): getattr(trial, error) for trial in found.trials}
    horizons = sorted({horizon for horizon, _ in values})
    rows = [[f"{h:g}", *percent([values[h, M] for M in PRINTED_TABLE_3])] for h in horizons]
    return ["δ", *map(str, PRINTED_TABLE_3)], rows


def constants_and_errors(model: Any, found: Mapping[str, float]) -> list[str]:
    """The cells of Table 4."""
    constants = (model.alpha, model.lam, model.mu, model.E, model.nu)
    own = [*(f"{value:.4f}" for value in constants), *percent([found[key] for key in ERRORS])]
    return [*own, f"{found['absolute test']:.3f} GPa/Å", *percent([found["E_u test"]])]


HEAD = ["M", "α", "λ", "μ", "E", "ν", *ERRORS, "E_res disks", "E_u disks"]


def table_4() -> Table:
    """Table 4 at 0 K: the choice of the sweep, the printed model, the potential."""
    chosen = swept(0).printed
    model = wp.load(folder_of(0) / chosen.model)
    own = constants_and_errors(model, errors_of(model, cold()))
    truth = data().provenance["truth"]
    potential = [f"{truth[key]:.4f}" for key in ("lambda", "mu", "E", "nu")]
    return ["", *HEAD], [
        [f"here, δ = {chosen.horizon:g} Å", f"{chosen.degree}", *own],
        *printed("you_2021", "table_4"),
        ["the potential's own", "–", "–", *potential, *6 * ["–"]],
    ]


Sets = wp.Dataset | Mapping[str, wp.Samples]


def two_grids(sets: Sets, against: Sets) -> list[list[str]]:
    """One fit at δ = 12.5 Å to both grids: errors on the grid of 2.5 and on that of 5 Å."""
    model = fitted([sets["train"], sets["train_fine"]], 12.5, 10).material
    names = [name + end for end in ("_fine", "") for name in SETS[1:]]
    found, rows = errors_of(model, {name: against[name] for name in names}), []
    for end, spacing in (("_fine", "2.5 Å"), ("", "5 Å")):
        own = percent([found[f"E_res val{end}"], found[f"E_u val{end}"]])
        disks = [f"{found[f'absolute test{end}']:.3f}", *percent([found[f"E_u test{end}"]])]
        rows.append([spacing, *own, *disks])
    return rows


def table_6() -> Table:
    """Table 6: one fit for two grids, at 0 K with printed numbers, and at 300 K [%, GPa/Å]."""
    told = (("16.19", "8.01", "2.95", "8.44"), ("13.24", "9.29", "0.197", "7.80"))
    ours = two_grids(data(), data())
    rows = [["0 K", h, *map("{} ({})".format, a, b)] for (h, *a), b in zip(ours, told)]
    clean = short_data()["shared", 1.0]
    for reduction in ("iota", "shared"):
        sets = short_data()[reduction, 1.0]
        for name, against in (("own", sets), ("clean", clean)):
            found = two_grids(sets, against)
            rows += [[f"300 K, {reduction}, against {name} data", *row] for row in found]
    return ["from", "on", "E_res val", "E_u val", "E_res disks", "E_u disks"], rows


# 300 K

FACTORS, BATH = (1.0, 0.25, 0.1), Bath(steps=1500, transient=800)
SEEDS = {True: 10, False: 4}
"""Of the sheet, which is periodic, and of the disk."""


@cache
def warm() -> dict[tuple[str, float], Dataset]:
    """Full runs by reduction and factor: an hour of LAMMPS on two cores."""
    paths = make_thermal(DATA.parent, factors=FACTORS)
    return {key: wp.load(path) for key, path in paths.items()}


def short_plans() -> list[Plan]:
    """Every third training load, few seeds, short runs: ten minutes instead of thirty."""
    return [
        replace(
            plan,
            groups={
                name: loads[::3] if name == "train" else loads
                for name, loads in plan.groups.items()
            },
            seeds=SEEDS[bool(plan.body.cells)],
            spare=2,
            repeat=1000,
        )
        for plan in thermal.graphene_plans()
    ]


def scaled(
    plans: Sequence[Plan], runs: Mapping[Task, ThermalRun], factor: float
) -> dict[Task, ThermalRun]:
    """Runs under loads times a factor: the noise of the seed, and the response times the factor.

    The shared seed makes this an identity but for the atoms' nonlinearity.
    """
    made = dict(runs)
    for task, loaded in runs.items():
        if task.load is None:
            continue
        plan = next(plan for plan in plans if plan.body == task.body)
        bare = runs[plan.unloaded(task.seed)]
        made[replace(task, factor=factor)] = ThermalRun(
            bare.average + factor * (loaded.average - bare.average),
            bare.smoothed + factor * (loaded.smoothed - bare.smoothed),
            factor * loaded.snr,
        )
    return made


@cache
def short_data() -> dict[tuple[str, float], Dataset]:
    """Both reductions on both grids, by reduction and factor, from the short plans."""
    plans = short_plans()
    at_rest, runs = run_all(plans, [1.0], BATH, CACHE, jobs=1, progress=True)
    wanted = [("shared", 1.0), *(("iota", factor) for factor in FACTORS)]
    return {
        (reduction, factor): data_set(
            plans, scaled(plans, runs, factor), at_rest, BATH,
            reduction=reduction, factor=factor, fine=factor == 1,
        )
        for reduction, factor in wanted
    }  # fmt: skip


def tables_3_and_4_at_300() -> Table:
    """Tables 3 and 4 at 300 K, by degree: here, printed in brackets; constants; E_u disks."""
    found, sets = swept(300), warm()["iota", 1.0]
    clean, rows = warm()["shared", 1.0], []
    for row, trial in zip(rows_by_degree(found, TABLE_3_AT_300), found.by_degree):
        model = wp.load(folder_of(300) / trial.model)
        own, shared = (errors_of(model, {n: s[n] for n in SETS}) for s in (sets, clean))
        quiet = " / ".join(percent([shared["E_u val"], shared["E_u test"]]))
        rows.append([*row, f"{model.lam:.4f}", f"{model.mu:.4f}", f"{model.nu:.4f}"])
        rows[-1] += [f"{own['absolute test']:.3f}", *percent([own["E_u test"]]), quiet]
    head = ["M", "δ*", *ERRORS, "AvgE", "λ", "μ", "ν", "E_res disks", "E_u disks"]
    return [*head, "E_u val / disks, shared seed"], rows


def table_5() -> Table:
    """Table 5 from short runs: each row against its own data, those of factor 1, and clean ones."""
    low, clean, rows = short_data()["iota", 1.0], short_data()["shared", 1.0], []
    for (reduction, factor), own in short_data().items():
        model = fitted(own["train"], 20.0, 10).material
        mine, noisy, quiet = (
            errors_of(model, {name: sets[name] for name in SETS}) for sets in (own, low, clean)
        )
        cells = [f"{factor:g}", reduction, f"{own.provenance['snr']['train']:.4f}"]
        cells += [f"{value:.4f}" for value in (model.lam, model.mu, model.nu)]
        cells += [pair(mine, "train"), *(pair(found, "val") for found in (mine, noisy, quiet))]
        cells += [f"{found['absolute test']:.3f}" for found in (noisy, quiet)]
        rows.append(cells + percent([found["E_u test"] for found in (noisy, quiet)]))
        if reduction == "iota":
            rows += [row for row in printed("you_2021", "table_5") if row[0] == f"{factor:g}"]
    head = ["factor", "", "SNR", "λ", "μ", "ν", "train, own", "val, own", "val, low", "val, clean"]
    ends = ["E_res disks, low", "clean", "E_u disks, low", "clean"]
    return head + ends, rows


def pair(found: Mapping[str, float], name: str) -> str:
    """E_res and E_u in %."""
    return " / ".join(percent([found[f"E_res {name}"], found[f"E_u {name}"]]))


def long_averages() -> Table:
    """Errors of the 0 K solid against averages of so many steps at 300 K.

    The ten validation loads and the four disks: two hours of one core, run by run kept in data/.
    """
    model, rows = fitted(data()["train"], 20.0, 10).material, []
    told: Any = zip(graphene_bodies(), (VALIDATION, TEST), ("ten loads", "four disks"))
    for body, loads, name in told:
        rested = solve_all({body: loads}, CACHE, 1, False)[body]
        force = np.stack([sample.force for sample in rested])
        for steps in (700, 24_000):
            bath, fields = Bath(steps=BATH.transient + steps, transient=BATH.transient), []
            for seed, (load, sample) in enumerate(zip(loads, rested), start=1):
                task = Task(body, load, 1.0, seed)
                file = thermal.run_file(CACHE, task, bath)
                if read_record(file, ThermalRun) is None:
                    thermal.run(task, sample, bath, CACHE)
                average = read_arrays(file)["average"]
                fields.append(settled(average, sample.reference, body.box))
            samples = on_nodes(body, rested[0].reference, np.stack(fields), force, spacing=5.0)
            found = errors_of(model, {"": samples})
            residual, displacement = percent([found["E_res "], found["E_u "]])
            if name == "four disks":  # their interior bears next to no load
                residual = f"{found['absolute ']:.3f} GPa/Å"
            rows.append([name, f"{steps}", residual, displacement])
    printed = [
        ["ten loads", "*printed*", "18.08", "8.88"],
        ["four disks", "*printed*", "0.208 GPa/Å", "9.21"],
    ]
    return ["", "steps", "E_res", "E_u"], [*rows, *printed]


def ratios() -> Table:
    """√(Σ|B|²/Σ|B + F|²) at factor 1 by damping [ps], steps, and ι of the smoothing in time."""
    runs, smoothings = ((0.02, 1), (0.1, 1), (1.0, 1), (0.1, 5)), (1.0, 0.3, 0.1, 0.03, 0.01)
    plan, rows = next(plan for plan in short_plans() if plan.body.cells), []
    (sample,) = solve_all({plan.body: [plan.groups["train"][7]]}, CACHE, 1, False)[plan.body]
    for damping, times in runs:
        average = times * (BATH.steps - BATH.transient)
        smooth = np.zeros((len(smoothings), *sample.force.shape))
        squares, body = np.zeros(len(smoothings)), plan.body
        with LammpsSession(sample.reference, box=body.box, potential=body.potential) as session:
            steps = session.trajectory(
                sample.reference + sample.displacement, sample.force,
                temperature=BATH.temperature, seed=1, steps=BATH.transient + average,
                timestep=BATH.timestep, damping=damping,
            )  # fmt: skip
            for step, (_, inner) in enumerate(steps):
                for row, iota in zip(smooth, smoothings):
                    row += iota * (sample.force + inner - row)
                if step >= BATH.transient:
                    squares += (smooth**2).sum(axis=(1, 2)) / (sample.force**2).sum()
        found = np.sqrt(average / squares)
        rows.append([f"{damping:g}, {average}", *(f"{value:.3f}" for value in found)])
    return ["damping, steps", *(f"ι = {iota:g}" for iota in smoothings)], rows


TABLES = (
    known_kernel, loads, coarse_graining, algorithm_1, algorithm_1_steps, metric, table_3,
    table_3_as_printed, pairs, pairs_as_printed, table_4, table_6, tables_3_and_4_at_300, table_5,
    long_averages, ratios,
)  # fmt: skip

if __name__ == "__main__":
    sys.exit(exit_status(lambda: print_tables(__doc__, TABLES)))
