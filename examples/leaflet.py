"""A heart valve's leaflet learned from displacement alone, as digital image correlation sees it.

Three protocols of a biaxial test are learned from, four are held out; no load is known. By default
the leaflet is synthetic, with noise, and even; --uneven makes its thickness vary. --frames takes a
folder of real frames instead, learns a material and the sheet's thickness from some, and predicts
the others; --other takes the material to another sheet.
"""

import argparse
import contextlib
import json
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

import warp_peri as wp
from examples.figures import panels
from examples.studies.leaflet_rivals import RIVALS, interpolated_errors, rival_errors
from tools.make_leaflet import Leaflet, make_leaflet, noisy
from tools.options import Options
from warp_peri import InputError, Samples
from warp_peri.atoms import noise_of
from warp_peri.atoms.dic import frames_of_folder
from warp_peri.errors import exit_status
from warp_peri.files.atomic import plain, write_json
from warp_peri.tissue import (
    Dictionary,
    DisplacementFit,
    HyperelasticSolid,
    NoEquilibrium,
    PlacedSheet,
    Term,
    families,
    fit_thickness,
    hyperelastic_errors,
    in_words,
    rose,
    rose_of,
    save_febio,
)


def draw(
    solid: HyperelasticSolid,
    test: Samples,
    truth: np.ndarray,
    report: dict[str, Any],
    folder: Path,
    thickness: np.ndarray | None = None,
) -> None:
    """Write the four figures, and the thickness of a sheet that is not even."""
    folder.mkdir(parents=True, exist_ok=True)
    sheet = solid.on(test, thickness=thickness)
    figures = {
        "maps": maps(sheet, test, truth),
        "curves": curves(sheet, test),
        "rose": fibre_rose(solid),
        "errors": errors_by_frame(report),
    }
    if thickness is not None:
        figures["thickness"] = thickness_map(test, thickness)
    for name, figure in figures.items():
        figure.savefig(folder / f"{name}.png", dpi=130)
        plt.close(figure)


def maps(sheet: PlacedSheet, test: Samples, truth: np.ndarray) -> Figure:
    """Measured, predicted and difference of both components on the last held-out frame."""
    u = test.u[-1]
    with contextlib.suppress(NoEquilibrium):
        u = wp.solve(sheet, wp.Dirichlet(test, None, u)).u
    inner = test.interior
    figure, axes = panels(10.5, 6.4, count=3, rows=2)
    for row, component in zip(axes, (0, 1)):
        fields = (truth[-1], u, u - truth[-1])
        for ax, field, title in zip(row, fields, ("measured", "predicted", "difference")):
            values = field[inner, component]
            drawn = ax.scatter(*test.x[inner].T, c=values, s=28, marker="s", cmap="viridis")
            figure.colorbar(drawn, ax=ax, shrink=0.8)
            ax.set(title=f"$u_{component + 1}$, {title}", aspect="equal", xlabel="x", ylabel="y")
    return figure


def thickness_map(test: Samples, thickness: np.ndarray) -> Figure:
    """Thickness over that at the centre."""
    figure, ax = panels(4.6, 4.0)
    x, y = test.x.T
    drawn = ax.scatter(x, y, c=thickness, s=22, marker="s", cmap="cividis")
    figure.colorbar(drawn, ax=ax, label="thickness / that at the centre")
    ax.set(aspect="equal", xlabel="x", ylabel="y", title="in the units of the frames")
    return figure


def curves(sheet: PlacedSheet, test: Samples) -> Figure:
    """Mean nominal stress against mean stretch by protocol; bands span the middle four fifths."""
    protocols = test.arrays.get("protocol", np.zeros(len(test), int))
    figure, axes = panels(9, 3.8, count=2, sharey=True)
    for number in np.unique(protocols):
        points = []
        for n in np.flatnonzero(protocols == number):
            stretch = np.sqrt(1 + 2 * sheet.energies.strain(test.u[n])[test.interior, :2])
            P = sheet.stress(test.u[n])
            stress = P[:, [0, 1], [0, 1]]
            points.append(
                (stretch.mean(axis=0), stress.mean(axis=0), np.quantile(stress, (0.1, 0.9), axis=0))
            )
        for axis, ax in enumerate(axes):
            x = [1.0, *(p[0][axis] for p in points)]
            y = [0.0, *(p[1][axis] for p in points)]
            low, high = ([0.0, *(p[2][end][axis] for p in points)] for end in (0, 1))
            (line,) = ax.plot(x, y, "o-", ms=3, label=f"protocol {number}")
            ax.fill_between(x, low, high, color=line.get_color(), alpha=0.15)
    for ax, name in zip(axes, ("1", "2")):
        ax.set(xlabel=f"stretch $\\lambda_{name}$", title=f"direction {name}")
    axes[0].set_ylabel("stress / initial stiffness")
    axes[0].legend(fontsize=8)
    return figure


