"""Influence functions of any shape: a callable of r with parameters to learn (theory, 59–60).

    shape = InfluenceFunction(lambda r, width: np.exp(-((r / width) ** 2)), {"width": 8.0})
    fit = warp_peri.fit(samples, warp_peri.LPS(20.0, shape))
    fit.influence.parameters["width"]

A model keeps the polynomial (60) of it, so that files, certificates and solves know one kind.
"""

from __future__ import annotations

import copy
import functools
import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy import ndarray
from numpy.linalg import lstsq, solve
from numpy.typing import ArrayLike

from warp_peri.errors import Held, InputError, Values, called, hold, kept
from warp_peri.files import atomic
from warp_peri.materials.lps import LPSMaterial, bernstein_basis
from warp_peri.points import arguments
from warp_peri.points.arguments import USUAL, Numbers, Pair, Positive, Units, checked, plain, typed
from warp_peri.points.families import bond_classes

DEGREES = ((10, 0.0), (20, 0.0), (40, 0.0), (60, 0.0), (80, 1e-6))
"""Degrees M that are tried, one after the other, to write a function as a polynomial, with the
weight of D itself in the fit: without it D of a function with kinks grows beyond 1e7."""
EXACT = 1e-8
"""A polynomial must meet a function to this at the bond lengths, relative to its largest value
there, and is not made finer once it does so between them."""
BOND_WEIGHT = 1e5
"""Weight of an error at a bond length, where one between bond lengths has 1."""
BETWEEN = 1000
"""Distances between the bond lengths that a polynomial is fitted at."""
ROUNDING = 1e-9
"""Of bond lengths."""
STEP, SEEN = 1e-4, 1e-7
"""A derivative is taken with a step of this times the parameter, or with a larger one, up to this
itself, where K changes by less than SEEN of its size; of fourth order, hence exact to 1e-12."""


