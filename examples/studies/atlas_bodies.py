"""Stability atlas: bonds and families that an edge cuts, crystals turned, sheets strained."""

import re
import warnings
from typing import Any

import numpy as np
import scipy.sparse as sp
from tqdm import tqdm

import warp_peri as wp
from examples.exact import plate_with_hole
from examples.figures import curves, name_lines, panels, ticks
from examples.studies.atlas_entry import Entry, entry, square_lattice, words
from tools.crystals import force_constants
from warp_peri import Dataset, Points
from warp_peri.edges.body import long_wave, solve_body
from warp_peri.methods import Coupling
from warp_peri.micromodulus import Crystal, from_phonons, plane_strain, transferred
from warp_peri.points.outlines import Circle, box, mesh_outline

HALF, TENSION = 100.0, 0.005
"""Half of the plate [Å], and tension far from the hole [TPa]."""
RADII = (15.0, 20.0, 25.0, 28.0, 32.0, 36.0, 38.0, 40.0, 42.0, 45.0, 50.0, 55.0)
COUPLED = (20.0, 40.0)
"""Of the holes [Å]: those that cut families, and those with elements at the edge."""
LAYER = 1.5
"""Nodes this close to a hole count as its edge, in spacings."""
SIDES = (9, 13, 17, 25, 33)
STRESS = 0.01
"""At the outermost nodes of a bent sheet [TPa]."""
ANGLES = (0.0, 5.0, 10.0, 15.0, 20.0, 30.0, 45.0)
REACHES = {32: 2.0, 56: 5**0.5, 80: 6**0.5, 122: 3.0}
"""Horizons over the spacing, by the number of bonds."""
INTERIOR, FIELDS = 24, 6
STATED = 20.0


def cut_families(model: wp.Model) -> Entry:
    """Plates whose hole cuts the families of a learned kernel, and the same with elements."""
    spacing = model.certified_on[0]
    cut = [cut_plate(model, spacing, radius) for radius in tqdm(RADII, desc="cut families")]
    coupled = [coupled_error(model, radius) for radius in COUPLED]
    error, edge, eigenvalue = (np.array(column) for column in zip(*cut))
    figure, ax = panels(7, 3.6)
    ax.semilogy(RADII, 100 * edge, "s--", label="families cut, at the edge")
    ax.semilogy(RADII, 100 * error, "o-", label="families cut")
    ax.semilogy(COUPLED, 100 * np.array(coupled), "^-", label="elements at the edge")
    ax.set(xlabel="radius of the hole [Å]", ylabel="error of displacement [%]")
    name_lines(ax)
    numbers = {
        "count": int((eigenvalue < 0).sum()), "radii": len(RADII), "eigenvalue": eigenvalue.min(),
        "error": 100 * error.max(), "edge": 100 * edge.max(), "least": 100 * error.min(),
        "coupled": 100 * max(coupled),
    }  # fmt: skip
    points = lattice_plate(spacing, model.horizon, RADII[0])
    rest = wp.Dirichlet(points, 0 * points.x, 0 * points.x)
    seen: list[Any] = [lambda: wp.solve(model, rest).u, *limits(model)]
    values = {"radius": RADII, "cut": cut, "coupled": coupled}
    return entry("bodies", numbers, seen, figure, values)


def lattice_plate(spacing: float, horizon: float, radius: float) -> wp.Points:
    """Nodes of the plate and a collar of two horizons, those in the hole outside."""
    reach = int(np.ceil((HALF + 2 * horizon) / spacing))
    steps = np.meshgrid(*2 * [np.arange(-reach, reach + 1)], indexing="ij")
    x = spacing * np.stack(steps, axis=-1)
    x = x.reshape(-1, 2).astype(float)
    hole = np.hypot(*x.T) < radius
    inside = (np.abs(x) < HALF).all(axis=1)
    return wp.Points(x, inside & ~hole, spacing, outside=hole)


def cut_plate(model: wp.Model, spacing: float, radius: float) -> tuple[float, float, float]:
    """Errors of displacement with cut families, in the plate and at its edge; the eigenvalue."""
    points = lattice_plate(spacing, model.horizon, radius)
    exact = np.zeros_like(points.x)
    away = np.hypot(*points.x.T) >= radius
    exact[away], _ = plate_with_hole(points.x[away], radius, TENSION, long_wave(model, spacing))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        u = wp.solve(
            model, wp.Dirichlet(points, np.zeros_like(exact), exact), allow_uncertified=True
        ).u
    said = " ".join(str(warning.message) for warning in caught)
    number = re.search(r"symmetric part is ([-+.e\d]+)", said)
    near = points.interior & (np.hypot(*points.x.T) < radius + LAYER * spacing)
    errors = [
        float(np.linalg.norm((u - exact)[nodes]) / np.linalg.norm(exact[nodes]))
        for nodes in (points.interior, near)
    ]
    return errors[0], errors[1], float(number[1]) if number else float("nan")


