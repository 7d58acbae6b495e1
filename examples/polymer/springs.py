"""Learned laws of a spring, and of one that twists."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated, Any

import numpy as np
from scipy.ndimage import map_coordinates, spline_filter
from scipy.optimize import brentq

from examples.polymer.closure import homogeneous
from examples.polymer.dumbbells import Ensembles, listed
from examples.polymer.gaussian_process import GaussianProcess, condensed
from examples.polymer.laws import (
    FENEP,
    IDENTITY,
    carried,
    check_conformation,
    eigenvalues,
    from_frame,
    in_frame,
    trace,
)
from examples.polymer.learned import FORMAT, Fastest, LearnedLaw, check_gradients, fastest
from warp_peri.core.record import Entry
from warp_peri.errors import InputError

LEAST = 1e-6
"""Eigenvalues are kept above it inside a step; a check refuses what is not positive."""
LARGEST = 0.9
"""Of S₁₂/√(S₁ S₂), which keeps S positive."""
SMALLEST = 0.03
"""|P₁₂|/√(P₁ P₂) below which a sample says nothing about ν."""
FLOOR = 0.02
"""Least standard deviation taken for a mean of ν."""
ABSOLUTE, RELATIVE = 0.004, 0.05
"""Standard deviation taken for a sample of S₁₂/√(S₁ S₂), and of the part that grows with it."""
SPREAD, LEAST_SPREAD = 0.03, 0.003
"""Standard deviation taken for a sample of the excess, and the least for a mean."""


def invariants(c: np.ndarray) -> np.ndarray:
    """(log c_i, log c_j c_k, log(c_j + c_k)) of eigenvalues [n, 3], shape [3 n, 3]."""
    j, k = np.roll(c, -1, axis=-1), np.roll(c, -2, axis=-1)
    return np.stack([np.log(c), np.log(j * k), np.log(j + k)], axis=-1).reshape(-1, 3)


def frame(C: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Eigenvalues of C [n, 4], none below LEAST, shape [n, 3]; cos 2φ and sin 2φ of the first."""
    *c, cosine, sine = eigenvalues(C)
    return np.maximum(np.stack(c, axis=-1), LEAST), cosine, sine


@dataclass(frozen=True)
class Springs(LearnedLaw):
    """A spring whose moments S have eigenvalues c_i exp(h_i) beside those of C, or S turned.

    Attributes:
        process: of h = log(S_i/c_i), with the inputs of `invariants`.
        gradients: the fastest of the data, as of learned.Fastest; None where they are not known.
    """

    process: GaussianProcess
    gradients: Annotated[Fastest | None, Entry(later=True)] = field(default=None, kw_only=True)
    ORDER = (*LearnedLaw.ORDER, "gradients")

    def stiffness(self, X: np.ndarray) -> np.ndarray:
        """h at inputs [n, 3]."""
        return self.process(X)

    def stretched(
        self, state: np.ndarray, c: np.ndarray, cosine: np.ndarray, sine: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray | float]:
        """h [n, 3] and S₁₂/√(S₁ S₂) [n] in the frame of C, of states [n, 4 …]."""
        return self.stiffness(invariants(c)).reshape(c.shape), 0.0

    def spring(self, state: np.ndarray) -> np.ndarray:
        """The spring's moments S, shape [n, 4]."""
        c, cosine, sine = frame(state[..., :4])
        h, turn = self.stretched(state, c, cosine, sine)
        s1, s2, s3 = np.moveaxis(c * np.exp(h), -1, 0)
        return np.asarray(from_frame(s1, s2, turn * np.sqrt(s1 * s2), s3, cosine, sine))

    def rate(self, K: np.ndarray, state: np.ndarray) -> np.ndarray:
        """dC/dt of conformations, shape [n, 4]."""
        return np.asarray(carried(K, state[..., :4]) + IDENTITY - self.spring(state))

    def stress(self, C: np.ndarray) -> np.ndarray:
        """The stress S − I, shape [n, 4]."""
        return np.asarray(self.spring(C) - IDENTITY)

    @property
    def beside(self) -> np.ndarray:
        """What a state at rest has beside C, shape [m]."""
        return np.zeros(0)

    @cached_property
    def rest(self) -> np.ndarray:
        """c I with S = I, the c nearest to 1, and what is beside it.

        Raises InputError for none between 0.01 and 10.
        """

        def excess(log_c: np.ndarray) -> np.ndarray:
            c, none = np.exp(log_c)[:, None] * np.ones(3), np.zeros(len(log_c))
            state = np.tile(np.concatenate([IDENTITY, self.beside]), (len(c), 1))
            return np.asarray(log_c + self.stretched(state, c, none, none)[0][:, 0])

        grid = np.linspace(np.log(0.01), np.log(10.0), 601)
        values = excess(grid)
        crossing = np.flatnonzero((values[:-1] < 0) & (values[1:] >= 0))
        if not len(crossing):
            raise InputError("spring law: no conformation at rest between 0.01 and 10")
        n = crossing[np.argmin(np.abs(grid[crossing]))]
        root = brentq(lambda x: float(excess(np.array([x]))[0]), grid[n], grid[n + 1], xtol=1e-12)
        return np.concatenate([float(np.exp(root)) * IDENTITY, self.beside])

    def features(self, K: np.ndarray, C: np.ndarray) -> np.ndarray:
        """The invariants, three for each state."""
        return invariants(frame(C[..., :4])[0])

    def check(self, K: np.ndarray, C: np.ndarray) -> None:
        """Warn or refuse outside the data; InputError for a C that is not positive definite.

        A fast flow can end in a C that slower ones have passed, with another S: K is checked too.
        """
        check_conformation(C[..., :4])
        if self.gradients is not None:
            check_gradients(self.gradients, K, self.outside)
        self.cloud.check(self.features(K, C), self.outside)


