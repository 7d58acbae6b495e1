"""The loads of You et al. 2021, section 6.1: 70 for training, 10 to validate, 4 on the disk.

Each load has a `shape`, a dimensionless field [A, 2] without net force on the atoms at positions
[Å] of a sheet of periods `box` [Å], or of a disk about the origin; amplitude [TPa/Å] times shape is
a body force density. A load without amplitude is as large as its bond strain says.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from warp_peri.points.arguments import EV_IN_TPA
from warp_peri.points.dataset import mixed_waves

Box = tuple[float, float] | None
"""Periods (Lx, Ly) of the atoms [Å]; None for a free body."""

UNLOADED_RADIUS = 50.0
"""Inside of it the disk carries no load [Å] (Table 2)."""


@dataclass(frozen=True)
class WaveLoad:
    """cos(k₁x) cos(k₂y) along one axis, kₐ = 2π pₐ/Lₐ of the sheet's own periods (6.2)."""

    axis: int
    waves: tuple[int, int]

    @property
    def load_id(self) -> str:
        return f"{'xy'[self.axis]} k=({self.waves[0]},{self.waves[1]})"

    def wave_vector(self, box: Box) -> np.ndarray:
        """k [1/Å] on a sheet of periods `box` [Å], shape [2]."""
        return np.asarray(2 * np.pi * np.divide(self.waves, _periods(box)))

    def shape(self, positions: np.ndarray, box: Box) -> np.ndarray:
        return _along(self.axis, np.cos(self.wave_vector(box) * positions).prod(axis=1))


@dataclass(frozen=True)
class PatchLoad:
    """A round patch in the middle and the opposite one around the edge of the sheet (Table 1).

    The patches at j = −1 and 1 are periodic images of each other: their centres are half a period
    from the middle along x (`edge` 0) or y (`edge` 1).
    """

    amplitude: ClassVar[float] = 0.001
    case: int
    axis: int
    edge: int
    radius: float

    @property
    def load_id(self) -> str:
        return f"table1-{self.case}"

    def shape(self, positions: np.ndarray, box: Box) -> np.ndarray:
        value = np.zeros(len(positions))
        for j in (-1, 0, 1):
            centre = np.zeros(2)
            centre[self.edge] = j * _periods(box)[self.edge] / 2
            r = np.linalg.norm(positions - centre, axis=1)
            value += (-1) ** j * np.cos(np.pi / 2 * np.minimum(1, r / self.radius))
        return _along(self.axis, value)


@dataclass(frozen=True)
class RimLoad:
    """Load on the disk outside UNLOADED_RADIUS, by cases of Table 2.

    Case 3 as printed, |sin θ|, pushes the disk away; its mean over the loaded atoms is removed.
    """

    amplitude: ClassVar[float] = 0.0005
    case: int

    @property
    def load_id(self) -> str:
        return f"table2-{self.case}"

    def shape(self, positions: np.ndarray, box: Box = None) -> np.ndarray:
        loaded = np.linalg.norm(positions, axis=1) > UNLOADED_RADIUS
        t = np.arctan2(positions[loaded, 1], positions[loaded, 0])
        sin, cos = np.sin(t), np.cos(t)
        b1, b2 = {
            1: (np.cos(4 * t) * cos, np.cos(4 * t) * sin),
            2: (np.sign(np.cos(4 * t)) * cos, np.sign(np.cos(4 * t)) * sin),
            3: (0 * t, np.sign(sin) * sin),
            4: (np.sin(3 * t) * sin, np.sin(3 * t) * cos),
        }[self.case]
        value = np.zeros((len(positions), 2))
        value[loaded] = _balanced(np.stack([b1, b2], axis=1))
        return value


@dataclass(frozen=True)
class MixedLoad:
    """All waves of a sheet no shorter than `shortest` [Å]: random phases and directions, each as
    large as its |k| (theory, Q11)."""

    seed: int
    shortest: float

    @property
    def load_id(self) -> str:
        return f"mixed-{self.seed} λ≥{self.shortest:g}"

    def shape(self, positions: np.ndarray, box: Box) -> np.ndarray:
        return mixed_waves(positions, _periods(box), self.shortest, seed=self.seed)


@dataclass(frozen=True)
class Reversed:
    """A load the other way round: what answers have of even order cancels between the two."""

    load: "Load"

    @property
    def load_id(self) -> str:
        return f"{self.load.load_id} reversed"

    def shape(self, positions: np.ndarray, box: Box) -> np.ndarray:
        return -self.load.shape(positions, box)


Load = WaveLoad | PatchLoad | RimLoad | MixedLoad | Reversed

WAVES = [(p, q) for p in range(6) for q in range(6) if p or q]
TRAINING = [WaveLoad(axis, waves) for axis in range(2) for waves in WAVES]


MIXED = [MixedLoad(seed, 20.0) for seed in range(2)]
DESIGNED: list[Load] = [way for load in MIXED for way in (load, Reversed(load))]
"""In place of TRAINING, loads that hold all waves, each and its reverse: one tells a law whose
moduli are known, two one that is to find them."""
PATCHES = (  # axis, edge and radius of the cases 1 to 10 of Table 1
    (0, 0, 25.0), (1, 0, 25.0), (0, 0, 15.0), (1, 0, 15.0), (0, 0, 10.0),
    (0, 1, 25.0), (1, 1, 25.0), (0, 1, 15.0), (1, 1, 15.0), (0, 1, 10.0),
)  # fmt: skip
VALIDATION = [PatchLoad(case, *patch) for case, patch in enumerate(PATCHES, start=1)]
TEST = [RimLoad(case) for case in (1, 2, 3, 4)]


def atom_force(density: np.ndarray, area: float, thickness: float) -> np.ndarray:
    """Force on an atom [eV/Å] from the body force density at it [TPa/Å].

    `area` belongs to the atom [Å²], `thickness` to the sheet [Å].
    """
    return density * (area * thickness / EV_IN_TPA)


def _periods(box: Box) -> np.ndarray:
    if box is None:
        raise ValueError("this load is periodic: it needs the periods of a sheet, got None")
    return np.array(box)


def _along(axis: int, value: np.ndarray) -> np.ndarray:
    field = np.zeros((len(value), 2))
    field[:, axis] = value
    return _balanced(field)


def _balanced(field: np.ndarray) -> np.ndarray:
    return field - field.mean(axis=0)
