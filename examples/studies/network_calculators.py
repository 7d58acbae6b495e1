"""Laws and elastic constants of a network's forces, beside other tools on the same calculator.

python examples/studies/network_calculators.py Al Si                    laws of two crystals
python examples/studies/network_calculators.py --tools law matcalc matscipy    all sixty by three
python examples/studies/network_calculators.py Fe --tools phonons    its softest waves, by phonopy
python examples/studies/network_calculators.py Al Si --tools lists    small cells, 1 or 16 at a time
python examples/studies/network_calculators.py K Al --tools law listed    strained cells as a list

The network is CHGNet (pip install chgnet); its weights come with it. Each result is kept in a file
as it ends, and a second start goes on from there.
"""

import contextlib
import itertools
import json
import signal
import sys
import time
import warnings
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent.parent))

import numpy as np

import warp_peri as wp
from examples.studies.network_crystals import (
    CRYSTALS,
    SYMMETRY,
    by_lists,
    by_matcalc,
    by_matscipy,
    by_phonopy,
    listed,
    needed,
    structure,
)
from tools.options import Options
from warp_peri.errors import exit_status
from warp_peri.files.atomic import finite, plain, write_json

LIMIT = 180.0
"""Processor seconds that a tool may take for a crystal."""


class Late(BaseException):
    """Time is over; no tool catches it."""


def by_law(name: str, calculator: Any) -> dict[str, Any]:
    """Moduli [GPa] and their errors of this library, whether the law is proven, amplitudes."""
    found = wp.from_atoms(structure(name), calculator)
    told = found.content()
    return {
        "C": np.array(told["elastic_tensor_GPa"]["atoms"]),
        "errors_GPa": told["standard_errors_GPa"],
        "proven": bool(found.certificate and found.certificate.holds),
        "said": found.said,
    }


TOOLS: dict[str, Any] = {
    "law": by_law, "matcalc": by_matcalc, "matscipy": by_matscipy, "phonons": by_phonopy,
    "lists": by_lists, "listed": lambda name, calculator: by_law(name, listed(calculator)),
}  # fmt: skip


def timed(tool: str, name: str, calculator: Any) -> dict[str, Any]:
    """What a tool finds, or what it says, and seconds by the clock and of the processor."""
    begin = time.perf_counter(), time.process_time()
    signal.setitimer(signal.ITIMER_PROF, LIMIT)
    try:
        with contextlib.redirect_stdout(sys.stderr):
            found = TOOLS[tool](name, calculator)
    except Late:
        found = {"why": f"more than {LIMIT:.0f} s"}
    except Exception as error:  # tools raise whatever they run into
        found = {"why": f"{type(error).__name__}: {error}"}
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
    end = time.perf_counter(), time.process_time()
    return found | {"seconds": end[0] - begin[0], "processor": end[1] - begin[1]}


def moduli(name: str, one: dict[str, Any]) -> dict[str, float]:
    """Those [GPa] that a crystal of a symmetry has, by name; none of a tool that failed."""
    places = (11, 12, 13, 33, 44, 66) if CRYSTALS[name][0] in SYMMETRY else (11, 12, 44)
    C = one.get("C")
    return {} if C is None else {f"C{mn}": C[mn // 10 - 1][mn % 10 - 1] for mn in places}


def cell(name: str, one: dict[str, Any]) -> str:
    """Moduli with their errors, or why there are none, and seconds, as two cells of a table."""
    C, bars = moduli(name, one), one.get("errors_GPa", {})
    told = [f"{C[key]:.1f}" + (f" ± {bars[key]:.2g}" if bars else "") for key in C]
    unstable = " (unstable)" if C and np.linalg.eigvalsh(one["C"])[0] <= 0 else ""
    return f" {', '.join(told) or one['why']}{unstable} | {one['processor']:.0f} |"


def shown(found: dict[str, dict[str, Any]], tools: list[str]) -> str:
    """A table in Markdown, and how far tools are apart, over the largest modulus of a crystal."""
    lines = ["| |" + "".join(f" {tool} [GPa] | s |" for tool in tools)]
    lines.append("|---|" + "---|---|" * len(tools))
    for name, each in found.items():
        cells = "".join(cell(name, each[tool]) for tool in tools)
        lines.append(f"| {name}, {CRYSTALS[name][0]} |{cells}")
    for tool in tools:
        ends = [each[tool] for each in found.values()]
        made, took = sum("C" in one for one in ends), [one["processor"] for one in ends]
        quick = f"median {np.median(took):.0f} s, most {max(took):.0f} s"
        lines.append(f"\n{tool}: {made} of {len(ends)}, {quick}")
    for a, b in itertools.combinations(tools, 2):
        apart, within = [], []
        for name, each in found.items():
            first, second = moduli(name, each[a]), moduli(name, each[b])
            off = {key: abs(first[key] - second[key]) for key in first if second}
            apart += [max(off.values()) / max(first.values())] if off else []
            bars = each[a].get("errors_GPa", {})
            within += [off[key] <= 2 * bars[key] for key in off if bars]
        parts = ", ".join(f"{part:.1%}" for part in np.quantile(apart or [np.nan], [0.5, 0.9, 1]))
        told = f"; {np.mean(within):.0%} of moduli within two errors" if within else ""
        lines.append(f"\n{a}, {b}: apart by {parts} (median, 90 %, worst of {len(apart)}){told}")
    return "\n".join(lines)


def late(*_: Any) -> None:
    """What the alarm calls."""
    raise Late


def main(words: list[str] | None = None) -> None:
    """Run what is not there yet, and print the table."""
    parser = Options(__doc__, out="network_calculators")
    parser.add("crystals", nargs="*", default=list(CRYSTALS), metavar="NAME")
    parser.add("--tools", nargs="+", default=["law"], choices=list(TOOLS), help="that are asked")
    given = parser.parse_args(words)
    if unknown := [name for name in given.crystals if name not in CRYSTALS]:
        raise wp.InputError(f"crystals: expected of {', '.join(CRYSTALS)}, got {unknown[0]}")
    signal.signal(signal.SIGPROF, late)
    calculator, found = None, dict[str, dict[str, Any]]()
    for tool, name in itertools.product(given.tools, given.crystals):
        file = given.out / f"{name}_{tool}.json"
        if not file.is_file():
            if calculator is None:
                with contextlib.redirect_stdout(sys.stderr):
                    module = needed("chgnet.model.dynamics", "chgnet")
                    calculator = module.CHGNetCalculator(use_device="cpu")
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                write_json(file, finite(plain(timed(tool, name, calculator))))
            print(file.read_text(), file=sys.stderr, flush=True)
        found.setdefault(name, {})[tool] = json.loads(file.read_text())
    print(shown(found, given.tools))


if __name__ == "__main__":
    sys.exit(exit_status(main))
