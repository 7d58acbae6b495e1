"""Figures of examples: axes in rows, numbered panels of curves, files."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from tools.options import RUNS as RUNS
from tools.options import Options
from warp_peri.errors import InputError
from warp_peri.files.atomic import destination, whole_file

matplotlib.use("Agg")


def panels(*size: float, count: int = 1, rows: int = 1, **how: Any) -> tuple[Figure, Any]:
    """A figure of this size, 6.4 × 4.2 by default, and its axes, one or several in rows."""
    width, height = size or (6.4, 4.2)
    figure = Figure(figsize=(width, height), layout="constrained")
    return figure, figure.subplots(rows, count, **how)


SOFTWARE = PngInfo()
SOFTWARE.add_text("Software", "warp_peri")  # by which pictures are known


def check_place(path: str | Path) -> Path:
    """The path of a picture; InputError where a file is that save_figure did not make."""
    place = destination(path)
    if place.exists() and b"tEXtSoftware\0warp_peri" not in place.read_bytes():
        raise InputError(f"{path}: is there already, and no picture of this job; move it away")
    return Path(path)


def begin(doc: str | None, picture: str | Path) -> Path:
    """The path of a script's picture, see check_place; its only option is --help."""
    Options(doc).parse_args()
    return check_place(picture)


def save_figure(figure: Any, path: str | Path, dpi: float = 150, *, overwrite=False) -> None:
    """Write a figure whole or not at all, in 256 colours, a third of the bytes; see check_place."""
    with whole_file(path if overwrite else check_place(path)) as temporary:
        figure.savefig(temporary, dpi=dpi, bbox_inches="tight")
        with Image.open(temporary) as drawn:
            few = drawn.convert("RGB").quantize(256, dither=Image.Dither.NONE)
        few.save(temporary, format="PNG", optimize=True, pnginfo=SOFTWARE)


@dataclass(frozen=True)
class Panel:
    """Curves by name over x, with a title and labels of both axes."""

    title: str
    x: Any
    xlabel: str
    ylabel: str
    curves: Mapping[str, Any]


def draw_panels(drawn: Sequence[Panel], path: Path) -> None:
    """Numbered panels in three columns at the width of a page, the first curves red, then blue."""
    rows = -(-len(drawn) // 3)
    with matplotlib.rc_context({"font.size": 7.5}):
        figure, axes = panels(7.2, 1.9 * rows, count=3, rows=rows, squeeze=False)
        for number, (ax, one) in enumerate(zip(axes.flat, drawn), 1):
            for style, (name, row) in zip(("C3.-", "C0.-"), one.curves.items()):
                ax.plot(one.x, np.asarray(row, float), style, label=name)
            ax.set(xlabel=one.xlabel, ylabel=one.ylabel)
            ax.legend(frameon=False, fontsize=7)
            for axis, values in ("x", [*one.x]), ("y", [*one.curves.values()]):
                if np.min(values) > 0 and np.max(values) > 50 * np.min(values):
                    ax.set(**{f"{axis}scale": "log"})
            ax.set_title(f"{number} {one.title}", fontsize=8, loc="left", weight="bold")
        save_figure(figure, path, dpi=105)
