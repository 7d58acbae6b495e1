"""Finite elements at large deformation: tangents, exact fields, orders, data that resume."""

import numpy as np
import pytest

skfem = pytest.importorskip("skfem")

from tools.hyperelastic_elements import Elements, NotSolved, quadrilaterals, triangles  # noqa: E402
from tools.hyperelastic_energies import Family, Fung, hgo, plane_stress_hgo  # noqa: E402
from tools.make_hgo import Material, make_hgo, sample, square_points  # noqa: E402
from warp_peri import InputError  # noqa: E402

FIBRES = (Family(0.3, 0.1, 1.5), Family(-1.0, 0.2, 0.0))
ENERGIES = {
    "hgo": hgo(0.33, 0.15, FIBRES),
    "plane stress": plane_stress_hgo(0.2, FIBRES),
    "fung": Fung([1.0, 0.8, 0.3, 0.5, -0.2, 0.1]),
}


@pytest.mark.parametrize("name", ENERGIES)
def test_slopes_and_curves_of_the_energies(name):
    energy = ENERGIES[name]
    random = np.random.default_rng(0)
    c = np.array([1.2, 1.1, 0.1]) + 0.1 * random.normal(size=(20, 3))
    _, g, H = energy(c)
    for n, step in enumerate(1e-6 * np.eye(3)):
        above, below = energy(c + step), energy(c - step)
        np.testing.assert_allclose(g[:, n], (above[0] - below[0]) / 2e-6, rtol=1e-6, atol=1e-8)
        np.testing.assert_allclose(H[:, n], (above[1] - below[1]) / 2e-6, rtol=1e-5, atol=1e-7)


def test_the_tangent_is_the_slope_of_the_forces():
    mesh = Elements(quadrilaterals(3))
    random = np.random.default_rng(1)
    u, v = 0.02 * random.normal(size=2 * mesh.nodes), random.normal(size=2 * mesh.nodes)
    energy = ENERGIES["hgo"]
    ends = [mesh.internal(energy, u + sign * 1e-6 * v) for sign in (1, -1)]
    np.testing.assert_allclose(
        mesh.tangent(energy, u) @ v, (ends[0] - ends[1]) / 2e-6, rtol=1e-5, atol=1e-7
    )


def test_uniform_strain_is_reproduced():
    mesh = Elements(quadrilaterals(3))
    F = np.array([[1.2, 0.1], [0.0, 0.9]])
    exact = (mesh.x @ (F - np.eye(2)).T).ravel()
    u = mesh.solve(ENERGIES["hgo"], np.zeros(2 * mesh.nodes), mesh.edge, exact[mesh.edge])
    np.testing.assert_allclose(u, exact, atol=1e-8)


def test_linear_triangles_converge_with_the_second_power():
    def b(x):
        return 0.5 * np.sin(np.pi * x[..., ::-1])

    matrix = hgo(0.33, 0.15, ())
    probe = np.array([[0.5, 0.5], [0.25, 0.5], [0.75, 0.25]])

    def field(mesh):
        u = mesh.solve(matrix, mesh.load(b), mesh.edge, np.zeros(len(mesh.edge)))
        return mesh.sample(u, probe)

    fine = field(Elements(quadrilaterals(32)))
    errors = [
        np.linalg.norm(field(Elements(triangles(n), skfem.ElementTriP1(), order=2)) - fine)
        for n in (8, 16, 32)
    ]
    rate = -np.polyfit(np.log([8, 16, 32]), np.log(errors), 1)[0]
    assert 1.7 < rate < 2.5


def test_a_load_without_equilibrium_is_refused():
    mesh = Elements(quadrilaterals(2))
    load = 1e6 * np.ones(2 * mesh.nodes)
    with pytest.raises(NotSolved, match="no equilibrium beyond"):
        mesh.solve(ENERGIES["hgo"], load, mesh.edge, np.zeros(len(mesh.edge)))


def test_data_are_the_same_after_an_interruption(tmp_path):
    counts = (2, 1, 0, 0)
    first = make_hgo(tmp_path / "a", counts=counts, jobs=1, progress=False)
    sample(tmp_path / "b", Material(), "square", 1001)  # was solved before it stopped
    again = make_hgo(tmp_path / "b", counts=counts, jobs=1, progress=False)
    for name in ("train", "val"):
        assert np.array_equal(first[name].u, again[name].u)
    assert first["train"].u.shape == (2, 441, 2)
    assert np.abs(first["train"].u[:, ~inside()]).max() == 0
    with pytest.raises(InputError, match="square: expected one of"):
        make_hgo(tmp_path / "c", square="cube")


def inside():
    x = square_points().x
    return ((x > 1e-9) & (x < 1 - 1e-9)).all(axis=1)
