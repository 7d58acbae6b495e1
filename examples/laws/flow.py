"""A polymer solution in a channel: dumbbells teach the law of its stress, and the law flows."""

import matplotlib.pyplot as plt

import warp_peri as wp
from warp_peri.flow import Dumbbells, PlaneFlow, learn_spring, mixed, simulate

gradients = mixed(8, 100, 3.0, hold=10, seed=1)  # of velocity, in relaxation times
record = simulate(Dumbbells(8, 2000, b=50.0, seed=1), gradients, 0.1, steps=10)
law = learn_spring(record, points=100)
flow = PlaneFlow(De=1.0, Re=1.0, cells=32, force=lambda t: 2.0)
run = wp.move(law, flow, until=4.0, dt=0.01, every=10)

print(law, run, sep="\n")
plt.plot(run["u"][[5, 10, 20, -1]].T)
plt.gca().set(xlabel="cell across the channel", ylabel="velocity", title="From rest to steady flow")
plt.savefig("flow.png")
