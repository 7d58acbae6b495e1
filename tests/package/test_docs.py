"""The snippets of the pages run as they are printed."""

import re
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

import warp_peri
from tests.support.problems import lattice, manufactured
from warp_peri.cli.main import main
from warp_peri.materials.influence import InfluenceFunction, exponential

DOCS = Path(__file__).parent.parent.parent / "docs"
PAGES = {
    page.relative_to(DOCS).as_posix().removesuffix(".md"): page.read_text(encoding="utf-8")
    for page in sorted(DOCS.rglob("*.md"))
}
"""Text of each page by its path below docs/, without suffix."""
API = ("api", "reference/api/")


def snippets(page):
    return re.findall(r"```python\n(.*?)```", PAGES[page], re.DOTALL)


@pytest.fixture(scope="module")
def points():
    """Fields in equilibrium with a known solid on a lattice of 5 Å."""
    shape = InfluenceFunction(exponential, {"length": 9.0})
    model = shape.model(lam=0.2, mu=0.3, horizon=20.0, spacings=[5.0])
    with pytest.warns(UserWarning, match="certified on no spacing"):
        return manufactured(
            model, lattice(13, 20.0, 5.0), 4, wave_number=0.2, allow_uncertified=True
        )


def test_csv_files_of_fields_become_a_data_set_that_trains(points, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "fields").mkdir()
    for s in range(len(points)):
        rows = np.hstack([points.x, points.u[s], points.b[s]])
        name = tmp_path / "fields" / f"load{s}.csv"
        np.savetxt(name, rows, delimiter=",", header="x,y,u_x,u_y,b_x,b_y", comments="")
    (snippet,) = (found for found in snippets("how-to/arrays") if ".glob(" in found)
    exec(compile(snippet, "arrays.md", "exec"), {})
    loaded = warp_peri.load("mine.h5")["train"]
    assert loaded.interior.sum() == 13**2
    np.testing.assert_allclose(loaded.u, points.u, rtol=1e-12)
    line = "train mine.h5 --horizon 20 --influence exponential --out runs/mine --json"
    assert main(line.split()) == 0
    model = warp_peri.load("runs/mine/model.json")
    assert (model.lam, model.mu) == pytest.approx((0.2, 0.3), rel=1e-5)
    assert model.provenance["influence"]["parameters"]["length"] == pytest.approx(9.0, rel=1e-5)


def test_the_api_lists_every_public_name():
    """Each `:::` of the pages with its members; a public module without members has its __all__."""
    page = "\n".join(text for name, text in PAGES.items() if name.startswith(API))
    shown = set()
    for block in page.split("\n::: ")[1:]:
        path, options = block.split("\n\n")[0].split("\n", 1)
        members = re.search(r"members: \[(.*)\]", options)
        module = import_module(path)
        names = members[1].split(", ") if members else getattr(module, "__all__", vars(module))
        for name in names:
            assert getattr(module, name, None) is not None, f"{path}.{name}"
            shown.add(getattr(module, name) if callable(getattr(module, name)) else name)
    for module in (warp_peri, *(getattr(warp_peri, name) for name in warp_peri._MODULES)):
        for name in getattr(module, "__all__", ()):
            assert getattr(module, name) in shown, f"{module.__name__}.{name}"


def test_every_page_is_in_the_menu():
    menu = (DOCS.parent / "mkdocs.yml").read_text(encoding="utf-8").split("\nnav:\n")[1]
    named = set(re.findall(r"^ +- (?:[^:\n]+: )?(\S+)\.md$", menu, re.MULTILINE))
    assert {*PAGES} == named


def test_what_says_how_has_no_studies():
    for page, text in PAGES.items():
        if page.startswith(("tutorials/", "how-to/")):
            assert "Studies" not in re.findall(r"^## (.+)$", text, re.MULTILINE), page


def test_every_page_opens_with_its_title_and_shows_small_pictures():
    """Small ones: but for the papers, whose figures have many panels."""
    for page, text in PAGES.items():
        assert re.match(r"(?:---\n.*?\n---\n+)?# \S", text, re.DOTALL), page
        for picture in re.findall(r"!\[[^\]]*\]\(([^)\s#]+)", text):
            path = DOCS / Path(page).parent / picture
            many = page.startswith("papers/")
            assert path.stat().st_size <= (400_000 if many else 200_000), f"{page}: {picture}"


def test_the_readme_fits_on_one_page():
    readme = (DOCS.parent / "README.md").read_text(encoding="utf-8")
    assert len(readme.split()) <= 600
    for target in re.findall(r"\]\(([^)#:]+)\)", readme):
        assert (DOCS.parent / target).exists(), target
