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
import scipy.sparse as sparse
from scipy.ndimage import convolve1d
from scipy.sparse.linalg import splu

import warp_peri as wp
from examples.prose import table
from tools.options import Options
from warp_peri import Samples
from warp_peri.errors import exit_status
from warp_peri.points.lattice import lattice_steps

BETWEEN = np.zeros(19)
BETWEEN[::2] = np.array([35, -405, 2268, -8820, 39690, 39690, -8820, 2268, -405, 35]) / 2**16
BETWEEN[9] = 1.0
"""Ten-point interpolation half way, on points twice as dense."""
MASS = np.array([[4, 2, -1], [2, 16, 2], [-1, 2, 4]]) / 30
SLOPES = np.array([[7, -8, 1], [-8, 16, -8], [1, -8, 7]]) / 3
SLOPE = np.array([[-3, -4, 1], [4, 0, -4], [-1, 4, 3]]) / 6
"""∫ φφ, ∫ φ′φ′ and ∫ φ′φ of quadratic functions on (0, 1)."""


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
    place = 4 * (steps - steps.min(axis=0))
    shape = tuple(place.max(axis=0) + 1)
    inner = place[samples.interior]
    around = 2 * np.array(list(np.ndindex(4, 4))) - 4
    corners = np.unique((inner[:, None] + around).reshape(-1, 2), axis=0)
    nine = corners[:, None] + np.array(list(np.ndindex(3, 3)))
    own = np.ravel_multi_index(tuple(np.moveaxis(nine, -1, 0)), shape)
    used, local = np.unique(own, return_inverse=True)
    local = local.reshape(own.shape)
    fine = np.stack(np.unravel_index(used, shape), axis=1)
    whole = np.bincount(local.ravel()) == np.where(fine % 2 == 0, 2, 1).prod(axis=1)
    nodes = np.ravel_multi_index(tuple(place.T), shape)
    whole &= ~np.isin(used, nodes[~samples.interior])
    loose = np.repeat(whole, 2)

    stiff, mass = _matrices(lam, mu, samples.spacing / 2)
    K, M = (_assembled(local, matrix) for matrix in (stiff, mass))
    held, load = (
        _refined(field @ axes, place, shape)[:, used].reshape(len(field), -1).T
        for field in (samples.u, samples.loads)
    )
    right = (M @ load)[loose] - K[loose][:, ~loose] @ held[~loose]
    held[loose] = splu(K[loose][:, loose].tocsc()).solve(right)
    found = np.zeros((len(samples.u), int(np.prod(shape)), 2))
    found[:, used] = held.T.reshape(len(samples.u), -1, 2)
    inside = samples.interior[:, None]
    return np.where(inside, found[:, nodes] @ axes.T, samples.u)


def _matrices(lam: float, mu: float, h: float) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness and mass of an element, shape [18, 18] each; u₁ and u₂ of a point side by side."""
    first, second = np.kron(SLOPES, MASS), np.kron(MASS, SLOPES)  # ∫ ∂₁φ ∂₁φ, ∫ ∂₂φ ∂₂φ
    mixed = np.kron(SLOPE, SLOPE.T)  # ∫ ∂₁φ ∂₂φ
    both = [[first, mixed], [mixed.T, second]]
    K = np.zeros((9, 2, 9, 2))
    for a, b in np.ndindex(2, 2):
        K[:, a, :, b] = lam * both[a][b] + mu * both[b][a] + (a == b) * mu * (first + second)
    return K.reshape(18, 18), np.kron(np.kron(MASS, MASS), np.eye(2)) * h**2


def _assembled(local: np.ndarray, matrix: np.ndarray) -> sparse.csr_array:
    """Sum over elements of one matrix, by the numbers of their points, shape [E, 9]."""
    unknown = (2 * local[..., None] + np.arange(2)).reshape(len(local), -1)
    rows, columns = (np.broadcast_to(one, (len(local), 18, 18)).ravel() for one in
                     (unknown[:, :, None], unknown[:, None]))  # fmt: skip
    values = np.broadcast_to(matrix, (len(local), 18, 18)).ravel()
    return sparse.coo_array((values, (rows, columns))).tocsr()


def _refined(field: np.ndarray, place: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """A field [S, N, 2] on points a quarter of a spacing apart, [S, points, 2]."""
    grid = np.zeros((len(field), *shape, 2))
    grid[:, place[:, 0], place[:, 1]] = field
    wide = np.zeros(2 * len(BETWEEN) - 1)
    wide[::2] = BETWEEN  # half way between nodes first
    for weights in (wide, BETWEEN):
        for axis in (1, 2):
            grid = convolve1d(grid, weights, axis=axis, mode="constant")
    return grid.reshape(len(field), -1, 2)


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
