"""Stability atlas: a polymer flow whose particles have noise of their own."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np

from examples.studies.atlas_entry import Entry, written
from warp_peri import InputError
from warp_peri.flow.channel import ChannelFlow, Particles
from warp_peri.flow.channel_run import run_channel
from warp_peri.flow.closure import Closure, Coupled
from warp_peri.flow.dumbbells import Dumbbells
from warp_peri.flow.laws import UpperConvectedMaxwell

DE, UNTIL, STEPS, COUNT = 1e-2, 0.03, 300, 300


def independent_noise() -> Entry:
    """A channel of dumbbells whose cells do not share their random numbers."""
    flow = ChannelFlow(DE, across=20, smoothing=1.2)
    n = Particles(flow).fluid
    exact = run_channel(flow, Closure(UpperConvectedMaxwell(), DE, n), UNTIL, UNTIL / STEPS)
    fluids = {
        common: Coupled(Dumbbells(n, COUNT, seed=1, common=common), DE) for common in (True, False)
    }
    shared = run_channel(flow, fluids[True], UNTIL, UNTIL / STEPS)
    particles, speeds, seen = Particles(flow), [], []
    try:
        for _ in range(STEPS):
            particles.step(fluids[False], UNTIL / STEPS)
            speeds.append(float(np.abs(particles.v).max()))
    except InputError as error:
        seen.append(f"InputError: {error}")
    off = float(np.linalg.norm(shared.v - exact.v) / np.linalg.norm(exact.v))
    figure, axes = plt.subplots(figsize=(6, 3.6), layout="constrained")
    axes.plot(exact.t, np.abs(exact.v).max(axis=(1, 2)), "k", label="exact law")
    axes.plot(shared.t, np.abs(shared.v).max(axis=(1, 2)), "C0--", label="shared noise")
    t = (np.arange(len(speeds)) + 1) * UNTIL / STEPS
    axes.plot(t, speeds, "C3", label="noise of its own in every particle")
    axes.set(xlabel="t / t0", ylabel="largest speed / U", yscale="log")
    axes.legend(frameon=False)
    values = {"largest": max(speeds), "exact": float(np.abs(exact.v).max())}
    text = written("noise-of-its-own", off=100 * off, count=COUNT, De=DE, **values)
    if not seen:
        raise RuntimeError("expected particles to leave the channel")
    return Entry(*text, seen, figure, values)
