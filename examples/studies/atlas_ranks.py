"""What goes wrong where a solve is spread over ranks: a filter that is cut off, blocks alone."""

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

import warp_peri as wp
from examples.figures import curves, panels
from examples.studies.atlas_entry import Entry, entry
from warp_peri.ranks.multigrid import bartlett, cut, folded, hann, short_inverse, smallest
from warp_peri.statics.conjugate_gradients import Inner, definite

MODEL = Path(__file__).parent.parent.parent / "tools" / "solve_model.json"
WIDTHS = (4, 8, 12, 16, 24, 32, 48)
BLOCKS = (1, 2, 4, 8)
SIDE = 48
"""Nodes along the plate that is solved in blocks."""
ARRAYS = Inner(
    lambda a, b: float(np.vdot(a, b)),
    lambda a: float(np.linalg.norm(a)),
    lambda a: float(np.abs(a).max()),
    lambda u, step, p: np.add(u, step * p, out=u),
)


def filters() -> Entry:
    """The smallest eigenvalue of cut filters, and iterations by the number of blocks."""
    law = wp.micromodulus.tensors_of(wp.load(MODEL), 5.0)
    tensors = law.tensors * law.spacing**2
    windows: dict[str, Callable[[np.ndarray], np.ndarray]] = {
        "none": lambda away: 0 * away + 1,
        "Hann": hann,
        "Bartlett": bartlett,
    }
    least: dict[str, list[float]] = {name: [] for name in windows}
    for width in WIDTHS:
        torus, kernel = short_inverse(law.steps, tensors, law.tensor(), width)
        largest = float(np.abs(folded(kernel, torus)).max())
        for name, window in windows.items():
            least[name].append(smallest(folded(cut(kernel, window), torus)) / largest)
    counts = [in_blocks(law, blocks) for blocks in BLOCKS]
    worst = int(np.argmin(least["none"]))
    figure, (left, right) = panels(8, 3.6, count=2)
    axes = {"xlabel": "reach of the filter [nodes]", "ylabel": "smallest eigenvalue over largest"}
    rows = {f"window: {name}": row for name, row in least.items()}
    curves(left, "plot", WIDTHS, rows, "o-", **axes)
    left.axhline(0, color="0.6", linewidth=0.8)
    left.set_yscale("symlog", linthresh=1e-3)
    right.plot(BLOCKS, counts, "o-")
    right.set(xlabel="blocks that are inverted alone", ylabel="iterations", ylim=(0, None))
    numbers = {
        "least": least["none"][worst], "width": WIDTHS[worst], "hann": min(least["Hann"]),
        "counts": " → ".join(map(str, counts)), "blocks": ", ".join(map(str, BLOCKS)),
    }  # fmt: skip
    values = {"width": WIDTHS, "smallest": least, "blocks": BLOCKS, "iterations": counts}
    return entry("ranks", numbers, (lambda: cut_off(law, WIDTHS[worst]),), figure, values)


def in_blocks(law, blocks: int) -> int:
    """Iterations where each block of rows inverts its own part of L, and nothing else is done."""
    matrix = plate(law)
    ends = np.arange(blocks + 1) * SIDE // blocks * SIDE * 2
    parts = [splu(sp.csc_array(matrix[a:b, a:b])) for a, b in pairwise(ends)]

    def precondition(r: np.ndarray) -> np.ndarray:
        return np.concatenate([p.solve(r[a:b]) for p, a, b in zip(parts, ends[:-1], ends[1:])])

    load = np.random.default_rng(0).normal(size=matrix.shape[0])
    return definite(lambda p: matrix @ p, precondition, load, 1e-8, inner=ARRAYS)[1].iterations


def plate(law) -> sp.csr_array:
    """L on a square of nodes, its collar held."""
    collar = int(np.abs(law.steps).max())
    x = np.argwhere(np.ones((SIDE + 2 * collar,) * 2)) - collar
    inside = ((x >= 0) & (x < SIDE)).all(axis=1)
    points = wp.Points(law.spacing * x, np.asarray(inside), law.spacing)
    columns = np.flatnonzero(np.repeat(inside, 2))
    return sp.csr_array(law.on(points).matrix().tocsc()[:, columns])


def cut_off(law, width: int) -> None:
    """Conjugate gradients with a filter that is cut without a window."""
    matrix = plate(law)
    tensors = law.tensors * law.spacing**2
    kernel = short_inverse(law.steps, tensors, law.tensor(), width)[1]
    torus = (2 * SIDE,) * 2 if SIDE > 2 * width else (4 * width + SIDE,) * 2
    (d11, d12, d22), wave = folded(kernel, torus), np.fft.rfft2

    def precondition(r: np.ndarray) -> np.ndarray:
        first, second = (wave(field, s=torus) for field in r.reshape(SIDE, SIDE, 2).T)
        pair = np.stack([d11 * first + d12 * second, d12 * first + d22 * second])
        return np.fft.irfft2(pair, s=torus)[:, :SIDE, :SIDE].T.reshape(-1)

    load = np.random.default_rng(0).normal(size=matrix.shape[0])
    definite(lambda p: matrix @ p, precondition, load, 1e-8, inner=ARRAYS)
