"""What the page on You et al. (2021) shows at 300 K: Tables 5 and 6, noise, Figure 7."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

import warp_peri
from examples.graphene_report import save_figure
from examples.studies.noise_report import PRINTED_TABLE_5
from tools.lammps_session import LammpsSession
from tools.make_thermal import data_set, run_all
from tools.plans import Plan, graphene_plans
from tools.thermal import Bath, Task, ThermalRun
from warp_peri import Bernstein
from warp_peri.learning.fit import learn
from warp_peri.points.dataset import Dataset
from warp_peri.points.families import bond_classes

BATH = Bath(steps=1500, transient=800)
SEEDS = {True: 10, False: 4}
"""Of the sheet, which is periodic, and of the disk."""
FACTORS = (1.0, 0.25, 0.1)
DAMPINGS, SMOOTHINGS = (0.02, 0.1, 1.0), (1.0, 0.3, 0.1, 0.03, 0.01)
WATCHED = (0, 20, 50)
"""Training loads that the signal-to-noise ratio is measured on."""
SETS, AVERAGES = ("val", "test"), ("iota", "plain")


def short_plans() -> list[Plan]:
    """Every second training load, few seeds: ten minutes instead of thirty."""
    return [
        replace(
            plan,
            groups={
                name: loads[::2] if name == "train" else loads
                for name, loads in plan.groups.items()
            },
            seeds=SEEDS[bool(plan.body.cells)],
            spare=2,
            repeat=1000,
        )
        for plan in graphene_plans()
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


def data_at_300(cache: Path) -> dict[tuple[str, float], Dataset]:
    """Both reductions on both grids, by reduction and factor."""
    plans = short_plans()
    at_rest, runs = run_all(plans, [1.0], BATH, cache, jobs=1, progress=True)
    wanted = [("shared", 1.0), ("plain", 1.0), *(("iota", factor) for factor in FACTORS)]
    return {
        (reduction, factor): data_set(
            plans, scaled(plans, runs, factor), at_rest, BATH,
            reduction=reduction, factor=factor, fine=factor == 1,
        )
        for reduction, factor in wanted
    }  # fmt: skip


def study(cache: Path) -> dict[str, Any]:
    """Table 5 under both readings of its errors, Table 6, and the kernels of Figure 7."""
    data = data_at_300(cache)
    low, clean = data["iota", 1.0], data["shared", 1.0]
    table_5, kernels = [], {}
    cases = [("shared", 1.0), *(("iota", factor) for factor in FACTORS)]
    for case in cases:
        own = data[case]
        model = learn(own["train"], horizon=20.0, kernel=Bernstein(10)).material
        row: dict[str, Any] = {"reduction": case[0], "factor": case[1]}
        row |= {key: getattr(model, key) for key in ("alpha", "lam", "mu", "E", "nu")}
        row |= errors(model, {"train": own["train"]}, "own")
        row |= errors(model, {name: own[name] for name in SETS}, "own")
        row |= errors(model, {name: low[name] for name in SETS}, "low")
        row |= errors(model, {name: clean[name] for name in SETS}, "clean")
        row["snr"] = own.provenance["snr"]["train"]
        table_5.append(row)
        kernels[f"{case[0]} {case[1]:g}"] = curve(model)
        if case == ("shared", 1.0):
            noisy = {key: errors(model, {"val": data[key, 1.0]["val"]}, key) for key in AVERAGES}
    grids = {}
    for reduction in ("iota", "shared"):
        own = data[reduction, 1.0]
        model = learn(
            [own["train"], own["train_fine"]], horizon=12.5, kernel=Bernstein(10)
        ).material
        names = [name + end for end in ("_fine", "") for name in SETS]
        grids[reduction] = errors(model, {name: own[name] for name in names}, "own")
        grids[reduction] |= errors(model, {name: clean[name] for name in names}, "clean")
    return {"table_5": table_5, "table_6": grids, "kernels": kernels, "noise": noisy}


def errors(model: Any, sets: Mapping[str, Any], against: str) -> dict[str, float]:
    """E_res, E_u and the absolute residual [GPa/Å] of each set."""
    row: dict[str, float] = {}
    for name, samples in sets.items():
        table = warp_peri.evaluate(model, samples, transfer=False)
        row |= {f"{key} {name} {against}": table[key] for key in ("E_res", "E_u")}
        row[f"absolute {name} {against}"] = 1e3 * table["E_res_abs"]
    return row


def curve(model: warp_peri.Model) -> dict[str, list[float]]:
    """K over its weighted volume on the lattice, by distance; and at the bonds."""
    classes = bond_classes(5.0, model.horizon)
    r = np.linspace(4.0, model.horizon, 300)
    m = float(np.sum(classes.count * model.influence(classes.r) * classes.r**2 * classes.weight))
    bonds = np.unique(np.round(classes.r, 9))
    return {
        "r": r.tolist(),
        "K": (model.influence(r) / m).tolist(),
        "bonds": bonds.tolist(),
        "K at bonds": (model.influence(bonds) / m).tolist(),
    }


def ratios(at_rest: Mapping[Any, Any], plan: Plan) -> dict[str, Any]:
    """√(Σ|B|²/Σ|B + F|²) by damping, with the forces F smoothed in time by ι."""
    loads = [plan.groups["train"][number] for number in WATCHED]
    found = {}
    for damping in DAMPINGS:
        squares = np.zeros(len(SMOOTHINGS))
        for load in loads:
            sample = at_rest[plan.body][load]
            with LammpsSession(
                sample.reference, box=plan.body.box, potential=plan.body.potential
            ) as session:
                steps = session.trajectory(
                    sample.reference + sample.displacement, sample.force,
                    temperature=BATH.temperature, seed=1, steps=BATH.steps,
                    timestep=BATH.timestep, damping=damping,
                )  # fmt: skip
                smooth = np.zeros((len(SMOOTHINGS), *sample.force.shape))
                for step, (_, inner) in enumerate(steps):
                    for row, iota in zip(smooth, SMOOTHINGS):
                        row += iota * (sample.force + inner - row)
                    if step >= BATH.transient:
                        squares += (smooth**2).sum(axis=(1, 2)) / (sample.force**2).sum()
        kept = len(loads) * (BATH.steps - BATH.transient)
        found[f"{damping:g}"] = np.sqrt(kept / squares).tolist()
    return found


def law_of_ratios() -> tuple[float, float, float]:
    """a, c of 1/SNR² = a/f² + c through the first and last printed ratio, and what it gives for
    the middle one."""
    f = np.array(FACTORS)
    inverse = np.array([PRINTED_TABLE_5[factor][0] for factor in FACTORS]) ** -2.0
    a = (inverse[2] - inverse[0]) / (f[2] ** -2 - f[0] ** -2)
    c = inverse[0] - a / f[0] ** 2
    return float(a), float(c), float((a / f[1] ** 2 + c) ** -0.5)
