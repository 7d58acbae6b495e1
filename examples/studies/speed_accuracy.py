"""Error against time to solution: learned models, their rivals and the atoms themselves.

    python examples/studies/speed_accuracy.py [--data FILE.h5] [--out runs/speed_accuracy]
    python examples/studies/speed_accuracy.py --again       # draws what is there
    python examples/studies/speed_accuracy.py --late predict    # measures some rows later

Errors are E_u on the held-out disks, on disks of 1 to 10 % of bond strain, and on periodic loads of
high frequency whose wave vectors no fit saw: of the training waves (p, q) those with odd p + q are
held out, and of these the shorter half counts. Set-up and solve are timed apart, the best of
several; the solve is that of one load, and a hundred are timed with the set-up. All rows are of one
run, fits included: an output folder that has some is refused without --again. With --late what
speed_accuracy.json beside this file lacks of elements and of some kinds is put into it: seconds of
a processor, over the ratio by which its other elements take longer than there.
Nodes 4 Å apart come from the samples that the data set was made from. Needs the extras `compare`
for finite elements and `bench` for Numba.
"""

import functools
import importlib.util
import json
import os
import platform
import re
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from datetime import date
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent.parent))

import numpy as np
import torch

from examples.local_elasticity import local_solver, moduli_of, potential_constants
from examples.studies import speed_laws
from examples.studies.fem_rival import elastic_solver
from examples.studies.speed_chart import chart, markdown, training_chart
from examples.studies.speed_laws import (
    MANY,
    by_cg,
    by_lu,
    by_numba,
    by_scipy,
    hundred,
    positive_model,
    smooth_error,
    timed,
)
from tools import make_graphene as making
from tools import samples
from tools.options import Options
from warp_peri import LPS, Bernstein, InputError, Model, Points, Samples, fit, load
from warp_peri.core.elastic import plane_isotropic
from warp_peri.errors import exit_status
from warp_peri.files.atomic import whole_file, write_json
from warp_peri.methods import Optimum
from warp_peri.transfer.lattice import agrees_to
from warp_peri.transfers import on_lattice

DEGREE = 10
CASES = (
    *((5.0, horizon, DEGREE, "LPS") for horizon in (12.5, 15.0, 20.0, 25.0)),
    (4.0, 16.0, DEGREE, "LPS"),
    (2.5, 12.5, DEGREE, "LPS"),
    (5.0, 20.0, DEGREE, "positive kernel"),
    (5.0, 20.0, 0, "λ, μ, α only"),
)
"""Spacing and horizon [Å], degree, and kind of the models."""
USUAL = (5.0, 20.0, DEGREE, "LPS")
TABLE = Path(__file__).with_suffix(".json")
RICH = {"transferred from δ = 25": (5.0, 25.0, 15, "rich")}
"""A model that cheaper ones are fitted to, isotropic at long waves for the smooth loads."""
TRANSFERS = (
    *(("transferred", h, d) for h, d in ((2.5, None), (4.0, None), (7.5, 22.5), (10.0, 25.0))),
    *((kind, 5.0, d) for kind in RICH for d in (12.5, 15.0, 20.0)),
    *((kind, h, None) for kind in RICH for h in (4.0, 2.5)),
)
"""Kind, spacing and horizon (None for the fewest bonds within the tolerance)."""
SUFFIX = {5.0: "", 4.0: "_four", 2.5: "_fine", 7.5: "_coarse", 10.0: "_coarsest"}
MADE = (4.0, 7.5, 10.0)
"""Spacings [Å] that the data file does not hold."""
SCENES = "graphene_0K_scenes.h5"
LEVELS = (0.005, 0.01, 0.02, 0.05)
"""Of agreement with the model at home, by wavelength."""
SLOW, SLOWER = ("numba", "network"), ("bent",)
"""Methods that smooth and a hundred loads, and a hundred alone, are not waited for with."""


