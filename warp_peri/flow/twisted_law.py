"""A second memory for the spring: S is not quite aligned with C, and what turns it is history.

In the frame of C the spring of FENE dumbbells has an off-diagonal part, up to a tenth of √(S₁ S₂)
in fast shear, and through it the small eigenvalue that carries shear stress. A second conformation
P, that of FENE-P dumbbells under the same gradients, says which way: S₁₂ = ν P₁₂ √(S₁ S₂)/√(P₁ P₂),
with ν learned (theory, F33). The state has eight components, C and then P.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from warp_peri.errors import InputError
from warp_peri.flow.closure import homogeneous
from warp_peri.flow.gaussian_process import SUBSET, GaussianProcess, fit_process, gathered, greedy
from warp_peri.flow.law_content import law_content
from warp_peri.flow.laws import FENEP
from warp_peri.flow.planar import IDENTITY, carried, eigenvalues, from_frame, in_frame
from warp_peri.flow.protocols import Ensembles
from warp_peri.flow.spring_law import LEAST, SpringLaw, invariants, learn_spring

LARGEST = 0.9
"""Of S₁₂/√(S₁ S₂), which keeps S positive."""
SMALLEST = 0.03
"""|P₁₂|/√(P₁ P₂) below which a sample says nothing about ν."""
FLOOR = 0.02
"""Least standard deviation taken for a mean of ν."""
ABSOLUTE, RELATIVE = 0.004, 0.05
"""Standard deviation taken for a sample of S₁₂/√(S₁ S₂), and of the part that grows with it."""


@dataclass(frozen=True)
class TwistedSpringLaw:
    """A learned spring, and what turns it.

    Args:
        spring_law: of the eigenvalues.
        process: of ν, with the inputs log c₁ c₂, log c₁/c₂ and log c₃.
        b: of the FENE-P dumbbells whose conformation is the second memory.
    """

    spring_law: SpringLaw
    process: GaussianProcess
    b: float
    provenance: dict[str, Any] = field(default_factory=dict, repr=False)

    def content(self) -> dict[str, Any]:
        """What the file of the law holds; tables are made again."""
        processes = (self.spring_law.process, self.process)
        return law_content("twisted", processes, self.spring_law.outside, self.provenance, b=self.b)

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
        return np.concatenate([self.spring_law.rest, self.twin.rest])

    def spring(self, state: np.ndarray) -> np.ndarray:
        """S, shape [n, 4], of states [n, 8]."""
        C, P = state[..., :4], state[..., 4:]
        c1, c2, c3, cosine, sine = eigenvalues(C)
        c = np.maximum(np.stack([c1, c2, c3], axis=-1), LEAST)
        stiffness = self.spring_law.stiffness(invariants(c).reshape(-1, 3)).reshape(c.shape)
        s1, s2, s3 = np.moveaxis(c * np.exp(stiffness), -1, 0)
        turn = twist(P, cosine, sine) * self.process(shapes(c))
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


def shapes(c: np.ndarray) -> np.ndarray:
    """(log c₁ c₂, log c₁/c₂, log c₃) of eigenvalues [..., 3]."""
    log = np.log(c)
    parts = [log[..., 0] + log[..., 1], log[..., 0] - log[..., 1], log[..., 2]]
    return np.stack(parts, axis=-1)


def learn_twisted(
    records: Ensembles | list[Ensembles],
    b: float,
    *,
    points: int = 200,
    turns: int = 120,
    **options: Any,
) -> TwistedSpringLaw:
    """Learn the spring and what turns it.

    Args:
        records: of dumbbells that were at rest at their start.
        b: of the dumbbells.
        points: of the spring.
        turns: points of ν, of those samples where P is turned at all.
        options: of learn_spring.

    Raises InputError when no sample has its P turned: learn_spring is enough then.
    """
    records = [records] if isinstance(records, Ensembles) else records
    law, twin = learn_spring(records, points=points, **options), FENEP(b)
    X, y, x = [], [], []
    for record in records:
        P = homogeneous(twin, record.K, record.interval)
        c1, c2, c3, cosine, sine = eigenvalues(record.C)
        s1, s2, s12 = in_frame(record.S, cosine, sine)
        X.append(shapes(np.stack([c1, c2, c3], axis=-1)).reshape(-1, 3))
        y.append((s12 / np.sqrt(s1 * s2)).ravel())
        x.append(twist(P, cosine, sine).ravel())
    inputs, turned, by = np.concatenate(X), np.concatenate(y), np.concatenate(x)
    keep = np.abs(by) > SMALLEST
    if keep.sum() < 2:
        raise InputError("twist: expected samples of shear or mixed flow, got none")
    inputs, turned, by = inputs[keep], turned[keep], by[keep]
    noise = (ABSOLUTE**2 + (RELATIVE * turned) ** 2) / by**2
    chosen = np.unique(np.linspace(0, len(by) - 1, min(SUBSET, len(by))).astype(int))
    process = fit_process(inputs[chosen], (turned / by)[chosen], noise=noise[chosen])
    for _ in range(2):
        chosen = greedy(process.standard(inputs), turns)
        parts = np.column_stack([inputs, turned / by])
        means, sure = gathered(process.standard(inputs), chosen, parts, 1 / noise)
        process = fit_process(means[:, :3], means[:, 3], noise=np.maximum(1 / sure, FLOOR**2))
    return TwistedSpringLaw(law, process, b)
