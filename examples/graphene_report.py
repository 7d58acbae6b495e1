"""Figures, metrics and report of the graphene example."""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from examples.figures import panels, save_figure
from examples.prose import table
from warp_peri import Dataset, Dirichlet, Samples, plots, solve
from warp_peri.cli.train import radius_of
from warp_peri.files.atomic import write_text
from warp_peri.fitting.evaluate import Run
from warp_peri.materials.third_order import CUBIC

RECORD = Path(__file__).parent.parent / "docs" / "record" / "graphene.json"
"""Errors of each model on graphene [%], the papers' among them."""
COLUMNS = [("E_res", "train"), ("E_res", "val"), ("E_u", "train"), ("E_u", "val"), ("E_u", "test")]
PAPER_CONSTANTS = {"lambda": -0.4796, "mu": 0.7978, "E": 0.91, "nu": -0.4297}
CERTIFICATE = ("symbol_min", "symbol_bound", "gamma_min", "inf_sup_min", "gamma_minus_2phi_min")
"""Figures of the certificate that are reported; the last three are those of (i) to (iii)."""
TEMPLATE = Path(__file__).with_suffix(".md")
CONDITIONS = {"direct": "LPS, positive symbol alone", "paper": "LPS, conditions (i)–(iii)"}
ROLES = {"train": "training loads", "val": "periodic sheet", "test": "free disks"}
FILES = {
    "crystal model, 20 bonds": "micromodulus",
    "third-order model, 28 bonds, with energy": "third_order_energy",
    "third-order model, 28 bonds, deconvolved": "third_order_filtered",
}
LOCAL = ("local elasticity, exact constants", "local elasticity, constants as learned")
DETAILS = (*CONDITIONS.values(), LOCAL[1])
BODIES = {
    "train": "training loads",
    "val": "loads of a periodic sheet that the fit never saw",
    "test": "free disks that the fit never saw",
}
ERRORS = {"E_res": "residual", "E_u": "displacement"}


def draw(
    folder: Path, run: Run, sets: Mapping[str, Samples], models: Mapping[str, Any]
) -> list[str]:
    """Write every figure of the main job; returns their names. `models`: rows by name."""
    material, train, figures = run.fit.material, sets["train"], {}
    figures["influence"], ax = panels()
    plots.influence_function(material, spacing=train.spacing, ax=ax)
    least = material.influence(np.linspace(train.spacing, material.horizon, 1000)).min()
    does = "changes sign" if least < 0 else "is positive"
    ax.set_title(f"K {does}; only its values at bonds enter")
    figures["loss"], ax = panels()
    plots.loss_by_stage(run.fit.history, ax=ax)
    ax.set_title("The training loss falls to the constrained optimum")
    if "test" in sets:
        disks, errors = sets["test"], run.tables["test"]["E_u_samples"]
        u = solve(material, Dirichlet(disks, disks.loads, disks.u), allow_uncertified=True).u
        figures["disks"] = disks_of(disks, u, errors)
    if "wave_number" in train.arrays:
        shown = {f"{n}, model": run.tables["train"][f"{e}_samples"] for e, n in ERRORS.items()}
        mean = 100 * np.mean(shown["displacement, model"])
        said = f"On the training loads displacement errs by {mean:.1f} %"
        if LOCAL[0] in models:
            local = models[LOCAL[0]]["E_u_samples"]["train"]
            shown["displacement, local elasticity"] = local
            said += f", by local elasticity {100 * np.mean(local):.1f} %"
        figures["waves"], ax = panels()
        for (name, values), marker in zip(shown.items(), "os^"):
            k, each = train.arrays["wave_number"], 100 * np.asarray(values)
            ax.plot(k, each, marker, fillstyle="none", label=name)
        ax.set(xlabel="wave number |k| of the load [1/Å]", ylabel="relative error [%]")
        ax.set(ylim=(0, None))
        ax.legend(frameon=False)
        ax.set_title(said, fontsize="medium")
    for name, figure in figures.items():
        save_figure(figure, folder / f"{name}.png", overwrite=True)  # which the job looked at
    return [f"{name}.png" for name in figures]


