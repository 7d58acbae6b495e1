"""Stability atlas: polymer flows. Noise of each particle's own, a conformation turned."""

import numpy as np

from examples.figures import curves, name_lines, panels
from examples.polymer import (
    ChannelFlow,
    Closure,
    CoupledDumbbells,
    Dumbbells,
    LogConformation,
    UpperConvectedMaxwell,
    elongation,
    homogeneous,
)
from examples.polymer.closure import heun
from examples.polymer.dumbbells import carried_exactly, propagator
from examples.polymer.laws import IDENTITY, eigenvalues, exponential_of
from examples.polymer.particles import Particles, run_channel
from examples.studies.atlas_entry import Entry, entry
from warp_peri import InputError

DE, UNTIL, STEPS, COUNT = 1e-2, 0.03, 300, 300


def independent_noise() -> Entry:
    """A channel of dumbbells whose cells do not share their random numbers."""
    flow = ChannelFlow(DE, across=20, smoothing=1.2)
    n = Particles(flow).fluid
    exact = run_channel(
        flow, Closure(UpperConvectedMaxwell(), DE, n), until=UNTIL, dt=UNTIL / STEPS
    )
    fluids = {
        common: CoupledDumbbells(Dumbbells(n, COUNT, seed=1, common=common), DE)
        for common in (True, False)
    }
    shared = run_channel(flow, fluids[True], until=UNTIL, dt=UNTIL / STEPS)
    particles, speeds, seen = Particles(flow), [], []
    try:
        for _ in range(STEPS):
            particles.step(fluids[False], UNTIL / STEPS)
            speeds.append(float(np.abs(particles.v).max()))
    except InputError as error:
        seen.append(f"InputError: {error}")
    off = float(np.linalg.norm(shared.v - exact.v) / np.linalg.norm(exact.v))
    figure, axes = panels(6, 3.6)
    axes.plot(exact.t, np.abs(exact.v).max(axis=(1, 2)), "k", label="exact model")
    axes.plot(shared.t, np.abs(shared.v).max(axis=(1, 2)), "C0--", label="shared noise")
    t = (np.arange(len(speeds)) + 1) * UNTIL / STEPS
    axes.plot(t, speeds, "C3", label="noise of its own")
    axes.set(xlabel="time t / t₀", ylabel="largest speed / U", yscale="log")
    name_lines(axes)
    values = {"largest": max(speeds), "exact": float(np.abs(exact.v).max())}
    if not seen:
        raise RuntimeError("expected particles to leave the channel")
    numbers = values | {"off": 100 * off, "count": COUNT, "De": DE}
    return entry("noise-of-its-own", numbers, seen, figure, values)


def stretched_and_turned() -> Entry:
    """Elongation at a high Weissenberg number and then a rotation, C and log C at one step."""
    law, wi, interval, parts = UpperConvectedMaxwell(), 3.0, 0.2, 4
    K = np.zeros((20, 1, 4))
    K[:10], K[10:] = elongation(wi), [0, 5.0, -5.0, 0]
    exact = [np.array([IDENTITY])]
    for now in K:
        C = exact[-1]
        for _ in range(100):
            C = carried_exactly(C, *propagator(now, interval / 100))
        exact.append(C)
    log = exponential_of(homogeneous(LogConformation(law), K, interval, parts=parts))
    unchecked = [np.array([IDENTITY])]
    for now in K:  # `homogeneous` would stop at the first C that is not positive
        C = unchecked[-1]
        for _ in range(parts):
            C = heun(law, now, C, interval / parts)
        unchecked.append(C)
    half = homogeneous(law, K, interval, parts=2 * parts)
    small = {
        name: eigenvalues(np.array(rows))[1][:, 0]
        for name, rows in (("exact", exact), ("C", unchecked), ("log C", log), ("half", half))
    }
    t = np.arange(len(K) + 1) * interval
    figure, axes = panels(6, 3.6)
    names = {"exact": "exact", "C": "state C", "half": "state C, half the step"}
    rows = {label: small[key] for key, label in (names | {"log C": "state log C"}).items()}
    axes.set_yscale("symlog", linthresh=0.1)
    x, y = "t / relaxation time", "smaller eigenvalue of C in the plane"
    curves(axes, "plot", t, rows, "k", "C3", "C1:", "C0--", xlabel=x, ylabel=y)
    large = eigenvalues(np.array(exact))[0].max()
    values = {
        "least": float(small["C"].min()), "exact": float(small["exact"][-1]),
        "log": float(small["log C"][-1]), "half": float(small["half"][-1]),
        "ratio": float(large / small["exact"].min()),
    }  # fmt: skip
    seen = (lambda: homogeneous(law, K, interval, parts=parts),)
    numbers = values | {"step": interval / parts, "wi": wi}
    return entry("stretched-and-turned", numbers, seen, figure, values)
