"""Dumbbells: their motion, ensembles under protocols, and twins that share their noise.

Time in relaxation times, length in units in which a Hookean dumbbell at rest has ⟨q q⟩ = I, stress
in n k T (theory, F1–F6).
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import warp as wp
from scipy import stats
from tqdm import tqdm

from examples.polymer.kernels.dumbbells import advance_fene, advance_hookean
from examples.polymer.laws import IDENTITY, trace
from warp_peri.errors import InputError
from warp_peri.files.atomic import ArrayFile
from warp_peri.files.checkpoint import fingerprint
from warp_peri.launch import DEVICE, at_once, empty, floats, launch, threads
from warp_peri.points.arrays import check_positive, check_whole, checked, is_positive

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
        check_whole("dumbbells", count, 2)
        check_whole("ensembles", ensembles, 1)
        if b is not None and not (is_positive(b) and b > 3):
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
        K = np.broadcast_to(checked("velocity gradient", K), (self.ensembles, 4))
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
        ArrayFile(path, self.key, "other dumbbells").write(self.state())

    def load(self, path: str | os.PathLike[str]) -> None:
        """Go on from a kept state. Raises InputError for none, and a file of other dumbbells."""
        file = ArrayFile(path, self.key, f"others than {self.key}")
        state = file.read(lambda arrays: {name: arrays[name] for name in self.state()})
        if state is None:
            raise InputError(f"{path}: no such file")
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


@dataclass(frozen=True)
class Ensembles:
    """Moments of ensembles at the ends of intervals.

    Args:
        interval: relaxation times between two rows.
        K: what was felt, shape [T, m, 4].
        C: ⟨q q⟩, shape [T + 1, m, 4].
        S: ⟨q q f⟩, the same for Hookean dumbbells; the stress is S − I.
        count: dumbbells in an ensemble, 0 for exact moments.

    Raises InputError for an interval that is not positive, a count below 0, and moments of other
    shapes or that are not finite.
    """

    interval: float
    K: np.ndarray
    C: np.ndarray
    S: np.ndarray
    count: int

    def __post_init__(self) -> None:
        check_positive("interval", self.interval)
        check_whole("count", self.count, 0)
        T, m, _ = checked("K", self.K, float, ("T", "m", 4)).shape
        for name in ("C", "S"):
            checked(name, getattr(self, name), float, (T + 1, m, 4))

    @property
    def stress(self) -> np.ndarray:
        """s = S − I [n k T], shape [T + 1, m, 4]."""
        return np.asarray(self.S - IDENTITY)


def listed(records: Ensembles | Sequence[Ensembles]) -> list[Ensembles]:
    """One record or several as a list. Raises InputError for none."""
    several = [records] if isinstance(records, Ensembles) else list(records)
    if not several:
        raise InputError("records: expected one or more, got none")
    return several


def held(K: np.ndarray, intervals: int) -> np.ndarray:
    """Every ensemble under one K of its own [m, 4] throughout."""
    return np.tile(np.asarray(K, dtype=float), (intervals, 1, 1))


def random_planar(n: int, largest: float, random: np.random.Generator) -> np.ndarray:
    """Gradients without trace, each component within ± largest/√2; shape [n, 4]."""
    a, b, c = random.uniform(-1, 1, (3, n)) * largest / np.sqrt(2)
    return np.stack([a, b, c, -a], axis=-1)


def mixed(m: int, intervals: int, largest: float, *, hold: int = 10, seed: int = 0) -> np.ndarray:
    """Random planar gradients, a new one every `hold` intervals: what visits mixed states.

    Raises InputError for a `largest` that is not positive.
    """
    check_positive("largest gradient", largest)
    random = np.random.default_rng(seed)
    pieces = -(-intervals // hold)
    drawn = random_planar(pieces * m, largest, random).reshape(pieces, m, 4)
    return np.repeat(drawn, hold, axis=0)[:intervals]


def simulate(
    dumbbells: Dumbbells,
    K: np.ndarray,
    interval: float,
    *,
    steps: int = 1,
    checkpoint: str | os.PathLike[str] | None = None,
    progress: bool = False,
) -> Ensembles:
    """Run dumbbells through a protocol.

    Args:
        dumbbells: as many ensembles as K has.
        K: the protocol, shape [T, m, 4].
        interval: relaxation times that each row is held.
        steps: of the dumbbells in an interval; Hookean ones need one.
        checkpoint: file written now and then; a run that finds its own goes on from it, and ends
            with the same bits.
        progress: whether to show a bar.

    Raises InputError for a protocol of another shape, an interval that is not positive, steps below
    1, or a checkpoint of another run.
    """
    check_positive("interval", interval)
    check_whole("steps", steps, 1)
    K = checked("K", K)
    if K.ndim != 3 or K.shape[1:] != (dumbbells.ensembles, 4):
        raise InputError(f"K: expected shape [T, {dumbbells.ensembles}, 4], got {list(K.shape)}")
    first, key = 0, f"{dumbbells.key}, {fingerprint(K, interval, steps)[:16]}"
    moments = np.zeros((2, len(K) + 1, *K.shape[1:]))
    file = ArrayFile(checkpoint, key, "another run")

    def made(arrays: dict[str, np.ndarray]) -> tuple[int, np.ndarray, dict[str, np.ndarray]]:
        state = {name: arrays[name] for name in dumbbells.state()}
        return int(arrays["done"]), arrays["moments"].reshape(moments.shape), state

    if (kept := file.read(made)) is not None:
        first, moments, state = kept
        dumbbells.restore(state)
    else:
        now = dumbbells.moments()
        moments[:, 0] = now.C, now.S
    rows = tqdm(range(first, len(K)), disable=not progress, desc="dumbbells", initial=first)
    often = max(1, len(K) // 20)
    for n in rows:
        now = dumbbells.advance(K[n], interval / steps, steps)
        moments[:, n + 1] = now.C, now.S
        if checkpoint is not None and ((n + 1) % often == 0 or n + 1 == len(K)):
            file.write({**dumbbells.state(), "moments": moments, "done": n + 1})
    return Ensembles(interval, K, moments[0], moments[1], dumbbells.count)


def read_trajectory(
    path: str | os.PathLike[str], relaxation_time: float, modulus: float, count: int
) -> Ensembles:
    """A stress trajectory of any simulator, as a record of one ensemble.

    Args:
        path: text with commas; columns t, K_xx, K_xy, K_yx, K_yy (in 1/time) and the stress of the
            polymer s_xx, s_xy, s_yy, s_zz, at equal times; lines that begin with # are skipped.
        relaxation_time: in the file's unit of time.
        modulus: n k T in the file's unit of stress.
        count: molecules, which set the noise.

    C is given as S: a stress trajectory does not know the conformation. Raises InputError for a
    file that cannot be read, other columns, times that are not equally spaced, a time or modulus
    that is not positive, and a count below 1.
    """
    check_positive("relaxation_time", relaxation_time)
    check_positive("modulus", modulus)
    check_whole("count", count, 1)
    try:
        table = np.loadtxt(path, delimiter=",", ndmin=2)
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: not a table of numbers ({error})") from None
    if table.shape[1] != 9 or len(table) < 3:
        raise InputError(f"{path}: expected 9 columns and 3 lines or more, got {table.shape}")
    gaps = np.diff(table[:, 0]) / relaxation_time
    if not (gaps[0] > 0 and np.allclose(gaps, gaps[0], rtol=1e-4)):
        raise InputError(f"{path}: expected equally spaced times")
    S = table[:, None, 5:] / modulus + IDENTITY
    K = table[:-1, None, 1:5] * relaxation_time
    return Ensembles(float(gaps[0]), K, S, S, count)


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
