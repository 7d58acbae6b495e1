"""A monotone neural force state on the main job's data: what a convex energy costs.

The force state of a convex energy, with weights k ≥ 0 and growing g, of the dilatation θ and of the
stretches less θ (of whole stretches instead it would have λ ≥ μ, which this graphene has not),
trained by Adam on the relative ℓ2 error of b. Widths, rates and samples in a step are chosen by
short trainings, by the error of training and validation loads. The best setting is then trained
anew. Leaves monotone.json.
"""

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any, NamedTuple

sys.path.insert(0, str(Path(__file__).resolve().parent.parent.parent))

import numpy as np
import torch
from tqdm import tqdm

import warp_peri as wp
from examples.nonlinear import OUT, STRAINED
from examples.prose import table
from examples.train_graphene import DATA
from tools.options import Options
from warp_peri import Samples
from warp_peri.errors import exit_status
from warp_peri.files.atomic import write_json
from warp_peri.neural.material import network
from warp_peri.points.families import families_of
from warp_peri.statics.equilibria import anderson
from warp_peri.third_order.material import NonlinearModel

HORIZON, STRAIN = 20.0, 0.02
"""δ [Å], and the scale of the networks' inputs."""
FIRST, SOLVED = 7, 1e-5
"""Samples that the size of a network's force is set by, and the tolerance of solves."""


class Setting(NamedTuple):
    """Widths of the two networks' hidden layers, Adam's rate, samples and nodes in a step."""

    first: tuple[int, int]
    second: tuple[int, int]
    rate: float
    batch: int = 2
    nodes: int = 40


SMALL, MIDDLE, WIDE = ((16, 16), (32, 32)), ((32, 64), (64, 64)), ((64, 64), (128, 128))
"""Widths; those in the middle are printed for measured tissue."""
TRIED = (
    Setting(*MIDDLE, 3e-3),
    Setting(*MIDDLE, 1e-2),
    Setting(*SMALL, 1e-2),
    Setting(*WIDE, 1e-2),
    Setting(*MIDDLE, 1e-2, batch=7),
)
EVERY = slice(None)
TRAIN_EVERY = 5
"""Of the training loads, one in so many is solved for."""
LOOKED = 5
"""Epochs from one look at the validation loads to the next."""


class BondTable:
    """Bonds of one set: extensions and directions of all samples, in single precision."""

    def __init__(self, samples: Samples) -> None:
        families = families_of(samples, HORIZON)
        count = len(families.pattern)
        self.samples, self.full, self.rows = samples, families.whole, families.rows
        self.neighbour = families.neighbour.reshape(-1, count)
        place = np.zeros(len(samples.x), int)
        place[self.full] = np.arange(len(self.full))
        self.own = torch.from_numpy(place[self.rows])
        self.far = torch.from_numpy(place[self.neighbour[self.rows]])
        self.xi = families.pattern
        self.r = torch.tensor(np.hypot(*families.pattern.T), dtype=torch.float32)
        loads = samples.loads[:, samples.interior]
        self.b = torch.tensor(loads, dtype=torch.float32)
        self.size = self.b.flatten(1).norm(dim=1)
        self.e, self.M = self.stretched(samples.u)

    def stretched(self, u: np.ndarray) -> tuple[torch.Tensor, torch.Tensor]:
        """Extensions [S, F, B] and, on the interior, directions [S, I, B, 2]."""
        eta = u[:, self.neighbour[self.full]] - u[:, self.full, None]
        Y = self.xi + eta
        length = np.linalg.norm(Y, axis=-1)
        e = torch.tensor(length - self.r.double().numpy(), dtype=torch.float32)
        M = (Y / length[..., None])[:, self.own.numpy()]
        return e, torch.tensor(M, dtype=torch.float32)

    def force(
        self, net: Any, e: torch.Tensor, M: torch.Tensor, nodes: torch.Tensor | slice = EVERY
    ) -> torch.Tensor:
        """−Σ (T_ij + T_ji) M on the interior or some nodes of it; both have the same extension."""
        states, own, far = net.states_of(e, self.r), self.own[nodes], self.far[nodes]
        mine = e[:, own]
        T = net(mine, [state[:, own, None] for state in states], self.r)
        T = T + net(mine, [state[:, far] for state in states], self.r)
        return -(M[:, nodes] * T[..., None]).sum(2)


