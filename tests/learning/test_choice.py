"""The cheapest measured way within a tolerance, and how it explains itself."""

import json
from dataclasses import replace

import numpy as np
import pytest

from tests.support.problems import kernel, lattice
from warp_peri import Dataset, Dirichlet, InputError, Samples, save
from warp_peri.choice import Scene, choose_model, shipped_table
from warp_peri.cli.main import main
from warp_peri.transfers import on_lattice


def row(method, spacing, horizon, error, seconds):
    return {
        "kind": "LPS",
        "method": method,
        "spacing": spacing,
        "horizon": horizon,
        "degree": 10,
        "disks_nodes": 300,
        "disks_setup": 0.9 * seconds,
        "disks_solve": 0.1 * seconds,
        "disks_error": error,
        "waves_error": 2 * error,
    }


TABLE = {
    "short_wave": 14.0,
    "long_wave": 25.0,
    "seconds_per_node": {"sine": 2e-6, "multigrid": 3e-6},
    "rows": [
        row("lu", 5.0, 12.5, 0.03, 0.02),
        row("lu", 5.0, 20.0, 0.01, 0.05),
        row("lu", 2.5, 12.5, 0.008, 0.3),
        row("multigrid", 5.0, 20.0, 0.001, 0.2),
        row("Q1", 5.0, 0.0, 0.001, 0.001),
    ],
}
SMALL = Scene((100.0, 100.0), 50.0)


def test_the_cheapest_within_the_tolerance_is_chosen():
    assert choose_model(tolerance=0.05, scene=SMALL, table=TABLE).horizon == 12.5
    choice = choose_model(tolerance=0.02, scene=SMALL, table=TABLE)
    assert (choice.spacing, choice.horizon, choice.method) == (5.0, 20.0, "lu")
    assert choice.seconds == pytest.approx(0.05 * (400 / 300) ** 1.5)
    assert "δ = 20 Å" in choice.reason
    assert choice.reason.count(".") >= 1


def test_short_waves_need_more_than_long_ones():
    short = Scene((100.0, 100.0), 15.0)
    assert choose_model(tolerance=0.05, scene=short, table=TABLE).horizon == 20.0


def test_large_scenes_take_conjugate_gradients_by_shape():
    for rectangle, method, each in ((True, "sine", 2e-6), (False, "multigrid", 3e-6)):
        scene = Scene((2000.0, 2000.0), 50.0, rectangle)
        choice = choose_model(tolerance=0.05, scene=scene, table=TABLE)
        assert choice.method == method
        assert (choice.spacing, choice.horizon) == (5.0, 20.0)  # as cheap as 12.5, and better
        assert choice.seconds == pytest.approx(each * 400**2)
    assert choose_model(tolerance=0.009, scene=scene, table=TABLE).spacing == 2.5


def test_only_what_solve_can_do_is_chosen():
    single = [
        *TABLE["rows"],
        row("lu32", 5.0, 12.5, 0.03, 1e-6),
    ]  # measured, and no option of solve
    choice = choose_model(tolerance=0.05, scene=SMALL, table=TABLE | {"rows": single})
    assert choice == choose_model(tolerance=0.05, scene=SMALL, table=TABLE)
    assert choice.method == "lu"


def test_what_was_not_measured_is_refused():
    with pytest.raises(InputError, match="waves of 10 Å were not measured"):
        choose_model(tolerance=0.05, scene=Scene((100.0, 100.0), 10.0), table=TABLE)
    with pytest.raises(InputError, match="no measured model comes within 0.1 %"):
        choose_model(tolerance=0.001, scene=SMALL, table=TABLE)
    for scene in (
        ((100.0, 0.0), 20.0),
        ((1e300, 1e300), 20.0),
        ((100.0, "wide"), 20.0),
        ((100.0, 100.0), np.nan),
    ):
        with pytest.raises(InputError, match="scene: expected lengths > 0"):
            Scene(*scene)
    for tolerance in (-1.0, np.nan, "small"):
        with pytest.raises(InputError, match="tolerance: expected a fraction > 0"):
            choose_model(tolerance=tolerance, scene=SMALL, table=TABLE)


@pytest.mark.parametrize("wrong", ["20", None, np.nan, True, -1.0])
def test_what_is_no_number_above_zero_is_refused(wrong):
    with pytest.raises(InputError, match="scene: expected lengths > 0"):
        Scene((100.0, wrong), 20.0)
    with pytest.raises(InputError, match="scene: expected lengths > 0"):
        Scene((100.0, 100.0), wrong)
    with pytest.raises(InputError, match="tolerance: expected a fraction > 0"):
        choose_model(tolerance=wrong, scene=SMALL, table=TABLE)


def test_the_shipped_table_serves_a_real_scene():
    table = shipped_table()
    assert table["short_wave"] < table["long_wave"]
    choice = choose_model(tolerance=0.05, scene=SMALL)
    errors = [r["disks_error"] for r in table["rows"] if r["method"] == "lu"]
    assert min(errors) <= choice.error <= 0.05


def test_spacing_and_horizon_from_transfers_of_a_model():
    home = replace(kernel("1/r", 3.0), largest_wave_number=2.0)
    choice = choose_model(tolerance=0.02, scene=Scene((60.0, 60.0), 8.0), table=TABLE, model=home)
    assert choice.spacing <= 1.05 * 8.0 / 3  # to two digits
    assert choice.error <= 0.02
    assert "coarsest of" in choice.reason
    there = home.in_units(("nm", "TPa"))
    other = choose_model(tolerance=0.02, scene=Scene((6.0, 6.0), 0.8), table=TABLE, model=there)
    assert other.spacing == pytest.approx(choice.spacing / 10)
    assert "on waves of 0.8 nm, by" in other.reason
    here = on_lattice(home, spacing=choice.spacing, tolerance=0.02, shortest_wave=8.0)
    assert here.horizon == choice.horizon
    with pytest.raises(InputError, match="the data held waves down to 3.14 Å"):
        choose_model(tolerance=0.02, scene=Scene((60.0, 60.0), 3.0), table=TABLE, model=home)