def fibre_rose(solid: HyperelasticSolid) -> Figure:
    """Energy of the fibres by direction at the largest stretch of the data."""
    figure, ax = plt.subplots(figsize=(4.2, 4.2), subplot_kw={"projection": "polar"})
    for angle, value in rose_of(solid).items():
        for turn in (0.0, np.pi):
            ax.bar(angle + turn, value, width=0.08, color="tab:red")
    ax.set(yticklabels=[], title="fibres")
    return figure


def errors_by_frame(report: dict[str, Any]) -> Figure:
    """Held-out errors of every frame, of the fits and their rivals."""
    figure, ax = panels(6.4, 3.8)
    fits = {n: e["frames"] for n, e in report.items() if isinstance(e, dict) and "frames" in e}
    for name, frames in fits.items():
        ax.plot(100 * np.asarray(frames), "o-", ms=3, label=name)
    for number, (name, rival) in enumerate(report.get("rivals", {}).items()):
        errors = 100 * np.asarray(rival["frames"])
        ax.plot(errors, "x--", color=f"C{number + len(fits)}", lw=1, ms=3, label=name)
    ax.set(xlabel="held-out frame", ylabel="error of displacement [%]", yscale="log")
    ax.legend(fontsize=8, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0), frameon=False)
    return figure


UNEVEN = "neo-Hookean, uneven"
INTERPOLATED = "no material, interpolation"
NEAREST = ((0, 1), (1, 0), (1, 1), (1, -1))
MATRIX = (Term("plane_stress"), Term("volumetric"))
ROSE = Dictionary(3.0, (), NEAREST, (*MATRIX, *rose(8, (2.0, 3.0, 4.0, 6.0))))
DEGREE = 2
"""Of the polynomial that is the logarithm of a thickness."""
PLAIN = Dictionary(3.0, (), NEAREST, MATRIX)
FOUR = Dictionary(3.0, (), NEAREST, (*MATRIX, *rose(4, (2.0, 4.0))))
CANDIDATES = {"even matrix": (PLAIN, 0), "matrix": (PLAIN, DEGREE)}
"""What a real sheet may be, by name: energies and degree of the thickness."""
FIBROUS = {"even, four directions": (FOUR, 0), "four directions": (FOUR, DEGREE)}
"""What a sheet with fibres may be too; these take many times as long."""
HELD = "matrix, deviations held"
LEAST = 0.05
"""Of the deviations, in units of the initial stiffness."""
Fits = dict[str, tuple[DisplacementFit, float]]


def learn(train: Samples, degree: int, *, progress: bool) -> Fits:
    """A fit on eight directions, then one whose directions and exponents are unknowns."""
    began = time.process_time()
    mark = ", uneven" if degree else ""
    wide = wp.fit(train, ROSE, thickness=degree, most_steps=6, progress=progress)
    fits = {f"eight directions{mark}": (wide, time.process_time() - began)}
    dictionary, start = families(wide.material)
    if len(dictionary.terms) > len(MATRIX):
        few = wp.fit(
            train, dictionary, moving=True, start=start, thickness=degree, most_steps=20,
            tolerance=1e-3, progress=progress,
        )  # fmt: skip
        fits[f"families{mark}"] = few, time.process_time() - began
    return fits


