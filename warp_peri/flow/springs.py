"""Learned laws of a spring, and of one that twists."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated, Any

import numpy as np
from scipy.ndimage import map_coordinates, spline_filter
from scipy.optimize import brentq

from warp_peri.core.record import Entry
from warp_peri.errors import InputError
from warp_peri.flow.closure import homogeneous
from warp_peri.flow.dumbbells import Ensembles, listed
from warp_peri.flow.gaussian_process import GaussianProcess, condensed
from warp_peri.flow.laws import (
    FENEP,
    IDENTITY,
    carried,
    check_conformation,
    eigenvalues,
    from_eigenvalues,
    from_frame,
    in_frame,
    trace,
)
from warp_peri.flow.learned import FORMAT, Cloud, Gradients, LearnedLaw, fastest, fastest_of

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
    gradients: Annotated[Gradients | None, Entry(key="fastest", later=True)] = None
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


@dataclass(frozen=True)
class TwistedSpringLaw(LearnedLaw, format=FORMAT, kind="twisted"):
    """A learned spring, and what turns it.

    Args:
        spring_law: of the eigenvalues.
        process: of ν, with the inputs log c₁ c₂, log c₁/c₂, log c₃ and those of `remembered`.
        excess: of what log S_i/c_i has beyond the spring's, inputs log c_i and `remembered`; zero
            far from its data.
        b: of the FENE-P dumbbells whose conformation is the second memory.
    """

    spring_law: SpringLaw
    process: GaussianProcess
    excess: GaussianProcess
    b: float
    provenance: dict[str, Any] = field(default_factory=dict, repr=False)
    ORDER = SpringLaw.ORDER
    PROCESSES = ("first", "process", "excess")

    def __post_init__(self) -> None:
        super().__post_init__()
        _ = self.twin  # an InputError where b is none

    @property
    def outside(self) -> str:
        """What happens far from the data, as of the spring."""
        return self.spring_law.outside

    @property
    def first(self) -> GaussianProcess:
        """The spring's."""
        return self.spring_law.process

    def derived(self) -> dict[str, Any]:
        """As of others, and the velocity gradients of the data."""
        return super().derived() | {"gradients": fastest(self.spring_law.gradients)}

    @classmethod
    def today(cls, content: dict[str, Any]) -> dict[str, Any]:
        """With the spring as a law of its own."""
        own = super().today(content | {"gradients": content.get("gradients")})
        spring = content | {"kind": "spring", "b": None, "provenance": {}}
        spring = spring | {"processes": [own.pop("first")]}
        return own | {"spring_law": {k: v for k, v in spring.items() if k != "sha256"}}

    @property
    def name(self) -> str:
        """The law's name in tables and figures."""
        return "learned spring, second memory"

    @cached_property
    def twin(self) -> FENEP:
        """The law of the second memory P."""
        return FENEP(self.b)

    @cached_property
    def rest(self) -> np.ndarray:
        """C and P at rest, shape [8]."""
        P = np.asarray(self.twin.rest)

        def stiffness(c: np.ndarray) -> np.ndarray:
            none = np.zeros(len(c))
            return self.stiffness(c, remembered(np.tile(P, (len(c), 1)), none, c, self.b))[:, 0]

        return np.concatenate([resting(stiffness), P])

    def stiffness(self, c: np.ndarray, memory: np.ndarray) -> np.ndarray:
        """log(S_i/c_i), shape [n, 3], of eigenvalues [n, 3] and what `remembered` gives."""
        spring = self.spring_law.stiffness(invariants(c).reshape(-1, 3))
        return np.asarray((spring + self.excess(beside(c, memory))).reshape(c.shape))

    def spring(self, state: np.ndarray) -> np.ndarray:
        """S, shape [n, 4], of states [n, 8]."""
        C, P = state[..., :4], state[..., 4:]
        c1, c2, c3, cosine, sine = eigenvalues(C)
        c = np.maximum(np.stack([c1, c2, c3], axis=-1), LEAST)
        turned = twist(P, cosine, sine)
        memory = remembered(P, turned, c, self.b)
        s1, s2, s3 = np.moveaxis(c * np.exp(self.stiffness(c, memory)), -1, 0)
        turn = turned * self.process(shapes(c, memory))
        s12 = np.clip(turn, -LARGEST, LARGEST) * np.sqrt(s1 * s2)
        return np.asarray(from_frame(s1, s2, s12, s3, cosine, sine))

    def stress(self, state: np.ndarray) -> np.ndarray:
        """The stress S − I, shape [n, 4]."""
        return np.asarray(self.spring(state) - IDENTITY)

    def rate(self, K: np.ndarray, state: np.ndarray) -> np.ndarray:
        """dC/dt and dP/dt, shape [n, 8]."""
        dC = carried(K, state[..., :4]) + IDENTITY - self.spring(state)
        return np.concatenate([dC, self.twin.rate(K, state[..., 4:])], axis=-1)

    def distance(self, K: np.ndarray, state: np.ndarray) -> np.ndarray:
        """How far states [n, 8] are from the data of the spring, in gaps, shape [n]."""
        return self.spring_law.distance(K, state[..., :4])

    def check(self, K: np.ndarray, state: np.ndarray) -> None:
        """As the spring's law does for C, and FENE-P for P."""
        self.spring_law.check(K, state[..., :4])
        self.twin.check(K, state[..., 4:])


