"""The rows of `warp-peri verify`: the fastest, in other units too, and how they are told."""

import csv
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import warp_peri as wp
from warp_peri.cli.main import main
from warp_peri.errors import InputError
from warp_peri.verification import (
    ROWS,
    by_atoms,
    by_material,
    chosen,
    measured,
    motion,
    page,
    rows,
    statics,
    table,
    verified,
)
from warp_peri.verification.statics import (
    CUBIC,
    GRAPHENE,
    KERNEL,
    UnitScale,
    compliances,
    disc,
    plane,
    plate_with_hole,
)

POSED = [one for one in ROWS if not one.why]
MISSED = {
    "Griffith's load, by the most stretched bond: LPS",
    "Griffith's load, by the most stretched bond: bond-based",
    "plate that is hit, angle of its cracks: LPS",
    "plate that is hit, angle of its cracks: bond-based",
}
"""Rows that do not hold today; who mends one strikes it here."""


@pytest.mark.parametrize(
    "one", [one for one in POSED if one.quick and one.name not in MISSED], ids=lambda one: one.name
)
def test_the_fastest_rows_hold(one):
    line = measured(one)
    assert line["holds"], line


@pytest.mark.slow
@pytest.mark.parametrize(
    "one", [one for one in POSED if not one.quick or one.name in MISSED], ids=lambda one: one.name
)
def test_every_other_row_holds_or_is_known_to_miss(one):
    line = measured(one)
    assert line["holds"] == (one.name not in MISSED), line


SCALED = (
    "patch test, square lattice: sheet energy",
    "smooth field: crystal",
    "smooth field: third order",
    "patch test, body with free edges: LPS",
    "NAFEMS LE1, elliptic membrane: LPS",
    "Cook's membrane: bond-based",
    "slanted crack, angle of its kink: LPS",
    "dispersion of a short wave: dressed elements",
)


@pytest.mark.parametrize("name", SCALED)
def test_units_and_the_size_of_moduli_change_no_answer(name):
    (one,) = (one for one in ROWS if one.name == name)
    line = measured(one, scaled=True)
    assert line["scaled"] <= rows.SAME
    assert line["holds"]


@pytest.mark.slow
@pytest.mark.parametrize(
    "one",
    [o for o in POSED if o.name not in SCALED and "100 000" not in o.name],
    ids=lambda one: one.name,
)
def test_nor_those_of_any_other_row(one):
    assert measured(one, scaled=True)["scaled"] <= rows.SAME


def test_every_row_is_told_whole_and_names_are_given_once():
    assert len({one.name for one in ROWS}) == len(ROWS)
    assert {one.name for one in POSED} >= MISSED
    for one in ROWS:
        assert one.source
        assert one.allowed > 0
    problems = {one.problem for one in ROWS}
    assert len(ROWS) == len(problems) * len({one.material for one in ROWS})
    idle = [measured(one) for one in ROWS if one.why]
    assert all(line["holds"] is None and "because" in line["note"] for line in idle)


def test_the_references_agree_with_second_forms():
    """Lekhnitskii's stress, the potentials of a disc, ASTM's polynomials, Tada's and Gross's."""
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


@pytest.mark.parametrize("stiffer", [4.0, 0.25])
def test_the_disc_is_continuous_and_in_balance(stiffer):
    moduli = plane(1.0, 1 / 3)
    exact, strain = disc(moduli, stiffer)
    angle = np.linspace(0, 2 * np.pi, 9)[:-1] + 0.1
    n = np.stack([np.cos(angle), np.sin(angle)], axis=1)

    def stress(x, factor, d=1e-6):
        slopes = [(exact(x + d * e) - exact(x - d * e)) / (2 * d) for e in np.eye(2)]
        return factor * moduli.stress(np.stack(slopes, axis=-1))

    inside, outside = (0.25 * (1 + d) * n for d in (-1e-5, 1e-5))
    jump = np.abs(exact(inside) - exact(outside)).max()
    assert jump < 1e-4 * np.abs(exact(inside)).max()
    pulls = (
        np.einsum("nij,nj->ni", stress(x, factor), n)
        for x, factor in ((inside, stiffer), (outside, 1.0))
    )
    one, other = pulls
    assert np.abs(one - other).max() < 1e-3 * np.abs(one).max()
    assert stress(0 * n[:1], 1.0)[0, 0, 0] > 0
    slope = (exact(np.array([[0.1, 0.0]])) - exact(np.array([[-0.1, 0.0]])))[0, 0] / 0.2
    assert slope == pytest.approx(strain, rel=1e-6)


@pytest.mark.slow
def test_split_elements_bear_stresses_near_incompressibility():
    """Hoop stress in a bore at ν = 0.4999, of 1.25 times the pressure, by elements alone."""
    s, moduli, off = UnitScale(), plane(1000.0, 0.4999, strain=True), []
    law = statics.material("LPS", moduli.tensor, 2.0, s)
    for split in (True, False):
        place = 24, 40
        patch = place, lambda p: (3 + 6 * p[:, :1] ** 1.2) * statics.arc(p)
        mesh = statics.mapped(s, (*patch, ("bore", "", *statics.SIDES)), split=split)
        with pytest.warns(UserWarning, match="elements alone"):
            found = statics.posed(law, mesh, s, statics.rollers(), {"bore": lambda x, n: -n})
        off.append(abs(statics.near(found, (3, 0), s)[1][1, 1] / 1.25 - 1))
    assert off[0] < 2e-3
    assert off[1] > 0.1


