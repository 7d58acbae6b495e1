"""What the page on You et al. (2021) shows: see papers.py."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

import warp_peri as wp
from examples.prose import rows_of
from examples.studies import paper_you_graining as graining
from examples.studies import paper_you_pictures as pictures
from examples.studies import paper_you_thermal as thermal
from examples.studies.sweep_report import ERRORS, PRINTED_TABLE_3, PRINTED_TABLE_4
from warp_peri import Bernstein, Dataset, Samples
from warp_peri.files.atomic import whole_file
from warp_peri.learning.fit import learn
from warp_peri.learning.response import as_model
from warp_peri.learning.result import Stage
from warp_peri.methods import Optimum, TwoStage

DATA, CACHE = "data/graphene_0K.h5", "data/graphene_0K.cache"
NEEDED = {
    DATA: "python examples/train_graphene.py",
    "runs/graphene_0K/model.json": "python examples/train_graphene.py",
    "runs/graphene_0K_sweep/sweep.json": "python examples/train_graphene.py --sweep",
    "runs/manufactured/manufactured.json": "python examples/studies/manufactured.py",
    "runs/manufactured_adam/manufactured.json": "python examples/studies/manufactured.py "
    "--quintic --adam --out runs/manufactured_adam",
    "runs/noise_study/noise.json": "python examples/studies/noise_study.py",
}
TEMPLATE = Path(__file__).with_suffix(".md")
SEEDS = range(5)
ROUNDS = 100
"""Outer iterations of Algorithm 1, as printed."""
MOVED = 1e-12
"""Of displacements, relative: what rounding may do."""
CHANGES = {
    "as printed": ("relu", "dense"),
    "conditions over the zone": ("relu", "symbol"),
    "and bounds by projection": ("projected", "symbol"),
}
"""How λ, μ, α and D are kept inside their bounds, and which conditions are asked for."""
SETS = ("train", "val", "test")
E_U = ("E_u train", "E_u val", "E_u test")
ALL_ERRORS = ("E_res train", "E_res val", *E_U)
NOISE = ("noise_iota", "noise_plain", "noise_printed", "steps")
"""What thermal.longer gives."""


def parts(runs: Path, kept: Callable[..., Any], figures: Path) -> dict[str, Callable[[], str]]:
    """The parts of the page, by the names that its template gives them."""

    @cache
    def data() -> Dataset:
        read: Dataset = wp.load(runs.parent / DATA)
        return read

    @cache
    def told(path: str) -> Any:
        return json.loads((runs / path).read_text(encoding="utf-8"))

    def sweep() -> Any:
        return told("graphene_0K_sweep/sweep.json")

    def model() -> Any:
        return wp.load(runs / "graphene_0K" / "model.json")

    def manufactured(name: str) -> str:
        return rows_of(consistency(told("manufactured/manufactured.json"), name))

    def by_adam() -> str:
        adam = told("manufactured_adam/manufactured.json")
        for name in ("fixed", "learned"):
            picture = (runs / "manufactured_adam" / f"{name}_alpha.png").read_bytes()
            with whole_file(figures / f"you_2021_{name}_alpha.png") as path:
                path.write_bytes(picture)
        return rows_of(three_ways(told("manufactured/manufactured.json"), adam))

    def runs_of(name: str) -> list[Any]:
        bounds, conditions = CHANGES[name]
        file = f"algorithm_1_{bounds}_{conditions}"
        return [
            kept(f"{file}_{seed}", partial(algorithm_1, data(), bounds, conditions, seed))
            for seed in SEEDS
        ]

    def moved() -> Any:
        given = partial(algorithm_1, data(), *CHANGES["as printed"], 0, MOVED)
        return kept("algorithm_1_moved", given)

    def squares() -> Any:
        return kept("squares", lambda: both_metrics(runs, sweep()["trials"], data()))

    def warm() -> Any:
        return kept("thermal", lambda: thermal.study(runs.parent / CACHE))

    def figure(name: str, draw: Callable[[Path], None]) -> str:
        draw(figures / name)
        return name

    def kernels(path: Path) -> None:
        thermal.draw_kernels(path, model(), warm()["kernels"])

    def noise(rows: Callable[[Any], Any]) -> str:
        return rows_of(rows(told("noise_study/noise.json")["sweep"]))

    law = thermal.law_of_ratios()
    end = cache(lambda: ends(runs_of("as printed")))
    more = cache(lambda: thermal.longer(warm()["noise"]))
    return {
        "family": lambda: figure("you_2021_family.png", pictures.family),
        "atoms": lambda: figure(
            "you_2021_atoms.png", partial(pictures.atoms, data(), runs.parent / CACHE)
        ),
        "fields": lambda: figure("you_2021_fields.png", partial(pictures.fields, data())),
        "graining": lambda: rows_of(
            graining.rows(
                kept("graining", lambda: graining.forces_between_nodes(runs.parent / CACHE)),
                data().provenance["u_change_cone_to_paraboloid"],
            )
        ),
        "long": lambda: rows_of(
            thermal.long_rows(
                kept("long_averages", lambda: thermal.long_averages(runs.parent / CACHE, model()))
            )
        ),
        "kernels": lambda: figure("you_2021_kernels.png", kernels),
        "manufactured": lambda: manufactured("fixed_alpha"),
        "learned_alpha": lambda: manufactured("learned_alpha"),
        "adam": by_adam,
        "strains": lambda: rows_of(strains(data())),
        "algorithm": lambda: rows_of(row_of_algorithm(name, runs_of(name)) for name in CHANGES),
        "stages": lambda: rows_of(steps_of_algorithm([*runs_of("as printed"), moved()])),
        **{name: partial(lambda name: end()[name], name) for name in ("lam", "mu", "E_u")},
        "metric": lambda: rows_of(metric(runs, data())),
        "chosen": lambda: rows_of(chosen(squares())),
        "table_3": lambda: rows_of(map(table_3, sweep()["by_degree"], sweep()["AvgE"])),
        "pairs": lambda: rows_of(pairs(sweep()["trials"])),
        "table_4": lambda: rows_of(table_4(runs, sweep(), data())),
        "table_3_warm": lambda: noise(thermal.table_3),
        "table_4_warm": lambda: noise(thermal.table_4),
        "table_5": lambda: rows_of(table_5(warm()["table_5"])),
        **{name: partial(lambda name: more()[name], name) for name in NOISE},
        "ratios": lambda: rows_of(
            thermal.rows_of_ratios(kept("ratios", lambda: thermal.ratios(runs.parent / CACHE)))
        ),
        "ratio_noise": lambda: f"{law[0]:.1f}",
        "ratio_load": lambda: f"{law[1]:.1f}",
        "ratio_middle": lambda: f"{law[2]:.4f}",
        "table_6": lambda: rows_of(table_6_rows(kept("table_6", lambda: two_grids(data())))),
        "table_6_warm": lambda: rows_of(thermal.rows_of_table_6(warm()["table_6"])),
    }


def percent(values: Sequence[float | None]) -> list[str]:
    """Errors in %."""
    return ["–" if value is None else f"{100 * value:.2f}" for value in values]


def strains(data: Dataset) -> list[list[str]]:
    """Samples, nodes and largest bond strain of each set."""
    rows = []
    for name in data:
        samples = data[name]
        largest = 100 * samples.arrays["max_bond_strain"]
        sizes = [f"{len(samples)}", f"{samples.spacing:g}", f"{samples.interior.sum()}"]
        rows.append([name, *sizes, f"{largest.min():.2f} to {largest.max():.2f}"])
    return rows


def consistency(found: Mapping[str, Any], name: str) -> list[list[str]]:
    """Losses by degree and spacing, then the error of the kernel."""
    table = found[name]
    degrees = (0, 2, 4, 6, 8, 10, 15, 20)
    rows = [["1/r itself", *(f"{value:.2e}" for value in found["true_kernel"])]]
    for number, degree in enumerate(degrees):
        rows.append([f"M = {degree}", *(f"{loss[number]:.2e}" for loss in table["residual"])])
    return [*rows, ["error of K, M = 10", *(f"{e:.3f}" for e in table["kernel_error"])]]


def three_ways(found: Mapping[str, Any], adam: Mapping[str, Any]) -> list[list[str]]:
    """Losses of least squares, then of Adam with quintic weights, α held and learned."""
    rows = []
    names = ("fixed_alpha", "learned_alpha")
    spacings = range(len(found["spacings"]))
    for number, degree in enumerate(adam["degrees"]):
        optimum = found["degrees"].index(degree)
        both = [
            (found[name]["residual"][h][optimum], adam[name]["residual"][h][number])
            for h in spacings
            for name in names
        ]
        rows.append([f"M = {degree}", *(f"{ours:.1e}, {theirs:.1e}" for ours, theirs in both)])
    kernels = [
        (found[name]["kernel_error"][h], adam[name]["kernel_error"][h])
        for h in spacings
        for name in names
    ]
    rows.append(["error of K, M = 10", *(f"{ours:.2f}, {theirs:.2f}" for ours, theirs in kernels)])
    return rows


def table_5(rows: Sequence[Mapping[str, Any]]) -> list[list[str]]:
    """Every fit at 300 K, each size of the loads followed by what is printed of it."""
    return [
        line
        for row in rows
        for line in (
            [thermal.row_of_table_5(row)]
            + [thermal.printed_row(row["factor"])] * (row["reduction"] == "iota")
        )
    ]


def algorithm_1(
    data: Dataset, bounds: str, conditions: str, seed: int, moved: float = 0.0
) -> dict[str, Any]:
    """One run of Algorithm 1: constants, epochs and errors, those of its prediction step beside.

    `moved` multiplies each displacement that is learned from by a random 1 ± moved.
    """
    method = TwoStage(bounds, conditions, outer_iterations=ROUNDS, seed=seed)
    samples = data["train"]
    factors = 1 + moved * np.random.default_rng(0).uniform(-1, 1, samples.u.shape)
    samples = replace(samples, u=samples.u * factors)
    found = learn(samples, horizon=20.0, kernel=Bernstein(10), method=method, progress=True)
    units, sets = found.material.units, {name: data[name] for name in SETS}

    def after(stage: Stage) -> dict[str, Any]:
        model = replace(as_model(stage.parameters, 20.0), units=units)
        row = {"lam": model.lam, "mu": model.mu, "alpha": model.alpha, "epochs": len(stage.loss)}
        return row | errors_of(model, sets)

    prediction, correction = map(after, found.history)
    return correction | {"seed": seed, "prediction": prediction}


def errors_of(model: Any, sets: Mapping[str, Samples]) -> dict[str, float | None]:
    """E_res and E_u of each set in ℓ2, and root mean squares; None where it cannot be solved."""
    row: dict[str, float | None] = {}
    for name, samples in sets.items():
        try:
            table = wp.evaluate(model, samples, allow_uncertified=True, transfer=False)
        except wp.InputError:  # indefinite: nothing is solved
            table = {}
        for key in ("E_res", "E_u", "E_res_rms", "E_u_rms"):
            row[f"{key} {name}"] = table.get(key)
    return row


def row_of_algorithm(name: str, runs: Sequence[Mapping[str, Any]]) -> list[str]:
    """Median constants, then least, median and largest errors over the seeds."""
    cells = [f"{np.median([run[key] for run in runs]):.2f}" for key in ("lam", "mu", "alpha")]
    for key in ALL_ERRORS:
        known = sorted(run[key] for run in runs if run[key] is not None)
        if not known:
            cells.append("refused")
            continue
        text = " / ".join(percent([known[0], float(np.median(known)), known[-1]]))
        cells.append(text + ("" if len(known) == len(runs) else f" ({len(known)} of {len(runs)})"))
    return [name, *cells]


def steps_of_algorithm(runs: Sequence[Mapping[str, Any]]) -> list[list[str]]:
    """Constants, epochs and errors after either step of each run; of the last, u was moved."""
    rows = []
    for run in runs:
        for name, row in (("prediction", run["prediction"]), ("correction", run)):
            constants = [f"{row[key]:.2f}" for key in ("lam", "mu", "alpha")]
            errors = percent([row[key] for key in ALL_ERRORS])
            rows.append([f"{run['seed']}", name, f"{row['epochs']}", *constants, *errors])
    rows[-2][0] = rows[-1][0] = f"{runs[-1]['seed']}, u moved"
    return rows


def ends(runs: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """Between which constants, and errors of displacement in %, the runs end."""
    texts = {}
    for name, keys, digits in (("lam", ("lam",), 2), ("mu", ("mu",), 2), ("E_u", E_U, 1)):
        values = [run[key] for run in runs for key in keys if run[key] is not None]
        values = [100 * value for value in values] if keys is E_U else values
        texts[name] = f"{min(values):.{digits}f} to {max(values):.{digits}f}"
    return texts


def metric(runs: Path, data: Dataset) -> list[list[str]]:
    """Main rows in ℓ2, and as squares of it."""
    names = {
        "linear solid": "model",
        "third order, with energy": "third_order_energy",
        "tensors": "micromodulus",
    }
    rows = []
    for name, file in names.items():
        material = wp.load(runs / "graphene_0K" / f"{file}.json")
        tables = {role: wp.evaluate(material, data[role]) for role in SETS}
        for kind, roles in (("E_res", SETS[:2]), ("E_u", SETS)):
            pairs = [(tables[role][kind], tables[role][f"{kind}_rms"]) for role in roles]
            cells = [f"{100 * value:.2f}, {100 * rms**2:.4f}" for value, rms in pairs]
            rows.append([name, kind, *cells, *["–"] * (len(SETS) - len(cells))])
    return rows


def both_metrics(
    runs: Path, trials: Sequence[Mapping[str, Any]], data: Dataset
) -> list[dict[str, Any]]:
    """Every fit of the sweep with its errors in ℓ2 and as squares."""
    rows = []
    for trial in tqdm(trials, desc="both metrics"):
        model = wp.load(runs / "graphene_0K_sweep" / trial["model"])
        found = errors_of(model, {key: data[key] for key in SETS})
        rows.append({"horizon": trial["horizon"], "degree": trial["degree"], **found})
    return rows


def chosen(trials: Sequence[Mapping[str, Any]]) -> list[list[str]]:
    """δ* and AvgE of every degree by each metric."""
    rows = []
    by_metric: dict[str, list[str]] = {}
    degrees = sorted({trial["degree"] for trial in trials})
    for suffix, power in (("", 1), ("_rms", 2)):
        best, first = [], None
        for degree in degrees:
            fits = [trial for trial in trials if trial["degree"] == degree]
            fit = min(fits, key=lambda trial: trial[f"E_res{suffix} train"])
            keys = [
                f"{kind}{suffix} {set}" for set in ("train", "val") for kind in ("E_res", "E_u")
            ]
            numbers = np.array([fit[key] for key in keys]) ** power
            first = numbers if first is None else first
            best.append(f"{fit['horizon']:g}, {np.mean(numbers / first):.4f}")
        by_metric[suffix] = best
    for number, degree in enumerate(degrees):
        printed = PRINTED_TABLE_3.get(degree)
        beside = "–" if printed is None else f"{printed[0]:g}, {printed[-1]:.4f}"
        rows.append([f"{degree}", *(by_metric[key][number] for key in by_metric), beside])
    return rows


def table_3(trial: Mapping[str, Any], average: float) -> list[str]:
    """A degree at its δ*: here, and printed."""
    ours = [f"{trial['horizon']:g}", *percent([trial[key] for key in ERRORS]), f"{average:.4f}"]
    theirs = [f"{value:g}" for value in PRINTED_TABLE_3[trial["degree"]]]
    return [f"{trial['degree']}", *(f"{a} ({b})" for a, b in zip(ours, theirs))]


def pairs(trials: Sequence[Mapping[str, Any]]) -> list[list[str]]:
    """E_u on validation of every δ and M."""
    degrees = sorted({trial["degree"] for trial in trials})
    found = {(t["horizon"], t["degree"]): t["E_u_val"] for t in trials}
    horizons = sorted({trial["horizon"] for trial in trials})
    return [[f"{h:g}", *percent([found[h, M] for M in degrees])] for h in horizons]


def table_4(runs: Path, trials: Mapping[str, Any], data: Dataset) -> list[list[str]]:
    """Constants and errors of the choice, of the printed model and of the potential."""
    trial = trials["printed_choice"]
    model = wp.load(runs / "graphene_0K_sweep" / trial["model"])
    table = wp.evaluate(model, data["test"], transfer=False)
    constants = [model.alpha, model.lam, model.mu, model.E, model.nu]
    truth = data.provenance["truth"]
    own = [f"{truth[key]:.4f}" for key in ("lambda", "mu", "E", "nu")]
    errors = percent([trial[key] for key in (*ERRORS, "E_u_test")])
    here = [f"here, δ = {trial['horizon']:g} Å", f"{trial['degree']}"]
    here += [*(f"{value:.4f}" for value in constants), *errors[:4]]
    here += [f"{1e3 * table['E_res_abs']:.3f} GPa/Å", errors[4]]
    M, *numbers = PRINTED_TABLE_4
    printed = ["printed", f"{M}", *(f"{value:g}" for value in numbers[:-1])]
    printed += ["0.203", f"{numbers[-1]:g}"]
    return [here, printed, ["the potential's own", "–", "–", *own, *6 * ["–"]]]


def two_grids(data: Dataset) -> dict[str, Any]:
    """One fit at δ = 12.5 Å to both grids, on either."""
    both = [data["train"], data["train_fine"]]
    model = learn(both, 12.5, Bernstein(10), method=Optimum(moduli=None)).material
    names = ("val", "test", "val_fine", "test_fine")
    absolute = {name: wp.evaluate(model, data[name])["E_res_abs"] for name in ("test", "test_fine")}
    return {**errors_of(model, {name: data[name] for name in names}), "absolute": absolute}


def table_6_rows(found: Mapping[str, Any]) -> list[list[str]]:
    """Both rows of Table 6."""
    printed = {"_fine": (16.19, 8.01, "2.95", 8.44), "": (13.24, 9.29, "0.197", 7.80)}
    rows = []
    for end, spacing in (("_fine", "2.5"), ("", "5")):
        ours = [
            *percent([found[f"E_res val{end}"], found[f"E_u val{end}"]]),
            f"{1e3 * found['absolute'][f'test{end}']:.3f} GPa/Å",
            *percent([found[f"E_u test{end}"]]),
        ]
        rows.append([f"{spacing} Å", *(f"{a} ({b})" for a, b in zip(ours, printed[end]))])
    return rows
