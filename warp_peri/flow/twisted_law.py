"""A second memory for the spring: S is not quite a function of C, and the rest is history.

In the frame of C the spring of FENE dumbbells has an off-diagonal part, up to a tenth of √(S₁ S₂)
in fast shear, and through it the small eigenvalue that carries shear stress. A second conformation
P, that of FENE-P dumbbells under the same gradients, says which way: S₁₂ = ν P₁₂ √(S₁ S₂)/√(P₁ P₂),
with ν learned (theory, F33). Nor are the eigenvalues of S those of one function of C: in steady
shear they are larger than at the same C on the way to rest. P says which of both it is, and what
the spring alone leaves is learned with it (F39). The state has eight components, C and then P.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from warp_peri.errors import InputError
from warp_peri.flow.closure import homogeneous
from warp_peri.flow.gaussian_process import GaussianProcess, condensed
from warp_peri.flow.laws import FENEP
from warp_peri.flow.learned import FORMAT, LearnedLaw, fastest
from warp_peri.flow.planar import IDENTITY, carried, eigenvalues, from_frame, in_frame, trace
from warp_peri.flow.protocols import Ensembles, listed
from warp_peri.flow.spring_law import (
    LEAST,
    SpringLaw,
    invariants,
    learn_spring,
    resting,
    spring_data,
)

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
