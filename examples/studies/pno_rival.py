"""The peridynamic neural operator as printed, on the same fields as the energy dictionary.

Jafarzadeh et al. 2024, equations 3.7–3.10: the force state is a network of the influence, the
dilatation, the extension and the length of a bond, the influence a network of the bond. Trained on
the nodes whose surroundings are data, as the dictionary is; and both on all nodes, with the paper's
mirror rule u(v) = 2 u(b) − u(m) around the square. Widths and rate are those of least validation
error after a short run each.
"""

from __future__ import annotations

import argparse
import copy
import json
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent.parent
sys.path.insert(0, str(ROOT))

import numpy as np
import torch
from scipy.optimize import root

from examples.neural_sets import mirrored
from examples.studies.pno_training import chosen_setting, relative, train
from tools.make_hgo import ELEMENTS, HORIZON, SPACING, make_hgo
from warp_peri.errors import exit_status
from warp_peri.files.atomic import finite, plain, write_json
from warp_peri.neural.networks import network
from warp_peri.points.samples import Samples
from warp_peri.tissue.energy_fit import fit_energy
from warp_peri.tissue.fit_errors import hyperelastic_errors
from warp_peri.tissue.solid import Dictionary

REACH = HORIZON
STRETCH = 5.0
"""Scale of the network's inputs; strains are about a fifth."""


class PeridynamicOperator(torch.nn.Module):
    """Force on the nodes whose families and whose neighbours' families are on the grid."""

    def __init__(self, first: int, second: int) -> None:
        super().__init__()
        side = range(-REACH, REACH + 1)
        self.steps = [(a, b) for a in side for b in side if 0 < a * a + b * b <= REACH**2]
        self.reverse = [self.steps.index((-a, -b)) for a, b in self.steps]
        xi = SPACING * torch.tensor(self.steps, dtype=torch.float32)
        self.xi = torch.nn.Parameter(xi, requires_grad=False)
        self.influence = network(2, first, second, 1)
        self.state = network(4, second, second, 1)
        self.scale = 1.0

    def forward(self, u: torch.Tensor) -> torch.Tensor:
        """b on [S, n − 4 REACH, m − 4 REACH, 2] of u on [S, n, m, 2]."""
        n, m = u.shape[1:3]
        centre = u[:, REACH : n - REACH, REACH : m - REACH]
        moved = torch.stack(
            [
                u[:, REACH + a : n - REACH + a, REACH + b : m - REACH + b] - centre
                for a, b in self.steps
            ],
            dim=3,
        )
        Y = self.xi + moved
        length, before = Y.norm(dim=-1), self.xi.norm(dim=1)
        extension = length - before
        omega = self.influence(self.xi / (REACH * SPACING))[:, 0]
        theta = (extension * omega * before).sum(-1) / (omega * before**2).sum()
        inputs = torch.stack(
            [
                omega.expand_as(extension),
                STRETCH * theta[..., None].expand_as(extension),
                STRETCH * extension / SPACING,
                (before / (REACH * SPACING)).expand_as(extension),
            ],
            dim=-1,
        )
        t = self.scale * self.state(inputs)[..., 0]
        M = Y / length[..., None]
        rows, columns = n - 4 * REACH, m - 4 * REACH
        inner = (slice(REACH, REACH + rows), slice(REACH, REACH + columns))
        total = torch.zeros(1)
        for k, (a, b) in enumerate(self.steps):
            far = t[
                :, REACH + a : REACH + a + rows, REACH + b : REACH + b + columns, self.reverse[k]
            ]
            total = (
                total - (t[:, inner[0], inner[1], k] + far)[..., None] * M[:, inner[0], inner[1], k]
            )
        return SPACING**2 * total


def grid_steps(samples: Samples) -> np.ndarray:
    """Places of the nodes on the smallest grid that holds them, shape [N, 2]."""
    steps: np.ndarray = np.rint((samples.x - samples.x.min(axis=0)) / SPACING).astype(int)
    return steps


def on_grid(samples: Samples) -> tuple[torch.Tensor, torch.Tensor]:
    """u on the whole grid, zero where no node is, and b on its interior."""
    steps = grid_steps(samples)
    sides = steps.max(axis=0) + 1
    u, b = (np.zeros((len(samples), *sides, 2)) for _ in range(2))
    u[:, steps[:, 0], steps[:, 1]], b[:, steps[:, 0], steps[:, 1]] = samples.u, samples.loads
    edge = slice(2 * REACH, -2 * REACH)
    return torch.tensor(u).float(), torch.tensor(b[:, edge, edge]).float()


def residuals(model: PeridynamicOperator, samples: Samples) -> np.ndarray:
    """Relative residuals on the interior, whatever its shape, shape [S]."""
    inner = tuple((grid_steps(samples)[samples.interior] - 2 * REACH).T)
    u, b = on_grid(samples)
    with torch.no_grad():
        force = torch.cat([model(field[None]) for field in u])
    index = (slice(None), *inner)
    errors: np.ndarray = relative(force[index], b[index]).numpy()
    return errors


