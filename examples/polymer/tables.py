"""The paper on polymer flow, computed: every table of the page on it, printed as Markdown.

    python examples/polymer/tables.py law plates      (default: every table)

Laws take seconds, flows minutes, coupled runs of 10⁵ dumbbells some ten minutes.
docs/record/polymer.json has what came out.
"""

import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import cache, partial
from itertools import product
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.spatial import cKDTree

from examples.exact import poiseuille as exact_flow
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
    UpperConvectedMaxwell,
    elongation,
    held,
    homogeneous,
    learn_rate,
    learn_shear,
    shear,
    simulate,
    start_pairs,
)
from examples.polymer.closure import Stress, exact_pairs, reached, window_pairs
from examples.polymer.gaussian_process import fit_process
from examples.polymer.laws import IDENTITY
from examples.polymer.particles import Particles, run_channel
from examples.polymer.plane import run_plane
from examples.prose import Table, print_tables
from warp_peri import InputError
from warp_peri.errors import exit_status

MAXWELL = UpperConvectedMaxwell()
SEEDS, COUNTS, TRAINING = range(5), (1000, 10_000, 100_000), (1000, 3000, 6000)
"""Seeds; dumbbells in an ensemble; training points."""
LAWS = ("printed recipe", "kinematics known")
RECIPES = (
    "printed pairing", "kinematics known", "exact rates, printed form",
    "exact rates, kinematics known",
)  # fmt: skip
HEIGHTS = (0.1, 0.25, 0.5)
FILTER, WINDOW = 5e-3, 0.05
"""Relaxation times: deviation of the filter of the stress, as printed; a window of increments."""
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
PERIOD, FORCE = 0.6, 12.0
SMOOTHING, REACH = 1.5, 3.0
"""Length of the Gaussian in spacings, and its cut in lengths, as printed."""
ACROSS, SHIFTS = (15, 30, 60), (0.0, 0.2)
"""Particles from wall to wall, and how far each is shifted, in spacings."""


def relative(value: np.ndarray, truth: np.ndarray) -> float:
    """Relative ℓ2 error in %."""
    return float(100 * np.linalg.norm(value - truth) / np.linalg.norm(truth))


def numbers(values: Iterable[float]) -> list[str]:
    """Two digits each."""
    return [f"{value:.2g}" for value in values]


def spread(values: Iterable[float]) -> str:
    """Median, with the least and the largest where there are several."""
    some = np.array(list(values))
    ends = f" ({some.min():.2g} to {some.max():.2g})" if len(some) > 1 else ""
    return f"{np.median(some):.2g}{ends}"


# Shear between plates: two inputs


@cache
def shear_record(De: float, count: int, seed: int = 0) -> Ensembles:
    """Nine rates up to 150, as printed, held for five relaxation times, in steps of 0.001."""
    rates = held(De * shear(np.linspace(-150, 150, 9)), 5000)
    return simulate(Dumbbells(9, count, seed=seed), rates, 1e-3)


def known_shear(record: Ensembles, kinematics: bool = True) -> ShearLaw:
    """A law of increments over a window, each with the stress at its start."""
    window = round(WINDOW / record.interval)
    return learn_shear(record, window=window, kinematics=kinematics, outside="allow")


def printed_shear(record: Ensembles, seed: int) -> ShearLaw:
    """The printed recipe of shear: Gaussian filter, differences of a step, ten random bins a rate.

    The variance of the rates in a bin is its noise.
    """
    random, X, y, noise = np.random.default_rng(seed), [], [], []
    for i in range(record.K.shape[1]):
        s = gaussian_filter1d(record.stress[:, i, 1], FILTER / record.interval, mode="nearest")
        rate, s = np.diff(s) / record.interval, s[1:]
        span = np.ptp(s) / 10
        for low in random.uniform(s.min(), s.max() - span, 10):
            inside = (s >= low) & (s <= low + span)
            if inside.sum() > 1:
                X.append((s[inside].mean(), record.K[0, i, 1]))
                y.append(rate[inside].mean())
                noise.append(max(rate[inside].var(), 1e-9))
    process = fit_process(np.array(X), np.array(y), noise=np.array(noise), mean=0.0)
    return ShearLaw((process,), False, "allow")


def shear_law(name: str, De: float, count: int, seed: int) -> ShearLaw:
    """Learned as printed, or with what shear does to any stress known."""
    record = shear_record(De, count, seed)
    return printed_shear(record, seed) if name == LAWS[0] else known_shear(record)


