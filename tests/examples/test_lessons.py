"""The short examples: a number of each, which it finds when it is imported."""

import pytest


def test_arrays_teach_the_constants_of_the_sheet():
    from examples.learn_from_arrays import MU, numbers

    assert numbers["mu"] == pytest.approx(MU, rel=1e-3)


def test_a_spinning_disk_is_that_of_the_textbook():
    from examples.solve_disk import numbers

    assert numbers["relative error of u"] < 5e-3


def test_an_influence_function_of_ones_own_is_found():
    from examples.own_influence import numbers

    assert numbers["radius"] == pytest.approx(9.0, rel=1e-5)


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
