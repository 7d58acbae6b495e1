"""One training run: learn, evaluate on every set, leave the model and its numbers in a folder."""

from __future__ import annotations

import dataclasses
import hashlib
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from warp_peri.errors import InputError
from warp_peri.files.atomic import write_json
from warp_peri.learning.evaluate import evaluate
from warp_peri.learning.fit import learn
from warp_peri.learning.methods import Kernel
from warp_peri.learning.uncertainty import Uncertainty, fit_uncertainty
from warp_peri.points.samples import Samples

ERRORS = ("E_res", "E_u", "E_res_abs")
"""Those of the means of `evaluate` that a model is kept with, where the metrics hold them."""


@dataclasses.dataclass(frozen=True)
class Run:
    """What a training run found.

    Attributes:
        fit: the material, its certificate and the way to them.
        tables: of `evaluate`, by the name of the set.
        refused: why a set was not evaluated, by its name.
        sure: what noise leaves unsure; None where no fields of noise were given.
        seconds: of learning and of prediction.
    """

    fit: Any
    tables: dict[str, dict[str, Any]]
    refused: dict[str, str]
    sure: Uncertainty | None
    seconds: dict[str, float]

    def mean(self, error: str) -> dict[str, float]:
        """An error of `evaluate`, averaged over the samples of each set, by the set's name."""
        return {name: table[error] for name, table in self.tables.items()}

    def save(
        self, folder: Path, metrics: dict[str, Any], *, data: Path, provenance: Mapping[str, Any]
    ) -> Any:
        """Write model.json, with its errors and the hash of its data, and metrics.json.

        Args:
            folder: made if it is not there.
            metrics: contents of metrics.json.
            data: the file that was learned from.
            provenance: what else the model says of how it came to be.

        Raises OSError when a file cannot be written.
        """
        material = self.fit.material
        said = {"errors": {key: metrics[key] for key in ERRORS if key in metrics}}
        said["provenance"] = {
            **getattr(material, "provenance", {}),
            "data": data.name,
            "sha256": hashlib.sha256(data.read_bytes()).hexdigest(),
            **provenance,
        }
        model = dataclasses.replace(
            material, **{name: value for name, value in said.items() if hasattr(material, name)}
        )
        model.save(folder / "model.json")
        write_json(folder / "metrics.json", metrics)
        return model


def train(
    samples: Samples,
    horizon: float,
    kernel: Kernel,
    sets: Mapping[str, Samples],
    *,
    noise: Samples | None = None,
    allow_uncertified: bool = False,
    **settings: Any,
) -> Run:
    """Learn from samples, evaluate on sets, and say how sure the constants are.

    Args:
        samples: training samples.
        horizon: δ [Å].
        kernel: as for `fit`.
        sets: to evaluate on, by name; one that `evaluate` refuses is passed over with its reason.
        noise: fields of noise alone on the nodes of the samples.
        allow_uncertified: warn about an uncertified spacing instead of refusing the set.
        settings: options of `fit` beyond these: method, conditions, loss, normalise, progress.

    Raises what `fit` raises.
    """
    begin = time.perf_counter()
    learned = learn(samples, horizon, kernel, noise=noise, **settings)
    between = time.perf_counter()
    told = evaluated(learned.material, sets, allow_uncertified=allow_uncertified)
    seconds = {"learning": between - begin, "prediction": time.perf_counter() - between}
    sure = None if noise is None else fit_uncertainty(learned, samples, noise)
    return Run(learned, *told, sure, seconds)


def evaluated(
    material: Any, sets: Mapping[str, Samples], **options: Any
) -> tuple[dict[str, dict[str, Any]], dict[str, str]]:
    """The tables of `evaluate` by set, and why a set has none; its options."""
    tables, refused = {}, {}
    for name, points in sets.items():
        try:
            tables[name] = evaluate(material, points, **options)
        except InputError as error:  # no load, another spacing, a collar too small
            refused[name] = str(error)
    return tables, refused
