"""Periodic sheets that are not even: boron nitride in graphene, vacancies; linear, at 0 K."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from tools.graphene import THICKNESS, bond_length, sheet
from tools.graphene_phonons import force_constants
from tools.lammps_session import LammpsSession
from tools.make_graphene import SMOOTHING_RADIUS
from tools.statics import Statics
from warp_peri import Points, Samples
from warp_peri.atoms import coarse_grain, smoothing_matrix
from warp_peri.core.elastic import allowed_tensors, voigt
from warp_peri.core.groups import point_group
from warp_peri.structures.calculators import potential_file

CELLS, NODES = (78, 45), 40
"""Of four atoms along x and y, 197.3 × 197.2 Å; and nodes each way."""
SHORTEST, WAVES = 20.0, 6
"""Wavelength [Å], and waves of a load."""
PATCHES = (25.0, 15.0, 10.0)
"""Radii of local loads [Å]."""
APART = 3.5
"""Vacancies are at least so far from one another [Å]."""

Place = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Sheet:
    """An uneven sheet.

    `sets`: loads "train", "val" (waves) and "patch" (local); `density`: smoothed number of atoms
    over that of the whole sheet, at the nodes; `inside`: share of the atoms around a node that are
    boron and nitrogen.
    """

    sets: dict[str, Samples]
    density: np.ndarray
    inside: np.ndarray


def moduli(elements: tuple[str, ...]) -> np.ndarray:
    """Voigt matrix [TPa] of a whole sheet of some elements on graphene's sites."""
    atoms = force_constants("BNC.tersoff", elements)
    C = atoms.elastic(allowed_tensors("isotropic", point_group("isotropic", 2), np.eye(2)))
    return voigt(C)


def uneven_sheet(
    nitride: Place | None = None,
    vacant: Place | None = None,
    *,
    train: int = 4,
    others: int = 10,
    seed: int = 0,
) -> Sheet:
    """Atoms' linear answers seen from nodes.

    `nitride`: which positions over the box, [n, 2] from −½ to ½, are boron nitride, [n] bool;
    `vacant`: share of atoms that is missing at such positions, [n]; `train`, `others`: loads of the
    set to learn from, and of each of the other two; `seed`: of loads and vacancies.
    """
    rng = np.random.default_rng(seed)
    potential = potential_file("SiC_1989.tersoff" if nitride is None else "BNC.tersoff")
    bond = bond_length(potential)
    whole, box = sheet(bond, cells=CELLS)
    kept = ~_vacancies(whole, box, vacant, rng)
    kind = np.zeros(len(whole), int)
    if nitride is not None:
        kind = np.where(nitride(whole / box), 1 + np.arange(len(whole)) % 2, 0)
    names = ("C",) if nitride is None else ("C", "B", "N")
    x, kind = whole[kept], kind[kept]
    with LammpsSession(x, box=box, potential=potential, elements=names, kind=kind) as session:
        statics = Statics(x, box=box, session=session)
        x = statics.reference
        forces = [waves(x, box, rng) for _ in range(train + others)]
        forces += [patch(x, box, r, rng) for r in np.resize(PATCHES, others)]
        forces = [force - force.mean(axis=0) for force in forces]
        moved = [statics.linear_response(force) for force in forces]
    line = (np.arange(NODES) + 0.5) / NODES - 0.5
    at = np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1).reshape(-1, 2) * box
    omega, even = (smoothing_matrix(a, at, radius=SMOOTHING_RADIUS, box=box) for a in (x, whole))
    area = float(np.prod(box)) / NODES**2
    u, b = coarse_grain(
        omega, displacement=moved, force=forces, node_area=area, thickness=THICKNESS
    )
    # sides differ by .07 %: nodes are taken as square
    h = area**0.5
    points = Points.sheet((NODES, NODES), h)
    cuts = {"train": slice(train), "val": slice(train, train + others),
            "patch": slice(train + others, None)}  # fmt: skip
    sets = {name: Samples(points, u[cut], b[cut]) for name, cut in cuts.items()}
    count = np.asarray(omega.sum(axis=1))
    return Sheet(sets, count / np.asarray(even.sum(axis=1)), (omega @ (kind > 0)) / count)


def _vacancies(
    x: np.ndarray, box: tuple[float, float], vacant: Place | None, rng: np.random.Generator
) -> np.ndarray:
    gone = np.zeros(len(x), bool)
    if vacant is None:
        return gone
    share = 1.25 * vacant(x / box)  # some stand too near to another
    tree = cKDTree(np.mod(x, box), boxsize=box)
    for i in rng.permutation(len(x)):
        near = tree.query_ball_point(np.mod(x[i], box), APART)
        if rng.uniform() < share[i] and not gone[near].any():
            gone[i] = True
    return gone


def waves(
    x: np.ndarray, box: tuple[float, float], rng: np.random.Generator, shortest: float = SHORTEST
) -> np.ndarray:
    """Force on atoms of a load of WAVES waves of a period, none shorter than this [Å]."""
    force, found = np.zeros_like(x), 0
    most = int(max(box) / shortest)
    while found < WAVES:
        k = 2 * np.pi * rng.integers(-most, most + 1, 2) / box
        size = np.linalg.norm(k)
        if not 0 < size <= 2 * np.pi / shortest:
            continue
        angle = rng.uniform(0, 2 * np.pi)
        wave = size * np.cos(x @ k + rng.uniform(0, 2 * np.pi))
        force += np.outer(wave, [np.cos(angle), np.sin(angle)])
        found += 1
    return force


def patch(
    x: np.ndarray, box: tuple[float, float], radius: float, rng: np.random.Generator
) -> np.ndarray:
    """Two opposite bumps somewhere."""
    angle = rng.uniform(0, 2 * np.pi)
    force = np.zeros_like(x)
    middle = rng.uniform(-0.5, 0.5, 2) * box
    for sign, at in ((1, middle), (-1, middle + rng.uniform(0.3, 0.5, 2) * box)):
        arm = x - at
        arm -= box * np.rint(arm / box)
        bump = np.cos(np.pi / 2 * np.minimum(1, np.linalg.norm(arm, axis=1) / radius))
        force += sign * np.outer(bump / bump.sum(), [np.cos(angle), np.sin(angle)])
    return force
