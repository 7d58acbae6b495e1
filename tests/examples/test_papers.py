"""The pages on the sources: what they compute, and that they name what is missing."""

import re
from pathlib import Path
from string import Formatter

import numpy as np
import pytest

from examples.polymer import Ensembles, held, shear
from examples.polymer.laws import IDENTITY
from examples.studies import paper_polymer_gp, paper_you_pictures, papers
from examples.studies import paper_slides_rates as rates
from examples.studies.polymer_tables import printed_shear

DOCS = Path(__file__).parent.parent.parent / "docs"


def long(name):
    return (DOCS / "archive" / f"papers_{name}.md").read_text(encoding="utf-8")


def claims(name):
    template = papers.SOURCES[name].TEMPLATE
    return template.with_stem(f"{template.stem}_claims").read_text(encoding="utf-8")


@pytest.mark.parametrize(("d", "exponent"), [(2, 1.0), (2, 3.5), (3, 2.5)])
def test_the_rate_of_the_quadrature_is_the_claimed_one(d, exponent):
    found = rates.pointwise(d, exponent, 3)
    assert found["rate"] == pytest.approx(found["claimed"], abs=0.1)


@pytest.mark.parametrize(("d", "name", "degree"), [(2, "∂₁u", 3), (3, "u", 2), (3, "∂₁∂₂u", 3)])
def test_functionals_of_least_squares_have_the_claimed_rate_and_keep_the_bound(d, name, degree):
    found = rates.functional(d, name, degree)
    assert found["rate"] == pytest.approx(found["claimed"], abs=0.1)
    assert 0 < found["share"] <= 1


def test_a_code_that_weighs_cells_does_not_converge_and_the_quadrature_does():
    """Claimed on the slides: swapping the weights restores convergence."""
    errors = {"cells": [], "quadrature": []}
    for number in (8, 16, 32):
        horizon = 3 * rates.LENGTH / number
        points = rates.lattice(number, horizon, rates.LENGTH)
        u = rates.no_dilatation(points.x)
        fields = u, 2 * rates.MU * u
        errors["cells"].append(rates.solved_by_cells(points, horizon, rates.MU, *fields))
        solid = rates.plain(rates.MU, rates.MU, horizon, points.spacing)
        errors["quadrature"].append(rates.error_of(solid, points, *fields))
    assert errors["cells"][-1] > errors["cells"][0]
    assert errors["quadrature"][-1] < errors["quadrature"][0] / 15


@pytest.mark.parametrize("name", papers.SOURCES)
def test_a_page_says_what_its_template_says(name):
    """Lines without numbers of a run stand on the page: neither goes on without the other."""
    template = papers.SOURCES[name].TEMPLATE.read_text(encoding="utf-8")
    page = long(name)
    assert list(papers.sections(template)) == list(papers.sections(page))
    lines = [line for line in template.splitlines() if "{" not in line]
    assert [line for line in lines if line not in page.splitlines()] == []
    named = [title for titles in papers.foot_of(page).values() for title in titles]
    assert set(named) <= set(papers.sections(page))


@pytest.mark.parametrize("name", ["you_2021", "polymer_gp", "slides"])
def test_every_part_of_a_page_is_asked_for_and_given(name, tmp_path):
    source = papers.SOURCES[name]
    parts = source.parts(tmp_path / "runs", papers.keeper(tmp_path), tmp_path)
    template = source.TEMPLATE.read_text(encoding="utf-8")
    assert {part for _, part, _, _ in Formatter().parse(template) if part} == set(parts)


def test_the_printed_recipe_of_shear_without_noise():
    """Filter, differences of a step and ten bins leave a per cent of the rate, the filter's own."""
    K, t = np.linspace(-1.5, 1.5, 9), 1e-3 * np.arange(5001)[:, None]
    C = np.tile(IDENTITY, (len(t), 9, 1))
    C[..., 1] = K * (1 - np.exp(-t))
    record = Ensembles(1e-3, held(shear(K), 5000), C, C, 0)
    law = printed_shear(record, 0)
    some = slice(250, 3000, 250)
    rate = law.rate(np.repeat(shear(K), 11, axis=0), C[some].swapaxes(0, 1).reshape(-1, 4))[:, 1]
    exact = (K * np.exp(-t[some])).T.ravel()
    assert np.linalg.norm(rate - exact) < 0.02 * np.linalg.norm(exact)


def test_training_flows_of_the_channel_are_the_printed_shear_and_what_elongation_bears():
    largest = np.abs(paper_polymer_gp.gradients(1e-2)).max(axis=(0, 1))
    np.testing.assert_allclose(largest, [0.4, 1.5, 1.5, 0.4])


def test_the_family_of_a_node_is_drawn(tmp_path):
    paper_you_pictures.family(tmp_path / "family.png")
    assert (tmp_path / "family.png").stat().st_size > 10_000


def test_thirty_sections_each_with_its_command():
    commands = 0
    for name in papers.SOURCES:
        commands += sum("\n```\n" in text for text in papers.sections(long(name)).values())
    assert commands >= 30


