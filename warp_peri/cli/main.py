"""The command `warp-peri`, also `python -m warp_peri`: from dumps to a certified model and on.

Every command takes --config FILE.toml with its settings; those that write results leave such a file
beside them. --json prints one object for machines.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from warp_peri.cli import commands
from warp_peri.cli.settings_file import parse
from warp_peri.errors import InputError
from warp_peri.learning.options import DEGREES, HORIZONS, LOSSES, METHODS


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command.

    Returns the exit status: 0; 1 after a failure, such as a full disk; 2 for input that cannot be
    used; 130 after Ctrl-C.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("always")
            warnings.showwarning = _warn
            given = parse(_parser(), arguments)
            commands.check_output(given)
            result = given.run(given)
    except KeyboardInterrupt:
        print("interrupted; what is finished is kept", file=sys.stderr)
        return 130
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except (OSError, RuntimeError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    try:
        _print(given, result)
        sys.stdout.flush()
    except OSError as error:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # or Python tries at exit
        if not isinstance(error, BrokenPipeError):  # that is a reader, as `head`, who has enough
            print(f"error: {error}", file=sys.stderr)
            return 1
    if given.command == "evaluate" and all("error" in table for table in result.values()):
        return 2
    return 0


class _Defaults(argparse.ArgumentDefaultsHelpFormatter):
    """Help with the defaults of those options that have one."""

    def _get_help_string(self, action: argparse.Action) -> str | None:
        if action.default is None or action.const is True:
            return action.help
        return super()._get_help_string(action)


def _warn(message: Warning | str, *_: Any, **__: Any) -> None:
    print(f"warning: {message}", file=sys.stderr)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="warp-peri", description=__doc__)
    some = parser.add_subparsers(dest="command", required=True)

    def command(
        name: str, run: Callable[[argparse.Namespace], Any], words: str
    ) -> argparse.ArgumentParser:
        found = some.add_parser(
            name,
            help=words,
            description=run.__doc__,
            formatter_class=_Defaults,
        )
        found.set_defaults(run=run)
        found.add_argument("--config", metavar="FILE.toml", help="settings of this command")
        found.add_argument("--json", action="store_true", help="one JSON object")
        return found

    one = command("coarse-grain", commands.run_coarse_grain, "LAMMPS dumps to a data file")
    one.add_argument("dumps", nargs="+", type=Path, metavar="DUMP", help="one for each load")
    one.add_argument("--reference", required=True, type=Path, help="dump of the unloaded atoms")
    one.add_argument(
        "--force",
        required=True,
        nargs="+",
        type=Path,
        help="external forces on the atoms of each load [eV/Å], by id: .npz or .csv",
    )
    one.add_argument("--unloaded", nargs="+", type=Path, help="dump without load, one or one each")
    one.add_argument("--out", required=True, type=Path, metavar="DATA.h5")
    one.add_argument("--set", default="train", help="name of the set in the file")
    one.add_argument("--spacing", type=float, default=5.0, help="of the nodes [Å]")
    one.add_argument("--radius", type=float, default=10.0, help="of the smoothing function [Å]")
    one.add_argument("--reach", type=float, default=100.0, help="nodes lie within it [Å]")
    one.add_argument("--interior", type=float, default=50.0, help="half width of the interior [Å]")
    one.add_argument("--box", type=float, nargs=2, help="periods of the atoms [Å]")
    one.add_argument("--mass", type=float, nargs="+", help="of atom types 1, 2, …; default: equal")
    one.add_argument(
        "--thickness", type=float, help="of the sheet [Å]; default: the file's, or 3.35"
    )
    one.add_argument(
        "--density", type=float, help="mass density [kg/m³]; default: the file's, or 2200"
    )
    one.add_argument("--skip", type=int, default=0, help="frames left out at the begin")
    one.add_argument("--iota", type=float, help="ι of the smoothing in time; default: average")

    one = command("train", commands.run_train, "a data file to a certified model")
    one.add_argument("data", type=Path, metavar="DATA.h5")
    one.add_argument("--out", required=True, type=Path, metavar="FOLDER")
    one.add_argument("--set", default="train", help="what to learn from")
    one.add_argument("--noise", help="set with fields of noise alone")
    one.add_argument("--horizon", type=float, default=20.0, help="δ [Å]")
    one.add_argument("--degree", type=int, help="M of the Bernstein polynomials; default: 10")
    one.add_argument(
        "--influence",
        metavar="SHAPE",
        help="in their place gaussian, exponential or conical, whose length is learned, or a .csv "
        "file with columns r [Å], K to be taken as it is",
    )
    one.add_argument(
        "--method",
        choices=METHODS,
        default="optimum",
        help="Algorithm 1 and its optimum, Algorithm 1 alone, or the optimum alone",
    )
    one.add_argument(
        "--conditions",
        choices=("direct", "paper"),
        default="direct",
        help="solvability on the lattice, or also (i) and (iii) of the paper",
    )
    one.add_argument(
        "--zeta",
        type=float,
        default=0.01,
        help="ζ [TPa] of the condition D(k) ≥ ζ s(k) that is kept",
    )
    one.add_argument("--loss", choices=LOSSES, default="auto", help="auto: as the noise asks for")
    one.add_argument("--normalise", action="store_true", help="divide samples by their loads")
    one.add_argument("--seed", type=int, default=0, help="of the two stages' first kernel")

    one = command("certify", commands.run_certify, "what is proven of a model")
    one.add_argument("model", type=Path, metavar="MODEL.json")
    one.add_argument("--spacing", type=float, nargs="+", help="of the lattices [Å]")

    one = command("evaluate", commands.run_evaluate, "errors of a model on data sets")
    one.add_argument("model", type=Path, metavar="MODEL.json")
    one.add_argument("data", type=Path, metavar="DATA.h5")
    one.add_argument(
        "--set",
        dest="sets",
        nargs="+",
        action="extend",
        metavar="NAME",
        help="sets to evaluate; by default all, and those that cannot be are reported as errors",
    )
    _uncertified(one)

    one = command("solve", commands.run_solve, "displacement from loads")
    one.add_argument("model", type=Path, metavar="MODEL.json")
    one.add_argument("data", type=Path, metavar="DATA.h5", help="loads; displacement on the collar")
    one.add_argument("--set", default="test")
    one.add_argument("--out", required=True, type=Path, metavar="SOLVED.h5")
    one.add_argument("--method", default="auto", help="of the solver")
    _uncertified(one)

    one = command("export", commands.run_export, "for ParaView and other codes")
    one.add_argument("what", choices=("fields", "influence", "operator"))
    one.add_argument("model", type=Path, metavar="MODEL.json")
    one.add_argument(
        "--out",
        required=True,
        type=Path,
        help="folder for fields, .csv for influence, .npz for operator",
    )
    one.add_argument(
        "--format",
        choices=("vtu", "xdmf"),
        default="vtu",
        help="fields: a .vtu file a sample, or one .xdmf file with samples as time steps",
    )
    one.add_argument("--data", type=Path, metavar="DATA.h5", help="nodes, loads and collar")
    one.add_argument("--set", default="test")
    one.add_argument("--spacing", type=float, help="influence: of the lattice [Å]")
    _uncertified(one)

    one = command("sweep", commands.run_sweep, "choose horizon and degree")
    one.add_argument("data", type=Path, metavar="DATA.h5")
    one.add_argument("--out", required=True, type=Path, metavar="FOLDER")
    one.add_argument("--set", default="train", help="what to learn from")
    one.add_argument("--val", default="val", help="validation set")
    one.add_argument("--test", help="reported; takes no part in the choice")
    one.add_argument("--noise", help="set with fields of noise alone")
    one.add_argument("--horizons", type=float, nargs="+", default=list(HORIZONS), help="δ [Å]")
    one.add_argument("--degrees", type=int, nargs="+", default=list(DEGREES), help="M")
    one.add_argument("--conditions", choices=("direct", "paper"), default="direct")
    one.add_argument("--jobs", type=int, default=-1, help="processes; -1: all cores")

    one = command("info", commands.run_info, "what a model or data file holds")
    one.add_argument("file", type=Path)
    return parser


def _uncertified(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--allow-uncertified",
        action="store_true",
        help="use the model on spacings it holds no certificate for, with a warning",
    )


def _print(given: argparse.Namespace, result: dict[str, Any]) -> None:
    if given.json:
        print(json.dumps(result))
    elif given.command == "evaluate":
        _print_table(result)
    else:
        print("\n".join(commands.lines_of(result)))


def _print_table(tables: dict[str, dict[str, Any]]) -> None:
    width = max(map(len, tables))
    print(f"{'set':{width}}  samples   E_res [%]  E_res_abs [TPa/Å]   E_u [%]")
    for name, table in tables.items():
        if "error" in table:
            print(f"{name:{width}}  {table['error']}")
            continue
        count = len(table["E_u_samples"])
        print(
            f"{name:{width}}  {count:7d}  {100 * table['E_res']:10.3f}  "
            f"{table['E_res_abs']:17.3e}  {100 * table['E_u']:8.3f}"
        )