def waves(points: Samples) -> np.ndarray:
    """Wave numbers (p, q) of the periodic samples, shape [S, 2], from their load ids."""
    ids = [str(load) for load in points.arrays["load_id"]]
    return np.array([[int(n) for n in re.findall(r"\d+", load)[-2:]] for load in ids])


def held_out(points: Samples) -> np.ndarray:
    """Samples that no fit sees."""
    return waves(points).sum(axis=1) % 2 == 1


def high(points: Samples) -> np.ndarray:
    """The shorter half of the waves held out."""
    size = np.hypot(*waves(points).T)
    out = held_out(points)
    return np.flatnonzero(out & (size >= np.median(size[out])))


def wavelengths(points: Samples) -> dict[str, float]:
    """Shortest wave [Å] of the short set, and the shortest of the waves left out of it."""
    period = float(np.ptp(points.x, axis=0).max()) / 2  # nodes reach a period to both sides
    size = np.hypot(*waves(points).T)
    short = size[high(points)]
    return {"short_wave": period / short.max(), "long_wave": period / short.min()}


def point_sets(file: Path) -> tuple[dict[str, Samples], dict[str, float]]:
    """The sets of the data file and those on nodes 4 Å apart, and the true λ and μ [TPa]."""
    data = load(file)
    sets = dict(data.sets)
    for name in ("train", "val", "test"):
        samples = making.read_samples(file.with_suffix(".cache"), name)
        for h in MADE:
            sets[name + SUFFIX[h]] = making.point_set(*samples, spacing=h)
    truth = data.provenance["truth"]
    return sets, {"lam": truth["lambda"], "mu": truth["mu"]}


def fitted(
    data: dict[str, Samples], out: Path, spacing: float, horizon: float, degree: int, kind: str
) -> Model:
    """The constrained optimum on the waves that are not held out; kept in a file."""
    names = {"positive kernel": "_positive", "rich": "_isotropic"}
    file = out / f"h{spacing:g}_d{horizon:g}_M{degree}{names.get(kind, '')}.json"
    if file.exists():
        return load(file)
    start = time.perf_counter()
    train = seen(data["train" + SUFFIX[spacing]])
    if kind == "positive kernel":
        model = positive_model(train, horizon=horizon, degree=degree)
    else:
        method = Optimum(moduli="isotropic" if kind == "rich" else None)
        model = fit(train, LPS(horizon, Bernstein(degree), method)).material
    SECONDS[file.stem] = time.perf_counter() - start
    model.save(file)
    return load(file)


SECONDS: dict[str, float] = {}
"""Of the fits of this run, by the names of their files."""


def seen(train: Samples) -> Samples:
    """The waves that fits see."""
    some = ~held_out(train)
    return Samples(train.points, train.u[some], train.loads[some])


def transfers(
    data: dict[str, Samples], out: Path
) -> Iterator[tuple[tuple[float, float, int], str, Model]]:
    """Spacing, horizon and degree, kind, and model of each transfer."""
    for kind, spacing, horizon in TRANSFERS:
        home = fitted(data, out, *RICH.get(kind, USUAL))
        model = on_lattice(home, spacing=spacing, horizon=horizon)
        yield (spacing, model.horizon, model.degree), kind, model


def agreement(model: Model) -> list[list[float]]:
    """Levels, and the lengths [Å] beyond which a transfer agrees with home to them."""
    record = model.provenance["transfer"]
    length, error = np.array(record["wavelength"]), np.array(record["error"])
    pairs = ((level, agrees_to(length, error, level)) for level in LEVELS)
    return [[level, wave] for level, wave in pairs if wave is not None]


def atoms() -> dict[str, Any]:
    """The row of the molecular model itself, whose errors are none."""
    row = {"label": "atoms (LAMMPS, Newton)", "kind": "atoms", "method": "atoms"}
    exact = {f"{name}_error": 0.0 for name in ("disks", "smooth", "waves")}
    return {**row, "spacing": 0.0, "horizon": 0.0, **exact, **molecular()}


