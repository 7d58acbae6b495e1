"""How few numbers describe graphene's influence function: shapes with parameters, one data set.

Positive shapes of one parameter, a damped wave of three, a table and the Bernstein polynomials are
fitted by the same path under the same conditions. Writes table.md, metrics.json and shapes.png.
"""

import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent.parent))

import numpy as np
from tqdm import tqdm

import warp_peri as wp
from examples.figures import note, panels
from examples.train_graphene import make_data
from tools.make_graphene import SMOOTHING_RADIUS
from tools.options import Options
from warp_peri import Dataset, Samples
from warp_peri.errors import exit_status
from warp_peri.files.atomic import whole_file, write_json, write_text
from warp_peri.learning.result import Fit
from warp_peri.plots import kernel_values
from warp_peri.points.families import bond_classes
from warp_peri.shapes import InfluenceFunction, damped_wave, named, table

HORIZON, DEGREE = 20.0, 10
KNOTS = np.linspace(4.0, HORIZON, 9)
SETS = ("train", "val", "test")


def waves() -> list[InfluenceFunction]:
    """A damped wave from two starts, since the loss has two valleys."""
    bounds = {"length": (1.0, 100.0), "period": (4.0, 100.0)}
    starts = ((5.0, 10.0), (5.0, 20.0))
    return [
        InfluenceFunction(damped_wave, {"length": a, "period": b, "phase": 0.0}, bounds)
        for a, b in starts
    ]


def fits(train: Samples) -> dict[str, tuple[int, Fit]]:
    """By name, the number of parameters of the shape and the fit."""
    cases: dict[str, tuple[int, Any]] = {
        name: (1, named(name, HORIZON)) for name in ("gaussian", "exponential", "conical")
    }
    cases["damped wave"] = (3, waves())
    # The scale of a kernel has no effect: one value or coefficient less than there are.
    values = table(KNOTS, 1 / KNOTS, learned=True)
    cases["table, 9 knots"] = (len(KNOTS) - 1, values)
    cases["Bernstein, M = 10"] = (DEGREE + 1, wp.Bernstein(DEGREE))
    return {
        name: (count, wp.fit(train, wp.LPS(HORIZON, kernel)))
        for name, (count, kernel) in tqdm(cases.items(), desc="fits")
    }


def row(name: str, count: int, fit: Fit, data: Dataset) -> dict[str, Any]:
    """Errors [%] and constants of one fit."""
    out: dict[str, Any] = {"shape": name, "parameters": count}
    for role in SETS:
        errors = wp.evaluate(fit.material, data[role])
        out |= {f"{key} {role}": 100 * errors[key] for key in ("E_res", "E_u")}
    out |= {"mu": fit.material.mu, "E": fit.material.E, "c": fit.certificate.symbol_bound}
    if fit.influence is not None:
        out["learned"] = fit.material.provenance["influence"]
    return out


def text(rows: list[dict[str, Any]]) -> str:
    """The rows as a table in Markdown."""
    lines = [
        "| K(r) | parameters | E_res train | E_res val | E_u train | E_u val | E_u disks | μ [TPa] "
        "| E [TPa] |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    keys = ("E_res train", "E_res val", "E_u train", "E_u val", "E_u test")
    for row in rows:
        errors = " | ".join(f"{row[key]:.2f}" for key in keys)
        constants = f"{row['mu']:.3f} | {row['E']:.3f}"
        lines.append(f"| {row['shape']} | {row['parameters']} | {errors} | {constants} |")
    return "\n".join(lines) + "\n"


def picture(learned: dict[str, tuple[int, Fit]], rows: list[dict[str, Any]], path: Path) -> None:
    """The kernels, and what each extra parameter buys on the disks."""
    figure, (left, right) = panels(11, 4.2, count=2)
    classes = bond_classes(5.0, HORIZON)
    r = np.linspace(classes.r[0], HORIZON, 500)
    left.axhline(0, color="0.7", linewidth=0.8)
    for number, name in enumerate(("gaussian", "damped wave", "Bernstein, M = 10")):
        model, color = learned[name][1].material, f"C{number}"
        bonds = classes.r**2 * kernel_values(model, classes, classes.r)
        if name.startswith("Bernstein"):  # between the bonds its polynomial is not determined
            left.plot(classes.r, bonds, "x", color=color, label=f"{name}, at the bonds")
        else:
            left.plot(r, r**2 * kernel_values(model, classes, r), color=color, label=name)
            left.plot(classes.r, bonds, "o", color=color, markersize=4)
    left.set(xlabel="bond length r [Å]", ylabel="weight of bonds K r² / m [Å⁻²]")
    left.set(ylim=(-0.015, 0.023), title="Graphene's influence function changes sign")
    left.legend(frameon=False, loc="upper right")
    right.semilogy([row["parameters"] for row in rows], [row["E_u test"] for row in rows], "o")
    above = {"exponential": 12, "gaussian": 0, "conical": -12, "table, 9 knots": 11}
    for row in rows:
        place, shift = (row["parameters"], row["E_u test"]), (8, above.get(row["shape"], 0))
        note(right, row["shape"], place, shift, va="center")
    right.set_xlim(0, 16)
    right.set_ylim(0.4, 40)
    right.yaxis.set_major_formatter("{x:g}")
    right.set(xlabel="parameters of the influence function", ylabel="error on unseen disks [%]")
    right.set_title("Three parameters that change sign do what eleven do")
    with whole_file(path) as temporary:
        figure.savefig(temporary, format="png", dpi=110)


def main(arguments: list[str] | None = None) -> int:
    parser = Options(__doc__, "influence_shapes")
    parser.add("--jobs", type=int, default=-1, help="processes for LAMMPS; -1: all cores")
    given = parser.parse_args(arguments)
    data = wp.load(make_data(given.jobs, SMOOTHING_RADIUS))
    learned = fits(data["train"])
    rows = [row(name, count, fit, data) for name, (count, fit) in learned.items()]
    write_json(given.out / "metrics.json", {"fits": rows})
    write_text(given.out / "table.md", text(rows))
    picture(learned, rows, given.out / "shapes.png")
    print(text(rows))
    return 0


if __name__ == "__main__":
    sys.exit(exit_status(main))
