"""A material of one's own: two energies against closed solutions, through every verb."""

from functools import partial

import numpy as np
import torch
from scipy.integrate import quad
from scipy.optimize import brentq

import warp_peri as wp
from tests.support import assert_refused, near, parametrize, refused, sup
from tests.support.materials import saint_venant
from tests.support.problems import lattice, loaded, noise
from warp_peri.testing import check_material

LAM, MU = 0.4, 0.9


def blatz_ko(E, mu):
    """In plane stress: the thickness stretch is J^(−1/3) of the J of the plane."""
    C = torch.eye(2, dtype=E.dtype) + 2 * E
    square = C[..., 0, 0] * C[..., 1, 1] - C[..., 0, 1] * C[..., 1, 0]
    return mu / 2 * ((C[..., 0, 0] + C[..., 1, 1]) / square + 3 * square ** (1 / 3) - 5)


def box(n, d, h, collar=2):
    """n nodes along each axis about zero, and so many of them at either end in the collar."""
    inside = np.ones(d * (n - 2 * collar,), bool)
    return lattice(inside, collar * h / 2, h, origin=(collar - n // 2) * h)


SOLIDS = {
    "Saint Venant-Kirchhoff": (
        saint_venant, {"lam": LAM, "mu": MU}, 3,
        lambda h: (1 + h) * (LAM + 2 * MU) * (h + h * h / 2),
    ),
    "Blatz-Ko": (
        blatz_ko, {"mu": MU}, 2, lambda h: MU * ((1 + h) ** (-1 / 3) - (1 + h) ** -3.0)
    ),
}  # fmt: skip
"""Energy, parameters, dimension, and the first Piola stress of a stretch 1 + h along x alone."""


def stretched(points, stress):
    """u along x alone in equilibrium with a uniform load: P(u′) = P₀ + 0.02 x, and the load."""
    slope = lambda x: brentq(lambda h: stress(h) - (0.1 + 0.02 * x), -0.5, 0.9)
    at = np.unique(points.x[:, 0])
    value = dict(zip(at, (quad(slope, 0, x, epsabs=1e-13)[0] for x in at)))
    u, b = np.zeros_like(points.x), np.zeros_like(points.x)
    u[:, 0], b[:, 0] = [value[x] for x in points.x[:, 0]], -0.02
    return u, b


@parametrize("name", SOLIDS)
def test_a_stretched_block_is_solved_to_second_order(name):
    energy, parameters, d, stress = SOLIDS[name]
    errors = []
    for n in (9, 17):
        points = box(n, d, 8 / (n - 1))
        u, b = stretched(points, stress)
        material = wp.DensityMaterial.of(energy, points.spacing, parameters, dimension=d)
        answer = wp.solve(material, wp.Dirichlet(points, b, u))
        errors.append(np.abs(answer.u - u)[np.abs(points.x).max(1) <= 2].max() / sup(u))
        near(answer.stress()[np.abs(points.x[points.interior]).max(1) < 1e-9][0][0, 0], 0.1, 2e-3)
    assert errors[1] < errors[0] / 2 < 1e-5


@parametrize(
    ("name", "loss"), [*((name, "forces") for name in SOLIDS), ("Blatz-Ko", "displacement")]
)
def test_parameters_are_found_again(name, loss):
    energy, parameters, d, _ = SOLIDS[name]
    points = box(9 if d == 2 else 7, d, 0.5)
    u = 0.02 * noise(points, 2) + 0.05 * points.x
    samples = loaded(wp.DensityMaterial.of(energy, 0.5, parameters, dimension=d).on(points), u)
    far = 8.0 if loss == "displacement" else 1.3  # whose first step has no equilibrium
    start = {key: far * value for key, value in parameters.items()}
    found = wp.fit(samples, wp.Density(energy, 0.5, start, loss)).material
    for key, value in parameters.items():
        near(found.parameters[key], value, 1e-5)
    assert wp.evaluate(found, samples)["E_u"] < 1e-4


@parametrize("told", [torch.Tensor.item, torch.Tensor.numpy])
def test_what_torch_does_not_see_of_a_parameter_has_no_gradient(told):
    """Refused where the force changes with it, all or in part; zero where it does not."""
    points, of = box(9, 2, 0.5), partial(wp.DensityMaterial.of, horizon=0.5, parameters={"a": 0.0})
    u, taken = 0.02 * noise(points), partial(torch.as_tensor, dtype=torch.float64)

    def slope(energy):
        module = wp.TorchModule(of(energy), points)
        module(torch.from_numpy(u)).square().sum().backward()
        return module.a.grad

    hidden = lambda E, a: blatz_ko(E, MU + told(taken(a)))
    seen = lambda E, a: blatz_ko(E, taken(a).exp())
    half = lambda E, a: hidden(E, a) + blatz_ko(E, taken(a))
    of_sum = lambda E, a: blatz_ko(E, MU) + E.sum((-1, -2)) ** 2 * float(told(taken(a)))
    force = [of(of_sum, parameters={"a": a}).on(points)(u) for a in (0.0, 1.0)]
    across = noise(points, seed=1)[points.interior]  # along which all of the change is nothing
    across -= (change := force[1] - force[0]) * np.vdot(change, across) / np.vdot(change, change)
    words = "the energy does not differentiate 'a'; use torch functions"
    assert_refused({
        f"{words}$": (
            *(partial(slope, energy) for energy in (hidden, half)),
            lambda: of(of_sum).on(points).by_numbers("a", u, across),
        ),
        f"{words}, got 0.0": lambda: slope(lambda E, a: blatz_ko(E, {0.0: MU}[a])),
    })  # fmt: skip
    for bent in (torch.relu, lambda a: a**1.5, lambda a: a**3):  # at a kink, an end, a saddle
        assert slope(lambda E, a, by=bent: blatz_ko(E, MU + by(taken(a)))) == 0
    assert slope(seen) > 0 == slope(lambda E, a: blatz_ko(E, a + MU if E.max() > 9 else MU))
    samples = loaded(of(hidden, parameters={"a": 0.2}).on(points), u[None])
    near(wp.fit(samples, wp.Density(hidden, 0.5, {"a": 0.0})).material.parameters["a"], 0.2, 1e-5)
    for law, names in (
        (lambda E, a, c: hidden(E, a), "c .*"),
        (lambda E, a, c: hidden(E, a + c), "a .*, c .*"),
        (lambda E, a, c: blatz_ko(E, taken(a + c).exp()), "a .*, c .*"),
        (lambda E, a, c: hidden(E, a) + 1e-8 * c * E.sum((-1, -2)) ** 3, "c .*"),
    ):
        with refused(f"parameters: these samples do not tell {names}, or not from there"):
            wp.fit(samples, wp.Density(law, 0.5, {"a": 0.0, "c": 0.7}))
    squared = lambda E, a, c: blatz_ko(E, 4 * c) + a**2 * E.sum((-1, -2)) ** 2  # no slope at 0
    sets = loaded(of(squared, parameters={"a": 0.7, "c": 1.0}).on(points), u[None])
    some = lambda E, a, c: squared(E, a, c) if a < 1e-3 else None
    found = wp.fit(sets, wp.Density(some, 0.5, {"a": 0.0, "c": 0.9}))
    near(found.material.parameters["a"], -0.7, 1e-5)  # beside 0 on the other side
    assert found.history["evaluations"] > 25  # of slopes too, those of the start once
    found = wp.fit(sets, wp.Density(squared, 0.5, {"a": 0.7, "c": 1.0}))
    assert found.history["evaluations"] < 10
    check_material(of(seen), points, u, read=lambda path: wp.DensityMaterial.read(path, seen))


def test_an_energy_is_called_uncompiled_with_gradients_on_the_processor():
    with torch.inference_mode(), torch.device("meta"):
        op = wp.DensityMaterial.of(torch.compile(blatz_ko), 0.5, {"mu": MU}).on(box(9, 2, 0.5))
        force = op(u := 0.02 * noise(op.points))
        near(op.by_numbers("mu", u, force), np.vdot(force, force) / MU, 1e-12)


def test_what_cannot_be_used_is_refused_and_files_ask_for_the_energy(tmp_path):
    points, of = box(9, 2, 0.5), partial(wp.DensityMaterial.of, horizon=0.5, parameters={})
    material = of(blatz_ko, parameters={"mu": MU})
    wp.save(path := tmp_path / "own.json", material)
    assert wp.DensityMaterial.read(path, blatz_ko).parameters == material.parameters
    assert of(max).name == "max"  # what does not tell its arguments is taken
    wp.save(path.parent / "partial.json", of(blatz := partial(blatz_ko, mu=MU)))
    assert wp.DensityMaterial.read(path.parent / "partial.json", blatz).energy is blatz
    pulled = of(lambda E: E[..., 0, 0] + (E * E).sum((-1, -2)))
    one = "energy: expected one value a strain, .* got"
    assert_refused({
        "energy: the file has the parameters of 'blatz_ko'": lambda: wp.load(path),
        "'blatz_ko', got 'saint_venant'": lambda: wp.DensityMaterial.read(path, saint_venant),
        "mu: expected finite": lambda: of(blatz_ko, parameters={"mu": 1e200}),
        "parameters: expected those of the function": lambda: of(blatz_ko, parameters={"k": 1.0}),
        "parameters: .* 'k'": lambda: material.at({"k": 1.0}),
        "dimension: expected 2 or 3, got 4": lambda: of(blatz_ko, dimension=4),
        "energy: expected no stress at rest": lambda: pulled.on(points),
        "got 1.00e.00 of a stiffness of 0.0": lambda: of(lambda E: E[..., 0, 0]).on(points),
        "got 0.0.* of a stiffness of 0.0": lambda: of(lambda E: (E**4).sum((-1, -2))).on(points),
        "^energy: expected a function of strains in torch": (
            lambda: of(lambda E: E.detach().numpy()[..., 0, 0]).on(points),
            lambda: of(torch.Tensor.trace).on(points),
            lambda: of(lambda E: blatz_ko(E.float(), MU)).on(points),
        ),
        f"{one} NoneType": lambda: of(lambda E: None).on(points),
        f"{one} float": lambda: of(lambda E: 2.0).on(points),
        f"{one} .*2": lambda: of(lambda E: E).on(points),
        "energy: only parameters have a gradient; write energy.requires_grad_":
            lambda: of(lambda E: blatz_ko(E, torch.nn.Parameter(torch.tensor(MU)))).on(points),
        "expected all bonds of every interior": lambda: material.on(box(9, 2, 0.5, 1)),
    })  # fmt: skip
