"""Settings of solvers, and the solution they return."""

from __future__ import annotations

import operator
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np
from numpy import ndarray
from numpy.linalg import norm

import warp_peri
from warp_peri.errors import InputError, Rows, Shown, StrPath, heard, warn
from warp_peri.points.arguments import Positive, Share, symbols, typed, typed_methods
from warp_peri.points.points import Points, Samples

if TYPE_CHECKING:
    from matplotlib.axes import Axes

TOLERANCE = 1e-8
"""Of iterative solves: true residual over right-hand side."""
Preconditioner = Literal["multigrid", "sine", "strip"]
"""Of conjugate gradients on lattices, by name."""


@typed
@dataclass(frozen=True)
class Direct:
    """Solver setting: a factorisation of the assembled operator.

    `solve` raises InputError for a singular operator.

    >>> wp.solve(model, wp.Dirichlet(points, None, 0.01 * x), solver=wp.Direct()).method
    'lu'
    """


@typed
@dataclass(frozen=True)
class CG:
    """Solver setting: conjugate gradients on a lattice.

    Attributes:
        preconditioner: "sine" for boxes of nodes, "multigrid" for any nodes, "strip" where λ ≫ μ;
            None chooses. On ranks "multigrid".
        tolerance: true residual over right-hand side.

    Raises InputError for another preconditioner, or a tolerance outside (0, 1).

    >>> wp.solve(model, wp.Dirichlet(points, None, 0.01 * x), solver=wp.CG("multigrid")).method
    'multigrid'
    """

    preconditioner: Preconditioner | None = None
    tolerance: Share = TOLERANCE


@typed
@dataclass(frozen=True)
class Newton:
    """Solver setting for nonlinear materials: repeated linear solves, then Newton's method.

    Attributes:
        tolerance: residual over the linear right-hand side.
        eigenvalues: whether the smallest eigenvalue of the tangent is asked for at each answer.

    Raises InputError for a tolerance outside (0, 1).

    >>> solution = wp.solve(third, wp.Dirichlet(points, None, 0.01 * x), solver=wp.Newton(1e-6))
    >>> solution.residual < 1e-6
    True
    """

    tolerance: Share = TOLERANCE
    eigenvalues: bool = False


@typed
@dataclass(frozen=True)
class Coupling:
    """Settings for coupling finite elements at the rim of a body with a lattice in its bulk.

    Attributes:
        spacing: of the bulk's lattice [Å]; None for the coarsest that resolves loads and body.
        overlap: width of what both solve for [Å]; None for 2δ, of a crystal four spacings.
        depth: least distance of the lattice's unknown nodes from the outline [Å]; None for as near
            as families are whole.
        degree: 2 for quadratic elements, curved at the outline; 1 for linear ones.
        tolerance: of the mismatch on the rim's inner side.

    Raises InputError for lengths that are not > 0, another degree, or a tolerance outside (0, 1).
    """

    spacing: Positive | None = None
    overlap: Positive | None = None
    depth: Positive | None = None
    degree: Literal[1, 2] = 2
    tolerance: Share = TOLERANCE


Solver: TypeAlias = Direct | CG | Newton | None


def refuse_solver(solver: Solver, known: tuple[type, ...], law: str) -> None:
    """Raise InputError for solver settings that a law does not take."""
    if solver is not None and not isinstance(solver, known):
        names = " or ".join(f"{kind.__name__}(…)" for kind in known) or "none"
        raise InputError(f"solver: expected {names} for {law}, got {solver!r:.60}")