@pytest.mark.parametrize("name", papers.SOURCES)
def test_each_section_has_what_is_printed_and_measured_a_command_and_a_sentence(name):
    template = papers.SOURCES[name].TEMPLATE.read_text(encoding="utf-8")
    printed = re.compile(r"[Pp]rinted|[Cc]laimed|[Tt]he (source|paper|slides)")
    for title, text in list(papers.sections(template).items())[1:]:
        assert printed.search(text), title
        assert "\n|---" in text or "\n![" in text, title
        *_, command, last = text.split("```")
        assert command.startswith(("\npython ", "\npytest ")), title
        assert re.search(r"^[^|!\s].*\.", last, re.MULTILINE), title


def test_a_section_is_made_again_and_the_foot_says_where():
    template = "# P\n\n## A\n\n{a}\n\n## B\n\n{b}\n\n## C\n\nc\n"
    page = papers.whole(
        ["# P\n\n", "## A\n\n1\n\n", "## B\n\n2\n\n"], {"commit x": [], "commit y": ["B"]}
    )
    parts = {"a": "3", "b": lambda: 1 / 0}
    again = papers.remade(page, template, ["A"], parts, "commit z")
    assert papers.sections(again) == {
        "": "# P\n\n", "A": "## A\n\n3\n\n", "B": "## B\n\n2\n\n", "C": "## C\n\nc\n",
    }  # fmt: skip
    assert papers.foot_of(again) == {"commit x": [], "commit y": ["B"], "commit z": ["A", "C"]}
    last = papers.remade(again, template, ["B"], {"a": "4", "b": "5"}, "commit z")
    assert papers.foot_of(last) == {"commit x": [], "commit z": ["A", "B", "C"]}


@pytest.mark.parametrize("name", papers.SOURCES)
def test_claims_have_the_numbers_of_the_long_page(name):
    page = (DOCS / "papers" / f"{name}.md").read_text(encoding="utf-8")
    assert page == papers.short(claims(name), long(name))
    assert len(papers.CELL.findall(claims(name))) >= 20
    assert "{" not in page
    assert len(page.split()) <= 1200


@pytest.mark.parametrize("name", papers.SOURCES)
def test_every_claim_has_a_verdict_and_a_place(name):
    """The last cell of a row says whether it holds, and leads to a section of the long page."""
    words = (re.sub(r"[^\w -]", "", title.lower()) for title in papers.sections(long(name)))
    titles = {re.sub(r"[ -]+", "-", title) for title in words}
    tables = re.findall(r"(?:^\|.*\n)+", claims(name), re.MULTILINE)
    assert len(tables) >= 2
    for head, _, *rows in (table.splitlines() for table in tables):
        assert head.endswith("| here | verdict |")
        for row in rows:
            found = re.search(r" \| \[([a-z ]+)\]\((\S+)\) \|$", row)
            assert found, row
            assert f"- *{found[1]}*:" in claims(name), row
    anchors = re.findall(rf"\(\.\./archive/papers_{name}\.md#([^)]+)\)", claims(name))
    assert anchors
    assert {*anchors} <= titles


def test_numbers_are_read_from_a_page_and_shown():
    page = "# P\n\n## A, first\n\n| x | 1.20 (3e-05 to -4) | runs away |\n"
    assert papers.short("{A > x > 0}, {A > x > 1}, {A > x > 0 > .2g%}", page) == "1.20, 3·10⁻⁵, 120"
    for wrong in ("{B > x > 0}", "{A > y > 0}"):
        with pytest.raises(ValueError, match="expected a row"):
            papers.short(wrong, page)


def test_pictures_are_redrawn_from_the_rows_of_a_page(tmp_path):
    paper_polymer_gp.redraw(long("polymer_gp"), tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {
        "polymer_costs.png", "polymer_plates.png", "polymer_training.png",
    }  # fmt: skip


def test_sections_that_are_not_there_are_refused(tmp_path):
    with pytest.raises(papers.InputError, match="section: expected one of those of"):
        papers.main(["slides", "--section", "Nothing", "--out", str(tmp_path)])


def test_what_is_to_be_run_first_is_named(tmp_path, capsys):
    with pytest.raises(papers.InputError, match=r"examples/train_graphene\.py --sweep"):
        papers.main(["you_2021", "--runs", str(tmp_path / "runs"), "--out", str(tmp_path)])


@pytest.mark.slow
def test_the_page_on_the_slides(tmp_path):
    given = ["slides", "--runs", str(tmp_path / "runs"), "--out", str(tmp_path)]
    assert papers.main(given) == 0
    text = (tmp_path / "archive" / "papers_slides.md").read_text(encoding="utf-8")
    assert "| 3 | 3.5 | 4 |" in text
    rows = papers.sections(text)["To the local solution at a fixed ratio"].splitlines()
    orders = [float(line.split("|")[-2]) for line in rows if line.startswith(("| bond", "| state"))]
    assert len(orders) == 3
    assert min(orders[:2]) > 1.9
    assert abs(orders[2]) < 0.3  # cells as weights
