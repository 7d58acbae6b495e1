"""A channel of polymer: a learned law with its band, the exact law, dumbbells under every point.

A law learned from small runs of dumbbells takes the place of simulating dumbbells under every
point of a channel. Hookean dumbbells have an exact law to be held to.

    python examples/polymer/channel.py --json      # numbers alone; figure and table under runs/
"""

import json
import sys
import time
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

import numpy as np

import warp_peri as wp
from examples import prose
from examples.exact import poiseuille
from examples.figures import headline, name_lines, panels
from examples.polymer import ChannelFlow, ChannelRecord, Dumbbells, RateLaw, UpperConvectedMaxwell
from examples.polymer.learn import hookean_law, relative
from examples.polymer.particles import Particles
from examples.polymer.paths import Band
from tools.options import Options
from warp_peri.errors import exit_status
from warp_peri.files.atomic import plain, write_json, write_text

DE, UNTIL, RECORDS = 1e-2, 0.03, 50


def channel(fluid: Any, flow: ChannelFlow) -> tuple[ChannelRecord, float]:
    """The channel with one kind of fluid, and seconds a step."""
    steps = RECORDS * 10
    start = time.perf_counter()
    run = wp.move(fluid, flow, until=UNTIL, dt=UNTIL / steps, every=10)
    return run.details, (time.perf_counter() - start) / steps


def channel_study(
    count: int, seed: int, pairs: int = 1000, draws: int = 6
) -> tuple[dict[str, Any], dict[str, ChannelRecord], Band]:
    """Learned, exact and coupled fluids in one channel, and the band around the learned one."""
    flow = ChannelFlow(DE)
    n = Particles(flow).fluid
    law = hookean_law(count, seed, pairs)
    fluids = {
        "exact law": UpperConvectedMaxwell(),
        "learned law": law.tabulated(),
        "coupled, 1000 dumbbells": Dumbbells(n, 1000, seed=seed, common=True),
    }
    outcomes = {name: channel(fluid, flow) for name, fluid in fluids.items()}
    runs = {name: record for name, (record, _) in outcomes.items()}
    exact = runs["exact law"]
    y = np.linspace(0, 1, 401)
    profile = poiseuille(y, exact.t, DE, flow.Re, flow.force)
    truth = [np.interp(x[:, 1], y, u) for x, u in zip(exact.x, profile)]
    numbers = {
        name: {
            "against the exact law in the same scheme": relative(run.v, exact.v),
            "seconds a step": outcomes[name][1],
            "density": float(np.abs(run.rho - 1).max()),
        }
        for name, run in runs.items()
    }
    numbers["exact law"]["against the exact flow"] = relative(exact.v[..., 0], np.array(truth))

    def centre(drawn: RateLaw) -> np.ndarray:
        return channel(drawn.tabulated(), flow)[0].centre()

    spread = law.band(centre, count=draws, seed=seed)
    numbers["learned law"]["2 sd of the band at the centre"] = float(spread.half_width().max())
    return numbers, runs, spread


def draw(runs: dict[str, ChannelRecord], spread: Band, folder: Path) -> None:
    """Velocity in the middle of the channel, and its profile at the end."""
    figure, (left, right) = panels(10, 3.8, count=2)
    for (name, run), style in zip(runs.items(), ("k-", "C1--", "C0:")):
        left.plot(run.t, run.centre(), style, label=name.replace("law", "model"))
        order = np.argsort(run.x[-1, :, 1])
        right.plot(run.v[-1, order, 0], run.x[-1, order, 1], style)
    t = runs["exact law"].t
    low, high = spread.value - spread.half_width(), spread.value + spread.half_width()
    left.fill_between(t, low, high, color="C1", alpha=0.3)
    left.set(xlabel="time t / t₀ (band: ± 2 deviations)", ylabel="velocity in the middle u / U")
    right.set(xlabel=f"velocity u / U at t = {t[-1]:g} t₀", ylabel="height over the wall y / L")
    name_lines(left)
    headline(
        figure, "The learned fluid flows as the exact one does, in time and across the channel"
    )
    figure.savefig(folder / "channel.png", dpi=130)


def table(numbers: dict[str, Any]) -> str:
    """The numbers as Markdown."""
    channels = []
    for name, row in numbers.items():
        error = row["against the exact law in the same scheme"]
        channels.append([name, f"{error:.2f}", f"{1e3 * row['seconds a step']:.2f}"])
    return prose.table(["fluid", "error %", "ms a step"], channels) + "\n"


def main(arguments: list[str] | None = None) -> None:
    parser = Options(__doc__, "polymer_flow", json=True)
    parser.add("--dumbbells", type=int, default=10_000, help="in each Hookean run")
    parser.add("--pairs", type=int, default=1000, help="increments of stress that the law learns")
    parser.add("--draws", type=int, default=6, help="laws that the band is made of")
    parser.add("--seed", type=int, default=0)
    given = parser.parse_args(arguments)
    start = time.perf_counter()
    rows, runs, spread = channel_study(given.dumbbells, given.seed, given.pairs, given.draws)
    numbers: dict[str, Any] = {"channel": rows, "sizes": {"Hookean": 22 * given.dumbbells}}
    numbers["seconds"] = time.perf_counter() - start
    draw(runs, spread, given.out)
    write_json(given.out / "numbers.json", numbers)
    write_text(given.out / "table.md", table(rows))
    print(json.dumps(plain(numbers), indent=2) if given.json else table(rows))


if __name__ == "__main__":
    sys.exit(exit_status(main))
