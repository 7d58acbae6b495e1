"""What the page on polymer flow by Gaussian processes shows: see papers.py."""

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import torch

from examples.exact import poiseuille
from examples.polymer import (
    ChannelFlow,
    ChannelRecord,
    Closure,
    CoupledDumbbells,
    Dumbbells,
    Ensembles,
    PlaneFlow,
    RateLaw,
    ShearLaw,
    elongation,
    held,
    homogeneous,
    learn_rate,
    shear,
    simulate,
    start_pairs,
)
from examples.polymer.closure import Stress, exact_pairs, reached, window_pairs
from examples.polymer.gaussian_process import JITTER
from examples.polymer.laws import IDENTITY
from examples.polymer.learn import relative
from examples.polymer.particles import Particles, run_channel
from examples.polymer.plane import run_plane
from examples.prose import NUMBER, cells_of, rows_of
from examples.studies import paper_polymer_pictures as pictures
from examples.studies import paper_polymer_walls as walls
from examples.studies.paper_polymer_pictures import COUNTS, HEIGHTS, LAWS, RECIPES, TRAINING
from examples.studies.polymer_tables import MAXWELL, SEEDS, known_shear, printed_shear, shear_record
from warp_peri import InputError

NEEDED: dict[str, str] = {}
TEMPLATE = Path(__file__).with_suffix(".md")
CELLS, RE = 128, 10.0
UNTIL = {1.0: 20.0, 10.0: 60.0}
"""End of the start-up between plates by De."""
MOST = (150.0, 40.0)
"""Largest |κ| of the training flows, shear and elongation [1/t0]. Printed is 150 for both, which
Hookean dumbbells do not bear in elongation at De 1e-2: they stretch without end beyond De ε = ½."""
RANGES = ((20.0, 20.0), (60.0, 40.0), MOST, (150.0, 150.0))
"""Of shear and elongation, by which the laws of the channel are compared."""
END, STEPS = 0.03, 500
STEP = 1e-6
"""Of time, as printed (Table 1)."""


def parts(runs: Path, kept: Callable[..., Any], figures: Path) -> dict[str, Callable[[], str]]:
    """The parts of the page, by the names that its template gives them."""
    del runs

    def figure_4() -> str:
        law = kept("law_at_10", law_at_10)
        pictures.draw_law(figures / "polymer_law.png", law)
        return rows_of([name, *map(spread, law[name]["errors"])] for name in LAWS)

    def figure_5() -> str:
        fluids = product((*LAWS, "coupled"), COUNTS)
        plates = {
            (De, *fluid): kept(
                f"plates_{De:g}_{fluid[0].split()[0]}_{fluid[1]}", partial(plate, De, *fluid)
            )
            for De, fluid in product(UNTIL, fluids)
        }
        pictures.draw_stress(figures / "polymer_stress.png", plates)
        return rows_of(plate_rows(plates))

    def oscillating() -> str:
        found = kept("oscillating", oscillating_plate)
        return rows_of([name, spread(errors)] for name, errors in found.items())

    def figures_6_and_9() -> str:
        fits = {n: kept(f"training_{n}", partial(training, n)) for n in TRAINING}
        pictures.draw_rates(figures / "polymer_rates.png", fits)
        return rows_of(training_rows(fits))

    def ranges() -> str:
        found = {
            most: kept(f"range_{most[0]:g}_{most[1]:g}", partial(by_range, *most))
            for most in RANGES
        }
        return rows_of(range_rows(found))

    def figure_7() -> str:
        found = {De: kept(f"channel_{De:g}", partial(channel_at, De)) for De in (1e-3, 2e-3, 1e-2)}
        pictures.draw_channel(figures / "polymer_channel.png", found)
        return rows_of(channel_rows(found))

    def runs_of_channel(rows: Callable[[Any], Any]) -> str:
        costs = {n: kept(f"cost_{n}", partial(whole_run, n)) for n in fluids_of_channel()}
        pictures.draw_forces(figures / "polymer_forces.png", costs)
        pictures.draw_costs(figures / "polymer_costs.png", costs)
        return rows_of(rows(costs))

    return {
        "law": figure_4,
        "plates": figure_5,
        "oscillating": oscillating,
        "training": figures_6_and_9,
        "ranges": ranges,
        "channel": figure_7,
        "steps": lambda: rows_of(kept("steps", printed_step)),
        "forces": lambda: runs_of_channel(force_rows),
        "costs": lambda: runs_of_channel(cost_rows),
        "nuts": lambda: rows_of(kept("nuts", nuts)["rows"]),
        "walls": lambda: rows_of(map(walls.row_of, kept("walls", walls.study))),
    }


