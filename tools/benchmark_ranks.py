"""One solve and one crack on 1, 2 and 4 ranks: iterations, bits, memory, and what is sent.

Run by `python tools/benchmark.py ranks`. Times are of this machine; iterations, bits and bytes are
not.
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from warp_peri import InputError
from warp_peri.ranks.processes import own_mpiexec

ROOT = Path(__file__).resolve().parent.parent
RANKS = (1, 2, 4)
LIMIT = 3000
"""Seconds of one run."""
BONDS = {"48 bonds, λ = μ": 4, "48 bonds, a dilatation": 8}
"""Rows of nodes that a rank of a sheet with δ = 4h takes from each neighbour."""


def run(count: int, script: str, *words: str) -> dict:
    """The numbers of an example on so many ranks."""
    with tempfile.TemporaryDirectory() as folder:
        command = [own_mpiexec(), "-n", str(count), sys.executable, str(ROOT / "examples" / script)]
        ended = subprocess.run(
            [*command, *words, "--json", "--out", folder],
            capture_output=True, text=True, timeout=LIMIT, check=False,
        )  # fmt: skip
    if ended.returncode:
        raise InputError(f"{script} on {count} ranks: {ended.stderr.strip()[-400:]}")
    return json.loads(ended.stdout.splitlines()[-1])


def ranks(*, quick: bool) -> None:
    """Print the tables."""
    sides, counts = (["24", "32"], RANKS[:2]) if quick else (["128", "250", "500"], RANKS)
    for shape in ("L",) if quick else ("L", "disk", "square", "cube"):
        few = {"L": [*sides, "1000"], "cube": ["32", "64"]}
        those = few.get(shape, sides)
        those = sides if quick else those
        print(f"\n{shape}, residual 1e-8: ranks, iterations of {' '.join(those)}, MB of a rank")
        bits = set()
        for count in counts:
            words = ("--shape", shape, "--tolerance", "1e-8", "--sides", *those)
            found = run(count, "large_plate.py", *words)
            bits.add(json.dumps(found["bits"]))
            iterations = " ".join(str(number) for number in found["iterations"].values())
            print(f"{count:6d}  {iterations:>20}  {found['memory_mb']:6d}", flush=True)
        print("  the same bits" if len(bits) == 1 else "  DIFFERENT BITS", flush=True)
    if quick:
        return
    cracks = {json.dumps(run(count, "branching.py")) for count in (1, 2, 3)}
    print("\nbranching.py on 1, 2, 3 ranks:", *cracks)
    print("  the same numbers" if len(cracks) == 1 else "  DIFFERENT NUMBERS")
    print("\nsent a step of a sheet of 10⁶ nodes a rank, to both neighbours [kB]:")
    for name, rows in BONDS.items():
        print(f"  {name}: {2 * rows * np.sqrt(1e6) * 16 / 1e3:.0f}")