def choose(train: Samples, fibres: bool, *, progress: bool) -> tuple[dict[str, float], Fits]:
    """Errors of the candidates on a frame left out; the best of them, learned from all frames.

    With it a matrix whose deviations are held, so that nothing but material and thickness fits.
    """
    out = np.arange(len(train)) == len(train) // 2
    rest, left = (Samples(train.points, train.u[part]) for part in (~out, out))
    errors, candidates = {}, CANDIDATES | (FIBROUS if fibres else {})
    for name, (dictionary, degree) in candidates.items():
        fit = real_fit(rest, dictionary, degree, progress=progress)
        errors[name] = float(
            hyperelastic_errors(fit.material, left, thickness=of(fit, left))["E_u"]
        )
    best = min(errors, key=lambda name: errors[name])
    fits: Fits = {}
    for name, work in ((best, (*candidates[best], np.inf)), (HELD, (PLAIN, DEGREE, LEAST))):
        began = time.process_time()
        fit = real_fit(train, *work, progress=progress)
        fits[name] = fit, time.process_time() - began
    return errors, fits


def real_fit(
    train: Samples, dictionary: Dictionary, degree: int, most: float = np.inf, *, progress: bool
) -> DisplacementFit:
    """One candidate, its deviations at most so stiff."""
    return wp.fit(
        train, dictionary, stiffness=(LEAST, most), thickness=degree, most_steps=10,
        tolerance=1e-3, progress=progress,
    )  # fmt: skip


def of(fit: DisplacementFit, frames: Samples) -> np.ndarray | None:
    """Thickness of every node, None for an even sheet."""
    return None if fit.thickness is None else fit.thickness.at(frames.x)


def held_out(fit: DisplacementFit, test: Samples, truth: np.ndarray) -> dict[str, Any]:
    """Errors of a fit on frames it never saw."""
    errors = hyperelastic_errors(fit.material, test, truth=truth, thickness=of(fit, test))
    solid = fit.material
    first = solid.dictionary.first_term
    energies = zip(solid.dictionary.labels[first:], solid.coefficients[first:])
    report = {
        "train": fit.history[-1],
        "held out": errors["E_u"],
        "largest": float(np.nanmax(errors["displacements"])),
        "not_solved": errors["not_solved"],
        "frames": errors["displacements"],
        "material": {word: value for word, value in energies if value > 0},
    }
    if fit.thickness is not None:
        report["thickness"] = dict(zip(fit.thickness.names, fit.thickness.numbers))
    if "protocol" in test.arrays:
        protocols = test.arrays["protocol"]
        report["protocols"] = {
            int(n): float(errors["displacements"][protocols == n].mean())
            for n in np.unique(protocols)
        }
    return report


def synthetic(given: argparse.Namespace) -> tuple[Samples, Samples, np.ndarray]:
    """Frames to learn from, frames held out, and the latter without noise."""
    leaflet = Leaflet(**{name: getattr(given, name) for name in vars(Leaflet())})
    sets = make_leaflet(given.data, leaflet=leaflet, jobs=given.jobs, progress=not given.json)
    train = noisy(sets["train"], given.noise, given.seed)
    test = noisy(sets["test"], given.noise, given.seed + 1)
    return train, test, sets["test"].u


def measured(folder: Path, given: argparse.Namespace) -> tuple[Samples, Samples]:
    """Real frames, spread from a quarter of the test to its end: every second is learned from."""
    samples = frames_of_folder(folder, given.count, pixel=given.pixel, radius=given.smooth)
    pick = np.arange(len(samples))[::-1] % 2 == 0
    return tuple(Samples(samples.points, samples.u[part]) for part in (pick, ~pick))  # type: ignore[return-value]


def export(solid: HyperelasticSolid, folder: Path) -> list[str]:
    """Write the material, as FEBio reads it where it can be one; what it says in words."""
    wp.save(folder / "leaflet.json", solid)
    words = in_words(solid)
    try:
        save_febio(solid, folder / "leaflet.feb")
    except InputError as error:
        words.append(f"no material of FEBio's: {error}")
    return words


def other_sheet(
    fits: dict[str, DisplacementFit], folder: Path, given: argparse.Namespace
) -> dict[str, Any]:
    """Errors on another sheet, taken as even, and with the thickness that its own frames tell."""
    own, other = measured(folder, given)
    report: dict[str, Any] = {}
    for name, fit in fits.items():
        uneven = fit_thickness(own, fit.material, DEGREE, progress=not given.json)
        report[f"{folder.name}, {name}"] = held_out(
            replace(fit, thickness=None), other, other.u
        ) | {"own thickness": held_out(uneven, other, other.u)}
    rivals = rival_errors(own, other, other.u, ["neo-Hookean", UNEVEN])
    rivals[INTERPOLATED] = interpolated_errors(other, other.u)
    return report | {f"{folder.name}, {name}": rival for name, rival in rivals.items()}


