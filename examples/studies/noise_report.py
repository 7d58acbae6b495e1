"""Tables and figures of the noise study."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.ticker import LogLocator

from examples.figures import headline, name_lines, panels, save_figure
from examples.prose import fill, rows_of
from warp_peri import Model, plots
from warp_peri.learning.result import Fit
from warp_peri.methods import Resampled
from warp_peri.points.families import bond_classes

Row = dict[str, Any]

PRINTED_TABLE_3 = {
    0: (12.5, 13.46, 31.33, 20.15, 14.86, 1.0),
    5: (12.5, 10.50, 13.80, 17.83, 9.66, 0.6784),
    10: (20.0, 9.79, 13.32, 18.11, 9.08, 0.6549),
    15: (20.0, 9.82, 13.16, 18.08, 8.88, 0.6505),
    20: (25.0, 9.81, 13.36, 18.34, 9.23, 0.6609),
}
"""δ* [Å], E_res train, E_u train, E_res val, E_u val [%], AvgE by degree, as printed (300 K)."""

PRINTED_TABLE_5 = {
    1.0: (0.1556, 2.5946, -0.4583, 0.7753, 0.90, -0.4196, 9.82, 13.16, 18.08, 8.88, 0.208, 9.21),
    0.25: (0.0543, 2.5197, -0.4782, 0.7798, 0.87, -0.4422, 14.52, 28.27, 18.34, 9.82, 0.211, 9.28),
    0.1: (0.0224, 1.9365, -0.3266, 0.6890, 0.95, -0.3106, 27.64, 48.86, 23.73, 17.54, 0.184, 7.95),
}
"""SNR, α, λ, μ, E [TPa], ν, then E_res and E_u on train, val and test, as printed; errors in %,
but E_res test absolute in the paper's units. The first row is Table 4 at 300 K."""

NAMES = {"shared": "shared seed", "plain": "plain average", "iota": "ι = 0.01"}
ERRORS = ("E_res_train", "E_u_train", "E_res_val", "E_u_val")
CONSTANTS = ("alpha", "lam", "mu", "E", "nu")


def tables(content: dict[str, Any], command: str) -> str:
    """The report: fits, Table 5, Tables 3 and 4 at 300 K."""
    floors = {(row["reduction"], row["factor"]): row for row in content["floors"]}
    return fill(
        Path(__file__).with_suffix(".md"),
        command=command,
        truth=content["truth"],
        fits=rows_of(_fit_row(row, floors) for row in content["fits"]),
        choices="\n".join(_choice(row) for row in content["fits"] if row["default"]),
        table_5=rows_of(_table_5(content["fits"], floors)),
        table_3=rows_of(_table_3(content["sweep"]["by_degree"], floors["iota", 1.0])),
        table_4=rows_of(_table_4(content["sweep"], floors["iota", 1.0])),
    )


def _fit_row(row: Row, floors: Mapping[tuple[str, float], Row]) -> list[str]:
    """One fit: its data, its loss, its errors and its constants."""
    floor = floors[row["reduction"], row["factor"]]
    return [
        NAMES[row["reduction"]],
        f"{row['factor']:g}",
        _pair(floor, "floor_{}"),
        row["loss"] + " (default)" * row["default"],
        *(_pair(row, name) for name in ("E_u_{}", "E_u_{}_shared", "E_u_{}_cold")),
        *(f"{row[key]:.4f}" for key in ("lam", "mu", "E")),
        f"{row['c']:.4f}",
    ]


def _choice(row: Row) -> str:
    """What the library chose for a data set, and why."""
    name = f"{NAMES[row['reduction']]}, factor {row['factor']:g}"
    return f"- {name}: {row['loss']} ({row['reason']})"


def _table_5(fits: list[Row], floors: Mapping[tuple[str, float], Row]) -> Iterator[list[str]]:
    """Table 5: time smoothing as printed, each row before the printed one."""
    for row in fits:
        if not row["default"] or row["reduction"] != "iota":
            continue
        floor = floors["iota", row["factor"]]
        own = [f"{row['factor']:g}", "here", f"{floor['snr']:.4f}"]
        yield [*own, *_constants(row), *_errors(row), *_against(row, floor)]
        printed = [f"{value:g}" for value in PRINTED_TABLE_5[row["factor"]]]
        yield ["", "printed", *printed, "–", "–", "–"]


