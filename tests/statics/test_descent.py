"""Polak and Ribière's search as a solver of every law: starts, shapes, and what it refuses."""

import numpy as np
import pytest
import torch

import warp_peri as wp
from tests.support.problems import ell, kernel, lattice, manufactured, noise
from warp_peri.statics.descent import polak_ribiere


def solid():
    return kernel("positive", 3.0)


def test_a_neighbour_is_a_better_start_and_units_of_length_do_not_matter():
    material, points = solid(), lattice(ell(), 3.0)
    u = 0.01 * points.x * (1 + 0.1 * np.sin(points.x)) * np.array([1.0, 1.02, 1.04])[:, None, None]
    solve = {
        start: wp.solve(
            material,
            wp.Dirichlet(points, None, u),
            solver=wp.methods.PolakRibiere(1e-9, start=start),
        )
        for start in (None, "previous")
    }
    np.testing.assert_allclose(solve["previous"].u, solve[None].u, atol=1e-9)
    exact = wp.solve(material, wp.Dirichlet(points, None, u)).u
    np.testing.assert_allclose(solve[None].u, exact, atol=1e-8 * abs(exact).max())
    far, near = solve[None].iterations, solve["previous"].iterations
    assert near[0] == far[0]
    assert sum(near[1:]) < sum(far[1:])
    other, small = material.in_units(("m", "Pa")), 1e-10
    there = wp.Points(small * points.x, points.interior, small, units=("m", "Pa"))
    tiny = wp.solve(
        other, wp.Dirichlet(there, None, small * u), solver=wp.methods.PolakRibiere(1e-9)
    )
    assert tiny.iterations == far
    np.testing.assert_allclose(tiny.u / small, solve[None].u, atol=1e-9)


def test_a_scalar_field():
    points = lattice(6, 3.0)
    phi = np.sin(points.x[:, 0])
    conductor = wp.diffusion.Conductor(horizon=3.0)
    problem = wp.Dirichlet(points, None, np.stack([phi, 2 * phi]))
    found = wp.solve(conductor, problem, solver=wp.methods.PolakRibiere(), kappa=1.0)
    np.testing.assert_allclose(found.u, wp.solve(conductor, problem, kappa=1.0).u, atol=1e-7)


@pytest.mark.filterwarnings("ignore:transferred from:UserWarning")
@pytest.mark.slow
def test_scattered_points():
    wide = lattice(6, 4.5)
    x = wide.x + 0.1 * noise(wide)
    scattered = wp.Points(x, wide.interior, 0.0)
    problem = wp.Dirichlet(scattered, None, 0.01 * np.sin(x))
    found = wp.solve(solid(), problem, solver=wp.methods.PolakRibiere(1e-10, most=3000))
    exact = wp.solve(solid(), problem)
    np.testing.assert_allclose(found.u, exact.u, atol=1e-7 * abs(exact.u).max())


def test_a_search_that_is_stopped_is_no_answer():
    material, points = solid(), lattice(ell(), 3.0)
    samples = manufactured(material, points, 2)
    problem = wp.Dirichlet(points, samples.loads, samples.u)
    with pytest.raises(wp.InputError, match=r"sample 0: no equilibrium .* after 3 steps"):
        wp.solve(material, problem, solver=wp.methods.PolakRibiere(most=3))
    rest = wp.solve(
        material, wp.Dirichlet(points, None, 0 * samples.u), solver=wp.methods.PolakRibiere()
    )
    assert rest.iterations == (0, 0)
    assert rest.residual == 0


def test_what_is_refused():
    material, points = solid(), lattice(4, 3.0)
    u = noise(points)
    for asked, words in (
        ({"tolerance": 0.0}, "tolerance"),
        ({"most": 0.5}, "most"),
        ({"start": "next"}, "start: expected 'previous'"),
    ):
        with pytest.raises(wp.InputError, match=words):
            wp.methods.PolakRibiere(**asked)
    asked = wp.methods.PolakRibiere()
    problem = wp.Dirichlet(points, u, u)
    with pytest.raises(wp.InputError, match="start: expected shape"):
        wp.solve(material, problem, solver=wp.methods.PolakRibiere(start=u[:3]))
    with pytest.raises(wp.InputError, match="parameters"):
        wp.solve(material, problem, solver=asked, parameters=material.solid)
    with pytest.raises(wp.InputError, match="solver: expected"):
        wp.solve(material, wp.Periodic(points, u), solver=asked)


def test_a_search_from_no_number_ends_at_once():
    _, record = polak_ribiere(lambda u: u / 0, torch.ones(3))
    assert not record.converged
    assert record.steps == 0
