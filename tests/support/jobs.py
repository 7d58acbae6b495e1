"""Small jobs that write files, to be killed and run again: data, sweep, training, frames.

python -m tests.support.jobs NAME FOLDER
"""

import io
import sys
from contextlib import redirect_stdout
from pathlib import Path

import numpy as np

import warp_peri
from tests.support.problems import kernel, lattice, manufactured
from tests.support.sheets import NEAREST, square, waves
from warp_peri.files.atomic import locked, whole_file


def data(folder):
    """The data tool on a small sheet, a small disk and nine of the loads."""
    import tools.make_graphene as tool
    from tools.loads import PatchLoad, RimLoad, WaveLoad

    tool.SHEET_CELLS, tool.DISK_RADIUS, tool.REACH = (8, 5), 65.0, 60.0
    tool.TRAINING = [WaveLoad(a, (p, 1)) for a in (0, 1) for p in range(3)]
    tool.VALIDATION = [PatchLoad(1, 0, 0, 8.0), PatchLoad(2, 1, 1, 5.0)]
    tool.TEST = [RimLoad(3)]
    tool.make_graphene(folder / "g.h5", jobs=1, progress=False)
    return ["g.h5"]


def problem(seed=0):
    return manufactured(kernel("positive", 2.5, lam=-0.2), lattice(5, 3.0), 5, seed=seed)


def sweep(folder):
    """Six fits and the choice."""
    from dataclasses import asdict

    from warp_peri.files.atomic import write_json
    from warp_peri.methods import sweep as run

    trials = run(
        problem(0), problem(1), folder / "fits", horizons=(2.0, 2.5), degrees=(0, 1, 2), jobs=1
    )
    write_json(folder / "choice.json", asdict(trials))
    return ["choice.json", *sorted(f"fits/{path.name}" for path in (folder / "fits").iterdir())]


def training(folder):
    """Algorithm 1, with a checkpoint."""
    from warp_peri import Bernstein
    from warp_peri.learning.fit import learn as fit
    from warp_peri.methods import TwoStage

    lengths = {"epochs": 100, "inner_epochs": 50, "outer_iterations": 12}
    stages = TwoStage(seed=3, checkpoint=folder / "state.npz", **lengths)
    learned = fit(problem(), 2.5, Bernstein(4), method=stages)
    learned.material.save(folder / "model.json")
    return ["model.json", "state.npz"]


def sheet(folder):
    """Frames of a sheet to its material: every fit is kept as it ends."""
    from warp_peri.cli.main import main
    from warp_peri.tissue import Dictionary, HyperelasticSolid, Term

    terms = (Term("plane_stress"), Term("mooney"))
    law = HyperelasticSolid(
        Dictionary(3.0, (), NEAREST, terms), np.array([0.1] * 4 + [0.35, 0.15]), 0.1
    )
    points = square(9)
    bent = points.x @ np.array([[0.3, 0.05], [0.0, 0.1]])
    with locked(folder / "frames"):
        for n in range(4):
            edge = bent * (n + 3) / 8 + 0.6 * waves(points, 0.25, n)
            u = warp_peri.solve(law, warp_peri.Dirichlet(points, None, edge)).u
            with whole_file(folder / "frames" / f"frame{n}.csv") as path:
                np.savetxt(
                    path, np.hstack([points.x, u]), delimiter=",", header="x,y,u,v", comments=""
                )
    line = ["dic", str(folder / "frames"), "--even", "--count", "4", "--json"]
    with redirect_stdout(io.StringIO()):
        assert main([*line, "--out", str(folder / "sheet")]) == 0
    names = ["dic.json", "curves.csv", "material.json", "material.feb"]
    fits = sorted(f"fits/{path.name}" for path in (folder / "sheet" / "fits").iterdir())
    return [f"sheet/{name}" for name in (*names, *fits)]


JOBS = {"data": data, "sweep": sweep, "training": training, "sheet": sheet}


def main(name, folder):
    print("imported", flush=True)
    print("\n".join(JOBS[name](Path(folder))), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
