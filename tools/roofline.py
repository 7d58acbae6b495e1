"""What bounds the sweeps over a lattice: a core's copies, its arithmetic in Warp's code, its loads.

`python tools/benchmark.py roofline` prints the ceilings and how close each sweep comes to them.
"""

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import warp as wp

from warp_peri.kernels.peak import peak
from warp_peri.launch import zeros
from warp_peri.materials.lps_bonds import Bonds
from warp_peri.materials.lps_force import evaluate, sweep
from warp_peri.methods import Solid

PER_BOND = {"dilatation": (4, 3, 2), "force": (7, 7, 3)}
"""Additions, multiplications and loads of numbers that a bond takes in each sweep, as the vector
instructions of the compiled loops show them."""
TURNS = 200_000


def least(function: Callable[[], Any], rounds: int = 25) -> float:
    """Least seconds of the process over the rounds, after one that compiles."""
    function()
    times = []
    for _ in range(rounds):
        start = time.process_time()
        function()
        times.append(time.process_time() - start)
    return min(times)


def peak_pairs(scalar: Any) -> float:
    """Pairs of one addition and one multiplication of numbers a second, on one core."""
    kernel, pairs = peak(scalar)
    out = zeros(1, dtype=scalar)
    inputs = [TURNS, scalar(1.0)]
    command = wp.launch(kernel, dim=1, inputs=inputs, outputs=[out], device="cpu", record_cmd=True)
    return pairs * TURNS / least(command.launch)


def sweeps(bonds: Bonds, solid: Solid, u: np.ndarray) -> dict[str, float]:
    """Seconds of the two sweeps of a lattice laid out in rows."""
    law = bonds.law(*solid.values())
    field = bonds.floats(u.reshape(1, -1))
    felt = evaluate(bonds, field, law)
    fields = field, felt.planes, felt.theta, felt.Lu
    phases = {
        "lay_out": ("laid", None, None),
        "dilatation": (None, "needed", None),
        "force": (None, None, "forces"),
    }

    def of(pieces: tuple[str | None, ...]) -> Callable[[], None]:
        return lambda: sweep(bonds, law, law.forward, pieces, *fields)

    return {name: least(of(pieces)) for name, pieces in phases.items()}


def roofline(bonds: Bonds, solid: Solid, u: np.ndarray, bandwidth: float) -> None:
    """Print the ceilings of one core and the times of the sweeps beside them."""
    size = wp.types.type_size_in_bytes(bonds.scalar)
    pairs = peak_pairs(bonds.scalar)
    count, nodes = len(bonds.families.neighbour), bonds.nodes
    seconds = sweeps(bonds, solid, u)
    print(f"\nroofline of one core, {bonds.scalar.__name__}, {nodes} nodes, {count} bonds")
    print(f"  copying {bandwidth / 1e9:.1f} GB/s; additions and multiplications side by side in")
    print(f"  Warp's code: {pairs / 1e9:.1f} ⋅ 10⁹ of each a second")
    fields = {"lay_out": 4, "dilatation": 3, "force": 5}
    for name, value in seconds.items():
        moved = fields[name] * size * nodes / bandwidth
        print(
            f"  {name:10} {1e3 * value:7.3f} ms; moving its fields once {1e3 * moved:.3f} ms",
            end="",
        )
        if name in PER_BOND:
            sums, products, loads = PER_BOND[name]
            bound = max(sums, products) * count / pairs
            print(
                f"; {sums} sums, {products} products, {loads} loads a bond: at least "
                f"{1e3 * bound:.3f} ms, {100 * bound / value:.0f} % of the arithmetic ceiling, "
                f"{size * loads * count / value / 1e9:.0f} GB/s out of the caches",
                end="",
            )
        print()
    total = sum(seconds.values())
    print(f"  all: {1e9 * total / count:.2f} ns a bond, {count / total / 1e6:.0f} Mbond/s")