def coupled_error(model: wp.Model, radius: float) -> float:
    """Error of displacement of the same plate with elements at its edges."""
    mesh = mesh_outline(box(2 * HALF, 2 * HALF), [Circle(radius, size=2.0)], size=8.0)
    finer = wp.transfers.on_lattice(model, spacing=model.certified_on[0] / 2)
    stiff = long_wave(finer, finer.certified_on[0])
    sides = ("left", "right", "top", "bottom")
    held = {side: lambda x: plate_with_hole(x, radius, TENSION, stiff)[0] for side in sides}
    u, _ = solve_body(finer, mesh, displacement=held, coupling=at_home(finer)).on_corners()
    exact, _ = plate_with_hole(mesh.x, radius, TENSION, stiff)
    return float(np.linalg.norm(u - exact) / np.linalg.norm(exact))


def at_home(model: wp.Model, overlap: float | None = None) -> Coupling:
    """The bulk on the lattice that the model is certified on."""
    return Coupling(spacing=model.certified_on[0], overlap=overlap)


def limits(model: wp.Model) -> list[str]:
    """What is said of a small hole, of hardly any overlap, and of a thin body."""
    finer = wp.transfers.on_lattice(model, spacing=model.certified_on[0] / 2)
    plate = box(2 * HALF, 2 * HALF)
    small = mesh_outline(plate, [Circle(5.0, size=2.0)], size=8.0)
    thin = mesh_outline(box(2 * HALF, 30.0), size=4.0)

    def run(mesh: wp.Mesh, overlap: float | None = None) -> str:
        held = {"left": (0.0, 0.0), "right": (0.1, 0.0)}
        coupling = at_home(finer, overlap)
        return words(lambda: solve_body(finer, mesh, displacement=held, coupling=coupling))

    return [run(small), run(mesh_outline(plate, size=1.5), 1e-3), run(thin)]


def sheet(side: int, spacing: float) -> Points:
    """A square of free nodes around the origin."""
    line = spacing * (np.arange(side) - (side - 1) / 2)
    x = np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1).reshape(-1, 2)
    return Points(x, np.ones(len(x), bool), spacing)


