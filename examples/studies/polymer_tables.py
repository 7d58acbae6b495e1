"""The paper's tables of polymer flow, and what changes them: one study a name.

    python examples/studies/polymer_tables.py couette channel recipes speed fene --json

couette   plates, De 1 and 10, 10³ dumbbells, by pairing, five seeds, and the coupled simulation
channel   the scheme with the exact law against the exact flow, order, long times
recipes   the channel from noisy data, De 1e-2, by recipe and number of dumbbells
speed     one step of the channel by kind of fluid, in one run
fene      held-out flows and the plane channel of FENE dumbbells; closure error by replay
held_out  flows of FENE dumbbells that no fit saw, five sets of data
twins     what Hookean twins take off the variance of FENE stress
bands     what bands of start-up between plates hold, twelve sets of data
"""

import json
import sys
import time
import warnings
from functools import cache
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent.parent
sys.path.insert(0, str(ROOT))

import numpy as np
from scipy.ndimage import gaussian_filter1d

from examples.exact import poiseuille
from examples.polymer import (
    FENEP,
    ChannelFlow,
    ChannelRecord,
    Closure,
    CoupledDumbbells,
    Dumbbells,
    Ensembles,
    PlaneFlow,
    Profiles,
    ShearLaw,
    Twins,
    UpperConvectedMaxwell,
    elongation,
    held,
    learn_rate,
    learn_shear,
    shear,
    simulate,
    start_pairs,
)
from examples.polymer.active import corrected_run, missing_stress
from examples.polymer.closure import Stress, window_pairs
from examples.polymer.gaussian_process import fit_process
from examples.polymer.learn import fene_law, fene_study, hookean_law, relative
from examples.polymer.particles import Particles, run_channel
from examples.polymer.paths import band
from examples.polymer.plane import run_plane
from tools.options import Options
from warp_peri import InputError
from warp_peri.errors import exit_status
from warp_peri.files.atomic import plain, write_json
from warp_peri.launch import set_threads, threads

MAXWELL = UpperConvectedMaxwell()
SEEDS = range(5)
FILTER, WINDOW = 5e-3, 0.05
"""Relaxation times: deviation of the filter of the stress, as printed; a window of increments."""


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
    return ShearLaw(process, False, outside="allow")


def couette() -> dict[str, Any]:
    """Largest error of u against the exact law in the same scheme."""
    numbers: dict[str, Any] = {}
    for De, until in ((1.0, 20.0), (10.0, 60.0)):
        flow = PlaneFlow(De, 10.0, 128, top=lambda t: 1.0)
        dt = 0.01 * De**0.5

        def run(fluid: Any, flow: PlaneFlow = flow, until: float = until, dt: float = dt) -> Any:
            return run_plane(flow, fluid, until=until, dt=dt, every=20).u

        exact = run(Closure(MAXWELL, De, 128))
        errors: dict[str, list[float]] = {}
        for seed in SEEDS:
            record = shear_record(De, 1000, seed)
            laws = {
                "printed pairing": printed_shear(record, seed),
                "start pairing": known_shear(record, kinematics=False),
                "start pairing, kinematics known": known_shear(record),
            }
            for name, law in laws.items():
                error = float(np.abs(run(Closure(law, De, 128)) - exact).max())
                errors.setdefault(name, []).append(error)
        coupled = run(CoupledDumbbells(Dumbbells(128, 1000, seed=5), De))
        errors["coupled"] = [float(np.abs(coupled - exact).max())]
        numbers[f"De {De:g}"] = {
            name: {"errors": values, "median": float(np.median(values))}
            for name, values in errors.items()
        }
    return numbers


