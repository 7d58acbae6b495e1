"""`predict` and `plan`: displacement with its likely error, and what would be cheapest."""

from __future__ import annotations

import argparse
import dataclasses
from typing import Any

import numpy as np

import warp_peri
from warp_peri.cli.inputs import data_for
from warp_peri.errors import InputError
from warp_peri.points.dataset import load_dataset
from warp_peri.points.unit_names import USUAL
from warp_peri.storage import load


def run_predict(given: argparse.Namespace) -> dict[str, Any]:
    """Displacement under the loads of a set, each with its likely error."""
    model = load(given.model)
    points = data_for(given, model)[given.set]
    asked = {"transfer": given.transfer, "allow_uncertified": given.allow_uncertified}
    options = {name: value for name, value in asked.items() if value != (name == "transfer")}
    problem = warp_peri.Dirichlet(points, points.loads, points.u)
    answers: Any = warp_peri.predict(model, problem, given.tolerance or None, **options)
    samples = []
    for answer, truth in zip(answers, points.u[:, points.interior]):
        told = {n: getattr(answer, n) for n in ("error", "parts", "kept", "why", "uncovered")}
        told["local_solid"] = answer.local if answer.operator else None
        if size := float(np.linalg.norm(truth)):  # the set holds what was measured or computed
            wrong = answer.u[points.interior] - truth
            told["true"] = float(np.linalg.norm(wrong)) / size
        samples.append(told)
    return {"set": given.set, "tolerance": given.tolerance or None, "samples": samples}


def run_plan(given: argparse.Namespace) -> dict[str, Any]:
    """The cheapest model and solver that was measured within a tolerance, for a scene."""
    typed = {"strain": given.strain, "loads": given.loads, "rectangle": given.rectangle or None}
    typed |= {"size": given.size and tuple(given.size), "shortest_wave": given.shortest_wave}
    typed = {name: value for name, value in typed.items() if value is not None}
    if given.data is not None:
        points = load_dataset(given.data, units=USUAL)[given.set]
        problem = warp_peri.Dirichlet(points, points.loads, points.u)
        scene = dataclasses.replace(
            warp_peri.choice.Scene.of(problem, modulus=given.modulus), **typed
        )
    elif {"size", "shortest_wave"} <= typed.keys():
        scene = warp_peri.choice.Scene(**typed)
    else:
        raise InputError("plan: expected a data file, or --size and --shortest-wave")
    choice = warp_peri.choice.choose_model(tolerance=given.tolerance, scene=scene)
    return {"scene": dataclasses.asdict(scene), **dataclasses.asdict(choice)}
