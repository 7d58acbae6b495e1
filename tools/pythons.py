"""Run the tests on every Python 3.11 or newer that this machine has, each in its own environment.

Looks on the path and among pyenv's versions. torch is taken as the index gives it, which may be a
CUDA build of several GB; --without-torch leaves it out, runs what works without it, and counts the
rest as not run.
"""

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
import xml.etree.ElementTree as ET
from pathlib import Path

from tqdm import tqdm

from warp_peri.errors import exit_status

ROOT = Path(__file__).resolve().parent.parent
OLDEST = (3, 11)
NEEDS_TORCH = "No module named 'torch'"


def interpreters() -> dict[str, Path]:
    """Interpreters by version, the first of each that is found."""
    names = [f"python3.{minor}" for minor in range(OLDEST[1], 30)]
    paths = [Path(there) for name in names if (there := shutil.which(name))]
    pyenv = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv"))
    paths += sorted(pyenv.glob("versions/*/bin/python3"))
    versions: dict[str, Path] = {}
    for path in [*paths, Path(sys.executable)]:
        said = subprocess.run([path, "-V"], capture_output=True, text=True, check=False).stdout
        match = re.fullmatch(r"Python (\d+)\.(\d+)\.(\d+)\s*", said)
        if match and tuple(map(int, match.groups()[:2])) >= OLDEST:
            versions.setdefault(".".join(match.groups()), path)
    return versions


def requirements(without_torch: bool) -> list[str]:
    """What the package and its tests need."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    needed = [*project["dependencies"], *project["optional-dependencies"]["test"]]
    return [
        requirement
        for requirement in needed
        if not (without_torch and re.match(r"torch\b", requirement))
    ]


def run(python: Path, folder: Path, tests: list[str], *, without_torch: bool) -> dict[str, int]:
    """Numbers of tests that passed, failed, were skipped, and were not run for want of torch."""
    environment = folder / "env"
    subprocess.run([python, "-m", "venv", environment], check=True)
    inside = environment / ("Scripts" if os.name == "nt" else "bin") / "python"
    install: list[str | Path] = [inside, "-m", "pip", "install", "--quiet"]
    constraints: list[str | Path] = ["--constraint", ROOT / "constraints.txt"]
    subprocess.run([*install, *requirements(without_torch), *constraints], check=True)
    report = folder / "report.xml"
    command: list[str | Path] = [
        inside,
        "-m",
        "pytest",
        "--quiet",
        "--continue-on-collection-errors",
    ]
    options = ["-p", "no:cacheprovider", f"--junit-xml={report}", f"--rootdir={ROOT}"]
    variables = os.environ | {"PYTHONPATH": str(ROOT)}
    subprocess.run(
        [*command, *options, *tests], cwd=ROOT, env=variables, check=False, capture_output=True
    )
    return counted(report)


def counted(report: Path) -> dict[str, int]:
    """Outcomes in a JUnit report."""
    count = {"passed": 0, "failed": 0, "skipped": 0, "without torch": 0}
    for case in ET.parse(report).iter("testcase"):
        wrong = [outcome for outcome in case if outcome.tag in ("failure", "error")]
        if any(
            NEEDS_TORCH in (outcome.text or "") + outcome.get("message", "") for outcome in wrong
        ):
            count["without torch"] += 1
        elif wrong:
            count["failed"] += 1
            print(f"failed: {case.get('classname')}::{case.get('name')}", file=sys.stderr)
        else:
            count["skipped" if case.find("skipped") is not None else "passed"] += 1
    return count


def main(arguments: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("tests", nargs="*", help="passed on to pytest; default: all")
    parser.add_argument("--only", nargs="+", metavar="VERSION", help="as 3.13 or 3.13.0")
    parser.add_argument("--without-torch", action="store_true")
    parser.add_argument("--json", action="store_true", help="one JSON object")
    given = parser.parse_args(arguments)
    chosen = {
        version: path
        for version, path in interpreters().items()
        if given.only is None
        or any(f"{version}.".startswith(f"{wanted}.") for wanted in given.only)
    }
    if not chosen:
        print("error: no Python 3.11 or newer of these versions here", file=sys.stderr)
        return 2
    rows = {}
    for version, path in tqdm(chosen.items(), desc="Pythons", disable=given.json or None):
        with tempfile.TemporaryDirectory() as folder:
            options = {"without_torch": given.without_torch}
            rows[version] = run(path, Path(folder), given.tests, **options)
    if given.json:
        print(json.dumps(rows))
    else:
        for version, row in rows.items():
            print(version, ", ".join(f"{name} {number}" for name, number in row.items()))
    return int(any(row["failed"] for row in rows.values()))


if __name__ == "__main__":
    sys.exit(exit_status(main))
