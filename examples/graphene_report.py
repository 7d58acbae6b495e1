"""Figures, metrics and report of the graphene example."""

from __future__ import annotations

import operator
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from warp_peri import plots
from warp_peri.files.whole import whole_file, write_text
from warp_peri.learning.result import Fit
from warp_peri.learning.uncertainty import Uncertainty
from warp_peri.models.lps import Model
from warp_peri.points.samples import Samples
from warp_peri.statics.solve import solve

PAPER = {
    "You et al. 2021, LPS": {
        "E_res": {"train": 9.81, "val": 13.28},
        "E_u": {"train": 11.72, "val": 7.16, "test": 6.75},
    },
    "Jafarzadeh et al. 2024, PNO": {
        "E_res": {"train": 7.89, "val": 10.23},
        "E_u": {"train": 10.00, "val": 2.78, "test": 3.80},
    },
}
"""Errors printed in the papers at h = 5 Å, δ = 20 Å, 0 K [%]."""

PAPER_300K = {
    "You et al. 2021, LPS, 300 K": {
        "E_res": {"train": 9.82, "val": 18.08},
        "E_u": {"train": 13.16, "val": 8.88, "test": 9.21},
    }
}
"""The same at 300 K, against the paper's own noisy displacements."""

PAPER_CONSTANTS = {"lambda": -0.4796, "mu": 0.7978, "E": 0.91, "nu": -0.4297}
SAME_OPTIMUM = 1e-5
"""Starts agree when what they reach differs by less, relative."""
ROLES = {"train": "training", "val": "validation", "test": "disks"}


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure whole or not at all, and close it."""
    with whole_file(path) as temporary:
        figure.savefig(temporary, dpi=150, bbox_inches="tight")
    plt.close(figure)


def draw_fit(folder: Path, fit: Fit, spacing: float, sure: Uncertainty | None = None) -> None:
    """influence.png, with a band where the noise is known, and loss.png."""
    figure, ax = plt.subplots(figsize=(6.4, 4.2))
    plots.influence_function(fit.model, spacing=spacing, ax=ax, sure=sure)
    ax.set_title(f"Influence function, δ = {fit.model.horizon:g} Å, M = {fit.model.degree}")
    save_figure(figure, folder / "influence.png")

    figure, ax = plt.subplots(figsize=(6.4, 4.2))
    plots.loss_by_stage(fit.history, ax=ax)
    ax.set_title("Training loss by stage")
    save_figure(figure, folder / "loss.png")


def draw_disks(
    path: Path,
    model: Model,
    points: Samples,
    table: dict[str, Any],
    *,
    worst: bool = False,
) -> None:
    """u₁ on the disks or the worst of them: molecular data, model and error, a row each."""
    solved = solve(model, points, points.loads, points.u, allow_uncertified=True)
    errors, inside = table["E_u_samples"], points.interior
    samples = [int(np.argmax(errors))] if worst else list(range(len(points)))
    rows = len(samples)
    figure, axes = plt.subplots(
        rows, 3, figsize=(9.5, 2.7 * rows + 0.4), squeeze=False, layout="constrained"
    )
    names = points.arrays.get("load_id", np.arange(1, len(points) + 1))
    for s, row in zip(samples, axes):
        truth, predicted = points.u[s, inside, 0], solved[s, inside, 0]
        error = 1000 * (predicted - truth)
        limit, small = np.abs([truth, predicted]).max(), np.abs(error).max()
        plots.node_field(points.x[inside], truth, limit=limit, ax=row[0])
        mesh = plots.node_field(points.x[inside], predicted, limit=limit, ax=row[1])
        figure.colorbar(mesh, ax=row[:2], label="u₁ [Å]")
        mesh = plots.node_field(points.x[inside], error, limit=small, ax=row[2])
        figure.colorbar(mesh, ax=row[2], label="error of u₁ [mÅ]")
        for ax, title in zip(row, ("molecular data", "model", "model − molecular")):
            ax.set_title(title, fontsize="medium")
            ax.set_xlabel("x₁ [Å]")
        row[0].set_ylabel(f"{names[s]}: E_u = {100 * errors[s]:.2f} %\nx₂ [Å]")
    disk = "disks" if rows > 1 else "a disk"
    figure.suptitle(f"Displacement on {disk} the fit never saw (interior nodes)")
    save_figure(figure, path)


def draw_waves(path: Path, points: Samples, table: dict[str, Any]) -> None:
    """Errors of the training samples against their wave number."""
    figure, ax = plt.subplots(figsize=(6.4, 4.2))
    errors = {"E_res": table["E_res_samples"], "E_u": table["E_u_samples"]}
    plots.errors_by_wave_number(points.arrays["wave_number"], errors, ax=ax)
    ax.set_title("Errors of the training samples")
    save_figure(figure, path)


def deviations(sure: Uncertainty) -> dict[str, float]:
    """Standard deviations of the constants by noise."""
    quantities = {"lambda": "lam", "mu": "mu", "E": "E", "nu": "nu"}
    return {
        key: float(sure.deviation(operator.attrgetter(name))) for key, name in quantities.items()
    }


def metrics(
    fit: Fit, tables: dict[str, dict[str, Any]], truth: dict[str, float] | None
) -> dict[str, Any]:
    """Contents of metrics.json, without the seconds; errors are fractions."""
    model, figures = fit.model, fit.certificate.figures()
    certificate = ("symbol_min", "symbol_bound", "gamma_min", "inf_sup_min", "gamma_minus_2phi_min")
    return {
        "E_res": {role: table["E_res"] for role, table in tables.items()},
        "E_u": {role: table["E_u"] for role, table in tables.items()},
        "E_res_abs": {role: table["E_res_abs"] for role, table in tables.items()},
        "lambda": model.lam,
        "mu": model.mu,
        "E": model.E,
        "nu": model.nu,
        "alpha": model.alpha,
        "D": model.D,
        "horizon": model.horizon,
        "degree": model.degree,
        "moduli": fit.moduli[0],
        "truth": truth,
        "stages": [
            {"name": stage.name, "E_res_train": stage.E_res_train, "seconds": stage.seconds}
            for stage in fit.history
        ],
        "starts": fit.starts,
        "loss": {"name": fit.loss.name, "reason": fit.loss.reason},
        "certificate": {key: figures[key] for key in certificate},
        "statement": fit.certificate.statement,
        "certified": bool(model.certified_on),
    }


def write_report(path: Path, numbers: dict[str, Any], command: str) -> None:
    """report.md: the errors beside the printed ones, constants, stages, certificate, times."""
    temperature = numbers["temperature"]
    roles = [role for role in ROLES if role in numbers["E_u"]]
    columns = [("E_res", r) for r in roles if r != "test"] + [("E_u", r) for r in roles]
    lines = [
        f"# Graphene at {temperature:g} K",
        "",
        f"Made by `{command}`. Errors are means over samples of relative ℓ2 errors [%].",
        "",
        "| | " + " | ".join(f"{e} {ROLES[r]}" for e, r in columns) + " |",
        "|---" * (len(columns) + 1) + "|",
        f"| this run, δ = {numbers['horizon']:g} Å, M = {numbers['degree']} | "
        + " | ".join(f"{100 * numbers[e][r]:.2f}" for e, r in columns)
        + " |",
    ]
    for name, printed in (PAPER if temperature == 0 else PAPER_300K).items():
        values = [printed[e].get(r) for e, r in columns]
        cells = ("–" if value is None else f"{value:.2f}" for value in values)
        lines.append(f"| {name} (as printed) | " + " | ".join(cells) + " |")
    if "test" in roles:
        lines += [
            "",
            f"Residual on the disks, absolute: {numbers['E_res_abs']['test']:.2e} TPa/Å "
            f"(relative {100 * numbers['E_res']['test']:.0f} %: the load there is only what "
            "the smoothing reaches in from the rim).",
        ]
    lines += ["", "## Constants [TPa]", "", "| | λ | μ | E | ν |", "|---|---|---|---|---|"]
    keys = ("lambda", "mu", "E", "nu")
    rows = {"learned": numbers, "the potential's own": numbers["truth"] or {}}
    if "deviation" in numbers:
        rows["standard deviation by noise"] = numbers["deviation"]
    if temperature == 0:
        rows["You et al. 2021, learned"] = PAPER_CONSTANTS
    for name, row in rows.items():
        cells = (f"{row[key]:.4f}" if key in row else "–" for key in keys)
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    moduli = ", ".join(f"{key} = {value:.4f}" for key, value in numbers["moduli"].items())
    lines += ["", f"Long-wave moduli of the discrete operator: {moduli}."]
    if numbers["truth"]:
        lam, mu = numbers["truth"]["lambda"], numbers["truth"]["mu"]
        lines[-1] += f" The potential's: C11 = {lam + 2 * mu:.4f}, C12 = {lam:.4f}, C44 = {mu:.4f}."
    lines += ["", f"Loss: {numbers['loss']['name']} ({numbers['loss']['reason']})."]
    lines += ["", "## Stages", "", "| stage | E_res training [%] | seconds |", "|---|---|---|"]
    for stage in numbers["stages"]:
        error = 100 * stage["E_res_train"]
        lines.append(f"| {stage['name']} | {error:.2f} | {stage['seconds']:.1f} |")
    if starts := numbers["starts"]:
        reached = ", ".join(f"{100 * value:.4f} % from {name}" for name, value in starts.items())
        agree = max(starts.values()) - min(starts.values()) <= SAME_OPTIMUM * min(starts.values())
        verdict = "one optimum" if agree else "DIFFERENT optima, the best is kept"
        lines += ["", f"‖L u − b‖/‖b‖ reached in stage 3: {reached} ({verdict})."]
    certificate = numbers["certificate"]
    verdict = "holds" if numbers["certified"] else "DOES NOT HOLD"
    lines += [
        "",
        f"## Certificate: {verdict}",
        "",
        numbers["statement"],
        "",
        f"- smallest D(k)/s(k) found over the Brillouin zone: {certificate['symbol_min']:.5f} TPa; "
        f"proven: at least {certificate['symbol_bound']:.5f} TPa",
        f"- Λmin(Γ) on the training domain: {_number(certificate['gamma_min'])} Å⁻²",
        f"- Λmin(ΦΓ⁻¹Φᵗ), zeros aside: {_number(certificate['inf_sup_min'])} (not asked for)",
        f"- Λmin(Γ − 2ΦᵗΦ): {_number(certificate['gamma_minus_2phi_min'])} Å⁻² "
        "(asked for with `--conditions paper`)",
        "",
        "## Seconds",
        "",
        ", ".join(f"{phase} {value:.1f}" for phase, value in numbers["seconds"].items()),
        "",
        "Figures: `influence.png`, `loss.png`, `disks.png`, `disk.png` (the worst), `waves.png`.",
    ]
    write_text(path, "\n".join(lines) + "\n")


def _number(value: float | None) -> str:
    return "not defined" if value is None else f"{value:.3e}"
