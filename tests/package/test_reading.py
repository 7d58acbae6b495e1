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
def hooks():
    pytest.importorskip("mkdocs", reason="mkdocs is not installed: pip install 'warp_peri[docs]'")
    with pytest.MonkeyPatch.context() as patch:
        yield beside_the_pages("hooks", patch)


TAG = r"(?:[A-Z][A-Za-z]?)?\d+[a-z]?"
SEVERAL = rf"\(?{TAG}(?:(?:, |–| to | and ){TAG})*(?!\w)"


def test_equations_that_are_cited_exist_and_have_a_form_that_links_know(check):
    """On pages after a link to the theory, and in docstrings after "theory, "."""
    texts, root, cited = check.pages(), DOCS.parent, {}
    known = {tag for text in texts.values() for tag in check.TAGGED.findall(text)}
    tops = ("warp_peri", "kernels", "tests", "examples", "tools")
    places = [path for top in tops for path in (root / top).rglob("*.py")]
    for path in [*places, *DOCS.rglob("*.md"), root / "README.md"]:
        text = " ".join(path.read_text(encoding="utf-8").split())
        for found in re.findall(
            rf"theory(?:/\w+)?(?:\.md[^),]*)?\)?,(?: equations)? ({SEVERAL})", text
        ):
            cited |= dict.fromkeys(re.findall(TAG, found), path.name)
    assert len(cited) > 100
    assert not {tag: path for tag, path in cited.items() if tag not in known}
    assert all(re.fullmatch(TAG, tag) for tag in known)


def test_a_citation_leads_to_its_equation(hooks):
    html = '<p>(<a href="../../theory/">theory</a>), N6 and 48a, best; (theory, C3)</p>'
    seen = hooks.linked(html, "how-to/cracks/")
    for tag in ("N6", "48a", "C3"):
        assert re.search(rf'<a href="../../theory/\w+/#eq-{tag}">{tag}</a>', seen)
    html = r'<p>As (x)</p><div class="arithmatex">\[x \tag{3a}\]</div>'
    seen = hooks.linked(html, "theory/x/")
    assert '<div class="equation" id="eq-3a"><div class="arithmatex">\\[x \\]</div>' in seen
    assert '<span class="number">(3a)</span>' in seen


def test_tables_of_records_and_commands_are_put_in(hooks):
    page = SimpleNamespace(file=SimpleNamespace(src_uri="reference/commands.md"))
    shown = hooks.on_page_markdown("[Table 3](../record/you_2021.json#table_3)", page=page)
    assert "| M | δ* | E_res train |" in shown
    assert "`python examples/reproduce/you_2021.py table_3`, measured at " in shown
    assert {"train", "learn", "dic", "solve"} < {*re.findall(r"^## (\S+)$", shown, re.MULTILINE)}


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


def test_pages_keep_the_rules(check):
    """Links, sentences, tables, pictures, numbers of equations, and the menu."""
    assert check.faults() == []


def test_links_and_anchors_are_found_as_a_browser_finds_them(check):
    text = (
        "# One `two`: three\n\n[a](b.md#c) ![p](q.png) [w](https://x.y) `[no](no.md)`\n\n"
        '## Strains above 1 %\n\n## By name {#named}\n\n<img src="r.png">\n\n'
        "$$x \\tag{N1}$$\n\n```\n# no heading\n[no](no.md)\n```\n"
    )
    assert check.links(text) == ["b.md#c", "q.png", "r.png"]
    assert check.anchors(text) == {"one-two-three", "strains-above-1", "named", "eq-N1"}


def test_names_of_the_glossary_are_in_the_code():
    text = (DOCS / "explanation/peridynamics.md").read_text(encoding="utf-8")
    names = re.findall(r"`wp\.([\w.]+)`", text)
    assert len(names) > 20
    for name in names:
        owner, known = wp, True
        for part in name.split("."):
            known = hasattr(owner, part) or part in getattr(owner, "__dataclass_fields__", ())
            owner = getattr(owner, part, None)
        assert known, name
