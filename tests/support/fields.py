"""Fields that operators are asked at, as arrays and as tensors."""

import numpy as np
import torch
from torch.autograd import grad

from tests.support.problems import loaded, normal
from tests.support.sheets import waves

solved_samples = lambda op: loaded(op, uneven(op.points, 2))
tensor = lambda op, *lead, seed=0: torch.from_numpy(field(op, *lead, seed=seed))
"""A field as a tensor."""
tensors = lambda op, *lead, count=2: [tensor(op, *lead, seed=n) for n in range(count)]
"""Several of them, no two alike."""
double = lambda value: torch.tensor(value, dtype=torch.float64)
"""A number or an array in double precision."""


def answers(op, u, v):
    """What an operator gives of fields, and gradients to them and to its numbers."""
    at = torch.from_numpy(u).requires_grad_()
    found = [op(u), op.jvp(u, v), op.energy(u), *grad(op(at).square().sum(), at)]
    if op.points.outside is None:
        found.append(op.stress(u))
    if known := getattr(op, "learnable", {}):
        numbers = {n: double(np.array(one, float)).requires_grad_() for n, one in known.items()}
        force = op.force_with_parameters(at.detach(), numbers)
        found += grad(force.square().sum(), [*numbers.values()])
    return found


def uneven(points, samples=None):
    """Smooth fields with gradients of some percent, one or several."""
    fields = np.stack([waves(points, 0.05, seed) for seed in range(samples or 1)])
    return fields if samples else fields[0]


def field(op, *lead, seed=0):
    """Fields with gradients of some percent, rough and smooth."""
    size = 0.01 * getattr(op.points, "spacing", 0) or 0.01
    u = size * normal((*lead, *op.shape), seed)
    return u + 2 * size * np.sin(op.points.x[:, 0]).reshape(-1, *[1] * (len(op.shape) - 1))


def seeded(values):
    """A number of a field, so that nothing cancels."""
    return ((0.3 * values + torch.from_numpy(normal(values.shape, 1))) * values).sum()
