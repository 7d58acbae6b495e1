"""A block of glass with a penny-shaped crack inside, pulled until it runs; Griffith beside it."""

import json
import sys
from os.path import realpath

sys.path.insert(0, realpath(__file__).rpartition("examples")[0])

import numpy as np

import warp_peri as wp
from examples.figures import RUNS, begin, panels, save_figure
from warp_peri import Cracked
from warp_peri.fracture import BrittleMaterial, Injected, box_nodes, energy_release, j_integral
from warp_peri.fracture import penny_corners as corners

UNITS = ("mm", "GPa")
LAM, MU, DENSITY, TOUGHNESS = 21.0, 26.0, 2450.0, 3.8e-6  # kg/m³; 1 J/m² is 1e-6 GPa mm
NU = LAM / (2 * (LAM + MU))
E = 2 * MU * (1 + NU)


def block(side, radius, grip):
    """A glass block of so many spacings, held within `grip` of where, and its crack on y = 0."""
    x = box_nodes((side,) * 3, 1.0)
    glass = wp.LPSMaterial(LAM, MU, 1.0, np.ones(1), horizon=2.0, units=UNITS, dimension=3)
    points = wp.Points(x, grip(np.abs(x)) < side / 2 - 2, 1.0, units=UNITS)
    return BrittleMaterial(glass, DENSITY, toughness=TOUGHNESS), points, corners(radius)


def released(side=14, radius=3.0):
    """G and J of a crack in a block with held faces, over 4 (1 − ν²) σ² a / (π E)."""
    solid, points, crack = block(side, radius, lambda away: away.max(axis=1))
    unit = points.x * [-NU / E, 1 / E, -NU / E]  # pulled by a unit of stress
    pulled = Cracked(points, u=unit, cracks=[crack])
    G = energy_release(solid, pulled, [[corners(radius - 1)], [corners(radius + 1)]])
    J = j_integral(wp.solve(solid, pulled), (radius, 0, 0), (1, 3))
    return np.array([G, J]) / (4 * (1 - NU**2) * radius / (np.pi * E))


def filled(side=14, radius=3.0):
    """Volume of a crack that a fluid fills, over 16 (1 − ν²) p a³ / (3 E) of I. N. Sneddon."""
    solid, points, _ = block(side, radius, lambda away: away.max(axis=1))
    run = wp.simulate(solid, Injected(points, [radius]))
    large = 16 * (1 - NU**2) * radius**3 / (3 * E)
    return float(run["volume"][0] / run["pressure"][0] / large)


def torn(side=24, radius=5.0, steps=400):
    """Slowly to twice Griffith's stress: the motion, its stresses, and what was the largest."""
    solid, points, crack = block(side, radius, lambda away: away[:, 1])
    x, griffith = points.x, np.sqrt(np.pi * E * TOUGHNESS / (4 * (1 - NU**2) * radius))
    step = 0.5 * solid.longest_step(1.0)
    rate = 2 * griffith / E / (steps * step)
    ends, up = ~points.interior[:, None], np.array([0, 1, 0])
    motion = wp.simulate(
        solid,
        Cracked(points, cracks=[crack], free=~(ends & (up > 0))),
        step=step,
        steps=steps,
        every=5,
        grip=rate * side / 2 * np.sign(x) * ends * up,
        v=rate * x * [-NU, 1, -NU],
        no_fail=~points.interior,
    )
    stress = np.gradient(motion["work"], motion.time) / (rate * side**3)  # the work of the ends
    return points, motion, stress / griffith


if __name__ == "__main__":
    picture = begin(__doc__, RUNS / "penny_crack.png")
    points, motion, stress = torn()
    G, J = released()
    numbers = {
        "G and J, over the theory's": [float(G), float(J)],
        "volume under pressure, over Sneddon's": filled(),
        "largest stress, over Griffith's": float(stress.max()),
        "energy that is missing from the ledger": float(motion.missing),
        "largest damage": float(motion.details.damage.max()),
    }
    print(json.dumps(numbers, indent=1))
    count = round(len(points.x) ** (1 / 3))
    damage = motion.details.damage.reshape(3 * (count,))
    figure, axes = panels(9.5, 3.2, count=3)
    cuts = damage[:, count // 2], damage[:, :, count // 2]
    titles = "The crack's plane, y = 0", "Pulled beyond the lines"
    for ax, cut, names, title in zip(axes, cuts, ("xz", "xy"), titles):
        edges = 2 * (-count / 2, count / 2)
        image = ax.imshow(cut.T, extent=edges, origin="lower", vmin=0, vmax=0.5)
        ax.set(xlabel=f"{names[0]} [mm]", ylabel=f"{names[1]} [mm]", title=title)
    x, y = np.meshgrid((-8, 0, 8), (-count / 2, count / 2))
    axes[1].quiver(x, y, 0 * y, y, color="C1", scale=2.5, scale_units="y", width=0.03)
    axes[1].hlines(y - 2 * np.sign(y), y[0, 0], y[1, 0], color="C1")
    axes[1].set_ylim(-0.75 * count, 0.75 * count)
    figure.colorbar(image, ax=axes[1], label="share of broken bonds")
    axes[2].plot(1e-6 * motion.time, stress)
    axes[2].set(xlabel="time [µs]", ylabel="stress over Griffith's", title="The block unloads")
    figure.suptitle("A round crack, pulled apart, runs to the faces of its block")
    save_figure(figure, picture)
