"""The rows of `make verify`: the fastest, in other units too, and how they are told."""

import csv
from pathlib import Path

import numpy as np
import pytest

from examples.exact import compliances, plate_with_hole
from tests.known_problems import __main__ as command
from tests.known_problems.rows import ROWS, SAME, Outcome, Row, measured, page
from tests.known_problems.statics import CUBIC

QUICK = [one for one in ROWS if one.quick and not one.why and not one.misses]
SCALED = (
    "patch test, square lattice: sheet energy",
    "smooth field: crystal",
    "smooth field: third order",
    "NAFEMS LE1, elliptic membrane: crystal",
    "NAFEMS LE1, elliptic membrane: LPS",
    "Cook's membrane: bond-based",
    "slanted crack, angle of its kink: LPS",
    "dispersion of a short wave: learned graphene",
)


@pytest.mark.parametrize("one", QUICK, ids=lambda one: one.name)
def test_fast_rows_hold_in_all_units(one):
    line = measured(one, scaled=one.name in SCALED)
    assert line["holds"], line
    assert (line["scaled"] or 0.0) <= SAME


def test_rows_are_whole_and_have_one_name_each():
    assert {*SCALED} <= {one.name for one in QUICK}
    assert len({one.name for one in ROWS}) == len(ROWS)
    for one in ROWS:
        assert one.source
        assert one.allowed > 0
    problems = {one.problem for one in ROWS}
    assert len(ROWS) == len(problems) * len({one.material for one in ROWS})
    idle = [measured(one) for one in ROWS if one.why]
    assert all(line["holds"] is None and "because" in line["note"] for line in idle)


def test_references_agree_with_second_forms():
    """Lekhnitskii's stress, ASTM's polynomials, Tada's and Gross's."""
    known = {one.problem: one.reference for one in ROWS}
    a11, a12, a66 = compliances(CUBIC)
    top = plate_with_hole(np.array([[0.0, 1.0]]), 1.0, 1.0, CUBIC)[1][0, 0, 0]
    assert top == pytest.approx(1 + np.sqrt(2 + 2 * a12 / a11 + a66 / a11), rel=1e-9)
    assert known["plate with a hole, cubic"] == pytest.approx(top, rel=1e-9)
    x = 0.5
    bend = 1.99 - x * (1 - x) * (2.15 - 3.93 * x + 2.7 * x**2)
    bend *= 3 * np.sqrt(x) / (2 * (1 + 2 * x) * (1 - x) ** 1.5)
    assert known["bend bar of ASTM E399"] == pytest.approx(bend, rel=8e-3)
    compact = (2 + x) * np.polyval([-5.6, 14.72, -13.32, 4.64, 0.886], x) / (1 - x) ** 1.5
    assert known["compact tension of ASTM E399"] == pytest.approx(compact, rel=1e-3)
    turn = np.pi * x / 2
    tada = np.sqrt(np.tan(turn) / turn) * (0.752 + 2.02 * x + 0.37 * (1 - np.sin(turn)) ** 3)
    assert known["edge crack"] == pytest.approx(tada / np.cos(turn), rel=2e-3)
    feddersen = np.sqrt(1 / np.cos(turn))
    assert known["centre crack"] == pytest.approx(feddersen, rel=4e-3)
    bulk, shear = 1000 / (1.3 * 0.4), 1000 / 1.3  # 2(λ + μ) and 2μ
    bore = (3 / bulk + 27 / shear) / 8
    assert known["thick cylinder"] == pytest.approx(bore, rel=1e-4)


def made(**fields):
    told = {"problem": "hole", "material": "LPS", "reference": 3.0, "source": "Kirsch"}
    told |= {"answer": 3.3, "error": 0.1, "allowed": 0.01, "order": 1.5, "least": 1.9}
    told |= {"seconds": 0.1, "holds": False, "note": "", "scaled": None, "misses": ""} | fields
    return told | {"name": f"{told['problem']}: {told['material']}"}


def test_too_low_an_order_and_a_changed_answer_do_not_hold():
    def run(scale, order=2.0, change=0.0):
        return Outcome(1.0 + change * (scale.unit != "m"), order)

    def line(least, scaled=False, **how):
        return measured(Row("a", "b", "c", 0.1, lambda s: run(s, **how), 1.0, least), scaled=scaled)

    assert line(1.9)["holds"]
    assert not line(2.1)["holds"]
    assert not line(1.9, order=None)["holds"]
    assert line(None, scaled=True)["scaled"] == 0
    assert not line(None, scaled=True, change=1e-5)["holds"]
    assert not measured(Row("a", "b", "c", 0.1, lambda s: Outcome(np.nan)))["holds"]


def test_the_command_ends_with_one_where_a_row_surprises(capsys, tmp_path, monkeypatch):
    lines = [made(holds=True), made(material="crystal", misses="known")]
    monkeypatch.setattr(command, "verified", lambda *_, **__: lines)
    assert command.main(["--page", str(tmp_path / "page.md")]) == 0
    assert "| hole |" in capsys.readouterr().out
    assert "[all rows as data](page.csv)" in (tmp_path / "page.md").read_text()
    with (tmp_path / "page.csv").open(newline="") as file:
        row, _ = csv.DictReader(file)
    assert (row["problem"], row["answer"], row["holds"]) == ("hole", "3.3", "True")
    (tmp_path / "mine.csv").write_text("mine")
    for words in ("--page", f"{tmp_path}/mine.md"), ("--page", "a.csv"), ("--processes", "0"):
        with pytest.raises(SystemExit, match="2"):
            command.main([*words])
        assert ": error: " in capsys.readouterr().err
    assert command.main(["--page", str(tmp_path / "page.md")]) == 0  # its own, again
    lines.append(made(material="bonds"))
    assert command.main([]) == 1
    lines[:] = [made(holds=True, misses="known")]
    assert command.main([]) == 1


def test_the_page_of_the_documentation_is_that_of_its_data():
    """Rows of the data are those that are posed here, and the page holds what they say."""
    path = Path(__file__).parents[2] / "docs" / "reference" / "verification.md"
    numbers = ("reference", "answer", "error", "allowed", "order", "least", "seconds")
    lines = []
    with path.with_suffix(".csv").open(newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            known = {name: float(row[name]) if row[name] else None for name in numbers}
            holds = {"True": True, "False": False, "": None}[row["holds"]]
            name = f"{row['problem']}: {row['material']}"
            lines.append({**row, **known, "holds": holds, "name": name})
    assert [line["name"] for line in lines] == [one.name for one in ROWS]
    assert [line["allowed"] for line in lines] == [one.allowed for one in ROWS]
    assert [line["holds"] is False for line in lines] == [bool(one.misses) for one in ROWS]
    assert path.read_text(encoding="utf-8") == page(lines)
