"""The force and its derivatives: against slow sums and differences, on points of any kind."""

from dataclasses import replace

import numpy as np
import pytest
import torch
import warp as wp
from numpy.random import default_rng
from torch.autograd import grad

from tests.gradients.cases import assert_slopes
from tests.support import approx, clouds, near, parametrize, problems, reference, sup
from tests.support.clouds import cloud, periodic_cloud
from tests.support.fields import double
from tests.support.problems import KERNELS, LAM, MU, ROUNDING, ell, kernel, lattice, noise, periodic
from tests.support.told import each_refused
from tools.rivals import BULK, SHEAR, SIZE, PeriLps
from warp_peri import Points
from warp_peri.atoms.calculators import LammpsError, lammps_class
from warp_peri.materials.lps import moduli
from warp_peri.materials.lps_force import Bonds, assemble
from warp_peri.materials.lps_operator import LPSOperator, lps_force
from warp_peri.methods import LPSParameters
from warp_peri.points.families import bond_classes

pytestmark = pytest.mark.filterwarnings("ignore:spacing. the model is certified")
HORIZON = 3.0
STEPS = {"u": 10.0, "lam": 10.0, "mu": 10.0, "alpha": 0.1, "D": 0.02}
"""Of differences, in hundredths of the size of what is moved."""
error = lambda value, expected: sup(value - expected) / sup(expected)
halved = lambda points: problems.cut(points, points.x[:, 0] > points.x[points.interior, 0].mean())
"""The interior without the half that is cut away."""
across = lambda points: problems.renumbered(points, np.lexsort(points.x.T))
"""Numbered along the other axis."""
KINDS = {
    "lattice": lambda: lattice(2, HORIZON),
    "periodic cloud": lambda: periodic_cloud(7),
    "cut lattice": lambda: halved(lattice(2, HORIZON)),
    "cut cloud": lambda: halved(cloud(2, HORIZON)),
}
SETS = {
    "L with a hole": lambda: lattice(np.kron(ell(), np.ones((4, 4))) > 0, HORIZON),
    "rotated": lambda: lattice(9, HORIZON, angle=0.7),
    "periodic, the other axis": lambda: across(periodic((9, 7))[0]),
    "periodic, partly interior": problems.partly_periodic,
}
"""Lattices that are laid out in rows."""


class Problem:
    """A scalar of L u, of first and second order, as a function of everything; λ and μ are numbers,
    or fields."""

    def __init__(self, name, points, samples=2, *, fields=False):
        self.bonds, random = Bonds(points, HORIZON), default_rng(1)
        self.seed = torch.from_numpy(noise(points, samples, seed=4)[:, points.interior])
        values = {"u": noise(points, samples), "lam": LAM, "mu": MU, **KERNELS[name]}
        if fields:
            values |= {n: values[n] + 0.2 * random.random(len(points.x)) for n in ("lam", "mu")}
        self.leaves = {part: torch.tensor(np.atleast_1d(v)).double() for part, v in values.items()}

    def scalar(self, leaves):
        Lu = lps_force(self.bonds, *leaves.values())
        return (self.seed * Lu).sum() + (Lu**2).sum() / 100

    def gathered(self):
        """Derivatives by name, and the force."""
        given = {part: leaf.clone().requires_grad_() for part, leaf in self.leaves.items()}
        with torch.no_grad():
            force = lps_force(self.bonds, *given.values())
        gradients = grad(self.scalar(given), [*given.values()])
        return {p: by.numpy() for p, by in zip(given, gradients)} | {"force": force.numpy()}


