"""The axis of a crystal: stated by points and files, asked for by laws that depend on it."""

import dataclasses

import numpy as np
import pytest

from tests.support.nonlinear import solid
from tests.support.problems import AXIS
from tests.support.sheets import hgo_dictionary, square
from tests.third_order.test_equilibria import problem
from warp_peri import Dataset, InputError, Points, Samples, evaluate
from warp_peri.cli.main import main
from warp_peri.materials.hyperelastic.operator import HyperelasticOperator
from warp_peri.points import samples as points_samples
from warp_peri.points.dataset import load_dataset, save_dataset


@pytest.fixture(scope="module")
def known():
    """A model and fields of 2 % strain that it holds exactly, the crystal at AXIS to the nodes."""
    model = solid("energy")
    points, u, b = problem(model, 0.02)
    return model, Samples(points, u[None], b[None])


def stated(samples, degrees):
    points = dataclasses.replace(samples.points, axis=degrees)
    return dataclasses.replace(samples, points=points)


@pytest.mark.filterwarnings("ignore:strain")
def test_a_crystal_is_answered_by_the_axis_that_is_stated(known):
    model, samples = known
    assert evaluate(model, samples)["E_u"] < 1e-6
    assert evaluate(model, stated(samples, np.rad2deg(AXIS) + 60))["E_u"] < 1e-6
    assert evaluate(model, stated(samples, 0.0))["E_u"] > 1e-4


@pytest.mark.filterwarnings("ignore:strain")
def test_where_none_is_stated_it_is_x_and_said_once(known):
    model, samples = known
    points_samples._said.clear()
    untold, along_x = stated(samples, None), stated(samples, 0.0)
    with pytest.warns(UserWarning, match="axis: the model depends on direction"):
        found = evaluate(model, untold)
    assert evaluate(model, untold) == found == evaluate(model, along_x)  # no second warning
    points_samples._said.clear()
    evaluate(model.linear, untold)
    evaluate(dataclasses.replace(model, q3=0.0), untold)  # isotropic


@pytest.mark.filterwarnings("ignore:strain")
def test_a_file_keeps_it_and_the_command_states_it(known, tmp_path, capsys):
    model, samples = known
    model.save(tmp_path / "m.json")

    def printed(given, *words):
        file = tmp_path / "d.h5"
        save_dataset(file, Dataset({"test": given}, 3.35, 2200.0))
        assert load_dataset(file)["test"].axis == given.axis
        assert main(["evaluate", str(tmp_path / "m.json"), str(file), *words]) == 0
        return capsys.readouterr().out

    right = printed(samples)
    assert printed(stated(samples, 0.0), "--axis", repr(samples.axis)) == right
    assert printed(stated(samples, 0.0)) != right


def test_what_is_no_angle_is_refused_and_sheets_know_of_none():
    with pytest.raises(InputError, match=r"axis: expected an angle \[degrees\], got nan"):
        Points(np.zeros((1, 2)), np.ones(1, bool), 1.0, axis=np.nan)
    turned = dataclasses.replace(square(2), axis=17.0)
    with pytest.raises(InputError, match="axis: directions of a hyperelastic solid .* got 17°"):
        HyperelasticOperator(hgo_dictionary(), turned)
