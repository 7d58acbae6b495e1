"""Learn a solid from arrays: nodes, displacements and loads of an elastic sheet under waves."""

import json
import sys
from os.path import realpath

import matplotlib.pyplot as plt
import numpy as np

sys.path.insert(0, realpath(__file__).rpartition("examples")[0])
import warp_peri
from examples.figures import RUNS, begin, save_figure
from warp_peri import plots

PICTURE = begin(__doc__, RUNS / "learn_from_arrays.png")
LAM, MU = 0.3, 0.7  # Lamé parameters of the sheet [TPa], which the fit is not told

# What you would bring: positions [Å], displacements [Å] and body forces [TPa/Å] of some tests.
x = 5.0 * (np.argwhere(np.ones((27, 27))) - 13)
k = 2 * np.pi / 120 * np.array([(p, q) for p in range(4) for q in range(4) if p or q])
k = np.repeat(k, 2, axis=0)
a = 0.1 * np.tile(np.eye(2), (len(k) // 2, 1))  # along x₁ and x₂ in turn
force = MU * (k**2).sum(1)[:, None] * a + (LAM + MU) * (k * a).sum(1)[:, None] * k
wave = np.cos(k @ x.T)[:, :, None]
u, b = wave * a[:, None], wave * force[:, None]

# Displacement is asked for on the interior; around it lies the collar, two horizons wide.
points = warp_peri.Points(x, interior=np.abs(x).max(axis=1) <= 40, spacing=5.0)
samples = warp_peri.Samples(points, u, b)
seen, unseen = (warp_peri.Samples(points, u[s], b[s]) for s in (slice(0, 24), slice(24, None)))
fit = warp_peri.fit(seen, warp_peri.LPS(horizon=12.5, kernel=warp_peri.Bernstein(3)))
numbers = {
    "lambda": fit.material.lam,
    "mu": fit.material.mu,
    "E_u on loads it never saw": warp_peri.evaluate(fit.material, unseen)["E_u"],
    "statement": fit.certificate.statement,
}

print(json.dumps(numbers, indent=1, ensure_ascii=False))
plots.influence_function(fit.material, spacing=5.0, ax=plt.figure().add_subplot())
save_figure(plt.gcf(), PICTURE)
