"""Graphene at some per cent: a linear crystal, and the potential's third-order constants."""

import sys
from os.path import realpath

sys.path.insert(0, realpath(__file__).rpartition("examples")[0])
import warp_peri as wp
from examples.figures import begin, save_figure

picture = begin(__doc__, "runs/third_order.png")
data = wp.load("data/graphene_0K.h5")  # of `make graphene`
law = wp.ThirdOrder(wp.Crystal(horizon=15.0), wp.methods.Smoothing(radius=10.0))
fit = wp.fit(data["train"], law)
disk = data["test"]
solution = wp.solve(fit.material, wp.Dirichlet(disk, disk.b, disk.u))
error = wp.evaluate(fit.material, disk)["E_u"]

print(fit.material, f"one solution up to |H| = {fit.material.proven_strain(5.0):.3f}", sep="\n")
title = solution.plot().set_title(f"A disk the fit never saw: {100 * error:.2f} % off")
save_figure(title.figure, picture)
