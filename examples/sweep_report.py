"""Tables 3 and 4 and figures 6 and 7 (left) of You et al. (2021), made again from a sweep."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import matplotlib.pyplot as plt
from matplotlib.ticker import NullFormatter, ScalarFormatter

from examples.figures import name_lines, panels, save_figure
from examples.prose import fill, rows_of
from warp_peri import LPSMaterial, load, plots
from warp_peri.files.atomic import write_json, write_text
from warp_peri.materials.lps_sweep import COST_TOLERANCE, Trial
from warp_peri.methods import SweepResult

PRINTED_TABLE_3 = {
    0: (12.5, 13.91, 17.54, 16.31, 14.49, 1.0),
    5: (12.5, 10.42, 12.19, 13.02, 7.69, 0.6933),
    10: (20.0, 9.81, 11.72, 13.28, 7.16, 0.6704),
    15: (22.5, 9.80, 11.61, 13.50, 7.22, 0.6731),
    20: (25.0, 9.75, 11.89, 13.53, 7.00, 0.6729),
}
"""δ* [Å], E_res train, E_u train, E_res val, E_u val [%], AvgE by degree, as printed (0 K)."""

PRINTED_TABLE_4 = (10, 2.8335, -0.4796, 0.7978, 0.91, -0.4297, 9.81, 11.72, 13.28, 7.16, 6.75)
"""M, α, λ, μ, E [TPa], ν, then E_res train, E_u train, E_res val, E_u val, E_u test [%]."""

ERRORS = ("E_res_train", "E_u_train", "E_res_val", "E_u_val")


def write_sweep(
    folder: Path,
    trials: SweepResult,
    *,
    spacing: float,
    truth: dict[str, float] | None,
    command: str,
) -> None:
    """sweep.json, sweep.md, sweep_errors.png (figure 6) and sweep_kernels.png (figure 7)."""
    write_json(
        folder / "sweep.json",
        {
            "trials": [asdict(trial) for trial in trials.trials],
            "by_degree": [asdict(trial) for trial in trials.by_degree],
            "AvgE": trials.average,
            "printed_choice": asdict(trials.printed),
            "cheapest_choice": asdict(trials.cheapest),
        },
    )
    write_text(folder / "sweep.md", _tables(folder, trials, truth, command))
    draw_errors(folder / "sweep_errors.png", trials.by_degree)
    figure, ax = plt.subplots(figsize=(6.4, 4.2))
    plots.influence_function(load(folder / trials.printed.model), spacing=spacing, ax=ax)
    ax.set_title(f"Chosen influence function: {_name(trials.printed)} (figure 7, left)")
    save_figure(figure, folder / "sweep_kernels.png")


def draw_errors(path: Path, trials: Sequence[Trial]) -> None:
    """Figure 6: errors by degree, here and printed."""
    figure, axes = panels(10.5, 4, count=2)
    degrees = [trial.degree for trial in trials]
    known = [M for M in degrees if M in PRINTED_TABLE_3]
    for ax, kind, title in zip(axes, ("E_res", "E_u"), ("load", "displacement")):
        for number, (end, name) in enumerate((("train", "training"), ("val", "validation"))):
            column = 1 + ERRORS.index(f"{kind}_{end}")
            ours = [100 * getattr(trial, f"{kind}_{end}") for trial in trials]
            printed = [PRINTED_TABLE_3[M][column] for M in known]
            for x, y, style, where in (
                (degrees, ours, "o-", "here"),
                (known, printed, "s--", "printed"),
            ):
                ax.semilogy(x, y, style, color=f"C{number}", label=f"{name}, {where}")
        ax.set(xlabel="degree of the influence function", ylabel="relative error [%]")
        ax.set(title=f"error of the {title}", xticks=degrees, xlim=(min(degrees) - 1, 31))
        ax.yaxis.set_major_formatter(ScalarFormatter())
        ax.yaxis.set_minor_formatter(NullFormatter())
        ax.set_yticks([1, 2, 5, 10])
        name_lines(ax)
    figure.suptitle("Errors fall with the degree, and end far below the printed ones (0 K)")
    save_figure(figure, path)


def _name(trial: Trial) -> str:
    return f"δ = {trial.horizon:g} Å, M = {trial.degree}"


def _tables(folder: Path, trials: SweepResult, truth: dict[str, float] | None, command: str) -> str:
    chosen = {"smallest AvgE": trials.printed, "cheapest": trials.cheapest}
    models = {name: load(folder / trial.model) for name, trial in chosen.items()}
    table_4 = [_table_4(name, trial, models[name]) for name, trial in chosen.items()]
    table_4.append(["printed", *(f"{value:g}" for value in PRINTED_TABLE_4)])
    if truth:
        own = [f"{truth[key]:.4f}" for key in ("lambda", "mu", "E", "nu")]
        table_4.append(["the potential's own", "–", "–", *own, *5 * [""]])
    return fill(
        Path(__file__).with_suffix(".md"),
        command=command,
        table_3=rows_of(map(_table_3, trials.by_degree, trials.average)),
        printed=_name(trials.printed),
        tolerance=COST_TOLERANCE,
        cheapest=_name(trials.cheapest),
        bonds=trials.cheapest.bonds,
        table_4=rows_of(table_4),
        trials=rows_of(map(_trial, trials.trials)),
    )


def _table_3(trial: Trial, average: float) -> list[str]:
    """A degree at its δ*, and what is printed."""
    printed = PRINTED_TABLE_3.get(trial.degree)
    beside = "–" if printed is None else ", ".join(f"{value:g}" for value in printed)
    return [f"{trial.degree}", f"{trial.horizon:g}", *_errors(trial), f"{average:.4f}", beside]


def _table_4(name: str, trial: Trial, model: LPSMaterial) -> list[str]:
    """A choice: its constants and errors."""
    constants = (model.alpha, model.lam, model.mu, model.E, model.nu)
    numbers = [f"{value:.4f}" for value in constants]
    return [name, f"{trial.degree}", *numbers, *_errors(trial), _test(trial)]


def _trial(trial: Trial) -> list[str]:
    """One fit."""
    numbers = [f"{value:.4f}" for value in (trial.lam, trial.mu, trial.symbol_bound)]
    names = [f"{trial.horizon:g}", f"{trial.degree}", f"{trial.bonds}"]
    return [*names, *_errors(trial), _test(trial), *numbers]


def _errors(trial: Trial) -> list[str]:
    return [f"{100 * getattr(trial, name):.2f}" for name in ERRORS]


def _test(trial: Trial) -> str:
    return "–" if trial.E_u_test is None else f"{100 * trial.E_u_test:.2f}"
