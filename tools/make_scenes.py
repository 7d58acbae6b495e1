"""Scenes that no constant of `predict` has seen, with truth from atoms: a data set of its own.

    python tools/make_scenes.py
    python tools/make_scenes.py --seed 4747 --strains .014 .02    # loads of your own
    python tools/make_scenes.py --seed 4747 --strains .02 --both-ways    # and each load reversed

Sums of many waves on the sheet and random loads round the disk, at bond strains from 1 to 10 %, on
the nodes of the data set, on other shapes of the interior, and on nodes turned against the crystal.
The loads were written down before any of them was looked at.
"""

import dataclasses
import sys
import warnings
from collections.abc import Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np

from tools import make_graphene as base
from tools.loads import Load, MixedLoad, RandomRim, Reversed
from tools.make_strained import SPACING, _solve_missing, strained_file
from tools.options import Options
from tools.samples import Piece, Sample, read_sample
from warp_peri import Dataset, Samples
from warp_peri.errors import exit_status
from warp_peri.files.atomic import locked
from warp_peri.points.dataset import save_dataset

OUT, POOL = Path("data/graphene_0K_scenes.h5"), Path("data/graphene_0K_pool.h5")
STRAINS = (0.01, 0.03, 0.05, 0.08, 0.10)
"""Largest bond strains."""
WAVES = (28.0, 34.0, 40.0, 48.0, 54.0, 66.0)
SHEET = tuple(MixedLoad(161 + n, shortest) for n, shortest in enumerate(WAVES))
DISK = tuple(RandomRim(1501 + n) for n in range(6))
"""Named when the form of the error stood, before they were made."""
SEEN = (
    (((81, 27.0), (82, 38.0), (83, 62.0)), (701, 702, 703)),
    (((91, 29.0), (92, 40.0), (93, 68.0)), (801, 802, 803)),
    (((101, 27.0), (102, 41.0), (103, 66.0)), (901, 902, 903)),
    (((104, 31.0), (105, 37.0), (106, 58.0)), (904, 905, 906)),
    (
        ((111, 26.0), (112, 33.0), (113, 39.0), (114, 47.0), (115, 55.0), (116, 72.0)),
        (1001, 1002, 1003, 1004, 1005, 1006),
    ),
    (
        ((121, 28.0), (122, 31.0), (123, 42.0), (124, 50.0), (125, 57.0), (126, 68.0)),
        (1101, 1102, 1103, 1104, 1105, 1106),
    ),
    (
        ((131, 27.0), (132, 32.0), (133, 37.0), (134, 44.0), (135, 53.0), (136, 70.0)),
        (1201, 1202, 1203, 1204, 1205, 1206),
    ),
    (
        ((141, 26.0), (142, 30.0), (143, 35.0), (144, 41.0), (145, 49.0), (146, 64.0)),
        (1301, 1302, 1303, 1304, 1305, 1306),
    ),
    (
        ((151, 27.0), (152, 33.0), (153, 39.0), (154, 46.0), (155, 52.0), (156, 75.0)),
        (1401, 1402, 1403, 1404, 1405, 1406),
    ),
)
"""Loads that were each scored once, in this order, by the form that the error had then: what the
form is chosen on now. Older ones are MixedLoad(41, 30), (42, 45), (43, 70), (51, 28), (52, 40),
(53, 60), (61, 26), (62, 36), (63, 80), (71, 28), (72, 42), (73, 65) and RandomRim(301–303, 401–403,
501–503, 601–603)."""
TURN = 13.0
"""Angle of the crystal to the nodes of the turned sets [degrees]."""


def pool() -> tuple[Sequence[Load], Sequence[Load]]:
    """Loads of all sets that were seen, on the sheet and on the disk."""
    sheet: list[Load] = [MixedLoad(*one) for waves, _ in SEEN for one in waves]
    return sheet, [RandomRim(seed) for _, seeds in SEEN for seed in seeds]


def shape(points: Samples, name: str) -> Samples:
    """The samples with another interior: an L, or a rectangle off the middle."""
    x, y = points.x.T
    kept = (x > -15) | (y > 5) if name == "L" else np.abs(x + 10) <= 25
    return dataclasses.replace(
        points, points=dataclasses.replace(points.points, interior=points.interior & kept)
    )


