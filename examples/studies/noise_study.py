"""What thermal noise does to a fit: Table 5, and Tables 3 and 4 at 300 K, of You et al. (2021).

Three reductions of the same runs, three factors on the loads, three losses. A printed error at
300 K is against displacements that are noisy themselves; here each model is held to them, to the
shared-seed reference of the same loads, and to 0 K. Runs LAMMPS for an hour on two cores unless
its runs are there.
"""

import argparse
import shlex
import sys
import warnings
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent.parent))

import numpy as np
from tqdm import tqdm

import warp_peri as wp
from examples.studies import noise_report
from examples.train_graphene import DATA, SMOOTHING_RADIUS, make_data
from tools.make_thermal import make_thermal
from tools.options import Options
from tools.thermal import REDUCTIONS
from warp_peri import Dataset, Samples, load
from warp_peri.errors import exit_status
from warp_peri.files.atomic import locked, write_json, write_text
from warp_peri.learning.result import Fit
from warp_peri.methods import resample_loads, sweep

FACTORS = (1.0, 0.25, 0.1)
HORIZON, DEGREE = 20.0, 10
LOSSES = ("residual", "corrected", "output")
DEFAULT = "auto"
"""Tried first; it takes one of the three."""
ROLES = ("val", "test")
SWEPT = ("iota", 1.0)
"""What the paper's Tables 3 and 4 are made from."""

Data = dict[tuple[str, float], Dataset]


def fits(data: Data, cold: Dataset) -> tuple[list[dict[str, Any]], dict[tuple[str, float], Fit]]:
    """A row for each factor, reduction and loss; and the fits by the default loss."""
    rows: list[dict[str, Any]] = []
    chosen: dict[tuple[str, float], Fit] = {}
    with tqdm(desc="fits", total=len(data) * len(LOSSES)) as bar:
        for (reduction, factor), own in data.items():
            for loss in (DEFAULT, *LOSSES):
                default = chosen.get((reduction, factor))
                if default and loss == default.loss.name:
                    continue
                fit = wp.fit(own["train"], law(loss), noise=own["noise"])
                chosen.setdefault((reduction, factor), fit)
                row: dict[str, Any] = {"reduction": reduction, "factor": factor}
                row["loss"] = fit.loss.name
                row |= {"default": loss == DEFAULT, "reason": fit.loss.reason}
                row |= {key: getattr(fit.material, key) for key in noise_report.CONSTANTS}
                row["c"] = fit.certificate.symbol_bound
                row["certified"] = bool(fit.material.certified_on)
                rows.append(row | against(fit.material, own, data["shared", factor], cold))
                bar.update()
    rows.sort(key=lambda row: (-row["factor"], REDUCTIONS.index(row["reduction"])))
    return rows, chosen


def law(loss: str) -> wp.LPS:
    """What is learned, by a loss."""
    return wp.LPS(horizon=HORIZON, kernel=wp.Bernstein(DEGREE), normalise=True, loss=loss)


def bands(fit: Fit, own: Dataset) -> wp.methods.Resampled:
    """The fit again, by its loss, to other choices of the loads."""
    return resample_loads(own["train"], law(fit.loss.name), noise=own["noise"], progress=True)


def against(
    model: wp.Model, own: Dataset, shared: Dataset, cold: Dataset
) -> dict[str, float | None]:
    """Errors on the model's own data, and E_u against the less noisy references."""
    row: dict[str, float | None] = {}
    with warnings.catch_warnings():
        # A model of small loads is meant to be held to large ones here.
        warnings.filterwarnings("ignore", message="strain:")
        for name in ("train", *ROLES):
            table = wp.evaluate(model, own[name])
            row |= {f"E_res_{name}": table["E_res"], f"E_u_{name}": table["E_u"]}
            row[f"E_res_abs_{name}"] = table["E_res_abs"]
        for reference, sets in (("shared", shared), ("cold", cold)):
            for name in ROLES:
                row[f"E_u_{name}_{reference}"] = wp.evaluate(model, sets[name])["E_u"]
    return row


def floors(data: Data) -> list[dict[str, Any]]:
    """Signal-to-noise ratio, and noise of each reference relative to the displacement it is in."""
    rows = []
    for (reduction, factor), own in data.items():
        row: dict[str, Any] = {"reduction": reduction, "factor": factor}
        row["snr"] = own.provenance["snr"]["train"]
        for name, noise in (("train", "noise"), ("val", "noise"), ("test", "noise_test")):
            row[f"floor_{name}"] = floor(own[noise], data["shared", factor][name])
        rows.append(row)
    return rows


def floor(noise: Samples, reference: Samples) -> float:
    """Root-mean-square norm of the noise on the interior over ‖u‖, mean over the samples."""
    inside = reference.interior
    size = np.sqrt((noise.u[:, inside] ** 2).sum(axis=(1, 2)).mean())
    return float(np.mean(size / np.linalg.norm(reference.u[:, inside], axis=(1, 2))))


def swept(folder: Path, data: Data, cold: Dataset, jobs: int) -> dict[str, Any]:
    """Algorithm 2 on the paper's reduction at 300 K: Tables 3 and 4."""
    own = data[SWEPT]
    trials = sweep(
        own["train"],
        own["val"],
        folder / "sweep",
        test=own["test"],
        noise=own["noise"],
        jobs=jobs,
        progress=True,
    )
    rows = []
    for trial, average in zip(trials.by_degree, trials.average):
        model = load(folder / "sweep" / trial.model)
        row: dict[str, Any] = {"degree": trial.degree, "horizon": trial.horizon, "AvgE": average}
        row |= {key: getattr(model, key) for key in ("alpha", "lam", "mu", "E", "nu")}
        rows.append(row | against(model, own, data["shared", SWEPT[1]], cold))
    return {"by_degree": rows, "chosen": trials.printed.degree}


def run(given: argparse.Namespace) -> str:
    """Data, fits, sweep, tables and figures; returns the tables."""
    cold = wp.load(make_data(given.jobs, SMOOTHING_RADIUS))
    paths = make_thermal(DATA.parent, factors=FACTORS, jobs=given.jobs)
    data = {
        (reduction, factor): wp.load(paths[reduction, factor])
        for reduction in REDUCTIONS
        for factor in FACTORS
    }
    truth = data["shared", 1.0].provenance["truth"]
    rows, chosen = fits(data, cold)
    table = swept(given.out, data, cold, given.jobs)
    content = {"truth": truth, "fits": rows, "floors": floors(data), "sweep": table}
    write_json(given.out / "noise.json", content)
    text = noise_report.tables(content, given.command)
    write_text(given.out / "noise.md", text)
    iota = {factor: chosen["iota", factor] for factor in FACTORS}
    sure = {factor: bands(fit, data["iota", factor]) for factor, fit in iota.items()}
    noise_report.draw_degrees(given.out / "errors_by_degree.png", table["by_degree"])
    noise_report.draw_kernels(given.out / "kernels.png", iota, sure)
    return text


def main(arguments: list[str] | None = None) -> int:
    parser = Options(__doc__, "noise_study")
    parser.add("--jobs", type=int, default=-1, help="processes; -1: all cores")
    given = parser.parse_args(arguments)
    words = sys.argv[1:] if arguments is None else arguments
    given.command = shlex.join(["python", "examples/studies/noise_study.py", *words])

    def work() -> None:
        with locked(given.out):
            print(run(given))

    return exit_status(work, "finished runs are kept and the next call goes on")


if __name__ == "__main__":
    sys.exit(main())
