"""What each command says of itself and takes: one table of text, from which the parsers are made.

The first line of a command is its sentence, the second an example; then come groups of options. An
option is a line: its name, the names of its values, and its help behind two blanks; lines indented
further go on. `V+` is one value or more, `V?` one or none, `a|b` a choice, `=x` the default, `!`
required, `@dest` the name in the settings. Without a value it is a switch.
"""

from __future__ import annotations

import re
from argparse import ArgumentParser
from pathlib import Path
from typing import Any

from warp_peri.learning import DEGREES, HORIZONS, LAWS, LOSSES, METHODS

AXIS = """\
  --axis DEGREES  angle of the crystal's axis from the nodes' x axis [degrees], for models that
    depend on direction (default: that of the file)"""
UNCERTIFIED = """\
  --allow-uncertified  use the model on spacings without a certificate, with a warning
  --no-transfer @transfer  refuse lattices that the model itself is not certified on"""
UNITS = """\
  --units LENGTH STRESS  units to convert the data to, as: nm GPa (default: those of the file)"""
NOISE = "  --noise NAME  name of a set with fields of noise alone (default: none)"
LOADS = "  --set NAME =test  name of the set with the loads"
DATA = "  data DATA.h5  data file"
MODEL = "  model MODEL.json  file of a model that was learned"

