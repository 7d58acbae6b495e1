"""Scattered points through a certified lattice; strains beyond what was trained."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import eigsh

from warp_peri.errors import InputError
from warp_peri.lps.matrices import matrices
from warp_peri.lps.model import Model
from warp_peri.points.interpolation import NEIGHBOURS
from warp_peri.points.lattice import largest_strain
from warp_peri.points.samples import PointsLike
from warp_peri.statics.direct import MatrixProblem
from warp_peri.transfer.carrier import Carrier

BEYOND = 2.0
"""Strains above this many times those of the training data are worth a warning."""


def warn_beyond(model: Model, strain: Callable[[], float]) -> None:
    """Warn when a solution is strained far beyond the data that the model was trained on.

    Args:
        model: that may know the strain of these data.
        strain: the solution's largest, worked out where it is needed.
    """
    if model.trained_strain is None:
        return
    largest = strain()
    if largest > BEYOND * model.trained_strain:
        warnings.warn(
            f"strain: the solution reaches {100 * largest:.2g} %, the training data "
            f"{100 * model.trained_strain:.2g} %: the model is linear and knows nothing of what "
            "comes beyond",
            stacklevel=3,
        )


@dataclass(frozen=True)
class ScatteredFigures:
    """What holds of an operator on scattered points.

    Attributes:
        asymmetry: largest |A − Aᵗ| over largest |A|.
        smallest_eigenvalue: of A [TPa/Å²]; above zero by the certificate of the lattice.
        smallest_singular_value: of T on the unknown nodes.
        condition: of A.
        entries: of A in a row, on average.
    """

    asymmetry: float
    smallest_eigenvalue: float
    smallest_singular_value: float
    condition: float
    entries: float


class ThroughLattice(Carrier):
    """The operator of a model on scattered points, A = Tᵗ L T (M7).

    A is assembled, to be solved with. It is symmetric, and positive definite because L is. The
    arguments, attributes and errors are those of Carrier, which is T. With a `carrier` of these
    points T is that one's, and the model is taken as it is.
    """

    def __init__(
        self,
        model: Model,
        points: PointsLike,
        *,
        spacing: float | None = None,
        neighbours: int = NEIGHBOURS,
        carrier: Carrier | None = None,
    ) -> None:
        if carrier is None:
            super().__init__(model, points, spacing=spacing, neighbours=neighbours)
        else:
            vars(self).update(vars(carrier) | {"model": model})
        L = matrices(self.model, self.lattice).operator(self.model.lam, self.model.mu)
        both = sp.identity(2, format="csr")
        test = sp.csr_array(sp.kron(self.unknown, both)).T
        A = sp.csr_array(test @ (L @ sp.csr_array(sp.kron(self.T, both))))
        self.problem = MatrixProblem(A, points.interior)
        self._A = A

    def __call__(self, u: np.ndarray) -> np.ndarray:
        """A u on the interior nodes [TPa/Å], of u [Å] of shape [S, N, 2]: shape [S, I, 2].

        Raises InputError for another shape.
        """
        self._check(u)
        flat = u.reshape(len(u), -1).T
        return np.asarray((self._A @ flat).T.reshape(len(u), -1, 2))

    def solve(self, b: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Displacement [Å], shape [S, N, 2]: u on the collar, the solution elsewhere.

        Args:
            b: as for `load`.
            u: [Å], shape [S, N, 2]; only collar values count.

        Raises InputError for other shapes.
        """
        self._check(u)
        right = np.zeros(u.shape)
        right[:, self.points.interior] = self.load(b)
        answer = self.problem.solve(right, u)
        warn_beyond(self.model, lambda: largest_strain(self.points, answer))
        return answer

    def _check(self, u: np.ndarray) -> None:
        shape = len(self.points.x), 2
        if u.ndim != 3 or u.shape[1:] != shape:
            raise InputError(f"u: expected shape [S, {shape[0]}, 2], got {list(u.shape)}")

    def figures(self) -> ScatteredFigures:
        """What holds of the operator, computed."""
        A = self.problem.stiffness
        size = abs(A).max()
        largest = float(eigsh(A, 1, which="LA", return_eigenvectors=False)[0])
        smallest = float(eigsh(A, 1, sigma=0, which="LM", return_eigenvectors=False)[0])
        return ScatteredFigures(
            asymmetry=float(abs(A - A.T).max() / size),
            smallest_eigenvalue=smallest,
            smallest_singular_value=self._smallest_singular_value(),
            condition=largest / smallest,
            entries=A.nnz / A.shape[0],
        )

    def _smallest_singular_value(self) -> float:
        gram = sp.csc_array(self.unknown.T @ self.unknown)
        if gram.shape[0] < 20:
            return float(np.sqrt(max(np.linalg.eigvalsh(gram.toarray())[0], 0.0)))
        square = eigsh(gram, 1, sigma=0, which="LM", return_eigenvectors=False)[0]
        return float(np.sqrt(max(square, 0.0)))
