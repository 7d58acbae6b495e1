"""Figures, metrics and report of the graphene example."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np

from examples.figures import panels, save_figure
from examples.prose import fill, table
from warp_peri import Dirichlet, LPSMaterial, Samples, plots, solve
from warp_peri.files.atomic import write_text
from warp_peri.fitting.evaluate import Run
from warp_peri.fitting.result import Fit

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
CERTIFICATE = ("symbol_min", "symbol_bound", "gamma_min", "inf_sup_min", "gamma_minus_2phi_min")
"""Figures of the certificate that are reported."""
TEMPLATE = Path(__file__).with_suffix(".md")
CONDITIONS = {"direct": "LPS, positive symbol alone", "paper": "LPS, conditions (i)–(iii)"}
LOCAL = {
    "true": "local elasticity, exact constants",
    "learned": "local elasticity, constants as learned",
}
ROLES = {"train": "training loads", "val": "periodic sheet", "test": "free disks"}
FORMS = {"energy": "with energy", "filtered": "deconvolved"}
ERRORS = {"E_res": "residual", "E_u": "displacement"}


def draw_fit(folder: Path, fit: Fit, spacing: float) -> None:
    """influence.png and loss.png."""
    figure, ax = plt.subplots(figsize=(6.4, 4.2))
    plots.influence_function(fit.material, spacing=spacing, ax=ax)
    values = fit.material.influence(np.linspace(spacing, fit.material.horizon, 1000))
    does = "changes sign" if values.min() < 0 else "is positive"
    ax.set_title(f"The learned influence function {does}")
    save_figure(figure, folder / "influence.png")

    figure, ax = plt.subplots(figsize=(6.4, 4.2))
    plots.loss_by_stage(fit.history, ax=ax)
    ax.set_title("The training loss falls to the constrained optimum")
    save_figure(figure, folder / "loss.png")


def draw_disks(
    path: Path, model: LPSMaterial, points: Samples, table: dict[str, Any], *, worst: bool = False
) -> None:
    """u₁ on the disks or the worst of them: molecular data, model and error, a row each."""
    solved = solve(model, Dirichlet(points, points.loads, points.u), allow_uncertified=True).u
    errors, inside = table["E_u_samples"], points.interior
    samples = [int(np.argmax(errors))] if worst else list(range(len(points)))
    rows = len(samples)
    figure, axes = panels(9.5, 2.7 * rows + 0.4, count=3, rows=rows, squeeze=False)
    for s, row in zip(samples, axes):
        truth, predicted = points.u[s, inside, 0], solved[s, inside, 0]
        error = 1000 * (predicted - truth)
        limit, small = np.abs([truth, predicted]).max(), np.abs(error).max()
        plots.node_field(points.x[inside], truth, limit=limit, ax=row[0])
        mesh = plots.node_field(points.x[inside], predicted, limit=limit, ax=row[1])
        figure.colorbar(mesh, ax=row[1], label="u₁ [Å]")
        mesh = plots.node_field(points.x[inside], error, limit=small, ax=row[2])
        figure.colorbar(mesh, ax=row[2], label="error of u₁ [mÅ]")
        for ax, title in zip(row, ("atoms", "model", f"error {100 * errors[s]:.2f} %")):
            ax.set_title(title, fontsize="medium")
            ax.set_xlabel("x₁ [Å]")
        row[0].set_ylabel(f"load {s + 1}\nx₂ [Å]")
    disk = "free disks" if rows > 1 else "a free disk"
    mean = 100 * np.mean([errors[s] for s in samples])
    figure.suptitle(f"The model predicts {disk} that no fit saw, with an error of {mean:.1f} %")
    save_figure(figure, path)


def draw_waves(
    path: Path, points: Samples, table: dict[str, Any], local: np.ndarray | None
) -> None:
    """Errors on the training samples against their wave number, local elasticity's beside."""
    figure, ax = plt.subplots(figsize=(6.4, 4.2))
    errors = {"load, model": table["E_res_samples"], "displacement, model": table["E_u_samples"]}
    said = f"On the training loads displacement errs by {100 * np.mean(table['E_u_samples']):.1f} %"
    if local is not None:
        errors["displacement, local elasticity"] = local
        said += f", by local elasticity {100 * np.mean(local):.1f} %"
    plots.errors_by_wave_number(points.arrays["wave_number"], errors, ax=ax)
    ax.set_title(said, fontsize="medium")
    save_figure(figure, path)