COMMANDS = {
    "coarse-grain": """\
Smooth LAMMPS dumps to displacement and load on nodes, in a data file.
load1.dump load2.dump --reference rest.dump --force load1.csv load2.csv --out mine.h5
input
  dumps DUMP+  dumps of the loaded atoms, one for each load
  --reference DUMP !  dump of the unloaded atoms; its first frame is the reference
  --force FILE+ !  external forces on the atoms [eV/Å], a .npz or .csv file for each load, rows in
    the order of the atoms' ids
  --unloaded DUMP+  dumps without load that are subtracted, one or one for each load (default: none)
  --box LX LY  periods of the atoms [Å] (default: the body is free)
  --mass MASS+  masses of the atom types 1, 2, … (default: equal)
  --thickness T  thickness of the sheet [Å], by which forces become stresses; a new DATA.h5 needs
    it (default: that in DATA.h5)
  --density RHO  mass density [kg/m³]; a new DATA.h5 needs it (default: that in DATA.h5)
  --skip N =0  number of frames left out at the beginning of each dump
model
  --spacing H =5.0  distance of the nodes [Å]
  --radius R =10.0  radius of the smoothing function [Å]
  --reach L =100.0  half width of the region covered with nodes [Å]; at least interior + 2 × horizon
  --interior A =50.0  half width of the interior [Å]
  --iota I  weight ι of each frame in the smoothing in time (default: plain average)
output
  --out DATA.h5 !  data file, made or extended
  --set NAME =train  name of the set in the data file""",
    "learn": """\
Learn an elastic model of a crystal from its structure and a potential.
Al.cif --calculator ase.calculators.emt:EMT --out runs/al
input
  structure STRUCTURE  crystal in any file that ASE reads; without --calculator a phonopy.yaml or
    its folder
  --calculator NAME  potential: lammps:"pair_style sw", or an ASE calculator as
    ase.calculators.emt:EMT, with arguments in parentheses (default: force constants of phonopy)
  --potential NAME  file of a LAMMPS potential, or the name of one that LAMMPS ships (default: none)
  --trust  accept a calculator that can run code from the file of --config
  --thickness T  thickness of a sheet [Å] (default: outermost nuclei and a van der Waals radius
    beyond)
  --hold STRAIN+ =[]  strains not relaxed, of xx yy zz yz xz xy, or all (default: none)
  --symmetry NAME =auto  point group of the crystal; auto asks spglib
model
  --spacing H  distance of the nodes [Å] (default: by the cell)
  --horizon L  horizon δ [Å] (default: 3 spacings for a sheet, √6 spacings for a solid)
  --supercell N N N  repeats of the cell (default: until the forces end)
  --units NAME+ =angstrom,GPa  units of the model: a pair, as nm GPa, or ase, metal, si
output
  --out FOLDER !  folder for model.json, learn.json, report.txt and law.png""",
    "dic": """\
Learn the material of a thin sheet from frames of digital image correlation.
examples/frames --pixel 0.012mm --out runs/sheet
input
  folder FRAMES  folder with a table of x, y, u, v for each frame
  --pixel NAME =1  length of the tables' unit, as 0.012mm, or the unit alone, as mm
  --positions reference|current  frame that the positions belong to (default: found from the tables)
  --count N =7  number of frames that are used
  --smooth R =0.0  radius of the fits that smooth the fields, in spacings
  --stress S+ =[]  pull over width, edge to edge, and mean thickness at rest [MPa], of the last
    frame or of each (default: stresses are scaled)
  --along x|y =x  direction of the pull of --stress
model
  --fibres N =0  try families of fibres too, looked for in N directions, at least 8; 0 for none
  --even  do not try a thickness that varies over the sheet
output
  --out FOLDER !  folder for material.json, dic.json, curves.png, curves.csv and material.feb""",
    "train": f"""\
Learn a model from a data file, prove it and measure its errors.
data/graphene_0K.h5 --horizon 12.5 --degree 5 --out runs/first
input
{DATA}
  --set NAME =train  name of the set to learn from
{NOISE}
{UNITS}
  --normalise  divide each sample by the size of its load
model
  --law {"|".join(LAWS)} =lps  material model: linear peridynamic solid, crystal model, or
    crystal model with third-order constants above 1 % strain
  --horizon L  horizon δ, in the data's unit of length (default: 20 Å)
  --degree M  degree of the Bernstein polynomials of the influence function (default: 10)
  --influence NAME  gaussian, exponential or conical, whose length is learned, or a .csv file with
    columns r [Å], K (default: Bernstein polynomials)
  --method {"|".join(METHODS)} =optimum  Adam to the optimum and its check, Algorithm 1 of You et
    al. 2021, or the optimum alone
  --conditions direct|paper =direct  prove solvability on the lattice, or conditions (i) and (iii)
    of You et al. 2021 too
  --zeta Z  stability margin: smallest stiffness of any wave over that of the Laplacian [TPa]
    (default: 0.0161 of the stiffness of the data)
  --loss {"|".join(LOSSES)} =auto  loss of the fit; auto chooses by the noise
  --seed N =0  seed of the first influence function of --method two-stage
output
  --out FOLDER !  folder for model.json, metrics.json and train.toml
  --overwrite  replace a model in FOLDER that other settings gave""",
    "certify": f"""\
Say what is proven of a model.
runs/first/model.json
input
{MODEL}
  --spacing H+  distances of the nodes to prove it on [Å] (default: that of the training data)""",
    "evaluate": f"""\
Measure the errors of a model on sets of a data file.
runs/first/model.json data/graphene_0K.h5 --set val test
input
{MODEL}
{DATA}
  --set @sets NAME+  names of the sets (default: all; those that cannot be used are reported)
{AXIS}
model
{UNCERTIFIED}""",
    "solve": f"""\
Solve for the displacement under loads, on the nodes of a data file or of a body.
runs/first/model.json data/graphene_0K.h5 --set test --out runs/first/disks.h5
input
{MODEL}
  data DATA.h5?  data file with loads, and displacement on the collar
{LOADS}
{AXIS}
model
  --method auto|lu|gmres|multigrid|sine|strip =auto  linear solver; auto takes the one that fits
{UNCERTIFIED}
output
  --out FILE !  file for the displacement: SOLVED.h5, or SOLVED.vtu for a body
a body with an outline, in place of DATA.h5
  --body MESH  mesh of the body, as of Gmsh (default: none)
  --units LENGTH STRESS  units of the mesh, the numbers and the answer (default: those of the model)
  --hold PART=ux,uy+ =[]  displacement of a part in --units; - leaves one free (default: none)
  --pull PART=tx,ty+ =[]  force per area on a part of the boundary, in --units (default: none)
  --spacing H  distance of the nodes inside (default: the coarsest that works)
  --overlap L  width that elements and nodes share (default: two horizons, four for a crystal)""",
    "predict": f"""\
Predict the displacement under loads, with its error.
ensemble.json data/graphene_0K.h5 --tolerance 0.01
input
  model ENSEMBLE.json  file of an ensemble that was learned
{DATA}
{LOADS}
{AXIS}
model
  --tolerance E =0.01  relative error of displacement to reach, as a fraction; 0 for the best answer
{UNCERTIFIED}""",
    "export": f"""\
Solve under the loads of a data file and write the fields for ParaView.
runs/first/model.json data/graphene_0K.h5 --out runs/first/fields
input
{MODEL}
{DATA}
{LOADS}
{AXIS}
model
{UNCERTIFIED}
output
  --out FOLDER !  folder for the files""",
    "sweep": f"""\
Choose horizon and degree by the errors on a validation set.
data/graphene_0K.h5 --test test --horizons 12.5 20 --degrees 5 10 --out runs/sweep
input
{DATA}
  --set NAME =train  name of the set to learn from
  --val NAME =val  name of the validation set
  --test NAME  name of a set that is reported and takes no part in the choice (default: none)
{NOISE}
{UNITS}
model
  --horizons L+  horizons δ [Å] (default: {" ".join(map(str, HORIZONS))})
  --degrees M+  degrees of the Bernstein polynomials (default: {" ".join(map(str, DEGREES))})
  --conditions direct|paper =direct  conditions of each fit, as in `train`
  --jobs N =-1  number of processes; -1 for all cores
output
  --out FOLDER !  folder for sweep.json and the models""",
    "info": """\
Say what a model, a data file or a mesh holds.
runs/first/model.json
input
  file FILE  model, data file or mesh""",
}
"""What each command is for, and its options; `commands` has a function run_NAME for each."""

