"""Ensembles of dumbbells on a device: Hookean ones exact in the step, FENE of weak order two.

Time in relaxation times, length in units in which a Hookean dumbbell at rest has ⟨q q⟩ = I, stress
in n k T (theory, F1–F6).
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import warp as wp

from warp_peri.errors import InputError
from warp_peri.files.archive import read_arrays
from warp_peri.files.atomic import whole_file
from warp_peri.kernels.flow.dumbbells import advance_fene, advance_hookean
from warp_peri.launch import DEVICE, at_once, empty, floats, launch, threads

BLOCK = 2000
"""Dumbbells a thread sums up in single precision."""
LARGEST_STEP = 1.0
"""|K| Δt beyond which the second-order step of FENE dumbbells is not trusted."""
NODES, WEIGHTS = np.polynomial.legendre.leggauss(6)


@dataclass(frozen=True)
class Moments:
    """Of ensembles: conformation C = ⟨q q⟩ and S = ⟨q q f⟩, shapes [m, 4]; S is C for Hookean."""

    C: np.ndarray
    S: np.ndarray


class Dumbbells:
    """Ensembles of independent dumbbells, each ensemble under a velocity gradient of its own.

    Args:
        ensembles: how many.
        count: dumbbells in each.
        b: largest q² of a FENE dumbbell, above 3; None for Hookean ones.
        seed: of start and noise; the same seed gives the same bits on any number of threads.
        common: whether all ensembles start alike and feel the same noise.
        matched: whether the start is scaled to have exactly the second moments of rest.
        device: of the arrays.

    Raises InputError for counts below 1 or b not above 3.
    """

    def __init__(
        self,
        ensembles: int,
        count: int,
        *,
        b: float | None = None,
        seed: int = 0,
        common: bool = False,
        matched: bool = False,
        device: str = DEVICE,
    ) -> None:
        if ensembles < 1 or count < 2:
            raise InputError(f"dumbbells: expected ≥ 2 in ≥ 1 ensembles, got {count}, {ensembles}")
        if b is not None and not (np.isfinite(b) and b > 3):
            raise InputError(f"b: expected a number above 3, got {b}")
        self.b, self.seed, self.common, self.matched = b, seed, common, matched
        self.count, self.ensembles, self.steps = count, ensembles, 0
        start = np.random.default_rng(seed)
        drawn = rest(1 if common else ensembles, count, b, start)
        if matched:
            drawn = match(drawn, rest_moment(b))
        q = np.broadcast_to(drawn, (ensembles, count, 3)).astype(np.float32)
        self.q: wp.array[Any] = wp.array(np.ascontiguousarray(q), dtype=wp.vec3f, device=device)
        self._on_cpu = wp.get_device(device).is_cpu
        self._stream = int(np.random.SeedSequence([seed, 1]).generate_state(1)[0] >> 2)
        self._blocks = -(-count // BLOCK)
        columns = 4 if b is None else 8
        self._sums = empty(ensembles * self._blocks, columns, dtype=wp.float64, device=device)

    def advance(self, K: np.ndarray, dt: float, steps: int = 1) -> Moments:
        """Some steps of dt relaxation times under K [ensembles, 4] held; the moments after them.

        Hookean dumbbells take any step exactly, so that steps are one. Raises InputError for a
        step beyond |K| Δt = 1 of FENE dumbbells.
        """
        K = np.broadcast_to(np.asarray(K, dtype=float), (self.ensembles, 4))
        if not np.isfinite(K).all():
            raise InputError("velocity gradient: expected finite numbers")
        largest = float(np.abs(K).max()) * dt
        if self.b is not None and largest > LARGEST_STEP:
            raise InputError(
                f"time step: expected at most {dt * LARGEST_STEP / largest:.3g} relaxation times "
                f"for a velocity gradient of {largest / dt:.3g}, got {dt:g}"
            )
        if self.b is None:
            self._launch(advance_hookean, [_single(part) for part in propagator(K, dt)], steps)
        else:
            self._launch(advance_fene, [_single(K), self.b, dt], steps)
        return self._mean()

    def follow(self, P: np.ndarray, L: np.ndarray) -> None:
        """One step q → P q + L ξ of Hookean dumbbells, as `propagator` gives it."""
        self._launch(advance_hookean, [_single(P), _single(L)], 1)

    def moments(self) -> Moments:
        """The moments as they are."""
        return self.advance(np.zeros(4), 0.0, 0)

    def _launch(self, kernel: Any, law: list[Any], steps: int) -> None:
        seed = (self._stream + self.steps) % 2**30
        inputs = [*law, seed, steps, int(self.common), self._blocks]
        self.steps += steps
        total = self.ensembles * self._blocks
        slices = min(threads(), total) if self._on_cpu else 1
        ends = [total * n // slices for n in range(slices + 1)]
        kernel.module.load(self.q.device)  # not from two threads at once

        def job(first: int, last: int) -> Callable[[], None]:
            return lambda: launch(kernel, last - first, [first, *inputs], [self.q, self._sums])

        at_once([job(first, last) for first, last in pairwise(ends)])

    def _mean(self) -> Moments:
        sums = self._sums.numpy().reshape(self.ensembles, self._blocks, -1).sum(axis=1)
        mean = sums / self.count
        return Moments(mean[:, :4].copy(), mean[:, -4:].copy())

    def state(self) -> dict[str, np.ndarray]:
        """What a checkpoint keeps."""
        return {"q": self.q.numpy(), "steps": np.array(self.steps)}

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """Go on from it with the random numbers that come next."""
        self.q.assign(state["q"])
        self.steps = int(state["steps"])

    def save(self, path: str | os.PathLike[str]) -> None:
        """Keep the state in an .npz file, written whole or not at all."""
        with whole_file(path) as temporary, open(temporary, "wb") as file:
            np.savez(file, **self.state(), key=np.array(self.key))  # type: ignore[arg-type]

    def load(self, path: str | os.PathLike[str]) -> None:
        """Go on from a kept state. Raises InputError for a file of other dumbbells."""
        try:
            content = read_arrays(path)
            state, key = {name: content[name] for name in self.state()}, str(content["key"])
        except (OSError, KeyError, ValueError, TypeError) as error:
            raise InputError(f"{path}: not a state of dumbbells ({error})") from None
        if key != self.key:
            raise InputError(f"{path}: expected the state of {self.key}, got {key}")
        self.restore(state)

    @property
    def key(self) -> str:
        """What the run depends on."""
        return (
            f"{self.ensembles} x {self.count} dumbbells, b {self.b}, seed {self.seed}, "
            f"common {self.common}, matched {self.matched}"
        )


def _single(values: np.ndarray) -> wp.array[Any]:
    return floats(values.astype(np.float32), wp.float32)


def rest_moment(b: float | None) -> float:
    """⟨q_x²⟩ at rest: 1, or b/(b + 5) of FENE dumbbells."""
    return 1.0 if b is None else b / (b + 5)


def rest(m: int, n: int, b: float | None, random: np.random.Generator) -> np.ndarray:
    """Dumbbells at rest, shape [m, n, 3]: Gaussian, or with density (1 − q²/b)^(b/2)."""
    q = random.standard_normal((m, n, 3))
    if b is not None:
        length = np.sqrt(b * random.beta(1.5, b / 2 + 1, (m, n, 1)))
        q *= length / np.linalg.norm(q, axis=2, keepdims=True)
    return q


def match(q: np.ndarray, moment: float) -> np.ndarray:
    """The ensembles, linearly mapped to second moments of exactly `moment` times I."""
    C = np.einsum("mni,mnj->mij", q, q) / q.shape[1]
    inverse = np.linalg.inv(np.linalg.cholesky(C))
    return np.asarray(np.sqrt(moment) * np.einsum("mij,mnj->mni", inverse, q))


def exponential(K: np.ndarray, t: float) -> np.ndarray:
    """exp(K t) of planar gradients, shape [..., 4], in closed form."""
    half = (K[..., 0] + K[..., 3]) / 2
    d = (K[..., 0] - K[..., 3]) / 2
    root = np.emath.sqrt(d * d + K[..., 1] * K[..., 2]) * t
    small = np.abs(root) < 1e-6
    ratio = np.where(small, 1 + root**2 / 6, np.sinh(root) / np.where(small, 1, root)).real * t
    grown, cosine = np.exp(half * t), np.cosh(root).real
    parts = [cosine + ratio * d, ratio * K[..., 1], ratio * K[..., 2], cosine - ratio * d]
    return np.asarray(grown[..., None] * np.stack(parts, axis=-1))


def propagator(
    K: np.ndarray, dt: float, stiffness: float | np.ndarray = 1.0
) -> tuple[np.ndarray, np.ndarray]:
    """(P, L) of the exact Hookean step (F3): q → P q + L ξ, with P [m, 5] and lower L [m, 4].

    P is (xx, xy, yx, yy, zz); the stiffness k, a number or [m], multiplies the spring. The
    covariance L Lᵗ = ∫ e^(−k t) e^(K t) e^(Kᵗt) dt by Gauss's rule with six nodes, which is exact
    to rounding where |K| Δt is below one.
    """
    k = np.broadcast_to(stiffness, K.shape[:-1])
    damped = np.exp(-k * dt / 2)
    P = damped[..., None] * exponential(K, dt)
    Q = np.zeros((*K.shape[:-1], 3))
    for node, weight in zip(NODES, WEIGHTS):
        t = (node + 1) * dt / 2
        E = exponential(K, t)
        product = np.stack(
            [E[..., 0] ** 2 + E[..., 1] ** 2,
             E[..., 0] * E[..., 2] + E[..., 1] * E[..., 3],
             E[..., 2] ** 2 + E[..., 3] ** 2],
            axis=-1,
        )  # fmt: skip
        Q += weight * dt / 2 * np.exp(-k * t)[..., None] * product
    lxx = np.sqrt(Q[..., 0])
    lyx = Q[..., 1] / np.where(lxx > 0, lxx, 1)
    lyy = np.sqrt(np.maximum(Q[..., 2] - lyx**2, 0))
    lzz = np.sqrt(-np.expm1(-k * dt) / k)
    return np.concatenate([P, damped[..., None]], axis=-1), np.stack([lxx, lyx, lyy, lzz], axis=-1)


def stretched_rest(K: np.ndarray, b: float) -> Moments:
    """Exact steady moments of FENE dumbbells in a symmetric K, by quadrature (F6).

    K: one planar gradient with K_xy = K_yx, shape [4]. Raises InputError for another.
    """
    if not np.isclose(K[1], K[2]):
        raise InputError("stretched_rest: expected a symmetric velocity gradient")
    radius, wr = np.polynomial.legendre.leggauss(200)
    r = np.sqrt(b) * (radius + 1) / 2
    height, wh = np.polynomial.legendre.leggauss(120)
    angle = np.arange(120) * 2 * np.pi / 120
    flat = np.sqrt(1 - height**2)
    e = np.stack(
        [np.multiply.outer(flat, np.cos(angle)), np.multiply.outer(flat, np.sin(angle)),
         np.broadcast_to(height[:, None], (120, 120))]
    )  # fmt: skip
    stretch = K[0] * e[0] ** 2 + (K[1] + K[2]) * e[0] * e[1] + K[3] * e[1] ** 2
    power = b / 2 * np.log1p(-(r**2) / b)[:, None, None] + r[:, None, None] ** 2 * stretch
    density = np.exp(power - power.max()) * (wr * r**2)[:, None, None] * wh[None, :, None]
    parts = np.stack([e[0] ** 2, e[0] * e[1], e[1] ** 2, e[2] ** 2])
    q2 = np.einsum("rha,cha,r->c", density, parts, r**2) / density.sum()
    f = r**2 / (1 - r**2 / b)
    return Moments(q2[None], (np.einsum("rha,cha,r->c", density, parts, f) / density.sum())[None])
