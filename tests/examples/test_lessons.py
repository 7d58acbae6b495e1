"""The short examples: a number of each, which it finds when it is imported."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import warp_peri as wp
from examples.own_law import Springs

ROOT = Path(__file__).parent.parent.parent


def test_arrays_teach_the_constants_of_the_sheet():
    from examples.learn_from_arrays import MU, numbers

    assert numbers["mu"] == pytest.approx(MU, rel=1e-3)


def test_a_spinning_disk_is_that_of_the_textbook():
    from examples.solve_disk import numbers

    assert numbers["relative error of u"] < 5e-3


def test_an_influence_function_of_ones_own_is_found():
    from examples.own_influence import numbers

    assert numbers["radius"] == pytest.approx(9.0, rel=1e-5)


def test_a_stiff_inclusion_is_found(capsys):
    from examples import inclusion_from_displacement

    assert inclusion_from_displacement.main(["--side", "14", "--steps", "25"]) == 0
    numbers = json.loads(capsys.readouterr().out)
    assert numbers["map error"] < 0.2
    assert numbers["mean in the inclusion"] == pytest.approx(4, rel=0.2)


def test_waves_find_two_maps(capsys):
    from examples import waves_to_map

    assert waves_to_map.main(["--side", "20", "--iterations", "12"]) == 0
    numbers = json.loads(capsys.readouterr().out)
    for modulus in ("κ", "μ"):
        assert numbers[modulus] < 0.6 * numbers[f"{modulus} at start"]


def own_law(folder, *on):
    """What the example prints, in a folder that its file is left in."""
    alone = {"OMP_NUM_THREADS": "1", "PYTHONPATH": str(ROOT)}
    words = [*on, sys.executable, str(ROOT / "examples" / "own_law.py")]
    run = subprocess.run(
        words, cwd=folder, env=os.environ | alone, capture_output=True, text=True, check=True
    )
    return [float(word) for word in run.stdout.split()]


@pytest.fixture(scope="module")
def alone(tmp_path_factory):
    folder = tmp_path_factory.mktemp("own")
    return own_law(folder), folder


def test_a_law_of_ones_own_goes_through_every_verb(alone):
    (error, proven, still, swung), folder = alone
    assert error < 5e-3  # three numbers for the four lengths of its bonds
    law = wp.load(folder / "springs.json")
    assert isinstance(law, Springs)
    assert wp.certify(law).symbol_bound == law.certificate.proven == proven > 0.19
    assert law.elastic_tensor()[0, 1] == pytest.approx(0.5, rel=0.02)  # λ = μ, as of all springs
    assert 0.9 * still < swung < still
    with pytest.raises(wp.InputError, match="spacing: the model is for 5, got 4"):
        wp.certify(law, spacing=4.0)
    with pytest.raises(wp.InputError, match="points: of a Model alone, not of a Springs"):
        wp.certify(law, points=wp.Points.sheet((9, 9), 5.0))


def test_a_ball_swells_in_a_block_as_the_textbook_says():
    from examples.solid_in_space import swollen

    *_, error, proven = swollen(0.1)
    assert error < 4e-3
    assert proven == pytest.approx(0.355, rel=1e-2)


def test_a_penny_runs_at_the_stress_of_griffith():
    from examples.penny_crack import torn

    _, motion, stress = torn(side=14, radius=3.0, steps=200)
    assert stress.max() == pytest.approx(1.0, abs=0.15)
    assert stress[-1] < 0.2  # it has come apart
    assert motion.missing < 0.02
