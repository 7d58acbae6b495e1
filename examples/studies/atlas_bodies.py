"""Stability atlas: families that an edge cuts, and what coupling with elements cannot do."""

import re
import warnings

import matplotlib.pyplot as plt
import numpy as np
from tqdm import tqdm

import warp_peri
from examples.exact import plate_with_hole
from examples.studies.atlas_entry import Entry, words, written
from warp_peri.edges.body import long_wave, solve_body
from warp_peri.methods import Coupling
from warp_peri.points.outlines import Circle, box, mesh_outline

HALF, TENSION = 100.0, 0.005
"""Half of the plate [Å], and tension far from the hole [TPa]."""
RADII = (15.0, 20.0, 25.0, 28.0, 32.0, 36.0, 38.0, 40.0, 42.0, 45.0, 50.0, 55.0)
COUPLED = (20.0, 40.0)
"""Of the holes [Å]: those that cut families, and those with elements at the edge."""
LAYER = 1.5
"""Nodes this close to a hole count as its edge, in spacings."""


def cut_families(model: warp_peri.Model) -> Entry:
    """Plates whose hole cuts the families of a learned kernel, and the same with elements."""
    spacing = model.certified_on[0]
    cut = [cut_plate(model, spacing, radius) for radius in tqdm(RADII, desc="cut families")]
    coupled = [coupled_error(model, radius) for radius in COUPLED]
    error, edge, eigenvalue = (np.array(column) for column in zip(*cut))
    figure, ax = plt.subplots(figsize=(5.2, 3.6), layout="constrained")
    ax.semilogy(RADII, 100 * edge, "s--", label="families cut, at the edge")
    ax.semilogy(RADII, 100 * error, "o-", label="families cut")
    ax.semilogy(COUPLED, 100 * np.array(coupled), "^-", label="elements at the edge")
    ax.set(xlabel="radius of the hole [Å]", ylabel="error of displacement [%]")
    ax.legend(frameon=False)
    return Entry(
        *written(
            "bodies",
            count=int((eigenvalue < 0).sum()),
            radii=len(RADII),
            eigenvalue=eigenvalue.min(),
            error=100 * error.max(),
            edge=100 * edge.max(),
            least=100 * error.min(),
            coupled=100 * max(coupled),
        ),
        [refusal(model, spacing), *limits(model)],
        figure,
        {"radius": RADII, "cut": cut, "coupled": coupled},
    )


def lattice_plate(spacing: float, horizon: float, radius: float) -> warp_peri.Points:
    """Nodes of the plate and a collar of two horizons, those in the hole outside."""
    reach = int(np.ceil((HALF + 2 * horizon) / spacing))
    steps = np.meshgrid(*2 * [np.arange(-reach, reach + 1)], indexing="ij")
    x = spacing * np.stack(steps, axis=-1)
    x = x.reshape(-1, 2).astype(float)
    hole = np.hypot(*x.T) < radius
    inside = (np.abs(x) < HALF).all(axis=1)
    return warp_peri.Points(x, inside & ~hole, spacing, outside=hole)


def cut_plate(model: warp_peri.Model, spacing: float, radius: float) -> tuple[float, float, float]:
    """Errors of displacement with cut families, in the plate and at its edge; the eigenvalue."""
    points = lattice_plate(spacing, model.horizon, radius)
    exact = np.zeros_like(points.x)
    away = np.hypot(*points.x.T) >= radius
    exact[away], _ = plate_with_hole(points.x[away], radius, TENSION, long_wave(model, spacing))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        u = warp_peri.solve(
            model, warp_peri.Dirichlet(points, np.zeros_like(exact), exact), allow_uncertified=True
        ).u
    said = " ".join(str(warning.message) for warning in caught)
    number = re.search(r"symmetric part is ([-+.e\d]+)", said)
    near = points.interior & (np.hypot(*points.x.T) < radius + LAYER * spacing)
    errors = [
        float(np.linalg.norm((u - exact)[nodes]) / np.linalg.norm(exact[nodes]))
        for nodes in (points.interior, near)
    ]
    return errors[0], errors[1], float(number[1]) if number else float("nan")


def refusal(model: warp_peri.Model, spacing: float) -> str:
    """What a solve with cut families says."""
    points = lattice_plate(spacing, model.horizon, RADII[0])
    u = np.zeros_like(points.x)
    return words(lambda: warp_peri.solve(model, warp_peri.Dirichlet(points, u, u)).u)


def coupled_error(model: warp_peri.Model, radius: float) -> float:
    """Error of displacement of the same plate with elements at its edges."""
    mesh = mesh_outline(box(2 * HALF, 2 * HALF), [Circle(radius, size=2.0)], size=8.0)
    finer = warp_peri.transfers.on_lattice(model, spacing=model.certified_on[0] / 2)
    stiff = long_wave(finer, finer.certified_on[0])
    sides = ("left", "right", "top", "bottom")
    held = {side: lambda x: plate_with_hole(x, radius, TENSION, stiff)[0] for side in sides}
    u, _ = solve_body(finer, mesh, displacement=held, coupling=at_home(finer)).on_corners()
    exact, _ = plate_with_hole(mesh.x, radius, TENSION, stiff)
    return float(np.linalg.norm(u - exact) / np.linalg.norm(exact))


def at_home(model: warp_peri.Model, overlap: float | None = None) -> Coupling:
    """The bulk on the lattice that the model is certified on."""
    return Coupling(spacing=model.certified_on[0], overlap=overlap)


def limits(model: warp_peri.Model) -> list[str]:
    """What is said of a small hole, of hardly any overlap, and of a thin body."""
    finer = warp_peri.transfers.on_lattice(model, spacing=model.certified_on[0] / 2)
    plate = box(2 * HALF, 2 * HALF)
    small = mesh_outline(plate, [Circle(5.0, size=2.0)], size=8.0)
    thin = mesh_outline(box(2 * HALF, 30.0), size=4.0)

    def run(mesh: warp_peri.Mesh, overlap: float | None = None) -> str:
        held = {"left": (0.0, 0.0), "right": (0.1, 0.0)}
        coupling = at_home(finer, overlap)
        return words(lambda: solve_body(finer, mesh, displacement=held, coupling=coupling))

    return [run(small), run(mesh_outline(plate, size=1.5), 1e-3), run(thin)]
