"""Rivals for displacement-driven learning: named energies in finite elements on the same frames.

Each energy is fitted like the learned solid: least squares of the solved displacement over the
training frames. Its elements take displacement on one ring of nodes around the interior.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import spsolve

from tools.hyperelastic_elements import Elements, NotSolved, finite_elements
from tools.hyperelastic_energies import Energy, Family, Fung, Invariants, ensemble, plane_stress_hgo
from warp_peri import InputError, Samples


@dataclass(frozen=True)
class Uneven:
    """A sheet whose thickness varies: exp(a·p), p = x, y, x², y² from −1 to 1 over the window."""

    energy: Energy
    numbers: np.ndarray


class Window:
    """Bilinear elements on the interior of the frames and one ring of nodes around it."""

    def __init__(self, frames: Samples) -> None:
        skfem = finite_elements()
        steps = np.rint((frames.x - frames.x.min(axis=0)) / frames.spacing).astype(int)
        inner = steps[frames.interior]
        low, high = inner.min(axis=0), inner.max(axis=0)
        if len(inner) != np.prod(high - low + 1):
            raise InputError("frames: the rivals' elements need a rectangle of interior nodes")
        lines = [frames.spacing * np.arange(a - 1, b + 2) for a, b in zip(low, high)]
        self.mesh = Elements(skfem.MeshQuad.init_tensor(*lines), skfem.ElementQuad1(), order=3)
        number = {tuple(step): n for n, step in enumerate(steps.tolist())}
        places = np.rint(self.mesh.x / frames.spacing).astype(int).tolist()
        self.nodes = np.array([number[tuple(place)] for place in places])
        self.free = frames.interior[self.nodes]
        place = self.mesh.quadrature / (0.5 * np.ptp(self.mesh.x, axis=0)) - 1
        self.powers = np.concatenate([place, place**2], axis=-1)
        self.areas = self.mesh.dx
        fixed = np.flatnonzero(~self.free)
        self.fixed = np.sort(np.concatenate([2 * fixed, 2 * fixed + 1]))

    def solve(
        self, sheet: Energy | Uneven, u: np.ndarray, near: np.ndarray | None = None
    ) -> np.ndarray | None:
        """Displacement of the interior from that of the ring, [I, 2]; None where not found.

        The search begins at the displacement `near` of the interior, at that of u where none is.
        """
        if isinstance(sheet, Uneven):
            energy, thickness = sheet.energy, np.exp(self.powers @ sheet.numbers)
        else:
            energy, thickness = sheet, np.ones(())
        self.mesh.dx = self.areas * thickness
        given = u[self.nodes].ravel()
        nothing = np.zeros_like(given)
        start = u[self.nodes]
        if near is not None:
            start[self.free] = near
        for steps in (1, 8):
            try:
                field = self.mesh.solve(
                    energy, nothing, self.fixed, given[self.fixed],
                    start=start.ravel() if steps == 1 else None, steps=steps, tolerance=1e-8,
                )  # fmt: skip
            except (NotSolved, RuntimeError):  # or a singular matrix
                continue
            return field.reshape(-1, 2)[self.free]
        return None

    def errors(self, sheet: Energy | Uneven, frames: Samples, truth: np.ndarray) -> np.ndarray:
        """Relative errors against the truth, NaN where not solved, shape [S]."""
        errors = []
        for u, expected in zip(frames.u, truth):
            solved, target = self.solve(sheet, u), expected[self.nodes][self.free]
            gap = np.nan if solved is None else np.linalg.norm(solved - target)
            errors.append(gap / np.linalg.norm(target))
        return np.array(errors)


def neo_hookean(_: np.ndarray) -> Energy:
    return plane_stress_hgo(1.0)


def uneven(x: np.ndarray) -> Uneven:
    return Uneven(plane_stress_hgo(1.0), x)


def one_family(x: np.ndarray) -> Energy:
    return plane_stress_hgo(1.0, [Family(x[2], abs(x[0]), abs(x[1]))])


def two_families(x: np.ndarray) -> Energy:
    return plane_stress_hgo(
        1.0, [Family(x[2] + sign * x[3], abs(x[0]), abs(x[1])) for sign in (1, -1)]
    )


def invariants(x: np.ndarray) -> Energy:
    return Invariants(1.0, abs(x[0]), abs(x[1]) + 1e-3, [Family(x[4], abs(x[2]), abs(x[3]))])


def structure(x: np.ndarray) -> Energy:
    return plane_stress_hgo(1.0, ensemble(x[0], x[1], abs(x[2]), abs(x[3])))


ANYWHERE = np.random.default_rng(0).uniform((-1, -1, 0, -1, -1.5), (1, 1, 2.5, 1.5, 1.5), (10, 5))
"""More starts of the invariant-based sheet, whose fits end in different places."""

RIVALS: dict[str, tuple[Callable[[np.ndarray], Energy | Uneven], Sequence[Sequence[float]]]] = {
    "neo-Hookean": (neo_hookean, [[]]),
    "Fung": (
        lambda x: Fung(x.tolist()),
        [[1.0, 1.0, 0.3, 0.5, -0.2, -0.2], [1.0, 1.0, 0.3, 0.5, 0.2, 0.2]],
    ),
    "HGO, one fibre direction": (one_family, [[1.5, 1.0, -0.7], [1.5, 1.0, 0.7]]),
    "HGO, two fibre directions": (two_families, [[1.0, 1.0, -0.6, 0.5], [1.0, 1.0, 0.6, 0.5]]),
    "invariant-based": (
        invariants,
        [[0.5, 0.5, 1.5, 1.0, -0.7], [0.5, 0.5, 1.5, 1.0, 0.7], *ANYWHERE],
    ),
    "structure-informed": (structure, [[-0.7, 0.4, 2.0, 1.0], [0.7, 0.4, 2.0, 1.0]]),
    "neo-Hookean, uneven": (uneven, [[0.0, 0.0, 0.0, 0.0]]),
}
"""Energies by their numbers, and where the fits begin; the best of a rival's starts counts."""


