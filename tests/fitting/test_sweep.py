"""Algorithm 2: choices among trials, and a sweep that resumes."""

from dataclasses import replace
from json import dumps

import numpy as np
import pytest

from tests.support import approx, of_json, refused, warned
from tests.support.problems import OTHER, kernel, lattice, manufactured
from warp_peri import LPS, LPSMaterial
from warp_peri.materials import sweep as trials
from warp_peri.materials.sweep import Trial, choose
from warp_peri.methods import sweep
from warp_peri.points.dataset import in_units


def trial(horizon, degree, *errors, bonds=20):
    return Trial(horizon, degree, bonds, *errors, None, -0.2, 0.7, 1.0, 0.01, "m.json")


def test_horizons_are_chosen_by_training_residual_and_degrees_by_the_average():
    """Of equal averages the lower degree is chosen; the cheapest good one has the fewest bonds."""
    chosen = choose([
        trial(10, 0, 0.4, 0.4, 0.4, 0.4),
        trial(20, 0, 0.5, 0.1, 0.1, 0.1),  # better but for E_res_train
        trial(10, 5, 0.1, 0.2, 0.2, 0.2),
        trial(20, 5, 0.2, 0.1, 0.1, 0.1),
        trial(10, 9, 0.1, 0.3, 0.3, 0.3),
    ])  # fmt: skip
    assert [t.horizon for t in chosen.by_degree] == [10, 10, 10]
    assert chosen.average == approx([1.0, (0.25 + 3 * 0.5) / 4, (0.25 + 3 * 0.75) / 4])
    assert (chosen.printed.horizon, chosen.printed.degree) == (10, 5)
    equal = [trial(10, M, *4 * [error]) for M, error in ((0, 1.0), (5, 0.20001), (9, 0.2))]
    assert choose(equal).printed.degree == 5
    sizes = ((0, 1.0, 12), (5, 0.109, 48), (5, 0.1, 80), (5, 0.12, 28), (3, 0.104, 112))
    sized = [trial(10, M, *4 * [error], bonds=bonds) for M, error, bonds in sizes]
    assert choose(sized).cheapest.bonds == 48


@pytest.fixture
def sets():
    model = kernel("positive", 2.5, lam=-0.2)
    return [manufactured(model, lattice(5, 3.0), 5, seed=seed) for seed in (0, 1)]


def test_a_sweep_finds_the_horizon_of_the_data_and_resumes(sets, tmp_path):
    train, val = sets
    options = {"horizons": np.array([2.0, 2.5]), "degrees": (0, 3), "jobs": 1}
    first = sweep(train, val, tmp_path, test=val, **options)
    assert len(first.trials) == 4
    assert (first.printed.horizon, first.printed.degree) == (2.5, 3)
    assert first.printed.E_u_test == approx(first.printed.E_u_val)
    files = {file: file.stat().st_mtime_ns for file in tmp_path.iterdir()}
    broken = next(file for file in files if file.name.startswith("d2_M3"))
    broken.write_text("{")
    mine = broken.with_suffix(".h5")
    mine.write_text("mine")
    with refused("expected loads inside"):
        sweep(train, replace(val, b=0 * val.b), tmp_path, **options)
    again = sweep(train, val, tmp_path, test=val, **options)
    assert [t.E_res_train for t in again.trials] == [t.E_res_train for t in first.trials]
    assert [file for file in files if file.stat().st_mtime_ns != files[file]] == [broken]
    assert mine.read_text() == "mine"


def test_usual_horizons_are_in_the_unit_of_the_data(sets, tmp_path, monkeypatch):
    horizons = []
    monkeypatch.setattr(trials, "_fit", lambda law, *_: horizons.append(law.horizon) or "none")
    monkeypatch.setattr(trials, "families_of", lambda *_: None)  # the body is too small
    train, val = (in_units(one, OTHER) for one in sets)
    with pytest.raises(RuntimeError), warned("none"):
        sweep(train, val, tmp_path, degrees=[0], jobs=1)
    assert horizons == [1.0, 1.25, 1.5, 1.75, 2.0, 2.25, 2.5]
    units = "sigma", "epsilon/sigma^3"
    train, val = (replace(one, points=replace(one.points, units=units)) for one in sets)
    with refused("horizons: expected one in sigma, the data's unit; got none"):
        sweep(train, val, tmp_path)


def test_a_trial_is_not_believed_as_it_stands(sets, tmp_path, monkeypatch):
    """By its errors, bound, name, seventh digit of the horizon, units, or a set for another use."""
    options = {"horizons": (2.0, 2.0 + 1e-7), "degrees": (0,), "jobs": 1}
    first = sweep(*sets, tmp_path, **options).trials
    one, other = sorted(tmp_path.glob("*.model.json"))
    better, bound, another = (of_json(path) for path in (one, one, other))
    better["errors"]["E_res"]["train"] = 0.0
    bound["certificate"]["1"]["symbol_bound"] *= 10
    del better["sha256"], bound["sha256"]
    for told in (better, bound, another):
        one.write_text(dumps(told))
        assert sweep(*sets, tmp_path, **options).trials == first
    with monkeypatch.context() as patch:
        patch.setattr(trials, "_mark", lambda *_: "known")
        for wrong in (0.0, "a", None, -1.0, [1.0], 0.5):
            told = of_json(other)
            del told["sha256"]
            told["provenance"]["sweep"], told["errors"]["E_u"]["val"] = "known", wrong
            other.write_text(dumps(told))
            assert (sweep(*sets, tmp_path, **options).trials == first) == (wrong != 0.5)
    (train, val), options = sets, options | {"horizons": (2.0,)}
    there = [replace(each, points=replace(each.points, units=OTHER)) for each in sets]
    sweep(*there, tmp_path, **options)
    quiet, law = replace(val, u=1e-9 * val.u), LPS(2.0, loss="residual")
    for more in ({"noise": replace(quiet, b=None)}, {"test": quiet}, {"law": law}):
        sweep(train, val, tmp_path, **more, **options)
    models = [LPSMaterial.load(path) for path in tmp_path.glob("*.model.json")]
    assert [model.units for model in models].count(OTHER) == 1
    assert len(models) == 6


def test_a_failed_fit_is_left_out_and_tried_again(sets, tmp_path, monkeypatch):
    options = {"horizons": (2.0, 2.5), "degrees": (0,), "jobs": 1}
    learn = LPS.learn

    def fails(law, *given, **options):
        if law.horizon == 2.0:
            raise RuntimeError("stage 3: no start ended with the conditions kept")
        return learn(law, *given, **options)

    with monkeypatch.context() as patch:
        patch.setattr(LPS, "learn", fails)
        with warned(r"sweep: δ = 2 Å, M = 0: stage 3: no start"):
            assert [t.horizon for t in sweep(*sets, tmp_path, **options).trials] == [2.5]
        with warned("δ = 2 Å"), pytest.raises(RuntimeError, match="every fit failed"):
            sweep(*sets, tmp_path, **options | {"horizons": (2.0,)})
    assert len(sweep(*sets, tmp_path, **options).trials) == 2
    with refused("horizon 4: .* have not at horizon"):
        sweep(*sets, tmp_path / "new", **options | {"horizons": (2.0, 4.0)})
    wide = replace(sets[1], points=replace(sets[1].points, x=sets[1].x / 3, spacing=1 / 3))
    with refused("horizon 2: .* have not"):
        sweep(*sets, tmp_path / "new", test=wide, **options)
    assert not (tmp_path / "new").exists()
    with refused("at least one horizon"):
        sweep(*sets, tmp_path, horizons=())
