"""The pages on the sources: what they compute, and that they name what is missing."""

import pytest

from examples.studies import paper_slides, papers


@pytest.mark.parametrize(("d", "exponent"), [(2, 1.0), (2, 3.5), (3, 2.5)])
def test_the_rate_of_the_quadrature_is_the_claimed_one(d, exponent):
    found = paper_slides.pointwise(d, exponent, 3)
    assert found["rate"] == pytest.approx(found["claimed"], abs=0.1)


def test_what_is_to_be_run_first_is_named(tmp_path, capsys):
    with pytest.raises(papers.InputError, match=r"examples/train_graphene\.py --sweep"):
        papers.main(["you_2021", "--runs", str(tmp_path / "runs"), "--out", str(tmp_path)])


@pytest.mark.slow
def test_the_page_on_the_slides(tmp_path):
    given = ["slides", "--runs", str(tmp_path / "runs"), "--out", str(tmp_path)]
    assert papers.main(given) == 0
    text = (tmp_path / "slides.md").read_text(encoding="utf-8")
    assert "| 3 | 3.5 | 4 |" in text
    rows = [line for line in text.splitlines() if line.startswith(("| bond", "| state"))]
    orders = [float(line.split("|")[-2]) for line in rows]
    assert len(orders) == 2
    assert min(orders) > 1.9