def twist(P: np.ndarray, cosine: np.ndarray, sine: np.ndarray) -> np.ndarray:
    """P₁₂/√(P₁ P₂) in the frame of C."""
    p1, p2, p12 = in_frame(P, cosine, sine)
    return np.asarray(p12 / np.sqrt(np.maximum(p1 * p2, LEAST)))


def remembered(P: np.ndarray, turned: np.ndarray, c: np.ndarray, b: float) -> np.ndarray:
    """What P says beside C, shape [..., 2]: log of its spring's stiffness, and how far it turned.

    The latter is the square of P₁₂/√(P₁ P₂) (c₁ − c₂)/(c₁ + c₂), smooth where C has no frame.
    """
    stiff = -np.log(np.maximum(1 - trace(P) / b, LEAST))
    aside = turned * (c[..., 0] - c[..., 1]) / (c[..., 0] + c[..., 1])
    return np.stack([stiff, aside**2], axis=-1)


def shapes(c: np.ndarray, memory: np.ndarray) -> np.ndarray:
    """(log c₁ c₂, log c₁/c₂, log c₃, memory) of eigenvalues [..., 3], shape [..., 5]."""
    log = np.log(c)
    parts = [log[..., 0] + log[..., 1], log[..., 0] - log[..., 1], log[..., 2]]
    return np.concatenate([np.stack(parts, axis=-1), memory], axis=-1)


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
    shape, inputs, left, turned, by = [], [], [], [], []
    for record in records:
        P = homogeneous(twin, record.K, record.interval).reshape(-1, 4)
        C, S = record.C.reshape(-1, 4), record.S.reshape(-1, 4)
        c1, c2, c3, cosine, sine = eigenvalues(C)
        s1, s2, s12 = in_frame(S, cosine, sine)
        c, x = np.stack([c1, c2, c3], axis=-1), twist(P, cosine, sine)
        memory, (X, y) = remembered(P, x, c, b), spring_data(C, S)
        shape.append(shapes(c, memory))
        inputs.append(beside(c, memory))
        left.append(y - law.stiffness(X))
        turned.append(s12 / np.sqrt(s1 * s2))
        by.append(x)
    x, y = np.concatenate(by), np.concatenate(turned)
    keep = np.abs(x) > SMALLEST
    if keep.sum() < 2:
        raise InputError("twist: expected samples of shear or mixed flow, got none")
    noise = (ABSOLUTE**2 + (RELATIVE * y[keep]) ** 2) / x[keep] ** 2
    ratio = y[keep] / x[keep]
    shaped = np.concatenate(shape)[keep]
    process = condensed(shaped, ratio, turns, noise=noise, floor=FLOOR**2, progress=progress)
    X, y = np.concatenate(inputs), np.concatenate(left)
    known = np.full(len(y), SPREAD**2)  # steady states, which are many samples, weigh more
    excess = condensed(X, y, turns, noise=known, floor=LEAST_SPREAD**2, mean=0.0, progress=progress)
    return TwistedSpringLaw(law, process, excess, b)
