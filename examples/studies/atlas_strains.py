"""Stability atlas: large strains, compression, sheets that are not even, noise on displacements."""

import warnings
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import warp_peri as wp
from examples import neural_sets
from examples.figures import curves, name_lines, note, panels
from examples.studies.atlas_entry import Entry, entry, square_lattice, words
from examples.studies.neural_noise import REACH, learned
from tools.failure import to_failure
from tools.hyperelastic_elements import Elements, quadrilaterals
from tools.hyperelastic_energies import plane_stress_hgo
from tools.loads import TEST, VALIDATION, Load
from tools.make_graphene import graphene_bodies, point_set
from tools.make_leaflet import Leaflet
from tools.make_strained import strained, strained_file
from tools.samples import Piece, Sample, _statics, read_sample, write_record
from warp_peri import Dataset, InputError, Points, Samples
from warp_peri.methods import Smoothing
from warp_peri.neural import evaluate
from warp_peri.tissue import Dictionary, DisplacementFit, Term, hyperelastic_errors
from warp_peri.tissue.equilibrium import StaticProblem
from warp_peri.tissue.from_displacement import fit_displacement
from warp_peri.tissue.operator import HyperelasticOperator

STRAINS = (0.01, 0.02, 0.04, 0.06, 0.08, 0.1, 0.12)
"""Largest bond strains; from the last on the load grows until atoms fail."""
CASE, DISK = 2, 1
"""Numbers of a validation load, a patch pushed across the crystal's zigzag direction, and of a load
on a disk."""
NEAREST = ((0, 1), (1, 0), (1, 1), (1, -1))
STIFFNESSES = (0.0, 0.05, 0.2, 0.5)
SHEET = (0.0713, 0.0780, 0.2)
"""Matrix, volume and fibres of the published sheet [its stress]."""
EVEN = Dictionary(3.0, (), NEAREST, (Term("plane_stress"), Term("volumetric")))
SPACING, INTERIOR = 0.1, 7
AMPLITUDES = (0.0, 0.1, 0.2, 0.4)
LEVELS = (0.0, 0.002, 0.005, 0.01)
EPOCHS = 60
SOLVED = 10


def larger_strains(data: Dataset, cache: Path) -> Entry:
    """E_u of a patch load against the largest bond strain, up to where atoms fail."""
    sheet, disk = graphene_bodies()
    patch = VALIDATION[CASE - 1]
    path = _growing(sheet, patch, cache)
    sets = _on_nodes(sheet, patch, path)
    of_disk = _growing(disk, TEST[DISK - 1], cache)[-1].max_bond_strain
    train, crystal = data["train"], wp.Micromodulus(15.0)
    energy = wp.fit(train, wp.ThirdOrder(crystal, Smoothing(10.0, 0.2), "energy")).material
    models: dict[str, Any] = {
        "linear model": wp.fit(train, crystal).material,
        "third order, with energy": energy,
        "third order, deconvolved": wp.fit(train, wp.ThirdOrder(crystal, Smoothing(10.0))).material,
    }
    errors: dict[str, list[float]] = {name: [] for name in models}
    with warnings.catch_warnings(action="ignore", category=UserWarning):
        for samples in sets.values():
            for name, model in models.items():
                try:
                    errors[name].append(wp.evaluate(model, samples)["E_u"])
                except InputError:
                    errors[name].append(np.nan)
    figure, ax = panels(7, 3.6)
    percent = 100 * np.array(list(sets))
    for name, values in errors.items():
        ax.semilogy(percent, 100 * np.array(values), "o-", label=name)
    of_patch = path[-1].max_bond_strain
    ax.set(xlabel="largest bond strain [%]", ylabel="error of displacement [%]")
    for body, strain, style in (("patch", of_patch, ":"), ("disk", of_disk, "--")):
        ax.axvline(100 * strain, color="0.6", linestyle=style)
        note(ax, f"atoms fail\n({body})", (100 * strain, ax.get_ylim()[0]), (-4, 4), ha="right")
    name_lines(ax)
    proven, column = energy.proven_strain(train.spacing), STRAINS.index(0.04)
    linear, of_energy, smooth = (np.array(values) for values in errors.values())
    numbers = {
        "linear": 100 * linear[column], "filtered": 100 * smooth[column],
        "worst": 100 * float(np.nanmax(smooth)),
        "bears_filtered": percent[np.isfinite(smooth)].max(),
        "bears_energy": percent[np.isfinite(of_energy)].max(),
        "patch_fails": 100 * of_patch, "disk_fails": 100 * of_disk, "proven": 100 * proven,
    }  # fmt: skip
    seen = (lambda: wp.evaluate(energy, sets[max(sets)]),)
    measured = {"strains": list(sets), "proven": proven, "disk_fails_at": of_disk, **errors}
    return entry("larger-strains", numbers, seen, figure, measured)


