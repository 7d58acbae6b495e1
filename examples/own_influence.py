"""Your own influence function: a callable of the bond length, whose parameters are learned."""

import dataclasses
import json
import sys
from os.path import realpath

import matplotlib.pyplot as plt
import numpy as np

sys.path.insert(0, realpath(__file__).rpartition("examples")[0])
import warp_peri
from examples.figures import RUNS, begin, save_figure

PICTURE = begin(__doc__, RUNS / "own_influence.png")
HORIZON, H = 15.0, 5.0  # Å


def ring(r, radius, width):
    """Bonds of one length carry most."""
    return np.exp(-(((r - radius) / width) ** 2))


# Data of a solid whose ring lies at 9 Å and is 5 Å wide: random waves, and the loads they need.
shape = warp_peri.influence.InfluenceFunction(ring, {"radius": 9.0, "width": 5.0})
truth = shape.model(lam=-0.2, mu=0.72, horizon=HORIZON, spacings=[H])
truth = dataclasses.replace(truth, certified_on=(H,))
x = H * (np.argwhere(np.ones((19, 19))) - 9)
points = warp_peri.Points(x, interior=np.abs(x).max(axis=1) <= 15, spacing=H)
random = np.random.default_rng(0)
k, phase = random.uniform(-0.3, 0.3, (12, 2)), random.uniform(0, 6, (12, 1))
u = np.cos(k @ x.T + phase)[:, :, None] * random.normal(size=(12, 1, 2))
b = np.zeros_like(u)
b[:, points.interior] = truth.on(points)(u)

guess = warp_peri.influence.InfluenceFunction(
    ring, {"radius": 6.0, "width": 8.0}, bounds={"radius": (0.0, HORIZON), "width": (1.0, 50.0)}
)
fit = warp_peri.fit(warp_peri.Samples(points, u, b), warp_peri.LPS(HORIZON, kernel=guess))
assert fit.influence is not None
numbers = {"mu": fit.material.mu, **fit.influence.parameters}

print(json.dumps(numbers, indent=1))
r = np.linspace(H, HORIZON)
for name, shape in (("first guess", guess), ("learned", fit.influence)):
    plt.plot(r, shape(r), label=name)
plt.plot(r, ring(r, 9.0, 5.0), "k:", label="truth")
plt.gca().set(xlabel="bond length r [Å]", ylabel="K")
plt.legend()
save_figure(plt.gcf(), PICTURE)