def bent(points: Points, elastic: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Displacement and load of a sheet under σ₁₁ proportional to x₂, on its two sides."""
    x, y = points.x.T
    end = x.max()
    S = np.linalg.inv(elastic) * STRESS / end
    u = np.stack([S[0, 0] * x * y, (S[0, 1] * y**2 - S[0, 0] * x**2) / 2], axis=1)
    b = np.zeros_like(u)
    corner = np.where(np.abs(y) == end, 0.5, 1.0)
    b[:, 0] = STRESS * y / end * corner * (np.sign(x) * (np.abs(x) == end)) / points.spacing
    return u, b


def cut_bonds(law: Crystal, points: Points) -> sp.csr_array:
    """The crystal's bonds, those that leave the sheet left out."""
    steps, C = law.steps, law.tensors
    side = round(len(points.x) ** 0.5)
    number = np.pad(np.arange(side**2).reshape(side, side), np.abs(steps).max(), constant_values=-1)
    reach = np.abs(steps).max()
    parts = []
    for step, tensor in zip(steps, C):
        at = tuple(slice(reach + s, reach + s + side) for s in step)
        other = number[at].ravel()
        own = np.flatnonzero(other >= 0)
        rows = sp.csr_array(
            (
                np.repeat([1.0, -1.0], len(own)),
                (np.tile(np.arange(len(own)), 2), np.append(own, other[own])),
            ),
            shape=(len(own), side**2),
        )
        parts.append(sp.kron(rows.T @ rows, tensor))
    return sp.csr_array(sum(parts[1:], parts[0]))


def cut_at_edges(data: Dataset) -> Entry:
    """Errors of bent free sheets whose bonds are cut, against their size."""
    law = wp.fit(data["train"], wp.Micromodulus(12.5)).material
    errors = []
    for side in SIDES:
        points = sheet(side, law.spacing)
        u, b = bent(points, law.elastic_tensor())
        rigid = _rigid(points.x)
        stiff = cut_bonds(law, points).toarray() + rigid @ rigid.T
        answer = np.linalg.solve(stiff, b.ravel())
        wrong, whole = (
            np.linalg.norm(v - rigid @ (rigid.T @ v)) for v in (answer - u.ravel(), u.ravel())
        )
        errors.append(float(100 * wrong / whole))
    figure, ax = panels()
    table = {"learned bonds, cut": errors}
    axes = {"ylabel": "error of displacement [%]", "ylim": (0, 65)}
    curves(ax, "semilogx", SIDES, table, "C3o-", xlabel="nodes a side", **axes)
    ticks(ax, SIDES)
    numbers = {"cut": errors[1], "side": SIDES[1], "bonds": law.bonds}
    return entry("edges", numbers, (lambda: law.on(points),), figure, table)


def _rigid(x: np.ndarray) -> np.ndarray:
    """Orthonormal rigid motions, [2 N, 3]."""
    turn = np.stack([-x[:, 1], x[:, 0]], axis=1)
    shifts = [np.tile(e, len(x)) for e in np.eye(2)]
    return np.linalg.qr(np.stack([*shifts, turn.ravel()], axis=1))[0]


def crystals() -> Entry:
    """Traction on a cut face that only turns, and errors of a direction that is not stated."""
    atoms = force_constants("Cu")
    h = float(atoms.cell[0, 0])
    laws = {n: from_phonons(atoms, h, r * h, symmetry="m-3m") for n, r in REACHES.items()}
    traction = {n: 1e3 * turned_face(law) for n, law in laws.items()}
    M = 1e3 * laws[80].elastic_tensor()
    half = (M[0, 1] - M[3, 3]) / 2
    copper = plane_strain(laws[80])
    graphene = from_phonons(force_constants("graphene"), 5.0, 12.5, symmetry="6mm")
    wrong = {
        name: [100 * unstated(law, angle) for angle in ANGLES]
        for name, law in (("copper, plane strain", copper), ("graphene", graphene))
    }
    figure, (left, right) = panels(9.2, 3.6, count=2)
    left.bar([str(n) for n in traction], list(traction.values()))
    left.axhline(half, color="C1", ls="--", label="(C12 − C44)/2")
    left.set(xlabel="bonds of a node, copper", ylabel="traction on a rotated face [GPa/rad]")
    left.set_ylim(0, 1.3 * max(traction.values()))
    left.legend(frameon=False)
    axes = {"xlabel": "angle of the axis that is not stated [°]"}
    axes["ylabel"] = "error of displacement [%]"
    rows = {name: error[1:] for name, error in wrong.items()}
    curves(right, "semilogy", ANGLES[1:], rows, "o-", **axes)
    numbers = {"angle": STATED, "traction": traction[80], "half": half}
    for key, error in zip(("copper", "graphene"), wrong.values()):
        numbers |= {key: max(error), f"{key}_told": error[ANGLES.index(STATED)]}
    values = {"traction": traction, "angle": ANGLES, "error": wrong}
    return entry("crystals", numbers, refusals(copper), figure, values)


def turned_face(law: Crystal) -> float:
    """Traction per radian on a {001} face, by a sum over the bonds that it leaves."""
    steps, tensors = np.concatenate([law.steps, -law.steps]), np.concatenate([law.tensors] * 2)
    turn = np.zeros((3, 3))
    turn[0, 2], turn[2, 0] = 1.0, -1.0
    force = np.zeros(3)
    for depth in range(int(steps.max())):
        whole = steps[:, 2] <= depth  # a node so far below the face has these bonds left
        pulls = np.einsum("nij,nj->i", tensors[whole], -(law.spacing * steps[whole]) @ turn.T)
        force += law.spacing * pulls
    return float(np.linalg.norm(force))


def unstated(law: Crystal, angle: float) -> float:
    """Error of displacement where the crystal lies at an angle [degrees] and nobody said so."""
    points = square_lattice(INTERIOR, law.horizon, law.spacing)
    there = transferred(law, law.spacing, rotation=angle)
    rng = np.random.default_rng(0)
    u = np.zeros((FIELDS, *points.x.shape))
    for field in u:
        for _ in range(6):
            k = rng.normal(size=2)
            k *= 2 * np.pi / (rng.uniform(4, 16) * law.spacing * np.linalg.norm(k))
            field += rng.normal(size=2) * np.cos(points.x @ k + rng.uniform(0, 6))[:, None]
    b = np.zeros_like(u)
    stated = wp.Points(points.x, points.interior, points.spacing, axis=angle)
    b[:, points.interior] = there.on(stated)(u)
    found = wp.solve(law, wp.Dirichlet(points, b, u)).u
    inside = points.interior
    wrong, size = (np.linalg.norm(x[:, inside].reshape(FIELDS, -1), axis=1) for x in (found - u, u))
    return float((wrong / size).mean())


def refusals(law: Crystal) -> list[str]:
    """What is said of cut bonds, and of a direction that is not the law's."""
    points = square_lattice(8, law.horizon, law.spacing)
    free = wp.Points(points.x, np.ones(len(points.x), bool), points.spacing)
    other = wp.Points(points.x, points.interior, points.spacing, axis=STATED)
    return [words(lambda: law.on(free)), words(lambda: law.on(other))]