def draw(
    folder: Path,
    run: Run,
    sets: Mapping[str, Samples],
    spacing: float,
    local: Mapping[str, Mapping[str, np.ndarray]],
) -> None:
    """Every figure of the main job; `local`: errors of local elasticity, if there are any."""
    draw_fit(folder, run.fit, spacing)
    if "test" in sets:
        for name, worst in (("disks.png", False), ("disk.png", True)):
            draw_disks(
                folder / name, run.fit.material, sets["test"], run.tables["test"], worst=worst
            )
    if "wave_number" in sets["train"].arrays:
        beside = local["true"]["train"] if "true" in local else None
        draw_waves(folder / "waves.png", sets["train"], run.tables["train"], beside)


def metrics(run: Run, provenance: Mapping[str, Any]) -> dict[str, Any]:
    """Contents of metrics.json, without the seconds; errors are fractions.

    `provenance` is that of the data: their temperature, and the potential's own constants.
    """
    fit = run.fit
    model, figures = fit.material, fit.certificate.figures()
    numbers = {
        "E_res": run.mean("E_res"),
        "E_u": run.mean("E_u"),
        "E_res_abs": run.mean("E_res_abs"),
        "E_u_samples": {
            role: [float(error) for error in table["E_u_samples"]]
            for role, table in run.tables.items()
        },
        "lambda": model.lam,
        "mu": model.mu,
        "E": model.E,
        "nu": model.nu,
        "alpha": model.alpha,
        "D": model.D,
        "horizon": model.horizon,
        "degree": model.degree,
        "moduli": fit.moduli[0],
        "held": fit.law.method.moduli,
        "degrees": {f"{degree}": error for degree, error in fit.degrees.items()},
        "truth": provenance.get("truth"),
        "stages": [
            {"name": stage.name, "E_res_train": stage.E_res_train, "seconds": stage.seconds}
            for stage in fit.history
        ],
        "starts": fit.starts,
        "loss": {"name": fit.loss.name, "reason": fit.loss.reason},
        "certificate": {key: figures[key] for key in CERTIFICATE},
        "statement": fit.certificate.statement,
        "certified": bool(model.certified_on),
        "temperature": provenance.get("temperature", 0.0),
        "conditions": {key: figures[key] for key in CERTIFICATE[2:]},
    }
    if fit.history[0].name == "1 Adam" and not provenance.get("temperature"):
        first, last = fit.history[0], fit.history[1]
        numbers["augmented_lagrangian"] = {
            "loss_over_optimum": first.loss[-1] / last.loss[-1],
            "loss": first.loss[-1],
            "loss_of_optimum": last.loss[-1],
            "gradients": first.steps,
            "rounds": len(first.loss) - 1,
            "seconds": first.seconds,
        }
    return numbers


def write_report(path: Path, numbers: dict[str, Any], data: Path, command: str) -> None:
    """report.md: what there is, how good, what next; details below a line."""
    good, proof, moduli = first_lines(numbers)
    text = fill(
        TEMPLATE,
        **numbers,
        command=command,
        out=shown(path.parent),
        data=shown(data),
        loads=len(numbers["E_u_samples"]["train"]),
        best=best(numbers),
        good=f"{good}.",
        proof=f"{proof}.",
        constants_line=f"{moduli}.",
        short_table=error_table(numbers, short=True),
        error_table=error_table(numbers),
        others=others_line(numbers),
        disks=disks_line(numbers),
        conditions_line=conditions_line(numbers),
        constants=constants_table(numbers),
        moduli_text=", ".join(f"{key} = {value:.4f}" for key, value in numbers["moduli"].items()),
        potential=potential_line(numbers["truth"]),
        stage_table=stage_table(numbers["stages"]),
        agreement=degree_line(numbers) + agreement_line(numbers["starts"]),
        adam=adam_line(numbers.get("augmented_lagrangian")) + alpha_line(numbers.get("alphas")),
        verdict="holds" if numbers["certified"] else "DOES NOT HOLD",
        times=", ".join(f"{phase} {value:.1f}" for phase, value in numbers["seconds"].items()),
    )
    write_text(path, text)


