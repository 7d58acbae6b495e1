"""Solve in space: a ball swells inside an elastic block; against the textbook's elasticity."""

import json
import sys
from os.path import realpath

import numpy as np

sys.path.insert(0, realpath(__file__).rpartition("examples")[0])
import warp_peri
from examples.figures import RUNS, begin, panels, save_figure
from warp_peri.crystals import crystal_from_lps

LAM, MU, BALL = 0.6, 0.8, 0.6
SPACINGS = 1 / np.array([10, 14, 20, 28])


def swollen(h):
    """The block |x| < 1 at spacing h: nodes, their displacement, relative error, what is proven."""
    side = np.arange(-1 - 4 * h, 1 + 4.5 * h, h)
    x = np.stack(np.meshgrid(side, side, side, indexing="ij"), axis=-1).reshape(-1, 3)
    r = np.linalg.norm(x, axis=1)
    points = warp_peri.Points(x, (r > BALL) & (np.abs(x).max(axis=1) < 1 - h / 2), h)
    # K = 1/r, δ = 2h. As tensors of range 2δ the solid is proven, and solved at any size.
    solid = warp_peri.LPSMaterial(LAM, MU, 1.0, np.ones(1), horizon=2 * h, dimension=3)
    law = crystal_from_lps(solid, h)
    exact = 0.1 * x * (BALL / np.maximum(r, BALL / 5))[:, None] ** 3  # without load, div u = 0
    u = warp_peri.solve(law, warp_peri.Dirichlet(points, np.zeros_like(x), exact)).u
    error = np.linalg.norm((u - exact)[points.interior]) / np.linalg.norm(exact[points.interior])
    return points, u, float(error), law.certificate.proven if law.certificate else 0.0


if __name__ == "__main__":
    picture = begin(__doc__, RUNS / "solid_in_space.png")
    solved = [swollen(h) for h in SPACINGS]
    errors = [error for *_, error, _ in solved]
    order = float(np.polyfit(np.log(SPACINGS), np.log(errors), 1)[0])
    numbers = {"relative error of u": errors, "order": order, "proven, over μ": solved[0][3] / MU}
    print(json.dumps(numbers, indent=1))
    points, u = solved[-1][:2]
    count = round(len(points.x) ** (1 / 3))
    size = np.where(points.interior, np.linalg.norm(u, axis=1), np.nan).reshape(3 * (count,))
    figure, axes = panels(9, 4, count=2)
    edge = points.x.max()
    image = axes[0].imshow(size[:, :, count // 2].T, extent=2 * (-edge, edge), origin="lower")
    figure.colorbar(image, label="size of displacement [half sides of the block]")
    axes[0].set(xlabel="x [half sides]", ylabel="y [half sides]", title="A ball swells in a block")
    axes[0].set(xlim=(-1, 1), ylim=(-1, 1))
    axes[1].loglog(SPACINGS, errors, "o-", label=f"measured, order {order:.1f}")
    axes[1].loglog(SPACINGS, errors[0] * (SPACINGS / SPACINGS[0]) ** 2, "k:", label="order 2")
    axes[1].set(xlabel="spacing [half sides], δ = 2 spacings")
    axes[1].set(ylabel="relative error of displacement", title="The error falls with spacing²")
    axes[1].legend(frameon=False)
    save_figure(figure, picture)
