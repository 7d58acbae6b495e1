"""What the page on You et al. (2021) shows at 300 K: Tables 3 to 6, noise, Figure 7."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import warp_peri as wp
from examples.figures import headline, panels, save_figure
from examples.studies.noise_report import ERRORS, PRINTED_TABLE_3, PRINTED_TABLE_5
from tools.lammps_session import LammpsSession
from tools.loads import VALIDATION
from tools.make_graphene import on_nodes, solve_all
from tools.make_thermal import data_set, run_all
from tools.thermal import (
    Bath,
    Plan,
    Task,
    ThermalRun,
    graphene_plans,
    read_run,
    run,
    run_file,
    settled,
)
from warp_peri import Bernstein, Dataset
from warp_peri.learning.fit import learn
from warp_peri.methods import Optimum
from warp_peri.points.families import bond_classes

BATH = Bath(steps=1500, transient=800)
SEEDS = {True: 10, False: 4}
"""Of the sheet, which is periodic, and of the disk."""
FACTORS = (1.0, 0.25, 0.1)
RUNS, SMOOTHINGS = ((0.02, 1), (0.1, 1), (1.0, 1), (0.1, 5)), (1.0, 0.3, 0.1, 0.03, 0.01)
"""Damping [ps] and how many times as long as the bath's the average is."""
WATCHED = (7,)
"""Training loads, of those that run, that the signal-to-noise ratio is measured on."""
SETS, AVERAGES = ("val", "test"), ("iota", "plain")
LONG, LONG_LOADS = (700, 24_000), (0, 5)
"""Steps of a plain average, and the validation loads that run so long."""


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
    """Table 5, Table 6, the kernels of Figure 7, and what noise adds to a residual."""
    data = data_at_300(cache)
    cases = [("shared", 1.0), *(("iota", factor) for factor in FACTORS)]
    fits = [one_grid(data, *case) for case in cases]
    return {
        "table_5": [fit["row"] for fit in fits],
        "kernels": {
            f"{reduction} {factor:g}": fit["kernel"]
            for (reduction, factor), fit in zip(cases, fits)
        },
        "noise": fits[0]["noise"],
        "table_6": {reduction: two_grids(data, reduction) for reduction in ("iota", "shared")},
    }


Data = Mapping[tuple[str, float], Dataset]


def long_averages(cache: Path, model: wp.Model) -> dict[str, Any]:
    """E_res and E_u in % of a model of the sheet at rest against averages of so many steps.

    Both lengths begin behind the same transient; seconds of a processor stand for 1000 steps.
    """
    body = next(plan.body for plan in short_plans() if plan.body.cells)
    loads = [VALIDATION[number] for number in LONG_LOADS]
    rested = solve_all({body: loads}, cache, 1, False)[body]
    found: dict[str, Any] = {}
    for steps in LONG:
        bath, fields = Bath(steps=BATH.transient + steps, transient=BATH.transient), []
        start = time.process_time()
        for seed, (load, sample) in enumerate(zip(loads, rested), start=1):
            task = Task(body, load, 1.0, seed)
            run(task, sample, bath, cache)
            kept = read_run(run_file(cache, task, bath))
            assert kept is not None
            fields.append(settled(body, sample.reference, kept.average))
        seconds = time.process_time() - start
        force = np.stack([sample.force for sample in rested])
        samples = on_nodes(body, rested[0].reference, np.stack(fields), force, spacing=5.0)
        table = wp.evaluate(model, samples)
        found[f"{steps}"] = {
            **{key: [100 * value for value in table[f"{key}_samples"]] for key in ("E_res", "E_u")},
            "seconds": 1e3 * seconds / (len(loads) * bath.steps),
        }
    return found


def long_rows(found: Mapping[str, Any]) -> list[list[str]]:
    """Errors of each load by length of the average, and what is printed of the whole set."""
    cells = [
        [steps, *(", ".join(f"{value:.1f}" for value in row[key]) for key in ("E_res", "E_u"))]
        for steps, row in found.items()
    ]
    printed = PRINTED_TABLE_5[1.0]
    return [*cells, ["*printed*, ten loads", f"{printed[8]:g}", f"{printed[9]:g}"]]


def one_grid(data: Data, reduction: str, factor: float) -> dict[str, Any]:
    """A fit as printed: its constants, kernel, and errors against its own and other data."""
    own, low, clean = data[reduction, factor], data["iota", 1.0], data["shared", 1.0]
    model = learn(own["train"], 20.0, Bernstein(10), method=Optimum(moduli=None)).material
    row: dict[str, Any] = {"reduction": reduction, "factor": factor}
    row |= {key: getattr(model, key) for key in ("alpha", "lam", "mu", "E", "nu")}
    row |= errors(model, {name: own[name] for name in ("train", *SETS)}, "own")
    row |= errors(model, {name: low[name] for name in SETS}, "low")
    row |= errors(model, {name: clean[name] for name in SETS}, "clean")
    row["snr"] = own.provenance["snr"]["train"]
    noise = {key: errors(model, {"val": data[key, 1.0]["val"]}, key) for key in AVERAGES}
    return {"row": row, "kernel": curve(model), "noise": noise}


