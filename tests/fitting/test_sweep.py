"""Algorithm 2: choices among trials, and a sweep that resumes."""

import copy
import dataclasses
import json

import pytest

from tests.support.problems import kernel, lattice, manufactured, with_nodes
from warp_peri import LPS, InputError, Model
from warp_peri.files.atomic import ArrayFile
from warp_peri.materials.lps_sweep import Trial, choose
from warp_peri.methods import TwoStage, sweep


def trial(horizon, degree, *errors, bonds=20):
    return Trial(horizon, degree, bonds, *errors, None, -0.2, 0.7, 1.0, 0.01, "m.json")


def test_horizons_are_chosen_by_training_residual_and_degrees_by_the_average():
    base = trial(10, 0, 0.4, 0.4, 0.4, 0.4)
    trials = [
        base,
        trial(20, 0, 0.5, 0.1, 0.1, 0.1),  # better but for E_res_train
        trial(10, 5, 0.1, 0.2, 0.2, 0.2),
        trial(20, 5, 0.2, 0.1, 0.1, 0.1),
        trial(10, 9, 0.1, 0.3, 0.3, 0.3),
    ]
    chosen = choose(trials)
    assert [t.horizon for t in chosen.by_degree] == [10, 10, 10]
    assert chosen.average == pytest.approx([1.0, (0.25 + 3 * 0.5) / 4, (0.25 + 3 * 0.75) / 4])
    assert (chosen.printed.horizon, chosen.printed.degree) == (10, 5)


def test_equal_averages_choose_the_lower_degree():
    trials = [trial(10, M, *4 * [error]) for M, error in ((0, 1.0), (5, 0.20001), (9, 0.2))]
    assert choose(trials).printed.degree == 5


def test_the_cheapest_good_one_has_the_fewest_bonds():
    trials = [
        trial(10, 0, *4 * [1.0], bonds=12),
        trial(20, 5, *4 * [0.109], bonds=48),
        trial(25, 5, *4 * [0.100], bonds=80),
        trial(15, 5, *4 * [0.120], bonds=28),
        trial(30, 3, *4 * [0.104], bonds=112),
    ]
    assert choose(trials).cheapest.bonds == 48


@pytest.fixture
def sets():
    model = kernel("positive", 2.5, lam=-0.2)
    return [manufactured(model, lattice(5, 3.0), 5, seed=seed) for seed in (0, 1)]


def test_a_sweep_finds_the_horizon_of_the_data_and_resumes(sets, tmp_path, monkeypatch):
    train, val = sets
    options = {"horizons": (2.0, 2.5), "degrees": (0, 3), "jobs": 1}
    first = sweep(train, val, tmp_path, test=val, **options)
    assert len(first.trials) == 4
    assert (first.printed.horizon, first.printed.degree) == (2.5, 3)
    assert first.printed.E_u_test == pytest.approx(first.printed.E_u_val)
    files = {file: file.stat().st_mtime_ns for file in tmp_path.iterdir()}

    broken = next(file for file in files if file.name.startswith("d2_M3"))
    broken.write_text("{")
    again = sweep(train, val, tmp_path, test=val, **options)
    assert [t.E_res_train for t in again.trials] == [t.E_res_train for t in first.trials]
    made = {file for file in files if file.stat().st_mtime_ns != files[file]}
    assert {file.name.split("_")[0] + file.name.split("_")[1] for file in made} == {"d2M3"}


def test_a_trial_is_not_believed_as_it_stands(sets, tmp_path):
    """Of other errors, of a bound that is not proven, under the name of another; a horizon that is
    the same to six digits is another trial."""
    options = {"horizons": (2.0, 2.0 + 1e-7), "degrees": (0,), "jobs": 1}
    first = sweep(*sets, tmp_path, **options)
    files = sorted(tmp_path.glob("*.model.json"))
    assert len(files) == len(first.trials) == 2
    content = json.loads(files[0].read_text())
    for change in ("errors", "numbers", "bound", "name"):
        told = copy.deepcopy(content)
        if change == "errors":
            told["errors"]["E_res"]["train"] = 0.0
            del told["sha256"]
        elif change == "numbers":
            told["lambda"] *= 1.001
            del told["sha256"]
        elif change == "bound":
            (figures,) = told["certificate"].values()
            figures["symbol_bound"] *= 10
            del told["sha256"]
        else:
            told = json.loads(files[1].read_text())
        files[0].write_text(json.dumps(told))
        again = sweep(*sets, tmp_path, **options)
        assert [dataclasses.astuple(t) for t in again.trials] == [
            dataclasses.astuple(t) for t in first.trials
        ]