@typed_methods
@dataclass(frozen=True, eq=False, repr=False)
class Solution(Shown):
    """A body in equilibrium: its displacement, and how it was found.

    Attributes:
        u: displacement [length] (of diffusion φ), shape as given: what was given on the collar, the
            answer on the interior; of a body on the corners of its mesh.
        points: the nodes; None for a body on a mesh.
        operator: the material on these points.
        load: what ``operator(u)`` equals in equilibrium, shape [..., I, d].
        method: that solved it.
        iterations: of each sample, as many as the method counts; 0 of a factorisation.
        proven: what is proven of the answer, in one sentence; None for nothing.
        warnings: what was said on the way.
        details: of this material or problem: records of the solver, elements and lattice of a body.
        measured: the relative residual, where the method finds it itself.

    Its `stress` and `energy` raise InputError where the material has none.

    >>> wp.solve(model, wp.Dirichlet(points, b[0], u[0])).stress().shape
    (121, 2, 2)
    """

    u: Any
    points: Points | None
    operator: Any
    load: Any
    method: str
    iterations: tuple[int, ...] = ()
    proven: str | None = None
    warnings: tuple[str, ...] = ()
    details: Any = None
    measured: float | None = None

    @property
    def residual(self) -> float:
        """Largest relative residual ‖op(u) − load‖ / ‖load − op(u of the collar alone)‖."""
        if self.measured is not None:
            return self.measured
        if self.points is None:
            raise InputError("residual: expected points, whose residual is asked for")
        u, inside = self._values.astype(float), self.points.interior
        if not u.size:  # of no samples
            return 0.0
        held = np.where(inside if u.shape[-1] == len(inside) else inside[:, None], 0.0, u)
        rows = len(self.load) if self.load.ndim == 3 else 1
        off = (self.load - self.operator(one) for one in (u, held))
        left, right = (norm(np.reshape(one, (rows, -1)), axis=1) for one in off)
        return float(np.max(np.divide(left, right, out=np.zeros_like(left), where=right > 0)))

    def stress(self) -> ndarray:
        """Stress σ at the interior nodes, [..., I, d, d]; of a body at the mesh's corners."""
        if self.points is None:
            return np.asarray(self.details.on_corners()[1])
        stress = self.operator.stress(self._values)
        if stress is None:
            raise InputError("stress: this model has none")
        return np.asarray(stress)

    def energy(self) -> ndarray:
        """Potential of the internal forces, as the operator's `energy`: of most laws up to what the
        collar alone has, so that it may be below zero, and differs with other collars."""
        energy = None if self.points is None else self.operator.energy(self._values)
        if energy is None:
            raise InputError("energy: this model has none")
        return np.asarray(energy)

    def at(self, x: ndarray) -> ndarray:
        """Displacement at positions of a meshed body, both [m, d]; InputError for lattices."""
        if not hasattr(self.details, "displacement"):
            raise InputError("at: only of bodies on meshes; u holds the values at the nodes")
        return np.asarray(self.details.displacement(x))

    def to_samples(self) -> Samples:
        """Samples of displacement and load; InputError for a body on a mesh, or no displacement."""
        if self.points is None or self._values.shape[-2:] != self.points.x.shape:
            raise InputError("to_samples: expected displacements on nodes, got another solution")
        shape = (-1, *self.points.x.shape)
        load = self.operator.on_all(np.asarray(self.load))
        return Samples(self.points, self._values.reshape(shape), load.reshape(shape))

    def to_vtk(self, path: StrPath) -> None:
        """Write the fields for ParaView: a folder with a file a sample; of a body one .vtu file.
        Fields that the operator has not, as the stress of a cracked body, are left out. InputError
        as export.write_vtk, export.write_body and `to_samples`."""
        if self.points is None:
            warp_peri.export.write_body(path, self.details)
        else:
            samples = self.to_samples()
            warp_peri.export.write_vtk(path, self.operator, samples, samples.u)

    def plot(self, sample: int = 0, *, ax: Axes | None = None) -> Axes:
        """Plot the size of the displacement, or φ, of a sample by node colours (3D: a slice)."""
        u, several = self._values, 1
        import matplotlib.pyplot as plt

        if self.points is None:
            x, unit = self.details.rim.mesh.x, symbols(self.details.model.units)[0]
        else:
            x, unit = self.points.x, symbols(self.points.units)[0]
        if u.ndim == 3 or (u.ndim == 2 and u.shape != x.shape):
            several = len(u)
            try:
                u = u[operator.index(sample)]
            except (IndexError, TypeError):
                raise InputError(f"sample: expected one of {several}, got {sample!r:.60}") from None
        if x.shape[1] == 3:
            away = np.abs(x[:, 2] - np.median(x[:, 2]))
            kept = away <= away.min() + 1e-9 * np.ptp(x)
            x, u = x[kept], u[kept]
        ax = plt.figure(layout="constrained").add_subplot() if ax is None else ax
        size = u if u.ndim == 1 else norm(u, axis=1)
        shown = ax.scatter(x[:, 0], x[:, 1], c=size, s=9, linewidths=0)
        ax.figure.colorbar(shown, ax=ax, label="φ" if u.ndim == 1 else f"|u| [{unit}]")
        ax.set(aspect="equal", xlabel=f"x [{unit}]", ylabel=f"y [{unit}]")
        if several > 1:
            ax.set(title=f"load {sample % several} of 0 to {several - 1}")
        return ax

    @property
    def _values(self) -> ndarray:
        """Displacement as a NumPy array; InputError for a rank's piece of one."""
        if hasattr(self.points, "comm"):
            raise InputError("solution: stress, energy, samples and plots are not had on ranks")
        return np.asarray(self.u.detach().cpu() if hasattr(self.u, "detach") else self.u)

    def rows(self) -> Rows:
        """Name and value of each line of the solution's summary table."""
        lines = [("displacement", f"shape {list(self.u.shape)}"), ("solved by", self.method)]
        if any(self.iterations):
            lines.append(("iterations", f"{max(self.iterations)} at most"))
        lines += [("residual", f"{self.residual:.1e}"), ("proven", self.proven or "nothing")]
        return lines + [("warning", text) for text in self.warnings]


def told(solved: Callable[[], Solution]) -> Solution:
    """Call `solved`; returns its solution with the warnings on the way."""
    with heard() as texts:
        solution = solved()
    return replace(solution, warnings=tuple(dict.fromkeys(texts))) if texts else solution


def by_sample(
    operator: Any, u: Any, load: Any, records: Any, method: str, proven: str | None = None
) -> Solution:
    """Solution of samples solved in turn; details are `records`, with residuals and iterations."""
    measured = max((one.residual for one in records), default=None)
    counts = tuple(one.iterations for one in records)
    of = operator.points, operator, load, method, counts, proven
    return Solution(u, *of, details=tuple(records), measured=measured)


BEYOND = 2.0
"""Strains above this many times those of the training data are worth a warning."""


def warn_beyond(model: Any, strain: Callable[[], float]) -> None:
    """Warn when a solution is strained far beyond the training data; `strain` computes it."""
    known = model.trained_strain
    if known is not None and (largest := strain()) > BEYOND * known:
        warn(
            f"strain: the solution reaches {100 * largest:.2g} %, the training data "
            f"{100 * known:.2g} %: the model is linear and knows nothing of what "
            "comes beyond"
        )
