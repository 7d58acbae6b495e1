"""What the page on Jafarzadeh et al. (2024) shows: see papers.py."""

import json
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from examples import neural_sets
from examples.neural_operator import PRINTED, WEIGHTS
from examples.neural_rivals import dictionary
from examples.prose import rows_of
from examples.studies import paper_jafarzadeh_pictures as pictures
from tools.make_hgo import SPACING, make_hgo
from warp_peri import Samples
from warp_peri.neural import NeuralEquilibrium, evaluate
from warp_peri.neural.material import load
from warp_peri.tissue import rose_of

GRAPHENE = "data/graphene_0K.h5"
REACHES = (3, 4, 5)
ASKED = "python examples/neural_operator.py"
NEEDED = {
    GRAPHENE: "python examples/train_graphene.py",
    **{f"runs/neural/hgo_{n}_errors.json": f"{ASKED} hgo --reach {n}" for n in REACHES},
    "runs/neural/leaflet_errors.json": f"{ASKED} leaflet",
}
TEMPLATE = Path(__file__).with_suffix(".md")
SHOWN = 0
"""The disk, and the squares, that are drawn: the first of each set."""
SHARES = (0.5, 0.95, 1.0)
"""Of all nodes, whose gradient of displacement is told."""
CLASSICAL = {"Fung": 0.1083, "invariant-based": 0.1073, "structure-informed": 0.0993}
"""Printed test errors of the materials beside the network."""

Field = dict[str, Any]


def parts(runs: Path, kept: Callable[..., Any], figures: Path) -> dict[str, str]:
    """The parts of the page, by the names that its template gives them."""
    reports = {
        name: json.loads((runs / "neural" / f"{name}_errors.json").read_text(encoding="utf-8"))
        for name in (*(f"hgo_{n}" for n in REACHES), "leaflet")
    }
    data = runs.parent / "data"
    disk = kept("graphene_disk", lambda: graphene_disk(runs.parent / GRAPHENE))
    pictures.prediction(figures / "jafarzadeh_disk.png", disk, "Å", "TPa/Å")
    errors = kept("graphene_errors", lambda: graphene_errors(runs.parent / GRAPHENE))
    sheet = kept("hgo_disk", lambda: hgo_disk(data / "hgo"))
    pictures.prediction(figures / "jafarzadeh_sheet.png", sheet, "mm", "MPa/mm")
    squares = make_hgo(data / "hgo", progress=False)
    gradients = sizes_of_gradients(squares)
    pictures.square(figures / "jafarzadeh_square.png", squares["train"], SHOWN)
    pictures.gradients(figures / "jafarzadeh_gradients.png", gradients)
    wide = neural_sets.mirrored(few(squares["train"]), 3)
    pictures.mirror(figures / "jafarzadeh_mirror.png", wide)
    pictures.loads(figures / "jafarzadeh_loads.png", {k: squares[k] for k in ("train", "val")})
    roses = {n: kept(f"rose_{n}", partial(dictionary_rose, data / "hgo", n)) for n in REACHES}
    laws = {n: load(WEIGHTS / f"hgo_{n}.json") for n in REACHES}
    pictures.influence(figures / "jafarzadeh_influence.png", load(WEIGHTS / "graphene.json"))
    pictures.roses(figures / "jafarzadeh_roses.png", laws, roses)
    frames = neural_sets.leaflet(data / "leaflet", jobs=-1, progress=False)
    pictures.leaflet(figures / "jafarzadeh_leaflet.png", frames)
    pictures.influence(figures / "jafarzadeh_tissue.png", load(WEIGHTS / "leaflet.json"))
    by_frame = errors_by_frame(reports["leaflet"])
    for name in ("Fung", "invariant-based"):  # six lines can be told apart
        del by_frame[name]
    pictures.frames(figures / "jafarzadeh_frames.png", by_frame, frames["test"])
    sizes = np.quantile(gradients, SHARES)
    return {
        "disk_u": f"{100 * gap(disk, 'u'):.2f}",
        "sheet_u": f"{100 * gap(sheet, 'u'):.2f}",
        "sheet_b": f"{100 * gap(sheet, 'b'):.2f}",
        "gradients": rows_of([["size", *(f"{size:.2f}" for size in sizes)]]),
        "figure_5": rows_of(figure_5(errors)),
        "figure_11": rows_of(figure_11(reports)),
        "epochs": rows_of(epochs(laws, reports)),
        "figure_14": rows_of(figure_14(reports["leaflet"])),
    }


def few(samples: Samples) -> Samples:
    """The sample that is drawn."""
    one = slice(SHOWN, SHOWN + 1)
    return Samples(samples.points, samples.u[one], None if samples.b is None else samples.b[one])


def graphene_disk(file: Path) -> Field:
    """Displacement and load of a disk of atoms, and what the network says of them."""
    samples = neural_sets.graphene(file)["disks"]
    return predicted(load(WEIGHTS / "graphene.json").double(), samples)


def graphene_errors(file: Path) -> dict[str, dict[str, float]]:
    """Of the shipped network on graphene: load of all sets, displacement of unseen loads."""
    material, found = load(WEIGHTS / "graphene.json").double(), {}
    for name, samples in neural_sets.graphene(file).items():
        found[name] = evaluate(material, samples, solve=name != "train", progress=False)
    kinds = ("E_res", "E_u", "E_res_abs")
    return {k: {n: e[k] for n, e in found.items() if e.get(k) is not None} for k in kinds}