@parametrize(
    ("name", "horizon", "points"),
    [
        ("sign-changing", 3.0, lattice(ell(), 3.0, angle=0.7, origin=(5.0, -2.0))),
        ("steep", 2.5, periodic((6, 7))[0]),
        ("sign-changing", 3.0, cloud(4, 3.0)),
        ("sign-changing", 3.0, periodic_cloud(7)),
    ],
)
def test_is_the_reference(name, horizon, points):
    model, u = kernel(name, horizon, lam=-0.2), noise(points)
    at = points.x, points.interior, model, u, points.box and np.array(points.box)
    expected = reference.operator(*at)
    assert error(model.on(points, allow_uncertified=True)(u), expected) < 10 * ROUNDING
    parts = LPSOperator(model, points).matrices
    L = parts.operator(model.lam, model.mu)
    assert error((L @ u.ravel()).reshape(-1, 2), expected) < 10 * ROUNDING
    theta, needed = parts.phi @ u.ravel(), np.unique(parts.psi.indices)[::20]
    dilated = [reference.dilatation(points.x, i, model, u, at[-1]) for i in needed]
    assert error(theta[needed], dilated) < 10 * ROUNDING
    scaled = replace(model, D=-1e9 * model.D)  # K's scale and sign have no effect
    assert error(scaled.on(points, allow_uncertified=True)(u), expected) < 10 * ROUNDING


@parametrize("kind", KINDS)
def test_derivatives_are_those_of_differences_and_fields_those_of_numbers(kind):
    problem = Problem("sign-changing", KINDS[kind](), 1, fields=True)
    assert_slopes(problem.scalar, problem.leaves, STEPS, 1e-8)
    number = Problem("sign-changing", KINDS[kind](), 1).gathered()
    for part in ("lam", "mu"):
        problem.leaves[part].fill_({"lam": LAM, "mu": MU}[part])
    for part, by in problem.gathered().items():
        by = by.sum(keepdims=True) if part in ("lam", "mu") else by
        assert error(by, number[part]) < 1e-12, part


@parametrize("kind", SETS)
def test_rows_are_the_lists_of_neighbours(kind, monkeypatch):
    rows = Problem("sign-changing", SETS[kind](), 3)
    assert rows.bonds.layout.in_rows
    by_rows = rows.gathered()
    monkeypatch.setattr(Bonds, "_rows", lambda _: None)
    for part, by_lists in Problem("sign-changing", SETS[kind](), 3).gathered().items():
        assert error(by_rows[part], by_lists) < (1e-14 if part in ("u", "force") else 2e-13), part


def test_nodes_in_no_order_or_far_apart_or_beside_a_crack_stay_in_their_lists():
    points = lattice(8, HORIZON)
    mixed = problems.renumbered(points, default_rng(0).permutation(len(points.x)))
    apart = Points(np.concatenate([points.x, points.x + 200.0]), np.tile(points.interior, 2), 1.0)
    for one in (mixed, apart, halved(points)):
        assert not Bonds(one, HORIZON).layout.in_rows
    torn = kernel("positive", HORIZON).on(halved(points), allow_uncertified=True)
    assert torn.energy(noise(points)) is None  # its force has none where λ is not μ


def test_bond_based_forces_need_half_the_collar():
    model, wave = kernel("sign-changing", HORIZON, lam=0.8), lambda op: np.sin(7 * op.points.x)
    bodies = lattice(3, HORIZON / 2), lattice(3, HORIZON)
    operator, whole = (model.on(body, allow_uncertified=True) for body in bodies)
    u = wave(operator)
    near(operator(u), whole(wave(whole)), 1e-12)
    assert error(operator.matrix() @ u.ravel(), operator(u).ravel()) < ROUNDING


