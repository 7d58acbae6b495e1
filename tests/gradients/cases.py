"""Every material by verb: a number of what the verb gives, its gradient, and how wrong that is."""

import numpy as np
import torch
from numpy.random import default_rng
from torch.autograd import grad

import warp_peri as wp
from tests.support.fields import seeded, tensor, tensors
from tests.support.materials import FLOWS, KINKED
from tests.support.problems import normal, slope
from warp_peri.certificates import critical_time_step
from warp_peri.solvers.verlet import inertia

DENSITY = 2000.0
LOADS = {"hyperelastic": 0.1, "third order": 0.1, "neural": 0.1}
"""Of nonlinear solids, so that all samples have an equilibrium."""
NOTHING = 1e-5
"""Share of the number that a hundredth of what has no effect on it moves, as of a scale of D."""


def numbers_of(op):
    """Learnable numbers a thousandth off, so that the operator is made anew; tensors, whose proof
    takes longest, and those of networks as they are."""
    if any(one.requires_grad for one in op.networks):
        return {"networks": torch.nn.utils.parameters_to_vector(op.networks).detach()}
    if not hasattr(op, "at"):
        return {}
    numbers = {n: torch.tensor(np.asarray(v, float)) for n, v in op.learnable.items()}
    return {n: value if n == "tensors" else 1.001 * value for n, value in numbers.items()}


def solver_of(name, op):
    """One that leaves no error of its own."""
    if name.startswith(("scattered", "conductor", "coupled", "cut")):
        return None
    if "broken" in name:
        return wp.Direct()
    return wp.CG(tolerance=1e-13) if op.is_linear else wp.Newton(tolerance=1e-13)


def learned(op, leaves):
    """Leaves by name of the material's own, once those of networks are put in their place."""
    if "networks" in leaves:
        torch.nn.utils.vector_to_parameters(leaves["networks"].detach(), op.networks)
    return {name: leaves[name] for name in numbers_of(op) if name != "networks"}


def given(op):
    """Fields, records and sizes of a motion at half of the critical step."""
    b, u, v = tensors(op, count=3)
    heavy = inertia(DENSITY, op.model.units)
    if hasattr(op, "max_symbol_eigenvalue"):
        step = np.sqrt(heavy / op.max_symbol_eigenvalue())
    else:
        step = critical_time_step(op.model, spacing=op.points.spacing, density=DENSITY) / 2
    nodes = np.flatnonzero(op.points.interior)[::3]
    options = {"density": DENSITY, "step": step, "steps": 14, "every": 4, "record": nodes}
    return {"b": heavy / step**2 / 50 * b, "u": u, "v": v / step / 10}, options


def loss(op, fields, options, parameters=None):
    """A number of records and ends, in units of the displacement."""
    extra = {} if parameters is None else {"parameters": parameters}
    problem = wp.Dirichlet(op.points, fields["b"], fields["u"])
    motion = wp.simulate(op, problem, v=fields["v"], **extra, **options)
    total, seen = 0.0, default_rng(1)
    for part in (motion["u"], motion.u, options["step"] * motion.v):
        total = total + ((10 * part + torch.from_numpy(seen.normal(size=part.shape))) * part).sum()
    return total


def errors(value, leaves, step, networks=(), least=0.0):
    """Relative error of the gradient to each leaf, along a direction of random entries.

    Args:
        value: a number, of the leaves by name.
        leaves: tensors; a direction has a hundredth of their size, or of the least.
        step: of the differences, by name and in directions.
        networks: parameters that a last leaf of this name is the vector of.

    An error is over the gradient's norm by the root mean square of the direction's entries.
    """
    asked = {name: leaf.detach().clone().requires_grad_() for name, leaf in leaves.items()}
    total = value(asked)
    of = [leaf for name, leaf in asked.items() if name != "networks"]
    gradients = grad(total, [*of, *networks])
    if networks:
        vector = torch.cat([one.ravel() for one in gradients[len(of) :]])
        gradients = (*gradients[: len(of)], vector)
    found = {}
    for (name, leaf), gradient in zip(leaves.items(), gradients):
        way = torch.ones(leaf.shape, dtype=torch.float64)
        if leaf.numel() > 1:
            way = torch.from_numpy(normal(leaf.shape, 7))
        way = way + way.mT if name == "tensors" else way  # unsymmetric ones are refused
        way = 0.01 * max(float(leaf.abs().max()), least) * way

        def along(t, name=name, leaf=leaf, way=way):
            with torch.no_grad():
                return float(value(leaves | {name: leaf + t * way}))

        expected = slope(along, step[name], order=4)
        size = float(gradient.norm() * way.norm()) / way.numel() ** 0.5
        size = max(size, NOTHING * abs(float(total.detach())))
        found[name] = abs(float((gradient * way).sum()) - expected) / size
    return found


