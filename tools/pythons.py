"""Run the tests on every Python 3.11 or newer that this machine has, each in its own environment.

Looks on the path and among pyenv's versions. torch is taken as the index gives it, which may be a
CUDA build of several GB. --torch system takes the interpreter's own, as Debian's python3-torch;
--torch none leaves it out, runs what works without it, and counts the rest as not run. --wheel
builds wheel and sdist, installs each alone into a fresh environment, and runs a smoke test there:
import, command, a sheet in equilibrium.
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
from collections.abc import Collection
from pathlib import Path

from tqdm import tqdm

from warp_peri.errors import exit_status

ROOT = Path(__file__).resolve().parent.parent
OLDEST = (3, 11)
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
NEEDS_TORCH = "No module named 'torch'"
SMOKE = {
    "import": "import warp_peri",
    "command": """
import pathlib, subprocess, sys

command = pathlib.Path(sys.executable).with_name("warp-peri")
assert b"train" in subprocess.run([command, "--help"], check=True, capture_output=True).stdout
""",
    "solve": """
import numpy as np
import warp_peri as wp

model = wp.Model(0.3, 0.7, 1.0, np.ones(1), horizon=2.0, certified_on=(1.0,))
x = np.argwhere(np.ones((15, 15))) - 7.0
points = wp.Points(x, np.abs(x).max(axis=1) <= 3, spacing=1.0)
u = wp.solve(model, wp.Dirichlet(points, None, 0.01 * x)).u
assert np.abs(u - 0.01 * x).max() < 1e-9, "a homogeneous stretch is in equilibrium"
""",
}
"""What an installed package has to do, one program each."""


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


def requirements(torch: str) -> list[str]:
    """What the package and its tests need, torch only where it is that of the index."""
    needed = [*PROJECT["dependencies"], *PROJECT["optional-dependencies"]["test"]]
    return [
        requirement
        for requirement in needed
        if torch == "index" or not re.match(r"torch\b", requirement)
    ]


def fresh(python: Path, folder: Path, torch: str, needed: Collection[str]) -> Path:
    """The interpreter of a new environment that has these of the requirements, no more."""
    system = ["--system-site-packages"] if torch == "system" else []
    subprocess.run([python, "-m", "venv", *system, folder / "env"], check=True)
    inside = folder / "env" / ("Scripts" if os.name == "nt" else "bin") / "python"
    packages = [name for name in requirements(torch) if name in needed]
    install: list[str | Path] = [inside, "-m", "pip", "install", "--quiet", *packages]
    subprocess.run([*install, "--constraint", ROOT / "constraints.txt"], check=True)
    return inside


def run(python: Path, folder: Path, tests: list[str], torch: str) -> dict[str, int]:
    """Numbers of tests that passed, failed, were skipped, and were not run for want of torch."""
    inside = fresh(python, folder, torch, requirements(torch))
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


def smoked(inside: Path, folder: Path, package: Path) -> list[str]:
    """Outcome of each program of SMOKE with a package, installed in place of another."""
    install: list[str | Path] = [inside, "-m", "pip", "install", "--quiet", "--no-deps"]
    subprocess.run([*install, "--force-reinstall", package], check=True)
    said = []
    for program in SMOKE.values():
        done = subprocess.run(
            [inside, "-c", program], cwd=folder, capture_output=True, text=True, check=False,
            env={name: value for name, value in os.environ.items() if name != "PYTHONPATH"},
        )  # fmt: skip
        needs = "needs torch" if NEEDS_TORCH in done.stderr else "failed"
        said.append(needs if done.returncode else "ok")
        if said[-1] == "failed":
            print(done.stderr, file=sys.stderr)
    return said


def smoke(chosen: dict[str, Path], torch: str) -> int:
    """Print what wheel and sdist do on each Python; 1 where something fails."""
    print("| Python | package | torch | " + " | ".join(SMOKE) + " |")
    print("|---|---|---|" + "---|" * len(SMOKE))
    failed = False
    with tempfile.TemporaryDirectory() as made:
        build: list[str | Path] = [sys.executable, "-m", "build", "--outdir", Path(made), ROOT]
        subprocess.run(build, check=True, stdout=subprocess.DEVNULL)
        for version, python in chosen.items():
            with tempfile.TemporaryDirectory() as folder:
                inside = fresh(python, Path(folder), torch, PROJECT["dependencies"])
                for package in sorted(Path(made).iterdir(), reverse=True):
                    said = smoked(inside, Path(folder), package)
                    kind = "wheel" if package.suffix == ".whl" else "sdist"
                    print("|", " | ".join([version, kind, torch, *said]), "|", flush=True)
                    failed = failed or "failed" in said
    return int(failed)


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
    parser.add_argument("--torch", choices=("index", "system", "none"), default="index")
    parser.add_argument(
        "--wheel", action="store_true", help="smoke test of wheel and sdist instead"
    )
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
    if given.wheel:
        return smoke(chosen, given.torch)
    rows = {}
    for version, path in tqdm(chosen.items(), desc="Pythons", disable=given.json or None):
        with tempfile.TemporaryDirectory() as folder:
            rows[version] = run(path, Path(folder), given.tests, given.torch)
    if given.json:
        print(json.dumps(rows))
    else:
        for version, row in rows.items():
            print(version, ", ".join(f"{name} {number}" for name, number in row.items()))
    return int(any(row["failed"] for row in rows.values()))


if __name__ == "__main__":
    sys.exit(exit_status(main))