def _growing(body: Piece, load: Load, cache: Path) -> list[Sample]:
    """The load at growing strains, to the last equilibrium of the atoms."""
    path: list[Sample] = []
    for strain in STRAINS:
        file = strained_file(cache, body, load, strain)
        equilibrium = read_sample(file)
        if equilibrium is None:
            equilibrium = strained(body, _statics(body), load, strain, path[-1] if path else None)
            write_record(file, equilibrium)
        path.append(equilibrium)
    return path + to_failure(body, load, path[-1])


def _on_nodes(body: Piece, load: Load, path: list[Sample]) -> dict[float, Samples]:
    """Samples on nodes 5 Å apart by their strain."""
    return {
        sample.max_bond_strain: replace(point_set(body, [load], [sample], spacing=5.0), arrays={})
        for sample in path
    }


def hourglass() -> Entry:
    """Smallest eigenvalue of the tangent against uniform compression."""
    steps = np.argwhere(np.ones((21, 21), bool))
    inner: np.ndarray = np.all((steps >= 6) & (steps < 15), axis=1)
    points = Points(0.05 * steps, inner, 0.05)
    terms = (Term("neo_hookean"), Term("volumetric"), Term("fibre_exponential", np.pi / 2, 1.5))
    dictionary = Dictionary(3.0, (), NEAREST, terms)
    problem = StaticProblem(HyperelasticOperator(dictionary, points))
    stretches = np.linspace(1.0, 0.6, 21)

    def smallest(statics: StaticProblem, stiffness: float) -> list[float]:
        c = np.array([stiffness] * len(NEAREST) + list(SHEET))
        return [
            statics.smallest_eigenvalue(c, (stretch - 1) * points.x) / problem.softest
            for stretch in stretches
        ]

    table = {stiffness: smallest(problem, stiffness) for stiffness in STIFFNESSES}
    on_corners = dictionary.with_terms([replace(term, corner=True) for term in terms])
    corners = smallest(problem.with_terms(on_corners.terms), 0.0)
    fails = [
        f"{100 * (1 - stretches[np.argmax(np.array(values) <= 0)]):.0f} % at {stiffness:g}"
        for stiffness, values in table.items()
        if min(values) <= 0
    ]
    figure, ax = panels()
    for stiffness, values in table.items():
        ax.plot(100 * (1 - stretches), values, label=f"stiffness of deviations {stiffness:g}")
    ax.plot(100 * (1 - stretches), corners, "k--", label="no deviations, on corners")
    ax.axhline(0, color="k", lw=0.8)
    ax.set(xlabel="compression [%]", ylabel="smallest eigenvalue / Laplacian's", ylim=(-0.6, 0.6))
    name_lines(ax)
    alone = StaticProblem(HyperelasticOperator(replace(dictionary, deviations=()), points))
    pushed = (-part * points.x + 1e-4 * np.sin(40 * points.x) for part in (0.1, 0.3))
    seen = [partial(alone.solve, np.array(SHEET), None, u) for u in pushed]
    rows = {str(stiffness): row for stiffness, row in table.items()}
    measured = {"compression": 1 - stretches, "corners": corners, **rows}
    numbers = {"fails": ", ".join(fails), "corners": min(corners)}
    return entry("compression", numbers, seen, figure, measured)


