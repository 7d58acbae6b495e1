"""Every Warp path on every device that is there, against the processor."""

import numpy as np
import pytest
import torch
import warp as wp

from tests.support.problems import GRADIENT, ROUNDING, kernel, lattice, noise
from warp_peri import InputError
from warp_peri.materials.lps_bonds import Bonds
from warp_peri.materials.lps_force import lps_force
from warp_peri.methods import Solid

HORIZON = 3.0
DEVICES = [str(device) for device in wp.get_devices()]
MODEL = kernel("sign-changing", HORIZON)


def gradients(device):
    """Derivatives of a scalar of L u to u and D."""
    bonds = Bonds(lattice(5, HORIZON), HORIZON, device=device)
    u = noise(lattice(5, HORIZON))
    u, D = (torch.tensor(v, device=device, requires_grad=True) for v in (u, MODEL.D))
    Lu = lps_force(bonds, u, Solid(MODEL.lam, MODEL.mu, MODEL.alpha, D))
    weight = torch.cos(torch.arange(Lu.numel(), dtype=Lu.dtype, device=device)).reshape(Lu.shape)
    return [part.cpu().numpy() for part in torch.autograd.grad(Lu, (u, D), weight)]


@pytest.mark.parametrize("device", DEVICES)
def test_forces_are_those_of_the_processor(device):
    points = lattice(6, HORIZON, angle=0.3)
    u = noise(points, 2)
    here, there = MODEL.on(points)(u), MODEL.on(points, device=device)(u)
    np.testing.assert_allclose(there, here, rtol=0, atol=ROUNDING * np.abs(here).max())


@pytest.mark.parametrize("device", DEVICES)
def test_the_plain_sweeps_that_a_gpu_uses_give_the_gradient_of_the_processor(device, monkeypatch):
    here_too = gradients("cpu")
    monkeypatch.setattr("warp_peri.materials.lps_bonds.DEVICE", "elsewhere")
    for there, here in zip(gradients(device), here_too):
        np.testing.assert_allclose(there, here, rtol=0, atol=GRADIENT * np.abs(here).max())


def test_a_device_that_is_not_there_is_named():
    with pytest.raises(InputError, match="device: expected one of .*cpu.*got 'cuda:99'"):
        MODEL.on(lattice(3, HORIZON), device="cuda:99")