def turned(body: Piece, samples: Sequence[Sample]) -> Samples:
    """Samples on nodes that the crystal is turned against."""
    c, s = np.cos(np.deg2rad(TURN)), np.sin(np.deg2rad(TURN))
    turn = np.array([[c, s], [-s, c]])
    fields = (np.stack([getattr(one, n) for one in samples]) for n in ("displacement", "force"))
    nodes = base.on_nodes(
        body, samples[0].reference @ turn, *(f @ turn for f in fields), spacing=SPACING
    )
    return dataclasses.replace(nodes, points=dataclasses.replace(nodes.points, axis=TURN))


def make_scenes(
    path: Path = OUT,
    *,
    sheet: Sequence[Load] = SHEET,
    disk: Sequence[Load] = DISK,
    strains: Sequence[float] = STRAINS,
    both_ways: bool = False,
    jobs: int = -1,
    progress: bool = True,
) -> Path:
    """Write the sets, named `<shape>_<percent>`; finished samples stay beside the file.

    With `both_ways` also `<shape>_reversed_<percent>`, of the same loads the other way round.
    """
    cache = path.with_suffix(".cache")
    with locked(path), locked(cache):
        cache.mkdir(parents=True, exist_ok=True)
        bodies = base.graphene_bodies()
        groups: dict[str, tuple[Piece, Sequence[Load]]] = {
            "sheet": (bodies[0], sheet),
            "disk": (bodies[1], disk),
        }
        if both_ways:
            groups |= {
                f"{name}_reversed": (body, [Reversed(load) for load in loads])
                for name, (body, loads) in groups.items()
            }
        _solve_missing(groups.values(), strains, cache, jobs, progress)
        sets: dict[str, Samples] = {}
        for strain in strains:
            for name, (body, loads) in groups.items():
                found = [read_sample(strained_file(cache, body, one, strain)) for one in loads]
                samples = [sample for sample in found if sample is not None]
                percent = f"{100 * strain:g}"
                nodes = base.point_set(body, loads, samples, spacing=SPACING)
                sets[f"{name}_{percent}"] = nodes
                if name.endswith("_reversed"):
                    continue
                other = "rectangle" if body.cells else "L"
                sets[f"{other}_{percent}"] = shape(nodes, other)
                if not body.cells:
                    sets[f"turned_{percent}"] = turned(body, samples)
        given = {"source": "tools/make_scenes.py", "temperature": 0.0, "strains": list(strains)}
        save_dataset(path, Dataset(sets, base.THICKNESS, base.mass_density(bodies[0].bond), given))
    return path


def main(arguments: list[str] | None = None) -> int:
    parser = Options(__doc__)
    parser.add("--out", type=Path, metavar="FILE", help=f"default {OUT}, or {POOL}")
    parser.add("--pool", action="store_true", help="loads that were scored before, in one")
    parser.add("--seed", type=int, help="six sheets and six disks of other loads, from this number")
    parser.add(
        "--strains", type=float, nargs="+", default=STRAINS, help="largest of bonds, growing"
    )
    parser.add("--both-ways", action="store_true", help="also each load the other way round")
    parser.add("--jobs", type=int, default=-1, help="processes; -1: one for each core")
    parser.add("--quiet", action="store_true", help="no progress bar")
    given = parser.parse_args(arguments)
    warnings.showwarning = base.short_warning

    def work() -> None:
        sheet, disk = pool() if given.pool else (SHEET, DISK)
        out = given.out or (POOL if given.pool else OUT)
        if given.seed is not None:
            sheet = [MixedLoad(given.seed + n, shortest) for n, shortest in enumerate(WAVES)]
            disk = [RandomRim(given.seed + n) for n in range(len(DISK))]
            out = given.out or OUT.with_stem(f"{OUT.stem}_{given.seed}")
        how = {"strains": given.strains, "both_ways": given.both_ways, "jobs": given.jobs}
        print(make_scenes(out, sheet=sheet, disk=disk, progress=not given.quiet, **how))

    return exit_status(work, "finished samples are kept", name="make_scenes")


if __name__ == "__main__":
    sys.exit(main())
