"""Figures of the pages with the commands that make them, and the gallery: nine cards.

    python examples/studies/gallery.py

Collects what the other examples left in runs/, draws the stress of a held-out disk from exported
fields, and writes docs/gallery.md and docs/gallery/. Figures that other pages show stay where they
are. A missing figure is named with its command, and nothing is written.
Needs meshio (the extra `export`).
"""

import io
import sys
import tomllib
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent.parent
sys.path.insert(0, str(ROOT))

import meshio
import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure as Canvas
from PIL import Image

from examples.figures import headline, panels
from examples.prose import table
from tools.options import Options
from warp_peri import InputError
from warp_peri.errors import exit_status
from warp_peri.files.atomic import whole_file, write_text

LARGEST, WIDTH = 200_000, 1000
"""A picture of more bytes is brought to this width in pixels, in 256 colours of its own."""
MAGNIFIED = 40
"""Displacements in the picture of stress are drawn this many times too large."""


@dataclass(frozen=True)
class Figure:
    """One figure: a row of gallery.toml; those with a card lead to a page."""

    title: str
    shows: str
    commands: list[str]
    path: str
    source: str | None = None
    card: str = ""
    page: str = ""


FIGURES = tuple(
    Figure(**row)
    for row in tomllib.loads(Path(__file__).with_suffix(".toml").read_text("utf-8"))["figure"]
)
COLUMNS = 3
"""Cards in a row."""


def cards() -> str:
    """The page of the gallery in Markdown."""
    shown = [
        f"[![{figure.title}]({figure.path}){{ width=400 }}]({figure.page})<br>{figure.card}"
        for figure in FIGURES
        if figure.card
    ]
    rows = [shown[n : n + COLUMNS] for n in range(0, len(shown), COLUMNS)]
    return "\n".join([
        "# Gallery",
        "",
        "See nine things that the library does. A picture leads to the page that shows how.",
        "",
        table([" "] * COLUMNS, rows),
        "",
    ])  # fmt: skip


def collect(source: Path, path: Path) -> None:
    """A picture as it is, or what is drawn from fields; smaller where it is large for a page."""
    if source.suffix == ".vtu":
        drawn, figure = io.BytesIO(), stress(source)
        figure.savefig(drawn, dpi=100)
        content = drawn.getvalue()
    else:
        content = source.read_bytes()
    with whole_file(path) as temporary:
        if len(content) <= LARGEST:
            temporary.write_bytes(content)
            return
        with Image.open(io.BytesIO(content)) as image:
            small = image.convert("RGB")
        size = (WIDTH, round(small.height * WIDTH / small.width))
        small = small.resize(size, Image.Resampling.LANCZOS)
        small.quantize(256, dither=Image.Dither.NONE).save(temporary, optimize=True)


def stress(source: Path) -> Canvas:
    """σ₁₁, σ₂₂ and σ₁₂ on the deformed interior, from a .vtu file of `warp-peri export`.

    A quadrilateral has the mean of its corners; it is drawn where all four are interior.
    """
    mesh = meshio.read(source)
    data = mesh.point_data
    x = mesh.points[:, :2] + MAGNIFIED * data["displacement"][:, :2]
    quads = mesh.cells_dict["quad"]
    inside = data["interior"][quads].all(axis=1)
    values = 1e3 * data["stress"][quads[inside]].mean(axis=1)
    limit = np.abs(values).max()
    figure, axes = panels(10.5, 4, count=3, sharey=True)
    for ax, column, name in zip(axes, (0, 1, 3), ("σ₁₁", "σ₂₂", "σ₁₂")):
        ax.add_collection(
            PolyCollection(x[quads[~inside]], facecolor="none", edgecolor="0.75", linewidth=0.4)
        )
        faces = PolyCollection(
            x[quads[inside]], array=values[:, column], cmap="RdBu_r", edgecolor="face"
        )
        faces.set_clim(-limit, limit)
        ax.add_collection(faces)
        ax.autoscale_view()
        ax.set(aspect="equal", title=name, xlabel="x₁ [Å]")
    axes[0].set_ylabel("x₂ [Å]")
    headline(figure, "Every stress is largest at the rim of the disk (grey: displacement given)")
    figure.colorbar(faces, ax=axes, label="stress [GPa]", shrink=0.85)
    return figure


def main(arguments: list[str] | None = None) -> int:
    parser = Options(__doc__)
    parser.add("--runs", type=Path, default=ROOT / "runs", help="of the other examples")
    parser.add("--out", type=Path, default=ROOT / "docs", help="default: docs/")
    given = parser.parse_args(arguments)
    for figure in FIGURES:
        needed = given.runs / figure.source if figure.source else given.out / figure.path
        if not needed.exists():
            made = " && ".join(c for c in figure.commands if "gallery.py" not in c)
            raise InputError(f"{needed}: no such file; it is made by: {made}")
    for figure in FIGURES:
        if figure.source:
            collect(given.runs / figure.source, given.out / figure.path)
    write_text(given.out / "gallery.md", cards())
    return 0


if __name__ == "__main__":
    sys.exit(exit_status(main))
