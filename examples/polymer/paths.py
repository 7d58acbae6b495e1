"""How sure a flow is: laws drawn from a learned one, each carried through the flow (F30).

A path is a whole function, drawn by Matheron's rule: random cosines for the prior, and the data's
pull on them. It knows the noise and the gaps of the data, not what the form of the law leaves out.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import scipy.linalg as sl
from scipy import stats

from examples.polymer.gaussian_process import LENGTHS, SUBSET, GaussianProcess, unlikelihood
from warp_peri import InputError

COSINES = 512
"""Of one prior function, for each input where the kernel is a sum."""


@dataclass(frozen=True)
class PathProcess(GaussianProcess):
    """One function drawn from a process.

    Args (beside those of the process):
        frequencies: of the cosines, shape [M, d].
        phases: shape [M].
        sizes: of the cosines, shape [M].
        pull: what the kernel's columns are multiplied by, shape [n].
    """

    frequencies: np.ndarray
    phases: np.ndarray
    sizes: np.ndarray
    pull: np.ndarray

    def prior_at(self, Z: np.ndarray) -> np.ndarray:
        """The prior function at standardised inputs."""
        return np.asarray(np.cos(Z @ self.frequencies.T + self.phases) @ self.sizes)

    def __call__(self, X: np.ndarray) -> np.ndarray:
        """Values of this function at inputs [m, d]."""
        Z = self.standard(X)
        standard = self.prior_at(Z) + self.covariance(Z, self.points) @ self.pull
        return np.asarray(self.mean + self.size * standard)


def draw(process: GaussianProcess, random: np.random.Generator) -> PathProcess:
    """One function of a process. Raises InputError for the kernel "second"."""
    d = len(process.log_lengths)
    if process.kernel == "product":
        frequencies = random.standard_normal((COSINES, d))
    elif process.kernel == "additive":
        frequencies = np.zeros((COSINES * d, d))
        for i in range(d):
            frequencies[i * COSINES : (i + 1) * COSINES, i] = random.standard_normal(COSINES)
    else:
        raise InputError(f"paths: expected the kernel product or additive, got {process.kernel}")
    phases = random.uniform(0, 2 * np.pi, len(frequencies))
    sizes = np.sqrt(2 * process.prior / len(frequencies)) * random.standard_normal(len(frequencies))
    known = {field.name: getattr(process, field.name) for field in fields(GaussianProcess)}
    path = PathProcess(
        **known, frequencies=frequencies, phases=phases, sizes=sizes, pull=np.zeros(len(process.y))
    )
    noise = process.noise / process.size**2
    if noise.ndim == 1:
        drawn = np.sqrt(noise) * random.standard_normal(len(noise))
    else:
        drawn = np.linalg.cholesky(noise) @ random.standard_normal(len(noise))
    wanted = (process.y - process.mean) / process.size - path.prior_at(process.points) - drawn
    return replace(path, pull=sl.cho_solve((process.factor, True), wanted))


def varied(process: GaussianProcess, count: int, random: np.random.Generator) -> list[Any]:
    """Processes of the same data with hyperparameters drawn about the likeliest (F38)."""
    theta, curvature = curvature_of(process)
    L = np.linalg.inv(np.linalg.cholesky(curvature)).T
    drawn = theta + random.standard_normal((count, len(theta))) @ L.T
    d = len(process.log_lengths)
    return [
        replace(process, log_amplitude=float(t[0]), log_lengths=np.clip(t[1 : 1 + d], *LENGTHS))
        for t in drawn
    ]


def curvature_of(process: GaussianProcess, step: float = 1e-3) -> tuple[np.ndarray, np.ndarray]:
    """Log amplitude and lengths θ of a fit, and the second derivatives of (F18) there (F38).

    By differences of the exact gradient on the points that were fitted, and 1 added for each: a
    prior within a factor e of the fit. Directions that the data do not bend upwards have the prior.
    """
    d, n = len(process.log_lengths), len(process.y)
    keep = np.unique(np.linspace(0, n - 1, min(SUBSET, n)).astype(int))
    Z = ((process.X - process.centre) / process.scale)[keep]
    f = ((process.y - process.mean) / process.size)[keep]
    noise = process.noise / process.size**2
    noise = noise[keep] if noise.ndim == 1 else noise[np.ix_(keep, keep)]
    theta = np.concatenate([[process.log_amplitude], process.log_lengths, [process.log_pairs, 0.0]])

    def gradient(moved: np.ndarray) -> np.ndarray:
        return unlikelihood(moved, Z, f, process.kernel, noise)[1][: 1 + d]

    shifts = step * np.eye(len(theta))[: 1 + d]
    H = np.array([gradient(theta + e) - gradient(theta - e) for e in shifts]) / (2 * step)
    value, vector = np.linalg.eigh((H + H.T) / 2)
    return theta[: 1 + d], (vector * (np.maximum(value, 0) + 1)) @ vector.T


def drawn_laws(law: Any, count: int, random: np.random.Generator) -> list[Any]:
    """Learned laws whose processes are drawn, hyperparameters first; tables are not used."""
    from examples.polymer.rates import RateLaw  # which is a law with a band itself

    processes = law.processes if isinstance(law, RateLaw) else [law.process]
    functions = [[draw(p, random) for p in varied(process, count, random)] for process in processes]
    if isinstance(law, RateLaw):
        return [law.as_law(RateLaw, processes=three) for three in zip(*functions)]
    return [replace(law, process=function) for function in functions[0]]


@dataclass(frozen=True)
class Band:
    """Of a field that a flow gave: with the law itself, and with laws drawn from it [S, ...]."""

    value: np.ndarray
    drawn: np.ndarray

    @property
    def deviation(self) -> np.ndarray:
        """Standard deviation of the drawn fields about the value."""
        return np.asarray(np.sqrt(np.mean((self.drawn - self.value) ** 2, axis=0)))

    def half_width(self, times: float = 2.0) -> np.ndarray:
        """Of the band that holds as much as `times` deviations of a normal number do.

        A deviation that comes of few drawn laws is itself uncertain: Student's factor.
        """
        probability = 2 * stats.norm.cdf(times) - 1
        factor = stats.t.ppf((1 + probability) / 2, len(self.drawn))
        return np.asarray(factor * self.deviation)

    def covers(self, truth: np.ndarray, times: float = 2.0) -> float:
        """Fraction of places, of those that moved at all, where the truth is inside the band."""
        moved = self.deviation > 1e-6 * np.abs(self.value).max()
        inside = np.abs(truth - self.value) < self.half_width(times)
        return float(inside[moved].mean())


def band(law: Any, run: Callable[[Any], np.ndarray], count: int = 8, seed: int = 0) -> Band:
    """Carry a law and `count` laws drawn from it through a flow.

    `law`: a learned law with product or additive kernels; `run`: gives the field, a velocity say,
    that a law makes; `count`: of drawn laws; `seed`: of the draws.
    """
    random = np.random.default_rng(seed)
    return Band(run(law), np.array([run(drawn) for drawn in drawn_laws(law, count, random)]))
