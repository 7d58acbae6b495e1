"""A law as two small networks, trained in plain torch: residuals in the loss, then answers too.

Fields and loads come from a solid at finite strain. The loss is the residual of the equation; at
last also the error of what `solve` answers, whose gradient one transposed solve gives.

python examples/network_from_residuals.py           numbers, and a picture
python examples/network_from_residuals.py --json    errors on loads never seen, seconds
"""

import json
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np
import torch

import warp_peri as wp
from examples.figures import name_lines, note, panels, save_figure
from tools.options import Options
from warp_peri.dressed import FiniteSolid
from warp_peri.errors import exit_status
from warp_peri.neural import NeuralOperator

SIDE, HORIZON, STRAIN = 8, 3.0, 0.03
FROM = 100
"""Steps before which a network may be no solid that rests."""
TRUTH = FiniteSolid(1.0, 0.4, 0.6, -0.02, 0.0, 0.0, -1.0, -3.0, 0.0)


def samples(count: int, seed: int) -> tuple[wp.Points, torch.Tensor, torch.Tensor]:
    """Nodes, smooth displacements [S, N, 2] and the loads that the truth answers with them."""
    wide = SIDE + 4 * int(HORIZON)
    x = np.argwhere(np.ones((wide, wide))) - (wide - 1) / 2
    points = wp.Points(x, np.abs(x).max(axis=1) < SIDE / 2, 1.0, axis=0.0)
    random = np.random.default_rng(seed)
    k = random.uniform(-0.5, 0.5, (count, 3, 2))
    waves = np.sin(np.einsum("swd,nd->swn", k, x) + random.uniform(0, 6, (count, 3, 1)))
    u = STRAIN * np.einsum("swn,swd->snd", waves, random.normal(size=(count, 3, 2)))
    b = np.zeros_like(u)
    b[:, points.interior] = TRUTH.on(points)(u)
    return points, torch.from_numpy(u), torch.from_numpy(b)


def trained(steps: int, last: int) -> tuple[dict[str, list[float]], dict[str, float]]:
    """Errors on loads never seen on the way, and numbers."""
    points, u, b = samples(12, 0)
    _, unseen, loads = samples(4, 1)
    inside = torch.from_numpy(points.interior)
    law = NeuralOperator(HORIZON, (16, 16), (16, 16), strain=STRAIN).double()
    module = wp.Module(law, points)
    law.fitted(module(u).detach(), b[:, inside])  # the scale of the forces
    adam = torch.optim.Adam(module.parameters(), lr=1e-2)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(adam, steps + last, 2e-3)

    def residual(u: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
        left = (module(u) - b[:, inside]).square().sum((1, 2))
        return (left / b[:, inside].square().sum((1, 2))).sqrt().mean()

    def answers(u: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
        found = wp.solve(module.operator, wp.Dirichlet(points, b, u)).u
        left = (found - u)[:, inside].square().sum((1, 2))
        return (left / u[:, inside].square().sum((1, 2))).sqrt().mean()

    rows: dict[str, list[float]] = {"step": [], "E_res": [], "E_u": []}
    begin = time.perf_counter()
    for step in range(steps + last + 1):
        if step % 50 == 0 or step in (steps, steps + last):
            with torch.no_grad():
                wrong = float(answers(unseen, loads)) if step >= FROM else np.nan
                found = step, float(residual(unseen, loads)), wrong
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
    numbers = {name: row[-1] for name, row in rows.items()}
    numbers["E_res at start"] = rows["E_res"][0]
    numbers["E_u of residuals alone"] = rows["E_u"][rows["step"].index(steps)]
    return rows, numbers | {"seconds": time.perf_counter() - begin}


def main(args: list[str] | None = None) -> int:
    """Write the picture and print the numbers."""
    options = Options(__doc__, "network_from_residuals", json=True)
    options.add("--steps", type=int, default=300, help="of Adam on residuals alone")
    options.add("--last", type=int, default=60, help="of Adam on answers too")
    given = options.parse_args(args)
    rows, numbers = trained(given.steps, given.last)
    print(json.dumps(numbers, indent=None if given.json else 1))
    figure, ax = panels()
    for name, label in {"E_res": "residual", "E_u": "displacement that is solved for"}.items():
        ax.semilogy(rows["step"], 100 * np.array(rows[name]), ".-", label=label)
    ax.axvspan(given.steps, given.steps + given.last, alpha=0.15)
    note(ax, "answers in\nthe loss", (given.steps, ax.get_ylim()[1]), (3, -4), va="top")
    ax.set(xlabel="step of Adam", ylabel="error on loads never seen [%]")
    ax.set_title(f"Residuals alone teach displacements to {100 * rows['E_u'][-1]:.2g} %")
    name_lines(ax)
    save_figure(figure, given.out / "network_from_residuals.png")
    return 0


if __name__ == "__main__":
    sys.exit(exit_status(main))
