"""Faults of physics put into the library one at a time, and which test catches each.

A fault of tools/mutants.toml has a number that stays, a file, a text that is once in it, what the
text becomes, and the statement that this breaks. Each is put into a copy of the tree, where the
tests of conformance and of gradients run and, if they pass, those of the fault's room. First all
run without a fault: what fails then would seem to catch every one. The last line counts; the exit
status is 1 where a fault survives. Numbers that the JSON file has are not run again.
"""

import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path
from typing import Annotated

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))
from tools.options import NewFile, Options
from warp_peri.core.record import read_json
from warp_peri.errors import InputError, exit_status
from warp_peri.files.atomic import write_text
from warp_peri.points.arguments import Bound

NET = ["tests/conformance", "tests/gradients"]
LEFT_OUT = shutil.ignore_patterns(".*", "__pycache__", "data", "runs", "site", "build")


def read_faults() -> dict[int, dict]:
    """The table, by number."""
    table = tomllib.loads((ROOT / "tools" / "mutants.toml").read_text(encoding="utf-8"))
    return {int(number): fault for number, fault in table.items()}


def with_fault(number: int, fault: dict, root: Path) -> tuple[str, str]:
    """The text of the fault's file, and with the fault; exits where its text is not once in it."""
    path = root / fault["file"]
    text = path.read_text(encoding="utf-8") if path.is_file() else ""
    if (count := text.count(fault["old"])) != 1:
        sys.exit(f"fault {number}: expected its text once in {fault['file']}, got it {count} times")
    return text, text.replace(fault["old"], fault["new"])


def caught_by(tests: list[str], root: Path) -> str:
    """The first test of these that fails in a tree, with its error; empty where all pass."""
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-n0", "--tb=line", *tests]
    environment = os.environ | {"PYTHONPATH": str(root)}
    run = subprocess.run(command, cwd=root, env=environment, capture_output=True, text=True)
    told = re.search(r"^(?:FAILED|ERROR) (.*)", run.stdout, re.M)
    found = told[1] if told else f"pytest ended with {run.returncode}: {run.stderr or run.stdout}"
    return found[:300] if run.returncode else ""


def main() -> None:
    faults = read_faults()
    known = Annotated[int, Bound("the number of a fault", faults.__contains__)]
    options = {
        "only": ([*faults], "faults of these numbers", known),
        "json": (Path, "what caught each fault", NewFile),
    }
    given = Options(__doc__, options=options).parse_args()
    chosen = {number: faults[number] for number in given.only}
    found = read_json(given.json) if given.json and given.json.exists() else {}
    if not isinstance(found, dict):
        raise InputError(f"{given.json}: expected tests by number of a fault, got {found!r:.60}")
    with tempfile.TemporaryDirectory() as folder:
        root = Path(shutil.copytree(ROOT, f"{folder}/tree", symlinks=True, ignore=LEFT_OUT))
        rooms = {test for fault in chosen.values() for test in fault["tests"]}
        if failure := caught_by([*NET, *sorted(rooms)], root):
            sys.exit(f"without a fault: {failure}")
        for number, fault in chosen.items():
            if (key := str(number)) not in found:
                path, (whole, wrong) = root / fault["file"], with_fault(number, fault, root)
                path.write_text(wrong, encoding="utf-8")
                found[key] = caught_by(NET, root) or caught_by(fault["tests"], root)
                path.write_text(whole, encoding="utf-8")
            print(number, found[key] or f"SURVIVES: {fault['breaks']}", flush=True)
            if given.json:
                write_text(given.json, json.dumps(found, indent=1) + "\n")
    left = [number for number in chosen if not found[str(number)]]
    print(f"caught {len(chosen) - len(left)} of {len(chosen)}; survivors: {left}")
    sys.exit(bool(left))


if __name__ == "__main__":
    sys.exit(exit_status(main))
