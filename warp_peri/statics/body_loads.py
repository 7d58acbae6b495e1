"""What holds, pulls and loads a body, on the nodes of any of its elements."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import binary_dilation

from warp_peri.errors import InputError
from warp_peri.points.cells import pieces
from warp_peri.points.mesh import Mesh
from warp_peri.points.tetrahedra import Tetrahedra
from warp_peri.statics.rim import Field, Rim, Traction

FINE = 4
"""Places in a spacing, on either axis, where the density is read for a lattice."""


@dataclass(frozen=True)
class BodyLoads:
    """Displacement and traction by part of the outline, and a body force.

    Attributes:
        held: displacement [Å] as functions of positions; NaN leaves a component free.
        pulls: force per area [TPa] as functions of positions and outward normals.
        b: body force density [TPa/Å] as a function of positions; None for none.
    """

    held: Mapping[str, Field]
    pulls: Mapping[str, Traction]
    b: Field | None

    def on(self, rim: Rim) -> np.ndarray:
        """Load of tractions and the body force on the nodes of elements [TPa Å], shape [n, d]."""
        f = np.zeros_like(rim.x) if self.b is None else rim.body_force(self.b)
        for name, pull in self.pulls.items():
            f += rim.traction(name, pull)
        return f

    def density(self, x: np.ndarray, spacing: float) -> np.ndarray:
        """The body force density [TPa/Å] that nodes of a lattice feel, both of shape [n, d].

        Its mean around a node (B16), by weights that add up to one over the nodes and
        leave quadratic fields as they are: no force is lost between nodes, and what changes from
        triangle to triangle is not taken for a long wave. It is read up to 2.5 spacings away.

        x: along the axes, so that they lie on a lattice of the spacing [Å].
        """
        if self.b is None:
            return np.zeros_like(x)
        cells = np.rint((x - x.min(axis=0)) / spacing).astype(int) + 2
        d = x.shape[1]
        near = np.zeros(cells.max(axis=0) + 3, bool)
        near[tuple(cells.T)] = True
        near = binary_dilation(near, np.ones((5,) * d))
        places = np.argwhere(np.kron(near, np.ones((FINE,) * d, bool)))
        at = x.min(axis=0) + spacing * ((places + 0.5) / FINE - 2.5)
        fine = np.zeros((*(FINE * np.array(near.shape)), d))
        fine[tuple(places.T)] = self.b(at)
        s = np.abs((np.arange(5 * FINE) + 0.5) / FINE - 2.5)
        inner, outer = 1 + s**2 * (1.5 * s - 2.5), 2 - s * (4 - s * (2.5 - 0.5 * s))
        weight = np.where(s < 1, inner, np.where(s < 2, outer, 0.0)) / FINE
        felt, count = fine, np.array(near.shape) - 4
        for span in FINE * count:  # axis by axis, each to the end of the line when it is done
            felt = np.moveaxis(
                sum(w * felt[n : n + span : FINE] for n, w in enumerate(weight)), 0, d - 1
            )
        there: np.ndarray = felt[tuple((cells - 2).T)]
        return there

    def given(self, rim: Rim) -> tuple[np.ndarray, np.ndarray]:
        """Held displacements of the nodes of elements, and which they are, shape [n, d] each."""
        given, fixed = np.zeros_like(rim.x), np.zeros(rim.x.shape, bool)
        for name, values in self.held.items():
            nodes = rim.nodes_of(name)
            there = values(rim.x[nodes])
            known = np.isfinite(there)
            given[nodes] = np.where(known, there, given[nodes])
            fixed[nodes] |= known
        return given, fixed

    def refuse_loose(self, rim: Rim, fixed: np.ndarray) -> None:
        """Raise InputError when displacements that are fixed, [n, d], let a piece move rigidly."""
        piece = pieces(rim.mesh.cells)[rim.cells >= 0]
        for number in np.unique(piece):
            nodes = np.unique(rim.basis.element_dofs[:, piece == number])
            centred = rim.x[nodes] - rim.x[nodes].mean(axis=0)
            size = np.abs(centred).max()
            motions = [np.broadcast_to(v, centred.shape) for v in np.eye(rim.d)]
            for a, c in itertools.combinations(range(rim.d), 2):
                turn = np.zeros_like(centred)
                turn[:, a], turn[:, c] = -centred[:, c] / size, centred[:, a] / size
                motions.append(turn)
            held_motions = np.stack([motion[fixed[nodes]] for motion in motions], axis=1)
            if np.linalg.matrix_rank(held_motions, tol=1e-6) < len(motions):
                raise InputError(
                    "displacement: expected parts that hold the body against shifts and turns, got "
                    + (", ".join(self.held) or "none")
                    + (f"; the mesh is of {piece.max() + 1} pieces" if piece.max() else "")
                )


def loads_on(
    mesh: Mesh | Tetrahedra,
    displacement: Mapping[str, Field | ArrayLike],
    traction: Mapping[str, Traction | ArrayLike] | None,
    b: Field | None,
) -> BodyLoads:
    """Loads as functions, which raise InputError for other shapes and what is not finite.

    Raises InputError for a part that the mesh has not, or a body force that is no function.
    """
    for name in (*displacement, *(traction or {})):
        check_part(name, mesh)
    held = {
        name: _field(f"part '{name}'", value, free=True) for name, value in displacement.items()
    }
    pulls = {name: _field(f"part '{name}'", value) for name, value in (traction or {}).items()}
    if b is not None and not callable(b):
        raise InputError(f"b: expected a function of positions [n, 2], got {b!r:.60}")
    return BodyLoads(held, pulls, None if b is None else _field("b", b))


def check_part(name: str, mesh: Mesh | Tetrahedra) -> None:
    """Raise InputError unless the outline has a part of this name."""
    if name not in mesh.parts:
        raise InputError(f"part '{name}': the outline has {', '.join(sorted(mesh.parts))}")


def _field(name: str, value: Field | Traction | ArrayLike, *, free: bool = False) -> Any:
    """A value as a function that answers with finite vectors of the right shape.

    Args:
        name: of it in messages.
        value: vectors, or a function of positions, and of normals where it is a traction.
        free: NaN is taken, for a component that is not held.
    """

    def answer(*where: np.ndarray) -> np.ndarray:
        given = value(*where) if callable(value) else value
        try:
            vectors = np.asarray(given, dtype=float)
            vectors = np.broadcast_to(vectors, where[0].shape) if vectors.ndim else vectors
        except (TypeError, ValueError):
            vectors = np.empty(0)
        if vectors.shape != where[0].shape:
            raise InputError(
                f"{name}: expected vectors of shape {list(where[0].shape)}, got shape "
                f"{list(np.shape(given))}" + (f" ({given!r:.40})" if np.ndim(given) == 0 else "")
            )
        if not (np.isfinite(vectors) | (free & np.isnan(vectors))).all():
            raise InputError(f"{name}: expected finite numbers" + (" or NaN" if free else ""))
        return vectors

    return answer
