"""Exact Gaussian-process regression that knows its noise (theory, F18).

Kernels on standardised inputs: "product", the squared exponential with a length for each input;
"additive", the sum of one-dimensional ones. A few hundred points are what it is for.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import scipy.linalg as sl
from scipy.optimize import minimize

from warp_peri import InputError

KERNELS = ("product", "additive")
JITTER = 1e-10
"""Added to the diagonal, in units of the kernel's own."""
LENGTHS = (np.log(0.1), np.log(60.0))
"""Bounds of the logarithm of a length, in standard deviations of its input."""
SUBSET = 400
"""Points, evenly from the first to the last, that hyperparameters are fitted on; all predict."""


@dataclass(frozen=True)
class GaussianProcess:
    """A fitted process: what it was given, in the given units, and its hyperparameters.

    Args:
        kernel: one of the names above.
        X: inputs, shape [n, d].
        y: values, shape [n].
        noise: variance of each value, shape [n], or its covariance [n, n].
        log_amplitude: of the standardised values.
        log_lengths: of the standardised inputs, shape [d].
        centre, scale: of the inputs, shape [d].
        mean, size: of the values.
    """

    kernel: str
    X: np.ndarray = field(repr=False)
    y: np.ndarray = field(repr=False)
    noise: np.ndarray = field(repr=False)
    log_amplitude: float
    log_lengths: np.ndarray
    centre: np.ndarray
    scale: np.ndarray
    mean: float
    size: float

    def __post_init__(self) -> None:
        n, d = self.X.shape if self.X.ndim == 2 else (0, 0)
        shapes = {"y": (n,), "noise": (n, n)[: self.noise.ndim], "log_lengths": (d,)}
        shapes |= {"centre": (d,), "scale": (d,)}
        if wrong := [name for name, shape in shapes.items() if getattr(self, name).shape != shape]:
            raise InputError(f"process: {', '.join(wrong)} do not fit {n} inputs of {d} numbers")
        if self.kernel not in KERNELS:
            raise InputError(f"kernel: expected one of {', '.join(KERNELS)}, got {self.kernel!r}")

    def standard(self, X: np.ndarray) -> np.ndarray:
        """Inputs in lengths of the kernel."""
        return np.asarray((X - self.centre) / self.scale / np.exp(self.log_lengths))

    @cached_property
    def points(self) -> np.ndarray:
        """The given inputs, standardised."""
        return self.standard(self.X)

    def covariance(self, A: np.ndarray, B: np.ndarray) -> np.ndarray:
        """Covariance of the standardised values at standardised inputs, shape [a, b]."""
        amplitude = np.exp(2 * self.log_amplitude)
        if self.kernel == "product":
            square = (A**2).sum(1)[:, None] + (B**2).sum(1) - 2 * A @ B.T
            return np.asarray(amplitude * np.exp(-0.5 * np.maximum(square, 0)))
        total = np.zeros((len(A), len(B)))
        for a, b in zip(A.T, B.T):
            total += np.exp(-0.5 * (a[:, None] - b) ** 2)
        return np.asarray(amplitude * total)

    @property
    def prior(self) -> float:
        """Variance of a standardised value before any data."""
        count = {"product": 1, "additive": len(self.log_lengths)}[self.kernel]
        return float(np.exp(2 * self.log_amplitude) * count)

    @cached_property
    def factor(self) -> np.ndarray:
        """Lower Cholesky factor of the covariance of the data."""
        K = self.covariance(self.points, self.points) + _matrix(self.noise / self.size**2)
        K[np.diag_indices(len(K))] += JITTER * self.prior
        return np.asarray(sl.cholesky(K, lower=True))

    @cached_property
    def weights(self) -> np.ndarray:
        """What the kernel's columns are multiplied by."""
        return np.asarray(sl.cho_solve((self.factor, True), (self.y - self.mean) / self.size))

    def __call__(self, X: np.ndarray) -> np.ndarray:
        """Expected values at inputs [m, d]."""
        k = self.covariance(self.standard(X), self.points)
        return np.asarray(self.mean + self.size * (k @ self.weights))