def redraw(page: str, figures: Path) -> None:
    """Figures 5 and 9, and what a run costs, from the tables of the page."""
    plates: dict[str, dict[str, Any]] = {}
    for De, name in product(UNTIL, (*LAWS, "coupled")):
        (row,) = cells_of(page, "Figure 5", f"| {De:g} | {name} |")
        cells = [[float(n) for n in NUMBER.findall(cell)[:-1]] for cell in row]
        plates.setdefault(f"{De:g}", {})[name] = cells
    pictures.draw_plates(figures / "polymer_plates.png", plates)
    training = {}
    for name in RECIPES:
        rows = cells_of(page, "Figures 6 and 9", f"| {name} |")
        ended = {int(points): u for points, _, _, u, *_ in rows if NUMBER.match(u)}
        training[name] = {points: float(u) for points, u in ended.items()}
    pictures.draw_training(figures / "polymer_training.png", training)
    costs = {}
    for name in fluids_of_channel():
        (row,) = cells_of(page, "What a run costs", f"| {name.replace('law', 'model')} |")
        costs[name] = dict(zip(("learned", "seconds", "error"), map(float, row)))
    pictures.draw_costs(figures / "polymer_costs.png", costs)


def numbers(values: Iterable[float]) -> list[str]:
    """Two digits each."""
    return [f"{value:.2g}" for value in values]


# Shear between plates: two inputs


def shear_law(name: str, De: float, count: int, seed: int) -> ShearLaw:
    """Learned as printed, or with what shear does to any stress known."""
    record = shear_record(De, count, seed)
    return printed_shear(record, seed) if name == LAWS[0] else known_shear(record)


def law_at_10() -> dict[str, Any]:
    """Figure 4: rates of the first law of each kind, and errors of five in % of the rms rate."""
    K, S = np.meshgrid(np.linspace(-1500, 1500, 41), np.linspace(-1500, 1500, 41))
    C, gradient = np.zeros((K.size, 4)) + IDENTITY, shear(K.ravel())
    C[:, 1] = S.ravel()
    exact = K.ravel() - S.ravel()
    found: dict[str, Any] = {"s": S[:, 0], "K": K[0], "exact": exact.reshape(K.shape)}
    inside = np.abs(S.ravel()) <= np.abs(K.ravel())  # what shear from rest passes: 0 … K
    inside &= S.ravel() * K.ravel() >= 0
    for name in LAWS:
        laws = [shear_law(name, 10.0, 10_000, seed) for seed in SEEDS]
        rates = np.array([law.rate(gradient, C)[:, 1] for law in laws])
        off, size = rates - exact, np.sqrt(np.mean(exact**2))
        parts = (off[:, part] for part in (inside, ~inside))
        errors = [100 * np.sqrt(np.mean(part**2, axis=1)) / size for part in parts]
        first = {"rate": rates[0].reshape(K.shape), "X": laws[0].process.X}
        found[name] = first | {"errors": np.array(errors)}
    return found