class Increasing(torch.nn.Module):
    """A function of one number that grows: weights through a softplus, tanh between."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.first, self.second = torch.nn.Linear(1, width), torch.nn.Linear(width, 1)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        positive = torch.nn.functional.softplus
        hidden = torch.tanh(x[..., None] * positive(self.first.weight[:, 0]) + self.first.bias)
        rest = torch.tanh(self.first.bias)
        return ((hidden - rest) * positive(self.second.weight[0])).sum(-1) + 0.1 * x


class Monotone(torch.nn.Module):
    """The derivative of Σ k(r) r G(e/r − θ) + m G_d(θ) to e; m θ = Σ k_d r e, m = Σ k_d r².

    All k positive and both g = G′ growing: a convex energy.
    """

    def __init__(self, first: tuple[int, int], second: tuple[int, int]) -> None:
        super().__init__()
        self.kernel, self.dilatation = network(1, *first, 1), network(1, *first, 1)
        self.g, self.g_d = Increasing(second[0]), Increasing(second[1])
        self.scale = 1.0

    def kernels(self, r: torch.Tensor) -> list[torch.Tensor]:
        both = (self.kernel, self.dilatation)
        return [torch.nn.functional.softplus(net(r[:, None] / HORIZON)[:, 0]) for net in both]

    def states_of(self, e: torch.Tensor, r: torch.Tensor) -> list[torch.Tensor]:
        """θ, and Σ k g r / m: what a bond's extension does to all others through θ."""
        k, k_d = self.kernels(r)
        m = (k_d * r**2).sum()
        theta = (e * k_d * r).sum(-1) / m
        stretch = e / r - theta[..., None]
        return [theta, (k * r * self.g(stretch / STRAIN)).sum(-1) / m]

    def forward(self, e: torch.Tensor, states: list[torch.Tensor], r: torch.Tensor) -> torch.Tensor:
        k, k_d = self.kernels(r)
        theta, others = states
        direct = k * self.g((e / r - theta) / STRAIN)
        return self.scale * (direct + k_d * r * (self.g_d(theta / STRAIN) - others))


def errors_of(
    net: torch.nn.Module, bonds: BondTable, some: torch.Tensor, nodes: torch.Tensor | slice = EVERY
) -> torch.Tensor:
    """Relative ℓ2 errors of b, or what some nodes say of them."""
    b = bonds.b[some]
    left = bonds.force(net, bonds.e[some], bonds.M[some], nodes) - b[:, nodes]
    share = left.shape[1] / b.shape[1]
    return left.flatten(1).norm(dim=1) / (bonds.size[some] * share**0.5)


def train(
    net: Any, bonds: BondTable, val: BondTable, setting: Setting, minutes: float, quiet: bool
) -> dict[str, Any]:
    """Adam with a falling rate; the weights of least training and validation error count."""
    everything, unseen = torch.arange(len(bonds.b)), torch.arange(len(val.b))
    with torch.no_grad():
        size = bonds.force(net, bonds.e[:FIRST], bonds.M[:FIRST]).norm()
        net.scale = float(bonds.b[:FIRST].norm() / size)
    adam = torch.optim.Adam(net.parameters(), lr=setting.rate)
    began, best, epochs, kept = time.process_time(), np.inf, 0, net.state_dict()
    bar = tqdm(total=round(60 * minutes), unit="s", disable=quiet or None, leave=False)
    while (part := (time.process_time() - began) / (60 * minutes)) < 1:
        for group in adam.param_groups:
            group["lr"] = setting.rate * (0.5 + 0.5 * np.cos(np.pi * part)) + 1e-6
        total = 0.0
        for some in everything[torch.randperm(len(everything))].split(setting.batch):
            adam.zero_grad()
            nodes = torch.randperm(bonds.b.shape[1])[: setting.nodes]
            loss = errors_of(net, bonds, some, nodes).mean()
            loss.backward()
            adam.step()
            total += float(loss.detach()) * len(some) / len(everything)
        epochs += 1
        over = time.process_time() - began >= 60 * minutes
        if epochs % LOOKED and not over:
            continue
        with torch.no_grad():
            score = total + float(errors_of(net, val, unseen).mean())
        if score < best:
            best = score
            kept = {key: value.clone() for key, value in net.state_dict().items()}
        bar.n = round(time.process_time() - began)
        bar.set_postfix(both=f"{100 * score:.2f} %")
    net.load_state_dict(kept)
    numbers = sum(p.numel() for p in net.parameters())
    record = {"epochs": epochs, "numbers": numbers, "minutes": minutes, "score": best}
    return record | setting._asdict()