def exact_channel(flow: ChannelFlow, until: float, fraction: float = 0.5) -> dict[str, float]:
    """The scheme with the exact law against the exact flow."""
    steps = int(np.ceil(until / (fraction * flow.longest_step)))
    fluid = Closure(MAXWELL, flow.De, Particles(flow).fluid)
    run = run_channel(flow, fluid, until=until, dt=until / steps, every=max(1, steps // 100))
    truth = at_particles(flow, run)
    return {
        "error": relative(run.v[..., 0], truth),
        "error at the end": relative(run.v[-1, :, 0], truth[-1]),
        "density": float(np.abs(run.rho - 1).max()),
    }


def at_particles(flow: ChannelFlow, run: ChannelRecord) -> np.ndarray:
    """The exact u at the particles' own heights."""
    y = np.linspace(0, 1, 401)
    exact = poiseuille(y, run.t, flow.De, flow.Re, flow.force)
    return np.array([np.interp(x[:, 1], y, u) for x, u in zip(run.x, exact)])


def channel() -> dict[str, Any]:
    """Errors in %, the fitted order at De 1e-2, and what is left at t = 0.3."""
    numbers: dict[str, Any] = {"De 0.001": exact_channel(ChannelFlow(1e-3), 0.05)}
    sizes = (20, 30, 40)
    for smoothing in (1.5, 1.2):
        rows = {
            n: exact_channel(ChannelFlow(1e-2, across=n, smoothing=smoothing, length=1.0), 0.03)
            for n in sizes
        }
        errors = np.array([row["error"] for row in rows.values()])
        order = -np.polyfit(np.log(sizes), np.log(errors), 1)[0]
        numbers[f"De 0.01, smoothing {smoothing}"] = {"across": rows, "order": float(order)}
    for De in (1e-3, 1e-2):
        numbers[f"to t = 0.3, De {De:g}"] = exact_channel(ChannelFlow(De), 0.3, 0.9)
    return numbers


def printed_data(count: int, seed: int) -> Ensembles:
    """Eleven rates each of shear and elongation."""
    rates = np.linspace(-0.2, 0.2, 11)
    K = held(np.concatenate([elongation(rates), shear(rates)]), 200)
    return simulate(Dumbbells(22, count, seed=seed), K, 0.05)


def recipes(counts: tuple[int, ...] = (10_000, 100_000)) -> dict[str, Any]:
    """Relative error of v against the exact law in the same scheme, De 1e-2."""
    flow = ChannelFlow(1e-2)
    n = Particles(flow).fluid

    def run(law: Any) -> np.ndarray:
        fluid = Closure(law, flow.De, n, check_every=10**9)
        return run_channel(flow, fluid, until=0.03, dt=6e-5, every=10).v

    exact, numbers = run(MAXWELL), {}
    for count in counts:
        errors: dict[str, list[float]] = {}
        for seed in SEEDS if count < 50_000 else range(3):
            random, record = np.random.default_rng(seed), printed_data(count, seed)
            windows = window_pairs(record, 2).choose(1000, random)
            starts = start_pairs(record, 2).choose(1000, random)
            laws = {
                "printed": learn_rate(windows, kinematics=False, outside="allow"),
                "start pairing": learn_rate(starts, kinematics=False, outside="allow"),
                "start pairing, kinematics": learn_rate(starts, outside="allow"),
                "start pairing, kinematics, mixed flows": hookean_law(count, seed),
            }
            for name, law in laws.items():
                try:
                    error = relative(run(law.tabulated()), exact)
                except InputError:
                    error = 1e4  # the run blew up
                errors.setdefault(name, []).append(min(error, 1e4))
        numbers[f"{count} dumbbells"] = {
            name: {"errors": values, "median": float(np.median(values))}
            for name, values in errors.items()
        }
    return numbers


def speed(rounds: int = 5) -> dict[str, Any]:
    """Milliseconds of one processor a step of 540 particles, fluids in turn, median of rounds.

    Every fluid flows in a channel of its own, so that neighbours are looked for as often as they
    are in a run.
    """
    before = threads()
    set_threads(1)
    flow, dt = ChannelFlow(1e-2), 6e-5
    n, law = Particles(flow).fluid, hookean_law(2000, 0)
    fluids: dict[str, Stress] = {
        "exact law": Closure(MAXWELL, flow.De, n),
        "learned law, tables": Closure(law.tabulated(), flow.De, n),
        "learned law, sums": Closure(law, flow.De, n),
        "coupled 1000": CoupledDumbbells(Dumbbells(n, 1000, common=True), flow.De),
        "coupled 10000": CoupledDumbbells(Dumbbells(n, 10_000, common=True), flow.De),
        "coupled 100000": CoupledDumbbells(Dumbbells(n, 100_000, common=True), flow.De),
    }
    steps = dict.fromkeys(fluids, 10) | {"learned law, tables": 100, "coupled 100000": 1}
    particles = {name: Particles(flow) for name in fluids}
    spent: dict[str, list[float]] = {name: [] for name in fluids}
    for _ in range(rounds):
        for name, fluid in fluids.items():
            start = time.process_time()
            for _ in range(steps[name]):
                particles[name].step(fluid, dt)
            spent[name].append(1e3 * (time.process_time() - start) / steps[name])
    median = {name: float(np.median(times)) for name, times in spent.items()}
    set_threads(before)
    ratio = median["coupled 100000"] / median["learned law, tables"]
    return {"milliseconds a step": median, "coupled 100000 over learned": ratio}


def fene(reference: int = 4000, count: int = 5000) -> dict[str, Any]:
    """Held-out flows; start-up of a plane channel, De = Re = 1, F = 12, 64 cells, to t = 8."""
    numbers: dict[str, Any] = {"held-out flows": fene_study(count, 0)}
    flow, b = PlaneFlow(1.0, 1.0, 64, force=lambda t: 12.0), 50.0

    def run(fluid: Any) -> Profiles:
        return run_plane(flow, fluid, until=8.0, dt=0.004, every=25)

    start = time.perf_counter()
    truth = run(
        CoupledDumbbells(Dumbbells(64, reference, b=b, seed=5, common=True, matched=True), 1.0)
    ).u
    seconds = {"coupled": time.perf_counter() - start}
    twisted = fene_law(count, 0)
    law = twisted.spring_law
    rows: dict[str, Any] = {}
    for rival in (MAXWELL, FENEP(b), law, law.tabulated(), twisted):
        start = time.perf_counter()
        name = (
            "learned spring, table" if rival is not law and hasattr(rival, "shape") else rival.name
        )
        with warnings.catch_warnings(action="ignore"):
            try:
                rows[name] = relative(run(Closure(rival, 1.0, 64)).u, truth)
            except InputError as error:
                rows[name] = str(error)
        seconds[name] = time.perf_counter() - start
    numbers["plane channel"], numbers["seconds"] = rows, seconds
    numbers["over FENE-P"] = {
        name: rows[name] / rows["FENE-P"] for name in (law.name, twisted.name)
    }
    profiles = run(Closure(law, 1.0, 64))

    def replay(K: np.ndarray, interval: float) -> np.ndarray:
        parts = int(np.ceil(np.abs(K).max() * interval / 0.25))
        dumbbells = Dumbbells(K.shape[1], 2000, b=b, seed=77, common=True, matched=True)
        return simulate(dumbbells, K, interval, steps=max(parts, 10)).stress

    for cells in (12,):
        missing = missing_stress(flow, profiles, law, replay, cells)
        better = corrected_run(flow, law, missing, 8.0, 0.004, 25)
        numbers[f"replay of {cells} cells"] = {
            "closure error estimated": relative(profiles.u, better.u),
            "error after": relative(better.u, truth),
        }
    return numbers


def held_out(count: int = 4000) -> dict[str, Any]:
    """Flows of FENE dumbbells that no fit saw: larger of both errors, five sets of data."""
    runs = [fene_study(count, seed) for seed in SEEDS]
    numbers: dict[str, Any] = {}
    for law, flows in runs[0].items():
        for flow in flows:
            larger = [max(e for e in run[law][flow].values() if e is not None) for run in runs]
            row = {"median": float(np.median(larger)), "worst": max(larger)}
            numbers.setdefault(law, {})[flow] = row
    return numbers


def twins(ensembles: int = 40, count: int = 1000) -> dict[str, Any]:
    """By how much Hookean twins cut the variance of S (xx, xy, yy, zz), b = 50."""
    numbers: dict[str, Any] = {}
    flows = {f"shear {wi:g}": shear(wi) for wi in (0.1, 0.5, 1.0, 3.0, 8.0)}
    flows |= {f"elongation {wi:g}": elongation(wi) for wi in (0.1, 0.3, 1.0)}
    for name, K in flows.items():
        quiet = Twins(ensembles, count, b=50.0, seed=7)
        plain = Dumbbells(ensembles, count, b=50.0, seed=7)
        for t, steps in ((0.5, 50), (3.0, 250)):
            start = time.process_time()
            with_twins = quiet.advance(K, 0.01, steps).S
            middle = time.process_time()
            without = plain.advance(K, 0.01, steps).S
            cost = (middle - start) / (time.process_time() - middle)
            cut = without.var(axis=0) / with_twins.var(axis=0)
            numbers[f"{name}, t = {t:g}"] = {"variance cut": cut.tolist(), "cost": cost}
    return numbers


def bands(seeds: int = 12, count: int = 24) -> dict[str, Any]:
    """Start-up between plates, De 1, 2000 dumbbells: what ± 2 deviations hold, set by set."""
    flow = PlaneFlow(1.0, 10.0, 16, top=lambda t: 1.0)

    def run(law: Any) -> np.ndarray:
        return run_plane(flow, Closure(law, 1.0, 16), until=4.0, dt=0.04, every=20).u

    exact, held_by, ratios = run(MAXWELL), [], []
    for seed in range(seeds):
        rates = held(shear(np.linspace(-20, 20, 7)), 300)
        record = simulate(Dumbbells(7, 2000, seed=seed), rates, 0.01)
        spread = band(learn_shear(record, outside="allow", most=150), run, count, seed)
        moved = spread.deviation > 1e-6
        held_by.append(spread.covers(exact))
        off = (exact - spread.value)[moved] / spread.deviation[moved]
        ratios.append(float(np.sqrt(np.mean(off**2))))
    overall = float(np.sqrt(np.mean(np.square(ratios))))
    return {"held": held_by, "mean": float(np.mean(held_by)), "error over deviation": overall}


STUDIES = {f.__name__: f for f in (couette, channel, recipes, speed, fene, held_out, twins, bands)}


def main(arguments: list[str] | None = None) -> None:
    parser = Options(__doc__, json=True)
    parser.add("studies", nargs="*", choices=[*STUDIES, []], help="all, if none is named")
    options = parser.parse_args(arguments)
    folder = ROOT / "runs" / "polymer_tables"
    for name in options.studies or STUDIES:
        numbers = STUDIES[name]()
        write_json(folder / f"{name}.json", numbers)
        print(json.dumps(plain({name: numbers}), indent=None if options.json else 2), flush=True)


if __name__ == "__main__":
    sys.exit(exit_status(main))