def solved_errors(model: PeridynamicOperator, samples: Samples, count: int) -> np.ndarray:
    """Relative errors of the solved displacement, NaN where none is found, shape [count].

    The search is for a zero of the residual by Newton and Krylov and begins at the true field,
    which is kind to the network.
    """
    exact = copy.deepcopy(model).double()
    steps = grid_steps(samples)[samples.interior]
    nodes, inner = tuple(steps.T), tuple((steps - 2 * REACH).T)
    errors = np.full(count, np.nan)
    for n, (field, load) in enumerate(zip(*(part[:count].double() for part in on_grid(samples)))):

        def left(v: np.ndarray, field: torch.Tensor = field, load: torch.Tensor = load) -> Any:
            moved = field.clone()
            moved[nodes] = torch.tensor(v.reshape(-1, 2))
            with torch.no_grad():
                return (exact(moved[None])[0] - load)[inner].numpy().ravel()

        truth = field[nodes].numpy().ravel()
        wanted = 1e-4 * float(load[inner].abs().max())
        answer = root(left, truth, method="krylov", options={"fatol": wanted, "maxiter": 40})
        if answer.success:
            errors[n] = np.linalg.norm(answer.x - truth) / np.linalg.norm(truth)
    return errors


def dictionary_errors(sets: dict[str, Samples], dictionary: Dictionary) -> dict[str, float]:
    """E_res of the dictionary's least squares on every set."""
    solid = fit_energy(sets["train"], dictionary).material
    return {
        name: hyperelastic_errors(solid, samples, solve=False)["E_res"]
        for name, samples in sets.items()
    }


def record_of(
    model: PeridynamicOperator, sets: dict[str, Samples], solved: int
) -> dict[str, float]:
    """Errors of a trained network on every set."""
    record: dict[str, float] = {}
    for name, samples in sets.items():
        record[name] = float(residuals(model, samples).mean())
        if solved and name in ("val", "disks"):
            errors = solved_errors(model, samples, min(solved, len(samples)))
            missing = np.isnan(errors)
            record[f"{name}, not solved"] = int(missing.sum())
            if not missing.all():
                record[f"{name}, E_u"] = float(errors[~missing].mean())
    return record


def main() -> None:
    """Run and print."""
    from examples.hgo_square import FREE

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--element", choices=ELEMENTS, default="linear")
    parser.add_argument("--minutes", type=float, default=6.0, help="of processor time, each")
    parser.add_argument(
        "--tune", type=float, default=1.2, help="minutes of each setting that is tried"
    )
    parser.add_argument("--samples", type=int, default=200)
    parser.add_argument("--solved", type=int, default=5, help="samples solved for E_u")
    parser.add_argument("--mirror", action="store_true", help="train on the mirrored squares too")
    parser.add_argument("--jobs", type=int, default=-1)
    parser.add_argument("--data", type=Path, default=ROOT / "data" / "hgo")
    parser.add_argument("--out", type=Path, default=ROOT / "runs" / "pno_rival")
    parser.add_argument("--json", action="store_true", help="print the numbers as JSON")
    given = parser.parse_args()
    counts = (given.samples, 25, 25, 10)
    sets = make_hgo(
        given.data, element=given.element, counts=counts, jobs=given.jobs, progress=not given.json
    )
    wide = {name: mirrored(samples, REACH) for name, samples in sets.items() if name != "disks"}
    records: dict[str, Any] = {
        "dictionary": dictionary_errors(sets, FREE),
        "dictionary, mirror rule": dictionary_errors(wide, FREE),
    }
    runs = {"network": sets, **({"network, mirror rule": wide} if given.mirror else {})}
    shared = {"folder": given.out / "checkpoints", "quiet": given.json}
    fields = {name: (on_grid(data["train"]), on_grid(data["val"])) for name, data in runs.items()}
    choice = chosen_setting(PeridynamicOperator, *fields["network"], given.tune, **shared)
    records["setting"] = choice
    for name, data in runs.items():
        model, record = train(
            PeridynamicOperator, *fields[name], choice["setting"], given.minutes, **shared
        )
        records[name] = record | record_of(model, data, 0 if data is wide else given.solved)
        if data is wide:
            records[name]["within the data"] = record_of(model, sets, given.solved)
        records = finite(plain(records))  # a network that diverged has no errors
        write_json(given.out / f"{given.element}.json", records)  # the next may take minutes
    if given.json:
        print(json.dumps(records, indent=2))
        return
    for name, errors in records.items():
        if name == "setting":
            continue
        keys = [key for key in ("train", "val", "test", "disks") if key in errors]
        parts = [f"{key} {100 * (errors[key] or np.nan):.2f}" for key in keys]
        print(f"{name:26} E_res in %: {'  '.join(parts)}")


if __name__ == "__main__":
    sys.exit(exit_status(main))