@dataclass(frozen=True)
class SpringLaw(Springs, format=FORMAT, kind="spring"):
    """A spring alone; its arguments are those of Springs and of others."""

    TITLE = "spring"

    def tabulated(self, shape: tuple[int, int, int] = (64, 48, 32)) -> TabulatedSpringLaw:
        """The same law by a table."""
        law: TabulatedSpringLaw = self.as_law(TabulatedSpringLaw, shape=shape)
        return law


@dataclass(frozen=True)
class TabulatedSpringLaw(SpringLaw):
    """A cubic table of log c_i, log c_j c_k and |log c_j/c_k|; beyond its ends it is constant."""

    shape: tuple[int, int, int] = (64, 48, 32)

    @cached_property
    def _table(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Ends of the inputs, and coefficients."""
        X = _places(self.process.X)
        low, high = X.min(axis=0) * [1, 1, 0], X.max(axis=0)
        more = 0.1 * (high - low) + 1e-6
        low, high = low - more * [1, 1, 0], high + more
        axes = [np.linspace(a, b, n) for a, b, n in zip(low, high, self.shape)]
        a, p, d = np.meshgrid(*axes, indexing="ij")
        X = np.stack([a, p, p / 2 + np.log(2 * np.cosh(d / 2))], axis=-1).reshape(-1, 3)
        values = np.concatenate([self.process(part) for part in np.array_split(X, 32)])
        return low, high, spline_filter(values.reshape(self.shape), order=3, mode="mirror")

    def stiffness(self, X: np.ndarray) -> np.ndarray:
        """log(S_i/c_i) by the table."""
        low, high, table = self._table
        steps = (np.array(self.shape) - 1) / (high - low)
        places = (np.clip(_places(X), low, high) - low) * steps
        return np.asarray(map_coordinates(table, places.T, order=3, mode="mirror", prefilter=False))


def _places(X: np.ndarray) -> np.ndarray:
    """(log c_i, log c_j c_k, |log c_j/c_k|) of invariants [n, 3]."""
    ratio = np.maximum(np.exp(X[:, 2] - X[:, 1] / 2) / 2, 1.0)
    return np.column_stack([X[:, :2], 2 * np.arccosh(ratio)])


def spring_data(C: np.ndarray, S: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(inputs [3 n, 3], log(S_i/c_i) [3 n]) of moments [..., 4].

    Raises InputError where C or S is not positive definite.
    """
    C, S = C.reshape(-1, 4), S.reshape(-1, 4)
    check_conformation(C)
    check_conformation(S)
    c, cosine, sine = frame(C)
    s1, s2, _ = in_frame(S, cosine, sine)
    return invariants(c), np.log(np.stack([s1, s2, S[:, 3]], axis=-1) / c).ravel()


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
    X, y = (np.concatenate(part) for part in zip(*(spring_data(one.C, one.S) for one in records)))
    process = condensed(X, y, points, rounds=rounds, progress=progress, **options)
    K = [record.K for record in records]
    return SpringLaw(process, outside=outside, gradients=fastest(K))


@dataclass(frozen=True, kw_only=True)
class TwistedSpringLaw(Springs, format=FORMAT, kind="twisted"):
    """A learned spring, and what turns it; its state is C and a second memory P, [n, 8].

    Attributes:
        turning: of ν, with the inputs log c₁ c₂, log c₁/c₂, log c₃ and those of `remembered`.
        excess: of what log S_i/c_i has beyond the spring's, inputs log c_i and `remembered`; zero
            far from its data.
        b: of the FENE-P dumbbells whose conformation is the second memory.
    """

    turning: GaussianProcess
    excess: GaussianProcess
    b: float
    PROCESSES, TITLE = ("process", "turning", "excess"), "spring, second memory"

    def __post_init__(self) -> None:
        super().__post_init__()
        _ = self.twin  # an InputError where b is none

    @cached_property
    def spring_law(self) -> SpringLaw:
        """The spring alone."""
        law: SpringLaw = self.as_law(SpringLaw)
        return law

    @cached_property
    def twin(self) -> FENEP:
        """The law of the second memory P."""
        return FENEP(self.b)

    @property
    def beside(self) -> np.ndarray:
        """P at rest."""
        return np.asarray(self.twin.rest)

    def stretched(
        self, state: np.ndarray, c: np.ndarray, cosine: np.ndarray, sine: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """That of the spring with its excess, and what turns it."""
        turned, memory = remembered(state[..., 4:], c, cosine, sine, self.b)
        h = self.stiffness(invariants(c)) + self.excess(beside(c, memory))
        turn = np.clip(turned * self.turning(shapes(c, memory)), -LARGEST, LARGEST)
        return h.reshape(c.shape), turn

    def rate(self, K: np.ndarray, state: np.ndarray) -> np.ndarray:
        """dC/dt and dP/dt, shape [n, 8]."""
        slopes = super().rate(K, state), self.twin.rate(K, state[..., 4:])
        return np.concatenate(slopes, axis=-1)

    def check(self, K: np.ndarray, state: np.ndarray) -> None:
        """As the spring's law does for C, and FENE-P for P."""
        super().check(K, state)
        self.twin.check(K, state[..., 4:])


def remembered(
    P: np.ndarray, c: np.ndarray, cosine: np.ndarray, sine: np.ndarray, b: float
) -> tuple[np.ndarray, np.ndarray]:
    """P₁₂/√(P₁ P₂) in the frame of C, shape [n], and what P says beside C, shape [n, 2].

    The latter are log of its spring's stiffness, and how far it turned: the square of
    P₁₂/√(P₁ P₂) (c₁ − c₂)/(c₁ + c₂), smooth where C has no frame.
    """
    p1, p2, p12 = in_frame(P, cosine, sine)
    turned = p12 / np.sqrt(np.maximum(p1 * p2, LEAST))
    stiff = -np.log(np.maximum(1 - trace(P) / b, LEAST))
    aside = turned * (c[..., 0] - c[..., 1]) / (c[..., 0] + c[..., 1])
    return turned, np.stack([stiff, aside**2], axis=-1)


def shapes(c: np.ndarray, memory: np.ndarray) -> np.ndarray:
    """(log c₁ c₂, log c₁/c₂, log c₃, memory) of eigenvalues [n, 3], shape [n, 5]."""
    one, two, three = np.log(c).T
    return np.column_stack([one + two, one - two, three, memory])


def beside(c: np.ndarray, memory: np.ndarray) -> np.ndarray:
    """(log c_i, memory) of eigenvalues [n, 3], shape [3 n, 3]."""
    return np.column_stack([np.log(c).ravel(), np.repeat(memory, 3, axis=0)])


def learn_twisted(
    records: Ensembles | Sequence[Ensembles],
    *,
    b: float,
    points: int = 200,
    turns: int = 120,
    progress: bool | None = None,
    **options: Any,
) -> TwistedSpringLaw:
    """Learn the spring, what turns it and what it has beyond a function of C.

    Args:
        records: of dumbbells that were at rest at their start.
        b: of the dumbbells.
        points: of the spring.
        turns: points of ν, of those samples where P is turned at all, and of the excess.
        progress: a bar of the fits; None shows one on a terminal.
        options: of learn_spring.

    Raises InputError when no sample has its P turned: learn_spring is enough then.
    """
    records = listed(records)
    law, twin = learn_spring(records, points=points, progress=progress, **options), FENEP(b)
    parts = []
    for record in records:
        P = homogeneous(twin, record.K, record.interval).reshape(-1, 4)
        C, S = record.C.reshape(-1, 4), record.S.reshape(-1, 4)
        c, cosine, sine = frame(C)
        (turned, memory), (X, y) = remembered(P, c, cosine, sine, b), spring_data(C, S)
        s1, s2, s12 = in_frame(S, cosine, sine)
        left = y - law.stiffness(X)
        parts.append((shapes(c, memory), beside(c, memory), left, turned, s12 / np.sqrt(s1 * s2)))
    shaped, inputs, left, x, y = (np.concatenate(part) for part in zip(*parts))
    keep = np.abs(x) > SMALLEST
    if keep.sum() < 2:
        raise InputError("twist: expected samples of shear or mixed flow, got none")
    noise = (ABSOLUTE**2 + (RELATIVE * y[keep]) ** 2) / x[keep] ** 2
    turning = condensed(
        shaped[keep], y[keep] / x[keep], turns, noise=noise, floor=FLOOR**2, progress=progress
    )
    known = np.full(len(left), SPREAD**2)  # steady states, which are many samples, weigh more
    excess = condensed(
        inputs, left, turns, noise=known, floor=LEAST_SPREAD**2, mean=0.0, progress=progress
    )
    both: TwistedSpringLaw = law.as_law(TwistedSpringLaw, turning=turning, excess=excess, b=b)
    return both