def two_grids(data: Data, reduction: str) -> dict[str, float]:
    """One fit at δ = 12.5 Å to both grids, on either, against its own and the clean data."""
    own, clean = data[reduction, 1.0], data["shared", 1.0]
    both = [own["train"], own["train_fine"]]
    model = learn(both, 12.5, Bernstein(10), method=Optimum(moduli=None)).material
    names = [name + end for end in ("_fine", "") for name in SETS]
    found = errors(model, {name: own[name] for name in names}, "own")
    return found | errors(model, {name: clean[name] for name in names}, "clean")


def errors(model: Any, sets: Mapping[str, Any], against: str) -> dict[str, float]:
    """E_res, E_u and the absolute residual [GPa/Å] of each set."""
    row: dict[str, float] = {}
    for name, samples in sets.items():
        table = wp.evaluate(model, samples, transfer=False)
        row |= {f"{key} {name} {against}": table[key] for key in ("E_res", "E_u")}
        row[f"absolute {name} {against}"] = 1e3 * table["E_res_abs"]
    return row


def curve(model: wp.Model) -> dict[str, list[float]]:
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


def ratios(cache: Path, runs: Sequence[tuple[float, int]] = RUNS) -> dict[str, Any]:
    """√(Σ|B|²/Σ|B + F|²) by damping and length, with the forces F smoothed in time by ι."""
    plan = next(plan for plan in short_plans() if plan.body.cells)
    loads = [plan.groups["train"][number] for number in WATCHED]
    samples = solve_all({plan.body: loads}, cache, 1, False)[plan.body]
    found = {}
    for damping, times in runs:
        average = times * (BATH.steps - BATH.transient)
        squares = np.zeros(len(SMOOTHINGS))
        for sample in samples:
            with LammpsSession(
                sample.reference, box=plan.body.box, potential=plan.body.potential
            ) as session:
                steps = session.trajectory(
                    sample.reference + sample.displacement, sample.force,
                    temperature=BATH.temperature, seed=1, steps=BATH.transient + average,
                    timestep=BATH.timestep, damping=damping,
                )  # fmt: skip
                smooth = np.zeros((len(SMOOTHINGS), *sample.force.shape))
                for step, (_, inner) in enumerate(steps):
                    for row, iota in zip(smooth, SMOOTHINGS):
                        row += iota * (sample.force + inner - row)
                    if step >= BATH.transient:
                        squares += (smooth**2).sum(axis=(1, 2)) / (sample.force**2).sum()
        found[f"{damping:g}, {average}"] = np.sqrt(len(loads) * average / squares).tolist()
    return found


def law_of_ratios() -> tuple[float, float, float]:
    """a, c of 1/SNR² = a/f² + c through the first and last printed ratio, and what it gives for
    the middle one."""
    f = np.array(FACTORS)
    inverse = np.array([PRINTED_TABLE_5[factor][0] for factor in FACTORS]) ** -2.0
    a = (inverse[2] - inverse[0]) / (f[2] ** -2 - f[0] ** -2)
    c = inverse[0] - a / f[0] ** 2
    return float(a), float(c), float((a / f[1] ** 2 + c) ** -0.5)


def row_of_table_5(row: Mapping[str, Any]) -> list[str]:
    """Constants, then E_res and E_u of the sets at factor 1 and against the clean ones."""
    smooth = "ι = 0.01" if row["reduction"] == "iota" else "shared seed"
    cells = [f"{row['factor']:g}", smooth, f"{row['snr']:.4f}"]
    cells += [f"{row[key]:.4f}" for key in ("lam", "mu", "nu")]
    cells.append(pair(row, "train", "own"))
    cells += [pair(row, "val", which) for which in ("own", "low", "clean")]
    cells += [f"{row[f'absolute test {which}']:.3f}" for which in ("low", "clean")]
    cells += [f"{100 * row[f'E_u test {which}']:.2f}" for which in ("low", "clean")]
    return cells


def pair(row: Mapping[str, Any], name: str, against: str) -> str:
    """E_res and E_u in %."""
    return " / ".join(f"{100 * row[f'{key} {name} {against}']:.2f}" for key in ("E_res", "E_u"))


def printed_row(factor: float) -> list[str]:
    """What the source's Table 5 has in the same columns."""
    snr, _, lam, mu, _, nu, res, u, res_val, u_val, res_test, u_test = PRINTED_TABLE_5[factor]
    own = [f"{res:g} / {u:g}", "–", f"{res_val:g} / {u_val:g}", "–"]
    constants = [f"{lam:g}", f"{mu:g}", f"{nu:g}"]
    return [
        f"{factor:g}", "*printed*", f"{snr:g}", *constants, *own,
        f"{res_test:g}", "–", f"{u_test:g}", "–",
    ]  # fmt: skip


