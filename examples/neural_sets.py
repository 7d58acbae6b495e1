"""What the neural operator is trained on: atoms, an anisotropic sheet, a leaflet."""

import dataclasses
from pathlib import Path

import numpy as np

import warp_peri as wp
from tools.make_hgo import DISK_RADIUS, HORIZON, NODES, SPACING, SQUARES, make_hgo
from tools.make_leaflet import make_leaflet
from warp_peri import Points, Samples

Sets = dict[str, Samples]
LEVELS, LEARNED, CHOSEN = 20, 100, 20
"""Frames of each of the leaflet's seven protocols, and how many to learn from and to choose by."""
REACH = 5
"""Of the leaflet's horizon, in spacings."""


def graphene(file: Path) -> Sets:
    """Coarse-grained atoms: 70 loads, 10 to choose by, 4 disks."""
    data = wp.load(file)
    return {"train": data["train"], "val": data["val"], "disks": data["test"]}


def hgo(folder: Path, reach: int, *, mirror: bool, jobs: int, progress: bool) -> Sets:
    """Squares and disks, for a horizon of so many spacings.

    Without the mirror rule equations stand at the nodes whose surroundings are data: 81 in squares
    of 21, 25 and 29 nodes a side for 3, 4 and 5 spacings; disks shrink. With it the squares have
    21, and equations stand at all inner nodes.
    """
    square = "square" if mirror else next(name for name, n in SQUARES.items() if n == reach)
    made = make_hgo(folder, square=square, jobs=jobs, progress=progress)
    disks = made.pop("disks")
    kept = DISK_RADIUS + 2 * (HORIZON - reach) * SPACING
    inner: np.ndarray = np.hypot(*disks.x.T) <= kept + 1e-9
    sets = {}
    for name, samples in made.items():
        sets[name] = mirrored(samples, reach) if mirror else samples
    return {**sets, "disks": with_interior(disks, inner)}


def with_interior(samples: Samples, interior: np.ndarray) -> Samples:
    """The same fields, with equations at other nodes."""
    points = dataclasses.replace(samples.points, interior=interior)
    return dataclasses.replace(samples, points=points)


def mirrored(samples: Samples, reach: int) -> Samples:
    """The square with a ring of u(v) = 2 u(b) − u(m), where all inner nodes carry equations.

    The rule is right where the second normal derivative of u vanishes at the edge, which a body
    force there contradicts.
    """
    ring = 2 * reach - 1  # nodes of the edge carry no equations
    steps = np.rint(samples.x / SPACING).astype(int)
    u, b = (np.zeros((len(samples), NODES, NODES, 2)) for _ in range(2))
    u[:, steps[:, 0], steps[:, 1]], b[:, steps[:, 0], steps[:, 1]] = samples.u, samples.loads
    place = np.argwhere(np.ones((NODES + 2 * ring,) * 2, bool)) - ring
    edge = np.clip(place, 0, NODES - 1)
    image = 2 * edge - place
    outside = (place != edge).any(axis=1)[None, :, None]
    there = u[:, image[:, 0], image[:, 1]]
    wide = np.where(outside, 2 * u[:, edge[:, 0], edge[:, 1]] - there, there)
    loads = np.where(outside, 0.0, b[:, image[:, 0], image[:, 1]])
    interior: np.ndarray = np.all((place > 0) & (place < NODES - 1), axis=1)
    points = Points(SPACING * place, interior, SPACING, units=samples.points.units)
    return Samples(points, wide, loads)


def leaflet(folder: Path, *, jobs: int, progress: bool) -> Sets:
    """Frames of seven protocols: 100 to learn from, 20 to choose by, 20 held out; 13 × 13 nodes.

    The frames of the last fifth of a load are as likely in each set as others: a draw of seed 0.
    """
    made = make_leaflet(folder, levels=LEVELS, jobs=jobs, progress=progress)
    points = made["train"].points
    steps = np.rint((points.x - points.x.min(axis=0)) / points.spacing).astype(int)
    last = steps.max() + 1 - 2 * REACH
    deep: np.ndarray = np.all((steps >= 2 * REACH) & (steps < last), axis=1)
    points = dataclasses.replace(points, interior=deep)
    u = np.concatenate([made["train"].u, made["test"].u])
    arrays = {
        key: np.concatenate([made["train"].arrays[key], made["test"].arrays[key]])
        for key in ("protocol", "level")
    }
    order = np.random.default_rng(0).permutation(len(u))
    parts = np.split(order, [LEARNED, LEARNED + CHOSEN])
    return {
        name: Samples(points, u[n], arrays={key: part[n] for key, part in arrays.items()})
        for name, part in zip(("train", "val", "test"), parts)
        for n in (np.sort(part),)
    }