def shown(path: Path) -> str:
    """A path as it is typed from where the job runs."""
    here = Path.cwd()
    return str(path.relative_to(here) if path.is_relative_to(here) else path)


def best(numbers: dict[str, Any]) -> str:
    """The set that says how good the model is: free disks, or what there is in their place."""
    return next(role for role in reversed(ROLES) if role in numbers["E_u"])


def first_lines(numbers: dict[str, Any]) -> list[str]:
    """How good the model is, whether it is proven, and its moduli beside the potential's."""
    role = best(numbers)
    errors = [100 * error for error in numbers["E_u_samples"][role]]
    bodies = {
        "train": f"the {len(errors)} training loads",
        "val": f"{len(errors)} loads of a periodic sheet that the fit never saw",
        "test": f"{len(errors)} free disks that the fit never saw",
    }
    mean = f"{100 * numbers['E_u'][role]:.2f} % ({min(errors):.1f} to {max(errors):.1f} %)"
    names = {"E": "Young's modulus", "mu": "shear modulus"}
    own = {
        key: f" (potential {1e3 * numbers['truth'][key]:.0f} GPa)" if numbers["truth"] else ""
        for key in names
    }
    moduli = (f"{name} {1e3 * numbers[key]:.0f} GPa{own[key]}" for key, name in names.items())
    proof = "Proven: the model has exactly one equilibrium for every load"
    return [
        f"On {bodies[role]} the displacement has an error of {mean}",
        proof if numbers["certified"] else "NOTHING IS PROVEN: solves refuse the model",
        ", ".join(moduli),
    ]


def error_table(numbers: dict[str, Any], *, short: bool = False) -> str:
    """Errors of each model and those printed in the papers [%].

    `short` leaves displacement under loads that no fit saw, and a row for each kind of model.
    """
    roles = [role for role in ROLES if role in numbers["E_u"]]
    if short:
        columns = [("E_u", role) for role in roles if role != "train" or roles == ["train"]]
    else:
        columns = [("E_res", role) for role in roles if role != "test"]
        columns += [("E_u", role) for role in roles]
    models = {"linear peridynamic solid (LPS)": numbers}
    if (other := numbers.get("other")) and not short:
        models[CONDITIONS[other["conditions"]]] = other
    if crystal := numbers.get("micromodulus"):
        models[f"crystal model, {crystal['bonds']} bonds"] = crystal
    for form, row in numbers.get("third_order", {}).items():
        models[f"third-order model, {row['bonds']} bonds, {FORMS[form]}"] = row
    for name, local in numbers.get("local", {}).items():
        if name == "true" or not short:
            models[LOCAL[name]] = {"E_u": local}
    rows = [[name, *(_cell(errors, *column, 100) for column in columns)]
            for name, errors in models.items()]  # fmt: skip
    for name, printed in (PAPER if numbers["temperature"] == 0 else PAPER_300K).items():
        rows.append([f"{name} †", *(_cell(printed, *column, 1) for column in columns)])
    return table(["", *(f"{ERRORS[error]}, {ROLES[role]}" for error, role in columns)], rows)


def _cell(errors: dict[str, Any], error: str, role: str, factor: float) -> str:
    value = errors.get(error, {}).get(role)
    return "–" if value is None else f"{factor * value:.2f}"


def conditions_line(numbers: dict[str, Any]) -> str:
    """Which conditions to ask for when, where both were."""
    if "other" not in numbers:
        return ""
    proofs = {numbers["other"]["conditions"]: numbers["other"]}
    paper, direct = (proofs.get(kind, numbers["certificate"]) for kind in ("paper", "direct"))
    third = "" if direct["gamma_minus_2phi_min"] >= 0 else ", and (iii) does not hold"
    return (
        f"\nConditions (i)–(iii) prove a stiffness of {paper['symbol_bound']:.3f} TPa: take them "
        "for answers that are stable under any load. A positive symbol alone proves "
        f"{direct['symbol_bound']:.3f} TPa{third}: take it where the residual is what counts.\n"
    )