def _table_3(by_degree: list[Row], floor: Row) -> Iterator[list[str]]:
    """Table 3: every degree at its δ*, and what is printed."""
    for row in by_degree:
        errors = [f"{100 * row[key]:.2f}" for key in ERRORS]
        own = [f"{row['degree']}", f"{row['horizon']:g}", *errors, f"{row['AvgE']:.4f}"]
        printed = PRINTED_TABLE_3.get(row["degree"])
        beside = ", ".join(f"{value:g}" for value in printed) if printed else "–"
        yield [*own, *_against(row, floor), beside]


def _table_4(sweep: dict[str, Any], floor: Row) -> Iterator[list[str]]:
    """Table 4: the degree that was chosen, and the printed one."""
    row = next(row for row in sweep["by_degree"] if row["degree"] == sweep["chosen"])
    own = ["here", f"{sweep['chosen']}"]
    yield [*own, *_constants(row), *_errors(row), *_against(row, floor)]
    yield ["printed", "15", *(f"{value:g}" for value in PRINTED_TABLE_5[1.0][1:]), "–", "–", "–"]


def _constants(row: Row) -> list[str]:
    return [f"{row[key]:.4f}" for key in CONSTANTS]


def _against(row: Row, floor: Row) -> list[str]:
    """Errors against the shared-seed reference and the loads of 0 K, and the noise floor."""
    return [_pair(row, "E_u_{}_shared"), _pair(row, "E_u_{}_cold"), _pair(floor, "floor_{}")]


def _pair(row: Row, name: str) -> str:
    """Validation / disks, in %."""
    return " / ".join(f"{100 * row[name.format(role)]:.2f}" for role in ("val", "test"))


def _errors(row: Row) -> list[str]:
    """E_res and E_u on train, val and test; E_res of the test set absolute."""
    out = [f"{100 * row[key]:.2f}" for key in ERRORS]
    return [*out, f"{1e3 * row['E_res_abs_test']:.3f}", f"{100 * row['E_u_test']:.2f}"]


def draw_degrees(path: Path, rows: list[dict[str, Any]]) -> None:
    """Figure 6, right: errors by degree at 300 K, here and printed."""
    figure, axes = panels(10, 4.6, count=2)
    degrees = [row["degree"] for row in rows]
    known = [M for M in degrees if M in PRINTED_TABLE_3]
    names = (("E_res_train", "E_res_val"), ("E_u_train", "E_u_val"))
    for ax, pair, first, of in zip(axes, names, (1, 2), ("load", "displacement")):
        for number, (name, said) in enumerate(zip(pair, ("training", "validation"))):
            color = f"C{number}"
            ours = [100 * row[name] for row in rows]
            printed = [PRINTED_TABLE_3[M][first + 2 * number] for M in known]
            ax.semilogy(degrees, ours, "o-", color=color, label=f"{said}, here")
            ax.semilogy(known, printed, "s--", color=color, label=f"{said}, printed")
        ax.set(xlabel="degree of the influence function", ylabel=f"error of the {of} [%]")
    ours = [100 * row["E_u_val_shared"] for row in rows]
    axes[1].semilogy(degrees, ours, "^-", color="C2", label="validation, shared seed")
    for ax in axes:
        ax.set_xticks(degrees)
        ax.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        ax.yaxis.set(major_formatter="{x:g}", minor_formatter="")
        name_lines(ax)
    headline(figure, "At 300 K noise sets the errors; against quiet data degrees help")
    save_figure(figure, path)


def draw_kernels(path: Path, fits: dict[float, Fit], sure: dict[float, Resampled]) -> None:
    """Figure 7, right: K at the bonds for each factor on the loads, with its 90 % band."""
    figure, ax = panels(7, 4.4)
    ax.axhline(0, color="0.7", linewidth=0.8)
    for number, (factor, fit) in enumerate(fits.items()):
        model = fit.material
        classes = bond_classes(model.trained_on[0], model.horizon)

        def values(m: Model, classes: Any = classes) -> np.ndarray:
            return plots.kernel_values(m, classes, classes.r)

        lower, upper = sure[factor].band(model, values, 0.9)
        middle = values(model)
        ax.errorbar(
            classes.r + 0.15 * (number - 1), middle, (upper - lower) / 2,
            fmt="o", capsize=3, color=f"C{number}", label=f"loads × {factor:g}",
        )  # fmt: skip
    ax.set(xlabel="bond length r [Å] (points moved apart by 0.15 Å)", ylabel="K / m  [Å⁻⁴]")
    ax.legend(frameon=False, title="time smoothing, 90 % band by bootstrap")
    ax.set_title("The smaller the loads, the less sure the influence function")
    save_figure(figure, path)