def law() -> Table:
    """Figure 4, De 10: error of the rate [%] where shear from rest passes, and elsewhere."""
    K, S = np.meshgrid(np.linspace(-1500, 1500, 41), np.linspace(-1500, 1500, 41))
    C, gradient = np.zeros((K.size, 4)) + IDENTITY, shear(K.ravel())
    C[:, 1] = S.ravel()
    exact = K.ravel() - S.ravel()
    inside = np.abs(S.ravel()) <= np.abs(K.ravel())  # what shear from rest passes: 0 … K
    inside &= S.ravel() * K.ravel() >= 0
    rows = []
    for name in LAWS:
        learned = [shear_law(name, 10.0, 10_000, seed) for seed in SEEDS]
        off = np.array([one.rate(gradient, C)[:, 1] for one in learned]) - exact
        size = np.sqrt(np.mean(exact**2))
        parts = (off[:, part] for part in (inside, ~inside))
        rows.append([name, *(spread(100 * (p**2).mean(axis=1) ** 0.5 / size) for p in parts)])
    return ["law", "on the way", "elsewhere"], rows


def fluids_between_plates(
    name: str, De: float, count: int, seeds: Sequence[int] = SEEDS
) -> Iterator[Stress]:
    """Laws that are learned, or dumbbells in every cell, by seeds."""
    for seed in seeds:
        if name == "coupled":
            yield CoupledDumbbells(Dumbbells(CELLS, count, seed=5 + seed), De)
        else:
            yield Closure(shear_law(name, De, count, seed), De, CELLS)


def plate_errors(De: float, fluid: str, count: int) -> np.ndarray:
    """Start-up between plates: largest error of u over the gap by seed and time, [S, T]."""
    flow = PlaneFlow(De, RE, CELLS, top=lambda t: 1.0)
    dt = 0.01 * De**0.5

    def run(stress: Stress) -> np.ndarray:
        return run_plane(flow, stress, until=UNTIL[De], dt=dt, every=20).u

    exact = run(Closure(MAXWELL, De, CELLS))
    seeds = SEEDS[:1] if fluid == "coupled" and count > COUNTS[0] else SEEDS  # takes minutes
    runs = (run(each) for each in fluids_between_plates(fluid, De, count, seeds))
    return np.array([np.abs(u - exact).max(axis=1) for u in runs])


def plates() -> Table:
    """Figure 5: largest error of u/U over time, median of seeds (ends), and the median at last."""
    rows = []
    for De, name in product(UNTIL, (*LAWS, "coupled")):
        runs = [plate_errors(De, name, n) for n in COUNTS]
        cells = (f"{spread(e.max(axis=1))}, {np.median(e[:, -1]):.1e}" for e in runs)
        rows.append([f"{De:g}", name, *cells])
    return ["De", "fluid", *map(str, COUNTS)], rows


def oscillating() -> Table:
    """A wall that swings, De 1: relative errors of u [%]."""
    flow = PlaneFlow(1.0, RE, CELLS, top=np.sin)

    def run(stress: Stress) -> np.ndarray:
        return run_plane(flow, stress, until=20.0, dt=0.01, every=20).u

    exact, rows = run(Closure(MAXWELL, 1.0, CELLS)), []
    for name in (*LAWS, "coupled"):
        fluids = fluids_between_plates(name, 1.0, 10_000)
        rows.append([name, spread(relative(run(fluid), exact) for fluid in fluids)])
    return ["fluid", "error"], rows


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


def training() -> Table:
    """Figures 6 and 9: errors of rates, of u and v, and seconds of a fit, by training points."""
    K, C = reached(MAXWELL, 400, 1e-2 * MOST[1], seed=9)  # mixed flows, which no recipe saw
    truth, exact = MAXWELL.rate(K, C)[:, :2], flow_of(MAXWELL)
    channel_record(100_000)  # is no part of the seconds of a fit
    rows = []
    for name, n in product(RECIPES, TRAINING):
        start = time.process_time()
        if name in RECIPES[:2]:
            learned = channel_law(name, n)
        else:
            learned = exact_law(n, kinematics=name == RECIPES[3])
        rate = learned.rate(K, C)[:, :2]
        seconds = time.process_time() - start
        v, u = error_in_channel(learned, exact)
        cells = numbers(relative(rate[:, i], truth[:, i]) for i in (0, 1))
        cells += ["runs away", "–"] if v is None or u is None else numbers([max(u), v])
        rows.append([name, f"{n}", *cells, f"{seconds:.0f}"])
    return ["recipe", "points", "rate xx", "rate xy", "u", "v", "seconds"], rows