def fluids_between_plates(
    name: str, De: float, count: int, seeds: Sequence[int] = SEEDS
) -> Iterator[Stress]:
    """Laws that are learned, or dumbbells in every cell, by seeds."""
    for seed in seeds:
        if name == "coupled":
            yield CoupledDumbbells(Dumbbells(CELLS, count, seed=5 + seed), De)
        else:
            yield Closure(shear_law(name, De, count, seed), De, CELLS)


def plate(De: float, fluid: str, count: int) -> dict[str, Any]:
    """Start-up: largest error of u over the gap by seed and time, σ_xy at five heights of one."""
    flow = PlaneFlow(De, RE, CELLS, top=lambda t: 1.0)
    dt = 0.01 * De**0.5

    def run(stress: Stress) -> Any:
        return run_plane(flow, stress, until=UNTIL[De], dt=dt, every=20)

    exact = run(Closure(MAXWELL, De, CELLS))
    seeds = SEEDS[:1] if fluid == "coupled" and count > COUNTS[0] else SEEDS  # takes minutes
    runs = [run(each) for each in fluids_between_plates(fluid, De, count, seeds)]
    cells = np.linspace(0, CELLS - 1, 5).astype(int)
    return {
        "t": exact.t,
        "error": [np.abs(now.u - exact.u).max(axis=1) for now in runs],
        "stress": runs[0].stress[:, cells, 1],
        "exact": exact.stress[:, cells, 1],
    }


def plate_rows(plates: Mapping[tuple[Any, ...], Mapping[str, Any]]) -> list[list[str]]:
    """Largest error over time and that at the end, by fluid and number of dumbbells."""
    rows = []
    for De, name in product(UNTIL, (*LAWS, "coupled")):
        runs = [np.array(plates[De, name, n]["error"]) for n in COUNTS]
        cells = (f"{spread(e.max(axis=1))}, {np.median(e[:, -1]):.1e}" for e in runs)
        rows.append([f"{De:g}", name, *cells])
    return rows


def spread(values: Iterable[float]) -> str:
    """Median, with the least and the largest where there are several."""
    some = np.array(list(values))
    ends = f" ({some.min():.2g} to {some.max():.2g})" if len(some) > 1 else ""
    return f"{np.median(some):.2g}{ends}"


def oscillating_plate() -> dict[str, list[float]]:
    """A wall that swings with the period of six relaxation times, De 1; relative errors of u."""
    flow = PlaneFlow(1.0, RE, CELLS, top=np.sin)

    def run(stress: Stress) -> np.ndarray:
        return run_plane(flow, stress, until=20.0, dt=0.01, every=20).u

    exact = run(Closure(MAXWELL, 1.0, CELLS))
    return {
        name: [relative(run(fluid), exact) for fluid in fluids_between_plates(name, 1.0, 10_000)]
        for name in (*LAWS, "coupled")
    }


# The channel: seven inputs


def gradients(De: float = 1e-2, most: tuple[float, float] = MOST) -> np.ndarray:
    """Eleven gradients each along three components, held for ten relaxation times.

    `most` is the largest shear and elongation [1/t0]; what comes back is per relaxation time.
    """
    rates = De * np.linspace(-1, 1, 11)
    along = most[0] * shear(rates)
    return held(np.concatenate([most[1] * elongation(rates), along, along[:, [0, 2, 1, 3]]]), 200)


@cache
def channel_record(count: int, seed: int = 0, most: tuple[float, float] = MOST) -> Ensembles:
    """Dumbbells under these gradients."""
    K = gradients(most=most)
    return simulate(Dumbbells(K.shape[1], count, seed=seed), K, 0.05)


def exact_law(n: int, kinematics: bool = True, De: float = 1e-2) -> RateLaw:
    """Learned from n exact rates of the Maxwell fluid under these gradients (no noise)."""
    K = gradients(De)
    C = homogeneous(MAXWELL, K, 0.05)[: len(K)]
    pairs = exact_pairs(MAXWELL, K.reshape(-1, 4), C.reshape(-1, 4))
    chosen = pairs.choose(n, np.random.default_rng(0))
    return learn_rate(chosen, kinematics=kinematics, outside="allow")


