"""Stability atlas: crystals whose bonds are cut, and crystals that lie otherwise than was said."""

import matplotlib.pyplot as plt
import numpy as np

import warp_peri
from examples.studies.atlas_entry import Entry, square_lattice, words, written
from tools.crystals import force_constants
from warp_peri.micromodulus import Crystal, from_phonons, plane_strain, transferred

ANGLES = (0.0, 5.0, 10.0, 15.0, 20.0, 30.0, 45.0)
REACHES = {32: 2.0, 56: 5**0.5, 80: 6**0.5, 122: 3.0}
"""Horizons over the spacing, by the number of bonds."""
INTERIOR, FIELDS = 24, 6
STATED = 20.0


def crystals() -> Entry:
    """Traction on a cut face that only turns, and errors of a direction that is not stated."""
    atoms = force_constants("Cu")
    h = float(atoms.cell[0, 0])
    laws = {n: from_phonons(atoms, h, r * h, symmetry="m-3m") for n, r in REACHES.items()}
    traction = {n: 1e3 * turned_face(law) for n, law in laws.items()}
    M = 1e3 * laws[80].elastic_tensor()
    copper = plane_strain(laws[80])
    carbon = force_constants("graphene")
    graphene = from_phonons(carbon, 5.0, 12.5, symmetry="6mm")
    wrong = {
        name: [100 * unstated(law, angle) for angle in ANGLES]
        for name, law in (("copper, plane strain", copper), ("graphene", graphene))
    }
    figure, (left, right) = plt.subplots(1, 2, figsize=(9.2, 3.6), layout="constrained")
    left.bar([str(n) for n in traction], list(traction.values()))
    left.axhline((M[0, 1] - M[3, 3]) / 2, color="C1", ls="--", label="(C12 − C44)/2")
    left.set(xlabel="bonds of a node, copper", ylabel="traction on a turned face [GPa/rad]")
    left.set_ylim(0, 1.3 * max(traction.values()))
    left.legend(frameon=False)
    for name, error in wrong.items():
        right.semilogy(ANGLES[1:], error[1:], "o-", label=name)
    right.set(
        xlabel="crystal against the nodes, not stated [°]", ylabel="error of displacement [%]"
    )
    right.legend(frameon=False)
    told = ANGLES.index(STATED)
    return Entry(
        *written(
            "crystals",
            angle=STATED,
            traction=traction[80],
            half=(M[0, 1] - M[3, 3]) / 2,
            copper=max(wrong["copper, plane strain"]),
            copper_told=wrong["copper, plane strain"][told],
            graphene=max(wrong["graphene"]),
            graphene_told=wrong["graphene"][told],
        ),
        refusals(copper),
        figure,
        {"traction": traction, "angle": ANGLES, "error": wrong},
    )


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
    stated = warp_peri.Points(points.x, points.interior, points.spacing, axis=angle)
    b[:, points.interior] = there.on(stated)(u)
    found = warp_peri.solve(law, warp_peri.Dirichlet(points, b, u)).u
    inside = points.interior
    wrong, size = (np.linalg.norm(x[:, inside].reshape(FIELDS, -1), axis=1) for x in (found - u, u))
    return float((wrong / size).mean())


def refusals(law: Crystal) -> list[str]:
    """What is said of cut bonds, and of a direction that is not the law's."""
    points = square_lattice(8, law.horizon, law.spacing)
    free = warp_peri.Points(points.x, np.ones(len(points.x), bool), points.spacing)
    other = warp_peri.Points(points.x, points.interior, points.spacing, axis=STATED)
    return [words(lambda: law.on(free)), words(lambda: law.on(other))]
