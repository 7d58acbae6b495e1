"""Where the method fails: every failure provoked, measured, drawn, and met by a named error.

Writes docs/stability.md with its figures (or, with --out, the same to a folder) and
stability.json. The texts are filled with the measurements of the run; the errors and warnings in
them are caught as a user would see them.
"""

import sys
import time
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent.parent
sys.path.insert(0, str(ROOT))

import matplotlib

matplotlib.use("Agg")

import warp_peri
from examples.graphene_report import save_figure
from examples.prose import fill
from examples.studies import (
    atlas_bodies,
    atlas_conditions,
    atlas_cracks,
    atlas_crystals,
    atlas_dressed,
    atlas_flow,
    atlas_hyperelastic,
    atlas_kernels,
    atlas_motion,
    atlas_neural,
    atlas_nonlinear,
    atlas_points,
    atlas_predictions,
    atlas_ranks,
    atlas_solves,
    atlas_structures,
    atlas_transfer,
    atlas_uneven,
)
from examples.studies.atlas_entry import Entry
from examples.train_graphene import DATA, SMOOTHING_RADIUS, make_data
from tools.options import Options
from warp_peri import InputError
from warp_peri.errors import exit_status
from warp_peri.files.atomic import finite, plain, write_json, write_text

STEPS = 100_000
TEMPLATE = Path(__file__).parent / "atlas" / "page.md"


def entries(data: warp_peri.Dataset, cache: Path, steps: int) -> dict[str, Callable[[], Entry]]:
    """What there is to provoke, by name."""
    learned: list[warp_peri.Model] = []

    def model() -> warp_peri.Model:
        if not learned:
            fit = warp_peri.fit(
                data["train"], warp_peri.LPS(horizon=20.0, kernel=warp_peri.Bernstein(10))
            )
            learned.append(fit.material)
        return learned[0]

    return {
        "sign-changing": lambda: atlas_conditions.sign_changing(data),
        "spacing": lambda: atlas_kernels.other_spacing(data, cache),
        "exponent": atlas_kernels.steep_kernels,
        "horizon": atlas_kernels.short_horizons,
        "degree": lambda: atlas_kernels.large_degrees(data),
        "lame": lambda: atlas_solves.lame_parameters(data),
        "scattered": atlas_points.scattered_points,
        "transfer": lambda: atlas_transfer.transfers(model()),
        "surfaces": atlas_points.free_surfaces,
        "bodies": lambda: atlas_bodies.cut_families(model()),
        "crystals": atlas_crystals.crystals,
        "supercell": atlas_structures.narrow_supercells,
        "time-step": lambda: atlas_motion.critical_step(model()),
        "energy": lambda: atlas_motion.energy_drift(model(), steps),
        "dispersion": lambda: atlas_motion.dispersion(model(), data),
        "strain": lambda: atlas_motion.large_strains(model()),
        "larger-strains": lambda: atlas_nonlinear.larger_strains(data, cache),
        "float32": atlas_solves.single_precision,
        "ranks": atlas_ranks.filters,
        "compression": atlas_hyperelastic.hourglass,
        "edges": lambda: atlas_dressed.cut_at_edges(data),
        "small-holes": lambda: atlas_dressed.small_holes(data),
        "stretched": atlas_dressed.stretched_beyond,
        "uneven": atlas_uneven.uneven_as_even,
        "noisy-strains": lambda: atlas_neural.noise(ROOT / "data" / "hgo"),
        "predictions": lambda: atlas_predictions.short_waves(data),
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
    parser.add_argument("--out", type=Path, default=ROOT / "docs", help="default: docs/")
    parser.add_argument("--only", nargs="+", metavar="NAME", help="some entries, no page")
    parser.add_argument("--steps", type=int, default=STEPS, help="of the energy drift")
    given = parser.parse_args(arguments)
    path = make_data(-1, SMOOTHING_RADIUS)
    data = warp_peri.load(path)
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