def fit_process(
    X: np.ndarray,
    y: np.ndarray,
    *,
    kernel: str = "product",
    noise: np.ndarray | None = None,
    mean: float | None = None,
    iterations: int = 80,
) -> GaussianProcess:
    """A process whose hyperparameters make the data likeliest.

    Args:
        X: inputs, shape [n, d].
        y: values, shape [n].
        kernel: "product" or "additive".
        noise: known variance of the values, shape [n], or covariance [n, n]; learned, the same for
            all, if not given.
        mean: of the process before data; that of y if not given.
        iterations: of L-BFGS-B.

    Raises InputError for shapes that do not fit, numbers that are not finite, an unknown kernel or
    a noise that is not positive.
    """
    X, y = np.asarray(X, dtype=float), np.asarray(y, dtype=float)
    _check(X, y, kernel, noise)
    scale = np.where(X.std(axis=0) > 1e-12, X.std(axis=0), 1.0)
    base = float(y.mean()) if mean is None else mean
    size = float(np.sqrt(np.mean((y - base) ** 2)))
    size = size if size > 1e-12 else 1.0
    keep = np.unique(np.linspace(0, len(X) - 1, min(SUBSET, len(X))).astype(int))
    known = None if noise is None else np.asarray(noise, dtype=float)
    part = None if known is None else known[keep] if known.ndim == 1 else known[np.ix_(keep, keep)]
    Z, f = ((X - X.mean(axis=0)) / scale)[keep], (y[keep] - base) / size
    given = None if part is None else part / size**2
    d = X.shape[1]
    start = np.concatenate([[0.0], np.full(d, 0.7), [np.log(0.1)]])
    bounds = [(-5, 6), *[LENGTHS] * d, (-12, 1)]
    optimum = minimize(
        unlikelihood, start, (Z, f, kernel, given), jac=True, bounds=bounds,
        method="L-BFGS-B", options={"maxiter": iterations},
    )  # fmt: skip
    theta = optimum.x
    variance = np.full(len(y), np.exp(2 * theta[-1]) * size**2) if known is None else known
    return GaussianProcess(
        kernel, X, y, variance, float(theta[0]), theta[1 : 1 + d], X.mean(axis=0), scale, base, size
    )


def unlikelihood(
    theta: np.ndarray, Z: np.ndarray, f: np.ndarray, kernel: str, noise: np.ndarray | None
) -> tuple[float, np.ndarray]:
    """(F18) and its gradient by log amplitude, log lengths, log noise."""
    n, d = Z.shape
    amplitude, lengths = np.exp(2 * theta[0]), np.exp(theta[1 : 1 + d])
    squares = [((z[:, None] - z) / length) ** 2 for z, length in zip(Z.T, lengths)]
    if kernel == "product":
        K = amplitude * np.exp(-0.5 * np.sum(squares, axis=0))
    else:
        ones = [np.exp(-0.5 * s) for s in squares]
        K = amplitude * np.sum(ones, axis=0)
    added = _matrix(noise) if noise is not None else np.exp(2 * theta[-1]) * np.eye(n)
    total = K + added + JITTER * K[0, 0] * np.eye(n)
    try:
        L = sl.cholesky(total, lower=True)
    except sl.LinAlgError:
        return 1e12, np.zeros_like(theta)
    alpha = sl.cho_solve((L, True), f)
    value = 0.5 * f @ alpha + np.log(np.diag(L)).sum() + 0.5 * n * np.log(2 * np.pi)
    G = 0.5 * (sl.cho_solve((L, True), np.eye(n)) - np.outer(alpha, alpha))
    gradient = np.zeros_like(theta)
    gradient[0] = 2 * np.sum(G * K) + 2 * JITTER * K[0, 0] * np.trace(G)
    for i, s in enumerate(squares):
        part = K if kernel == "product" else amplitude * ones[i]
        gradient[1 + i] = np.sum(G * part * s)
    if noise is None:
        gradient[-1] = 2 * np.exp(2 * theta[-1]) * np.trace(G)
    return float(value), gradient


def _matrix(noise: np.ndarray) -> np.ndarray:
    return np.diag(noise) if noise.ndim == 1 else noise


def _check(X: np.ndarray, y: np.ndarray, kernel: str, noise: np.ndarray | None) -> None:
    if kernel not in KERNELS:
        raise InputError(f"kernel: expected one of {', '.join(KERNELS)}, got {kernel!r}")
    if X.ndim != 2 or y.shape != X.shape[:1] or len(y) < 2:
        raise InputError(f"data: expected X [n, d] and y [n], got {X.shape} and {y.shape}")
    if not (np.isfinite(X).all() and np.isfinite(y).all()):
        raise InputError("data: expected finite inputs and values")
    if noise is not None:
        noise = np.asarray(noise, dtype=float)
        variances = noise if noise.ndim == 1 else np.diag(noise)
        if variances.shape != y.shape or not (variances > 0).all():
            raise InputError(f"noise: expected {len(y)} variances above 0")
