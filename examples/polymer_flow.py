"""Polymer flow with memory: dumbbells → a law with error bars → flows that no fit saw.

A law learned from small runs of dumbbells takes the place of simulating dumbbells under every
point of a channel. Hookean dumbbells have an exact law to be held to; FENE dumbbells have none.

    python examples/polymer_flow.py --json      # numbers alone; figure and table under runs/
"""

import json
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

import numpy as np

import warp_peri as wp
from examples import prose
from examples.exact import poiseuille
from examples.figures import headline, name_lines, panels
from examples.flows.paths import Band, band
from tools.options import Options
from warp_peri.errors import exit_status
from warp_peri.files.atomic import plain, write_json, write_text
from warp_peri.flow import (
    FENEP,
    ChannelFlow,
    ChannelRecord,
    Dumbbells,
    RateLaw,
    TwistedSpringLaw,
    UpperConvectedMaxwell,
    elongation,
    held,
    homogeneous,
    learn_rate,
    learn_twisted,
    mixed,
    shear,
    simulate,
    start_pairs,
)
from warp_peri.flow.channel import Particles

DE, UNTIL, RECORDS = 1e-2, 0.03, 50
B = 50.0


def relative(value: np.ndarray, truth: np.ndarray) -> float:
    """Relative ℓ2 error in %."""
    return float(100 * np.linalg.norm(value - truth) / np.linalg.norm(truth))


def hookean_law(count: int, seed: int) -> RateLaw:
    """A rate learned from mixed flows of Hookean dumbbells, what the flow itself does known."""
    K = mixed(22, 200, 0.4, hold=10, seed=seed)
    pairs = start_pairs(simulate(Dumbbells(22, count, seed=seed), K, 0.05), 2)
    chosen = pairs.choose(1000, np.random.default_rng(seed))
    return learn_rate(chosen, outside="allow")


def fene_law(count: int, seed: int) -> TwistedSpringLaw:
    """A spring with a second memory, from shear, elongation and rest after them."""
    rates = np.array([0.5, 1.0, 2.0, 4.0, 8.0])
    K = np.concatenate([shear(rates), elongation(np.array([0.25, 0.5, 1.0, 2.0]))])
    K = np.concatenate([held(K, 60), np.zeros((40, len(K), 4))])
    record = simulate(Dumbbells(len(K[0]), count, b=B, seed=seed), K, 0.1, steps=5)
    return learn_twisted(record, b=B, points=200, outside="allow")


def channel(fluid: Any, flow: ChannelFlow) -> tuple[ChannelRecord, float]:
    """The channel with one kind of fluid, and seconds a step."""
    steps = RECORDS * 10
    start = time.perf_counter()
    run = wp.move(fluid, flow, until=UNTIL, dt=UNTIL / steps, every=10)
    return run.details, (time.perf_counter() - start) / steps


def channel_study(count: int, seed: int) -> tuple[dict[str, Any], dict[str, ChannelRecord], Band]:
    """Learned, exact and coupled fluids in one channel, and the band around the learned one."""
    flow = ChannelFlow(DE)
    n = Particles(flow).fluid
    law = replace(hookean_law(count, seed), provenance={"dumbbells": count, "seed": seed})
    wp.save(ROOT / "runs" / "polymer_flow" / "law.json", law)
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

    spread = band(law, centre, count=6, seed=seed)
    numbers["learned law"]["2 sd of the band at the centre"] = float(spread.half_width().max())
    return numbers, runs, spread


def fene_study(count: int, seed: int) -> dict[str, Any]:
    """Flows no fit saw: relative ℓ2 over time of s_xy and N1, learned spring and FENE-P."""
    t = (np.arange(60) + 0.5) * 0.1
    K = np.zeros((60, 5, 4))
    K[:, 0] = shear(np.where(t < 4, 3.0, 0.0))
    K[:, 1] = shear(5 * np.sin(t))
    K[:, 2] = np.multiply.outer(t < 4, [1.0, 2.0, 0.3, -1.0])
    K[:, 3] = elongation(np.where(t < 4, 1.5, 0.0))
    K[:, 4] = np.where(t[:, None] < 3, shear(6.0), elongation(1.0))
    names = ["shear 3, then rest", "oscillating shear", "mixed, then rest", "elongation 1.5"]
    names.append("shear 6, then elongation 1")
    truth = simulate(Dumbbells(5, 4 * count, b=B, seed=seed + 50), K, 0.1, steps=5).stress
    numbers = {}
    learned = fene_law(count, seed)
    for law in (learned.spring_law, learned, FENEP(B)):
        C = homogeneous(law, K, 0.1)
        s = np.asarray(law.stress(C.reshape(-1, C.shape[-1]))).reshape(*C.shape[:2], 4)
        first = s[..., 0] - s[..., 2], truth[..., 0] - truth[..., 2]
        numbers[law.name] = {
            name: {
                "s_xy": relative(s[:, i, 1], truth[:, i, 1]) if i != 3 else None,
                "N1": relative(first[0][:, i], first[1][:, i]),
            }
            for i, name in enumerate(names)
        }
    return numbers


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
    for name, row in numbers["channel"].items():
        error = row["against the exact law in the same scheme"]
        channels.append([name, f"{error:.2f}", f"{1e3 * row['seconds a step']:.2f}"])
    flows = [
        [name, law, "–" if row["s_xy"] is None else f"{row['s_xy']:.1f}", f"{row['N1']:.1f}"]
        for law, rows in numbers["fene"].items()
        for name, row in rows.items()
    ]
    both = prose.table(["fluid", "error %", "ms a step"], channels) + "\n\n"
    return both + prose.table(["FENE, flow no fit saw", "law", "s_xy %", "N1 %"], flows) + "\n"


def main(arguments: list[str] | None = None) -> None:
    parser = Options(__doc__, json=True)
    parser.add("--dumbbells", type=int, default=10_000, help="in each Hookean run")
    parser.add("--fene", type=int, default=4000, help="in each FENE run")
    parser.add("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    folder = ROOT / "runs" / "polymer_flow"
    start = time.perf_counter()
    rows, runs, spread = channel_study(options.dumbbells, options.seed)
    numbers: dict[str, Any] = {"channel": rows, "fene": fene_study(options.fene, options.seed)}
    numbers["sizes"] = {"Hookean": 22 * options.dumbbells, "FENE": 9 * options.fene}
    numbers["seconds"] = time.perf_counter() - start
    folder.mkdir(parents=True, exist_ok=True)
    draw(runs, spread, folder)
    write_json(folder / "numbers.json", numbers)
    write_text(folder / "table.md", table(numbers))
    print(json.dumps(plain(numbers), indent=2) if options.json else table(numbers))


if __name__ == "__main__":
    sys.exit(exit_status(main))
