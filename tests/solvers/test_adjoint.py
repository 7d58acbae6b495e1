"""Gradients through waves: differences of the whole motion, few states, and what is refused."""

import weakref
from functools import partial

import numpy as np
import pytest
import torch

import warp_peri as wp
from tests.support.materials import field, operator
from tests.support.problems import difference
from warp_peri.certificates import critical_time_step
from warp_peri.solvers import verlet
from warp_peri.solvers.adjoint import BATCH

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")
DENSITY = 2000.0
STEPS, EVERY = 14, 4


def longest(op):
    """The critical step [ps]."""
    if hasattr(op, "max_symbol_eigenvalue"):
        heavy = verlet.inertia(DENSITY, op.model.units)
        return 2 * np.sqrt(heavy / op.max_symbol_eigenvalue())
    return critical_time_step(op.model, spacing=op.points.spacing, density=DENSITY)


def given(op, factor=0.5):
    """Fields, records and sizes of a motion."""
    b, u, v = (torch.from_numpy(field(op, seed=n)) for n in range(3))
    nodes = np.flatnonzero(op.points.interior)[::3]
    step = factor * longest(op)
    options = {"density": DENSITY, "step": step, "steps": STEPS, "every": EVERY, "record": nodes}
    heavy = verlet.inertia(DENSITY, op.model.units)
    return {"b": heavy / step**2 / 50 * b, "u": u, "v": v / step / 10}, options


def loss(op, fields, options, parameters=None):
    """A number of records and ends, in units of the displacement."""
    extra = {} if parameters is None else {"parameters": parameters}
    motion = wp.simulate(op, wp.Dirichlet(op.points, fields["b"], fields["u"]), v=fields["v"],
                     **extra, **options)  # fmt: skip
    total, seen = 0.0, np.random.default_rng(1)
    for part in (motion["u"], motion.u, options["step"] * motion.v):
        seed = torch.from_numpy(seen.normal(size=part.shape))
        total = total + ((10 * part + seed) * part).sum()
    return total


def test_a_nonlinear_force_is_felt_where_the_motion_went():
    op = operator("third order, energy")
    fields, options = given(op)
    leaf = fields["u"].clone().requires_grad_()
    (gradient,) = torch.autograd.grad(loss(op, fields | {"u": leaf}, options), leaf)
    way = torch.from_numpy(np.random.default_rng(7).normal(size=leaf.shape))
    moved = lambda t: float(loss(op, fields | {"u": fields["u"] + t[0] * way}, options))
    slope = difference(moved, [0.0], 0.1 * float(fields["u"].abs().max()))[0]
    assert abs(float((gradient * way).sum()) - slope) <= 1e-7 * float(gradient.norm() * way.norm())


def test_the_motion_is_that_of_arrays_to_the_bit():
    op = operator("LPS")
    fields, options = given(op)
    arrays = {name: value.numpy() for name, value in fields.items()}

    def moved(of, **extra):
        problem = wp.Dirichlet(op.points, of["b"], of["u"])
        return wp.simulate(op, problem, v=of["v"], **options | extra)

    plain = moved(arrays)
    told = moved(fields, parameters=dict(wp.TorchModule(op, op.points).named_parameters()))
    for name in ("u", "v", "energy"):
        own, known = (torch.as_tensor(getattr(one, name)) for one in (told, plain))
        assert torch.equal(own, known)
    assert torch.equal(told["u"], torch.as_tensor(plain["u"]))
    assert plain["u"].shape == (len(plain.time), len(options["record"]), 2)
    first, second = (moved(arrays, steps=n, every=1) for n in (1, 2))
    mean = (first.u + second.u)[options["record"]] / 2
    assert np.array_equal(second["u"][1], mean)


def test_few_states_are_kept(monkeypatch):
    steps, op, alive, most = 200, operator("LPS, bond-based"), {}, [0]

    def forget(key, _):
        alive.pop(key, None)

    class Counted(verlet.State):
        """Counts displacements that are there at once."""

        def __init__(self, u, v, g, steps=0):
            super().__init__(u, v, g, steps)
            alive[id(u)] = weakref.ref(u, partial(forget, id(u)))
            most[0] = max(most[0], len(alive))

    monkeypatch.setattr(verlet, "State", Counted)
    fields, options = given(op)
    mu = torch.tensor(op.model.mu, requires_grad=True)
    problem = wp.Dirichlet(op.points, None, fields["u"].requires_grad_())
    sizes = options | {"steps": steps, "every": 100}
    motion = wp.simulate(op, problem, parameters={"mu": mu}, **sizes)
    assert most[0] <= np.sqrt(steps) + 3
    motion["u"].square().sum().backward()
    assert most[0] <= 2 * np.sqrt(steps) + BATCH + 3
    del motion
    kept = len(alive)  # the field that the operator swept last
    assert kept <= 1
    most[0] = 0
    wp.simulate(op, problem, **options | {"steps": 100})["u"].square().sum().backward()
    assert most[0] <= 4 + kept


def test_what_has_no_gradient_says_so():
    op = operator("LPS")
    fields, options = given(op)
    u = fields["u"].requires_grad_()

    def moved(of=op, u=u, **extra):
        return wp.simulate(of, wp.Dirichlet(of.points, None, u), **options | extra)

    (first,) = torch.autograd.grad(moved().u.square().sum(), u, create_graph=True)
    with pytest.raises(wp.InputError, match="second derivative"):
        first.sum().backward()
    for extra, words in (
        ({"step": 1.0}, "step: expected at most"),
        ({"checkpoint": "run.h5"}, "simulate: expected no checkpoint of tensors"),
        ({"parameters": {"kappa": 1.0}}, r"of shape lam \[\], mu .* D \[5\], got kappa \[\]"),
        ({"parameters": {"mu": 1e3 * op.model.mu}}, "step: expected at most"),
        ({"parameters": {"D": [0.0, 0.0, 0.0, -1.0, 1.0]}}, "is indefinite"),
    ):
        with pytest.raises(wp.InputError, match=words):
            moved(**extra)
    crystal = operator("crystal")
    with pytest.raises(wp.InputError, match=r"numbers of shape tensors \[14, 2, 2\], got mu"):
        moved(crystal, torch.zeros(crystal.shape), parameters={"mu": 1.0}, record=None)
    cracked = wp.Cracked(op.points, u=torch.zeros(op.shape, requires_grad=True))
    with pytest.raises(wp.InputError, match="pulls of bonds that soften.* got a Cracked"):
        wp.simulate(op.model, cracked, events=2)
    with pytest.raises(wp.InputError, match="record: expected none beside a checkpoint"):
        wp.simulate(
            op, wp.Dirichlet(op.points, None, u.detach().numpy()), checkpoint="r.h5", **options
        )
