"""Stability atlas: a sheet that is not even, learned from as if it were."""

import warnings

import matplotlib.pyplot as plt
import numpy as np

from examples.studies.atlas_entry import Entry, square_lattice, words, written
from tools.hyperelastic_elements import Elements, quadrilaterals
from tools.hyperelastic_energies import plane_stress_hgo
from tools.make_leaflet import Leaflet
from warp_peri import Samples
from warp_peri.tissue import Dictionary, DisplacementFit, Term, hyperelastic_errors
from warp_peri.tissue.from_displacement import fit_displacement

NEAREST = ((0, 1), (1, 0), (1, 1), (1, -1))
SHEET = Dictionary(3.0, (), NEAREST, (Term("plane_stress"), Term("volumetric")))
SPACING, INTERIOR = 0.1, 7
AMPLITUDES = (0.0, 0.1, 0.2, 0.4)


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
    curves: dict[str, list[float]] = {
        name: [] for name in ("ratio", "even", "uneven", "even, carried", "uneven, carried")
    }
    carried = frames(0.0, range(3, 4))
    for amplitude in AMPLITUDES:
        train, test = frames(amplitude, range(2)), frames(amplitude, range(2, 3))
        thick = Leaflet(uneven=amplitude).thickness(train.x - train.x.mean(axis=0))[train.interior]
        curves["ratio"].append(float(thick.max() / thick.min()))
        for name, degree in (("even", 0), ("uneven", 2)):
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                fit = fit_displacement(train, SHEET, thickness=degree, most_steps=8)
            curves[name].append(error(fit, test))
            curves[f"{name}, carried"].append(error(fit, carried, own=False))
    seen = words(lambda: fit_displacement(train, SHEET, most_steps=8))
    figure, ax = plt.subplots(figsize=(6.4, 4.2), layout="constrained")
    for name, style in (
        ("even", "C3o-"), ("uneven", "C0o-"), ("even, carried", "C3s--"), ("uneven, carried", "C0s--"),
    ):  # fmt: skip
        ax.semilogy(curves["ratio"], curves[name], style, label=name)
    ax.set(xlabel="thickest / thinnest place", ylabel="error of displacement [%]")
    ax.legend(frameon=False, ncols=2, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    last = {name.replace(", ", "_"): values[-1] for name, values in curves.items()}
    return Entry(*written("uneven", **last), [seen], figure, dict(curves))
