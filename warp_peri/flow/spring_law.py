"""The objective form: the flow's part is exact, and only the spring is learned (F22–F24).

dC/dt = K C + C Kᵗ + I − S(C), where S has the eigenvectors of C and log(S_i/c_i) is one function
of (c_i; c_j c_k, c_j + c_k). Rotating the fluid rotates everything, S stays positive, and Hookean
dumbbells are exact: the function is zero.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated, Any

import numpy as np
from scipy.ndimage import map_coordinates, spline_filter
from scipy.optimize import brentq

from warp_peri.core.record import Quantity
from warp_peri.errors import InputError
from warp_peri.flow.cloud import Cloud, Gradients
from warp_peri.flow.gaussian_process import GaussianProcess, condensed
from warp_peri.flow.learned import FORMAT, LearnedLaw, fastest, fastest_of
from warp_peri.flow.planar import (
    IDENTITY,
    carried,
    check_conformation,
    eigenvalues,
    from_eigenvalues,
)
from warp_peri.flow.protocols import Ensembles, listed

LEAST = 1e-6
"""Eigenvalues are kept above it inside a step; a check refuses what is not positive."""


def invariants(c: np.ndarray) -> np.ndarray:
    """(log c_i, log c_j c_k, log(c_j + c_k)) of eigenvalues [..., 3], shape [..., 3, 3]."""
    j, k = np.roll(c, -1, axis=-1), np.roll(c, -2, axis=-1)
    return np.stack([np.log(c), np.log(j * k), np.log(j + k)], axis=-1)


def resting(stiffness: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """c I with S = I, the c nearest to 1, of log(S_i/c_i) [n] at equal eigenvalues [n, 3].

    Raises InputError for none between 0.01 and 10.
    """

    def excess(logarithm: np.ndarray) -> np.ndarray:
        return np.asarray(logarithm + stiffness(np.exp(logarithm)[:, None] * np.ones(3)))

    grid = np.linspace(np.log(0.01), np.log(10.0), 601)
    values = excess(grid)
    crossing = np.flatnonzero((values[:-1] < 0) & (values[1:] >= 0))
    if not len(crossing):
        raise InputError("spring law: no conformation at rest between 0.01 and 10")
    n = crossing[np.argmin(np.abs(grid[crossing]))]
    root = brentq(lambda x: float(excess(np.array([x]))[0]), grid[n], grid[n + 1], xtol=1e-12)
    return float(np.exp(root)) * IDENTITY


@dataclass(frozen=True)
class SpringLaw(LearnedLaw, format=FORMAT, kind="spring"):
    """A process of log(S_i/c_i).

    Args:
        process: with the inputs of `invariants`.
        outside: "warn", "refuse" or "allow" states and gradients far from the data.
        gradients: those of the data; None where they are not known.
        provenance: what it was learned from; plain values, for its file.
    """

    process: GaussianProcess
    outside: str = "warn"
    gradients: Annotated[Gradients | None, Quantity(key="fastest", later=True)] = None
    provenance: dict[str, Any] = field(default_factory=dict, repr=False)
    ORDER = (*LearnedLaw.ORDER, "gradients")
    PROCESSES = ("process",)

    def derived(self) -> dict[str, Any]:
        """As of others, and the velocity gradients of the data."""
        return super().derived() | {"gradients": fastest(self.gradients)}

    @classmethod
    def today(cls, content: dict[str, Any]) -> dict[str, Any]:
        """As of others, with the velocity gradients of the data."""
        return super().today(content | {"fastest": fastest_of(content)})

    @property
    def name(self) -> str:
        """The law's name in tables and figures."""
        return "learned spring"

    def stiffness(self, X: np.ndarray) -> np.ndarray:
        """log(S_i/c_i) at inputs [n, 3]."""
        return self.process(X)

    @cached_property
    def rest(self) -> np.ndarray:
        """c I with S = I, the c nearest to 1. Raises InputError for none between 0.01 and 10."""
        return resting(lambda c: self.stiffness(invariants(c)[:, 0]))

    def spring(self, C: np.ndarray) -> np.ndarray:
        """The spring's moments S(C), shape [n, 4]."""
        c1, c2, c3, cosine, sine = eigenvalues(C)
        c = np.maximum(np.stack([c1, c2, c3], axis=-1), LEAST)
        h = np.exp(self.stiffness(invariants(c).reshape(-1, 3)).reshape(c.shape))
        S = c * h
        return np.asarray(from_eigenvalues(S[..., 0], S[..., 1], S[..., 2], cosine, sine))

    def rate(self, K: np.ndarray, C: np.ndarray) -> np.ndarray:
        """dC/dt of conformations, shape [n, 4]."""
        return np.asarray(carried(K, C) + IDENTITY - self.spring(C))

    def stress(self, C: np.ndarray) -> np.ndarray:
        """The stress S − I, shape [n, 4]."""
        return np.asarray(self.spring(C) - IDENTITY)

    @cached_property
    def cloud(self) -> Cloud:
        """Where the training data are."""
        return Cloud(self.process.X, self.process.scale)

    def distance(self, K: np.ndarray, C: np.ndarray) -> np.ndarray:
        """Of states [n, 4] from the data, in gaps, shape [n]; the farthest of the eigenvalues."""
        c = np.maximum(np.stack(eigenvalues(C)[:3], axis=-1), LEAST)
        return np.asarray(self.cloud.distance(invariants(c).reshape(-1, 3)).reshape(-1, 3).max(1))

    def check(self, K: np.ndarray, C: np.ndarray) -> None:
        """Warn or refuse outside the data; InputError for a C that is not positive definite.

        A fast flow can end in a C that slower ones have passed, with another S: K is checked too.
        """
        check_conformation(C)
        if self.gradients is not None:
            self.gradients.check(K, self.outside)
        c = np.stack(eigenvalues(C)[:3], axis=-1)
        self.cloud.check(invariants(c).reshape(-1, 3), self.outside)

    def tabulated(self, shape: tuple[int, int, int] = (64, 48, 32)) -> TabulatedSpringLaw:
        """The same law by a table."""
        return TabulatedSpringLaw(
            self.process, self.outside, self.gradients, self.provenance, shape
        )


