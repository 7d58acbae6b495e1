"""Stability atlas: the error of an answer where the family's data hold nothing of its loads."""

import matplotlib.pyplot as plt
import numpy as np

import warp_peri as wp
from examples.studies.atlas_entry import Entry, words, written
from warp_peri.points.samples import part
from warp_peri.prediction import Family

LONG = 45.0
"""Waves that the family learns from are longer [Å]."""


def short_waves(data: wp.Dataset) -> Entry:
    """Likely and true errors of waves that are shorter than all that a family learned from."""
    train = data["train"]
    length = 2 * np.pi / np.asarray(train.arrays["wave_number"])
    seen = np.flatnonzero(length >= LONG)
    law = wp.Micromodulus(15.0, "4mm", moduli="long waves")
    family = wp.fit(part(train, seen), Family(law), progress=False).material
    answers = wp.predict(family, wp.Dirichlet(train.points, train.loads, train.u), None)
    assert isinstance(answers, tuple)
    inside = train.interior
    true = np.array(
        [
            np.linalg.norm((a.u - u)[inside]) / np.linalg.norm(u[inside])
            for a, u in zip(answers, train.u)
        ]
    )
    told = np.array([answer.error for answer in answers])
    named = np.array([len(answer.uncovered) > 0 for answer in answers])
    ratio, short = told / true, length < LONG
    figure, ax = plt.subplots(figsize=(6.4, 4.2), layout="constrained")
    for some, style, label in (
        (short & named, "C3o", "named as not covered"),
        (short & ~named, "C1o", "shorter, not named"),
        (~short, "C0o", "learned from"),
    ):
        ax.semilogy(length[some], ratio[some], style, label=label)
    ax.axhline(1.0, color="k", lw=0.8)
    ax.set(xlabel="wavelength [Å]", ylabel="likely error / true error")
    ax.legend(frameon=False)
    lowest = int(np.argmin(np.where(short, ratio, np.inf)))
    numbers = {
        "long": LONG,
        "loads": len(seen),
        "covered": 100 * float(np.mean(ratio[~short] >= 1)),
        "least": float(ratio[~short].min()),
        "worst": float(ratio[lowest]),
        "low": int(np.count_nonzero(short & (ratio < 1))),
        "named": int(np.count_nonzero(short & (ratio < 1) & named)),
    }
    problem = wp.Dirichlet(train.points, train.loads, train.u)
    alone = words(lambda: wp.predict(family.rich, problem))  # a law that is no family
    seen_words = [answers[lowest].why, alone]
    values = {"wavelength": length.tolist(), "ratio": ratio.tolist(), **numbers}
    return Entry(*written("predictions", **numbers), seen_words, figure, values)