def blank(report: Any) -> Any:
    """The same with None for frames that were not solved, which JSON has no number for."""
    if isinstance(report, dict):
        return {key: blank(value) for key, value in report.items()}
    if isinstance(report, list):
        return [blank(value) for value in report]
    return None if isinstance(report, float) and np.isnan(report) else report


def arguments() -> argparse.Namespace:
    """What was asked for on the command line."""
    parser = Options(__doc__, "leaflet", json=True)
    parser.add("--noise", type=float, default=0.002, help="of every node, in spacings")
    parser.add("--seed", type=int, default=7, help="of the noise")
    parser.add("--frames", type=Path, help="folder of real frames")
    parser.add("--other", type=Path, nargs="*", default=[], help="folders to predict too")
    parser.add("--fibres", action="store_true", help="real sheets may have fibres")
    parser.add("--count", type=int, default=7, help="real frames to use")
    parser.add("--pixel", type=float, default=1.0, help="length of the frames' unit")
    parser.add("--smooth", type=float, default=0.0, help="radius of local fits, spacings")
    parser.add("--rivals", nargs="*", choices=RIVALS, help="all but the uneven sheet")
    parser.add("--jobs", type=int, default=-1, help="processes that make data")
    parser.add("--data", type=Path, default=ROOT / "data" / "leaflet")
    for name, value in vars(Leaflet()).items():
        parser.add(f"--{name}", type=float, default=value, help="of the synthetic leaflet")
    given = parser.parse_args()
    if given.rivals is None:  # the synthetic leaflet is even
        given.rivals = [name for name in RIVALS if given.frames or name != UNEVEN]
    if not (given.noise >= 0 and given.pixel > 0 and given.count >= 4):
        parser.error(
            "expected --noise ≥ 0, --pixel > 0 and --count ≥ 4, got "
            f"{given.noise}, {given.pixel} and {given.count}"
        )
    return given


def main() -> None:
    given = arguments()
    report: dict[str, Any] = {}
    if not given.frames:
        train, test, truth = synthetic(given)
        fits = learn(train, 0, progress=not given.json)
        if given.uneven:
            fits |= learn(train, DEGREE, progress=not given.json)
    else:
        train, test = measured(given.frames, given)
        truth = test.u
        report["left out"], fits = choose(train, given.fibres, progress=not given.json)
    report |= {
        "frames": [len(train), len(test)],
        "interior nodes": int(train.interior.sum()),
        "noise in spacings": noise_of(test) / test.spacing,
    }
    for name, (fit, seconds) in fits.items():
        report[name] = held_out(fit, test, truth) | {"seconds": seconds}
    best = HELD if given.frames else min(fits, key=lambda name: fits[name][0].history[-1])
    for folder in given.other:
        report |= other_sheet({name: fit for name, (fit, _) in fits.items()}, folder, given)
    report["rivals"] = rival_errors(train, test, truth, given.rivals)
    report["rivals"][INTERPOLATED] = interpolated_errors(test, truth)
    report["words"] = export(fits[best][0].material, given.out)
    draw(fits[best][0].material, test, truth, report, given.out, of(fits[best][0], test))
    report = blank(plain(report))
    write_json(given.out / "errors.json", report)
    if given.json:
        print(json.dumps(report, indent=2))
        return
    for name, entry in (*report.items(), *report["rivals"].items()):
        if isinstance(entry, dict) and "held out" in entry:
            error = "-" if entry["held out"] is None else f"{100 * entry['held out']:.3f} %"
            print(f"{name:20} held out {error} ({entry['not_solved']} not solved)")
            for word, value in (entry.get("material", {}) | entry.get("thickness", {})).items():
                print(f"    {word}: {value:.4f}")
            if "own thickness" in entry:
                print(f"    own thickness: {100 * entry['own thickness']['held out']:.3f} %")
    print("\n".join(report["words"]))


if __name__ == "__main__":
    sys.exit(exit_status(main))
