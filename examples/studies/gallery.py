"""The gallery: one page of figures, each with the command that makes it.

    python examples/studies/gallery.py

Collects what the other examples left in runs/, draws the stress of a held-out disk from exported
fields, and writes docs/gallery.md with docs/gallery/. Figures that other pages show stay where they
are. A missing figure is named with its command, and nothing is written. Needs meshio (the extra
`export`).
"""

from __future__ import annotations

import argparse
import io
import sys
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent.parent
sys.path.insert(0, str(ROOT))

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import meshio
import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure as Canvas
from PIL import Image

from warp_peri.errors import InputError, exit_status
from warp_peri.files.atomic import whole_file, write_text

LARGEST, WIDTH = 200_000, 1000
"""A picture of more bytes is brought to this width in pixels, in 256 colours of its own."""
MAGNIFIED = 40
"""Displacements in the picture of stress are drawn this many times too large."""


@dataclass(frozen=True)
class Figure:
    """One figure of the page.

    Attributes:
        title: its heading.
        shows: one sentence.
        commands: what makes it, in order.
        path: the picture, from docs/.
        source: what it is made from, from runs/; none when another page has the picture.
    """

    title: str
    shows: str
    commands: tuple[str, ...]
    path: str
    source: str | None = None


TRAIN = "python examples/train_graphene.py"

