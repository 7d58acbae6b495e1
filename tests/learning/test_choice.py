"""The cheapest measured way within a tolerance, and how it explains itself."""

from dataclasses import replace

import numpy as np
import pytest

from tests.dressed.solids import solid
from tests.support.problems import kernel
from warp_peri import InputError
from warp_peri.choice import Scene, choose_model, shipped_table
from warp_peri.dressed import transferred
from warp_peri.transfers import on_lattice


def row(method, spacing, horizon, error, seconds):
    return {
        "kind": "learned",
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


def test_a_dressed_solid_is_carried_to_the_coarsest_nodes():
    law = solid(2, "elements", size=0.01)
    scene = Scene((60.0, 40.0), 12.0)
    choices = [choose_model(tolerance=t, scene=scene, model=law) for t in (0.2, 0.01)]
    assert choices[0].spacing > choices[1].spacing > 0.5
    for choice, tolerance in zip(choices, (0.2, 0.01)):
        assert choice.error <= tolerance
        assert f"on {choice.spacing:g} Å: the coarsest of" in choice.reason
        there = transferred(law, choice.spacing)
        k = 2 * np.pi / 12.0 * np.array([[1.0, 0.0], [0.5**0.5, 0.5**0.5]])
        off = np.linalg.solve(there.symbol(k), law.symbol(k)) - np.eye(2)
        assert np.abs(off).max() <= tolerance
    with pytest.raises(InputError, match="no lattice down to"):
        choose_model(tolerance=1e-9, scene=scene, model=law)
    with pytest.raises(InputError, match="got a dressed solid in space"):
        choose_model(tolerance=0.1, scene=scene, model=solid(3))


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
    for scene in (((100.0, 0.0), 20.0), ((100.0, "wide"), 20.0), ((100.0, 100.0), np.nan)):
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