def ranges() -> Table:
    """Errors of v by the range of training and recipe, and how many runs went away."""
    exact, rows = flow_of(MAXWELL), []
    for most in RANGES:
        seeds, cells = range(3 if 1e-2 * most[1] < 0.5 else 1), []
        for name in RECIPES[:2]:
            errors = [error_in_channel(channel_law(name, 1000, n, most), exact)[0] for n in seeds]
            ended = [error for error in errors if error is not None]
            lost = len(errors) - len(ended)
            away = f"{lost} of {len(errors)} run away" if lost else ""
            cells.append(", ".join(filter(None, [spread(ended) if ended else "", away])))
        rows.append([f"{most[0]:g}", f"{most[1]:g}", *cells])
    return ["shear", "elongation", *RECIPES[:2]], rows


def channel() -> Table:
    """Figure 7: highest and lowest u in the middle over the last one, and errors [%]."""
    rows, until = [], 0.1
    for De in (1e-3, 2e-3, 1e-2):
        flow = ChannelFlow(De)
        steps = int(np.ceil(until / (0.5 * flow.longest_step) / 50)) * 50
        own, learned = (flow_of(one, De, until, steps) for one in (MAXWELL, exact_law(1000, De=De)))
        exact = exact_flow(np.array([0.5]), own.t, De, flow.Re, flow.force)[:, 0]
        steady = FORCE / 8
        extremes = [f"{exact.max() / steady:.2f}", f"{exact.min() / steady:.2f}"]
        errors = numbers([relative(own.centre(), exact), relative(learned.v, own.v)])
        rows.append([f"{De:g}", *extremes, *errors])
    return ["De", "highest", "lowest", "particles", "learned"], rows


def steps() -> Table:
    """Table 1: the channel of De 0.01 with the printed step and with ours, exact law."""
    flow, runs = ChannelFlow(1e-2), {STEP: flow_of(MAXWELL, 1e-2, END, round(END / STEP)).v}
    for share in (0.5, 0.25):
        number = int(np.ceil(END / (share * flow.longest_step) / 50)) * 50
        runs[END / number] = flow_of(MAXWELL, 1e-2, END, number).v
    rows = [[f"{dt:.1e}", f"{END / dt:.0f}", *numbers([relative(v, runs[STEP])])]
            for dt, v in runs.items()]  # fmt: skip
    return ["step", "steps", "difference"], rows


FLUIDS = ("exact law", "learned, exact rates", "learned, 100000 dumbbells")


