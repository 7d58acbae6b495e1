"""Where the method fails: every failure provoked, measured, drawn, and met by a named error.

Writes docs/stability.md with its figures (or, with --out, the same to a folder) and
stability.json. The texts are filled with the measurements of the run; the errors and warnings in
them are caught as a user would see them.
"""

import sys
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent.parent
sys.path.insert(0, str(ROOT))

import warp_peri as wp
from examples.figures import save_figure
from examples.prose import fill
from examples.studies import (
    atlas_bodies,
    atlas_cracks,
    atlas_flow,
    atlas_kernels,
    atlas_motion,
    atlas_ranks,
    atlas_solves,
    atlas_strains,
    atlas_transfer,
)
from examples.studies.atlas_entry import Entry
from examples.train_graphene import DATA, SMOOTHING_RADIUS, make_data
from tools.options import Options
from warp_peri import InputError
from warp_peri.errors import exit_status
from warp_peri.files.atomic import finite, plain, write_json, write_text

STEPS = 100_000
TEMPLATE = Path(__file__).parent / "atlas" / "page.md"


def entries(data: wp.Dataset, atoms: Path, steps: int) -> dict[str, Callable[[], Entry]]:
    """What there is to provoke, by name."""

    @cache
    def model() -> wp.Model:
        return wp.fit(
            data["train"], wp.LPS(20.0, wp.Bernstein(10), wp.methods.Optimum(moduli=None))
        ).material

    return {
        "sign-changing": lambda: atlas_kernels.sign_changing(data),
        "spacing": lambda: atlas_kernels.other_spacing(data, atoms),
        "exponent": atlas_kernels.steep_kernels,
        "horizon": atlas_kernels.short_horizons,
        "degree": lambda: atlas_kernels.large_degrees(data),
        "lame": lambda: atlas_solves.lame_parameters(data),
        "scattered": atlas_solves.scattered_points,
        "transfer": lambda: atlas_transfer.transfers(model()),
        "surfaces": atlas_solves.free_surfaces,
        "bodies": lambda: atlas_bodies.cut_families(model()),
        "crystals": atlas_bodies.crystals,
        "supercell": atlas_transfer.narrow_supercells,
        "time-step": lambda: atlas_motion.critical_step(model()),
        "energy": lambda: atlas_motion.energy_drift(model(), steps),
        "dispersion": lambda: atlas_motion.dispersion(model(), data),
        "strain": lambda: atlas_motion.large_strains(model()),
        "larger-strains": lambda: atlas_strains.larger_strains(data, atoms),
        "float32": atlas_solves.single_precision,
        "ranks": atlas_ranks.filters,
        "compression": atlas_strains.hourglass,
        "edges": lambda: atlas_bodies.cut_at_edges(data),
        "small-holes": lambda: atlas_bodies.small_holes(data),
        "stretched": atlas_bodies.stretched_beyond,
        "uneven": atlas_strains.uneven_as_even,
        "noisy-strains": lambda: atlas_strains.noise(ROOT / "data" / "hgo"),
        "predictions": lambda: atlas_transfer.short_waves(data),
        "noise-of-its-own": atlas_flow.independent_noise,
        "stretched-and-turned": atlas_flow.stretched_and_turned,
        "broken": lambda: atlas_cracks.broken_kernels(model()),
        "cracks-in-space": atlas_cracks.in_space,
        "stretch": atlas_cracks.misjudged_stretch,
        "edge-tips": atlas_cracks.edge_tips,
        "long-steps": atlas_cracks.long_steps,
    }


def section(name: str, entry: Entry, figures: str) -> str:
    """One entry as Markdown."""
    seen = "\n".join(f"    {line}" for line in entry.seen)
    return (
        f"## {entry.title}\n\n**{entry.number}**\n\n{entry.text}\n\n"
        f"![{entry.title}]({figures}/{name}.png)\n\nWhat a user sees:\n\n{seen}\n"
    )


def main(arguments: list[str] | None = None) -> int:
    parser = Options(__doc__)
    parser.add("--out", type=Path, default=ROOT / "docs", help="default: docs/")
    parser.add("--only", nargs="+", metavar="NAME", help="some entries, no page")
    parser.add("--steps", type=int, default=STEPS, help="of the energy drift")
    given = parser.parse_args(arguments)
    path = make_data(-1, SMOOTHING_RADIUS)
    data = wp.load(path)
    works = entries(data, DATA.with_suffix(".cache"), given.steps)
    unknown = set(given.only or ()) - set(works)
    if unknown:
        raise InputError(f"--only: expected some of {', '.join(works)}, got {sorted(unknown)}")
    sections, values = [], {}
    for name in given.only or works:
        begin = time.perf_counter()
        entry = works[name]()
        save_figure(entry.figure, given.out / "stability" / f"{name}.png")
        sections.append(section(name, entry, "stability"))
        values[name] = {"number": entry.number, "seen": entry.seen, "values": entry.values}
        print(f"{entry.title}: {entry.number} ({time.perf_counter() - begin:.0f} s)", flush=True)
    if not given.only:
        page = fill(TEMPLATE, sections="\n".join(sections))
        write_text(given.out / "stability.md", page)
        write_json(ROOT / "runs" / "stability" / "stability.json", finite(plain(values)))
    return 0


if __name__ == "__main__":
    sys.exit(exit_status(main))
