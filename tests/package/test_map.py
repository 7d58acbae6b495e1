"""The map of the library on the pages: every folder is there, and its use runs."""

import re
import shlex
from pathlib import Path

import numpy as np
import pytest

import warp_peri
from tests.package.test_order import ROOT
from tests.support.problems import kernel, lattice, manufactured
from warp_peri.cli.main import main
from warp_peri.points.dataset import save_dataset

PAGES = [
    page.read_text(encoding="utf-8")
    for page in sorted(
        (ROOT.parent / "docs").rglob("*.md"), key=lambda page: "archive" in page.parts
    )
]
PAGE = next(text for text in PAGES if "\n| `files/` |" in text)
USES = {
    wing: re.findall(r"`([^`]*)`", use)
    for wing, use in re.findall(r"^\| `(?!warp_peri)([a-z_]+)/` \|[^|]*\|(.*)\|$", PAGE, re.M)
}


def test_map_names_every_folder():
    assert set(USES) == {path.parent.name for path in ROOT.glob("*/__init__.py")}
    assert all(len(lines) <= 3 for lines in USES.values())


@pytest.mark.filterwarnings("ignore:strain")
def test_every_use_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    body = lattice(6, 12.5, 5.0)
    atoms = np.random.default_rng(0).uniform(-40, 70, (4000, 2))
    known = {"np": np, "warp_peri": warp_peri, "x": body.x, "interior": body.interior}
    samples = manufactured(kernel("1/r", 12.5, spacing=5.0), body, 6, wave_number=0.2)
    known |= {"u": 0.1 * samples.u, "b": 0.1 * samples.b, "atoms": atoms, "r": np.ones(1)}
    known |= {"d": np.zeros((1, len(atoms), 2)), "f": np.ones((1, len(atoms), 2))}
    for wing, lines in USES.items():
        if wing != "cli":
            exec("\n".join(lines), known)
    assert known["certificate"].holds
    assert known["motion"].drift < 1e-9
    save_dataset("mine.h5", known["data"])
    for command in USES["cli"]:
        assert main([*shlex.split(command)[1:], "--degree", "2"]) == 0
    assert Path("runs/mine/model.json").exists()
