"""Graphene as a linear peridynamic solid: seventy loads teach it, a disk it never saw judges it."""

import sys
from os.path import realpath

sys.path.insert(0, realpath(__file__).rpartition("examples")[0])
import warp_peri as wp
from examples.figures import begin, save_figure

picture = begin(__doc__, "runs/linear.png")
data = wp.load("data/graphene_0K.h5")  # of `make graphene`
fit = wp.fit(data["train"], wp.LPS(horizon=12.5, kernel=wp.Bernstein(4)))
disk = data["test"]
solution = wp.solve(fit.material, wp.Dirichlet(disk, disk.b, disk.u))
error = wp.evaluate(fit.material, disk)["E_u"]

print(fit.material, fit.certificate.statement, sep="\n")
title = solution.plot().set_title(f"A disk the fit never saw: {100 * error:.2f} % off")
save_figure(title.figure, picture)