def test_on_a_tape_of_the_user():
    """Force and gradients are those of torch; what is refused."""
    points, model = lattice(5, HORIZON), kernel("sign-changing", HORIZON)
    operator, u = model.on(points), noise(points, 2)
    field = wp.array(u, dtype=wp.vec2d, requires_grad=True)
    values = map(np.atleast_1d, model.learnable.values())
    numbers = [wp.array(one, dtype=wp.float64, requires_grad=True) for one in values]
    seed = noise(points, 2, seed=1)[:, points.interior]
    out = wp.zeros((2, len(seed[0])), dtype=wp.vec2d, requires_grad=True)
    with wp.Tape() as tape:
        operator.launch(field, out, LPSParameters(*numbers))
    tape.backward(grads={out: wp.array(seed, dtype=wp.vec2d)})
    leaves = [torch.tensor(one.numpy(), requires_grad=True) for one in (field, *numbers)]
    Lu = lps_force(operator.bonds, *leaves)
    near(out.numpy(), Lu.detach().numpy(), 0)
    for array, by in zip([field, *numbers], grad(Lu, leaves, torch.from_numpy(seed))):
        assert error(array.grad.numpy(), by.numpy()) <= 1e-14
    operator.launch(field, out)  # no tape: the force alone, of the model's own numbers
    near(out.numpy(), operator(u), 0)
    soft = wp.array([-1.0], dtype=wp.float64)
    shorter = LPSParameters(*numbers[:-1], numbers[-1][:-1])
    each_refused(operator.launch, {
        "parameters: expected LPSParameters.*, got dict": (field, out, {}),
        "parameters: expected LPSParameters.*, got LPSMaterial": (field, out, model),
        "mu: expected": (field, out, LPSParameters(numbers[0], soft, *numbers[2:])),
        r"D: expected shape \[5\], got \[4\]": (field, out, shorter),
        r"out: expected a contiguous .* \[2, 25\]": (field, out[:, :-1]),
        "u: expected a contiguous array of Warp of shape": (field.numpy(), out),
    })  # fmt: skip


def test_no_table_is_stale_and_a_bond_may_have_no_influence():
    """K vanishes where r = δ, at the last bond."""
    points = cloud(5, HORIZON)
    points = replace(points, x=np.round(points.x * 4) / 4)
    u, operator = noise(points), kernel("positive", HORIZON).on(points, allow_uncertified=True)
    assert (operator.bonds.families.r == HORIZON).any()
    for change in ({"lam": -0.1}, {"mu": 0.5}, {"alpha": 0.9}, {"D": [1.0, 0.5, 0.2, 0.0]}):
        operator.model = replace(operator.model, **change)
        assert error(operator(u).ravel(), operator.matrix() @ u.ravel()) < ROUNDING


def test_moduli_are_those_of_the_continuum_on_every_lattice():
    C = moduli(kernel("1/r", 5.0), bond_classes(1.0, 5.0))
    assert C == approx({"C11": LAM + 2 * MU, "C12": LAM, "C44": MU}, rel=1e-9)
    C = moduli(clouds.solid(2.5), bond_classes(1.0, 2.5, dimension=3))
    assert C == approx({"C11": 1.9, "C12": 0.3, "C44": 0.8}, rel=1e-12)


def test_other_weights_stay_those_of_a_solve_with_other_numbers():
    """And the certificate, which is of the usual weights, says nothing of them."""
    points, model = lattice(7, HORIZON), kernel("1/r", HORIZON)
    b, other = noise(points), replace(model, mu=0.6)
    for degree in (2, 6):
        operator = model.on(points, quadrature_degree=degree)
        found = operator.solve(b, 0 * b, parameters={"mu": double(0.6)})
        expected = other.on(points, quadrature_degree=degree).solve(b, 0 * b)
        assert error(np.asarray(found.u), expected.u) < 1e-9
        assert operator.proven is None


def test_every_force_is_that_of_lammps_with_its_volumes():
    """Of pair_style peri/lps, whose influence is 1/r; they fall off over the last half spacing."""
    try:
        bare = lammps_class()(cmdargs=["-screen", "none", "-log", "none"])
    except LammpsError as error:
        pytest.skip(str(error))
    if not bare.has_style("pair", "peri/lps"):
        pytest.skip("this LAMMPS has no pair_style peri/lps")
    lammps, points = PeriLps(11, 2.0), clouds.cube(3, 2.0)
    classes = bond_classes(1.0, 2.0, dimension=3)
    place = {tuple(p): i for i, p in enumerate(np.rint(lammps.x - 4).astype(int))}
    there = [place[tuple(p)] for p in points.x.astype(int)]
    u = SIZE * noise(lammps)
    theirs = lammps.force(u)[there][points.interior]
    lammps.close()
    weight = np.minimum(1.0, 2.0 + 0.5 - classes.r)
    kw, m = weight / classes.r, classes.count @ (weight * classes.r)
    L = assemble(Bonds(points, 2.0), kw, m).operator(BULK - 2 * SHEAR / 3, SHEAR)
    near(theirs, -(L @ u[there].ravel()).reshape(-1, 3), 1e-5)
