"""The best isotropic LPS on square or cubic nodes, as a rival of micromodulus tensors."""

import numpy as np
from scipy.optimize import least_squares

from warp_peri.core.stencil import bend, directions, half_ball, laplacian, zone_sample
from warp_peri.micromodulus import Crystal
from warp_peri.micromodulus.force_constants import ForceConstants

WAVES, LARGEST = 200, 2.0
PENALTY = 3.0


def isotropic_lps(atoms: ForceConstants, spacing: float, horizon: float) -> Crystal:
    """D = Σ v (1 − cos) ξξ/r² + κ φφᵗ, φ = Σ v sin(k·ξ) ξ, a weight v for each orbit of bonds.

    Long waves are isotropic and the symbol positive; fitted on the same relative rows as the
    tensors, in TPa and Å. The answer is its stencil, which reaches twice as far.
    """
    d = atoms.dimension
    steps = half_ball(horizon / spacing, d)
    r2 = (steps**2).sum(axis=1)
    kinds = np.sort(np.abs(steps), axis=1)
    orbit = np.unique(kinds, axis=0, return_inverse=True)[1].ravel()
    count = int(orbit.max()) + 1
    one = np.eye(count)[orbit]  # bonds × orbits
    x = steps.astype(float)
    fourth = (x**4).sum(axis=1)  # long waves are isotropic: Σ v (ξ₁⁴ − 3 ξ₁² ξ₂²)/r² = 0
    even = one.T @ ((fourth - 3 / (d - 1) * (r2**2 - fourth)) / r2)
    free = np.linalg.svd(even[None])[2][1:].T
    products = np.einsum("ni,nj->nij", x, x) / r2[:, None, None]

    def tables(phase: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        gamma = np.einsum("kn,no,nij->okij", bend(phase, steps), one, products, optimize=True)
        phi = np.einsum("kn,no,ni->oki", 2 * np.sin(phase @ steps.T), one, x, optimize=True)
        return gamma, phi

    number = np.arange(WAVES)
    size = LARGEST * (0.02 + 0.98 * ((number * 0.6180339887) % 1))
    phase = size[:, None] * directions(WAVES, d)
    flexible = np.linalg.inv(atoms.effective(phase / spacing))
    near, zone = tables(phase), zone_sample(np.array([np.eye(d), -np.eye(d)], int), d, 4)
    far, s = tables(zone), laplacian(zone)

    def symbol(table: tuple[np.ndarray, np.ndarray], q: np.ndarray) -> np.ndarray:
        v = free @ q[:-1]
        phi = np.tensordot(v, table[1], 1)
        return np.tensordot(v, table[0], 1) + q[-1] * phi[:, :, None] * phi[:, None, :]

    plain = 1 / np.sqrt([r2[orbit == o][0] for o in range(count)])
    scale = np.trace(atoms.effective(phase[:20] / spacing).mean(axis=0)) / np.trace(
        np.tensordot(plain, near[0][:, :20], 1).mean(axis=0)
    )

    def misses(q: np.ndarray) -> np.ndarray:
        q = np.append(q[:-1] * scale, q[-1] / scale)
        fit = flexible @ symbol(near, q) - np.eye(d)
        low = np.linalg.eigvalsh(symbol(far, q))[:, 0] / s
        floor = 0.02 * scale
        return np.append(fit.ravel() / np.sqrt(WAVES), PENALTY * np.minimum(0, low / floor - 1))

    best = least_squares(misses, np.append(free.T @ plain, 0.1), max_nfev=200)
    q = np.append(best.x[:-1] * scale, best.x[-1] / scale)
    v = free @ q[:-1]
    gamma, phi = (one @ v)[:, None, None] * products, (one @ v)[:, None] * x
    return _as_tensors(steps, gamma, phi, float(q[-1]), spacing)


def _as_tensors(
    steps: np.ndarray, gamma: np.ndarray, phi: np.ndarray, kappa: float, spacing: float
) -> Crystal:
    """The tensors of Γ + κ φφᵗ: bonds of range 2δ come from products of sines (theory.md, T17)."""
    both = np.concatenate([steps, -steps])
    slope = np.concatenate([phi, -phi])
    found = {
        tuple(step): value.copy() for step, value in zip(both.tolist(), np.tile(gamma, (2, 1, 1)))
    }
    for a, first in zip(both, slope):
        for b, second in zip(both, slope):
            step = tuple((a + b).tolist())
            if any(step):
                found[step] = found.get(step, np.zeros(phi.shape[1:] * 2)) + kappa * np.outer(
                    first, second
                )
    half = [step for step in found if step > (0,) * len(step)]
    tensors = np.array([found[step] for step in half])
    tensors = (tensors + tensors.transpose(0, 2, 1)) / 2
    return Crystal(spacing, np.array(half), tensors)
