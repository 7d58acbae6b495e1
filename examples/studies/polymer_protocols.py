"""Flows of FENE dumbbells against their learned law: steady shear, and twelve unseen protocols.

    python examples/studies/polymer_protocols.py steady unseen --json

steady    N1 and s_xy of steady shear, N1 of fast oscillation and elongation, and what is warned of
unseen    twelve protocols that no fit saw: the larger relative error of s_xy and N1 over time

Five sets of data of 4000 dumbbells an ensemble, shear up to 8 and elongation up to 2.
"""

import json
import sys
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent.parent
sys.path.insert(0, str(ROOT))

import numpy as np

from examples.polymer import FENEP, Dumbbells, elongation, held, homogeneous, mixed, shear, simulate
from examples.polymer.learn import B, fene_law, relative
from examples.polymer.learned import OutsideWarning
from tools.options import Options
from warp_peri import InputError
from warp_peri.errors import exit_status
from warp_peri.files.atomic import plain, write_json

RATES = (0.5, 1.0, 2.0, 4.0, 6.0, 8.0, 10.0, 12.0, 20.0)
T = (np.arange(80) + 0.5) * 0.1


def fast() -> dict[str, np.ndarray]:
    """Gradients [80, 4] of steady shear, and of flows faster than the data."""
    flows = {f"shear {rate:g}": held(shear([rate]), 80)[:, 0] for rate in RATES}
    flows |= {f"oscillating shear {wi:g}": shear(wi * np.sin(T)) for wi in (5.0, 15.0, 30.0)}
    return flows | {f"elongation {rate:g}": elongation(rate + 0 * T) for rate in (1.5, 3.0)}


def protocols() -> dict[str, np.ndarray]:
    """Gradients [80, 4] that were chosen before any law was held to them."""
    early = T < 4
    both = np.where(early[:, None], [0.8, 4.0, 0.5, -0.8], elongation(-0.7))
    return {
        "shear 1.5, then rest": shear(np.where(early, 1.5, 0.0)),
        "shear 7": shear(7.0 + 0 * T),
        "shear 3, then 7": shear(np.where(early, 3.0, 7.0)),
        "shear 7, then 1.5": shear(np.where(early, 7.0, 1.5)),
        "shear 5, then −5": shear(np.where(early, 5.0, -5.0)),
        "shear 6 sin 3t": shear(6 * np.sin(3 * T)),
        "shear 8 sin 0.7t": shear(8 * np.sin(0.7 * T)),
        "elongation 0.75, then rest": elongation(np.where(early, 0.75, 0.0)),
        "elongation 1.5, then shear 5": np.where(early[:, None], elongation(1.5), shear(5.0)),
        "mixed, a new one each 1.5": mixed(1, 80, 2.0, hold=15, seed=123)[:, 0],
        "shear t": shear(T),
        "both, then compression": both,
    }


def stresses(flows: dict[str, np.ndarray], count: int, seed: int) -> np.ndarray:
    """s [81, m, 4] of dumbbells."""
    K = np.stack(list(flows.values()), axis=1)
    steps = max(10, int(np.ceil(np.abs(K).max() / 1.5)))
    return simulate(Dumbbells(K.shape[1], count, b=B, seed=seed), K, 0.1, steps=steps).stress


def of_law(law: Any, K: np.ndarray) -> tuple[np.ndarray, bool]:
    """s [81, 4] of a law, infinite where it fails, and whether it warned."""
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        try:
            C = homogeneous(law, K[:, None], 0.1)
            s = np.asarray(law.stress(C.reshape(-1, C.shape[-1])))
        except InputError:
            return np.full((81, 4), np.inf), True
    return s, any(issubclass(one.category, OutsideWarning) for one in told)


def laws(count: int, seed: int) -> list[Any]:
    """A law with a second memory and its spring alone, both of which warn."""
    learned = replace(fene_law(count, seed), outside="warn")
    return [learned, learned.spring_law]


def first(s: np.ndarray) -> np.ndarray:
    """N1 of stresses [..., 4]."""
    return np.asarray(s[..., 0] - s[..., 2])


def steady(count: int = 4000, sets: int = 5) -> dict[str, Any]:
    """Errors in %, from the smallest to the largest over sets of data, and sets that warned.

    Of shear the means from t = 5 to 8 with their signs, of the others over all time as relative ℓ2.
    """
    flows, numbers = fast(), dict[str, Any]()
    truth = stresses(flows, 4 * count, 901)
    for n, rivals in enumerate([*(laws(count, seed) for seed in range(sets)), [FENEP(B)]]):
        for law in rivals:
            for i, (name, K) in enumerate(flows.items()):
                s, warned = of_law(law, K)
                row = numbers.setdefault(law.name, {}).setdefault(name, {"warned": 0})
                row["warned"] += int(warned and n < sets)
                if name.startswith("shear"):
                    off = s[50:].mean(axis=0), truth[50:, i].mean(axis=0)
                    errors = {"N1": 100 * (first(off[0]) / first(off[1]) - 1)}
                    errors["s_xy"] = 100 * (off[0][1] / off[1][1] - 1)
                else:
                    errors = {"N1": relative(first(s), first(truth[:, i]))}
                for what, error in errors.items():
                    row.setdefault(what, []).append(float(error))
    return numbers


def unseen(count: int = 4000, sets: int = 5) -> dict[str, Any]:
    """Median and worst over sets of data of the larger error in %."""
    flows, numbers = protocols(), dict[str, Any]()
    truth = stresses(flows, 4 * count, 777)
    for rivals in [*(laws(count, seed) for seed in range(sets)), [FENEP(B)]]:
        for law in rivals:
            for i, (name, K) in enumerate(flows.items()):
                s, _ = of_law(law, K)
                errors = [relative(first(s), first(truth[:, i]))]
                errors += [relative(s[:, 1], truth[:, i, 1])] if K[:, 1].any() else []
                numbers.setdefault(law.name, {}).setdefault(name, []).append(max(errors))
    return {
        law: {name: {"median": float(np.median(e)), "worst": max(e)} for name, e in rows.items()}
        for law, rows in numbers.items()
    }


STUDIES = {f.__name__: f for f in (steady, unseen)}


def main(arguments: list[str] | None = None) -> None:
    parser = Options(__doc__, json=True)
    parser.add("studies", nargs="*", choices=[*STUDIES, []], help="both, if none is named")
    parser.add("--dumbbells", type=int, default=4000, help="in each ensemble of the data")
    parser.add("--sets", type=int, default=5, help="of data")
    options = parser.parse_args(arguments)
    folder = ROOT / "runs" / "polymer_protocols"
    for name in options.studies or STUDIES:
        numbers = STUDIES[name](options.dumbbells, options.sets)
        write_json(folder / f"{name}.json", numbers)
        print(json.dumps(plain({name: numbers}), indent=None if options.json else 2), flush=True)


if __name__ == "__main__":
    sys.exit(exit_status(main))
