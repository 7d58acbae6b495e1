"""Stability atlas: loads from small strains to where atoms fail, for linear and nonlinear solids."""

import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np

import warp_peri
from examples.studies.atlas_entry import Entry, words, written
from tools.failure import to_failure
from tools.loads import TEST, VALIDATION, Load
from tools.make_graphene import graphene_bodies, point_set
from tools.make_strained import strained, strained_file
from tools.samples import Piece, Sample, _statics, read_sample, write_record
from warp_peri import Bernstein, Dataset, InputError, Model, Samples
from warp_peri.learning.nonlinear import Nonlinear
from warp_peri.methods import Optimum, Smoothing
from warp_peri.third_order.material import NonlinearModel

STRAINS = (0.01, 0.02, 0.04, 0.06, 0.08, 0.1, 0.12)
"""Largest bond strains; from the last on the load grows until atoms fail."""
CASE, DISK = 2, 1
"""Numbers of a validation load, a patch pushed across the crystal's zigzag direction, and of a load
on a disk."""


def larger_strains(data: Dataset, cache: Path) -> Entry:
    """E_u of a patch load against the largest bond strain, up to where atoms fail."""
    sheet, disk = graphene_bodies()
    patch = VALIDATION[CASE - 1]
    path = _growing(sheet, patch, cache)
    sets = _on_nodes(sheet, patch, path)
    of_disk = _growing(disk, TEST[DISK - 1], cache)[-1].max_bond_strain
    train, kernel = data["train"], Bernstein(10, two_functions=True)
    options: dict[str, Any] = {"method": Optimum(moduli="isotropic"), "normalise": True}
    filtered = Nonlinear(Smoothing())
    energy = warp_peri.fit(
        train, warp_peri.ThirdOrder(warp_peri.LPS(20.0, kernel, **options))
    ).material
    models: dict[str, Model | NonlinearModel] = {
        "linear": warp_peri.fit(train, warp_peri.LPS(20.0, kernel, **options)).material,
        "energy form": energy,
        "filtered form": warp_peri.fit(
            train, warp_peri.ThirdOrder(warp_peri.LPS(20.0, kernel, **options), filtered.smoothing)
        ).material,
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
    of_patch = path[-1].max_bond_strain
    for body, strain, style in (("patch", of_patch, ":"), ("disk", of_disk, "--")):
        axes.axvline(100 * strain, color="0.6", linestyle=style, label=f"atoms fail ({body})")
    axes.set(xlabel="largest bond strain [%]", ylabel="E_u [%]")
    axes.legend(frameon=False, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    last = sets[max(sets)]
    seen = [words(lambda: warp_peri.evaluate(energy, last))]
    proven = energy.proven_strain(train.spacing)
    measured = {"strains": list(sets), "proven": proven, "disk_fails_at": of_disk, **errors}
    column = STRAINS.index(0.04)
    text = written(
        "larger-strains",
        linear=100 * errors["linear"][column],
        filtered=100 * errors["filtered form"][column],
        worst=100 * float(np.nanmax(errors["filtered form"])),
        bears_filtered=percent[np.isfinite(errors["filtered form"])].max(),
        bears_energy=percent[np.isfinite(errors["energy form"])].max(),
        patch_fails=100 * of_patch,
        disk_fails=100 * of_disk,
        proven=100 * proven,
    )
    return Entry(*text, seen, figure, measured)


def _growing(body: Piece, load: Load, cache: Path) -> list[Sample]:
    """The load at growing strains, to the last equilibrium of the atoms."""
    path: list[Sample] = []
    for strain in STRAINS:
        file = strained_file(cache, body, load, strain)
        equilibrium = read_sample(file)
        if equilibrium is None:
            equilibrium = strained(body, _statics(body), load, strain, path[-1] if path else None)
            write_record(file, equilibrium)
        path.append(equilibrium)
    return path + to_failure(body, load, path[-1])


def _on_nodes(body: Piece, load: Load, path: list[Sample]) -> dict[float, Samples]:
    """Samples on nodes 5 Å apart by their strain."""
    return {
        sample.max_bond_strain: replace(point_set(body, [load], [sample], spacing=5.0), arrays={})
        for sample in path
    }
