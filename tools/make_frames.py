"""Frames of a rubber sheet as image correlation gives them: elements, tines, noise of pixels.

python tools/make_frames.py data/frames
"""

import sys
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np
import torch

from tools.hyperelastic_energies import invariants_of
from tools.make_leaflet import NODES, PROTOCOLS, SPACING, Leaflet, pull
from tools.options import Folder, Options, reading
from warp_peri.errors import exit_status
from warp_peri.files.atomic import write_text, written
from warp_peri.points.arguments import NotNegative
from warp_peri.points.points import grid_points

C1, C2 = 3.5, 1.5
"""Of the sheet [kPa]."""
PIXELS, NOISE = 10.0, 0.02
"""Between points, and on every displacement [pixels]."""
USED, LEVELS, TRAVEL = (0, 2, 4, 5), 3, 0.6


def mooney_rivlin(c: torch.Tensor) -> torch.Tensor:
    """C1 (I1 − 3) + C2 (I2 − 3) of an incompressible sheet in plane stress, as an Energy."""
    trace, D = invariants_of(c)
    return C1 * (trace + 1 / D - 3) + C2 * (D + trace / D - 3)


@dataclass(frozen=True)
class Rubber(Leaflet):
    """The leaflet's test on a sheet of rubber."""

    @property
    def energy(self):
        """Its strain energy."""
        return mooney_rivlin


def write_frames(folder: Path, *, noise: float = NOISE, seed: int = 7) -> None:
    """A table of x, y, u, v [pixels] for each protocol and level."""
    rng = np.random.default_rng(seed)
    x = grid_points(PIXELS * np.arange(NODES), 2)
    frames = [pull(Rubber(), PROTOCOLS[n], LEVELS, TRAVEL)[0] for n in USED]
    for number, field in enumerate(np.concatenate(frames) * PIXELS / SPACING):
        table = np.hstack([x, field + noise * rng.standard_normal(field.shape)])
        rows = "\n".join(f"{a:g},{b:g},{u:.3f},{v:.3f}" for a, b, u, v in table)
        write_text(folder / f"frame{number:02d}.csv", f"x,y,u,v\n{rows}\n")


def main() -> None:
    """Write the frames from a shell."""
    parser = Options(__doc__, options={
        "noise": (NOISE, "[pixels]", NotNegative), "overwrite": (False, "frames that are there"),
    })  # fmt: skip
    parser.add_argument("folder", type=reading(Folder))
    given = parser.parse_args()
    with written(given.folder):
        given.folder.mkdir(parents=True, exist_ok=True)
    if any(given.folder.glob("frame*.csv")) and not given.overwrite:
        parser.error(f"folder: {given.folder} has frames already; name another, or --overwrite")
    write_frames(given.folder, noise=given.noise)


if __name__ == "__main__":
    sys.exit(exit_status(main))