FIGURES = (
    Figure(
        "A learned influence function",
        "K over its weighted volume, learned from graphene: it changes sign, and only its values "
        "at the bond lengths of the lattice (dots) enter the model.",
        (TRAIN,),
        "gallery/influence_function.png",
        "graphene_0K/influence.png",
    ),
    Figure(
        "Held-out disks",
        "Displacement on four disks the fit never saw: molecular statics, the model, and their "
        "difference in thousandths of an ångström.",
        (TRAIN,),
        "gallery/disks.png",
        "graphene_0K/disks.png",
    ),
    Figure(
        "The worst of them",
        "The disk of the largest error among these four.",
        (TRAIN,),
        "disk.png",
        "graphene_0K/disk.png",
    ),
    Figure(
        "Stress on a held-out disk",
        "Stress that the model predicts inside the first disk, displacement magnified "
        f"{MAGNIFIED} times; the grey mesh is the collar, where displacement is given.",
        (
            TRAIN,
            "warp-peri export fields runs/graphene_0K/model.json --data data/graphene_0K.h5 "
            "\\\n    --set test --out runs/graphene_0K/fields",
            "python examples/studies/gallery.py",
        ),
        "gallery/stress.png",
        "graphene_0K/fields/sample_0000.vtu",
    ),
    Figure(
        "Three stages of learning",
        "The training residual through the two stages of Adam and at the constrained optimum, "
        "which lies below what 10 000 steps of the second stage reach.",
        (TRAIN,),
        "gallery/loss.png",
        "graphene_0K/loss.png",
    ),
    Figure(
        "Errors by degree",
        "Training and validation errors fall with the degree of the polynomial, each at its best "
        "horizon; dashed, what You et al. (2021) printed on their own data.",
        (f"{TRAIN} --sweep",),
        "gallery/sweep_errors.png",
        "graphene_0K_sweep/sweep_errors.png",
    ),
    Figure(
        "How few numbers describe graphene?",
        "A damped wave of three parameters does on the disks what eleven of the polynomial do; "
        "the three that keep their sign fail ([more](influence.md)).",
        ("python examples/studies/influence_shapes.py",),
        "influence.png",
        "influence_shapes/shapes.png",
    ),
    Figure(
        "Does it find a kernel that is known?",
        "On manufactured fields of a solid with K = 1/r the loss falls with degree and spacing, "
        "and the learned kernel approaches 1/r as the grid is refined.",
        ("python examples/studies/manufactured.py",),
        "gallery/manufactured.png",
        "manufactured/fixed_alpha.png",
    ),
    Figure(
        "What noise leaves unsure",
        "K at the bonds, learned from runs at 300 K under three sizes of load, with bands that "
        "hold 90 % of what other noise would have given ([more](noise.md)).",
        ("python examples/studies/noise_study.py",),
        "noise/kernels.png",
    ),
    Figure(
        "A prediction with its band",
        "Displacement along the axis of a held-out disk by the model learned at a tenth of the "
        "loads, and its error within the band that noise alone explains ([more](noise.md)).",
        ("python examples/studies/noise_study.py",),
        "noise/disk.png",
    ),
    Figure(
        "The lattice, the atoms, the nodes",
        "Graphene with the cone that smooths it onto a node, its atoms under a load, and the nodes "
        "([more](papers/you_2021.md)).",
        ("python examples/studies/papers.py you_2021",),
        "papers/you_2021_atoms.png",
    ),
    Figure(
        "From a structure to a law",
        "Molybdenum disulphide from a structure and a potential: its phonons beside those of the "
        "law, Young's modulus over direction, errors on unseen loads ([more](atoms.md)).",
        ("python examples/structures.py MoS2 --picture docs/atoms.png",),
        "atoms.png",
    ),
    Figure(
        "A crystal in space",
        "Copper: acoustic branches of the atoms and of the law, and Young's modulus over direction "
        "([more](crystals.md)).",
        ("python examples/crystals.py Cu --picture docs/crystals.png",),
        "crystals.png",
    ),
    Figure(
        "A sheet that is not even",
        "A disc of boron nitride in graphene, and the maps of κ and μ that were learned from loads "
        "([more](dressed.md)).",
        ("python examples/uneven_sheet.py",),
        "uneven_sheet.png",
    ),
    Figure(
        "An answer with its error",
        "What was said of the error beside what is true, on scenes that nothing was fitted to, and "
        "a map of the likely error ([more](predict.md)).",
        ("python examples/predict.py",),
        "predict.png",
    ),
    Figure(
        "Which law over which strain",
        "Errors of graphene's laws over the strain ([more](which_law.md)).",
        ("python examples/studies/which_law.py",),
        "which_law.png",
    ),
    Figure(
        "Soft tissue with fibres",
        "A disk of an anisotropic sheet under large strain: elements, the law that was learned on "
        "squares, their difference ([more](tissue.md)).",
        ("python examples/hgo_square.py --element linear --samples 60 --disks 4",),
        "pictures/sheet.png",
    ),
    Figure(
        "A neural operator",
        "Influence function and force state that graphene's forces taught networks of the printed "
        "widths ([more](neural.md)).",
        ("python examples/neural_operator.py graphene",),
        "pictures/neural.png",
    ),
    Figure(
        "Polymer flow with memory",
        "A channel of dumbbells: exact law, learned law with its band, dumbbells in every particle "
        "([more](flow.md)).",
        ("python examples/polymer_flow.py",),
        "pictures/channel.png",
    ),
    Figure(
        "A crack that branches",
        "Share of broken bonds in a plate of glass ([more](cracks.md)).",
        ("python examples/branching.py",),
        "pictures/branching.png",
    ),
    Figure(
        "A crack in a block",
        "A penny-shaped crack: two planes through its damage, and the stress over time "
        "([more](cracks.md)).",
        ("python examples/penny_crack.py",),
        "pictures/penny.png",
    ),
    Figure(
        "Cracks in graphene",
        "Strain at which cracks open over their length: atoms (dots), and a continuum with one "
        "toughness ([more](cracks_from_atoms.md)).",
        ("python examples/cracked_graphene.py --all",),
        "pictures/graphene_cracks.png",
    ),
    Figure(
        "An inclusion",
        "A stiff disk in a soft plate under equal strain: where the error lies, and how it falls "
        "for five pairs of materials ([more](cracks.md)).",
        ("python examples/inclusion.py",),
        "gallery/inclusion.png",
        "inclusion/inclusion.png",
    ),
    Figure(
        "Grains",
        "Twins and several grains of copper: which grain, the stiffness that was learned, "
        "displacement of the atoms, error ([more](dressed.md)).",
        ("python examples/grains.py",),
        "grains.png",
    ),
    Figure(
        "Holes in a plate",
        "Stress around three holes under tension, elements along their edges ([more](bodies.md)).",
        ("python examples/plate_with_hole.py --three-holes",),
        "pictures/holes.png",
    ),
    Figure(
        "A void in a block of copper",
        "Stress that a crystal predicts, tetrahedra at its faces "
        "([more](bodies.md#crystals-in-the-plane-and-in-space)).",
        ("python examples/crystal_body.py --out docs/pictures/crystal_body.png",),
        "pictures/crystal_body.png",
    ),
    Figure(
        "A ball that swells in a block",
        "The isotropic solid in three dimensions, and its error over the spacing "
        "([more](lattices.md)).",
        ("python examples/solid_in_space.py",),
        "pictures/space.png",
    ),
    Figure(
        "Diffusion through two materials",
        "A plate with grains that conduct twenty times better, and the solution of a stationary "
        "flow through it ([more](cracks.md#diffusion)).",
        ("python examples/diffusion.py",),
        "gallery/diffusion.png",
        "diffusion/diffusion.png",
    ),
    Figure(
        "Many processes",
        "A plate solved on four ranks: its displacement, and who owns which nodes "
        "([more](ranks.md)).",
        ("mpiexec -n 4 python examples/large_plate.py --sides 128",),
        "ranks.png",
    ),
    Figure(
        "Speed against accuracy",
        "Error against time of one solve: learned models, finite elements with the true "
        "constants, and the atoms themselves ([more](speed_accuracy.md)).",
        ("python examples/studies/speed_accuracy.py",),
        "speed_accuracy.png",
    ),
    Figure(
        "Where it fails: waves",
        "The learned model, fitted to statics alone, follows the phonons of the atoms up to half "
        "of the nodes' zone and leaves them beyond ([more](stability.md)).",
        ("python examples/studies/stability_atlas.py",),
        "stability/dispersion.png",
    ),
    Figure(
        "Where it fails: another spacing",
        "A model predicts on the spacings it was trained on (1.0 is 5 Å, 0.5 is 2.5 Å) and nowhere "
        "else ([more](stability.md)).",
        ("python examples/studies/stability_atlas.py",),
        "stability/spacing.png",
    ),
)


