"""Dressed bodies that end or are torn, against atoms: a hole and a crack in graphene, free balls.

python examples/studies/dressed_bodies.py    the hole, the strip and the crack
"""

import dataclasses
import json
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent.parent))

import numpy as np
from scipy.spatial import cKDTree

import warp_peri as wp
from examples.hole_against_atoms import INSIDE, held_sides, mesh_of
from tools.cracked_sheet import CutSession, Pulled, cracked_sheet, longer_cutoff
from tools.crystal_ball import Ball
from tools.crystals import force_constants
from tools.graphene import THICKNESS, bond_length
from tools.graphene_phonons import force_constants as graphene
from tools.holed_sheet import STRIP, Plate, held_samples, loads_of
from tools.make_graphene import SMOOTHING_RADIUS, ZIGZAG
from tools.statics import ColouredHessian
from warp_peri.atoms import force_on_mesh, smoothing_matrix
from warp_peri.dressed import DressedSolid, from_phonons, torn
from warp_peri.edges.body import solve_body
from warp_peri.statics.direct import symmetric_factors
from warp_peri.structures.noise import EV_IN_TPA
from warp_peri.structures.phonons import CONE, relative, smoothing

AROUND = 5.0
"""Radius within which atoms of a node's own side tell its displacement [Å]."""


@dataclass(frozen=True)
class Opened:
    """A sheet with a crack along y = 0.

    `x`: atoms at rest, their faces relaxed [Å], shape [A, 2]; `u`: displacement over the strain of
    the rim along y [Å], shape [A, 2]; `length`: half of the crack [Å]; `step`: width of a hexagon
    along the crack [Å]; `half`: half sides of the part that moves [Å].
    """

    x: np.ndarray
    u: np.ndarray
    length: float
    step: float
    half: float

    def seen(self, nodes: np.ndarray) -> np.ndarray:
        """u at nodes [n, 2], quadratic fits to atoms around; across the crack none are asked."""
        tree, found = cKDTree(self.x), np.empty_like(nodes)
        for i, near in enumerate(tree.query_ball_point(nodes, AROUND)):
            near = np.array(near)
            if abs(nodes[i, 0]) < self.length + AROUND:
                near = near[self.x[near, 1] * nodes[i, 1] > 0]
            dx, dy = (self.x[near] - nodes[i]).T
            weight = np.sqrt(np.maximum(AROUND - np.hypot(dx, dy), 0))[:, None]
            terms = np.column_stack([np.ones(len(near)), dx, dy, dx**2, dx * dy, dy**2])
            found[i] = np.linalg.lstsq(weight * terms, weight * self.u[near])[0][0]
        return found


def opened_sheet(steps: int = 10, half: float = 70.0) -> Opened:
    """The linear answer of a square with a crack of 2 · steps cut bonds, at 0 K."""
    step = cracked_sheet([], half=10.0).step
    ends = np.array([[-steps * step, 0.0], [steps * step, 0.0]])
    body = cracked_sheet([ends], half=half)
    with tempfile.TemporaryDirectory() as folder:
        potential = longer_cutoff(Path(folder))
        with CutSession(body, potential) as session:
            x, found = Pulled(body, session).rest(body.positions)
            if not found:
                raise RuntimeError("the cracked sheet found no rest")
            H = ColouredHessian(body.bonds, len(x))(session.forces, x)
    held = np.repeat(body.held, 2)
    u = x * (0.0, 1.0)
    flat = u.ravel()
    right = -(H[~held][:, held] @ flat[held])
    flat[~held] = symmetric_factors(H[~held][:, ~held]).solve(right)
    return Opened(x, flat.reshape(-1, 2), steps * step, step, half)


HOLED = Plate((120.0, 120.0), 30.0)
TENSION = 3e-4
"""Stress about the loads of the plate [TPa], small enough for it to be linear."""
OFF = 10.0
"""Distance from free edges beyond which displacement is compared [Å]."""
REACH, KEPT = 110.0, 3
"""Of the plate's nodes, and layers of them that are held."""
WITHIN = 8.6
"""Radius up to which a free ball is compared, in spacings: nodes that see no surface."""
ROWS = 3
"""On either side of a crack, where stress is compared."""


def without(solid: DressedSolid) -> DressedSolid:
    """Its base alone, G = 1."""
    return dataclasses.replace(solid, tensors=0 * solid.tensors)


def lattice(half: float, h: float, d: int) -> np.ndarray:
    """Nodes around one in the middle, [N, d]."""
    line = h * np.arange(-int(half / h + 1e-9), int(half / h + 1e-9) + 1)
    return np.stack(np.meshgrid(*[line] * d, indexing="ij"), axis=-1).reshape(-1, d)


