"""Gradients of velocities by the law's numbers, against differences, and numbers found again."""

import numpy as np
import pytest
import torch

from examples.polymer.closure import Closure
from examples.polymer.dumbbells import Dumbbells, held, simulate
from examples.polymer.laws import FENEP, Giesekus, shear
from examples.polymer.plane import PlaneFlow, run_plane
from examples.polymer.springs import learn_spring
from examples.polymer.torch_laws import TorchSpring, fit_velocities, velocities
from warp_peri import InputError

FLOW = PlaneFlow(1.0, 1.0, 6, force=lambda t: 6.0)
RUN = lambda law: velocities(law, FLOW, 1.0, 0.05, every=5)


def spring():
    K = held(shear(np.array([1.0, 4.0])), 20)
    record = simulate(Dumbbells(2, 1000, b=50.0), K, 0.1, steps=4)
    return learn_spring(record, points=12, outside="allow")


SPRING = spring()
LAWS = {
    "Giesekus": (lambda p: Giesekus(p[0]), [0.2]),
    "FENE-P": (lambda p: FENEP(p[0]), [30.0]),
    "spring": (lambda p: TorchSpring(SPRING, p), np.linspace(-0.1, 0.3, 12)),
}


@pytest.mark.parametrize("name", LAWS)
def test_every_gradient_against_central_differences(name):
    make, start = LAWS[name]
    weight = torch.linspace(0.2, 1, 7, dtype=torch.float64)

    def value(p):
        return (RUN(make(p)) * weight).sum()

    theta = torch.tensor(np.array(start), dtype=torch.float64, requires_grad=True)
    (exact,) = torch.autograd.grad(value(theta), theta)
    for i in range(len(start)):
        step = torch.zeros(len(start), dtype=torch.float64)
        step[i] = 1e-5 * max(1.0, abs(start[i]))
        with torch.no_grad():
            central = (value(theta + step) - value(theta - step)) / (2 * step[i])
        assert abs(central - exact[i]) < 1e-6 * max(1e-2, float(exact.abs().max()))


@pytest.mark.parametrize("law", [Giesekus(0.2), FENEP(30.0)])
def test_torch_and_numpy_run_the_same_flow(law):
    same = run_plane(FLOW, Closure(law, 1.0, 6), until=0.4, dt=0.01, every=5)
    u = velocities(law, FLOW, 0.4, 0.01, every=5)
    assert np.abs(u.numpy() - same.u[1:]).max() < 1e-3  # steps of a law are divided there


def test_a_number_is_found_from_velocities():
    truth = RUN(Giesekus(0.35)).numpy()
    noisy = truth + 1e-3 * np.random.default_rng(0).standard_normal(truth.shape)
    law, asked = LAWS["Giesekus"][0], {"start": [0.1], "bounds": [(0.0, 1.0)], "run": RUN}
    alpha, left = fit_velocities(noisy, law, **asked)
    assert alpha[0] == pytest.approx(0.35, abs=0.01)
    assert left < 2e-3
    with pytest.raises(InputError, match="finite"):
        fit_velocities(noisy * np.nan, law, **asked)
    with pytest.raises(InputError, match="time step"):
        velocities(Giesekus(0.2), FLOW, 1.0, 1.0)