def disks_of(disks: Samples, solved: np.ndarray, errors: list[float]) -> Figure:
    """u₁ of atoms and model on disks, and its error; a row for each disk."""
    figure, axes = panels(9.5, 2.7 * len(errors) + 0.4, count=3, rows=len(errors), squeeze=False)
    inside, mean = disks.interior, 100 * np.mean(errors)
    for s, (error, row) in enumerate(zip(errors, axes)):
        atoms, model = disks.u[s, inside, 0], solved[s, inside, 0]
        off, most = 1000 * (model - atoms), np.abs([atoms, model]).max()
        fields = {
            "atoms, u₁ [Å]": (atoms, most),
            "model, u₁ [Å]": (model, most),
            f"error [mÅ], {100 * error:.2f} %": (off, np.abs(off).max()),
        }
        for ax, (title, (values, limit)) in zip(row, fields.items()):
            how = {"c": values, "cmap": "RdBu_r", "vmin": -limit, "vmax": limit}
            shown = ax.scatter(*disks.x[inside].T, s=12, marker="s", **how)
            figure.colorbar(shown, ax=ax, shrink=0.8)
            ax.set(aspect="equal", xlabel="x₁ [Å]")
            ax.set_title(title, fontsize="medium")
        row[0].set_ylabel(f"load {s + 1}\nx₂ [Å]")
    figure.suptitle(f"The model predicts free disks that no fit saw, with an error of {mean:.1f} %")
    return figure


def metrics(run: Run, data: Dataset) -> dict[str, Any]:
    """Contents of metrics.json, without the seconds; errors are fractions."""
    provenance: Mapping[str, Any] = data.provenance
    fit, model, figures = run.fit, run.fit.material, run.fit.certificate.figures()
    kept = ("E", "nu", "mu", "alpha", "D", "horizon", "degree")
    errors = {error: run.mean(error) for error in ("E_res", "E_u", "E_res_abs", "E_u_samples")}
    numbers = {
        **errors,
        "models": {"linear peridynamic solid (LPS)": errors},
        **{"lambda": model.lam} | {name: getattr(model, name) for name in kept},
        "moduli": fit.moduli[0],
        "held": fit.law.method.moduli,
        "degrees": {f"{degree}": error for degree, error in fit.degrees.items()},
        "truth": provenance.get("truth"),
        "stages": {stage.name: [stage.E_res_train, stage.seconds] for stage in fit.history},
        "starts": fit.starts,
        "loss": f"{fit.loss}",
        "certificate": {key: figures[key] for key in CERTIFICATE},
        "statement": fit.certificate.statement,
        "certified": bool(model.certified_on),
        "temperature": provenance.get("temperature", 0.0),
        "radius": radius_of(data),
    }
    if fit.history[0].name == "1 Adam" and not numbers["temperature"]:
        first, last = fit.history[:2]
        numbers["augmented_lagrangian"] = {
            "loss_over_optimum": first.loss[-1] / last.loss[-1],
            "gradients": first.steps,
            "rounds": len(first.loss) - 1,
        }
    return numbers


