"""Ways to learn the same material, side by side, on the graphene data of the main job.

The paper's algorithm as printed, the same with projected bounds, the constrained optimum under
either choice of conditions, with held or isotropic moduli; then
training on two grids at once, solved on both and on a third that no fit saw.
"""

import sys
import time
import warnings
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent.parent))

import numpy as np
import torch
from tqdm import tqdm

import warp_peri as wp
from examples.train_graphene import DATA, make_data
from tools.make_graphene import SMOOTHING_RADIUS, point_set, read_samples
from tools.options import Options
from warp_peri import Bernstein, Dataset, InputError, Model, Samples
from warp_peri.errors import exit_status
from warp_peri.files.atomic import write_json, write_text
from warp_peri.learning.fit import learn as fit
from warp_peri.learning.result import Fit
from warp_peri.learning.two_stage import DenseMargins
from warp_peri.methods import Optimum, TwoStage
from warp_peri.points.families import bond_classes

UNSEEN_SPACING = 4.0
"""[Å]"""

PRINTED_TABLE_6 = {"E_u h = 5 Å": 7.80, "E_u h = 2.5 Å": 8.44}
"""Disks, δ = 12.5 Å, trained on both grids [%]."""


def one_grid(data: Dataset) -> list[dict[str, Any]]:
    """Fits at h = 5 Å, δ = 20 Å, M = 10."""
    truth = data.provenance["truth"]
    moduli = (truth["lambda"], truth["mu"])
    cases: dict[str, dict[str, Any]] = {
        "Algorithm 1, ReLU in the loss": {"method": TwoStage(parametrisation="relu")},
        "Algorithm 1, projected bounds": {"method": TwoStage()},
        "default: moduli of long waves held": {},
        "the same, paper's conditions": {"conditions": wp.methods.Conditions("paper")},
        "moduli learned freely": {"method": Optimum(moduli=None)},
        "moduli free, paper's conditions": {
            "method": Optimum(moduli=None),
            "conditions": wp.methods.Conditions("paper"),
        },
        "constrained, isotropic": {"method": Optimum(moduli="isotropic")},
        "constrained, true moduli held": {"method": Optimum(moduli=moduli)},
    }
    rows = []
    for name, options in tqdm(cases.items(), desc="one grid"):
        begin = time.perf_counter()
        learned = fit(data["train"], **({"horizon": 20.0, "kernel": Bernstein(10)} | options))
        row = {"fit": name, "seconds": time.perf_counter() - begin}
        sets = {role: data[role] for role in ("train", "val", "test")}
        rows.append(row | _numbers(learned) | _errors(learned.material, sets))
    return rows


def two_grids(data: Dataset, unseen: Samples) -> list[dict[str, Any]]:
    """Fits on h = 5 and 2.5 Å together, evaluated on the disks of both and of an unseen grid."""
    rows = []
    both = [data["train"], data["train_fine"]]
    for horizon in tqdm((12.5, 20.0), desc="two grids"):
        begin = time.perf_counter()
        learned = fit(both, horizon, Bernstein(10), method=Optimum(moduli=None))
        row = {"fit": f"δ = {horizon:g} Å", "seconds": time.perf_counter() - begin}
        row |= _numbers(learned)
        third = wp.certify(learned.material, spacing=unseen.spacing)
        row["c on the unseen grid"] = third.symbol_bound
        sets = {"h = 5 Å": data["test"], "h = 2.5 Å": data["test_fine"], "h = 4 Å": unseen}
        rows.append(row | _errors(learned.material, sets))
    return rows


def _numbers(learned: Fit) -> dict[str, Any]:
    """Constants, moduli, certificate and whether the starts agree."""
    reached = list(learned.starts.values())
    spread = float(np.ptp(reached) / min(reached)) if reached else None
    return {
        "lambda": learned.material.lam,
        "mu": learned.material.mu,
        "moduli": learned.moduli,
        "c": [certificate.symbol_bound for certificate in learned.certificates],
        "spread of the starts": spread,
    }