def loaded(body: Any, x: np.ndarray, atoms: np.ndarray, forces: np.ndarray, cone: float) -> Any:
    """Forces on atoms spread over the nodes that carry something, all of each: [S, N, d]."""
    alive = body.stiffness.any(axis=1)
    spread = smoothing(atoms, x[alive], cone, None)
    b = np.zeros((len(forces), *x.shape))
    b[:, alive] = [spread @ force for force in forces]
    return b * EV_IN_TPA


def plate(of: Plate = HOLED, spacing: float = 5.0) -> dict[str, Any]:
    """E_u [%] of a plate with a hole, or of a strip, as large as their atoms, under their loads.

    By dressed elements that the outline cuts, by the same without G, and by the same law in a Body,
    which ends in triangles.
    """
    law = from_phonons(graphene(), spacing, "elements", 8, symmetry="isotropic", split=False)
    with tempfile.TemporaryDirectory() as cache:
        samples = held_samples(cache, plates=[of], tension=TENSION, progress=False)[of]
    bond = bond_length()
    R = of.effective_radius(bond) if of.radius else 0.0
    half = np.inf if R else of.effective_height(bond)

    def inside(at: np.ndarray) -> np.ndarray:
        return (np.linalg.norm(at, axis=1) > R) & (np.abs(at[:, 1]) < half)

    x = lattice(REACH, spacing, 2)
    near = 1.5 * spacing
    x = x[(np.linalg.norm(x, axis=1) > R - near) & (np.abs(x[:, 1]) < half + near)]
    inner = np.abs(x if R else x[:, :1]).max(axis=1) < REACH - (KEPT - 0.5) * spacing
    points = wp.Points(x, inner, spacing, axis=ZIGZAG)
    seen, ended = [], []
    far = inner & (np.abs(x) < INSIDE - SMOOTHING_RADIUS).all(axis=1) & (of.edge_distance(x) > OFF)
    mesh = mesh_of(of, bond)
    for sample in samples:
        seen.append(smoothed(sample.reference, sample.displacement, x))
        there = (np.abs(sample.reference) <= INSIDE).all(axis=1)
        atoms = sample.reference[there]
        density = force_on_mesh(mesh, atoms, sample.force[there], thickness=THICKNESS)
        body = solve_body(law.crystal, mesh, displacement=held_sides(of, sample), b=density)
        atoms = atoms[mesh.holding(atoms) >= 0]
        ended.append(smoothed(atoms, body.displacement(atoms), x))
    u = np.array(seen)
    found: dict[str, Any] = {"radius": R} if R else {"half height": half}
    answers = {"body": np.array(ended)}
    for name, solid in {"dressed": law, "elements": without(law)}.items():
        cut = solid.on(points, edges=inside)
        b = [loaded(cut, x, s.reference, s.force[None], SMOOTHING_RADIUS)[0] for s in samples]
        load = np.array(b) / (spacing**2 * THICKNESS)
        answers[name] = wp.solve(cut, wp.Dirichlet(points, load, u)).u
    for name, answer in answers.items():
        each = {load.name: relative(v[None], w[None], far)
                for load, v, w in zip(loads_of(of, TENSION), answer, u)}  # fmt: skip
        found[name] = float(np.mean(list(each.values())))
        found[f"{name}, each"] = each
    return found