def solved(net: Any, bonds: BondTable, model: NonlinearModel, every: int = 1) -> dict[str, float]:
    """E_u by the accelerated fixed point of the linear solid, and the share that converged."""
    samples = bonds.samples
    straight = model.linear.on(samples)
    solver = straight.inverse(len(samples))
    inside, misses, ended = samples.interior, [], 0
    for u, b in zip(samples.u[::every], samples.loads[::every]):
        field = u.copy()
        field[inside] = 0
        right = b[inside] - straight(field)
        scale = float(np.linalg.norm(right))

        def left(
            inner: np.ndarray, field: np.ndarray = field, b: np.ndarray = b, scale: float = scale
        ) -> np.ndarray:
            field[inside] = inner
            with torch.no_grad():
                e, M = bonds.stretched(field[None])
                force = bonds.force(net, e, M)[0].double().numpy()
            return np.asarray((b[inside] - force) / scale)

        def correction(residual: np.ndarray, scale: float = scale) -> np.ndarray:
            return solver(residual * scale, SOLVED)

        inner, size = anderson(left, correction, solver(right, SOLVED), SOLVED)
        ended += size <= 100 * SOLVED  # single precision
        misses.append(np.linalg.norm(inner - u[inside]) / np.linalg.norm(u[inside]))
    return {"E_u": float(np.mean(misses)), "converged": ended / len(misses)}


def run(given: argparse.Namespace) -> dict[str, Any]:
    """What was tried, and the errors of the best, trained anew, on every set."""
    torch.set_num_threads(1)
    data, larger = wp.load(DATA), wp.load(STRAINED)
    named = {name: data[name] for name in ("train", "val", "test")}
    named |= {name: larger[name] for name in larger}
    sets = {name: BondTable(samples) for name, samples in named.items()}
    model = wp.load(given.models / "energy.json")
    tried = []
    for setting in TRIED[: given.settings]:
        tried.append(trained(sets, setting, given.try_minutes, given)[1])
        print(tried[-1], file=sys.stderr)
    best = TRIED[int(np.argmin([record["score"] for record in tried]))]
    net, record = trained(sets, best, given.minutes, given)
    errors: dict[str, dict[str, float]] = {}
    for name, bonds in sets.items():
        with torch.no_grad():
            misses = errors_of(net, bonds, torch.arange(len(bonds.b)))
        found = solved(net, bonds, model, every=TRAIN_EVERY if name == "train" else 1)
        errors[name] = {"E_res": float(misses.mean()), **found}
    report = {**record, "tried": tried, "errors": errors}
    write_json(given.models / "monotone.json", report)
    return report


def trained(
    sets: dict[str, BondTable], setting: Setting, minutes: float, given: argparse.Namespace
) -> tuple[torch.nn.Module, dict[str, Any]]:
    """A new network of a setting, trained for so long."""
    torch.manual_seed(given.seed)
    net = Monotone(setting.first, setting.second)
    return net, train(net, sets["train"], sets["val"], setting, minutes, given.json)


def page(report: dict[str, Any]) -> str:
    """Errors on every set, and what was tried, as Markdown."""
    kinds = ("E_res", "E_u", "converged")
    rows = [
        [name, *(f"{100 * errors[kind]:.3g}" for kind in kinds)]
        for name, errors in report["errors"].items()
    ]
    text = table(["%", *kinds], rows) + "\n"
    keys = ("first", "second", "rate", "batch", "nodes", "numbers", "epochs", "minutes")
    rows = [
        [*(str(record[key]) for key in keys), f"{100 * record['score']:.2f}"]
        for record in (*report["tried"], report)
    ]
    return text + "\n" + table([*keys, "train + val [%]"], rows)


def main(arguments: list[str] | None = None) -> int:
    parser = Options(__doc__, json=True, defaults=True)
    parser.add("--minutes", type=float, default=2.0, help="processor time of the best one")
    parser.add("--try-minutes", type=float, default=0.15, help="of each setting tried")
    parser.add("--settings", type=int, default=len(TRIED), help="how many are tried")
    parser.add("--seed", type=int, default=0)
    parser.add("--models", type=Path, default=OUT, help="folder of examples/nonlinear.py")
    given = parser.parse_args(arguments)
    report = run(given)
    print(json.dumps(report) if given.json else page(report))
    return 0


if __name__ == "__main__":
    sys.exit(exit_status(main))
