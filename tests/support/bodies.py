"""Small lattice bodies and solids that break, shared by the tests of damage."""

import numpy as np

from tests.support.clouds import plain
from warp_peri.fracture.body import box_nodes, lattice_body
from warp_peri.fracture.dynamics import BreakingBody
from warp_peri.fracture.materials import BrittleMaterial
from warp_peri.solvers.verlet import inertia


def solid(lam=1.0, mu=1.0, horizon=3.0, density=1.0, dimension=2, **criterion):
    """K = 1/r and one criterion, a stretch by default."""
    model = plain(horizon, lam, mu, dimension=dimension)
    density = density / inertia(1.0, model.units)  # density: in units of TPa ps²/Å²
    return BrittleMaterial(model, density, **(criterion or {"critical_stretch": 0.01}))


def plate(width=16, height=12, *depth, horizon=3.0):
    """A rectangle or block of unit cells."""
    return lattice_body(box_nodes((width, height, *depth), 1.0), 1.0, horizon)


def pulled(lam=1.0, sides=(24, 16), horizon=3.0, **criterion):
    """A plate or block whose upper and lower rows are pulled apart by a load."""
    body, height = plate(*sides, horizon=horizon), sides[1]
    y = body.x[:, 1]
    load = np.zeros_like(body.x)
    edge = np.abs(y) > height / 2 - 1
    load[edge, 1] = 0.02 * np.sign(y[edge])
    return BreakingBody(
        solid(lam, horizon=horizon, dimension=len(sides), **criterion),
        body,
        load=load,
        no_fail=np.abs(y) > height / 2 - 3,
    )


def random_breaking(body, random, share):
    """The body's neighbours with a random share of its bonds broken, both directions at once."""
    neighbour = body.neighbour.copy()
    node, bond = np.nonzero(neighbour > np.arange(len(neighbour))[:, None])  # each pair once
    chosen = random.random(len(node)) < share
    node, bond = node[chosen], bond[chosen]
    far = neighbour[node, bond]
    neighbour[node, bond] = -1 - far
    neighbour[far, body.opposite[bond]] = -1 - node
    return neighbour
