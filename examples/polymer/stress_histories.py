"""A flow law from histories of stress alone, as any simulator of polymers can write them.

Sixteen histories of gradient and stress, one file each, make a law; nobody looks at conformations.
It is held to four other histories, and to the laws that a book would take.

    python examples/polymer/stress_histories.py --json
"""

import json
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np
from matplotlib.figure import Figure

import warp_peri as wp
from examples import polymer as flow
from examples.figures import save_figure
from tools.options import Options
from warp_peri.errors import exit_status

B, COUNT, TIME = 50.0, 2000, 0.1
"""FENE dumbbells that stand for the polymer: spring, number; relaxation times from row to row."""


def histories(folder: Path) -> list[flow.Ensembles]:
    """Files t, K_xx, K_xy, K_yx, K_yy, s_xx, s_xy, s_yy, s_zz, and what `read_trajectory` makes."""
    folder.mkdir(parents=True, exist_ok=True)
    K = flow.mixed(16, 100, 1.0, hold=10, seed=1)  # a new gradient each relaxation time
    polymer = flow.simulate(flow.Dumbbells(16, COUNT, b=B, seed=1), K, TIME, steps=5)
    time, last = TIME * np.arange(len(K) + 1)[:, None], np.concatenate([K, K[-1:]])
    for i in range(16):
        table = np.hstack([time, last[:, i], polymer.stress[:, i]])
        np.savetxt(folder / f"{i:02}.csv", table, delimiter=",")
    return [flow.read_trajectory(path, 1.0, 1.0, COUNT) for path in sorted(folder.glob("*.csv"))]


def unseen() -> flow.Ensembles:
    """Shear and rest, oscillating shear, shear then a mixed flow, elongation and rest."""
    K = np.zeros((80, 4, 4))
    K[:40, 0], K[:, 1] = flow.shear([0.67]), flow.shear(np.sin(0.15 * np.arange(80)))
    K[:30, 2], K[30:60, 2], K[:40, 3] = (
        flow.shear([1.0]),
        [0.17, 0.33, 0.07, -0.17],
        [0.27, 0, 0, -0.27],
    )
    return flow.simulate(flow.Dumbbells(4, 4 * COUNT, b=B, seed=99), K, TIME, steps=5)


def stresses(law: Any, record: flow.Ensembles) -> np.ndarray:
    """s of a law under the gradients of a record, shape [T + 1, m, 4]."""
    state = flow.homogeneous(law, record.K, record.interval)
    return np.asarray(law.stress(state.reshape(-1, state.shape[-1])).reshape(record.S.shape))


def main(arguments: list[str] | None = None) -> None:
    parser = Options(__doc__, "stress_histories", json=True)
    parser.add("--most", type=int, default=300, help="increments that are learned from")
    options = parser.parse_args(arguments)
    records, truth = histories(options.out / "histories"), unseen()
    law = flow.learn_rate(records, window=2, kernel="product", most=options.most)
    wp.save(options.out / "law.json", law)
    laws = {
        "learned": law, "FENE-P": flow.FENEP(B), "upper-convected": flow.UpperConvectedMaxwell()
    }  # fmt: skip
    runs = {name: stresses(each, truth)[..., :3] for name, each in laws.items()}
    size = np.linalg.norm(truth.stress[..., :3], axis=(0, 2))
    errors = {
        name: (100 * np.linalg.norm(s - truth.stress[..., :3], axis=(0, 2)) / size).tolist()
        for name, s in runs.items()
    }
    print(json.dumps({"error %": errors}, indent=None if options.json else 1))
    figure = Figure(figsize=(7, 3), layout="constrained")
    for i, (ax, name) in enumerate(zip(figure.subplots(1, 2), ("shear, then rest", "oscillation"))):
        ax.plot(TIME * np.arange(81), truth.stress[:, i, 1], "k", label="dumbbells")
        for style, (kind, s) in zip(("C0--", "C1:", "C2:"), runs.items()):
            ax.plot(TIME * np.arange(81), s[:, i, 1], style, label=kind)
        ax.set(xlabel="relaxation times", ylabel="s_xy", title=name)
    ax.legend(frameon=False, fontsize=8)
    save_figure(figure, options.out / "stress.png")


if __name__ == "__main__":
    sys.exit(exit_status(main))
