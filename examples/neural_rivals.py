"""Other materials learned from what the neural operator learns from, by name."""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np

import warp_peri as wp
from examples.hgo_square import FREE
from examples.leaflet import ROSE
from examples.neural_sets import Sets
from examples.studies.leaflet_rivals import RIVALS, Window, fit, interpolated_errors
from warp_peri import Samples
from warp_peri.materials.hyperelastic.energy_fit import fit_energy
from warp_peri.materials.hyperelastic.from_displacement import fit_displacement
from warp_peri.tissue import HyperelasticSolid, hyperelastic_errors

EVERY = 10
"""Of the leaflet's training frames, one in so many is what the dictionary is fitted on, and what
the fits of elements to all frames begin with."""
ELEMENTS = (
    "neo-Hookean",
    "Fung",
    "invariant-based",
    "structure-informed",
    "HGO, two fibre directions",
)

Errors = dict[str, dict[str, Any]]
"""By kind and set: E_res, E_u, and of the leaflet's held-out frames each one's E_u ("frames")."""


def linear_solid(sets: Sets) -> Errors:
    """The linear peridynamic solid with a learned influence function, certified."""
    model = wp.fit(
        sets["train"], wp.LPS(20.0, method=wp.methods.Optimum(moduli=None)), progress=False
    ).material
    errors = {name: wp.evaluate(model, samples) for name, samples in sets.items()}
    return {
        key: {name: float(found[key]) for name, found in errors.items()}
        for key in ("E_res", "E_res_abs", "E_u")
    }


def dictionary(samples: Samples, reach: int) -> HyperelasticSolid:
    """The dictionary of energies, coefficients of any sign, at a horizon of so many spacings."""
    return fit_energy(samples, dataclasses.replace(FREE, reach=float(reach))).material


def frames_dictionary(sets: Sets) -> Errors:
    """The dictionary learned from displacement alone."""
    solid = fit_displacement(_few(sets["train"]), ROSE, most_steps=8).material
    frames = hyperelastic_errors(solid, sets["test"])["displacements"]
    return {**_errors(solid, sets, solve=True), "frames": {"test": frames}}


def elements(name: str) -> Callable[[Sets], Errors]:
    """A named energy in finite elements on the interior, fitted to all frames, as printed."""

    def errors(sets: Sets) -> Errors:
        make, starts = RIVALS[name]
        few, window = _few(sets["train"]), Window(sets["train"])
        numbers, _ = min((fit(window, make, np.array(x), few) for x in starts), key=lambda f: f[1])
        every = np.concatenate([samples.u for samples in sets.values()])
        frames = Samples(sets["train"].points, every)
        numbers, _ = fit(window, make, numbers, frames, most_steps=1)
        found = {
            part: window.errors(make(numbers), samples, samples.u) for part, samples in sets.items()
        }
        means = {part: float(np.nanmean(values)) for part, values in found.items()}
        return {"E_u": means, "frames": {"test": found["test"]}}

    return errors


def interpolated(sets: Sets) -> Errors:
    """No material: the collar's displacement continued by biharmonic interpolation."""
    found = {part: interpolated_errors(samples, samples.u) for part, samples in sets.items()}
    means = {part: errors["held out"] for part, errors in found.items()}
    return {"E_u": means, "frames": {"test": found["test"]["frames"]}}


def _few(samples: Samples) -> Samples:
    return Samples(samples.points, samples.u[::EVERY])


def _errors(solid: HyperelasticSolid, sets: Sets, *, solve: bool) -> Errors:
    """E_res where there are loads, and E_u."""
    found: Errors = {}
    for name, samples in sets.items():
        errors = hyperelastic_errors(solid, samples, solve=solve)
        for key in ("E_res", "E_u"):
            if key in errors:
                found.setdefault(key, {})[name] = float(errors[key])
    return found


def rivals_of(experiment: str, sets: Sets, reach: int, *, solve: bool) -> dict[str, Any]:
    """Errors of the rivals of an experiment, by name, kind and set; `solve` for E_u of a sheet."""
    if experiment == "graphene":
        return {"linear solid": linear_solid(sets)}
    if experiment == "hgo":
        return {"dictionary": _errors(dictionary(sets["train"], reach), sets, solve=solve)}
    fits = {"no material": interpolated} | {name: elements(name) for name in ELEMENTS}
    fits["dictionary"] = frames_dictionary
    return {name: errors(sets) for name, errors in fits.items()}