@typed
@dataclass(frozen=True, eq=False)
class InfluenceFunction(Held):
    """An influence function K(r) of the bond length and parameters; its scale has no effect.

    Attributes:
        function: called as function(r, **parameters) with r [Å] of shape [R]; returns K, shape [R].
        parameters: the values to start from, or learned: numbers or arrays of one axis.
        bounds: of a parameter, (lowest, highest); each of an array's elements keeps them.

    Raises InputError for parameters that are no finite numbers or outside their bounds, and bounds
    of no parameter. Calling it raises InputError where K is not finite or of another shape.
    """

    function: Callable[..., ArrayLike]
    parameters: Numbers = field(default_factory=dict)
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        values = {}
        for name, value in self.parameters.items():
            array = checked(name, value)
            if array.ndim > 1:
                raise InputError(f"{name}: expected a number or a list, got {array.shape}")
            values[name] = array if array.ndim else float(array)
        hold(self, parameters=values, bounds=dict(self.bounds))
        arguments.check_parameters(self.function, values)
        for name, ends in self.bounds.items():
            if name not in self.parameters:
                known = ", ".join(self.parameters) or "none"
                raise InputError(f"bounds: no parameter {name!r}; there are: {known}")
            pair = plain(f"bounds of {name}", ends)
            if pair.shape != (2,) or not pair[0] < pair[1]:
                raise InputError(f"bounds of {name}: expected (lowest, highest), got {ends!r}")
        lowest, highest = self.ends
        if not ((lowest <= self.vector) & (self.vector <= highest)).all():
            raise InputError(f"parameters: {dict(self.parameters)} are not within {self.bounds}")

    @property
    def name(self) -> str:
        """Name of the influence function."""
        inner = getattr(self.function, "func", self.function)  # of a functools.partial
        return str(getattr(inner, "__name__", type(inner).__name__))

    @property
    def vector(self) -> ndarray:
        """All parameters of the influence function in one vector, shape [P]."""
        return np.concatenate([np.zeros(0), *map(np.ravel, self.parameters.values())])

    @property
    def ends(self) -> Pair:
        """Lowest and highest value of each parameter, infinite where it has no bounds."""
        free = (-np.inf, np.inf)
        pairs = [
            np.tile(self.bounds.get(name, free), (np.size(value), 1))
            for name, value in self.parameters.items()
        ]
        lowest, highest = np.concatenate([np.zeros((0, 2)), *pairs]).T
        return lowest, highest

    def at(self, vector: ndarray) -> InfluenceFunction:
        """The influence function with other parameters, in one vector [P]."""
        values, first = Values(), 0
        vector = checked("vector", vector, float, self.vector.shape)
        for name, value in self.parameters.items():
            part = vector[first : first + np.size(value)]
            values[name] = part if np.ndim(value) else part[0]
            first += np.size(value)
        return replace(self, parameters=values)

    def __call__(self, r: ArrayLike) -> ndarray:
        """Values of K at the distances r [Å], of the shape of r."""
        distance, name = checked("r", r), f"influence '{self.name}'"
        what, named = f"{name}: expected a function of r [R]", copy.deepcopy(self.parameters)
        K = plain(name, called(what, self.function, distance.copy(), **named))
        arguments.check_shape(f"{name}: that of r", K, distance.shape)
        if (wrong := distance[~np.isfinite(K)]).size:
            raise InputError(
                f"{name}: K is not finite at r = {wrong.flat[0]:g} with "
                f"{dict(self.parameters)}; give `bounds` that keep it so"
            )
        return K

    def slopes(self, r: ndarray) -> ndarray:
        """Derivatives of K by the parameters, [R, P], by differences within the bounds."""
        p, columns = self.vector, []
        small, large = sorted((1.0, np.max(r)))  # of lengths, and of what has no unit
        for one, value, low, high in zip(np.eye(len(p)), p, *self.ends):
            widest = (high - low) / 8
            step = min(STEP * (abs(value) or small), widest)
            while True:
                ends = np.ceil((low - value) / step) + 2, np.floor((high - value) / step) - 2
                m = np.arange(-2, 3) + np.clip(0, *ends)
                K = np.array([self.at(p + n * step * one)(r) for n in m])
                seen = np.ptp(K, axis=0).max() >= SEEN * np.abs(K).max()
                if seen or 10 * step > min(STEP * large, widest):
                    break
                step *= 10
            weights = solve(np.vander(m, increasing=True).T, np.eye(5)[1])
            columns.append(weights @ K / step)
        return np.reshape(columns, (len(p), len(r))).T

    def coefficients(self, lengths: ArrayLike, horizon: Positive) -> tuple[ndarray, float]:
        """Bernstein coefficients D [M + 1] with α = 0, exact at bond lengths [Å], and how far they
        are off between them, relative to the largest |K| at one.

        Least squares over distances down to half the shortest bond, the bond lengths themselves
        held, with the first degree of DEGREES that is exact, or the last (theory, 60). Raises
        InputError for a function whose values at the bond lengths no D reaches, and a table that
        does not reach them.
        """
        r = np.unique(checked("lengths", lengths))
        if not (r.size and r[0] > 0):
            raise InputError("lengths: expected bonds, of lengths > 0, got others or none")
        knots = getattr(self.function, "keywords", {}).get("knots", r)  # of a table
        if r[0] < (1 - ROUNDING) * knots[0] or r[-1] > (1 + ROUNDING) * knots[-1]:
            raise InputError(
                f"table: expected K at all bonds, {r[0]:g} to {r[-1]:g}, got it at {knots[0]:g} to "
                f"{knots[-1]:g}"
            )
        nodes = np.cos(np.pi * (np.arange(BETWEEN) + 0.5) / BETWEEN)
        shortest = r[0] / 2
        s = shortest + (horizon - shortest) * (nodes + 1) / 2
        K, between = self(r), self(s)
        size = np.abs(K).max()
        if not size > 0:
            raise InputError(f"influence '{self.name}': K is zero at every bond length")
        for degree, small in DEGREES:
            basis = [bernstein_basis(lengths, horizon, degree) for lengths in (r, s)]
            system = [BOND_WEIGHT * basis[0], basis[1], small * np.eye(degree + 1)]
            target = np.concatenate([BOND_WEIGHT * K, between, np.zeros(degree + 1)]) / size
            D = lstsq(np.concatenate(system), target, rcond=1e-15)[0]
            error = np.abs(basis[0] @ D - K / size).max()
            departure = float(np.abs(basis[1] @ D - between / size).max())
            if max(error, departure) <= EXACT:
                break
        if error > EXACT:
            raise InputError(
                f"influence '{self.name}': no polynomial of degree {degree} takes its values "
                f"at the {len(r)} bond lengths; it is off by {error:.0e} of the largest"
            )
        return D * size, departure

    def model(
        self,
        *,
        lam: float,
        mu: float,
        horizon: Positive,
        spacings: Sequence[float],
        units: Units = USUAL,
    ) -> LPSMaterial:
        """Make an uncertified LPS of λ, μ [TPa] and this function to δ [Å], exact at the bonds of
        some spacings [Å]. Raises InputError as `coefficients`, and for numbers out of range."""
        of = checked("spacings", spacings, float, ("n",))
        lengths = np.concatenate([np.zeros(0), *(bond_classes(h, horizon).r for h in of)])
        D, departure = self.coefficients(lengths, horizon)
        kept = {"influence": self.record(departure)}
        return LPSMaterial(lam, mu, 0.0, D, horizon, provenance=kept, units=units)

    def record(self, departure: float) -> Values:
        """Provenance entry of an influence function, with its polynomial's departure."""
        values = atomic.plain(self.parameters)
        return {"function": self.name, "parameters": values, "departure": departure}


