"""Algorithm 2: a sweep over horizon and degree."""

import json
from dataclasses import replace

import numpy as np
import pytest

from tests.problems import kernel, lattice, manufactured
from warp_peri import InputError, evaluate, load_model
from warp_peri.sweep import Trial, choose, sweep

TRUE = kernel("positive", 2.5)


def trial(horizon, degree, bonds, *errors):
    names = ("E_res_train", "E_u_train", "E_res_val", "E_u_val")
    rest = {"E_u_test": None, "lam": 0.0, "mu": 1.0, "alpha": 1.0, "symbol_bound": 0.1}
    return Trial(horizon, degree, bonds, **dict(zip(names, errors)), **rest, model="m.json")


def test_choices_are_those_of_the_algorithm():
    trials = [
        trial(2.0, 0, 12, 0.4, 0.4, 0.4, 0.4),
        trial(3.0, 0, 28, 0.2, 0.2, 0.2, 0.2),  # base: smallest E_res_train of degree 0
        trial(2.0, 5, 12, 0.11, 0.11, 0.10, 0.10),
        trial(3.0, 5, 28, 0.10, 0.10, 0.12, 0.08),  # AvgE 0.5
        trial(2.0, 9, 12, 0.30, 0.30, 0.30, 0.30),
        trial(3.0, 9, 28, 0.09, 0.13, 0.12, 0.12),
    ]
    found = choose(trials)
    assert [(t.horizon, t.degree) for t in found.by_degree] == [(3.0, 0), (3.0, 5), (3.0, 9)]
    assert found.average == pytest.approx([1.0, 0.5, 0.575])
    assert found.printed == trials[3]
    assert found.cheapest == trials[2]  # 12 bonds, AvgE 0.525


@pytest.fixture(scope="module")
def sets():
    """Training and validation samples."""
    points = manufactured(TRUE, lattice(5, 2.5), 6, wave_number=2.0)
    return [replace(points, u=points.u[some], b=points.b[some]) for some in (slice(4), slice(4, 6))]


def test_a_sweep_goes_on_where_it_was(sets, tmp_path, monkeypatch):
    choice = {"horizons": (2.0, 2.5), "degrees": (0, 3), "jobs": 1}
    first = sweep(*sets, tmp_path, test=sets[1], **choice)
    assert len(first.trials) == 4
    best = min(first.trials, key=lambda one: one.E_res_train)
    assert (best.horizon, best.degree) == (2.5, 3)
    model = load_model(tmp_path / best.model)
    assert best.E_res_val == pytest.approx(evaluate(model, sets[1])["E_res"])
    assert best.E_u_test == best.E_u_val
    files = {file: file.read_bytes() for file in tmp_path.iterdir()}
    assert len(files) == 8

    fits = []
    original = sweep.__globals__["fit"]
    monkeypatch.setitem(
        sweep.__globals__, "fit", lambda *a, **k: fits.append(k["degree"]) or original(*a, **k)
    )
    assert sweep(*sets, tmp_path, test=sets[1], **choice) == first
    assert fits == []
    next(iter(tmp_path.glob("d2_M3_*.model.json"))).unlink()
    again = sweep(*sets, tmp_path, test=sets[1], **choice)
    assert fits == [3]
    assert again == first
    other = replace(sets[1], b=2 * sets[1].b)
    sweep(sets[0], other, tmp_path, horizons=(2.0,), degrees=(0,), jobs=1)
    assert fits == [3, 0]


def test_records_are_plain_json(sets, tmp_path):
    sweep(*sets, tmp_path, horizons=(2.0,), degrees=(0,), jobs=1)
    (record,) = (file for file in tmp_path.iterdir() if "model" not in file.name)
    content = json.loads(record.read_text())
    assert content["bonds"] == 12
    assert np.isfinite([content[key] for key in ("lam", "mu", "E_u_val")]).all()


def test_nothing_to_sweep_is_refused(sets, tmp_path):
    with pytest.raises(InputError, match="at least one horizon and one degree"):
        sweep(*sets, tmp_path, degrees=())