def assert_slopes(value, leaves, step, limit, *more, **how):
    """That no such error is above a limit; `step` by name, or one for all."""
    step = step if isinstance(step, dict) else dict.fromkeys(leaves, step)
    found = errors(value, leaves, step, *more, **how)
    assert max(found.values()) <= limit, found


def table(name, op, value, leaves, own):
    """As errors, `own` the step of fields; networks have their own numbers again afterwards.

    The steps of numbers are a third, less of many; of a kernel of scattered points, whose
    coefficients are large, the least.
    """
    many = {"D": 0.01 if name.startswith("scattered") else 0.1, "tensors": 0.005, "networks": 1e-4}
    step = dict.fromkeys(("b", "u", "v", "signal", "collar"), own) | many
    step = {name: step.get(name, 0.3) for name in leaves}
    found = errors(value, leaves, step, op.networks if "networks" in leaves else ())
    learned(op, leaves)
    return found


def force(name, op):
    """Of the force, to u and to numbers."""
    leaves = {"u": tensor(op, 2)} | numbers_of(op)

    def value(leaves):
        own = learned(op, leaves)
        return seeded(op.force_with_parameters(leaves["u"], own) if own else op(leaves["u"]))

    return table(name, op, value, leaves, 1e-3 if name in KINKED else 1.0)


def solve(name, op):
    """Of what rests, to b, u and numbers."""
    b, u = tensors(op, 2)
    share = next((s for word, s in LOADS.items() if word in name), 1.0)
    solver, held = solver_of(name, op), {} if op.points.interior.all() else {"u": u}
    leaves = {"b": share * b} | held | numbers_of(op)

    def value(leaves):
        own = learned(op, leaves)
        extra = {"parameters": own} if own else {}
        given = {name: leaves[name] for name in ("b", *held)}
        problem = (wp.Dirichlet if held else wp.Periodic)(op.points, **given)
        return seeded(wp.solve(op, problem, solver=solver, **extra).u)

    return table(name, op, value, leaves, 1e-2 if name in KINKED else 10.0 if op.is_linear else 1.0)


def simulate(name, op):
    """Of records and ends of waves, to b, u, v, the load in time and numbers; of fields after each
    step of what flows, to b, u, the collar in time and numbers."""
    if name in FLOWS:
        return flow(name, op)
    fields, options = given(op)
    signal = torch.from_numpy(1 + 0.3 * np.sin(np.arange(options["steps"] + 1)))
    numbers = numbers_of(op)

    def value(leaves):
        own = {n: leaves[n] for n in numbers}
        sizes = options | {"signal": leaves["signal"]}
        return loss(op, {n: leaves[n] for n in fields}, sizes, own or None)

    return table(name, op, value, fields | {"signal": signal} | numbers, 10.0)


def flow(name, op):
    b, u, held = tensors(op, count=3)

    def value(leaves):
        collar = lambda t: leaves["u"] + t * leaves["collar"]
        how = {"step": 0.3, "steps": 4, "collar": collar, "parameters": learned(op, leaves)}
        problem = wp.Dirichlet(op.points, leaves["b"], leaves["u"])
        return seeded(wp.simulate(op, problem, **how)["u"])

    return table(name, op, value, {"b": b, "u": u, "collar": held} | numbers_of(op), 10.0)
