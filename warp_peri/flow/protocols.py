"""What is done to dumbbells, and what is recorded: gradients held one after another.

A protocol is an array K [T, m, 4]: in interval n ensemble i feels K[n, i], in relaxation times.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from warp_peri.errors import InputError
from warp_peri.files.archive import read_arrays
from warp_peri.files.atomic import whole_file
from warp_peri.flow.dumbbells import Dumbbells
from warp_peri.flow.planar import IDENTITY
from warp_peri.points.arrays import check_positive, check_whole, checked, fingerprint


@dataclass(frozen=True)
class Ensembles:
    """Moments of ensembles at the ends of intervals.

    Args:
        interval: relaxation times between two rows.
        K: what was felt, shape [T, m, 4].
        C: ⟨q q⟩, shape [T + 1, m, 4].
        S: ⟨q q f⟩, the same for Hookean dumbbells; the stress is S − I.
        count: dumbbells in an ensemble, 0 for exact moments.

    Raises InputError for an interval that is not positive, a count below 0, and moments of other
    shapes or that are not finite.
    """

    interval: float
    K: np.ndarray
    C: np.ndarray
    S: np.ndarray
    count: int

    def __post_init__(self) -> None:
        check_positive("interval", self.interval)
        check_whole("count", self.count, 0)
        T, m, _ = checked("K", self.K, float, ("T", "m", 4)).shape
        for name in ("C", "S"):
            checked(name, getattr(self, name), float, (T + 1, m, 4))

    @property
    def stress(self) -> np.ndarray:
        """s = S − I [n k T], shape [T + 1, m, 4]."""
        return np.asarray(self.S - IDENTITY)


def listed(records: Ensembles | Sequence[Ensembles]) -> list[Ensembles]:
    """One record or several as a list. Raises InputError for none."""
    several = [records] if isinstance(records, Ensembles) else list(records)
    if not several:
        raise InputError("records: expected one or more, got none")
    return several


def held(K: np.ndarray, intervals: int) -> np.ndarray:
    """Every ensemble under one K of its own [m, 4] throughout."""
    return np.tile(np.asarray(K, dtype=float), (intervals, 1, 1))


def random_planar(n: int, largest: float, random: np.random.Generator) -> np.ndarray:
    """Gradients without trace, each component within ± largest/√2; shape [n, 4]."""
    a, b, c = random.uniform(-1, 1, (3, n)) * largest / np.sqrt(2)
    return np.stack([a, b, c, -a], axis=-1)


def mixed(m: int, intervals: int, largest: float, *, hold: int = 10, seed: int = 0) -> np.ndarray:
    """Random planar gradients, a new one every `hold` intervals: what visits mixed states.

    Raises InputError for a `largest` that is not positive.
    """
    check_positive("largest gradient", largest)
    random = np.random.default_rng(seed)
    pieces = -(-intervals // hold)
    drawn = random_planar(pieces * m, largest, random).reshape(pieces, m, 4)
    return np.repeat(drawn, hold, axis=0)[:intervals]


def simulate(
    dumbbells: Dumbbells,
    K: np.ndarray,
    interval: float,
    *,
    steps: int = 1,
    checkpoint: str | os.PathLike[str] | None = None,
    progress: bool = False,
) -> Ensembles:
    """Run dumbbells through a protocol.

    Args:
        dumbbells: as many ensembles as K has.
        K: the protocol, shape [T, m, 4].
        interval: relaxation times that each row is held.
        steps: of the dumbbells in an interval; Hookean ones need one.
        checkpoint: file written now and then; a run that finds its own goes on from it, and ends
            with the same bits.
        progress: whether to show a bar.

    Raises InputError for a protocol of another shape, an interval that is not positive, steps below
    1, or a checkpoint of another run.
    """
    check_positive("interval", interval)
    check_whole("steps", steps, 1)
    K = np.asarray(K, dtype=float)
    if K.ndim != 3 or K.shape[1:] != (dumbbells.ensembles, 4):
        raise InputError(f"K: expected shape [T, {dumbbells.ensembles}, 4], got {list(K.shape)}")
    first, key = 0, f"{dumbbells.key}, {fingerprint(K, interval, steps)[:16]}"
    moments = np.zeros((2, len(K) + 1, *K.shape[1:]))
    if checkpoint is not None and Path(checkpoint).exists():
        first, moments = _resume(checkpoint, dumbbells, moments, key)
    else:
        now = dumbbells.moments()
        moments[:, 0] = now.C, now.S
    rows = tqdm(range(first, len(K)), disable=not progress, desc="dumbbells", initial=first)
    often = max(1, len(K) // 20)
    for n in rows:
        now = dumbbells.advance(K[n], interval / steps, steps)
        moments[:, n + 1] = now.C, now.S
        if checkpoint is not None and ((n + 1) % often == 0 or n + 1 == len(K)):
            _keep(checkpoint, dumbbells, moments, n + 1, key)
    return Ensembles(interval, K, moments[0], moments[1], dumbbells.count)


def _keep(
    path: str | os.PathLike[str], dumbbells: Dumbbells, moments: np.ndarray, done: int, key: str
) -> None:
    content: dict[str, Any] = {**dumbbells.state(), "moments": moments}
    content |= {"done": np.array(done), "key": np.array(key)}
    with whole_file(path) as temporary, open(temporary, "wb") as file:
        np.savez(file, **content)


def _resume(
    path: str | os.PathLike[str], dumbbells: Dumbbells, moments: np.ndarray, key: str
) -> tuple[int, np.ndarray]:
    try:
        content = read_arrays(path)
        kept_key, done = str(content["key"]), int(content["done"])
        kept, state = content["moments"], {name: content[name] for name in dumbbells.state()}
    except (OSError, KeyError, ValueError) as error:
        raise InputError(f"{path}: not a checkpoint of dumbbells ({error})") from None
    if kept_key != key or kept.shape != moments.shape:
        raise InputError(f"{path}: the checkpoint of another run ({kept_key})")
    dumbbells.restore(state)
    return done, kept


def read_trajectory(
    path: str | os.PathLike[str], relaxation_time: float, modulus: float, count: int
) -> Ensembles:
    """A stress trajectory of any simulator, as a record of one ensemble.

    Args:
        path: text with commas; columns t, K_xx, K_xy, K_yx, K_yy (in 1/time) and the stress of the
            polymer s_xx, s_xy, s_yy, s_zz, at equal times; lines that begin with # are skipped.
        relaxation_time: in the file's unit of time.
        modulus: n k T in the file's unit of stress.
        count: molecules, which set the noise.

    C is given as S: a stress trajectory does not know the conformation. Raises InputError for a
    file that cannot be read, other columns, times that are not equally spaced, a time or modulus
    that is not positive, and a count below 1.
    """
    check_positive("relaxation_time", relaxation_time)
    check_positive("modulus", modulus)
    check_whole("count", count, 1)
    try:
        table = np.loadtxt(path, delimiter=",", ndmin=2)
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: not a table of numbers ({error})") from None
    if table.shape[1] != 9 or len(table) < 3:
        raise InputError(f"{path}: expected 9 columns and 3 lines or more, got {table.shape}")
    gaps = np.diff(table[:, 0]) / relaxation_time
    if not (gaps[0] > 0 and np.allclose(gaps, gaps[0], rtol=1e-4)):
        raise InputError(f"{path}: expected equally spaced times")
    S = table[:, None, 5:] / modulus + IDENTITY
    K = table[:-1, None, 1:5] * relaxation_time
    return Ensembles(float(gaps[0]), K, S, S, count)