def figure_5(errors: Mapping[str, Mapping[str, float]]) -> list[list[str]]:
    """Printed, network: errors in %, and the error of the load on the disks in GPa/Å."""
    rows = []
    for name, one, unit in (("*printed*", PRINTED["graphene"], 1.0), ("network", errors, 1e3)):
        told = percent(one["E_res"], ("train", "val")), percent(one["E_u"], ("val", "disks"))
        rows.append([name, *told, f"{unit * one['E_res_abs']['disks']:.3g}"])
    return rows


def hgo_disk(folder: Path) -> Field:
    """The same of a disk of the anisotropic sheet, δ = 3 spacings."""
    sets = neural_sets.hgo(folder, 3, mirror=False, jobs=-1, progress=False)
    return predicted(load(WEIGHTS / "hgo_3.json").double(), sets["disks"])


def predicted(material: Any, samples: Samples) -> Field:
    """u where b is given, b where u is given, beside the truth, on the interior."""
    one, placed = few(samples), material.on(samples.points)
    inside = one.interior
    found = NeuralEquilibrium(placed).from_rest(one.loads[0], one.u[0], tolerance=1e-6)
    return {
        "x": one.x[inside].tolist(),
        "converged": found.converged,
        "u": [one.u[0][inside].tolist(), found.u[inside].tolist()],
        "b": [one.loads[0][inside].tolist(), placed(one.u[0]).tolist()],
    }


def gap(field: Field, name: str) -> float:
    """Relative ℓ2 error of u or b."""
    true, found = (np.array(part) for part in field[name])
    return float(np.linalg.norm(found - true) / np.linalg.norm(true))


def sizes_of_gradients(sets: Mapping[str, Samples]) -> np.ndarray:
    """|∇u| of all nodes of all squares."""
    fields = np.concatenate([samples.u for name, samples in sets.items() if name != "disks"])
    side = round(len(fields[0]) ** 0.5)
    F = np.gradient(fields.reshape(-1, side, side, 2), SPACING, axis=(1, 2))
    sizes: np.ndarray = np.sqrt(sum((part**2).sum(axis=-1) for part in F)).ravel()
    return sizes


def dictionary_rose(folder: Path, reach: int) -> dict[str, float]:
    """Energy by direction [rad] of the dictionary at one horizon."""
    sets = neural_sets.hgo(folder, reach, mirror=False, jobs=-1, progress=False)
    solid = dictionary(sets["train"], reach)
    return {f"{angle}": value for angle, value in rose_of(solid).items()}


def percent(errors: Mapping[str, float], sets: Sequence[str]) -> str:
    """Errors of some sets in %, two digits."""
    return " / ".join(f"{100 * errors[name]:.2f}" if name in errors else "–" for name in sets)


def figure_11(reports: Mapping[str, Any]) -> list[list[str]]:
    """Printed, network, dictionary of each horizon."""
    squares, rows = ("train", "val", "test"), []
    for n in REACHES:
        report, printed = reports[f"hgo_{n}"], PRINTED[f"hgo {n}"]
        for name, errors in (
            ("*printed*", printed),
            ("network", report),
            ("dictionary", report["rivals"]["dictionary"]),
        ):
            cells = [f"{n}", name]
            for kind in ("E_res", "E_u"):
                known = squares[:2] if name == "*printed*" else squares
                cells += [percent(errors[kind], known), percent(errors[kind], ["disks"])]
            rows.append(cells)
    return rows


def epochs(laws: Mapping[int, Any], reports: Mapping[str, Any]) -> list[list[str]]:
    """How the shipped weights were made, and how many of their equilibria were found."""
    rows = []
    for n, law in laws.items():
        made = law.provenance
        pace = made["seconds"] / made["epochs"]
        found = min(reports[f"hgo_{n}"]["converged"].values())
        numbers = f"{law.numbers()}"
        rows.append([f"{n}", numbers, f"{made['epochs']}", f"{pace:.1f}", f"{100 * found:.0f} %"])
    return rows


def errors_by_frame(report: Mapping[str, Any]) -> dict[str, list[float]]:
    """E_u of every held-out frame, by material."""
    found = {name: rival["frames"]["test"] for name, rival in report["rivals"].items()}
    if "frames" in report:
        found["network"] = report["frames"]["test"]
    return found


def figure_14(report: Mapping[str, Any]) -> list[list[str]]:
    """Printed and measured errors of every material of the leaflet."""
    sets = ("train", "val", "test")
    rows = [["*printed*, network", percent(PRINTED["leaflet"]["E_u"], sets)]]
    rows += [[f"*printed*, {name}", f"– / – / {100 * e:.2f}"] for name, e in CLASSICAL.items()]
    for name, rival in report["rivals"].items():
        rows.append([name, percent(rival["E_u"], sets)])
    if "E_u" in report:
        share = min(report["converged"].values())
        found = "" if share == 1 else f" (equilibria of {100 * share:.0f} % found)"
        rows.append(["network", percent(report["E_u"], sets) + found])
    return rows