def table_3(sweep: Mapping[str, Any]) -> list[list[str]]:
    """Every degree at its δ*: here, printed in brackets, and E_u against the shared seed."""
    rows = []
    for fit in sweep["by_degree"]:
        ours = [f"{fit['horizon']:g}", *(f"{100 * fit[key]:.2f}" for key in ERRORS)]
        theirs = PRINTED_TABLE_3[fit["degree"]]
        cells = [f"{a} ({b:g})" for a, b in zip([*ours, f"{fit['AvgE']:.4f}"], theirs)]
        rows.append([f"{fit['degree']}", *cells, against_shared_seed(fit)])
    return rows


def table_4(sweep: Mapping[str, Any]) -> list[list[str]]:
    """Constants and errors of the degree that was chosen, and the printed ones."""
    fit = next(row for row in sweep["by_degree"] if row["degree"] == sweep["chosen"])
    here = [f"here, δ = {fit['horizon']:g} Å", f"{fit['degree']}"]
    here += [f"{fit[key]:.4f}" for key in ("alpha", "lam", "mu", "E", "nu")]
    here += [f"{100 * fit[key]:.2f}" for key in ERRORS]
    here += [f"{1e3 * fit['E_res_abs_test']:.3f} GPa/Å", f"{100 * fit['E_u_test']:.2f}"]
    printed = [f"{value:g}" for value in PRINTED_TABLE_5[1.0][1:]]
    return [[*here, against_shared_seed(fit)], ["printed", "15", *printed, "–"]]


def against_shared_seed(fit: Mapping[str, Any]) -> str:
    """E_u on validation / disks in %, the noise of both runs being the same."""
    return " / ".join(f"{100 * fit[f'E_u_{name}_shared']:.2f}" for name in SETS)


def rows_of_table_6(found: Mapping[str, Mapping[str, float]]) -> list[list[str]]:
    """Both reductions on both grids, each against its own data and the clean ones."""
    rows = []
    for reduction, errors_there in found.items():
        for end, spacing in (("_fine", "2.5 Å"), ("", "5 Å")):
            own = ["ι = 0.01" if reduction == "iota" else "shared seed", spacing]
            for against in ("own", "clean"):
                own.append(pair(errors_there, f"val{end}", against))
                own.append(f"{errors_there[f'absolute test{end} {against}']:.3f}")
                own.append(f"{100 * errors_there[f'E_u test{end} {against}']:.2f}")
            rows.append(own)
    return rows


def rows_of_ratios(found: Mapping[str, Sequence[float]]) -> list[list[str]]:
    """Signal-to-noise ratios by damping, length and smoothing."""
    return [[run, *(f"{value:.3f}" for value in row)] for run, row in found.items()]


def longer(found: Mapping[str, Mapping[str, float]]) -> dict[str, str]:
    """What noise adds to E_res on validation, and the steps that would average it away."""
    cold, warm = 13.28, PRINTED_TABLE_5[1.0][8]
    printed = float(np.sqrt(warm**2 - cold**2))
    here = {key: 100 * row[f"E_res val {key}"] for key, row in found.items()}
    steps = (BATH.steps - BATH.transient) * (here["plain"] / printed) ** 2
    texts = {f"noise_{key}": f"{value:.0f}" for key, value in here.items()}
    return {**texts, "noise_printed": f"{printed:.0f}", "steps": f"{round(steps, -3):.0f}"}


def draw_kernels(path: Path, cold: wp.Model, kernels: Mapping[str, Any]) -> None:
    """Figure 7: K at 0 and 300 K, and at 300 K under three sizes of load.

    Between bonds K is hundreds of times what it is at them, so that the axis is theirs.
    """
    figure, (both, noises) = panels(10.5, 3.8, count=2, sharey=True)
    zero = curve(cold)
    names = {"shared 1": "300 K, shared seed", "iota 1": "300 K, smoothed"}
    sizes = {"iota 1": "loads × 1", "iota 0.25": "loads × 1/4", "iota 0.1": "loads × 1/10"}
    lines = [(both, zero, "0 K"), *((both, kernels[k], said) for k, said in names.items())]
    lines += [(noises, kernels[k], said) for k, said in sizes.items()]
    most = 1.3 * max(np.abs(line["K at bonds"]).max() for _, line, _ in lines)
    for number, (ax, line, label) in enumerate(lines):
        color, marker = f"C{number % 5}", "os^"[number % 3]
        ax.plot(line["r"], line["K"], color=color, linewidth=0.7)
        ax.plot(line["bonds"], line["K at bonds"], marker, color=color, markersize=5, label=label)
    for ax, title in ((both, "at 0 and 300 K"), (noises, "at 300 K, by the size of the loads")):
        ax.axhline(0, color="grey", linewidth=0.8)
        ax.set(xlabel="bond length r [Å]", ylabel="K / m [Å⁻⁴]", title=title, ylim=(-most, most))
        ax.legend(frameon=False, ncols=3, loc="upper center", bbox_to_anchor=(0.5, -0.15))
    headline(figure, "Heat leaves the influence function as it is; smaller loads teach another")
    save_figure(figure, path)
