"""Local elasticity on the nodes of a set: the solid without a horizon that a law is held against.

    python examples/local_elasticity.py

Prints E_u [%] of the main job's model and of local elasticity with the potential's moduli on scenes
that no fit saw (tools/make_scenes.py makes them). Biquadratic elements half a spacing wide; loads
and displacements of the collar go to points between the nodes by ten-point interpolation.
"""

import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

import numpy as np
from scipy.ndimage import binary_erosion, convolve1d

import warp_peri as wp
from examples.prose import table
from examples.studies.fem_rival import elastic_solver
from tools.options import Options
from warp_peri import Points, Samples
from warp_peri.errors import exit_status
from warp_peri.points.lattice import lattice_steps

FINER = 4
"""Points of elements, which are two of them wide, in a spacing."""
BETWEEN = np.zeros(19)
BETWEEN[::2] = np.array([35, -405, 2268, -8820, 39690, 39690, -8820, 2268, -405, 35]) / 2**16
BETWEEN[9] = 1.0
"""Ten-point interpolation half way, on points twice as dense."""


def errors_of_local(samples: Samples, lam: float, mu: float) -> np.ndarray:
    """E_u of local elasticity by sample: relative ℓ2 errors on the interior, shape [S]."""
    inside = samples.interior
    wrong, true = solve_local(samples, lam, mu)[:, inside] - samples.u[:, inside], samples.u
    size = np.linalg.norm(true[:, inside].reshape(len(true), -1), axis=1)
    return np.linalg.norm(wrong.reshape(len(wrong), -1), axis=1) / size


def solve_local(samples: Samples, lam: float, mu: float) -> np.ndarray:
    """Displacements [S, N, 2] under the loads; u is held on the collar, as it is given.

    Args:
        samples: on a square lattice, with a collar of six nodes at least.
        lam, mu: of plane elasticity [stress].
    """
    steps, axes = lattice_steps(samples.points)
    place = FINER * (steps - steps.min(axis=0))
    shape = tuple(place.max(axis=0) + 1)
    body = np.zeros(shape, bool)  # the elements that touch the interior
    for corner in np.ndindex(2 * FINER + 1, 2 * FINER + 1):
        body[tuple((place[samples.interior] + corner - FINER).T)] = True
    free = binary_erosion(body, np.ones((3, 3)))
    free[tuple(place[~samples.interior].T)] = False
    used = np.argwhere(body)
    fine = Points(used * samples.spacing / FINER, free[body], samples.spacing / FINER)
    u, b = (_refined(field @ axes, place, shape)[:, body] for field in (samples.u, samples.loads))
    u[:, free[body]] = elastic_solver(fine, order=2, lam=lam, mu=mu)(b, u)
    found = np.zeros((len(u), *shape, 2))
    found[:, body] = u
    inside = samples.interior[:, None]
    return np.where(inside, found[:, place[:, 0], place[:, 1]] @ axes.T, samples.u)


def _refined(field: np.ndarray, place: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """A field [S, N, 2] on points a quarter of a spacing apart, [S, *shape, 2]."""
    grid = np.zeros((len(field), *shape, 2))
    grid[:, place[:, 0], place[:, 1]] = field
    wide = np.zeros(2 * len(BETWEEN) - 1)
    wide[::2] = BETWEEN  # half way between nodes first
    for weights in (wide, BETWEEN):
        for axis in (1, 2):
            grid = convolve1d(grid, weights, axis=axis, mode="constant")
    return grid


def scenes(model: Path, data: Path) -> str:
    """A row for each scene at 1 and 3 % strain: E_u of the model and of local elasticity [%]."""
    material, sets = wp.load(model), wp.load(data)
    truth = wp.load(ROOT / "data" / "graphene_0K.h5").provenance["truth"]
    rows = []
    for name in (name for name in sets if name.rsplit("_")[-1] in ("1", "3")):
        local = errors_of_local(sets[name], truth["lambda"], truth["mu"]).mean()
        errors = wp.evaluate(material, sets[name], allow_uncertified=True)["E_u"], local
        rows.append([name.replace("_", ", ") + " %", *(f"{100 * error:.2f}" for error in errors)])
    return table(["scene, strain", "linear solid", "local elasticity"], rows)


def main(arguments: list[str] | None = None) -> int:
    parser = Options(__doc__, defaults=True)
    parser.add("--model", type=Path, default=ROOT / "runs" / "graphene_0K" / "model.json")
    parser.add("--data", type=Path, default=ROOT / "data" / "graphene_0K_scenes.h5")
    given = parser.parse_args(arguments)
    return exit_status(lambda: print(scenes(given.model, given.data)))


if __name__ == "__main__":
    sys.exit(main())