def _errors(model: Model, sets: dict[str, Samples]) -> dict[str, float | None]:
    """E_res and E_u of each set; None where the operator is indefinite and nothing is solved."""
    out: dict[str, float | None] = {}
    with warnings.catch_warnings(action="ignore"):  # some rows are about uncertified grids
        for name, points in sets.items():
            try:
                table = wp.evaluate(model, points, allow_uncertified=True)
            except InputError:
                table = {"E_res": None, "E_u": None}
            out |= {f"E_res {name}": table["E_res"], f"E_u {name}": table["E_u"]}
    return out


def dense_seconds(points: Samples) -> float:
    """Seconds that the three dense conditions and their gradient take, once."""
    margins = DenseMargins([points], 20.0)
    model = Model(-0.2, 0.7, 1.0, np.ones(1), 20.0)
    classes = bond_classes(points.spacing, 20.0)
    kw = model.influence(classes.r) * classes.weight
    w = torch.tensor(kw / (classes.count @ (kw * classes.r**2)), requires_grad=True)
    scalar = torch.ones((), dtype=torch.float64)
    seconds = []
    for _ in range(3):
        begin = time.perf_counter()
        margins(scalar, scalar, [w]).sum().backward()
        seconds.append(time.perf_counter() - begin)
    return float(np.median(seconds))


def report(single: list[dict[str, Any]], double: list[dict[str, Any]], dense: float) -> str:
    """The tables."""
    columns = ["E_res train", "E_res val", "E_u train", "E_u val", "E_u test"]
    lines = [
        "# Ways to learn",
        "",
        "Made by `python examples/studies/compare_fits.py`.",
        "h = 5 Å, δ = 20 Å, M = 10; errors in %.",
        "",
        "| fit | " + " | ".join(columns) + " | λ | μ | C11 | C12 | C44 | c [TPa] | seconds |",
        "|---" * (len(columns) + 8) + "|",
    ]
    for row in single:
        cells = [f"{100 * row[column]:.2f}" for column in columns]
        cells += [f"{row['lambda']:.4f}", f"{row['mu']:.4f}"]
        cells += [f"{row['moduli'][0][key]:.4f}" for key in ("C11", "C12", "C44")]
        cells += [f"{row['c'][0]:.4f}", f"{row['seconds']:.1f}"]
        lines.append(f"| {row['fit']} | " + " | ".join(cells) + " |")
    lines += [
        "",
        f"With the dense conditions of (4.6), one epoch of stage 2 takes {dense:.2f} s more "
        "(their value and gradient on the training domain).",
        "",
        "## Two grids at once: E_u on the disks",
        "",
        "| fit | h = 5 Å | h = 2.5 Å | h = 4 Å (unseen) | c at 5, 2.5, 4 Å [TPa] | seconds |",
        "|---|---|---|---|---|---|",
    ]
    for row in double:
        errors = [row[f"E_u {name}"] for name in ("h = 5 Å", "h = 2.5 Å", "h = 4 Å")]
        cells = ["refused" if error is None else f"{100 * error:.2f}" for error in errors]
        bounds = ", ".join(f"{value:.4f}" for value in [*row["c"], row["c on the unseen grid"]])
        lines.append(f"| {row['fit']} | {' | '.join(cells)} | {bounds} | {row['seconds']:.0f} |")
    printed = " | ".join(f"{value:.2f}" for value in PRINTED_TABLE_6.values())
    lines.append(f"| printed, δ = 12.5 Å | {printed} | – | – | – |")
    return "\n".join(lines) + "\n"


def main(arguments: list[str] | None = None) -> int:
    parser = Options(__doc__, "compare_fits")
    parser.add("--jobs", type=int, default=-1, help="processes for LAMMPS; -1: all cores")
    given = parser.parse_args(arguments)
    data = wp.load(make_data(given.jobs, SMOOTHING_RADIUS))
    body, loads, samples = read_samples(DATA.with_suffix(".cache"), "test")
    unseen = point_set(body, loads, samples, spacing=UNSEEN_SPACING)
    single, double = one_grid(data), two_grids(data, unseen)
    dense = dense_seconds(data["train"])
    write_json(
        given.out / "compare_fits.json",
        {"one_grid": single, "two_grids": double, "dense_conditions_seconds": dense},
    )
    text = report(single, double, dense)
    write_text(given.out / "report.md", text)
    print(text)
    return 0


if __name__ == "__main__":
    sys.exit(exit_status(main))
