"""Heat through a plate with a round grain that conducts ten times better."""

import sys
from os.path import realpath

import numpy as np

sys.path.insert(0, realpath(__file__).rpartition("examples")[0])
import warp_peri as wp
from examples.figures import begin, save_figure

picture = begin(__doc__, "runs/diffusion.png")
h = 1 / 32
steps = np.argwhere(np.ones((77, 77))) - 38
units = ("sigma", "epsilon/sigma^3")  # of no length in particular
plate = np.abs(steps).max(axis=1) <= 32
points = wp.Points(h * steps, plate, spacing=h, units=units)
phi = points.x[:, 0]  # temperature on the collar: from −1 on the left to 1 on the right


def kappa(place):
    """Conductivity at positions, and at the middle of bonds."""
    return np.where(np.hypot(place[..., 0], place[..., 1]) < 0.5, 10.0, 1.0)


material = wp.diffusion.DiffusionMaterial(horizon=3 * h, conductivity=1.0, units=units)
solution = wp.solve(material, wp.Dirichlet(points, np.zeros_like(phi), phi), kappa=kappa)

print(material, solution, sep="\n")
title = solution.plot().set_title("Temperature")
save_figure(title.figure, picture)
