"""`python -m warp_peri evaluate MODEL.json DATA.h5`: errors of a model on the sets of a file."""

from __future__ import annotations

import argparse
import json
import sys
import warnings
from pathlib import Path
from typing import Any

from warp_peri.dataset import load_dataset
from warp_peri.errors import InputError
from warp_peri.model import load_model
from warp_peri.validation import evaluate


def main(arguments: list[str] | None = None) -> int:
    """Run the command; returns the exit status: 0, or 2 for input that cannot be used."""
    parser = argparse.ArgumentParser(prog="python -m warp_peri", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    command = commands.add_parser("evaluate", help="errors of a model on data sets")
    command.add_argument("model", type=Path, metavar="MODEL.json")
    command.add_argument("data", type=Path, metavar="DATA.h5")
    command.add_argument(
        "--set",
        dest="sets",
        nargs="+",
        action="extend",
        metavar="NAME",
        help="sets to evaluate (default: all; those that cannot be are reported as errors)",
    )
    command.add_argument(
        "--allow-uncertified",
        action="store_true",
        help="use the model on spacings it holds no certificate for, with a warning",
    )
    command.add_argument("--json", action="store_true", help="one JSON object keyed by set")
    given = parser.parse_args(arguments)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("always")
            warnings.showwarning = _warn
            tables = _evaluate(given)
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    if given.json:
        print(json.dumps(tables))
    else:
        _print_table(tables)
    return 0 if any("error" not in table for table in tables.values()) else 2


def _warn(message: Warning | str, *_: Any, **__: Any) -> None:
    print(f"warning: {message}", file=sys.stderr)


def _evaluate(given: argparse.Namespace) -> dict[str, dict[str, Any]]:
    model, data = load_model(given.model), load_dataset(given.data)
    tables: dict[str, dict[str, Any]] = {}
    for name in given.sets or data:
        points = data[name]
        try:
            tables[name] = evaluate(model, points, allow_uncertified=given.allow_uncertified)
        except InputError as error:
            if given.sets:
                raise InputError(f"set '{name}': {error}") from None
            tables[name] = {"error": str(error)}
    return tables


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


if __name__ == "__main__":
    sys.exit(main())
