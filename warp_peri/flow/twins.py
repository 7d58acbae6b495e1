"""FENE dumbbells beside Hookean twins, whose exact moments take noise off theirs (F34, F35)."""

from __future__ import annotations

import numpy as np
from scipy import stats

from warp_peri.errors import InputError
from warp_peri.flow.dumbbells import Dumbbells, Moments, propagator
from warp_peri.flow.planar import IDENTITY, trace

FULLEST = 0.95
"""Of ⟨q²⟩/b where the stiffness of the twins is taken."""


class Twins(Dumbbells):
    """As Dumbbells, but each FENE dumbbell has a Hookean twin with the same random numbers.

    The twins' springs have the stiffness of the mean length, so that their moments are those of
    FENE-P and known exactly. What these are off by in the sample is regressed out of C and S: the
    fluctuations of both have the same cause.

    Args:
        ensembles: how many.
        count: dumbbells in each, 20 or more.
        b: largest q² of a dumbbell, above 3.
        seed: of start and noise.

    Raises InputError for fewer dumbbells, and as Dumbbells does.
    """

    b: float

    def __init__(self, ensembles: int, count: int, *, b: float, seed: int = 0) -> None:
        if count < 20:
            raise InputError(f"twins: expected 20 dumbbells or more, got {count}")
        super().__init__(ensembles, count, b=b, seed=seed)
        self.twin = Dumbbells(ensembles, count, seed=seed)
        self.twin.q.assign(relaxed(self.q.numpy(), b))
        self.exact = np.tile(b / (b + 3) * IDENTITY, (ensembles, 1))

    def advance(self, K: np.ndarray, dt: float, steps: int = 1) -> Moments:
        """As Dumbbells.advance, with less noise in the moments."""
        super().advance(K, dt, steps)
        K = np.broadcast_to(np.asarray(K, dtype=float), (self.ensembles, 4))
        for _ in range(steps):
            longest = np.minimum(trace(self.exact) / self.b, FULLEST)
            P, L = propagator(K, dt, 1 / (1 - longest))
            self.twin.follow(P, L)
            self.exact = carried_exactly(self.exact, P, L)
        return self._controlled()

    def state(self) -> dict[str, np.ndarray]:
        """What a checkpoint keeps."""
        return super().state() | {"twin": self.twin.q.numpy(), "exact": self.exact}

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """Go on from a state that was kept."""
        super().restore(state)
        self.twin.restore({"q": state["twin"], "steps": state["steps"]})
        self.exact = np.array(state["exact"])

    @property
    def key(self) -> str:
        """What the run depends on."""
        return super().key + ", twins"

    def _controlled(self) -> Moments:
        """Moments with the twin as control variate (F35), an ensemble at a time."""
        values = np.empty((self.ensembles, 8))
        for i, (q, h) in enumerate(zip(self.q.numpy(), self.twin.q.numpy())):
            squares, known = products(q), products(h)
            f = 1 / (1 - squares[:, [0, 2, 3]].sum(axis=1, keepdims=True) / self.b)
            sampled = np.concatenate([squares, squares * f], axis=1)
            mean, off = sampled.mean(axis=0), known.mean(axis=0) - self.exact[i]
            about = known - known.mean(axis=0)
            slope = np.linalg.lstsq(about, sampled - mean)[0]
            values[i] = mean - off @ slope
        return Moments(values[:, :4].copy(), values[:, 4:].copy())


def products(q: np.ndarray) -> np.ndarray:
    """(xx, xy, yy, zz) of q q for dumbbells [n, 3], shape [n, 4], float64."""
    x, y, z = np.asarray(q, dtype=float).T
    return np.stack([x * x, x * y, y * y, z * z], axis=-1)


def relaxed(q: np.ndarray, b: float) -> np.ndarray:
    """Twins at rest, with the directions and the ranks of length of FENE dumbbells (F34)."""
    q = np.asarray(q, dtype=float)
    length = np.linalg.norm(q, axis=-1, keepdims=True)
    rank = stats.beta.cdf(length**2 / b, 1.5, b / 2 + 1)
    wanted = np.sqrt(b / (b + 3)) * stats.chi.ppf(np.clip(rank, 1e-12, 1 - 1e-12), 3)
    return np.asarray(q / length * wanted, dtype=np.float32)


def carried_exactly(C: np.ndarray, P: np.ndarray, L: np.ndarray) -> np.ndarray:
    """⟨q q⟩ [m, 4] after q → P q + L ξ (F3)."""
    p = P[:, :4].reshape(-1, 2, 2)
    plane = p @ C[:, [0, 1, 1, 2]].reshape(-1, 2, 2) @ np.swapaxes(p, 1, 2)
    xx, yx, yy, zz = L.T
    noise = np.stack([xx * xx, xx * yx, yx * yx + yy * yy, zz * zz], axis=-1)
    out = P[:, 4] ** 2 * C[:, 3]
    moments = np.stack([plane[:, 0, 0], plane[:, 0, 1], plane[:, 1, 1], out], axis=-1)
    return np.asarray(moments + noise)