def others_line(numbers: dict[str, Any]) -> str:
    """What the other two models are for, where they were learned."""
    if "third_order" not in numbers:
        return ""
    energy, filtered = numbers["third_order"].values()
    constants = ", ".join(f"{name} = {value:.3f}" for name, value in energy["constants"].items())
    return (
        f"- Strains above 1 %: `third_order_energy.json`, a crystal model with {constants} TPa. At "
        f"most one solution has strains up to {100 * energy['proven_strain']:.1f} %. "
        "`third_order_filtered.json` undoes the smoothing of the data, has no energy and is proven "
        f"to {100 * filtered['proven_strain']:.1f} %.\n"
        "- Directions and speed: `micromodulus.json`, a crystal model that need not be isotropic."
        "\n"
    )


def disks_line(numbers: dict[str, Any]) -> str:
    """What the residual on the disks is worth, where there are disks."""
    if "test" not in numbers["E_u"]:
        return ""
    return (
        f"\nThe residual on the disks is {numbers['E_res_abs']['test']:.2e} TPa/Å, "
        f"{100 * numbers['E_res']['test']:.0f} % of a load that smoothing alone brings in from "
        "the rim."
    )


def constants_table(numbers: dict[str, Any]) -> str:
    """The learned constants beside the potential's own and the paper's [TPa]."""
    sources = {"learned": numbers, "potential": numbers["truth"] or {}}
    if numbers["temperature"] == 0:
        sources["You et al. 2021, learned"] = PAPER_CONSTANTS
    keys = ("lambda", "mu", "E", "nu")
    rows = [
        [name, *(f"{source[key]:.4f}" if key in source else "–" for key in keys)]
        for name, source in sources.items()
    ]
    return table(["", "λ", "μ", "E", "ν"], rows)


def potential_line(truth: dict[str, float] | None) -> str:
    """Long-wave moduli of the potential, where they are known."""
    if not truth:
        return ""
    lam, mu = truth["lambda"], truth["mu"]
    return f" The potential has C11 = {lam + 2 * mu:.4f}, C12 = {lam:.4f}, C44 = {mu:.4f}."


def stage_table(stages: list[dict[str, Any]]) -> str:
    """What each stage of the fit reached, and how long it took."""
    rows = [
        [stage["name"], f"{100 * stage['E_res_train']:.2f}", f"{stage['seconds']:.1f}"]
        for stage in stages
    ]
    return table(["stage", "residual, training loads [%]", "seconds"], rows)


def adam_line(reached: dict[str, float] | None) -> str:
    """How near Adam with the augmented Lagrangian came to the optimum, where it was run."""
    if reached is None:
        return ""
    return (
        "\nAdam with the augmented Lagrangian on the operator, by itself: a loss of "
        f"{reached['loss']:.4e}, which the optimum lowers to {reached['loss_of_optimum']:.4e} "
        f"({reached['loss_over_optimum']:.6f} times), in {reached['seconds']:.1f} s and "
        f"{reached['gradients']} gradients of the operator by Warp, each over all loads; each "
        f"of {reached['rounds']} rounds applies it once more.\n"
    )


def alpha_line(alphas: list[float] | None) -> str:
    """Which exponents fit as well, where they were tried."""
    if not alphas:
        return ""
    return (
        f"\nKernels of any α from {alphas[0]:g} to {alphas[-1]:g} come within 1 % of the least "
        "loss: α and D say much the same.\n"
    )


def degree_line(numbers: dict[str, Any]) -> str:
    """How the degree was chosen, where it was."""
    if not (degrees := numbers["degrees"]):
        return ""
    left = ", ".join(f"{100 * error:.2f} % by degree {M}" for M, error in degrees.items())
    return (
        f"\nThe degree is {numbers['degree']}, the smallest whose error on loads left out of the "
        f"fit, a fifth at a time, is within 2 % of the best ({left}).\n"
    )


def agreement_line(starts: dict[str, float]) -> str:
    """Whether the starts of stage 3 reached one optimum, where it was run."""
    if not starts:
        return ""
    reached = ", ".join(f"{100 * value:.4f} % from {name}" for name, value in starts.items())
    agree = max(starts.values()) - min(starts.values()) <= SAME_OPTIMUM * min(starts.values())
    verdict = "one optimum" if agree else "DIFFERENT optima, the best is kept"
    return f"\n‖L u − b‖/‖b‖ reached in stage 3: {reached} ({verdict}).\n"