@dataclass(frozen=True)
class TabulatedSpringLaw(SpringLaw):
    """A cubic table of log c_i, log c_j c_k and |log c_j/c_k|; beyond its ends it is constant."""

    shape: tuple[int, int, int] = (64, 48, 32)

    @cached_property
    def _ends(self) -> tuple[np.ndarray, np.ndarray]:
        X = self.process.X
        spread = _spread(X[:, 1], X[:, 2])
        low = np.array([X[:, 0].min(), X[:, 1].min(), 0.0])
        high = np.array([X[:, 0].max(), X[:, 1].max(), spread.max()])
        more = 0.1 * (high - low) + 1e-6
        return low - more * [1, 1, 0], high + more

    @cached_property
    def _coefficients(self) -> np.ndarray:
        low, high = self._ends
        axes = [np.linspace(a, b, n) for a, b, n in zip(low, high, self.shape)]
        a, p, d = np.meshgrid(*axes, indexing="ij")
        total = p / 2 + np.log(2 * np.cosh(d / 2))
        X = np.stack([a, p, total], axis=-1).reshape(-1, 3)
        values = np.concatenate([self.process(part) for part in np.array_split(X, 32)])
        return np.asarray(spline_filter(values.reshape(self.shape), order=3, mode="mirror"))

    def stiffness(self, X: np.ndarray) -> np.ndarray:
        """log(S_i/c_i) by the table."""
        low, high = self._ends
        places = np.stack([X[:, 0], X[:, 1], _spread(X[:, 1], X[:, 2])])
        steps = (np.array(self.shape) - 1) / (high - low)
        places = (np.clip(places, low[:, None], high[:, None]) - low[:, None]) * steps[:, None]
        table = self._coefficients
        return np.asarray(map_coordinates(table, places, order=3, mode="mirror", prefilter=False))


def _spread(product: np.ndarray, total: np.ndarray) -> np.ndarray:
    """|log c_j/c_k| of log c_j c_k and log(c_j + c_k)."""
    return np.asarray(2 * np.arccosh(np.maximum(np.exp(total - product / 2) / 2, 1.0)))


def spring_data(C: np.ndarray, S: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(inputs [3 n, 3], log(S_i/c_i) [3 n]) of moments [..., 4].

    Raises InputError where C or S is not positive definite.
    """
    C, S = C.reshape(-1, 4), S.reshape(-1, 4)
    check_conformation(C)
    check_conformation(S)
    c1, c2, c3, cosine, sine = eigenvalues(C)
    xx, xy, yy, zz = S.T
    along, across = (xx + yy) / 2, (xx - yy) / 2 * cosine + xy * sine
    c = np.stack([c1, c2, c3], axis=-1)
    s = np.stack([along + across, along - across, zz], axis=-1)
    return invariants(c).reshape(-1, 3), np.log(s / c).ravel()


def learn_spring(
    records: Ensembles | Sequence[Ensembles],
    *,
    points: int = 200,
    outside: str = "warn",
    rounds: int = 2,
    progress: bool | None = None,
    **options: Any,
) -> SpringLaw:
    """Learn the spring from conformations and stresses.

    Args:
        records: of dumbbells or of molecules whose C is known.
        points: chosen greedily, those that tell most about all others.
        outside: what happens far from the data, "warn", "refuse" or "allow".
        rounds: greedy choices.
        progress: a bar of the fits; None shows one on a terminal.
        options: of fit_process.

    Raises InputError for moments that are not positive definite, no records, or fewer points than
    2.
    """
    records = listed(records)
    if points < 2:
        raise InputError(f"points: expected 2 or more, got {points}")
    samples = [spring_data(record.C, record.S) for record in records]
    X, y = np.concatenate([x for x, _ in samples]), np.concatenate([v for _, v in samples])
    process = condensed(X, y, points, rounds=rounds, progress=progress, **options)
    return SpringLaw(process, outside, Gradients.of([record.K for record in records]))
