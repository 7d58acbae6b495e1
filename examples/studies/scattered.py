"""Learn graphene from fields on scattered nodes, through Warp's operator, and predict the disks.

The training samples of the main job, smoothed at randomly perturbed nodes: all of them on one
set of nodes, or each on its own. Scattered points have no symbol and no reduced loss; the full loss
is minimised by the two stages of Algorithm 1, the conditions kept on the lattice of the disks.
"""

import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent.parent))

import numpy as np

import warp_peri as wp
from examples.train_graphene import DATA, make_data
from tools.graphene import THICKNESS
from tools.make_graphene import INTERIOR, REACH, SMOOTHING_RADIUS, read_samples
from tools.options import Options
from warp_peri import Bernstein, Points, Samples
from warp_peri.errors import exit_status
from warp_peri.files.atomic import write_json
from warp_peri.learning.fit import learn as fit
from warp_peri.methods import TwoStage

SPACING = 5.0


def scattered_sets(perturbation: float, seed: int, *, own_nodes: bool) -> list[Samples]:
    """The 70 training samples on perturbed nodes.

    `perturbation`: largest shift of a node along each axis, in spacings; `seed`: of the shifts;
    `own_nodes`: give every sample nodes of its own.
    """
    body, _, samples = read_samples(DATA.with_suffix(".cache"), "train")
    random = np.random.default_rng(seed)
    line = np.arange(-REACH, REACH + SPACING / 2, SPACING)
    lattice = np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1).reshape(-1, 2)
    interior = (np.abs(lattice) <= INTERIOR).all(axis=1)
    sets = []
    for some in [[sample] for sample in samples] if own_nodes else [samples]:
        x = lattice + SPACING * perturbation * random.uniform(-1, 1, size=lattice.shape)
        omega = wp.atoms.smoothing_matrix(
            some[0].reference, x, radius=SMOOTHING_RADIUS, box=body.box, density=True
        )
        u, b = wp.atoms.coarse_grain(
            omega,
            displacement=np.stack([sample.displacement for sample in some]),
            force=np.stack([sample.force for sample in some]),
            node_area=1.0,
            thickness=THICKNESS,
        )
        sets.append(Samples(Points(x, interior, 0.0), u, b))
    return sets


def main(arguments: list[str] | None = None) -> int:
    parser = Options(__doc__, "scattered")
    parser.add("--horizon", type=float, default=20.0, help="δ [Å]")
    parser.add("--degree", type=int, default=10, help="M")
    parser.add("--perturbation", type=float, default=0.2, help="in spacings")
    parser.add("--own-nodes", action="store_true", help="each sample on its own nodes")
    parser.add("--seed", type=int, default=0)
    parser.add("--jobs", type=int, default=-1, help="processes for LAMMPS; -1: all cores")
    given = parser.parse_args(arguments)
    data = wp.load(make_data(given.jobs, SMOOTHING_RADIUS))
    sets = scattered_sets(given.perturbation, given.seed, own_nodes=given.own_nodes)
    begin = time.perf_counter()
    learned = fit(
        sets,
        horizon=given.horizon,
        kernel=Bernstein(given.degree),
        method=TwoStage(
            seed=given.seed, checkpoint=given.out / "stage2.npz", lattice_spacing=SPACING
        ),
        progress=True,
    )
    seconds = time.perf_counter() - begin
    errors = {
        name: wp.evaluate(learned.material, data[name], allow_uncertified=True)["E_u"]
        for name in ("train", "val", "test")
    }
    learned.material.save(given.out / "model.json")
    stages = {stage.name: stage.E_res_train for stage in learned.history}
    content = {"E_u": errors, "E_res_train": stages, "seconds": seconds}
    content |= {"lambda": learned.material.lam, "mu": learned.material.mu}
    write_json(given.out / "scattered.json", content)
    for name, value in stages.items():
        print(f"stage {name}: E_res on the scattered nodes {100 * value:.2f} %")
    print("E_u on the lattice: " + ", ".join(f"{k} {100 * v:.2f} %" for k, v in errors.items()))
    print(f"λ = {learned.material.lam:.4f} TPa, μ = {learned.material.mu:.4f} TPa, {seconds:.0f} s")
    return 0


if __name__ == "__main__":
    sys.exit(exit_status(main, "stage 2 goes on where it was with the next run"))
