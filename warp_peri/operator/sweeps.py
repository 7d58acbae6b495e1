"""The Warp launches of the operator on one point set: influence → volume → dilatation → force."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from scipy.special import comb

from warp_peri.errors import InputError
from warp_peri.kernels.bonds import bonds
from warp_peri.kernels.lps import force as lps
from warp_peri.kernels.lps import influence as influence_kernels
from warp_peri.launch import DEVICE, floats, ints, known_device, launch, launch_slices, zeros
from warp_peri.models.influence import CANCELLED
from warp_peri.models.lps import Model
from warp_peri.points.families import families_of
from warp_peri.points.quadrature import DEGREE
from warp_peri.points.samples import PointsLike

PRECISIONS = {"float64": wp.float64, "float32": wp.float32}


@dataclass(frozen=True)
class State:
    """Arrays of one evaluation, in the precision of the sweeps.

    Attributes:
        kw, m: K W of each bond class [C] and weighted volume of each node [N], or of all nodes of a
            lattice [1], deviatoric.
        kd, md: those of the dilatation; the same arrays with one influence function.
        theta: dilatation of each sample and node, shape [S, N].
        Lu: L u on the interior nodes, shape [S, I] of vectors.
    """

    kw: wp.array[Any]
    m: wp.array[Any]
    kd: wp.array[Any]
    md: wp.array[Any]
    theta: wp.array[Any]
    Lu: wp.array[Any]


class Sweeps:
    """The Warp launches of (4)–(9) over the interior nodes of a point set.

    Args:
        points: a lattice, or scattered points (spacing 0). Bonds to nodes outside are broken, and
            the dilatation of nodes that had such bonds is corrected (theory.md, 40–41).
        horizon: δ [Å].
        bond_based: λ = μ without a dilatation (theory.md, 42).
        quadrature_degree: of the polynomials that the weights are exact for.
        precision: "float64" or "float32".
        device: where the arrays lie and the kernels run, as Warp names it: "cpu", "cuda:0". The
            families are found on the processor.

    Attributes:
        families: families of all nodes.
        rows: interior nodes, where forces are evaluated.
        full: nodes within δ of them, where dilatations are needed.
        links: the arrays that lead every kernel from a node to its bonds.

    Raises InputError for what families_of refuses, another precision, and an unknown device.
    """

    def __init__(
        self,
        points: PointsLike,
        horizon: float,
        *,
        bond_based: bool = False,
        quadrature_degree: int = DEGREE,
        precision: str = "float64",
        device: str = DEVICE,
    ) -> None:
        if precision not in PRECISIONS:
            raise InputError(f"precision: expected one of {list(PRECISIONS)}, got {precision!r}")
        self.scalar = PRECISIONS[precision]
        self.device = known_device(device)
        types = bonds(self.scalar)
        self.vec, self.mat = types.vec, types.mat
        self.kernels = lps.sweeps(self.scalar)
        self.families = families_of(
            points,
            horizon,
            bond_based=bond_based,
            degree=quadrature_degree,
        )
        families = self.families
        self.horizon, self.bond_based = float(horizon), bond_based
        self.rows, self.whole = self.ints(families.rows), self.ints(families.whole)
        self.cut = self.ints(families.cut)
        self.full = self.ints(np.sort(np.concatenate([families.whole, families.cut])))
        self.row, self.reverse = self.ints(families.row), self.ints(families.reverse)
        self.r, self.weight = self.floats(families.r), self.floats(families.weight)
        lattice = families.lattice
        bond_class = np.zeros(1) if lattice is None else lattice.bond_class
        pattern = np.ones((1, 2)) if lattice is None else families.pattern
        inverse_square = 1 / (pattern**2).sum(axis=1, keepdims=True)
        x = points.x if lattice is None else np.zeros((1, 2))
        box = points.box
        inverse = (0.0, 0.0) if box is None else (1 / box[0], 1 / box[1])
        self.lattice = int(lattice is not None)
        self._kept: dict[tuple[bytes, bytes], tuple[wp.array[Any], wp.array[Any]]] = {}
        self.links = (
            self.lattice,
            self.row,
            self.ints(families.neighbour),
            self.ints(bond_class),
            floats(np.hstack([pattern, inverse_square]), types.bond, self.device),
            floats(x, self.vec, self.device),
            types.box(*(self.scalar(value) for value in (*(box or (0.0, 0.0)), *inverse))),
        )

    @property
    def nodes(self) -> int:
        """Number of nodes N."""
        return len(self.row) - 1

    def floats(self, values: np.ndarray) -> wp.array[Any]:
        """A Warp array in the precision of the sweeps, where they run."""
        return floats(values, self.scalar, self.device)

    def ints(self, values: np.ndarray) -> wp.array[Any]:
        """A Warp array of int32, where the sweeps run."""
        return ints(values, self.device)

    def influence_inputs(self, degree: int) -> tuple[Any, ...]:
        """What the influence kernels of a degree read before α and D."""
        binomial = self.floats(comb(degree, np.arange(degree + 1)))
        return (self.scalar(self.horizon), binomial, self.r, self.weight)

    def influence(
        self, alpha: wp.array[Any], D: wp.array[Any], *, gradient: bool
    ) -> tuple[wp.array[Any], ...]:
        """K W of each class, shape [C], and weighted volumes m; kept while only u changes.

        m has shape [N], 0 where not needed; on a lattice shape [1], the same for all nodes.
        """
        degree = len(D) - 1
        key = (alpha.numpy().tobytes(), D.numpy().tobytes())
        if not gradient and key in self._kept:
            return self._kept[key]
        kw = self.zeros(len(self.r), gradient=gradient)
        volumes = 1 if self.lattice else self.nodes
        m = self.zeros(volumes, gradient=gradient)
        kernel = influence_kernels.influence(degree, self.scalar)
        table = (*self.influence_inputs(degree), alpha, D)
        lattice, row, _, bond_class, *_ = self.links
        inputs = (self.full, lattice, row, bond_class, self.r, kw)
        count = 1 if self.lattice else len(self.full)
        self._launch(gradient, kernel, len(self.r), table, kw)
        self._launch(gradient, self.kernels.weighted_volume, count, inputs, m)
        if not gradient:
            if len(self._kept) > 1:  # those of the last model: at most two functions
                self._kept.clear()
            self._kept[key] = kw, m
        return kw, m

    def check_volumes(self, model: Model) -> None:
        """Refuse an influence function whose weighted volume vanishes: the operator divides by it.

        Raises InputError saying how many nodes that concerns; on a lattice it is all of them.
        """
        families = self.families
        alpha = self.floats(np.array([model.alpha]))
        for D in {
            model.D.tobytes(): model.D,
            model.dilatation.tobytes(): model.dilatation,
        }.values():
            kw = self.influence(alpha, self.floats(D), gradient=False)[0].numpy()
            terms = kw * families.r**2
            if families.lattice is not None:
                terms = (families.lattice.count * terms)[None]
                m, size = terms.sum(axis=1), np.abs(terms).sum(axis=1)
            else:
                m = np.add.reduceat(terms, families.row[:-1])[self.full.numpy()]
                size = np.add.reduceat(np.abs(terms), families.row[:-1])[self.full.numpy()]
            bad = np.count_nonzero(~(np.abs(m) > CANCELLED * size))
            if bad:
                where = "every node" if families.lattice is not None else f"{bad} nodes"
                raise InputError(
                    f"influence function: its weighted volume m (theory.md, 5) is zero at {where}: "
                    f"positive and negative parts cancel to {np.abs(m).min() / size.max():.0e}"
                )

    def forget(self) -> None:
        """Drop K W and m of the last model, so that the next evaluation computes them anew."""
        self._kept.clear()

    def shape(self, kd: wp.array[Any], *, gradient: bool = False) -> wp.array[Any]:
        """S of the nodes with broken bonds, (40), shape [N]."""
        shape = self.zeros(self.nodes, dtype=self.mat, gradient=gradient)
        inputs = (self.cut, *self.links, kd)
        self._launch(gradient, self.kernels.surface_shape, len(self.cut), inputs, shape)
        return shape

    def evaluate(
        self,
        u: wp.array[Any],
        lam: wp.array[Any],
        mu: wp.array[Any],
        alpha: wp.array[Any],
        D: wp.array[Any],
        D_dilatation: wp.array[Any] | None = None,
        *,
        gradient: bool = False,
    ) -> State:
        """L u and all that led to it; with `gradient` for a tape, in one thread."""
        samples, nodes, kernels = u.shape[0], self.nodes, self.kernels
        inputs: tuple[Any, ...]
        kw, m = self.influence(alpha, D, gradient=gradient)
        kd, md = kw, m
        Lu = self.zeros(samples, len(self.rows), dtype=self.vec, gradient=gradient)
        if self.bond_based:
            inputs = (self.rows, *self.links, kw, m, mu, u)
            self._launch(gradient, kernels.bond_force, len(self.rows), inputs, Lu, samples)
            return State(kw, m, kd, md, self.zeros(samples, nodes), Lu)
        if D_dilatation is not None:
            kd, md = self.influence(alpha, D_dilatation, gradient=gradient)
        theta = self.zeros(samples, nodes, gradient=gradient)
        inputs = (self.whole, *self.links, kd, md, u)
        self._launch(gradient, kernels.dilatation, len(self.whole), inputs, theta, samples)
        if len(self.cut):
            shape = self.shape(kd, gradient=gradient)
            inputs = (self.cut, *self.links, kd, shape, u)
            self._launch(
                gradient, kernels.surface_dilatation, len(self.cut), inputs, theta, samples
            )
        inputs = (self.rows, *self.links, kw, m, kd, md, lam, mu, u, theta)
        self._launch(gradient, kernels.force, len(self.rows), inputs, Lu, samples)
        return State(kw, m, kd, md, theta, Lu)

    def force(self, *arrays: wp.array[Any], gradient: bool = False) -> wp.array[Any]:
        """L u [TPa/Å] on the interior nodes, shape [S, I]; on the active tape, with `gradient`.

        The arguments are those of `evaluate`.
        """
        return self.evaluate(*arrays, gradient=gradient).Lu

    def zeros(self, *shape: int, dtype: Any = None, gradient: bool = False) -> wp.array[Any]:
        """A Warp array of zeros."""
        dtype = dtype or self.scalar
        return zeros(*shape, dtype=dtype, gradient=gradient, device=self.device)

    @staticmethod
    def _launch(
        tape: bool,
        kernel: Any,
        count: int,
        inputs: tuple[Any, ...],
        output: wp.array[Any],
        samples: int = 0,
    ) -> None:
        if tape:
            launch(kernel, (samples, count) if samples else count, (0, *inputs), (output,))
        else:
            launch_slices(kernel, count, inputs, (output,), samples=samples)