def molecular() -> dict[str, float]:
    """Seconds of the atoms for disk and sheet: relaxing and factorising once, then one load."""
    seconds_of: dict[str, float] = {}
    sheet, disk = making.graphene_bodies()
    cases: dict[str, tuple[Any, Any]] = {
        "disks": (disk, making.TEST),
        "waves": (sheet, making.TRAINING),
    }
    for name, (body, loads) in cases.items():
        seconds = []
        for some in (loads[:1], loads[1:4]):  # a process sets a body up once, for the first load
            with tempfile.TemporaryDirectory() as folder:
                start = time.perf_counter()
                making.solve_samples(body, list(some), Path(folder))
                seconds.append(time.perf_counter() - start)
        each = seconds[1] / 3
        if name == "disks":
            with tempfile.TemporaryDirectory() as folder:
                start = time.perf_counter()
                samples._statics.cache_clear()
                making.solve_samples(
                    body, [loads[n % len(loads)] for n in range(MANY)], Path(folder)
                )
                seconds_of["hundred"] = time.perf_counter() - start
        seconds_of |= {f"{name}_solve": each, f"{name}_setup": max(seconds[0] - each, 0.0)}
    return seconds_of


def line(row: dict[str, Any]) -> str:
    """A row as it is printed while the next is measured."""
    return (
        f"{row['label']:42} {100 * row['disks_error']:7.2f} % {100 * row['waves_error']:7.2f} %  "
        f"set-up {1e3 * row['disks_setup']:8.1f} ms  solve {1e3 * row['disks_solve']:8.2f} ms"
    )


