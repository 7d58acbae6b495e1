"""Transferred models in use: fitted once, and taken by everything that solves."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
import torch

import warp_peri as wp
from tests.support.clouds import cloud
from tests.support.problems import kernel, lattice, manufactured, noise
from tests.support.solving import solve
from warp_peri import InputError, Points, evaluate
from warp_peri.certificates import critical_time_step
from warp_peri.materials import transfer
from warp_peri.materials.lps import LPSMaterial
from warp_peri.materials.transfer import model_for
from warp_peri.methods import Smoothing
from warp_peri.points.families import carried_horizon, families_of
from warp_peri.solvers.solution import Direct
from warp_peri.transfers import on_lattice

HOME = replace(kernel("1/r", 3.0), largest_wave_number=2.0)
ASKED = {"spacing": 0.8, "horizon": 1.6}


@pytest.fixture(autouse=True)
def forgotten(monkeypatch):
    monkeypatch.setattr(transfer, "_memory", {})
    monkeypatch.setattr(transfer, "_said", set())


def test_a_process_fits_each_lattice_once(monkeypatch):
    first = on_lattice(HOME, **ASKED)
    monkeypatch.setattr(transfer, "_transferred", None)  # would be called to make it anew
    assert on_lattice(replace(HOME), **ASKED) is first
    with pytest.raises(TypeError):
        on_lattice(replace(HOME, mu=0.9), **ASKED)


@pytest.fixture
def points():
    """Waves in equilibrium with the model at home, on nodes 0.8 apart."""
    here = lattice(6, 2.4, spacing=0.8)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return manufactured(on_lattice(HOME, spacing=0.8), here, 2, wave_number=0.5)


def test_everything_takes_points_of_another_spacing(points):
    model = replace(HOME)
    there = on_lattice(model, spacing=0.8)
    with pytest.warns(UserWarning, match="transferred from 1 Å to 0.8 Å"):
        u = solve(model, points, points.b, points.u)
    # said once: a warning is an error from here on
    assert np.array_equal(u, solve(there, points, points.b, points.u))
    assert np.array_equal(model.on(points)(u), there.on(points)(u))
    table = evaluate(model, points)
    assert table["transferred_from"] == 1.0
    assert table == evaluate(there, points)
    assert table["E_u"] < 1e-9
    sheet = Points.sheet((24, 28), 0.8)
    load = wp.Periodic(sheet, np.random.default_rng(0).normal(size=sheet.x.shape))
    assert np.array_equal(wp.solve(model, load).u, wp.solve(there, load).u)
    step = critical_time_step(model, spacing=0.8, density=1000.0)
    assert step == critical_time_step(there, spacing=0.8, density=1000.0)
    tensors = [torch.from_numpy(field) for field in (points.b, points.u)]
    same = there.on(points).solve(*tensors, Direct())
    assert same.u.numpy() == pytest.approx(u)


def test_refusing_is_an_option(points):
    for use in (LPSMaterial.on, evaluate, model_for):
        with pytest.raises(InputError, match="certified on 1 Å, not on 0.8 Å"):
            use(HOME, points, transfer=False)


def test_the_horizon_that_the_collar_carries():
    for horizon in (1.6, 0.8 * np.sqrt(5), 2.4):
        points = lattice(4, horizon, spacing=0.8)
        carried = carried_horizon(points)
        families_of(points, carried)
        with pytest.raises(InputError, match="complete families"):
            families_of(points, carried + 0.8)
    few = lattice(6, 0.8 * np.sqrt(5), spacing=0.8)
    with pytest.warns(UserWarning, match="transferred"):
        assert model_for(HOME, few).horizon == pytest.approx(0.8 * np.sqrt(5))


@pytest.mark.parametrize("spacing", [1.0, 0.8])
def test_nodes_around_a_free_edge_are_told_of_it(spacing):
    """At home and on a lattice that the model is carried to."""
    x = spacing * np.argwhere(np.ones((24, 24)))
    x = x[np.linalg.norm(x - x.mean(axis=0), axis=1) > 4 * spacing]
    inside = (np.abs(x - x.mean(axis=0)) < 5.5 * spacing).all(axis=1)
    holed = Points(x=x, interior=inside, spacing=spacing)
    with pytest.raises(InputError, match=r"edges.* Body"):
        solve(HOME, holed, np.zeros((len(x), 2)), np.zeros((len(x), 2)))


def test_scattered_points_are_refused_with_both_ways_on():
    points = cloud(5, 3.0)
    both = r"not on scattered points, .*transfers\.onto_lattice\(samples, spacing=…\).*allow_unc"
    with pytest.raises(InputError, match=both):
        HOME.on(points)
    with pytest.warns(UserWarning, match="not on scattered points"):
        assert HOME.on(points, allow_uncertified=True).model is HOME


def test_a_fit_of_scattered_points_names_what_carries_them():
    u = noise(points := cloud(5, 3.0), 2)
    crystal = wp.Crystal(3.0)
    for law in (wp.LPS(3.0), crystal, wp.ThirdOrder(crystal, Smoothing(2.0))):
        with pytest.raises(InputError, match=r"got scattered points; transfers\.onto_lattice"):
            wp.fit(wp.Samples(points, u, u), law)
