"""Graphene as a neural operator, trained for seconds at small widths."""

import sys
from os.path import realpath

sys.path.insert(0, realpath(__file__).rpartition("examples")[0])
import warp_peri as wp
from examples.figures import begin, save_figure

picture = begin(__doc__, "runs/neural.png")
data = wp.load("data/graphene_0K.h5")  # of `make graphene`
law = wp.neural.NeuralOperator(horizon=12.5, influence=(32, 32), state=(32, 32), strain=0.5)
training = wp.neural.TrainingSettings(epochs=12)
fit = wp.fit(data["train"], law, validation=data["val"], training=training)
disk = data["test"]
solution = wp.solve(fit.material, wp.Dirichlet(disk, disk.b, disk.u))
error = wp.evaluate(fit.material, disk)["E_u"]

print(fit.material, fit.history, sep="\n")
title = solution.plot().set_title(f"A disk the fit never saw: {100 * error:.2f} % off")
save_figure(title.figure, picture)
