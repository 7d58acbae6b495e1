"""A law as two small networks, trained in plain torch: residuals in the loss, then answers too.

Fields and loads come from a crystal with third-order constants. The loss is the residual of the
equation; at last also the error of what `solve` answers, whose gradient one transposed solve gives.

python examples/network_from_residuals.py           numbers, and a picture
python examples/network_from_residuals.py --json    errors on loads never seen, seconds
"""

import sys
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np
import torch

import warp_peri as wp
from examples.crystals import local
from examples.figures import curves, note, panels, shown
from warp_peri.core.elastic import from_voigt, plane_isotropic
from warp_peri.errors import exit_status
from warp_peri.methods import Smoothing
from warp_peri.micromodulus import fit_symbol
from warp_peri.neural import NeuralOperator
from warp_peri.third_order.material import ThirdOrderCrystal

SIDE, HORIZON, STRAIN = 8, 3.0, 0.03
FROM = 100
"""Steps before which a network may be no solid that rests."""
C = from_voigt(plane_isotropic(0.4, 0.6))
LINEAR = fit_symbol(local(C), 1.0, 2.0, symmetry="isotropic", tensor=C)
TRUTH = ThirdOrderCrystal(LINEAR, -1.0, -3.0, 0.0, Smoothing(2.0, 0.2), "energy", 2.0)
X = np.argwhere(np.ones(2 * [SIDE + 4 * int(HORIZON)])) - (SIDE + 4 * HORIZON - 1) / 2
POINTS = wp.Points(X, np.abs(X).max(axis=1) < SIDE / 2, 1.0, axis=0.0)
INSIDE = torch.from_numpy(POINTS.interior)


def samples(count: int, seed: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Smooth displacements [S, N, 2] and the loads that the truth answers with them."""
    random = np.random.default_rng(seed)
    k = random.uniform(-0.5, 0.5, (count, 3, 2))
    waves = np.sin(np.einsum("swd,nd->swn", k, X) + random.uniform(0, 6, (count, 3, 1)))
    u = torch.from_numpy(
        STRAIN * np.einsum("swn,swd->snd", waves, random.normal(size=(count, 3, 2)))
    )
    b = torch.zeros_like(u)
    b[:, INSIDE] = TRUTH.on(POINTS)(u)
    return u, b


def wrong(found: torch.Tensor, true: torch.Tensor) -> torch.Tensor:
    """Mean relative error of fields [S, n, 2]."""
    return ((found - true).square().sum((1, 2)) / true.square().sum((1, 2))).sqrt().mean()


def network_from_residuals(steps: int, last: int) -> tuple[dict[str, Any], Any]:
    """Errors on loads never seen, other numbers, and a picture of the way there."""
    (u, b), (unseen, loads) = samples(12, 0), samples(4, 1)
    law = NeuralOperator(HORIZON, (16, 16), (16, 16), strain=STRAIN).double()
    force = wp.Module(law, POINTS)
    law.fitted(force(u).detach(), b[:, INSIDE])  # the scale of the forces
    adam = torch.optim.Adam(force.parameters(), lr=1e-2)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(adam, steps + last, 2e-3)

    def residual(u: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
        return wrong(force(u), b[:, INSIDE])

    def answers(u: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
        found = wp.solve(force.operator, wp.Dirichlet(POINTS, b, u)).u
        return wrong(found[:, INSIDE], u[:, INSIDE])

    rows: dict[str, list[float]] = {"step": [], "E_res": [], "E_u": []}
    begin = time.perf_counter()
    for step in range(steps + last + 1):
        if step % 50 == 0 or step in (steps, steps + last):
            with torch.no_grad():
                error = float(answers(unseen, loads)) if step >= FROM else np.nan
                found = step, float(residual(unseen, loads)), error
            for name, value in zip(rows, found):
                rows[name].append(value)
        adam.zero_grad()
        loss = residual(u, b)
        if step >= steps:
            some = [2 * step % 12, (2 * step + 1) % 12]
            loss = loss + answers(u[some], b[some])
        loss.backward()
        adam.step()
        schedule.step()

    numbers: dict[str, Any] = {name: row[-1] for name, row in rows.items()}
    numbers |= {"E_res at start": rows["E_res"][0], "seconds": time.perf_counter() - begin}
    numbers["E_u of residuals alone"] = rows["E_u"][rows["step"].index(steps)]
    return numbers, picture(rows, steps)


def picture(rows: dict[str, list[float]], steps: int) -> Any:
    """Errors on the way."""
    figure, ax = panels()
    lines = {"residual": rows["E_res"], "displacement that is solved for": rows["E_u"]}
    ax.axvspan(steps, rows["step"][-1], alpha=0.15)
    note(ax, "answers\nin the loss", (steps, 30 * max(rows["E_res"])), (-52, 0))
    ax.set_title("Residuals teach the model; answers in the loss add nothing")
    labels = {"xlabel": "step of Adam", "ylabel": "error on loads never seen [%]"}
    curves(ax, "semilogy", rows["step"], lines, ".-", scale=100, **labels)
    return figure


def main(args: list[str] | None = None) -> int:
    """Write the picture and print the numbers."""
    options = {"steps": (300, "of Adam on residuals alone"), "last": (60, "of Adam on answers too")}
    return shown(__doc__, "network_from_residuals", network_from_residuals, args, **options)


if __name__ == "__main__":
    sys.exit(exit_status(main))
