"""Stability atlas: learned bonds that are cut where a body ends; sheets strained too far."""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
import scipy.sparse as sp

import warp_peri
from examples.studies.atlas_entry import Entry, square_lattice, words, written
from warp_peri import Dataset, Points
from warp_peri.dressed import DressedSolid, FiniteSolid

SIDES = (9, 13, 17, 25, 33)
STYLES = {"learned bonds, cut": "C3o-", "elements, dressed": "C0o-", "bonds, dressed": "C1o-"}
SIDE = 8
"""Unknown nodes a side of a strained sheet."""
HOLES = (0.25, 0.5, 1, 2, 4, 8)
HOLE_SIDE = 48
"""Radii over the spacing, and spacings a side of the plate."""
STRESS = 0.01
"""At the outermost nodes of a bent sheet [TPa]."""


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


def cut_bonds(law: DressedSolid, points: Points) -> sp.csr_array:
    """The even law's own bonds, those that leave the sheet left out."""
    steps, C = law.crystal.steps, law.crystal.tensors
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
    """Errors of bent free sheets against their size: bonds cut, and dressed."""
    law = warp_peri.fit(data["train"], warp_peri.Dressed("elements", 8)).material
    on_bonds = warp_peri.fit(data["train"], warp_peri.Dressed("bonds", 12)).material
    curves: dict[str, list[float]] = {name: [] for name in STYLES}
    for side in SIDES:
        points = sheet(side, law.spacing)
        u, b = bent(points, law.elastic)
        answers = {}
        for name, one in (("elements, dressed", law), ("bonds, dressed", on_bonds)):
            body = one.on(points, edges=True)
            answers[name] = warp_peri.solve(body, warp_peri.Dirichlet(points, b, 0 * b)).u
        rigid = _rigid(points.x)
        stiff = cut_bonds(law, points).toarray() + rigid @ rigid.T
        answers["learned bonds, cut"] = np.linalg.solve(stiff, b.ravel()).reshape(-1, 2)
        for name, answer in answers.items():
            wrong, whole = (
                np.linalg.norm(v - rigid @ (rigid.T @ v)) for v in ((answer - u).ravel(), u.ravel())
            )
            curves[name].append(float(100 * wrong / whole))
    seen = words(lambda: law.on(points))
    figure, ax = plt.subplots(figsize=(6.4, 4.2), layout="constrained")
    for name, style in STYLES.items():
        ax.loglog(SIDES, curves[name], style, label=name)
    ax.set(xlabel="nodes a side", ylabel="error of displacement [%]")
    ax.set_xticks(SIDES, labels=map(str, SIDES))
    ax.minorticks_off()
    ax.legend(frameon=False)
    cut, on_elements, plain = (values[1] for values in curves.values())
    numbers = {"side": SIDES[1], "cut": cut, "dressed": on_elements, "plain": plain}
    return Entry(
        *written("edges", bonds=law.crystal.bonds, **numbers), [seen], figure, dict(curves)
    )


def _rigid(x: np.ndarray) -> np.ndarray:
    """Orthonormal rigid motions, [2 N, 3]."""
    turn = np.stack([-x[:, 1], x[:, 0]], axis=1)
    shifts = [np.tile(e, len(x)) for e in np.eye(2)]
    return np.linalg.qr(np.stack([*shifts, turn.ravel()], axis=1))[0]


def pulled_plate(x: np.ndarray, R: float, lam: float, mu: float) -> np.ndarray:
    """u over the stress of an infinite plate with a round hole, pulled along the first axis."""
    z = x[:, 0] + 1j * x[:, 1]
    z = np.where(np.abs(z) < 0.2 * R, 0.2 * R, z)  # of no meaning inside the hole
    slope = 0.25 * (1 - 2 * R**2 / z**2)
    psi = -0.5 * (z + R**2 / z - R**4 / z**3)
    k = (lam + 3 * mu) / (lam + mu)
    u = (k * 0.25 * (z + 2 * R**2 / z) - z * slope.conj() - psi.conj()) / (2 * mu)
    return np.stack([u.real, u.imag], axis=1)


