"""Local elasticity on the samples that a model is held against: what does nonlocality buy?

    python examples/local_elasticity.py data/graphene_0K.h5 runs/graphene_0K/model.json

Prints E_u [%] by set: of each model, and of local elasticity with the moduli of its long waves and
with the true ones of the file. Needs scikit-fem (the extra `compare`).
"""

import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

import numpy as np

import warp_peri as wp
from tools.elements import errors_of_local, moduli_of
from tools.options import Options
from warp_peri.core.elastic import plane_isotropic
from warp_peri.errors import exit_status
from warp_peri.points.arguments import USUAL


def errors_by_model(
    models: dict[str, Any], sets: dict[str, wp.Samples], true: np.ndarray | None
) -> dict[str, dict[str, float]]:
    """E_u by model and set; `true` is the Voigt matrix [3, 3] of local elasticity, if known."""
    found: dict[str, dict[str, float]] = {}
    for name, samples in sets.items():
        for label, model in models.items():
            errors = wp.evaluate(model, samples, allow_uncertified=True)["E_u"]
            found.setdefault(label, {})[name] = errors
            own = errors_of_local(samples, moduli_of(model, samples.spacing)).mean()
            found.setdefault(f"local elasticity, moduli of {label}", {})[name] = own
        if true is not None:
            exact = errors_of_local(samples, true).mean()
            found.setdefault("local elasticity, true moduli", {})[name] = exact
    return found


def main(arguments: list[str] | None = None) -> None:
    parser = Options(__doc__, options={"sets": (["val", "test"], "of the data")})
    parser.add_argument("data", type=Path)
    parser.add_argument("models", type=Path, nargs="+")
    given = parser.parse_args(arguments)
    data = wp.load(given.data)
    truth = data.provenance.get("truth")
    units = data.units if truth is None else USUAL  # of the truth
    data = wp.load(given.data, units=units)
    models = {path.stem: wp.load(path, units=units) for path in given.models}
    sets = {name: data[name] for name in given.sets}
    true = None if truth is None else plane_isotropic(truth["lambda"], truth["mu"])
    for label, errors in errors_by_model(models, sets, true).items():
        print(f"{label:44}", *(f"{name} {100 * e:.2f} %" for name, e in errors.items()))


if __name__ == "__main__":
    sys.exit(exit_status(main))