def page() -> str:
    """The page in Markdown."""
    lines = [
        "# Gallery",
        "",
        "Look here to see what the library does before you read how. Every figure is made by the",
        "commands under it, from the root of the repository; `python examples/studies/gallery.py`",
        "puts them here.",
    ]
    for figure in FIGURES:
        lines += ["", f"## {figure.title}", "", figure.shows, ""]
        lines += [f"![{figure.title}]({figure.path})", "", "```"]
        lines += [*figure.commands, "```"]
    return "\n".join(lines) + "\n"


def collect(source: Path, path: Path) -> None:
    """A picture as it is, or what is drawn from fields; smaller where it is large for a page."""
    if source.suffix == ".vtu":
        drawn, figure = io.BytesIO(), stress(source)
        figure.savefig(drawn, dpi=100)
        plt.close(figure)
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
    """σ₁₁, σ₂₂ and σ₁₂ on the deformed interior, from a .vtu file of `warp-peri export fields`.

    A quadrilateral has the mean of its corners; it is drawn where all four are interior.
    """
    mesh = meshio.read(source)
    data = mesh.point_data
    x = mesh.points[:, :2] + MAGNIFIED * data["displacement"][:, :2]
    quads = mesh.cells_dict["quad"]
    inside = data["interior"][quads].all(axis=1)
    values = 1e3 * data["stress"][quads[inside]].mean(axis=1)
    limit = np.abs(values).max()
    figure, axes = plt.subplots(1, 3, figsize=(10.5, 3.5), sharey=True, layout="constrained")
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
        ax.set_aspect("equal")
        ax.set_title(name)
        ax.set_xlabel("x₁ [Å]")
    axes[0].set_ylabel("x₂ [Å]")
    figure.colorbar(faces, ax=axes, label="stress [GPa]", shrink=0.85)
    return figure


def main(arguments: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=Path, default=ROOT / "runs", help="of the other examples")
    parser.add_argument("--out", type=Path, default=ROOT / "docs", help="default: docs/")
    given = parser.parse_args(arguments)
    for figure in FIGURES:
        needed = given.runs / figure.source if figure.source else given.out / figure.path
        if not needed.exists():
            made = " && ".join(c for c in figure.commands if "gallery.py" not in c)
            raise InputError(f"{needed}: no such file; it is made by: {made}")
    for figure in FIGURES:
        if figure.source:
            collect(given.runs / figure.source, given.out / figure.path)
    write_text(given.out / "gallery.md", page())
    return 0


if __name__ == "__main__":
    sys.exit(exit_status(main))