def small_holes(data: Dataset) -> Entry:
    """Errors of what a hole adds against its size, cut elements integrated and left as stairs."""
    law = warp_peri.fit(data["train"], warp_peri.Dressed("elements", 8)).material
    h, middle = law.spacing, np.array([0.37, 0.21])  # of the hole: nowhere in particular
    most = HOLE_SIDE // 2
    line = h * np.arange(-most, most + 1)
    x = np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1).reshape(-1, 2)
    lam, mu = law.elastic[0, 1], law.elastic[2, 2]
    curves: dict[str, list[float]] = {"fitted elements": [], "stairs": []}
    for radius in HOLES:
        R, at = radius * h, x - middle * h
        outside = np.linalg.norm(at, axis=1) > R
        points = Points(x, np.abs(x).max(axis=1) < (most - 2.5) * h, h)
        exact, even = (pulled_plate(at, r, lam, mu) for r in (R, 0.0))
        for name in curves:

            def inside(y: np.ndarray, stairs: bool = name == "stairs", R: float = R) -> np.ndarray:
                place = (np.floor(y / h) + 0.5) * h if stairs else y
                return np.asarray(np.linalg.norm(place - middle * h, axis=1) > R)

            body = law.on(points, edges=inside)
            u = warp_peri.solve(body, warp_peri.Dirichlet(points, 0 * x, exact)).u
            seen = outside & points.interior
            wrong, added = (np.linalg.norm(v[seen]) for v in (u - exact, exact - even))
            curves[name].append(float(100 * wrong / added))
    figure, ax = plt.subplots(figsize=(6.4, 4.2), layout="constrained")
    for (name, values), style in zip(curves.items(), ("C0o-", "C1o-")):
        ax.loglog(HOLES, values, style, label=name)
    ax.set(xlabel="radius of the hole over the spacing", ylabel="error of what it adds [%]")
    ax.set_xticks(HOLES, labels=[f"{r:g}" for r in HOLES])
    ax.minorticks_off()
    ax.legend(frameon=False)
    fitted, stairs = curves.values()
    numbers = {"small": fitted[0], "two": fitted[HOLES.index(2)], "stairs": stairs[HOLES.index(2)],
               "large": fitted[-1], "least": HOLES[0], "most": HOLES[-1]}  # fmt: skip
    far = words(lambda: law.on(points, edges=lambda y: y[:, :1] > 0))
    return Entry(*written("small-holes", **numbers), [far], figure, dict(curves))


def stretched_beyond(law: FiniteSolid | None = None) -> Entry:
    """The least eigenvalue of a strained sheet's tangent against |H|, and what is proven."""
    law = law or FiniteSolid(5.0, -0.197, 0.722, -0.120, 0.034, 0.047, -0.44, -7.32, 1.11)
    points = square_lattice(SIDE, 1.5 * law.spacing, law.spacing)
    points = replace(points, axis=0.0)
    body, inside = law.on(points), np.repeat(points.interior, 2)
    x = points.x - points.x[points.interior].mean(axis=0)
    k = 2 * np.pi / (6 * law.spacing)
    ways = {
        "stretched both ways": x,
        "stretched one way": x * [1, 0],
        "sheared": x[:, ::-1] * [1, 0],
        "a wave of six spacings": np.stack([np.sin(k * x[:, 0]), 0 * x[:, 0]], axis=1) / k,
    }
    sizes = np.linspace(0, 0.16, 33)
    curves: dict[str, list[float]] = {}
    for name, u in ways.items():
        u = u / body.largest_gradient(u)
        least = [np.linalg.eigvalsh(body.tangent(s * u).toarray()[:, inside])[0] for s in sizes]
        curves[name] = [float(value / least[0]) for value in least]
    first = min(float(np.interp(0, -np.array(c), sizes)) for c in curves.values() if min(c) < 0)
    beyond = (first + 0.01) * ways["stretched both ways"] / 2**0.5
    seen = words(lambda: body.rest(0 * beyond, beyond))
    figure, ax = plt.subplots(figsize=(6.4, 4.2), layout="constrained")
    for name, values in curves.items():
        ax.plot(100 * sizes, values, label=name)
    ax.axvspan(0, 100 * law.strain, color="C2", alpha=0.2, lw=0, label="proven")
    ax.axhline(0, color="k", lw=0.8)
    ax.set(xlabel="largest |H| [%]", ylabel="least eigenvalue over that at rest", ylim=(-1, 1.5))
    ax.legend(frameon=False)
    numbers = {"proven": 100 * law.strain, "first": 100 * first}
    return Entry(*written("stretched", **numbers), [seen], figure, dict(curves) | numbers)