def frames(uneven: float, waves: range) -> Samples:
    """Frames of a neo-Hookean sheet of elements, stretched by a quarter with waves on its edge."""
    points = square_lattice(INTERIOR, 3 * SPACING, SPACING)
    middle, side = points.x.mean(axis=0), np.ptp(points.x[:, 0])
    mesh = Elements(quadrilaterals(10, side + 2 * SPACING, points.x.min() - SPACING))
    mesh.dx = mesh.dx * Leaflet(uneven=uneven).thickness(mesh.quadrature - middle)
    fields = []
    for number in waves:
        edge = mesh.x @ np.array([[-0.05, 0.05], [0.0, 0.25]])
        edge += 0.03 * np.sin((2 + 0.5 * number) * mesh.x[:, ::-1] + number)
        given = edge.ravel()[mesh.edge]
        u = mesh.solve(plane_stress_hgo(1.0), np.zeros(2 * mesh.nodes), mesh.edge, given, steps=2)
        fields.append(mesh.sample(u, points.x))
    return Samples(points, np.stack(fields))


def error(fit: DisplacementFit, test: Samples, *, own: bool = True) -> float:
    """Of the solved displacement [%], as thick as was learned or, where not `own`, even."""
    thickness = fit.thickness.at(test.x) if own and fit.thickness is not None else None
    return 100 * float(hyperelastic_errors(fit.material, test, thickness=thickness)["E_u"])


def uneven_as_even() -> Entry:
    """Errors of an even fit and of one with a thickness, against how uneven the sheet is."""
    styles = {
        "homogeneous": "C3o-", "heterogeneous": "C0o-",
        "homogeneous, transferred": "C3s--", "heterogeneous, transferred": "C0s--",
    }  # fmt: skip
    table: dict[str, list[float]] = {name: [] for name in styles}
    ratios = []
    carried = frames(0.0, range(3, 4))
    for amplitude in AMPLITUDES:
        train, test = frames(amplitude, range(2)), frames(amplitude, range(2, 3))
        thick = Leaflet(uneven=amplitude).thickness(train.x - train.x.mean(axis=0))[train.interior]
        ratios.append(float(thick.max() / thick.min()))
        for name, degree in (("homogeneous", 0), ("heterogeneous", 2)):
            with warnings.catch_warnings(action="ignore"):
                fit = fit_displacement(train, EVEN, thickness=degree, most_steps=8)
            table[name].append(error(fit, test))
            table[f"{name}, transferred"].append(error(fit, carried, own=False))
    figure, ax = panels()
    axes = {"xlabel": "thickest / thinnest place", "ylabel": "error of displacement [%]"}
    curves(ax, "semilogy", ratios, table, *styles.values(), **axes)
    table = {"ratio": ratios} | table
    last = {name.replace(", ", "_"): values[-1] for name, values in table.items()}
    seen = (lambda: fit_displacement(train, EVEN, most_steps=8),)
    return entry("uneven", last, seen, figure, table)


def noise(folder: Path) -> Entry:
    """Residuals on clean squares, and the share of equilibria, against the noise learned from."""
    sets = neural_sets.hgo(folder, REACH, mirror=False, jobs=1, progress=False)
    test = sets["test"]
    residual, found = [], []
    seen: list[str] = []
    for level in LEVELS:
        law = learned(sets, level, EPOCHS)
        errors = evaluate(law, test, most=SOLVED)
        residual.append(100 * errors["E_res"])
        found.append(100 * errors["converged"])
        if not seen and errors["converged"] < 1:
            lost = int(np.argmin(errors["samples"]["converged"]))
            problem = wp.Dirichlet(test.points, test.loads[lost], test.u[lost])
            seen.append(words(partial(wp.solve, law, problem)))
    figure, ax = panels()
    levels = [100 * level for level in LEVELS]
    rows = {"residual of clean forces": residual, "equilibria found": found}
    axes = {"xlabel": "noise on the displacements learned from [%]", "ylabel": "share [%]"}
    curves(ax, "plot", levels, rows, "o-", "s--", ylim=(0, 105), **axes)
    numbers = {
        "epochs": EPOCHS, "solved": SOLVED, "most": levels[-1], "clean": residual[0],
        "worst": residual[-1], "left": found[-1], "kept": found[0],
    }  # fmt: skip
    values = {"noise": levels, "residual": residual, "found": found}
    return entry("noisy-strains", numbers, seen, figure, values)