def test_units_and_what_a_set_is_for_tell_a_trial_from_others(sets, tmp_path):
    """The same numbers in other units were one trial, and so were test=X and noise=X."""
    train, val = sets
    options = {"horizons": (2.0,), "degrees": (0,), "jobs": 1}
    sweep(train, val, tmp_path, **options)
    others = [with_nodes(one, units=("nm", "GPa")) for one in sets]
    sweep(*others, tmp_path, **options)
    sweep(train, val, tmp_path, test=val, **options)
    models = [Model.load(path) for path in sorted(tmp_path.glob("*.model.json"))]
    assert len(models) == 3
    assert {model.units for model in models} == {("angstrom", "TPa"), ("nm", "GPa")}
    quiet = dataclasses.replace(val, u=1e-9 * val.u)
    sweep(train, val, tmp_path, noise=quiet, **options)
    sweep(train, val, tmp_path, test=quiet, **options)
    assert len(list(tmp_path.glob("*.model.json"))) == 5


@pytest.mark.filterwarnings("ignore:strain:UserWarning", "ignore:λ . μ ended on the lower bound")
def test_a_sweep_goes_on_inside_a_fit(sets, tmp_path, monkeypatch):
    """Algorithm 1 of hours, stopped after its second round, ends where it would have ended."""
    method = TwoStage("relu", epochs=50, inner_epochs=5, outer_iterations=5)
    options = {"horizons": (2.5,), "degrees": (1,), "jobs": 1, "method": method}
    whole = sweep(*sets, tmp_path / "whole", **options).trials
    saved, save = [], ArrayFile.write

    def stops(self, arrays):
        save(self, arrays)
        saved.append(arrays["done"])
        if len(saved) == 2:
            raise KeyboardInterrupt

    monkeypatch.setattr(ArrayFile, "write", stops)
    with pytest.raises(KeyboardInterrupt):
        sweep(*sets, tmp_path, **options)
    assert not list(tmp_path.glob("d*.json"))
    assert sweep(*sets, tmp_path, **options).trials == whole
    assert saved == [1, 2, 3, 4, 5]
    assert not list(tmp_path.glob("*.npz"))


def test_a_failed_fit_is_left_out_and_tried_again(sets, tmp_path, monkeypatch):
    train, val = sets
    options = {"horizons": (2.0, 2.5), "degrees": (0,), "jobs": 1}
    learn, horizons = LPS.learn, []

    def fails(law, *given, **options):
        horizons.append(law.horizon)
        if law.horizon == 2.0:
            raise RuntimeError("stage 3: no start ended with the conditions kept")
        return learn(law, *given, **options)

    with monkeypatch.context() as patch:
        patch.setattr(LPS, "learn", fails)
        with pytest.warns(UserWarning, match=r"sweep: δ = 2 Å, M = 0: stage 3: no start"):
            result = sweep(train, val, tmp_path, **options)
        assert [t.horizon for t in result.trials] == [2.5]
        with (
            pytest.warns(UserWarning, match="δ = 2 Å"),
            pytest.raises(RuntimeError, match="every fit failed"),
        ):
            sweep(train, val, tmp_path, **options | {"horizons": (2.0,)})
        with pytest.raises(InputError, match="at least one horizon"):
            sweep(train, val, tmp_path, horizons=())
        assert horizons == [2.0, 2.5, 2.0]
    assert len(sweep(train, val, tmp_path, **options).trials) == 2
