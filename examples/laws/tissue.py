"""A sheet with fibres, from displacement and load: an energy at nodes and on corners of cells."""

import sys
from os.path import realpath

sys.path.insert(0, realpath(__file__).rpartition("examples")[0])
import warp_peri as wp
from examples.figures import begin, save_figure

picture = begin(__doc__, "runs/tissue.png")
data = wp.load("data/hgo.h5")  # of `python tools/make_hgo.py`
read = wp.hyperelastic.fit_fibre_families(data["train"], stiffness=0.35)
fit = wp.fit(data["train"], wp.hyperelastic.with_corners(read.dictionary), positive=True)
disk = data["disks"]
solution = wp.solve(fit.material, wp.Dirichlet(disk, disk.b, disk.u))
error = wp.evaluate(fit.material, disk)["E_u"]

print(*wp.hyperelastic.in_words(fit.material), sep="\n")
title = solution.plot().set_title(f"A disk the fit never saw: {100 * error:.2f} % off")
save_figure(title.figure, picture)