def test_rows_are_chosen_by_parts_of_their_names():
    assert {one.problem for one in chosen(["le1,"])} == {"NAFEMS LE1, elliptic membrane"}
    assert len(chosen()) == len(ROWS)
    with pytest.raises(InputError, match="only: expected a part of a row's name, got 'kirschen'"):
        chosen(["kirschen"])
    for word in ("", " "):
        with pytest.raises(InputError, match="only: expected a part of a row's name"):
            chosen(["LE1", word])
    with pytest.raises(InputError, match="processes: expected at least 1, got 0"):
        verified(["LE1"], processes=0)


def made(**fields):
    told = {"problem": "hole", "material": "LPS", "reference": 3.0, "source": "Kirsch"}
    told |= {"answer": 3.3, "error": 0.1, "allowed": 0.01, "order": 1.5, "least": 1.9}
    told |= {"seconds": 0.1, "holds": False, "note": "", "scaled": None} | fields
    return told | {"name": f"{told['problem']}: {told['material']}"}


def test_a_row_that_misses_stays_in_the_table_and_one_that_does_not_apply_says_why():
    lines = [made(), made(material="bonds", holds=None, note="does not apply, because ν")]
    told = table(lines)
    expected = "| hole | LPS | 3 [1] | 3.3 | 10 % | 1 % | 1.5 (≥ 1.9) | 0.1 | **does not hold** |"
    assert f"{expected}  |" in told.splitlines()
    assert f"{expected} too soft |" in table([made(note="too soft")]).splitlines()
    assert "Notes" not in table([made(note="too soft")])
    assert "1. Kirsch." in told
    assert "- does not apply, because ν: hole: bonds." in told
    assert "|hole [1]|**10**|–|" in by_material(lines)
    assert "0 of 1 rows hold" in page(lines)


def test_too_low_an_order_and_a_changed_answer_do_not_hold():
    def run(scale, order=2.0, change=0.0):
        return rows.Outcome(1.0 + change * (scale.unit != "m"), order)

    def line(least, scaled=False, **how):
        one = rows.Row("a", "b", "c", 0.1, lambda s: run(s, **how), 1.0, least)
        return measured(one, scaled=scaled)

    assert line(1.9)["holds"]
    assert not line(2.1)["holds"]
    assert not line(1.9, order=None)["holds"]
    assert line(None, scaled=True)["scaled"] == 0
    assert not line(None, scaled=True, change=1e-5)["holds"]


def test_an_error_that_grows_with_units_and_what_is_no_number_do_not_hold():
    def line(value, **how):
        return measured(rows.Row("a", "b", "c", 1e-11, lambda s: rows.Outcome(value(s))), **how)

    assert line(lambda s: 1e-12)["holds"]
    assert not line(lambda s: 1e-12 if s.unit == "m" else 1e-8, scaled=True)["holds"]
    told = line(lambda s: np.nan)
    assert not told["holds"]
    assert told["answer"] is None
    json.dumps(told, allow_nan=False)
    assert "refused" in table([told])


def test_a_crack_that_stands_is_not_below_rayleighs_speed(monkeypatch):
    pulled = motion.Cracked
    monkeypatch.setattr(motion, "Cracked", lambda p, b, cracks: pulled(p, 0 * b, cracks=cracks))
    (one,) = (one for one in ROWS if one.name == "crack in glass below Rayleigh's speed: LPS")
    assert not measured(one)["holds"]


def test_a_page_that_cannot_be_written_is_told_before_anything_is_posed(tmp_path, monkeypatch):
    monkeypatch.setattr("warp_peri.verification.verified", lambda *_, **__: 1 / 0)
    (tmp_path / "file").write_text("")
    for page_ in (tmp_path, tmp_path / "file" / "page.md"):
        assert main(["verify", "--page", str(page_)]) == 2


@pytest.mark.slow
def test_an_interrupt_ends_the_rows_that_run(tmp_path):
    """Sent to the command alone, not to its workers as by a terminal."""
    words = [sys.executable, "-m", "warp_peri", "verify", "--only", "Cook", "cylinder", "LE10"]
    with subprocess.Popen([*words, "--out", str(tmp_path)], stderr=subprocess.PIPE) as job:
        seen = b""
        while b"1 of" not in seen and (more := job.stderr.read1()):
            seen += more
        job.send_signal(signal.SIGINT)
        begin = time.monotonic()
        assert job.wait(timeout=60) == 130
    assert time.monotonic() - begin < 10


