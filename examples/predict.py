"""A tolerance in, an answer with its error out: an ensemble of graphene on bodies it never saw.

    python examples/predict.py

Learns an ensemble from data/graphene_0K.h5 in a minute, and predicts the free disks of that file at
four tolerances. Prints for each the error that is stated and the true one, against the atoms.
"""

import sys
from pathlib import Path
from typing import Any

import numpy as np

import warp_peri as wp

ROOT = Path(__file__).resolve().parent.parent
TOLERANCES = (0.02, 0.01, 0.005, None)
"""None: as well as the ensemble can."""


def stated_and_true(
    material: wp.prediction.EnsembleMaterial, disks: wp.Samples, tolerance: float | None
) -> np.ndarray:
    """Errors that are stated and true ones, relative ℓ2 of displacement, shape [S, 2]."""
    inside, pairs = disks.interior, []
    for b, u in zip(disks.loads, disks.u):
        collar = np.where(inside[:, None], 0.0, u)
        answer: Any = wp.predict(material, wp.Dirichlet(disks.points, b, collar), tolerance)
        wrong = np.linalg.norm((answer.u - u)[inside]) / np.linalg.norm(u[inside])
        pairs.append((answer.error, wrong))
    return np.array(pairs)


def main() -> int:
    data = wp.load(ROOT / "data" / "graphene_0K.h5")
    rich = wp.ThirdOrder(wp.Crystal(15.0), wp.methods.Smoothing(10.0))
    family = wp.prediction.Ensemble(rich)
    material = wp.fit(data["train"], family, validation=data["val"], progress=False).material
    for tolerance in TOLERANCES:
        name = "best" if tolerance is None else f"{100 * tolerance:g} %"
        pairs = 100 * stated_and_true(material, data["test"], tolerance)
        print(f"{name:>6}:", "; ".join(f"stated {a:.2f} %, true {b:.2f} %" for a, b in pairs))
    return 0


if __name__ == "__main__":
    sys.exit(main())