def fit(
    window: Window,
    make: Callable[[np.ndarray], Energy | Uneven],
    start: np.ndarray,
    frames: Samples,
    *,
    most_steps: int = 12,
) -> tuple[np.ndarray, float]:
    """Levenberg and Marquardt with differences: numbers and root mean square of the errors."""

    truth = [u[window.nodes][window.free] for u in frames.u]
    size = np.array([np.linalg.norm(u) for u in truth])[:, None, None]

    def fields(x: np.ndarray, near: np.ndarray | None) -> np.ndarray | None:
        solved = []
        for n, u in enumerate(frames.u):
            field = window.solve(make(x), u, None if near is None else near[n])
            if field is None:
                return None
            solved.append(field)
        return np.array(solved)

    def gaps(fields: np.ndarray) -> np.ndarray:
        return ((fields - truth) / size).ravel()

    x, now, damping = start, fields(start, None), 1e-3
    if now is None:
        return x, np.inf
    left = gaps(now)
    for _ in range(most_steps if len(x) else 0):
        columns = []
        for n in range(len(x)):
            step = 1e-3 * max(abs(x[n]), 0.1)
            moved = fields(x + step * np.eye(len(x))[n], now)
            columns.append(np.zeros_like(left) if moved is None else (gaps(moved) - left) / step)
        J = np.stack(columns, axis=1)
        square = J.T @ J
        better = None
        while damping < 1e4:
            move = np.linalg.solve(square + damping * np.diag(np.diag(square) + 1e-12), -J.T @ left)
            better = fields(x + move, now)
            if better is not None and gaps(better) @ gaps(better) < left @ left:
                break
            better, damping = None, 10 * damping
        if better is None:
            break
        gain = 1 - (gaps(better) @ gaps(better)) / (left @ left)
        x, now, left, damping = x + move, better, gaps(better), damping / 10
        if gain < 1e-3:
            break
    return x, float(np.sqrt(left @ left / len(frames.u)))


def rival_errors(
    train: Samples, test: Samples, truth: np.ndarray, names: Sequence[str] = tuple(RIVALS)
) -> dict[str, dict[str, Any]]:
    """Held-out errors of the rivals, with their numbers and errors on the training frames."""
    window = Window(train)
    report = {}
    for name in names:
        make, starts = RIVALS[name]
        x, trained = min(
            (fit(window, make, np.array(start), train) for start in starts), key=lambda f: f[1]
        )
        errors = window.errors(make(x), test, truth)
        report[name] = {
            "numbers": x,
            "train": trained,
            "held out": float(np.nanmean(errors)),
            "not_solved": int(np.isnan(errors).sum()),
            "frames": errors,
        }
    return report


def interpolated_errors(test: Samples, truth: np.ndarray) -> dict[str, Any]:
    """Errors of the biharmonic interpolation of the collar: no number and no material.

    It reads displacement and slope on the rim of the interior, as a nonlocal solid does. What does
    not beat it has shown nothing about the material.
    """
    steps = np.rint((test.x - test.x.min(axis=0)) / test.spacing).astype(int)
    size = steps.max(axis=0) + 1
    second = [sp.diags([1.0, -2.0, 1.0], [-1, 0, 1], (n, n)) for n in size]
    laplacian = sp.kronsum(second[1], second[0], format="csr")
    nodes = steps @ [size[1], 1]
    inner, collar = nodes[test.interior], nodes[~test.interior]
    rows = (laplacian @ laplacian)[inner]
    errors = []
    for u, expected in zip(test.u, truth):
        filled = spsolve(rows[:, inner].tocsc(), -(rows[:, collar] @ u[~test.interior]))
        target = expected[test.interior]
        errors.append(np.linalg.norm(filled - target) / np.linalg.norm(target))
    return {"held out": float(np.mean(errors)), "not_solved": 0, "frames": np.array(errors)}
