"""Where the method fails: every failure provoked, measured, drawn, and met by a named error.

Writes docs/explanation/where_it_fails.md, the study behind it docs/archive/stability.md, the
figures, and stability/stability.json with the measurements (or, with --out, the same to a folder).
The texts are filled with the measurements of the run; the errors and warnings in them are caught
as a user would see them. With --again the pages are made anew from stability.json.
"""

import json
import re
import sys
import time
import unicodedata
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent.parent
sys.path.insert(0, str(ROOT))

import warp_peri as wp
from examples.figures import headline, save_figure
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
from examples.studies.atlas_entry import Entry, Words, filled
from examples.train_graphene import DATA, SMOOTHING_RADIUS, make_data
from tools.options import Options
from warp_peri import InputError
from warp_peri.errors import exit_status
from warp_peri.files.atomic import finite, plain, write_json, write_text

STEPS = 100_000
TEMPLATES = Path(__file__).parent / "atlas"
PAGES = {"page": "explanation/where_it_fails.md", "study": "archive/stability.md"}
"""Templates of whole pages, and where the pages lie."""
PARTS = {
    "Fit and transfer": (
        "sign-changing", "spacing", "exponent", "horizon", "degree", "lame", "scattered",
        "transfer", "supercell", "noisy-strains",
    ),
    "Bodies and edges": ("surfaces", "bodies", "crystals", "edges"),
    "Motion": ("time-step", "energy", "dispersion"),
    "Large strains": ("strain", "larger-strains", "compression", "uneven"),
    "Cracks": ("broken", "cracks-in-space", "stretch", "edge-tips", "long-steps"),
    "Numbers and error bars": ("float32", "ranks", "predictions"),
    "Polymer flow": ("noise-of-its-own", "stretched-and-turned"),
}  # fmt: skip
"""Entries of the page for readers, by subject."""


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


def anchor(title: str) -> str:
    """A link's end of a heading, as the site makes it."""
    plain_title = unicodedata.normalize("NFKD", title).encode("ascii", "ignore").decode()
    return re.sub(r"[-\s]+", "-", re.sub(r"[^\w\s-]", "", plain_title).strip().lower())


def study(name: str, words: Words, seen: list[str]) -> str:
    """One entry of the study as Markdown."""
    said = "\n".join(f"    {line}" for line in seen)
    return (
        f"## {words.title}\n\n**{words.number}**\n\n{words.text}\n\n"
        f"![{words.title}](../stability/{name}.png)\n\nWhat a user sees:\n\n{said}\n"
    )


def brief(words: Words, seen: list[str]) -> str:
    """One entry of the page for readers as Markdown."""
    said = "\n".join(seen)
    return (
        f"### {words.heading} {{#{anchor(words.title)}}}\n\n{words.brief}\n"
        f"[Study](../archive/stability.md#{anchor(words.title)}).\n\n```text\n{said}\n```\n"
    )


def row(words: Words) -> str:
    """One entry of the table of symptoms."""
    symptom, cause, remedy = words.row.split(" | ")
    return f"| {symptom} | [{cause.rstrip('.')}](#{anchor(words.title)}) | {remedy} |"


def pages(kept: Mapping[str, Mapping[str, Any]]) -> dict[str, str]:
    """Both pages, by their places, from measurements and messages by entry."""
    words = {name: filled(name, one["numbers"]) for name, one in kept.items()}
    rows = sorted((row(one) for one in words.values()), key=lambda line: line[2] != "`")
    parts = [
        f"## {part}\n\n" + "\n".join(brief(words[name], kept[name]["seen"]) for name in names)
        for part, names in PARTS.items()
    ]
    sections = [study(name, words[name], one["seen"]) for name, one in kept.items()]
    return {
        PAGES["page"]: fill(TEMPLATES / "page.md", rows="\n".join(rows), parts="\n".join(parts)),
        PAGES["study"]: fill(TEMPLATES / "study.md", sections="\n".join(sections)),
    }


def write_pages(out: Path, kept: Mapping[str, Mapping[str, Any]]) -> None:
    for place, text in pages(kept).items():
        (out / place).parent.mkdir(parents=True, exist_ok=True)
        write_text(out / place, text)


def main(arguments: list[str] | None = None) -> int:
    parser = Options(__doc__)
    parser.add("--out", type=Path, default=ROOT / "docs", help="default: docs/")
    parser.add("--only", nargs="+", metavar="NAME", help="some entries, no page")
    parser.add("--steps", type=int, default=STEPS, help="of the energy drift")
    parser.add("--again", action="store_true", help="the pages from what is there, unmeasured")
    given = parser.parse_args(arguments)
    table = given.out / "stability" / "stability.json"
    if given.again:
        write_pages(given.out, json.loads(table.read_text(encoding="utf-8")))
        return 0
    data = wp.load(make_data(-1, SMOOTHING_RADIUS))
    works = entries(data, DATA.with_suffix(".cache"), given.steps)
    unknown = set(given.only or ()) - set(works)
    if unknown:
        raise InputError(f"--only: expected some of {', '.join(works)}, got {sorted(unknown)}")
    kept, values = {}, {}
    for name in given.only or works:
        begin = time.perf_counter()
        entry = works[name]()
        words = filled(name, entry.numbers)
        headline(entry.figure, words.message)
        save_figure(entry.figure, given.out / "stability" / f"{name}.png")
        kept[name] = {"numbers": plain(entry.numbers), "seen": entry.seen}
        values[name] = kept[name] | {"values": entry.values}
        print(f"{words.title}: {words.number} ({time.perf_counter() - begin:.0f} s)", flush=True)
    if not given.only:
        write_json(table, finite(kept))
        write_pages(given.out, kept)
        write_json(ROOT / "runs" / "stability" / "stability.json", finite(plain(values)))
    return 0


if __name__ == "__main__":
    sys.exit(exit_status(main))
