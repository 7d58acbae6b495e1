"""Three reductions of the same thermal runs to displacement fields, and the noise of each.

  shared  average of a loaded run minus that of the unloaded run of its seed
  plain   average of a loaded run after the transient
  iota    smoothing in time as printed, You et al. 2021 (2.10)

The disk expands and turns: without a partner of its own seed, the mean of unloaded runs of other
seeds is subtracted, and then what is left of a rigid motion. Noise is estimated from seeds that no
loaded run shares.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from tools.loads import Load
from tools.plans import Plan
from tools.samples import Piece, Sample
from tools.thermal import Task, ThermalRun

REDUCTIONS = ("shared", "plain", "iota")


@dataclass(frozen=True)
class Fields:
    """Displacement of the atoms of one group of loads.

    Attributes:
        loads: of the samples.
        displacement: [Å], shape [S, A, 2].
        snr: signal-to-noise ratio of each sample's atoms.
        seed: of each sample.
    """

    loads: list[Load]
    displacement: np.ndarray
    snr: np.ndarray
    seed: np.ndarray


def reduced(
    plan: Plan,
    group: str,
    runs: Mapping[Task, ThermalRun],
    at_rest: Mapping[Load, Sample],
    *,
    reduction: str,
    factor: float,
) -> Fields:
    """Every load of a group by one reduction, for one factor on the loads."""
    loads = list(plan.groups[group])
    seeds = [plan.seed(number) for number in range(len(loads))]
    loaded = [runs[Task(plan.body, load, factor, seed)] for load, seed in zip(loads, seeds)]
    fields = []
    for run, seed, load in zip(loaded, seeds, loads):
        if reduction == "shared":
            field = run.average - runs[plan.unloaded(seed)].average
        else:
            field = _unpaired(plan, runs, run, seed, reduction)
        fields.append(settled(plan.body, at_rest[load].reference, field))
    snr = np.array([run.snr for run in loaded])
    return Fields(loads, np.stack(fields), snr, np.array(seeds))


def _unpaired(
    plan: Plan, runs: Mapping[Task, ThermalRun], run: ThermalRun, seed: int, reduction: str
) -> np.ndarray:
    """Average or smoothed displacement of a run, on the disk less the mean of other seeds."""
    field = run.average if reduction == "plain" else run.smoothed
    if plan.body.box is not None:
        return field
    others = [runs[plan.unloaded(other)].average for other in plan.every_seed() if other != seed]
    return field - np.mean(others, axis=0)


def noise(
    plan: Plan,
    runs: Mapping[Task, ThermalRun],
    reference: np.ndarray,
    *,
    reduction: str,
    factor: float,
) -> np.ndarray:
    """Noise of a reduction by itself: fields [Å], shape [S, A, 2], that no load caused.

    Of the plain average and of the smoothing: unloaded runs of the spare seeds. Of the shared
    seeds: what a load gives with two seeds, difference over √2.
    """
    fields = []
    if reduction == "shared":
        for group, loads in plan.groups.items():
            for number, second in plan.repeated(group).items():
                pair = []
                for seed in (plan.seed(number), second):
                    loaded = runs[Task(plan.body, loads[number], factor, seed)]
                    pair.append(loaded.average - runs[plan.unloaded(seed)].average)
                fields.append((pair[0] - pair[1]) / np.sqrt(2))
    else:
        for seed in plan.spare_seeds():
            fields.append(_unpaired(plan, runs, runs[plan.unloaded(seed)], seed, reduction))
    return np.stack([settled(plan.body, reference, field) for field in fields])


def settled(body: Piece, reference: np.ndarray, field: np.ndarray) -> np.ndarray:
    """A field without its mean and, on a free body, without its mean rotation; shapes [A, 2]."""
    field = field - field.mean(axis=0)
    if body.box is None:
        x = reference - reference.mean(axis=0)
        turn = np.stack([-x[:, 1], x[:, 0]], axis=1)
        field -= turn * ((turn * field).sum() / (turn**2).sum())
    return field
