"""Nothing decides on an absolute stiffness, length or force: a solid a million times as soft or as
large gives the same strains."""

from dataclasses import fields, is_dataclass, replace

import numpy as np
import pytest
import torch
from torch.autograd import grad

import warp_peri as wp
from tests.conformance.test_breaking import CRACK, SOLIDS, points_of
from tests.support import filterwarnings, in_plane_and_space, near, parametrize, sup
from tests.support.clouds import larger
from tests.support.fields import field, solved_samples, uneven
from tests.support.materials import LAWS, SPREAD, operator, placed, saint_venant
from tests.support.problems import kernel, lattice, loaded, noise, on_interior
from tests.support.sheets import waves
from tests.support.solving import solve
from warp_peri.fracture import Cracked
from warp_peri.points.arguments import USUAL, factors

pytestmark = filterwarnings(
    "ignore:strain:UserWarning", "ignore:transferred:UserWarning", "ignore:spacing:UserWarning"
)
SCALES = {
    "small and stiff": (("nm", "mm"), ("TPa", "MPa")),
    "large and soft": (("mm", "nm"), ("MPa", "TPa")),
}
"""Units here and there of lengths, and of stresses."""
SOLID = kernel("1/r", 2.0, lam=0.9)


@pytest.fixture(params=SCALES)
def scale(request):
    return SCALES[request.param]


def named(value, units):
    """The same numbers under other units, those of parts too."""
    if not is_dataclass(value):
        value.units = units
        return value
    parts = {
        field.name: named(part, units)
        for field in fields(value)
        if hasattr(part := getattr(value, field.name), "in_units")
    }
    own = {"units": units} if "units" in {field.name for field in fields(value)} else {}
    return replace(value, **parts, **own)


def resized(material, scale):
    """The material with lengths and moduli a million times as large or small, and both factors."""
    have, want = zip(*scale)
    return named(named(material, have).in_units(want), USUAL), *factors(have, want)


@parametrize("name", SPREAD)
def test_a_force_a_solve_and_a_motion(name, scale):
    law, (op, points) = SPREAD[name], placed(name, 3)
    u = uneven(points)
    other, length, stress = resized(law.on(points), scale)
    there = larger(points, length)
    twin = other.on(there)
    near(twin(length * u), op(u) * stress / length, 1e-9)
    near(twin.jvp(length * u, length * u), op.jvp(u, u) * stress / length, 1e-9)
    near(twin.stress(length * u), op.stress(u) * stress, 1e-9)
    if law.energy:
        near(twin.energy(length * u), op.energy(u) * stress * length**2, 1e-9)
    samples = solved_samples(op)[:1]
    errors = wp.evaluate(twin, wp.Samples(there, length * samples.u, samples.b * stress / length))
    assert errors["E_res"] < 1e-9
    assert errors["E_u"] < 1e-7
    how = {"density": 1000.0, "steps": 5, "every": 5}
    step = 1e-2 * points.spacing / np.sqrt(sup(op.stress(u)) / 0.05 * 1e8 / 1000)
    slower, start = length / np.sqrt(stress), wp.Dirichlet(there, None, length * u)
    try:
        moved = wp.simulate(op, wp.Dirichlet(points, None, u), step=step, **how)
    except wp.InputError:
        with pytest.raises(wp.InputError):
            wp.simulate(twin, start, step=step * slower, **how)
        return
    again = wp.simulate(twin, start, step=step * slower, **how)
    near(again.u, length * moved.u, 1e-9)
    near(np.asarray(again.v), np.asarray(moved.v) * length / slower, 1e-6)


@parametrize("name", ["third order, energy", "density", "hyperelastic", "neural operator"])
def test_very_small_loads_are_answered_in_proportion_and_unanswerable_ones_refused(name):
    op, points = placed(name)
    b, u = waves(points, 1e-3), on_interior(points, 0, waves(points, 1.0, 1))
    first, *found = (solve(op, points, size * b, size * u) / size for size in (1e-8, 1e-9, 1e-200))
    for one in found:
        near(one, first, 1e-6)
    load = wp.Dirichlet(points, 1e170 * waves(points, 1.0), 0 * points.x)
    with np.errstate(all="ignore"), pytest.raises(wp.InputError):
        wp.solve(LAWS[name].material(), load)


def test_another_lattice(scale):
    """A kernel is fitted there, whose conditions are those of the solid, however soft."""
    bound = wp.certify(SOLID, spacing=1.0).figures()
    material = replace(SOLID, certificate={"1": bound})
    other, length, stress = resized(material, scale)
    points = lattice(6, 5.0, 0.5)
    made, there = loaded(material.on(points), uneven(points, 1)), larger(points, length)
    found = wp.solve(other, wp.Dirichlet(there, made.b * stress / length, length * made.u))
    near(found.u, length * made.u, 1e-4)
    assert found.proven


@parametrize("size", [1e-6, 1e6, 1e-10])
def test_numbers_that_a_fit_starts_at_zero(size):
    op = placed("density")[0]
    one = solved_samples(op)
    there = wp.Samples(larger(op.points, size), size * one.u, one.b)
    found = wp.fit(there, wp.Density(saint_venant, size, {"lam": 0.0, "mu": size})).material
    near([*found.parameters.values()], size * np.array([0.4, 0.9]), 1e-6)
    ring = lambda r, radius: np.exp(-(((r - radius) / (2 * size)) ** 2))
    true, start = (wp.influence.InfluenceFunction(ring, {"radius": r}) for r in (size, 0.0))
    solid = true.model(lam=0.3 * size, mu=0.7 * size, horizon=3 * size, spacings=[size])
    points = larger(LAWS["LPS"].points(4), size)
    samples = loaded(solid.on(points, allow_uncertified=True), uneven(points, 4))
    near(wp.fit(samples, wp.LPS(3 * size, start)).influence.parameters["radius"], size, 1e-6)


def test_a_coupled_solid_and_its_gradient(scale):
    op = operator("coupled")
    other, length, stress = resized(op.model, scale)

    def found(model, points, by, load):
        b = torch.tensor(load * field(op) * [0, 0, 1], requires_grad=True)
        problem = wp.Dirichlet(points, b, np.zeros(op.shape))
        rest, moved = wp.solve(model, problem), wp.simulate(model, problem, step=0.1, steps=2)
        for u in (rest.u / torch.tensor(by), moved.u / torch.tensor(by)):
            yield u.detach().numpy()
            yield grad(u.sum(), b)[0].numpy() * load

    by, points = np.array([length, length, 1.0]), op.points
    twins = found(other, larger(points, length), by, stress / by)
    for here, there in zip(found(op, points, np.ones(3), np.ones(3)), twins, strict=True):
        near(there[:, 0], here[:, 0], 1e-8)
        near(there, here, 1e-8)


@in_plane_and_space
def test_a_crack_at_rest(d, scale):
    points, crack = points_of(d), np.array(CRACK[d])
    b, u = 1e-3 * noise(points), 0.01 * points.x * np.arange(1, d + 1)
    for name in ("brittle", "brittle, by stretch", "soft"):
        solid = SOLIDS[name](d)
        other, length, stress = resized(solid, scale)
        first = wp.solve(solid, Cracked(points, b, u, crack))
        there = Cracked(larger(points, length), b * stress / length, length * u, length * crack)
        found = wp.solve(other, there)
        near(found.u, length * first.u, 1e-9)
        near(found.energy(), first.energy() * stress * length**d, 1e-9)
