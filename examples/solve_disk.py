"""Solve a disk: it spins, its core is held, its rim is free; against the textbook's elasticity."""

import dataclasses
import json
import sys
from os.path import realpath

import matplotlib.pyplot as plt
import numpy as np

sys.path.insert(0, realpath(__file__).rpartition("examples")[0])
import warp_peri
from examples.figures import RUNS, begin, save_figure

PICTURE = begin(__doc__, RUNS / "solve_disk.png")
LAM, MU, RADIUS, H = 0.3, 0.7, 1.0, 1 / 24
HORIZON = 3 * H

# K = 1/r. A solve takes models that are certified on the lattice at hand; a fit certifies its own.
model = warp_peri.LPSMaterial(lam=LAM, mu=MU, alpha=1.0, D=np.ones(1), horizon=HORIZON)
if warp_peri.certify(model, spacing=H).holds:
    model = dataclasses.replace(model, certified_on=(H,))

# The disk, and outside it nodes that are no part of it: bonds to them are broken.
x = H * (np.argwhere(np.ones((61, 61))) - 30)
r = np.linalg.norm(x, axis=1)
core, outside = r < 2 * HORIZON, r > RADIUS
points = warp_peri.Points(x, ~core & ~outside, H, outside=outside)

# Elasticity: −σ′ = b with b = x gives u = (A − B r²) x; σ_rr = 0 at the rim gives A.
B = 1 / (8 * (LAM + 2 * MU))
A = B * RADIUS**2 * (2 * LAM + 3 * MU) / (LAM + MU)
exact = (A - B * r[:, None] ** 2) * x
u = warp_peri.solve(model, warp_peri.Dirichlet(points, b=x, u=exact)).u
body = points.interior
error = np.linalg.norm((u - exact)[body]) / np.linalg.norm(exact[body])
numbers = {"relative error of u": error, "largest u": np.abs(u[body]).max()}

print(json.dumps(numbers, indent=1))
wrong = np.linalg.norm(u - exact, axis=1)
plt.scatter((x + u)[body, 0], (x + u)[body, 1], s=9, c=wrong[body])
plt.colorbar(label="|u − elasticity|")
plt.gca().set(aspect="equal", xlabel="x / R", ylabel="y / R")
plt.title("The disk as it spins; its core is held")
save_figure(plt.gcf(), PICTURE)
