"""Stability atlas: networks that have learned forces from displacements with noise."""

from functools import partial
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import warp_peri as wp
from examples import neural_sets
from examples.studies.atlas_entry import Entry, words, written
from examples.studies.neural_noise import REACH, learned
from warp_peri.neural import evaluate

LEVELS = (0.0, 0.002, 0.005, 0.01)
EPOCHS = 60
SOLVED = 10


def noise(folder: Path) -> Entry:
    """Residuals on clean squares, and the share of equilibria, against the noise learned from."""
    sets = neural_sets.hgo(folder, REACH, mirror=False, jobs=1, progress=False)
    test = sets["test"]
    residual, found = [], []
    seen: list[str] = []
    for level in LEVELS:
        law = learned(sets, level, EPOCHS)
        errors = evaluate(law, test, most=SOLVED)
        residual.append(100 * errors["E_res"])
        found.append(100 * errors["converged"])
        if not seen and errors["converged"] < 1:
            lost = int(np.argmin(errors["samples"]["converged"]))
            problem = wp.Dirichlet(test.points, test.loads[lost], test.u[lost])
            seen.append(words(partial(wp.solve, law, problem)))
    figure, ax = plt.subplots(figsize=(6.4, 4.2), layout="constrained")
    levels = [100 * level for level in LEVELS]
    ax.plot(levels, residual, "o-", label="residual of clean forces")
    ax.plot(levels, found, "s--", label="equilibria found")
    ax.set(xlabel="noise on the displacements learned from [%]", ylabel="[%]", ylim=(0, 105))
    ax.legend(frameon=False)
    numbers = {
        "epochs": EPOCHS,
        "solved": SOLVED,
        "most": levels[-1],
        "clean": residual[0],
        "worst": residual[-1],
        "left": found[-1],
        "kept": found[0],
    }
    values = {"noise": levels, "residual": residual, "found": found}
    return Entry(*written("noisy-strains", **numbers), seen, figure, values)