def measure(
    data: dict[str, Samples],
    truth: dict[str, float],
    out: Path,
    file: Path,
    *,
    late: Sequence[str] | None = None,
) -> list[dict[str, Any]]:
    """One row for each model, precision and solver; with `late` elements and rows of these kinds
    of speed_laws alone, by the clock of the processor."""
    clock = time.perf_counter if late is None else time.process_time
    rows: list[dict[str, Any]] = []
    strained = functools.cache(
        lambda spacing: speed_laws.strained_disks(file.with_name(SCENES), spacing)
    )

    def add(
        label: str,
        kind: str,
        case: tuple[float, float, int],
        method: str,
        prepare: Any,
        **more: Any,
    ) -> None:
        spacing, horizon, degree = case
        row: dict[str, Any] = {"label": label, "kind": kind, "spacing": spacing}
        row |= {"horizon": horizon, "method": method, "degree": degree}
        row["disks_nodes"] = int(np.count_nonzero(data["test" + SUFFIX[spacing]].interior))
        for name, group in (("disks", "test"), ("waves", "train")):
            points = data[group + SUFFIX[spacing]]
            chosen = np.arange(len(points)) if name == "disks" else high(points)
            rounds = 1 if method in SLOW + SLOWER else 3
            record = timed(functools.partial(prepare, points), points, chosen, rounds, clock)
            row |= {f"{name}_{key}": value for key, value in record.items()}
        disks = data["test" + SUFFIX[spacing]]
        if method not in SLOW:
            row["smooth_error"] = smooth_error(data["val" + SUFFIX[spacing]], prepare)
            if method not in SLOWER:
                stack, how = method in ("rest", "predict"), functools.partial(prepare, disks)
                row["hundred"] = hundred(how, disks, stack=stack, clock=clock)
            if late is None:  # these disks are made by LAMMPS
                row["strained"] = [
                    [size, smooth_error(points, prepare)] for size, points in strained(spacing)
                ]
        rows.append(row | more)
        print(line(row), flush=True)

    def others(kinds: Sequence[str] | None = None) -> None:
        """Rows of speed_laws, of some kinds."""
        train = data["train"]
        for label, kind, horizon, method, prepare, seconds in speed_laws.rows(
            seen(train), data["val"], kinds
        ):
            count = len(train) if kind == "neural operator" else len(seen(train))
            more = {"fit_seconds": seconds, "loads": count}
            add(label, kind, (5.0, horizon, DEGREE), method, prepare, **more)

    if late is not None:
        elements(add, truth, fitted(data, out, *USUAL))
        others(late)
        return rows
    for spacing, horizon, degree, kind in CASES:
        before = set(SECONDS)
        model = fitted(data, out, spacing, horizon, degree, kind)
        case, name = (spacing, horizon, degree), f"{kind}, h = {spacing:g}, δ = {horizon:g}"
        trained = {"fit_seconds": sum(SECONDS[key] for key in set(SECONDS) - before)}

        def use(how: Any, model: Model = model) -> Any:
            return lambda points: how(model, points)

        number = {"loads": int((~held_out(data["train"])).sum())} | trained
        add(f"{name}, LU", kind, case, "lu", use(by_lu(np.float64)), **number)
        if kind == "LPS" and (horizon == 20 or spacing == 2.5):
            for method, said in (("cg", "CG"), ("fft", "FFT-CG"), ("multigrid", "multigrid-CG")):
                add(f"{name}, {said}", kind, case, method, use(by_cg(method)))
        if kind == "LPS" and horizon == 20:
            add(f"{name}, LU float32", kind, case, "lu32", use(by_lu(np.float32)))
            add(f"{name}, SciPy CSR and CG", kind, case, "scipy", use(by_scipy))
            if importlib.util.find_spec("numba"):
                add(f"{name}, Numba sweeps and CG", kind, case, "numba", use(by_numba))
    for case, kind, model in transfers(data, out):
        name = f"{kind}, h = {case[0]:g}, δ = {case[1]:.3g}"
        solver = functools.partial(by_lu(np.float64), model)
        add(f"{name}, LU", kind, case, "lu", solver, agrees=agreement(model))
    elements(add, truth, fitted(data, out, *USUAL))
    others()
    start = time.perf_counter()
    two = fit(
        speed_laws.two_loads(file.with_suffix(".cache")),
        LPS(20.0, Bernstein(DEGREE), Optimum(moduli=None)),
    )
    more = {"fit_seconds": time.perf_counter() - start, "loads": 2}
    how = functools.partial(by_lu(np.float64), two.material)
    add(
        "LPS from two designed loads, h = 5, δ = 20, LU",
        "designed",
        (5.0, 20.0, DEGREE),
        "lu",
        how,
        **more,
    )
    rows.append(atoms())
    return rows


def elements(add: Callable[..., None], truth: dict[str, float], learned: Model) -> None:
    """Rows of local elasticity, linear and of third order: elements on the nodes, and so fine that
    no mesh errs."""
    true, third = plane_isotropic(truth["lam"], truth["mu"]), potential_constants()
    for label, spacing, order in (
        ("FEM Q1, h = 5, true constants", 5.0, 1),
        ("FEM Q1, h = 2.5, true constants", 2.5, 1),
        ("FEM Q2, elements of 5 Å on the nodes of 2.5 Å", 2.5, 2),
    ):
        how = functools.partial(elastic_solver, order=order, C=true)
        add(label, f"FEM Q{order}", (spacing, 0.0, order), f"Q{order}", how)
    for label, C in (("true moduli", true), ("learned moduli", moduli_of(learned, 5.0))):
        how = functools.partial(local_solver, C=C)
        add(f"local elasticity, {label}", "local elasticity", (5.0, 0.0, 2), "local", how)
    for label, how in (
        ("FEM Q1, h = 5", functools.partial(elastic_solver, order=1, C=true, third=third)),
        ("quadratic elements of 2.5 Å", functools.partial(local_solver, C=true, third=third)),
    ):
        add(f"local third order, {label}", "local third order", (5.0, 0.0, 1), "bent", how)


SECONDS_OF = "disks_setup", "disks_solve", "waves_setup", "waves_solve", "hundred"