@cache
def whole_run(name: str) -> tuple[float, float, ChannelRecord]:
    """A run of the channel, De 0.01: processor seconds to learn and to run, and the run."""
    flow, start, learned = ChannelFlow(1e-2), time.process_time(), 0.0
    if name.startswith("coupled"):
        n = int(name.split()[1])
        fluid = CoupledDumbbells(Dumbbells(Particles(flow).fluid, n, common=True, seed=0), flow.De)
        run = run_channel(flow, fluid, until=END, dt=END / STEPS, every=STEPS // 50)
    else:
        make: dict[str, Callable[[], Any]] = {
            FLUIDS[0]: lambda: MAXWELL,
            FLUIDS[1]: partial(exact_law, 1000),
            FLUIDS[2]: partial(channel_law, RECIPES[1]),
        }
        law = make[name]()
        learned = time.process_time() - start
        run = flow_of(law)
    return learned, time.process_time() - start - learned, run


def every_run() -> dict[str, tuple[float, float, ChannelRecord]]:
    """All fluids of the channel."""
    return {n: whole_run(n) for n in (*FLUIDS, *(f"coupled, {n} dumbbells" for n in COUNTS))}


def forces() -> Table:
    """Figure 8: relative error [%] of ∂σ_xy/∂y at three heights, σ of particles in bins."""

    def slopes(run: ChannelRecord) -> np.ndarray:
        y, s = replace(run, v=run.sigma[..., [1, 1]]).profile(ChannelFlow(1e-2).across)
        slope = np.gradient(s, y, axis=1)
        return np.array([[np.interp(h, y, row) for h in HEIGHTS] for row in slope])

    found = {name: slopes(run) for name, (_, _, run) in every_run().items()}
    exact = found.pop(FLUIDS[0])
    rows = [[name, *numbers(relative(a, b) for a, b in zip(one.T, exact.T))]
            for name, one in found.items()]  # fmt: skip
    return ["fluid", *map(str, HEIGHTS)], rows


def costs() -> Table:
    """Seconds to learn and to run, and error of v [%]."""
    runs, rows = every_run(), []
    exact = runs[FLUIDS[0]][2].v
    for name, (learned, seconds, run) in runs.items():
        error = relative(run.v, exact)
        rows.append([name, f"{learned:.1f}", f"{seconds:.1f}", f"{error:.2g}"])
    return ["fluid", "learn", "run", "error"], rows


# Walls by MSPH as printed (Appendix A), and by images


def msph(x: np.ndarray, at: np.ndarray, h: float) -> np.ndarray:
    """The value and ∂xx + ∂yy at places from values at particles, (A11)–(A18): [2, P, N].

    Moments of the second Taylor expansion with W, ∇W and ∇∇W; equal volumes drop out.
    """
    matrix = np.zeros((2, len(at), len(x)))
    turned = np.column_stack([x[:, 0] % PERIOD, x[:, 1] + 2])  # a period has no room below zero
    places = np.column_stack([at[:, 0] % PERIOD, at[:, 1] + 2])
    near = cKDTree(turned, boxsize=(PERIOD, 8)).query_ball_point(places, REACH * h)
    for row, some in enumerate(near):
        a, b = (x[some] - at[row]).T
        a = a - PERIOD * np.rint(a / PERIOD)
        a, b = a / h, b / h
        W = np.exp(-(a**2) - b**2)
        tests = W * np.stack([1 + 0 * a, a, b, 2 * a**2 - 1, 2 * a * b, 2 * b**2 - 1])
        taylor = np.stack([1 + 0 * a, a, b, a**2 / 2, a * b, b**2 / 2])
        found = np.linalg.solve(tests @ taylor.T, tests)
        matrix[:, row, some] = found[0], (found[3] + found[5]) / h**2
    return matrix


def wall_particles(across: int, shift: float) -> tuple[np.ndarray, np.ndarray]:
    """Fluid particles, and the wall's on the lattice, as far as the Gaussian reaches."""
    b = 1 / across
    along = (np.arange(round(PERIOD * across)) + 0.5) * b
    moves = np.random.default_rng(0).uniform(-shift * b, shift * b, (len(along) * across, 2))
    fluid = np.array(list(product(along, (np.arange(across) + 0.5) * b))) + moves
    depth = (np.arange(int(np.ceil(REACH * SMOOTHING))) + 0.5) * b
    return fluid, np.array(list(product(along, np.concatenate([-depth, 1 + depth]))))


def mirrored(x: np.ndarray) -> np.ndarray:
    """About the nearer wall."""
    y = x[:, 1]
    return np.column_stack([x[:, 0], np.where(y < 0.5, -y, 2 - y)])


def steady_error(across: int, shift: float, walls: str) -> float:
    """Relative error of the steady velocity, −∇²u = F with no slip, in ℓ2."""
    h = SMOOTHING / across
    fluid, wall = wall_particles(across, shift)
    if walls == "images":
        edge = np.abs(fluid[:, 1] - 0.5) > 0.5 - REACH * h
        behind, of_fluid = mirrored(fluid[edge]), -np.eye(len(fluid))[edge]
    else:
        behind, of_fluid = wall, -msph(fluid, mirrored(wall), h)[0]
    second = msph(np.concatenate([fluid, behind]), fluid, h)[1]
    inside = second[:, : len(fluid)] + second[:, len(fluid) :] @ of_fluid
    u = np.linalg.solve(inside, np.full(len(fluid), -FORCE))
    y = fluid[:, 1]
    exact = FORCE / 2 * y * (1 - y)
    return float(np.linalg.norm(u - exact) / np.linalg.norm(exact))


def walls() -> Table:
    """Relative errors [%] by walls, shift of the particles [spacings] and particles across."""
    rows = []
    for kind, shift in product(("MSPH, as printed", "images"), (0.0, 0.2)):
        errors = [steady_error(n, shift, kind) for n in ACROSS]
        order = -np.polyfit(np.log(ACROSS), np.log(errors), 1)[0]
        rows.append([kind, f"{shift:g}", *(f"{100 * e:.2f}" for e in errors), f"{order:.1f}"])
    return ["walls", "shift", *map(str, ACROSS), "order"], rows


TABLES = (law, plates, oscillating, channel, ranges, steps, training, forces, costs, walls)

if __name__ == "__main__":
    sys.exit(exit_status(lambda: print_tables(__doc__, TABLES)))
