"""Pages and equations: what links, citations and the search lead to."""

import importlib.util
import re
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

import warp_peri as wp

DOCS = Path(__file__).parent.parent.parent / "docs"


def beside_the_pages(name, monkeypatch):
    """A script of docs/, which is no package."""
    monkeypatch.setattr(sys, "path", [*sys.path])
    spec = importlib.util.spec_from_file_location(name, DOCS / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def check():
    with pytest.MonkeyPatch.context() as patch:
        yield beside_the_pages("check", patch)


@pytest.fixture(scope="module")
def equations():
    with pytest.MonkeyPatch.context() as patch:
        yield beside_the_pages("equations", patch)


@pytest.fixture(scope="module")
def count(check):
    return check.counted()


def test_every_equation_has_a_number_of_its_own_and_an_anchor(count):
    assert count["equations"] == count["equations of one tag only"] > 100
    assert count["equations with an anchor"] == count["equations"]


def test_every_number_has_the_form_that_links_know(equations):
    for tag in equations.where():
        assert re.fullmatch(equations.TAG, tag), tag


def test_equations_that_are_cited_exist(equations):
    """On pages after a link to the theory, and in docstrings after "theory, "."""
    known, root, cited = equations.where(), DOCS.parent, {}
    tops = ("warp_peri", "kernels", "tests", "examples", "tools")
    places = [path for top in tops for path in (root / top).rglob("*.py")]
    for path in [*places, *DOCS.rglob("*.md"), root / "README.md"]:
        text = " ".join(path.read_text(encoding="utf-8").split())
        for found in re.findall(
            rf"theory(?:/\w+)?(?:\.md[^),]*)?\)?,(?: equations)? ({equations.SEVERAL})", text
        ):
            cited |= dict.fromkeys(re.findall(equations.TAG, found), path.name)
    assert len(cited) > 100
    assert not {tag: path for tag, path in cited.items() if tag not in known}


def test_a_citation_leads_to_its_equation(equations):
    where = equations.where()
    html = '<p>(<a href="../../theory/">theory</a>), N6 and 48a–48c, best; (theory, Di3)</p>'
    seen = equations.on_page_content(html, SimpleNamespace(url="how-to/cracks/"))
    for tag in ("N6", "48a", "48c", "Di3"):
        assert f'<a href="../../{where[tag]}#eq-{tag}">{tag}</a>' in seen
    page = SimpleNamespace(url=where["3a"])
    html = r'<p>As (3a), (N22–N23), (9, 12)</p><div class="arithmatex">\[x \tag{3a}\]</div>'
    seen = equations.on_page_content(html, page)
    assert seen.count('<a href="#eq-3a">3a</a>') == 1
    for tag in ("N22", "N23", "9", "12"):
        assert f'#eq-{tag}">{tag}</a>' in seen
    assert '<div class="equation" id="eq-3a"><div class="arithmatex">\\[x \\]</div>' in seen
    assert '<span class="number">(3a)</span>' in seen


@pytest.mark.parametrize(
    ("path", "found"),
    [
        ("how-to/cracks.md", {"boost": 4}),
        ("theory/cracks.md", {}),
        ("archive/papers_slides.md", {"exclude": True}),
        ("reference/api/cracks.md", {}),
    ],
)
def test_the_search_finds_how_tos_first_and_leaves_out_the_archive(path, found, monkeypatch):
    searched = beside_the_pages("searched", monkeypatch)
    page = SimpleNamespace(file=SimpleNamespace(src_uri=path), meta={})
    html = '<h2 id="a">A</h2><h3 id="b" class="doc doc-heading">B</h3>'
    shown = searched.on_page_content(html, page)
    assert page.meta["search"] == found
    assert shown.count("data-search-exclude") == path.startswith("reference/api/")
    assert '<h2 id="a">' in shown


def test_sentences_are_found_as_a_reader_finds_them(check):
    text = (
        "# Title\n\nOne of four words. Two, with $x = 1.5$ in it!\n\n- An item\n- Another item\n\n"
        "| a | b |\n|---|---|\n| c | d |\n\n```\nno prose here\n```\n"
    )
    assert check.sentences(text) == [
        "One of four words.",
        "Two, with X in it!",
        "An item",
        "Another item",
    ]
    assert check.tables(text) == [1]
    assert check.words(text) < len(text.split())


def test_links_lead_to_files_and_headings(check, monkeypatch):
    """A page that the menu names and that is not there yet is the business of another test."""
    broken = check.broken_links(check.pages())
    missing = {(DOCS / page).resolve() for page in check.menu() if not (DOCS / page).exists()}
    lost = []
    for line in broken:
        page, target = line.split(": ")
        if ((DOCS / page).parent / target.partition("#")[0]).resolve() not in missing:
            lost.append(line)
    assert not lost


def test_links_and_anchors_are_found_as_a_browser_finds_them(check):
    text = (
        "# One `two`: three\n\n[a](b.md#c) ![p](q.png) [w](https://x.y) `[no](no.md)`\n\n"
        '## Strains above 1 %\n\n## By name {#named}\n\n<img src="r.png">\n\n'
        "$$x \\tag{N1}$$\n\n```\n# no heading\n[no](no.md)\n```\n"
    )
    assert check.links(text) == ["b.md#c", "q.png", "r.png"]
    assert check.anchors(text) == {"one-two-three", "strains-above-1", "named", "eq-N1"}


def test_the_page_of_the_commands_is_what_the_parser_says(monkeypatch):
    commands = beside_the_pages("commands", monkeypatch)
    shown = commands.PAGE.read_text(encoding="utf-8")
    assert shown == commands.page(), "python docs/commands.py writes it anew"
    assert {"train", "learn", "dic", "solve"} < {*re.findall(r"^## (\S+)$", shown, re.MULTILINE)}


def test_names_of_the_glossary_are_in_the_code():
    (page,) = DOCS.rglob("glossary.md")
    text = page.read_text(encoding="utf-8")
    names = re.findall(r"`wp\.([\w.]+)`", text)
    assert len(names) > 20
    for name in names:
        owner, known = wp, True
        for part in name.split("."):
            known = hasattr(owner, part) or part in getattr(owner, "__dataclass_fields__", ())
            owner = getattr(owner, part, None)
        assert known, name