def write_report(
    path: Path, numbers: dict[str, Any], models: dict[str, Any], data: Path, command: str
) -> None:
    """report.md: what there is, how good, what next; details below a line."""
    text = TEMPLATE.read_text(encoding="utf-8").format(
        **numbers,
        first="{}. {}.\n{}.".format(*first_lines(numbers)),
        command=command,
        out=shown(path.parent),
        data=shown(data),
        loads=len(numbers["E_u_samples"]["train"]),
        best=best(numbers),
        short_table=error_table(numbers, short=True),
        error_table=error_table(numbers),
        constants=constants_table(numbers),
        others=others(models),
        notes="\n\n".join(notes(numbers)),
        drawn=", ".join(f"`{name}`" for name in numbers["figures"]),
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
    role, truth = best(numbers), numbers["truth"]
    errors = [100 * error for error in numbers["E_u_samples"][role]]
    mean = f"{100 * numbers['E_u'][role]:.2f} % ({min(errors):.1f} to {max(errors):.1f} %)"
    moduli = (
        f"{name} {1e3 * numbers[key]:.0f} GPa"
        + (f" (potential {1e3 * truth[key]:.0f} GPa)" if truth else "")
        for key, name in (("E", "Young's modulus"), ("mu", "shear modulus"))
    )
    proof = "Proven: the model has exactly one equilibrium for every load"
    return [
        f"On {len(errors)} {BODIES[role]} the displacement has an error of {mean}",
        proof if numbers["certified"] else "NOTHING IS PROVEN: solves refuse the model",
        ", ".join(moduli),
    ]


def error_table(numbers: dict[str, Any], *, short: bool = False) -> str:
    """Errors of models, here and printed [%]; `short`: of displacement, a row for each kind."""
    wanted = [("E_u", r) for r in ROLES if r != "train" or r == best(numbers)]
    columns = [one for one in (wanted if short else COLUMNS) if one[1] in numbers["E_u"]]
    rows = [
        [name, *(number(100 * errors.get(e, {}).get(r, np.nan), 2) for e, r in columns)]
        for name, errors in numbers["models"].items()
        if not (short and name in DETAILS)
    ]
    for name, *cells in json.loads(RECORD.read_text("utf-8"))["rows"]:
        if "et al." in name and ("300 K" in name) == bool(numbers["temperature"]):
            printed = dict(zip(COLUMNS, cells))
            rows.append([f"{name} †", *(number(printed[column], 2) for column in columns)])
    return table(["", *(f"{ERRORS[error]}, {ROLES[role]}" for error, role in columns)], rows)


def number(value: float, digits: int) -> str:
    """With so many digits, or a dash where there is none."""
    return "–" if np.isnan(value) else f"{value:.{digits}f}"


def constants_table(numbers: dict[str, Any]) -> str:
    """The learned constants beside the potential's own and the paper's [TPa]."""
    sources = {"learned": numbers, "potential": numbers["truth"] or {}}
    if numbers["temperature"] == 0:
        sources["You et al. 2021, learned"] = PAPER_CONSTANTS
    rows = [
        [name, *(number(source.get(key, np.nan), 4) for key in PAPER_CONSTANTS)]
        for name, source in sources.items()
    ]
    return table(["", "λ", "μ", "E", "ν"], rows)


def others(models: dict[str, Any]) -> str:
    """What the other models are for, where they were learned."""
    if not models:
        return ""
    *_, energy, filtered = models.values()
    constants = ", ".join(f"{name} = {getattr(energy, name):.3f}" for name in CUBIC)
    strains = (100 * one.proven_strain(one.linear.spacing) for one in (energy, filtered))
    return (
        "- Strains above 1 %: `third_order_energy.json`, a crystal model with {} TPa. At most one "
        "solution has strains up to {:.1f} %. `third_order_filtered.json` undoes the smoothing of "
        "the data, has no energy and is proven to {:.1f} %.\n- Directions and speed: "
        "`micromodulus.json`, a crystal model that need not be isotropic.\n"
    ).format(constants, *strains)


def notes(numbers: dict[str, Any]) -> Iterator[str]:
    """What else a run found, a paragraph each."""
    moduli = ", ".join(f"{key} = {value:.4f}" for key, value in numbers["moduli"].items())
    said = f"Long waves on the nodes have {moduli}."
    if truth := numbers["truth"]:
        lam, mu = truth["lambda"], truth["mu"]
        said += f" The potential has C11 = {lam + 2 * mu:.4f}, C12 = {lam:.4f}, C44 = {mu:.4f}."
    yield said
    if radius := numbers["radius"]:
        yield f"Atoms are smoothed to nodes within a radius of {radius:g} Å."
    stages = numbers["stages"].items()
    after = ", ".join(f"{100 * E:.2f} % after {name[2:]} ({s:.1f} s)" for name, (E, s) in stages)
    yield f"Residual on the training loads: {after}. Loss of the fit: {numbers['loss']}."
    if "test" in numbers["E_u"]:
        yield (
            f"The residual on the disks is {numbers['E_res_abs']['test']:.2e} TPa/Å, "
            f"{100 * numbers['E_res']['test']:.0f} % of a load that smoothing alone brings in from "
            "the rim."
        )
    for kind in [kind for kind, name in CONDITIONS.items() if name in numbers["models"]]:
        proofs = dict.fromkeys(CONDITIONS, numbers["certificate"])
        proofs[kind] = numbers["models"][CONDITIONS[kind]]
        paper, direct = proofs["paper"], proofs["direct"]
        third = "" if direct["gamma_minus_2phi_min"] >= 0 else ", and (iii) does not hold"
        yield (
            f"Conditions (i)–(iii) prove a stiffness of {paper['symbol_bound']:.3f} TPa: take them "
            "for answers that are stable under any load. A positive symbol alone proves "
            f"{direct['symbol_bound']:.3f} TPa{third}: take it where the residual is what counts."
        )
    if adam := numbers.get("augmented_lagrangian"):
        yield (
            "Adam with the augmented Lagrangian, by itself, ends at "
            f"{adam['loss_over_optimum']:.6f} times the loss of the optimum, after "
            f"{adam['gradients']} gradients over all loads and {adam['rounds']} rounds."
        )
    if alphas := numbers.get("alphas"):
        yield (
            f"Kernels of any α from {alphas[0]:g} to {alphas[-1]:g} come within 1 % of the least "
            "loss: α and D say much the same."
        )
    if degrees := numbers["degrees"]:
        left = ", ".join(f"{100 * error:.2f} % by degree {M}" for M, error in degrees.items())
        yield (
            f"The degree is {numbers['degree']}, the smallest whose error on loads left out of the "
            f"fit, a fifth at a time, is within 2 % of the best ({left})."
        )
    if starts := numbers["starts"]:
        reached = ", ".join(f"{100 * value:.4f} % from {name}" for name, value in starts.items())
        agree = max(starts.values()) <= (1 + 1e-5) * min(starts.values())
        verdict = "one optimum" if agree else "DIFFERENT optima, the best is kept"
        yield f"‖L u − b‖/‖b‖ reached in stage 3: {reached} ({verdict})."