PATHS = ("DUMP", "FILE", "FOLDER", "FRAMES", "MESH", "PATH", "STRUCTURE")
WORDS = ("NAME", "STRAIN", "LENGTH", "STRESS")
COUNTS = ("N", "M")
"""Names of values that are paths, as are those with an ending; text; whole numbers; else reals."""


def described(name: str) -> tuple[str, str]:
    """The sentence of a command and an example of its line."""
    sentence, example, *_ = COMMANDS[name].splitlines()
    return sentence, f"warp-peri {name} {example}"


def add_options(command: ArgumentParser, name: str) -> None:
    """Give a parser the options of a command, in their groups."""
    group = command.add_argument_group()  # the text has one before the first option
    for line in COMMANDS[name].replace("\n    ", " ").splitlines()[2:]:
        if not line.startswith("  "):
            group = command.add_argument_group(line)
            continue
        spec, text = re.split(r" {2,}", line.strip(), maxsplit=1)
        option, *marks = spec.split()
        group.add_argument(option, help=text.replace("%", "%%"), **_taken(option, marks))


def _taken(option: str, marks: list[str]) -> dict[str, Any]:
    """How argparse takes an option, from the marks between its name and its help."""
    how: dict[str, Any] = {}
    named: list[str] = []
    default = None
    for mark in marks:
        if mark == "!":
            how["required"] = True
        elif mark[0] == "=":
            default = mark[1:]
        elif mark[0] == "@":
            how["dest"] = mark[1:]
        elif "|" in mark:
            how["choices"] = mark.split("|")
        else:
            named.append(mark)
    if named:
        first = named[0].rstrip("+?")
        how["type"] = _kind(first)
        how["metavar"] = tuple(named) if len(named) > 1 else first
        if len(named) > 1:
            how["nargs"] = len(named)
        elif named[0] != first:
            how["nargs"] = named[0][-1]
            if named[0][-1] == "+" and option.startswith("--"):
                how["action"] = "extend"
    elif "choices" not in how:
        how["action"] = "store_false" if option.startswith("--no-") else "store_true"
    if default is not None and "," in default:  # replaced, not added to, by what is typed
        how |= {"default": default.split(","), "action": "store"}
    elif default is not None:
        how["default"] = [] if default == "[]" else how.get("type", str)(default)
    return how


def _kind(value: str) -> Any:
    if value in PATHS or "." in value:
        return Path
    return str if value in WORDS or "=" in value else int if value in COUNTS else float
