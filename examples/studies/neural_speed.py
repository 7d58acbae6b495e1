"""Force and gradient of the neural operator at the printed widths: against matmul and plain torch.

The plain version evaluates the network for both ends of every directed bond of the interior, as a
first implementation does. Seconds are of the processor, the least of some repeats in turn.
"""

import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent.parent
sys.path.insert(0, str(ROOT))

import torch

from examples import neural_sets
from tools.options import Options
from warp_peri.errors import exit_status
from warp_peri.launch import set_threads
from warp_peri.neural import NeuralOperator
from warp_peri.neural.bonds import Gather
from warp_peri.neural.material import CHUNK, load, units
from warp_peri.neural.placed import Placed, interpolated_force
from warp_peri.neural.training import relative


def plain(placed: Placed, u: torch.Tensor) -> torch.Tensor:
    """The same force by torch alone."""
    bonds, net = placed.bonds, placed.material
    assert isinstance(net, NeuralOperator)
    rows, whole = torch.as_tensor(bonds.rows), torch.as_tensor(bonds.whole)
    row, table = torch.as_tensor(bonds.row), torch.as_tensor(bonds.neighbour).long()
    xi = torch.as_tensor(bonds.xi, dtype=u.dtype)
    r = xi.norm(dim=1)
    Y = xi + u[:, table[whole]] - u[:, whole, None]
    e = Y.norm(dim=-1) - r
    omega = net.influence(r[:, None] / net.horizon)[:, 0]
    theta = (e * omega * r).sum(-1) / (omega * r**2).sum()
    inner = row[rows]
    mine, far = e[:, inner], row[table[rows]]
    total = torch.zeros(())
    for dilatation in (theta[:, inner, None], theta[:, far]):
        inputs = (omega, dilatation / net.strain, mine / (net.strain * r), r / net.horizon)
        total = (
            total
            + net.scale
            * net.state(torch.stack([part.expand_as(mine) for part in inputs], dim=-1))[..., 0]
        )
    M = Y[:, inner] / Y[:, inner].norm(dim=-1, keepdim=True)
    return -bonds.area * (M * total[..., None]).sum(2)


def undecided(placed: Placed, u: torch.Tensor) -> float:
    """The share of the large products that is made: units whose sign differs within a chunk."""
    omega, share, r = placed.shares(u.dtype)
    e, theta = Gather.apply(u, share, placed.bonds)
    net, parts = placed.material, list[int]()
    assert isinstance(net, NeuralOperator)
    first: Any = net.state[0]
    for seen in placed.inputs(omega, theta, e, r):
        scales: Any = (1.0, net.strain, net.strain * seen[3], net.horizon)
        inputs = torch.stack([part / scale for part, scale in zip(seen, scales)], dim=1)
        for part in inputs.split(CHUNK):
            parts.append(len(part) * len(units(part, first.weight, first.bias)[1]))
    return sum(parts) / (2 * e.numel() * len(first.bias))


def least(ways: dict[str, Callable[[], object]], repeats: int) -> dict[str, float]:
    """Processor seconds of each, the least."""
    found: dict[str, list[float]] = {name: [] for name in ways}
    for _ in range(repeats + 1):
        for name, way in ways.items():
            began = time.process_time()
            way()
            found[name].append(time.process_time() - began)
    return {name: min(values[1:]) for name, values in found.items()}


def main() -> int:
    """Measure and print."""
    parser = Options(__doc__)
    parser.add("--samples", type=int, default=2)
    parser.add("--repeats", type=int, default=3)
    parser.add("--threads", type=int, default=1)
    parser.add("--fresh", action="store_true", help="untrained numbers")
    given = parser.parse_args()
    torch.set_num_threads(given.threads)
    set_threads(given.threads)
    samples = neural_sets.graphene(ROOT / "data" / "graphene_0K.h5")["train"]
    material = (
        NeuralOperator(20.0, strain=0.5)
        if given.fresh
        else load(ROOT / "examples" / "neural_weights" / "graphene.json").float()
    )
    placed = material.on(samples.points)
    u = torch.as_tensor(samples.u[: given.samples], dtype=torch.float32)
    b = torch.as_tensor(samples.loads[: given.samples, samples.interior], dtype=torch.float32)
    n = 2 * placed.bonds.acting * given.samples
    x, W, square = torch.randn(n, 512), torch.randn(512, 512), torch.randn(4096, 4096)

    def learn(force: Callable[[Placed, torch.Tensor], torch.Tensor]) -> None:
        relative(force(placed, u), b).mean().backward()

    def products() -> None:
        """The three products of a force and its gradient at these shapes."""
        y = x @ W
        y @ W.t()
        y.t() @ x

    with torch.no_grad():
        gap = float((plain(placed, u) - placed(u)).norm() / placed(u).norm())
        made = undecided(placed, u)
    ways: dict[str, Callable[[], object]] = {
        "square matmul": lambda: square @ square,
        "three matmuls": products,
        "plain torch": lambda: learn(plain),
        "this": lambda: learn(lambda p, v: p(v)),
        "interpolated": lambda: learn(lambda p, v: interpolated_force(p, v)),
    }
    seconds = least(ways, given.repeats)
    rate = 6 * n * 512 * 512 / 1e9
    report = {
        "bond states a sample": n // given.samples,
        "agree to": gap,
        "seconds": seconds,
        "of matmul's rate": seconds["three matmuls"] / seconds["this"],
        "GFLOP/s of matmul": rate / seconds["three matmuls"],
        "GFLOP/s of the processor": 2 * len(square) ** 3 / 1e9 / seconds["square matmul"],
        "share of products made": made,
        "GFLOP/s of those": made * rate / seconds["this"],
        "times plain torch": seconds["plain torch"] / seconds["this"],
    }
    print(json.dumps(report, indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(exit_status(main))