def smoothed(atoms: np.ndarray, u: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Displacement at nodes by a plane through that of the atoms around, [N, 2]: at a free edge
    their middle lies beside the node."""
    cone = smoothing_matrix(atoms, x, radius=SMOOTHING_RADIUS, density=True).tocoo()
    node, weight, arm = cone.row, cone.data, atoms[cone.col] - x[cone.row]
    terms = np.column_stack([np.ones(len(arm)), arm / SMOOTHING_RADIUS])
    A, y = np.zeros((len(x), 3, 3)), np.zeros((len(x), 3, 2))
    np.add.at(A, node, weight[:, None, None] * terms[:, :, None] * terms[:, None])
    np.add.at(y, node, weight[:, None, None] * terms[:, :, None] * u[cone.col][:, None])
    return np.asarray((np.linalg.pinv(A, rcond=1e-4, hermitian=True) @ y)[:, 0])


def squeezed_law(name: str, seen: Ball) -> DressedSolid:
    """A split law of the crystal as the surface of a ball squeezes it."""
    symmetry = force_constants(name).group()  # its strain is that of a cubic crystal, too
    return from_phonons(force_constants(name, seen.strain), seen.samples.spacing, symmetry=symmetry)


def free_ball(law: DressedSolid, seen: Ball, per_node: float) -> dict[str, Any]:
    """E_u [%] of a whole free ball, less its rigid motion, two cones of nodes off its surface.

    `law`: of the squeezed crystal; `seen`: atoms and loads; `per_node`: atoms of a cell.
    """
    h = law.spacing
    R = float((len(seen.atoms) / per_node * 3 / (4 * np.pi)) ** (1 / 3)) * h
    x = lattice(R + 1.5 * h, h, 3)
    x = x[np.linalg.norm(x, axis=1) < R + 1.5 * h]
    points = wp.Points(x, np.ones(len(x), bool), h)
    known = seen.samples.x[np.linalg.norm(seen.samples.x, axis=1) < WITHIN * h + 1e-6]
    order = {tuple(step): n for n, step in enumerate(np.rint(x / h).astype(int).tolist())}
    at = [order[tuple(step)] for step in np.rint(known / h).astype(int).tolist()]
    inside = np.linalg.norm(seen.samples.x, axis=1) < WITHIN * h + 1e-6
    turn = np.cross(known[:, None], np.eye(3)[None]).transpose(0, 2, 1).reshape(-1, 3)
    rigid = np.linalg.qr(np.hstack([np.tile(np.eye(3), (len(known), 1)), turn]))[0]

    def still(u: np.ndarray) -> np.ndarray:
        flat = u.reshape(len(u), -1).T
        return np.asarray((flat - rigid @ (rigid.T @ flat)).T)[..., None]

    everywhere = np.ones(rigid.shape[0], bool)
    found: dict[str, Any] = {"radius": R / h, "nodes": len(x)}
    for name, solid in {"dressed": law, "elements": without(law)}.items():
        body = solid.on(points, edges=lambda at: np.linalg.norm(at, axis=1) < R)
        b = loaded(body, x, seen.atoms, seen.forces, CONE * h) / h**3
        u = wp.solve(body, wp.Dirichlet(points, b, 0 * b)).u[:, at]
        found[name] = relative(still(u), still(seen.samples.u[:, inside]), everywhere)
    return found


def faces() -> dict[str, Any]:
    """A torn dressed sheet of graphene, pulled across its crack, beside linear atoms.

    Errors [%] of the opening at the middle, of what the crack adds to displacement in rows beside
    it, and of stress in cells of four nodes beside it; stress ahead of its tip over the pull's
    strain [TPa]. By the dressed law and by its base alone.
    """
    seen = opened_sheet()
    h = seen.step  # nodes as the atoms' rows along the crack
    most = int((seen.half + 7) / h)
    line = h * (np.arange(-most, most) + 0.5)
    x = np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1).reshape(-1, 2)
    points = wp.Points(x, (np.abs(x) < seen.half).all(axis=1), h)
    crack = torn(points, [[(-seen.length, 0.0), (seen.length, 0.0)]])
    true = seen.seen(x)
    law = from_phonons(graphene(), h, "bonds", 12, symmetry="isotropic", split=False)
    tips = round(seen.length / h)
    beside = (np.arange(-tips, tips - 1) + most)[:, None]
    C = law.elastic

    def stress(u: np.ndarray) -> np.ndarray:
        """σ₁₁, σ₂₂, σ₁₂ of cells between nodes, [2m − 1, 2m − 1, 3]."""
        field = u.reshape(2 * most, 2 * most, 2)
        along = np.diff(field, axis=0) / h
        across = np.diff(field, axis=1) / h
        first, second = (along[:, 1:] + along[:, :-1]) / 2, (across[1:] + across[:-1]) / 2
        e = np.stack([first[..., 0], second[..., 1], first[..., 1] + second[..., 0]], axis=-1)
        return np.asarray(e @ C)

    def rows(number: int) -> np.ndarray:
        return (np.abs(x[:, 0]) < seen.length) & (np.abs(np.abs(x[:, 1]) / h - number - 0.5) < 0.1)

    def opening(u: np.ndarray) -> float:
        middle = (np.abs(x[:, 0]) < h) & rows(0)
        return float(u[middle & (x[:, 1] > 0), 1].mean() - u[middle & (x[:, 1] < 0), 1].mean())

    even, told = x * (0.0, 1.0), stress(true)
    found: dict[str, Any] = {}
    for name, solid in {"dressed": law, "base": without(law)}.items():
        body = solid.on(points, edges=True, broken=crack)
        u = wp.solve(body, wp.Dirichlet(points, 0 * x, true)).u
        own = stress(u)
        cells = [[most + n, most - 2 - n] for n in range(ROWS)]
        found[name] = {
            "opening": 100 * (opening(u) / opening(true) - 1),
            "rows": [relative((u - even)[None], (true - even)[None], rows(n)) for n in range(ROWS)],
            "stress": [
                float(
                    100 * np.linalg.norm((own - told)[beside, c]) / np.linalg.norm(told[beside, c])
                )
                for c in cells
            ],
            "stress ahead": own[most + tips : most + tips + 3, most - 1, 1].tolist(),
        }
    found["atoms"] = {"stress ahead": told[most + tips : most + tips + 3, most - 1, 1].tolist()}
    return found


if __name__ == "__main__":
    print(json.dumps({"hole": plate(), "strip": plate(STRIP), "faces": faces()}, indent=1))
