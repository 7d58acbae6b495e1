"""What a rank feels of other ranks' nodes: lists of nodes (of boxes: ranks.tiles)."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from warp_peri.points.points import Points
from warp_peri.points.strain import largest_strain

if TYPE_CHECKING:
    from warp_peri.ranks.pieces import Piece


NEAREST = 4.0
"""Mean spacings of scattered points within which a node has its nearest neighbours."""


class NodeHalo:
    """Nodes of other ranks in the boxes around a piece.

    The nodes here are the piece's own and theirs, in the order of the whole body: sums over
    neighbours then have the same bits on any rank.

    Args:
        piece: the nodes that this rank owns.
        reach: how far it feels [length].

    Attributes:
        number: of all nodes here in the whole body, rising, shape [m].
        x: their positions, shape [m, d].
        own: places of the piece's own among them, shape [n].
        count: nodes of the whole body.
        sent: bytes of one exchange of vectors that this rank sends.
    """

    def __init__(self, piece: Piece, reach: float) -> None:
        self.piece, self.count = piece, piece.count
        comm, slack = piece.comm, 1e-6 * piece.spacing
        low, high = piece.x.min(axis=0) - reach - slack, piece.x.max(axis=0) + reach + slack
        boxes = comm.allgather((low, high))
        given = [np.zeros(0, np.int64)] * comm.size
        for rank, (low, high) in enumerate(boxes):
            if rank != comm.rank:
                given[rank] = np.flatnonzero(((piece.x >= low) & (piece.x <= high)).all(axis=1))
        taken = comm.alltoall([(piece.number[nodes], piece.x[nodes]) for nodes in given])
        number = np.concatenate([piece.number, *[numbers for numbers, _ in taken]])
        order = np.argsort(number)
        self.number = number[order]
        self.x = np.concatenate([piece.x, *[x for _, x in taken]])[order]
        self.own = np.searchsorted(self.number, piece.number)
        ranks = range(comm.size)
        self._give = [(r, self.own[given[r]]) for r in ranks if len(given[r])]
        self._take = [
            (r, np.searchsorted(self.number, taken[r][0])) for r in ranks if len(taken[r][0])
        ]
        self.comm, d = comm, piece.dimension
        self.sent = 8 * d * sum(len(places) for _, places in self._give)
        self._out = [np.empty((len(places), d)) for _, places in self._give]
        self._in = [np.empty((len(places), d)) for _, places in self._take]

    @property
    def is_own(self) -> np.ndarray:
        """Which of the nodes here are the piece's own, shape [m]."""
        return np.isin(np.arange(len(self.number)), self.own)

    def sum(self, values: np.ndarray) -> np.ndarray:
        """Of values [k, ...] over all ranks, shape [...]."""
        return self.piece.sum(values)

    def gather(self, values: np.ndarray) -> np.ndarray:
        """Values [n, ...] of the own nodes on all of the whole body, on every rank."""
        return self.piece.gather(values)

    def mark(self, *parts: Any) -> str:
        """As Piece.mark, of arrays [m or more, ...] on the nodes here."""
        own = [part[self.own] if isinstance(part, np.ndarray) else part for part in parts]
        return self.piece.mark(*own)

    def start(self, field: np.ndarray) -> Callable[[], None]:
        """Send for others' nodes in a field of vectors [m or more, d]; what fills them in it."""
        from mpi4py import MPI

        comm = self.comm
        requests = [comm.Irecv(b, source=r) for (r, _), b in zip(self._take, self._in)]
        for (rank, places), buffer in zip(self._give, self._out):
            np.take(field, places, axis=0, out=buffer)
            requests.append(comm.Isend(buffer, dest=rank))

        def finish() -> None:
            MPI.Request.Waitall(requests)
            for (_, places), buffer in zip(self._take, self._in):
                field[places] = buffer

        return finish

    def exchange(self, field: np.ndarray) -> None:
        """Fill others' nodes in a field of vectors [m or more, d] from their owners."""
        self.start(field)()

    def around(self, values: np.ndarray) -> np.ndarray:
        """Values [n, ...] of the piece's own nodes on all nodes here, [m, ...]."""
        values = np.asarray(values)
        here = np.zeros((len(self.number), *values.shape[1:]), values.dtype)
        here[self.own] = values
        requests = [self.comm.isend(here[places], dest=r) for r, places in self._give]
        for r, places in self._take:
            here[places] = self.comm.recv(source=r)
        for request in requests:
            request.wait()
        return here

    def largest(self, values: np.ndarray) -> np.ndarray:
        """Of numbers [m] that ranks have of the same node the largest, of the own nodes, [n]."""
        found = values.copy()
        requests = [self.comm.isend(values[places], dest=r) for r, places in self._take]
        for r, places in self._give:
            found[places] = np.maximum(found[places], self.comm.recv(source=r))
        for request in requests:
            request.wait()
        return np.asarray(found[self.own])


def strain_on_ranks(piece: Piece, u: np.ndarray) -> float:
    """As points.strain.largest_strain, of u [n, d] of a piece, over all ranks."""
    halo = NodeHalo(piece, piece.spacing or NEAREST * piece.carrier)
    field = np.zeros_like(halo.x)
    field[halo.own] = u
    halo.exchange(field)
    here = Points(halo.x, np.ones(len(field), bool), piece.spacing)
    return float(max(piece.comm.allgather(largest_strain(here, field, halo.own))))
