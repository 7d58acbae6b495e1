"""Laws and elastic constants of a network's forces, beside other tools on the same calculator.

python examples/studies/network_calculators.py                          a table
python examples/studies/network_calculators.py Al Si --json             one object on stdout
python examples/studies/network_calculators.py --with matcalc matscipy  their moduli too

The network is CHGNet (pip install chgnet); its weights come with it.
"""

import contextlib
import importlib
import json
import sys
import time
import warnings
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent.parent))

import ase
import ase.build
import numpy as np
from ase.filters import FrechetCellFilter
from ase.optimize import BFGS
from ase.units import GPa

import warp_peri as wp
from tools.options import Options
from warp_peri.errors import exit_status

CRYSTALS: dict[str, dict[str, Any]] = {
    "Al": {}, "Cu": {}, "W": {}, "Si": {}, "Mg": {},
    "MgO": {"crystalstructure": "rocksalt", "a": 4.21},
    "NaCl": {"crystalstructure": "rocksalt", "a": 5.64},
    "GaAs": {"crystalstructure": "zincblende", "a": 5.65},
}  # fmt: skip
"""Names, and what `ase.build.bulk` does not know of them."""
TOLD = ("noise", "displacements", "rough", "both", "moduli, force constants alone",
        "moduli, finite strains alone", "force constants")  # fmt: skip
QUIET = 0.01
"""Forces [eV/Å] that the other tools relax to; matcalc's default is 0.1, without relaxed ions."""


def needed(module: str, package: str) -> Any:
    """A module that this study needs and the library does not; InputError without it."""
    try:
        return importlib.import_module(module)
    except ImportError:
        raise wp.InputError(f"{package}: expected it here; pip install {package}") from None


def network() -> Any:
    """CHGNet on the processor, loaded once."""
    module = needed("chgnet.model.dynamics", "chgnet")
    with contextlib.redirect_stdout(sys.stderr):
        return module.CHGNetCalculator(use_device="cpu")


def law(name: str, calculator: Any) -> dict[str, Any]:
    """The law, or why there is none; moduli [GPa], their errors, amplitudes, seconds."""
    begin = time.perf_counter(), time.process_time()
    try:
        found = wp.from_atoms(ase.build.bulk(name, **CRYSTALS[name]), calculator)
    except wp.InputError as error:
        made: dict[str, Any] = {"law": False, "why": str(error)}
    else:
        figures = found.content()
        made = {
            "law": True,
            "proven": bool(found.certificate and found.certificate.holds),
            "moduli_GPa": figures["moduli_GPa"]["atoms"],
            "errors_GPa": figures["standard_errors_GPa"],
            "said": {key: found.said[key] for key in TOLD if key in found.said},
        }
    end = time.perf_counter(), time.process_time()
    return made | {"seconds": end[0] - begin[0], "processor": end[1] - begin[1]}


def of_matcalc(name: str, calculator: Any) -> np.ndarray:
    """Voigt matrix [GPa] by matcalc, ions relaxed."""
    tool = needed("matcalc", "matcalc").ElasticityCalc(
        calculator, fmax=QUIET, relax_deformed_structures=True, units_GPa=True
    )
    found = tool.calc(ase.build.bulk(name, **CRYSTALS[name]))
    return np.array(found["elastic_tensor"].voigt)


def of_matscipy(name: str, calculator: Any) -> np.ndarray:
    """Voigt matrix [GPa] by matscipy, ions relaxed."""
    tool = needed("matscipy.elasticity", "matscipy")
    cell = ase.build.bulk(name, **CRYSTALS[name])
    cell.calc = calculator
    moving: Any = FrechetCellFilter(cell)
    BFGS(moving, logfile=None).run(fmax=QUIET / 10, steps=200)
    how: dict[str, Any] = {"verbose": False, "graphics": False, "logfile": None, "fmax": QUIET}
    symmetry = "trigonal_high" if name == "Mg" else "cubic"
    C, _ = tool.fit_elastic_constants(cell, symmetry, 5, 0.005, BFGS, **how)
    return np.array(C) / GPa


RIVALS: dict[str, Any] = {"matcalc": of_matcalc, "matscipy": of_matscipy}


def beside(tool: str, name: str, calculator: Any) -> dict[str, Any]:
    """Moduli [GPa] of another tool, or what it says, and seconds."""
    begin, places = time.perf_counter(), ("C11", "C12", "C13", "C33", "C44")
    try:
        with contextlib.redirect_stdout(sys.stderr):
            C = RIVALS[tool](name, calculator)
        told: Any = {"moduli_GPa": {key: C[int(key[1]) - 1, int(key[2]) - 1] for key in places}}
    except Exception as error:  # tools raise whatever they run into
        told = {"why": f"{type(error).__name__}: {error}"}
    return told | {"seconds": time.perf_counter() - begin}


def shown(found: dict[str, dict[str, Any]]) -> str:
    """A table in Markdown."""
    tools = [tool for tool in RIVALS if tool in next(iter(found.values()))]
    lines = ["| | moduli ± standard error [GPa] | s |" + "".join(f" {t} | s |" for t in tools),
             "|" + "---|" * (3 + 2 * len(tools))]  # fmt: skip
    for name, one in found.items():
        C, bars = one.get("moduli_GPa", {}), one.get("errors_GPa", {})
        told = ", ".join(f"{key} {C[key]:.1f} ± {bars[key]:.1f}" for key in C) or one["why"]
        line = f"| {name} | {told} | {one['seconds']:.0f} |"
        for tool in tools:
            theirs = one[tool].get("moduli_GPa", {})
            rival = ", ".join(f"{theirs[key]:.1f}" for key in C or theirs if key in theirs)
            line += f" {rival or one[tool]['why']} | {one[tool]['seconds']:.0f} |"
        lines.append(line)
    return "\n".join(lines)


def main(words: list[str] | None = None) -> None:
    """Print the table, or JSON."""
    parser = Options(__doc__)
    parser.add("crystals", nargs="*", default=list(CRYSTALS), metavar="NAME")
    parser.add("--with", nargs="+", default=[], choices=list(RIVALS), dest="tools", help="beside")
    parser.add("--json", action="store_true", help="print all figures as JSON")
    given = parser.parse_args(words)
    if unknown := [name for name in given.crystals if name not in CRYSTALS]:
        raise wp.InputError(f"crystals: expected of {', '.join(CRYSTALS)}, got {unknown[0]}")
    calculator, found = network(), {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for name in given.crystals:
            found[name] = law(name, calculator)
            for tool in given.tools:
                found[name][tool] = beside(tool, name, calculator)
            print(f"{name} {json.dumps(found[name])}", file=sys.stderr, flush=True)
    print(json.dumps(found, indent=1) if given.json else shown(found))


if __name__ == "__main__":
    sys.exit(exit_status(main))