def test_the_command_ends_with_one_where_a_row_misses(capsys, tmp_path, monkeypatch):
    lines = [made(holds=True), made(material="crystal")]
    monkeypatch.setattr("warp_peri.verification.verified", lambda *_, **__: lines)
    assert main(["verify", "--json"]) == 1
    assert json.loads(capsys.readouterr().out)["rows"][1]["holds"] is False
    lines.pop()
    assert main(["verify", "--page", str(tmp_path / "page.md")]) == 0
    assert "| hole |" in capsys.readouterr().out
    assert (tmp_path / "page.md").read_text().startswith("# Verification")
    assert "[all rows as data](page.csv)" in (tmp_path / "page.md").read_text()
    with (tmp_path / "page.csv").open(newline="") as file:
        (row,) = csv.DictReader(file)
    assert (row["problem"], row["answer"], row["holds"]) == ("hole", "3.3", "True")


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
    assert path.read_text(encoding="utf-8") == page(lines)


@pytest.mark.slow
def test_rows_are_shared_by_processes_and_leave_pictures(tmp_path):
    lines = verified(["square lattice: LPS", "square lattice: sheet energy"], out=tmp_path)
    assert [line["material"] for line in lines] == ["LPS", "sheet energy"]
    assert all(line["holds"] for line in lines)
    assert len([*tmp_path.glob("*.png")]) == 2
    assert json.loads((tmp_path / "verification.json").read_text())["rows"] == lines


@pytest.fixture
def atoms(tmp_path, monkeypatch):
    """A model, and scenes that it solves itself in place of LAMMPS; what the command is told."""
    law = wp.Model(GRAPHENE.C12, GRAPHENE.C44, 1.0, np.array(KERNEL), 20.0, certified_on=(5.0,))
    wp.save(tmp_path / "law.json", law)
    x = 5.0 * np.stack(np.meshgrid(*2 * [np.arange(26.0)], indexing="ij"), axis=-1).reshape(-1, 2)
    points = wp.Points(x, np.abs(x - 62.5).max(axis=1) < 22.0, 5.0)
    u, b = np.random.default_rng(3).normal(size=(2, 2, *x.shape)) * [[[[1e-3]]], [[[1e-5]]]]
    u[:, points.interior] = 0.0
    solved = wp.solve(law, wp.Dirichlet(points, b, u)).u
    true = {"truth": {"lambda": GRAPHENE.C12, "mu": GRAPHENE.C44}}
    sets = dict.fromkeys(rows.FRESH, wp.Samples(points, solved, b))
    data = wp.Dataset(sets, thickness=3.35, density=2200.0, provenance=true)
    real, told = subprocess.run, []

    def run(job, **how):
        if "make_scenes" not in job[1]:
            return real(job, **how)
        told.extend(job)
        wp.save(job[-1], data)
        return subprocess.CompletedProcess(job, 0, "", "")

    monkeypatch.setattr(rows.subprocess, "run", run)
    return tmp_path / "law.json", told


@pytest.mark.slow
def test_fresh_loads_are_those_of_the_seed_and_a_law_is_held_against_local_elasticity(atoms):
    law, told = atoms
    lines = by_atoms(7, law)
    assert told[told.index("--seed") + 1] == "7"
    assert [line["problem"] for line in lines] == [*rows.FRESH.values()]
    for line in lines:
        assert line["error"] < 1e-6 < line["allowed"]
        assert line["holds"]
    assert "seed 7" in table(lines)


def test_atoms_say_what_they_lack(tmp_path, monkeypatch):
    with pytest.raises(InputError, match="atoms: expected a checkout and a model"):
        by_atoms(7, tmp_path / "none.json")
    (model := tmp_path / "law.json").write_text("{}")
    with pytest.raises(InputError, match="seed: expected a number of at least 0, got -1"):
        by_atoms(-1, model)
    failed = subprocess.CompletedProcess([], 2, "", "no LAMMPS here")
    monkeypatch.setattr(rows.subprocess, "run", lambda *_, **__: failed)
    with pytest.raises(InputError, match="atoms: make_scenes.py: no LAMMPS here"):
        by_atoms(7, model)


def test_a_unit_has_its_length():
    assert UnitScale("mm").length == pytest.approx(1e3)
    assert UnitScale("angstrom").length == pytest.approx(1e10)


def killed(number, scaled, out):
    """The second of the rows that the test chooses kills its process."""
    if number == ROWS.index(QUICK[1]):
        os.kill(os.getpid(), signal.SIGKILL)
    return measured(ROWS[number], scaled=scaled, out=out)


QUICK = [one for one in POSED if one.problem == "patch test, square lattice"][:3]


@pytest.mark.slow
@pytest.mark.parametrize("processes", [1, 2])
def test_a_row_whose_process_is_killed_is_told_and_the_others_are_kept(monkeypatch, processes):
    monkeypatch.setattr(rows, "_numbered", killed)
    monkeypatch.setattr(rows, "chosen", lambda only: QUICK)
    lines = verified(processes=processes)
    assert [line["name"] for line in lines] == [one.name for one in QUICK]
    assert [line["holds"] for line in lines] == [True, False, True]
    assert "killed" in lines[1]["note"]
    assert "does not hold" in table(lines)
