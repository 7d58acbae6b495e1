"""Stability atlas: a sheet at large deformation, pushed together with and without deviations."""

from dataclasses import replace
from functools import partial

import matplotlib.pyplot as plt
import numpy as np

from examples.studies.atlas_entry import Entry, words
from warp_peri import Points
from warp_peri.tissue import Dictionary, Term
from warp_peri.tissue.equilibrium import StaticProblem
from warp_peri.tissue.operator import HyperelasticOperator

NEAREST = ((0, 1), (1, 0), (1, 1), (1, -1))
STIFFNESSES = (0.0, 0.05, 0.2, 0.5)
SHEET = (0.0713, 0.0780, 0.2)
"""Matrix, volume and fibres of the published sheet [its stress]."""


def hourglass() -> Entry:
    """Smallest eigenvalue of the tangent against uniform compression."""
    steps = np.argwhere(np.ones((21, 21), bool))
    inner: np.ndarray = np.all((steps >= 6) & (steps < 15), axis=1)
    points = Points(0.05 * steps, inner, 0.05)
    terms = (Term("neo_hookean"), Term("volumetric"), Term("fibre_exponential", np.pi / 2, 1.5))
    dictionary = Dictionary(3.0, (), NEAREST, terms)
    problem = StaticProblem(HyperelasticOperator(dictionary, points))
    stretches = np.linspace(1.0, 0.6, 21)
    curves = {}
    for stiffness in STIFFNESSES:
        c = np.array([stiffness] * len(NEAREST) + list(SHEET))
        curves[stiffness] = [
            problem.smallest_eigenvalue(c, (stretch - 1) * points.x) / problem.softest
            for stretch in stretches
        ]
    on_corners = dictionary.with_terms([replace(term, corner=True) for term in terms])
    cornered = problem.with_terms(on_corners.terms)
    c = np.array([0.0] * len(NEAREST) + list(SHEET))
    corners = [
        cornered.smallest_eigenvalue(c, (stretch - 1) * points.x) / problem.softest
        for stretch in stretches
    ]
    first = {
        stiffness: float(1 - stretches[np.argmax(np.array(values) <= 0)])
        for stiffness, values in curves.items()
        if min(values) <= 0
    }
    figure, ax = plt.subplots(figsize=(6.4, 4.2), layout="constrained")
    for stiffness, values in curves.items():
        ax.plot(100 * (1 - stretches), values, label=f"deviations {stiffness:g}")
    ax.plot(100 * (1 - stretches), corners, "k--", label="no deviations, on corners")
    ax.axhline(0, color="k", lw=0.8)
    ax.set(xlabel="compression [%]", ylabel="smallest eigenvalue / Laplacian's", ylim=(-0.6, 0.6))
    ax.legend()
    bare = replace(dictionary, deviations=())
    alone = StaticProblem(HyperelasticOperator(bare, points))
    seen = []
    for part in (0.1, 0.3):
        u = -part * points.x + 1e-4 * np.sin(40 * points.x)
        seen.append(words(partial(alone.solve, np.array(SHEET), None, u)))
    fails = [f"{100 * part:.0f} % at {stiffness:g}" for stiffness, part in first.items()]
    least = (
        f"On corners of cells the smallest eigenvalue stays above {min(corners):.2f} without any."
    )
    return Entry(
        title="A sheet pushed together",
        number=f"Unstable from this compression on, by stiffness of the deviations: {', '.join(fails)}. {least}",
        text=(
            "A nodal strain is a central difference and does not see the shortest waves, so nothing "
            "but tension holds the nodes against them. Without deviations (H6) such waves cost\n"
            "nothing at rest and release energy under any compression. Deviations vanish in uniform "
            "strain, so they stiffen\nthe short waves alone; bounding the coefficients of bonds "
            "instead would stiffen the sheet. A solve follows stable\nequilibria from rest and says "
            "when it had to leave them (`Equilibrium.followed`) or found none. The same energies of "
            "triangles at the\ncorners of cells (H19) see every wave; `fit_energy(stable=…)` shares a "
            "material between nodes and corners so that\nno sampled wave grows in sampled strains of the data."
        ),
        seen=seen,
        figure=figure,
        values={
            "compression": 1 - stretches,
            "corners": corners,
            **{str(k): v for k, v in curves.items()},
        },
    )
