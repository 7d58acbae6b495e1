"""Forces of solids richer than a linear peridynamic one, for displacement fields on a lattice.

Every feature is the force that one number of a richer solid would add, at the interior nodes along
the lattice's own axes: shape [S, I, 2, F]. What is left after a fit is explained by them
(diagnosis.py).
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import null_space

from warp_peri.points.families import bond_classes
from warp_peri.points.lattice import lattice_steps
from warp_peri.points.samples import Samples
from warp_peri.regression.reduced import Features


class SheetFeatures:
    """Features of samples on a lattice.

    Args:
        samples: S fields on a lattice.
        horizon: δ [length].
        dilatation: whether the solid has one; its collar of 2δ bears bonds of bonds then.

    Attributes:
        axes: of the lattice as columns, shape [2, 2].
        place: of the interior nodes in the rectangle of the lattice, shape [I, 2].
    """

    def __init__(self, samples: Samples, horizon: float, *, dilatation: bool = True) -> None:
        steps, self.axes = lattice_steps(samples)
        classes = bond_classes(samples.spacing, horizon)
        pad = int(np.abs(classes.steps).max()) + 2
        shape = (*(steps.max(axis=0) + 1 + 2 * pad), 2)
        u = np.zeros((len(samples), *shape))
        place = steps + pad
        u[:, place[:, 0], place[:, 1]] = samples.u @ self.axes
        self.u, self.h = u, samples.spacing
        self.place = place[samples.interior]
        half = (classes.steps[:, 0] > 0) | ((classes.steps[:, 0] == 0) & (classes.steps[:, 1] > 0))
        self.steps, self.kind = classes.steps[half], classes.bond_class[half]
        self._samples, self._horizon, self._dilatation = samples, horizon, dilatation

    @property
    def largest_strain(self) -> float:
        """Largest entry of a strain at an interior node."""
        strain = self._strains()[1][:, self.place[:, 0], self.place[:, 1]]
        return float(np.abs(strain).max())

    def shifted(self, step: tuple[int, int] | np.ndarray) -> np.ndarray:
        """u at the nodes a step away, shape [S, I, 2]."""
        row, column = (self.place + step).T
        values: np.ndarray = self.u[:, row, column]
        return values

    def second(self, step: tuple[int, int] | np.ndarray) -> np.ndarray:
        """u(x + ξ) + u(x − ξ) − 2 u(x), shape [S, I, 2]."""
        away = np.asarray(step)
        bent: np.ndarray = self.shifted(away) + self.shifted(-away) - 2 * self.shifted((0, 0))
        return bent

    def orbits(self) -> np.ndarray:
        """Forces of unit bonds of each class, along the bonds and whole."""
        out = np.zeros((*self.shifted((0, 0)).shape, 2 * (self.kind.max() + 1)))
        for step, kind in zip(self.steps, self.kind):
            d, n = self.second(step), step / np.linalg.norm(step)
            out[..., 2 * kind] += (d @ n)[..., None] * n
            out[..., 2 * kind + 1] += d
        return out

    def kernels(self) -> np.ndarray:
        """What any influence function is made of, (14–17): bonds, and pairs of them through θ.

        Without a dilatation none beside the bonds' own.
        """
        if not self._dilatation:
            return self.orbits()
        forces = Features(self._samples, self._horizon)(self._samples.u)
        along: np.ndarray = np.einsum("sifa,ab->sibf", forces, self.axes)
        return along

    def hexagonal(self) -> np.ndarray:
        """Forces that turn by −4φ with the bond, of sums of classes that short waves alone see.

        A crystal with six axes has them beside those of an isotropic solid; its axes may have any
        angle. On the square's few directions a class by itself would be a stiffness of long waves
        that no such crystal has.
        """
        count = 2 * (self.kind.max() + 1)
        out, moments = np.zeros((*self.shifted((0, 0)).shape, count)), np.zeros((8, count))
        for step, kind in zip(self.steps, self.kind):
            d, angle = self.second(step), 4 * np.arctan2(step[1], step[0])
            c, s = np.cos(angle), np.sin(angle)
            out[..., 2 * kind] += d @ np.array([[c, -s], [-s, -c]])
            out[..., 2 * kind + 1] += d @ np.array([[s, c], [c, -s]])
            moments[:, 2 * kind] += np.outer(np.outer(step, step), [c, -s]).ravel()
            moments[:, 2 * kind + 1] += np.outer(np.outer(step, step), [s, c]).ravel()
        short: np.ndarray = out @ null_space(moments)
        return short

    def pairs(self) -> np.ndarray:
        """Unit bonds, each by itself, with every symmetric matrix."""
        parts = []
        for step in self.steps:
            d = self.second(step)
            zero = np.zeros_like(d[..., 0])
            parts += [
                np.stack([d[..., 0], zero], axis=-1),
                np.stack([zero, d[..., 1]], axis=-1),
                d[..., ::-1],
            ]
        return np.stack(parts, axis=-1)

    def constants(self) -> np.ndarray:
        """Forces of the six constants of a sheet without symmetry."""
        a, c = self.second((1, 0)), self.second((0, 1))
        d = (self.second((1, 1)) - self.second((1, -1))) / 4  # ∂₁∂₂ u h²
        zero, one, two = np.zeros_like(a[..., 0]), 0, 1
        forces = (
            (a[..., one], zero),
            (zero, c[..., two]),
            (d[..., two], d[..., one]),
            (c[..., one] + d[..., two], d[..., one] + a[..., two]),
            (2 * d[..., one] + a[..., two], a[..., one]),
            (c[..., two], c[..., one] + 2 * d[..., two]),
        )
        return np.stack([np.stack(force, axis=-1) for force in forces], axis=-1)

    def quadratic(self) -> np.ndarray:
        """Divergences of every stress that is a product of two gradients, 30 of them."""
        gradient = self._gradient()
        i, j = np.triu_indices(4)
        stress = gradient[..., i] * gradient[..., j]
        slopes = [self._slope(stress, axis) for axis in (1, 2)]
        zero = np.zeros_like(slopes[0])
        columns = [
            np.stack([slopes[0], zero], axis=2),
            np.stack([zero, slopes[1]], axis=2),
            np.stack([slopes[1], slopes[0]], axis=2),
        ]
        return np.concatenate(columns, axis=-1)

    def invariant(self) -> np.ndarray:
        """Divergences of the second-order stresses of a hexagonal sheet, 6 of them.

        With H = ∇u and the strain e + HᵗH/2 they are those of the two Lamé parameters under
        rotation, and of the four energies of third order: (tr e)³, tr e tr e², and the real and
        imaginary part of (e₁₁ − e₂₂ + 2i e₁₂)³, which has the six-fold axis at any angle. Five are
        independent: by Cayley and Hamilton the second is a sum of the first, third and fourth.
        """
        H, e, q = self._strains()
        turned = [first + H @ known for first, known in zip(_first(q), _first(e))]
        return self._forces([*turned, *_second(e, e)])

    def cubic(self) -> np.ndarray:
        """The same of third order, with the five energies of fourth order, 11 of them."""
        H, e, q = self._strains()
        turned = [H @ first for first in _first(q)]
        turned += [2 * mixed + H @ pure for mixed, pure in zip(_second(e, q), _second(e, e))]
        unit, trace, square = np.eye(2), _trace(e), _trace(e @ e)
        spin = _spin(e)[..., None, None]
        whole = [trace**3 * unit, trace * square * unit + trace**2 * e, square * e]
        whole += [
            part(spin**3) * unit + 3 * trace * known
            for part, known in zip((np.real, np.imag), _second(e, e)[2:])
        ]
        return self._forces([*turned, *whole])

    def local(self) -> np.ndarray:
        """Strains and second differences around each node, shape [S, I, 11]."""
        gradient = self._gradient()[:, self.place[:, 0], self.place[:, 1]]
        strain = np.stack(
            [gradient[..., 0], gradient[..., 3], gradient[..., 1] + gradient[..., 2]], axis=-1
        )
        seconds = [self.second(step) / self.h for step in ((1, 0), (0, 1), (1, 1), (1, -1))]
        return np.concatenate([strain, *seconds], axis=-1)

    def _gradient(self) -> np.ndarray:
        """∂u by central differences everywhere, entries 11, 12, 21, 22: [S, n₁, n₂, 4]."""
        u = self.u
        parts = [(np.roll(u, -1, axis) - np.roll(u, 1, axis)) / (2 * self.h) for axis in (1, 2)]
        return np.concatenate([parts[0], parts[1]], axis=-1)

    def _strains(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """H = ∇u, its symmetric part and HᵗH/2, shape [S, n₁, n₂, 2, 2]."""
        gradient = self._gradient()
        H = gradient.reshape(*gradient.shape[:-1], 2, 2).swapaxes(-1, -2)
        return H, (H + H.swapaxes(-1, -2)) / 2, H.swapaxes(-1, -2) @ H / 2

    def _forces(self, stresses: list[np.ndarray]) -> np.ndarray:
        """Divergences of stresses [S, n₁, n₂, 2, 2]."""
        forces = [self._slope(one[..., 0], 1) + self._slope(one[..., 1], 2) for one in stresses]
        return np.stack(forces, axis=-1)

    def _slope(self, field: np.ndarray, axis: int) -> np.ndarray:
        """Derivative of a field [S, n₁, n₂, …] along an axis at the interior nodes [S, I, …]."""
        by_steps = (np.roll(field, -1, axis) - np.roll(field, 1, axis)) / (2 * self.h)
        at_nodes: np.ndarray = by_steps[:, self.place[:, 0], self.place[:, 1]]
        return at_nodes


def _trace(a: np.ndarray) -> np.ndarray:
    """Of matrices in the last two axes, kept as axes of one."""
    trace: np.ndarray = np.trace(a, axis1=-2, axis2=-1)[..., None, None]
    return trace


def _spin(e: np.ndarray) -> np.ndarray:
    """e₁₁ − e₂₂ + 2i e₁₂, which turns twice as fast as the axes."""
    spin: np.ndarray = e[..., 0, 0] - e[..., 1, 1] + 2j * e[..., 0, 1]
    return spin


def _first(e: np.ndarray) -> list[np.ndarray]:
    """Stresses of (tr e)²/2 and tr e²."""
    return [_trace(e) * np.eye(2), 2 * e]


def _second(a: np.ndarray, b: np.ndarray) -> list[np.ndarray]:
    """Symmetric in both, and for a = b = e stresses of (tr e)³/3, tr e tr e² and Re, Im of z³/6,
    where z is the spin of e."""
    unit, z = np.eye(2), _spin(a) * _spin(b)
    spin = [
        np.stack([p, q, q, -p], axis=-1).reshape(a.shape)
        for p, q in ((z.real, -z.imag), (z.imag, z.real))
    ]
    both = _trace(a @ b) * unit + _trace(a) * b + _trace(b) * a
    return [_trace(a) * _trace(b) * unit, both, *spin]
