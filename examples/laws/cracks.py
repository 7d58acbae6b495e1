"""A notched glass plate pulled apart: bonds break, a crack runs, a ledger keeps the energy."""

import sys
from os.path import realpath

import matplotlib.pyplot as plt
import numpy as np

sys.path.insert(0, realpath(__file__).rpartition("examples")[0])
import warp_peri as wp
from examples.figures import begin, save_figure

picture = begin(__doc__, "runs/cracks.png")
h = 1e-3  # m; a plate of 10 cm by 4 cm
units = ("m", "Pa")
glass = wp.LPSMaterial(lam=21e9, mu=26e9, alpha=1.0, D=np.ones(1), horizon=3 * h, units=units)
solid = wp.fracture.BrittleMaterial(glass, density=2450.0, toughness=3.8)  # kg/m³, J/m²
x = wp.fracture.rectangle_nodes(0.1, 0.04, h)
rim = np.abs(x[:, 1]) > 0.02 - h
pull = np.where(rim, 1e6 / h * np.sign(x[:, 1]), 0.0)[:, None] * [0, 1]  # 1 MPa on two edges
points = wp.Points(x, np.ones(len(x), bool), h, units=units)
plate = wp.Cracked(points, pull, cracks=[[(-0.051, 0), (0, 0)]])
step = 0.4 * solid.longest_step(h)
run = wp.simulate(solid, plate, step=step, steps=300, every=10, no_fail=rim)

print(run, f"energy that is missing from the ledger: {run.missing:.1e}", sep="\n")
plt.scatter(1e3 * x[:, 0], 1e3 * x[:, 1], c=run.details.damage, s=4)
plt.gca().set(aspect="equal", xlabel="x [mm]", ylabel="y [mm]", title="Share of broken bonds")
save_figure(plt.gcf(), picture)
