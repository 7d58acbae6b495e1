"""Stability atlas: one load from small strains to where atoms fail, for linear and nonlinear solids."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np

import warp_peri
from examples.studies.atlas_entry import Entry, words, written
from tools.make_graphene import graphene_bodies, point_set
from tools.make_strained import strained, strained_file
from tools.samples import Sample, _statics, read_sample, write_record
from tools.statics import ConvergenceError
from warp_peri import (
    Bernstein,
    Dataset,
    Model,
    Nonlinear,
    NonlinearModel,
    Optimum,
    Samples,
    Smoothing,
)
from warp_peri.errors import InputError

STRAINS = (0.01, 0.02, 0.04, 0.06, 0.08, 0.1, 0.12, 0.14, 0.16, 0.18, 0.2)
CASE = 2
"""Number of the validation load: a patch pushed across the crystal's zigzag direction."""


def larger_strains(data: Dataset, cache: Path) -> Entry:
    """E_u of a patch load against the largest bond strain."""
    sets = _patches(cache)
    train, kernel = data["train"], Bernstein(10, two_functions=True)
    options: dict[str, Any] = {"method": Optimum(moduli="isotropic"), "normalise": True}
    filtered = Nonlinear(Smoothing())
    energy = warp_peri.fit(train, 20.0, kernel, nonlinear=Nonlinear(), **options).model
    models: dict[str, Model | NonlinearModel] = {
        "linear": warp_peri.fit(train, 20.0, kernel, **options).model,
        "energy form": energy,
        "filtered form": warp_peri.fit(train, 20.0, kernel, nonlinear=filtered, **options).model,
    }
    errors: dict[str, list[float]] = {name: [] for name in models}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        for samples in sets.values():
            for name, model in models.items():
                try:
                    errors[name].append(warp_peri.evaluate(model, samples)["E_u"])
                except InputError:
                    errors[name].append(np.nan)
    figure, axes = plt.subplots(figsize=(6, 3.6), layout="constrained")
    percent = 100 * np.array(list(sets))
    for name, values in errors.items():
        axes.semilogy(percent, 100 * np.array(values), "o-", label=name)
    axes.set(xlabel="largest bond strain [%]", ylabel="E_u [%]")
    axes.legend(frameon=False)
    last = sets[max(sets)]
    seen = [words(lambda: warp_peri.evaluate(energy, last))]
    proven = energy.proven_strain(train.spacing)
    measured = {"strains": list(sets), "proven": proven, **errors}
    column = list(sets).index(0.04)
    text = written(
        "larger-strains",
        linear=100 * errors["linear"][column],
        filtered=100 * errors["filtered form"][column],
        worst=100 * float(np.nanmax(errors["filtered form"])),
        bears_filtered=percent[np.isfinite(errors["filtered form"])].max(),
        bears_energy=percent[np.isfinite(errors["energy form"])].max(),
        end=100 * max(sets),
        proven=100 * proven,
    )
    return Entry(*text, seen, figure, measured)


def _patches(cache: Path) -> dict[float, Samples]:
    """The load at growing strains, as far as atoms bear it."""
    from tools.loads import VALIDATION

    body, load = graphene_bodies()[0], VALIDATION[CASE - 1]
    sets: dict[float, Samples] = {}
    before: Sample | None = None
    for strain in STRAINS:
        file = strained_file(cache, body, load, strain)
        equilibrium = read_sample(file)
        if equilibrium is None:
            try:
                equilibrium = strained(body, _statics(body), load, strain, before)
            except ConvergenceError:
                return sets
            write_record(file, equilibrium)
        before = equilibrium
        samples = point_set(body, [load], [equilibrium], spacing=5.0)
        sets[strain] = replace(samples, arrays={})
    return sets