def beside(rows: list[dict[str, Any]], told: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Rows of a table, and after its elements those measured later that it lacks.

    Seconds of these are over `slower`, the median ratio of those of rows that both have.
    """
    known = {row["label"]: number for number, row in enumerate(rows)}
    both = [(row, rows[known[row["label"]]]) for row in told if row["label"] in known]
    ratios = [row[key] / old[key] for row, old in both for key in SECONDS_OF if key in old]
    slower = float(np.median(ratios))
    new = [
        row | {key: row[key] / slower for key in SECONDS_OF if key in row} | {"slower": slower}
        for row in told
        if row["label"] not in known
    ]
    place = 1 + max(known[row["label"]] for row, _ in both)
    return [*rows[:place], *new, *rows[place:]]


def machine() -> dict[str, str]:
    """What this ran on."""
    names = {
        "processor": platform.processor() or platform.machine(),
        "python": platform.python_version(),
    }
    cpu = Path("/proc/cpuinfo")
    if cpu.exists():
        found = re.search(r"model name\s*:\s*(.+)", cpu.read_text())
        names |= {"processor": found[1]} if found else {}
    return names | {
        "cores": str(os.cpu_count()),
        "numpy": np.__version__,
        "torch": torch.__version__,
    }


def seconds_per_node(model: Model, side: int = 500) -> dict[str, float]:
    """Set-up and solve of a large square and a large disk, over their unknown nodes."""
    costs = {}
    line = np.arange(side) - (side - 1) / 2
    disk = line[:, None] ** 2 + line**2 <= (side / 2) ** 2
    pad = 2 * int(np.ceil(model.horizon / model.certified_on[0]))
    for method, mask in (("sine", np.ones_like(disk)), ("multigrid", disk)):
        mask = np.pad(mask, pad)
        x = model.certified_on[0] * np.argwhere(np.ones_like(mask)).astype(float)
        noise = np.random.default_rng(0).normal(size=(2, 1, len(x), 2))
        points = Samples(Points(x, mask.ravel(), model.certified_on[0]), *noise)
        record = timed(functools.partial(by_cg(method), model, points), points, np.arange(1))
        costs[method] = (record["setup"] + record["solve"]) / int(mask.sum())
    return costs


def main(arguments: list[str] | None = None) -> int:
    parser = Options(__doc__)
    parser.add("--data", type=Path, default=Path("data/graphene_0K.h5"))
    parser.add("--out", type=Path, default=Path("runs/speed_accuracy"))
    parser.add("--again", action="store_true", help="draw what is there once more")
    parser.add("--late", nargs="+", metavar="KIND", help="rows that the table beside this lacks")
    given = parser.parse_args(arguments)
    given.out.mkdir(parents=True, exist_ok=True)
    table = given.out / "speed_accuracy.json"
    if given.again:
        content = json.loads(table.read_text(encoding="utf-8"))
        rows = content["rows"]
    elif given.late is not None:
        data, truth = point_sets(given.data)
        content = json.loads(TABLE.read_text(encoding="utf-8"))
        told = measure(data, truth, given.out, given.data, late=given.late)
        content["rows"] = rows = beside(content["rows"], told)
        content["later"] = {"date": f"{date.today()}"} | machine()
        write_json(table, content)
    else:
        if list(given.out.glob("h*.json")):
            raise InputError(f"{given.out}: expected a folder without fits, so that all are timed")
        data, truth = point_sets(given.data)
        rows = measure(data, truth, given.out, given.data)
        large = seconds_per_node(fitted(data, given.out, *USUAL))
        content = {"rows": rows, **wavelengths(data["train"]), "seconds_per_node": large}
        write_json(table, content | {"machine": machine()})
    chart(rows, given.out / "speed_accuracy.png")
    training_chart(rows, given.out / "training_cost.png")
    with whole_file(given.out / "speed_accuracy.md") as path:
        Path(path).write_text(markdown(rows), encoding="utf-8")
    print(markdown(rows))
    return 0


if __name__ == "__main__":
    sys.exit(exit_status(main))