def channel_law(
    name: str, n: int = 1000, seed: int = 0, most: tuple[float, float] = MOST
) -> RateLaw:
    """Learned from n random windows of 10⁵ dumbbells, paired as printed or with the start."""
    printed = name == RECIPES[0]
    pairs = (window_pairs if printed else start_pairs)(channel_record(100_000, seed, most), 1)
    chosen = pairs.choose(n, np.random.default_rng(seed))
    return learn_rate(chosen, kinematics=not printed, outside="allow")


def flow_of(law: Any, De: float = 1e-2, until: float = END, steps: int = STEPS) -> ChannelRecord:
    """The channel with a law, in its tables where it has some."""
    flow = ChannelFlow(De)
    law = law.tabulated() if hasattr(law, "tabulated") else law
    fluid = Closure(law, De, Particles(flow).fluid, check_every=10**9)
    return run_channel(flow, fluid, until=until, dt=until / steps, every=max(1, steps // 50))


def error_in_channel(law: Any, exact: ChannelRecord) -> tuple[float | None, list[float] | None]:
    """Relative error of v, and the largest of u/U over time; None where the flow runs away."""
    try:
        v = flow_of(law).v
    except InputError:  # a stress or a velocity that is not finite
        return None, None
    return relative(v, exact.v), np.abs(v - exact.v).max(axis=(1, 2)).tolist()


def training(n: int) -> dict[str, Any]:
    """Figures 6 and 9: laws of n points, their rates on states of the flow, and errors of u."""
    K, C = reached(MAXWELL, 400, 1e-2 * MOST[1], seed=9)  # mixed flows, which no recipe saw
    truth, exact = MAXWELL.rate(K, C), flow_of(MAXWELL)
    learners = {
        **{name: partial(channel_law, name, n) for name in RECIPES[:2]},
        RECIPES[2]: partial(exact_law, n, kinematics=False),
        RECIPES[3]: partial(exact_law, n),
    }
    channel_record(100_000)  # is no part of the seconds of a fit
    found: dict[str, Any] = {"t": exact.t, "truth": truth[:, :2]}
    for name, learner in learners.items():
        start = time.process_time()
        law = learner()
        law.rate(K[:1], C[:1])  # weights are computed when they are asked for
        seconds = time.process_time() - start
        error, over_time = error_in_channel(law, exact)
        rate = law.rate(K, C)[:, :2]
        found[name] = {"rate": rate, "error": over_time, "relative": error, "seconds": seconds}
    return found


def training_rows(fits: Mapping[int, Mapping[str, Any]]) -> list[list[str]]:
    """Errors of rates and of u, and seconds of a fit, by number of training points."""
    rows = []
    for name in RECIPES:
        for n, fit in fits.items():
            truth, row = np.array(fit["truth"]), fit[name]
            cells = numbers(relative(np.array(row["rate"])[:, i], truth[:, i]) for i in (0, 1))
            if row["error"] is None:
                cells += ["runs away", "–"]
            else:
                cells += numbers([max(row["error"]), row["relative"]])
            rows.append([name, f"{n}", *cells, f"{row['seconds']:.0f}"])
    return rows


def by_range(shear_most: float, elongation_most: float) -> dict[str, list[float | None]]:
    """Errors of v by recipe, 1000 points of training flows up to these gradients.

    Three seeds, and one where dumbbells stretch without end.
    """
    exact, most = flow_of(MAXWELL), (shear_most, elongation_most)
    seeds = range(3 if 1e-2 * elongation_most < 0.5 else 1)
    return {
        name: [error_in_channel(channel_law(name, 1000, n, most), exact)[0] for n in seeds]
        for name in RECIPES[:2]
    }


def range_rows(found: Mapping[tuple[float, float], Mapping[str, Any]]) -> list[list[str]]:
    """Errors of v by range and recipe, and how many runs went away."""
    rows = []
    for most, errors in found.items():
        cells = []
        for name in RECIPES[:2]:
            ended = [error for error in errors[name] if error is not None]
            lost = len(errors[name]) - len(ended)
            away = f"{lost} of {len(errors[name])} run away" if lost else ""
            cells.append(", ".join(filter(None, [spread(ended) if ended else "", away])))
        rows.append([f"{most[0]:g}", f"{most[1]:g}", *cells])
    return rows


def channel_at(De: float) -> dict[str, Any]:
    """Figure 7: u in the middle over time, exact flow, exact law, law learned from exact rates."""
    until = 0.1
    steps = int(np.ceil(until / (0.5 * ChannelFlow(De).longest_step) / 50)) * 50
    runs = {
        "law": flow_of(MAXWELL, De, until, steps),
        "learned": flow_of(exact_law(1000, De=De), De, until, steps),
    }
    t, flow = runs["law"].t, ChannelFlow(De)
    exact = poiseuille(np.array([0.5]), t, De, flow.Re, flow.force)[:, 0]
    newton = poiseuille(np.array([0.5]), t, 1e-7, flow.Re, flow.force)[:, 0]
    return {
        "t": t,
        "exact": exact,
        "newton": newton,
        "centre": {name: run.centre() for name, run in runs.items()},
        "relative": relative(runs["learned"].v, runs["law"].v),
    }


def printed_step() -> list[list[str]]:
    """Table 1: the channel of De 1e-2 with the printed step and with ours, exact law."""
    flow, rows = ChannelFlow(1e-2), []
    runs = {STEP: flow_of(MAXWELL, 1e-2, END, round(END / STEP)).v}
    for share in (0.5, 0.25):
        steps = int(np.ceil(END / (share * flow.longest_step) / 50)) * 50
        runs[END / steps] = flow_of(MAXWELL, 1e-2, END, steps).v
    for dt, v in runs.items():
        rows.append([f"{dt:.1e}", f"{END / dt:.0f}", f"{relative(v, runs[STEP]):.2g}"])
    return rows


def channel_rows(channels: Mapping[float, Mapping[str, Any]]) -> list[list[str]]:
    """Highest and lowest u over that of the end, and errors."""
    rows = []
    for De, found in channels.items():
        exact, law = np.array(found["exact"]), np.array(found["centre"]["law"])
        steady = 12 / 8
        extremes = [f"{exact.max() / steady:.2f}", f"{exact.min() / steady:.2f}"]
        rows.append([f"{De:g}", *extremes, *numbers([relative(law, exact), found["relative"]])])
    return rows


def fluids_of_channel() -> tuple[str, ...]:
    """Whole runs that are compared."""
    return (
        "exact law",
        "learned, exact rates",
        "learned, 100000 dumbbells",
        *(f"coupled, {n} dumbbells" for n in COUNTS),
    )


def whole_run(name: str) -> dict[str, Any]:
    """A run of the channel, De 1e-2: processor seconds, error of v, forces at three heights."""
    flow = ChannelFlow(1e-2)
    exact = flow_of(MAXWELL)
    start = time.process_time()
    learned = 0.0
    if name.startswith("coupled"):
        n = int(name.split()[1])
        fluid = CoupledDumbbells(Dumbbells(Particles(flow).fluid, n, common=True, seed=0), flow.De)
        run = run_channel(flow, fluid, until=END, dt=END / STEPS, every=STEPS // 50)
    else:
        law: Any = MAXWELL
        if name == "learned, exact rates":
            law = exact_law(1000)
        elif name != "exact law":
            law = channel_law(RECIPES[1])
        learned = time.process_time() - start
        run = flow_of(law)
    seconds = time.process_time() - start - learned
    return {
        "t": run.t,
        "seconds": seconds,
        "learned": learned,
        "error": relative(run.v, exact.v),
        "force": forces(run, flow),
    }


def forces(run: ChannelRecord, flow: ChannelFlow) -> np.ndarray:
    """∂σ_xy/∂y at the heights, shape [T, heights], from σ of particles in thirty bins."""
    bins = flow.across
    stress = replace(run, v=run.sigma[..., [1, 1]])
    y, s = stress.profile(bins)
    slope = np.gradient(s, y, axis=1)
    return np.array([[np.interp(h, y, row) for h in HEIGHTS] for row in slope])


def force_rows(costs: Mapping[str, Mapping[str, Any]]) -> list[list[str]]:
    """Relative errors of the force at each height."""
    exact = np.array(costs["exact law"]["force"])
    rows = []
    for name, run in costs.items():
        if name != "exact law":
            found = np.array(run["force"])
            rows.append([name, *numbers(relative(a, b) for a, b in zip(found.T, exact.T))])
    return rows


def cost_rows(costs: Mapping[str, Mapping[str, Any]]) -> list[list[str]]:
    """Seconds to learn and to run, and error of v."""
    numbers = {"learned": ".1f", "seconds": ".1f", "error": ".2g"}
    return [
        [name.replace("law", "model"), *(f"{run[key]:{form}}" for key, form in numbers.items())]
        for name, run in costs.items()
    ]


# Averaging over hyperparameters


def nuts(draws: int = 300) -> dict[str, Any]:
    """Means of the posterior over Γ, l₁, l₂ by the No-U-Turn sampler beside the optimum (De 10)."""
    from pyro.infer.mcmc import MCMC, NUTS

    optimum = shear_law(LAWS[0], 10.0, 1000, 0)
    process = optimum.process
    Z = torch.from_numpy((process.X - process.centre) / process.scale)
    f = torch.from_numpy((process.y - process.mean) / process.size)
    noise = torch.from_numpy(process.noise / process.size**2)

    def potential(at: dict[str, torch.Tensor]) -> torch.Tensor:
        """−log posterior; a prior 1/Θ is constant in log Θ, here within exp(± 5)."""
        theta = at["log"]
        lengths = Z / torch.exp(theta[1:])
        K = torch.exp(2 * theta[0] - 0.5 * torch.cdist(lengths, lengths) ** 2)
        L = torch.linalg.cholesky(K + torch.diag(noise + (JITTER + 1e-8) * torch.exp(2 * theta[0])))
        a = torch.linalg.solve_triangular(L, f[:, None], upper=False)
        outside = torch.relu(theta.abs() - 5).square().sum()
        return 0.5 * (a**2).sum() + torch.log(torch.diagonal(L)).sum() + 50 * outside

    begin = torch.tensor([process.log_amplitude, *process.log_lengths]).clamp(-4, 4)
    sampler = MCMC(
        NUTS(potential_fn=potential),
        draws,
        warmup_steps=draws,
        initial_params={"log": begin},
        disable_progbar=True,
    )
    start = time.process_time()
    torch.manual_seed(0)
    sampler.run()
    seconds = time.process_time() - start
    mean = torch.exp(sampler.get_samples()["log"]).mean(dim=0).log().numpy()
    averaged = replace(process, log_amplitude=float(mean[0]), log_lengths=mean[1:])
    flow = PlaneFlow(10.0, RE, CELLS, top=lambda t: 1.0)

    def run(law: Any) -> np.ndarray:
        return run_plane(flow, Closure(law, 10.0, CELLS), until=60.0, dt=0.03, every=20).u

    exact, rows = run(MAXWELL), []
    for name, found in {"optimum": process, "mean by NUTS": averaged}.items():
        theta = np.exp([found.log_amplitude, *found.log_lengths])
        error = np.abs(run(ShearLaw(found, False, outside="allow")) - exact).max()
        rows.append([name, *numbers(theta), f"{error:.2g}"])
    return {"rows": rows, "seconds": seconds, "draws": draws}