@typed
def gaussian(r: ndarray, width: Positive) -> ndarray:
    """Gaussian influence function exp(−(r/width)²), width [Å]."""
    return np.exp(-((checked("r", r) / width) ** 2))


@typed
def exponential(r: ndarray, length: Positive) -> ndarray:
    """Exponential influence function exp(−r/length), length [Å]."""
    return np.exp(-checked("r", r) / length)


@typed
def conical(r: ndarray, reach: Positive) -> ndarray:
    """Conical influence function 1 − r/reach out to the reach [Å], 0 beyond."""
    return np.maximum(1 - checked("r", r) / reach, 0.0)


NAMED = {"gaussian": gaussian, "exponential": exponential, "conical": conical}
"""Shapes with one length to learn."""


@typed
def named(name: str, horizon: Positive) -> InfluenceFunction:
    """An influence function of NAMED, its length from the horizon [Å] on, within a factor of 20."""
    if name not in NAMED:
        raise InputError(f"influence: expected {', '.join(NAMED)}, got {name!r}")
    function = NAMED[name]
    (length,) = list(inspect.signature(function).parameters)[1:]
    ends = (horizon / 20, 20 * horizon)
    return InfluenceFunction(function, {length: float(horizon)}, {length: ends})


@typed
def table(r: ArrayLike, K: ArrayLike, *, learned: bool = False) -> InfluenceFunction:
    """Piecewise linear influence function through values K [T] at rising distances r [Å], constant
    beyond the ends, where no bond may be; `learned` takes the values as parameters to learn."""
    knots, given = kept(checked("r", r)), kept(checked("K", K))
    if knots.ndim != 1 or len(knots) < 2 or knots.shape != given.shape:
        raise InputError(
            f"table: expected r and K of one shape [T], T ≥ 2, got {knots.shape}, {given.shape}"
        )
    if not (np.diff(knots) > 0).all():
        raise InputError("table: expected K at rising r")

    function = functools.partial(tabulated, knots=knots)
    if learned:
        return InfluenceFunction(function, {"K": given})
    return InfluenceFunction(functools.partial(function, K=given))


def tabulated(r: ndarray, K: ndarray, knots: ndarray) -> ndarray:
    """Piecewise linear K at distances r between its values at the knots."""
    return np.asarray(np.interp(r, knots, K))


def shapes_of(kernel: Any) -> list[InfluenceFunction]:
    """One influence function or several as a list; InputError for anything else."""
    shapes = list(kernel) if isinstance(kernel, (list, tuple)) else [kernel]
    if not shapes or not all(isinstance(shape, InfluenceFunction) for shape in shapes):
        raise InputError(
            "kernel: expected Bernstein(…), an InfluenceFunction or a list of them, got "
            f"{kernel!r:.60}; a function f(r, width) is InfluenceFunction(f, {{'width': 8.0}})"
        )
    return shapes
