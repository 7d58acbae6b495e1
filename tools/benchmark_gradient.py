"""What gradients cost: of a force beside plain torch, of a motion beside itself, and in memory."""

import json
import resource
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch

import warp_peri as wp
from tools import rivals
from warp_peri.launch import set_threads
from warp_peri.materials.lps_bonds import Bonds

SPACING, HORIZON, DENSITY = 1.0, 4.0, 2200.0
SOLID: dict[str, Any] = {
    "lam": -0.2,
    "mu": 0.72,
    "alpha": 1.0,
    "D": np.array([1.0, 0.8, 0.5, 0.4, 0.3]),
}

ASKED: dict[str, tuple[str, ...]] = {
    "fields": (),
    "fields, λ, μ": ("lam", "mu"),
    "fields, λ, μ, α, D": ("lam", "mu", "alpha", "D"),
}


def solid(side: int) -> tuple[Any, Any]:
    """A linear peridynamic solid on side² interior nodes, and its nodes."""
    reach = 2 * int(HORIZON)
    x = np.argwhere(np.ones((side + 2 * reach,) * 2)).astype(float)
    interior = np.abs(x - x.mean(axis=0)).max(axis=1) < side / 2
    points = wp.Points(x, interior, SPACING)
    model = wp.Model(**SOLID, horizon=HORIZON, certified_on=(SPACING,))
    return model.on(points), points


def least(functions: dict[str, Any], rounds: int) -> dict[str, float]:
    """Least seconds of the processor of each, taken in turn after one untimed call."""
    found = {name: np.inf for name in functions}
    for function in functions.values():
        function()
    for _ in range(rounds):
        for name, function in functions.items():
            start = time.process_time()
            function()
            found[name] = min(found[name], time.process_time() - start)
    return found


def of_force(side: int, rounds: int) -> dict[str, float]:
    """A step of a torch loss, ½ mean (L u − b)² to u, α and D: here, and by torch's scatter."""
    x = np.argwhere(np.ones((side, side))).astype(float)
    box = (float(side), float(side))
    points = wp.Points(x, np.ones(len(x), bool), SPACING, box=box)
    bonds = Bonds(points, HORIZON)
    fields = np.random.default_rng(1).normal(size=(2, len(x), 2))
    t = rivals.tables(bonds, x, np.array(box), *fields, **SOLID)
    _, scatter = rivals.torch_scatter(t, torch.float64)
    operator = wp.Model(**SOLID, horizon=HORIZON, certified_on=(SPACING,)).on(points)
    module = wp.Module(operator, points)
    u = torch.from_numpy(fields[0]).requires_grad_()
    seed = torch.from_numpy(fields[1])
    leaves: list[Any] = [u, module.D, module.alpha]

    def here() -> Any:
        return torch.autograd.grad((module(u) * seed).sum(), leaves)

    def field() -> Any:
        return torch.autograd.grad((operator(u) * seed).sum(), u)

    for one, other in zip(here(), scatter()):
        wrong = np.abs(one.numpy() - other).max() / np.abs(other).max()
        if not wrong <= 1e-8:
            raise RuntimeError(f"the rival's gradient differs by {wrong:.1e}")
    return least({"to u": field, "to u, α, D": here, "torch scatter": scatter}, rounds)


def motion(side: int, steps: int, names: tuple[str, ...]) -> tuple[Any, Any]:
    """Forward and backward of waves on side² nodes, to the start and numbers by name."""
    operator, points = solid(side)
    step = 0.5 * wp.proofs.critical_time_step(operator.model, spacing=SPACING, density=DENSITY)
    x = points.x - points.x.mean(axis=0)
    u = np.exp(-np.square(x).sum(axis=1) / 50)[:, None] * [1e-3, 0]
    start = torch.from_numpy(u).requires_grad_()
    sizes: dict[str, Any] = {"density": DENSITY, "step": step, "steps": steps, "every": steps}
    extra = {n: torch.tensor(SOLID[n], dtype=torch.float64, requires_grad=True) for n in names}

    def forward() -> Any:
        given = {"parameters": extra} if extra else {}
        return wp.move(operator, wp.Dirichlet(points, None, start), **sizes, **given)

    def backward(moved: Any) -> Any:
        return torch.autograd.grad(moved.u.square().sum(), [start, *extra.values()])

    return forward, backward


def of_motion(side: int, steps: int, rounds: int) -> dict[str, float]:
    """Seconds of the pass backwards over those of the pass forwards: to fields, to numbers too."""
    found = {}
    for name, names in ASKED.items():
        forward, backward = motion(side, steps, names)
        ratios = []
        for _ in range(rounds):
            start = time.process_time()
            moved = forward()
            middle = time.process_time()
            backward(moved)
            ratios.append((time.process_time() - middle) / (middle - start))
        found[name] = float(np.median(ratios))
    return found


def memory(side: int, steps: int) -> dict[str, float]:
    """Largest resident memory [MB] and seconds of a motion there and back, in its own process."""
    code = (
        "import json, sys, time; from tools import benchmark_gradient as b; s = time.time();"
        f"f, g = b.motion({side}, {steps}, b.ASKED['fields, λ, μ, α, D']); m = f();"
        "h = time.time() - s; g(m); print(json.dumps([b.peak(), h, time.time() - s - h]))"
    )
    told = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    megabytes, there, back = json.loads(told.stdout.splitlines()[-1])
    found = {"nodes": side**2, "steps": steps, "MB": megabytes, "there": there, "back": back}
    print(json.dumps(found), file=sys.stderr, flush=True)  # the next may take long
    return found


def peak() -> float:
    """Largest resident memory of this program so far [MB]; Linux's own count begins at its start,
    getrusage's with what the process was before."""
    status = Path("/proc/self/status")
    if status.exists():
        words = dict(line.split(":", 1) for line in status.read_text().splitlines())
        return float(words["VmHWM"].split()[0]) / 2**10
    size = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return size / 2**20 if sys.platform == "darwin" else size / 2**10


def gradient(*, quick: bool, long: bool = False, as_json: bool = False) -> None:
    """The table of what gradients cost, on one thread; `long` adds 10⁵ steps on 200² nodes, which
    take some twenty minutes."""
    set_threads(1)
    torch.set_num_threads(1)
    side, rounds = (16, 1) if quick else (200, 7)
    seconds = of_force(side, rounds)
    ratios = of_motion(side, 5 if quick else 60, min(rounds, 3))
    sizes = [(side, 20)] if quick else [(200, 1000), (200, 10_000), (40, 30_000)]
    kept = [memory(*one) for one in [*sizes, *([(200, 100_000)] if long else [])]]
    if as_json:
        print(json.dumps({"seconds": seconds, "backward over forward": ratios, "memory": kept}))
        return
    print(f"gradient of a torch loss on {side}² nodes, one thread, the processor's time")
    for name, value in seconds.items():
        print(
            f"  {name:16}{1e3 * value:9.1f} ms, 1/{seconds['torch scatter'] / value:.1f} of torch"
        )
    print(f"`move` on {side}² nodes, backward over forward")
    for name, ratio in ratios.items():
        print(f"  to {name:20}{ratio:6.2f}")
    print("memory of `move` there and back, to fields, λ, μ, α and D")
    for row in kept:
        print(
            f"  {row['nodes']:6.0f} nodes {row['steps']:7.0f} steps {row['MB']:7.0f} MB, "
            f"{row['there']:.0f} and {row['back']:.0f} s"
        )
