"""Calculators of forces by what is typed for them."""

from __future__ import annotations

import ast
import importlib
import os
from collections.abc import Sequence
from typing import Any

from warp_peri.errors import InputError
from warp_peri.structures.lammps import lammps_calculator


def named_calculator(
    name: str, symbols: Sequence[str], potential: str | os.PathLike[str] | None = None
) -> Any:
    """An ASE calculator by name.

    Args:
        name: "lammps:pair_style sw", or "module:Class" or "module:function" with arguments behind
            it, as "ase.calculators.lj:LennardJones(sigma=3.4, epsilon=0.0104, rc=9.0)".
        symbols: of the atoms that it will see.
        potential: file of a LAMMPS potential.

    Raises InputError for a name that leads to no calculator, LammpsError without LAMMPS.
    """
    module, _, call = name.partition(":")
    if module == "lammps":
        return lammps_calculator(call, symbols, potential)
    if potential is not None:
        raise InputError(f"potential: it goes with lammps:…, got {name!r}")
    try:
        tree = ast.parse(call, mode="eval").body
        if isinstance(tree, ast.Call):
            path = ast.unparse(tree.func)
            arguments = [ast.literal_eval(argument) for argument in tree.args]
            options = {str(o.arg): ast.literal_eval(o.value) for o in tree.keywords}
        else:
            path, arguments, options = call, [], {}
        made: Any = importlib.import_module(module)
        for part in path.split("."):
            made = getattr(made, part)
        calculator = made(*arguments, **options)
    except Exception as error:  # constructors raise whatever they miss
        raise InputError(
            'calculator: expected lammps:"pair_style …" or module:Class(arguments), as '
            f"ase.calculators.emt:EMT, got {name!r} ({error})"
        ) from None
    if not hasattr(calculator, "get_property") and not hasattr(calculator, "get_forces"):
        raise InputError(f"calculator: {name!r} makes no ASE calculator")
    return calculator