def test_a_scene_is_read_off_a_problem():
    points = lattice(20, 2.5, spacing=5.0)
    x = points.x
    b = 1e-4 * np.cos(2 * np.pi * x[:, :1] / 40.0) * [0.0, 1.0]
    problem = Dirichlet(points, b, 0 * b)
    scene = Scene.of(problem, modulus=0.7)
    assert scene.size == (100.0, 100.0)
    assert scene.rectangle
    assert 20 <= scene.shortest_wave <= 40
    exact = 1e-4 / 0.7 * 40 / (2 * np.pi) / np.sqrt(2)  # |grad u| of b / (μ k²)
    assert scene.strain == pytest.approx(exact, rel=0.2)
    twice = Scene.of(Dirichlet(points, np.stack([b, b]), np.zeros((2, *b.shape))), modulus=0.7)
    assert twice.loads == 2
    pulled = Scene.of(Dirichlet(points, 0 * b, 0.01 * x), modulus=0.7)
    assert pulled.strain > scene.strain
    with pytest.raises(InputError, match="expected a load, or displacement"):
        Scene.of(Dirichlet(points, 0 * b, 0 * b), modulus=0.7)
    for wrong in (0.0, -3.0, np.nan, "soft"):
        with pytest.raises(InputError, match="modulus: expected a number > 0"):
            Scene.of(problem, modulus=wrong)
    with pytest.raises(InputError, match="strain > 0"):
        replace(scene, strain=-1.0)


def test_strain_loads_and_kinds_of_answers_decide():
    strained = {"strained": [[0.005, 0.004], [0.05, 0.04]], "hundred": 0.3}
    bent = {"strained": [[0.005, 0.001], [0.05, 0.005]], "hundred": 20.0}
    rows = [
        row("lu", 5.0, 20.0, 0.01, 0.05) | strained,
        row("rest", 5.0, 20.0, 0.002, 0.06) | bent | {"kind": "third-order model", "label": "bent"},
        row("predict", 5.0, 25.0, 0.003, 0.07) | bent | {"kind": "predict", "label": "one %"},
        row("Q1", 5.0, 0.0, 0.009, 0.01) | strained | {"kind": "FEM Q1", "label": "FEM Q1, x"},
        row("rest", 5.0, 20.0, 1e-6, 1e-6) | {"kind": "neural operator"},
    ]
    table = TABLE | {"rows": rows}

    def answer(tolerance, **scene):
        asked = replace(SMALL, **scene)
        return choose_model(tolerance=tolerance, scene=asked, table=table)

    assert answer(0.05).answer == "elements"
    assert answer(0.05).reason.startswith("Local elements suffice: h = 5 Å, FEM Q1 with")
    assert answer(0.02, strain=0.05).answer == "nonlinear"
    assert answer(0.006, strain=0.005).answer == "elements"
    slow = TABLE | {"rows": [rows[0], rows[3] | {"disks_solve": 9.0}]}
    other = choose_model(tolerance=0.05, scene=SMALL, table=slow)
    assert other.answer == "linear"
    assert other.reason.endswith(" Local elements suffice too: FEM Q1, x.")
    assert answer(0.0015, strain=0.005).answer == "nonlinear"
    assert "|H| = 0.5 %" in answer(0.0015, strain=0.005).reason
    few = TABLE | {"rows": rows[2:3]}
    assert choose_model(tolerance=0.01, scene=SMALL, table=few).method == "predict"
    linear = TABLE | {"rows": rows[:1]}
    thick = Scene((1000.0, 1000.0), 50.0, stiff=True)
    assert choose_model(tolerance=0.05, scene=thick, table=TABLE).method == "strip"
    many = choose_model(tolerance=0.05, scene=replace(SMALL, loads=100), table=linear)
    assert many.seconds > choose_model(tolerance=0.05, scene=SMALL, table=linear).seconds


def test_a_linear_solid_that_is_enough_is_taken_before_a_nonlinear_one():
    rows = [
        row("rest", 5.0, 20.0, 0.002, 0.01) | {"kind": "third-order model", "label": "bent"},
        row("lu", 5.0, 20.0, 0.01, 0.05),
    ]
    table = TABLE | {"rows": rows}
    assert choose_model(tolerance=0.03, scene=SMALL, table=table).answer == "linear"
    assert choose_model(tolerance=0.005, scene=SMALL, table=table).answer == "nonlinear"


def test_the_command_plans(tmp_path, capsys):
    points = lattice(20, 2.5, spacing=5.0)
    b = 1e-4 * np.cos(2 * np.pi * points.x[None, :, :1] / 60.0) * [0.0, 1.0]
    save(tmp_path / "d.h5", Dataset({"test": Samples(points, 0 * b, b)}, 3.35, 2200.0))
    assert main(["plan", str(tmp_path / "d.h5"), "--tolerance", "0.05", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["error"] <= 0.05
    assert told["scene"]["size"] == [100.0, 100.0]
    assert told["answer"] in told["reason"] or told["method"] in told["reason"]
    size = ["--size", "500", "500", "--shortest-wave", "50"]
    assert main(["plan", *size, "--tolerance", "0.05"]) == 0
    for idle in (["--modulus", "0.5"], ["--set", "val"]):
        assert main(["plan", *size, *idle]) == 2
        assert f"{idle[0][2:]}: expected with a data file" in capsys.readouterr().err
    assert main(["plan", "--size", "500", "500"]) == 2
