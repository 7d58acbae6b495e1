"""Gradients through waves: differences of the whole motion, few states, and what is refused."""

import weakref

import numpy as np
import torch
from torch.autograd import grad

from tests.gradients.cases import given
from tests.support import assert_refused, each_refused, filterwarnings, near
from tests.support.materials import operator
from warp_peri import Cracked, Dirichlet, TorchModule, simulate
from warp_peri.solvers import verlet
from warp_peri.solvers.adjoint import BATCH

pytestmark = filterwarnings("ignore::UserWarning")


def test_the_motion_is_that_of_arrays_to_the_bit():
    op = operator("LPS")
    fields, options = given(op)
    arrays = {name: value.numpy() for name, value in fields.items()}

    def moved(of, **extra):
        return simulate(op, Dirichlet(op.points, of["b"], of["u"]), v=of["v"], **options | extra)

    plain = moved(arrays)
    told = moved(fields, parameters=dict(TorchModule(op, op.points).named_parameters()))
    for name in ("u", "v", "energy"):
        own, known = (torch.as_tensor(getattr(one, name)) for one in (told, plain))
        assert torch.equal(own, known)
    assert torch.equal(told["u"], torch.as_tensor(plain["u"]))
    assert plain["u"].shape == (len(plain.time), len(options["record"]), 2)
    first, second = (moved(arrays, steps=n, every=1) for n in (1, 2))
    near(second["u"][1], (first.u + second.u)[options["record"]] / 2, 0)


def test_few_states_are_kept(monkeypatch):
    steps, op, most = 200, operator("LPS, bond-based"), [0]
    alive = weakref.WeakValueDictionary()

    class Counted(verlet.State):
        """Counts displacements that are there at once."""

        def __init__(self, u, v, g, steps=0):
            super().__init__(u, v, g, steps)
            alive[id(u)] = u
            most[0] = max(most[0], len(alive))

    monkeypatch.setattr(verlet, "State", Counted)
    fields, options = given(op)
    mu = torch.tensor(op.model.mu, requires_grad=True)
    problem = Dirichlet(op.points, None, fields["u"].requires_grad_())
    sizes = options | {"steps": steps, "every": 100}
    motion = simulate(op, problem, parameters={"mu": mu}, **sizes)
    assert most[0] <= np.sqrt(steps) + 3
    motion["u"].square().sum().backward()
    assert most[0] <= 2 * np.sqrt(steps) + BATCH + 3
    del motion
    kept = len(alive)  # the field that the operator swept last
    assert kept <= 1
    most[0] = 0
    simulate(op, problem, **options | {"steps": 100})["u"].square().sum().backward()
    assert most[0] <= 4 + kept


def test_what_has_no_gradient_says_so():
    op = operator("LPS")
    fields, options = given(op)
    u = fields["u"].requires_grad_()

    def moved(of=op, u=u, **extra):
        return simulate(of, Dirichlet(of.points, None, u), **options | extra)

    (first,) = grad(moved().u.square().sum(), u, create_graph=True)
    each_refused(lambda extra: moved(**extra), {
        "step: expected at most": {"step": 1.0},
        "steps: expected at most .* steps": {"steps": 10**12},
        "simulate: expected no checkpoint of tensors": {"checkpoint": "run.h5"},
        r"among lam \[\], mu .* D \[5\], got kappa \[\]": {"parameters": {"kappa": 1.0}},
        "expected at most": {"parameters": {"mu": 1e3 * op.model.mu}},
        "is indefinite": {"parameters": {"D": [0.0, 0.0, 0.0, -1.0, 1.0]}},
    })  # fmt: skip
    crystal, of_mu = operator("crystal"), {"parameters": {"mu": 1.0}, "record": None}
    cracked = Cracked(op.points, u=torch.zeros(op.shape, requires_grad=True))
    assert_refused({
        "second derivative": lambda: first.sum().backward(),
        r"numbers among tensors \[10, 2, 2\], got mu":
            lambda: moved(crystal, torch.zeros(crystal.shape), **of_mu),
        "pulls of bonds that soften.* got a Cracked": lambda: simulate(op.model, cracked, events=2),
        "record: expected none beside a checkpoint": lambda: simulate(
            op, Dirichlet(op.points, None, u.detach().numpy()), checkpoint="r.h5", **options
        ),
    })  # fmt: skip
