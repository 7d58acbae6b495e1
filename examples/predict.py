"""A tolerance in, an answer with its error out: how often the error is right, against atoms.

Learns an ensemble from the main job's data and predicts problems that no constant of it saw, at
strains from 1 to 10 %. Makes the data it lacks with LAMMPS, once. Costs are prices of steps on
200² nodes, all placed and factorised before: those of an answer against the cheapest way that an
oracle knows to be within the tolerance, among elements, the linear answer, and its corrections.
Needs the extra `compare` for elements.
"""

import argparse
import json
import os
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # idle threads that wait count as processor time

import numpy as np
import torch

import warp_peri as wp
from examples.figures import headline, note, panels, save_figure
from examples.studies.fem_rival import elastic_solver
from examples.train_graphene import DATA, make_data
from tools.options import Options
from warp_peri.core.elastic import plane_isotropic
from warp_peri.errors import exit_status
from warp_peri.files.atomic import locked, write_json
from warp_peri.launch import set_threads
from warp_peri.methods import Smoothing
from warp_peri.prediction import Answer, Family, Members, PlacedMembers, strain

OUT = ROOT / "runs" / "predict"
TOLERANCES = (0.005, 0.01, 0.02, 0.05, 0.10)
LINE = (-30.0, -15.0, 0.0, 15.0, 30.0)
"""Strain is looked at where these cross [Å], if that is inside."""
FIRST = 0.01
"""Relative residual of the oracle's linear solves."""
LOOSE = 0.5
"""A tolerance that the linear answer keeps where costs are measured."""
HELD = (20, 41, 80)
"""Nodes a side of squares that are held at their collar."""
LARGE = 200
"""Nodes a side where costs are measured."""


def rich_law() -> wp.ThirdOrder:
    """The best law that this data bear."""
    return wp.ThirdOrder(wp.Micromodulus(15.0), Smoothing(10.0))


def ensemble(given: argparse.Namespace) -> Members:
    """The ensemble, learned once and kept in the folder of results."""
    path = given.out / "ensemble.json"
    if path.exists() and not given.refit:
        return wp.load(path)
    data = wp.load(given.data or make_data(-1, 10.0))
    material = wp.fit(data["train"], Family(rich_law()), validation=data["val"]).material
    wp.save(path, material)
    return material


def scenes(given: argparse.Namespace) -> dict[str, wp.Samples]:
    """Sets with truth from atoms, by name."""
    path = given.scenes or DATA.with_name("graphene_0K_scenes.h5")
    if not path.exists():
        from tools.make_scenes import make_scenes

        print("making scenes with LAMMPS (once)", file=sys.stderr)
        make_scenes(path)
    return dict(wp.load(path).sets)


def relative(u: np.ndarray, truth: np.ndarray, inside: np.ndarray) -> float:
    """Error of a displacement on the interior, over the displacement."""
    return float(np.linalg.norm((u - truth)[inside]) / np.linalg.norm(truth[inside]))


def timed(run: Callable[[], Any]) -> tuple[float, Any]:
    """Seconds of the processor, and what came out."""
    start = time.process_time()
    result = run()
    return time.process_time() - start, result


Solve = Callable[[np.ndarray, np.ndarray], np.ndarray]


def elements(samples: wp.Samples, truth: dict[str, float]) -> Solve:
    """Finite elements with the true constants, ready to solve for u on the interior."""
    return elastic_solver(samples, order=1, C=plane_isotropic(truth["lambda"], truth["mu"]))


def one_scene(
    placed: PlacedMembers, points: Any, b: np.ndarray, truth: np.ndarray, by_elements: Solve
) -> dict[str, Any]:
    """Errors and bars of one load, and the steps that they took."""
    inside = placed.points.interior
    problem = wp.Dirichlet(points, b, np.where(inside[:, None], 0.0, truth))
    found: dict[str, Any] = {"rms_gradient": placed.gradient(truth)}
    found["ways"] = ways(placed, problem, truth)
    u = truth.copy()
    u[inside] = by_elements(b, problem.u)
    found["ways"].append([{"elements": 1}, relative(u, truth, inside)])
    for tolerance in (*TOLERANCES, None):
        with counted(placed) as steps:
            answer: Any = wp.predict(placed, problem, tolerance)
        row = {"error": answer.error, "true": relative(answer.u, truth, inside)}
        row |= {"kept": answer.kept, "why": answer.why, "parts": answer.parts}
        row["steps"] = steps | {"linear": 1}
        found["best" if tolerance is None else f"{tolerance:g}"] = row
    first: Any = wp.predict(placed, problem, 1.0)
    found["strain"] = strains(first, truth)
    return found


@contextmanager
def counted(placed: PlacedMembers) -> Iterator[dict[str, int]]:
    """How often each step is gone, counted while an answer is made."""
    taken: dict[str, int] = {}
    wrapped = list[tuple[Any, str]]()

    def count(holder: Any, step: str, name: str) -> None:
        before, taken[name] = getattr(holder, step), 0

        def counting(*given: Any, **named: Any) -> Any:
            taken[name] += 1
            return before(*given, **named)

        vars(holder)[step] = counting
        wrapped.append((holder, step))

    for step in ("correction", "doubts"):
        count(placed, step, step)
    count(placed.spectrum, "shares", "record")
    try:
        yield taken
    finally:
        for holder, step in wrapped:
            del vars(holder)[step]


def ways(placed: PlacedMembers, problem: wp.Dirichlet, truth: np.ndarray) -> list[list[Any]]:
    """The linear answer, and after so many corrections: steps and true errors."""
    inside, found = placed.points.interior, []
    load = placed.load(problem.b)
    u = problem.u.copy()
    u[inside] = placed.inverse(load - placed.straight(u), FIRST)
    for number in range(6):
        found.append([{"linear": 1, "correction": number}, relative(u, truth, inside)])
        u[inside] += placed.correction(load, u)
    return found


def strains(answer: Answer, truth: np.ndarray) -> list[list[float]]:
    """Error of the strain of the linear answer and its correction, over its root mean square."""
    placed = answer.operator
    assert placed is not None
    at = np.stack(np.meshgrid(LINE, LINE), axis=-1).reshape(-1, 2)
    inside = placed.points.x[placed.points.interior]
    near = np.linalg.norm(inside[:, None] - at, axis=-1).min(axis=0) <= placed.points.spacing
    of = strain(placed.points, at[near])
    pick = (slice(None), [0, 1, 0], [0, 1, 1])
    exact, quantity = of(truth)[pick], answer.of(of)
    size = np.sqrt((exact**2).sum(axis=1).mean())
    wrong = (exact - quantity.value[pick]) / size
    return [wrong.ravel().tolist(), (quantity.correction[pick] / size).ravel().tolist()]


def costs(material: Members, truth: dict[str, float]) -> dict[str, Any]:
    """On 200² nodes: a correction over a linear solve, an answer at 1 % over a nonlinear solve,
    with and without what is set up once; and seconds of each step."""
    pad = 10
    x = 5.0 * np.argwhere(np.ones((LARGE + 2 * pad,) * 2)).astype(float)
    grid = np.rint(x / 5).astype(int) - pad
    inside = np.asarray(((grid >= 0) & (grid < LARGE)).all(axis=1))
    points = wp.Points(x, inside, 5.0, axis=0.0)
    k = np.array([[0.02, 0.01], [-0.008, 0.024]])
    b, given = 1e-4 * np.cos(x @ k), 0.5 * np.sin(x @ k)
    problem = wp.Dirichlet(points, b, given)

    def fastest(run: Callable[[], Any], rounds: int = 4) -> float:
        return min(timed(run)[0] for _ in range(rounds))

    def one_answer() -> Any:
        return wp.predict(material, problem, 0.01)

    placed, nonlinear = material.with_doubts(points), material.on(points)
    answer: Any = wp.predict(placed, problem, 0.01)
    u, load, start = answer.u, placed.load(b), np.where(inside[:, None], 0.0, given)
    left, right = placed.correction(load, u), load - placed.straight(start)
    linear = start.copy()
    linear[inside] = placed.inverse(right, FIRST)
    by_elements = elements(wp.Samples(points, given[None], b[None]), truth)

    steps = {
        "linear": lambda: placed.inverse(right, FIRST),
        "correction": lambda: (placed.correction(load, linear), placed.gradient(linear)),
        "record": lambda: placed.recorded(u),
        "doubts": lambda: placed.doubts(u, left),
        "elements": lambda: by_elements(b, given),
        "loose": lambda: wp.predict(placed, problem, LOOSE),
    }
    loose: Any = steps["loose"]()
    assert loose.why.startswith("linear;"), loose.why
    rounds = [{name: fastest(run, 2) for name, run in steps.items()} for _ in range(10)]
    prices = {name: min(one[name] for one in rounds) for name in steps}  # each as often disturbed
    own = prices.pop("loose")
    known = sum(prices[name] for name in ("linear", "correction", "record"))
    prices["else"] = max(own - known, 0.0)
    with warnings.catch_warnings(action="ignore"):
        solved = fastest(lambda: wp.solve(material.linear.on(points), problem), 2)
        whole = fastest(lambda: wp.solve(nonlinear, problem), 3)
        anew = fastest(lambda: wp.solve(material, problem), 2)
    return {
        "correction": prices["correction"] / solved,
        "answer": fastest(lambda: wp.predict(placed, problem, 0.01)) / whole,
        "answer_with_setting_up": fastest(one_answer, 2) / anew,
        "loose_answer_over_linear_solve": own / prices["linear"],
        "linear_solve_seconds": solved,
        "nonlinear_solve_seconds": whole,
        "prices": prices,
    }


def clamped(material: Members) -> dict[str, Any]:
    """Squares that are held or bent at their collar, against the rich member solved: no data have
    such edges. Errors that are told over true ones, of answers at four tolerances."""
    ratios = []
    for side in HELD:
        x = 5.0 * np.argwhere(np.ones((side + 20,) * 2)).astype(float)
        middle, span = x.mean(axis=0), 5.0 * side
        inside = (np.abs(x - middle) < span / 2).all(axis=1)
        points, s = wp.Points(x, inside, 5.0, axis=0.0), (x - middle) / span
        push, none = material.linear.moduli()["C44"] * 0.05 / span, np.zeros_like(x)
        wave, bump = np.cos(2 * np.pi * s), np.exp(-(s**2).sum(axis=1, keepdims=True) / 0.04)
        turned = 0.01 / 6 * span * np.sin(2 * np.pi * s[:, ::-1])
        loads = (push * np.eye(2)[[0] * len(x)], push * wave, push * bump * [0, 1], none)
        for b, given in zip(loads, (none, none, none, turned)):
            problem = wp.Dirichlet(points, b, given)
            truth = wp.solve(material.rich, problem).u
            for tolerance in TOLERANCES[1:]:
                answer: Any = wp.predict(material, problem, tolerance)
                ratios.append(answer.error / relative(answer.u, truth, inside))
    return {"answers": len(ratios), "coverage": float(np.mean(np.array(ratios) >= 1))} | spread(
        ratios
    )


def price(steps: dict[str, int], prices: dict[str, float]) -> float:
    """Seconds of so many steps of each kind."""
    return sum(number * prices[name] for name, number in steps.items())


def over_oracle(
    row: dict[str, Any], told: dict[str, Any], tolerance: float, prices: dict[str, float]
) -> float | None:
    """Price of an answer over that of the cheapest way that is truly within the tolerance."""
    good = [price(steps, prices) for steps, true in row["ways"] if true <= tolerance]
    if not (told["kept"] and good):
        return None
    return (price(told["steps"], prices) + prices["else"]) / min(good)


def summary(rows: list[dict[str, Any]], prices: dict[str, float]) -> dict[str, Any]:
    """What the error is worth, over all scenes."""
    numbers: dict[str, Any] = {"scenes": len(rows), "tolerances": {}, "oracle": {}}
    numbers["oracle_mean"] = {}
    ratios = []
    for tolerance in TOLERANCES:
        told = [row[f"{tolerance:g}"] for row in rows]
        ratio = [one["error"] / one["true"] for one in told]
        ratios += ratio
        kept = [one for one in told if one["kept"]]
        easy = [one for one, row in zip(told, rows) if row["best"]["true"] <= tolerance / 2]
        numbers["tolerances"][f"{tolerance:g}"] = {
            "scenes": len(told),
            "kept": len(kept),
            "true": sum(one["true"] <= tolerance for one in kept),
            "coverage": float(np.mean(np.array(ratio) >= 1)),
            "within_half": len(easy),
            "of_them_kept": sum(one["kept"] for one in easy),
            "median": float(np.median(ratio)),
            "smallest": float(np.min(ratio)),
        }
        over = [over_oracle(row, one, tolerance, prices) for one, row in zip(told, rows)]
        known = [ratio for ratio in over if ratio is not None]
        numbers["oracle"][f"{tolerance:g}"] = float(np.median(known)) if known else None
        numbers["oracle_mean"][f"{tolerance:g}"] = float(np.mean(known)) if known else None
    best = [row["best"]["error"] / row["best"]["true"] for row in rows]
    numbers["best"] = {"coverage": float(np.mean(np.array(best) >= 1)), **spread(best)}
    numbers["coverage"] = float(np.mean(np.array(ratios) >= 1))
    numbers["bar_over_true"] = spread(ratios)
    wrong, corrected = (np.concatenate([row["strain"][n] for row in rows]) for n in (0, 1))
    seen = np.abs(wrong) > 0.01
    share = corrected[seen] / wrong[seen]
    numbers["strain"] = {
        "within": float(np.mean((share > 0.8) & (share < 1.2))),
        "corrected_over_first": float(np.linalg.norm(wrong - corrected) / np.linalg.norm(wrong)),
    }
    return numbers


def spread(ratios: list[float]) -> dict[str, float]:
    """Median and smallest."""
    return {"median": float(np.median(ratios)), "smallest": float(np.min(ratios))}


def draw(path: Path, rows: list[dict[str, Any]], answer: Answer) -> None:
    """What was said against what is true; and where one answer is likely wrong."""
    figure, (left, right) = panels(8.4, 4, count=2)
    for name, mark in (("0.01", "o"), ("best", ".")):
        pairs = np.array([[row[name]["true"], row[name]["error"]] for row in rows])
        left.loglog(*100 * pairs.T, mark, ms=4, alpha=0.6, label={"best": "best"}.get(name, "1 %"))
    left.axline((0.1, 0.1), (1, 1), color="k", lw=0.8)
    note(left, "both alike", (0.2, 0.2), (4, -8))
    left.set(
        xlabel="true error [%]", ylabel="likely error [%]", title="Unseen problems, each a dot"
    )
    left.set_aspect("equal", "datalim")
    left.legend(title="tolerance", frameon=False)
    answer.plot(ax=right)
    right.set_title("Where one answer is likely wrong")
    told = [row[key] for row in rows for key in ("0.01", "best")]
    above = sum(one["error"] >= one["true"] for one in told)
    headline(figure, f"{above} of {len(told)} likely errors are no smaller than the true ones")
    right.set(xlabel="x [Å]", ylabel="y [Å]")
    save_figure(figure, path, dpi=150, bbox_inches=None)


def run(given: argparse.Namespace) -> dict[str, Any]:
    """Every scene; what metrics.json holds."""
    set_threads(1)
    torch.set_num_threads(1)
    material = ensemble(given)
    truth = wp.load(given.data or make_data(-1, 10.0)).provenance["truth"]
    cost, rows, shown = costs(material, truth), [], None
    for name, samples in scenes(given).items():
        placed = material.with_doubts(samples.points)
        by_elements = elements(samples, truth)
        for number, (b, exact) in enumerate(zip(samples.loads, samples.u)):
            found = one_scene(placed, samples, b, exact, by_elements)
            rows.append({"scene": f"{name} {number}"} | found)
        if shown is None or name == "disk_5":
            shown = wp.predict(placed, wp.Dirichlet(samples, samples.loads[0], samples.u[0]), 0.02)
        print(name, file=sys.stderr)
    assert isinstance(shown, Answer)
    draw(given.out / "predict.png", rows, shown)
    factors = {"factors": vars(material.factors)}
    held = {"clamped": clamped(material)}
    return summary(rows, cost["prices"]) | held | {"cost": cost} | factors | {"rows": rows}


def main(arguments: list[str] | None = None) -> int:
    parser = Options(__doc__, json=True)
    parser.add("--data", type=Path, help="the main job's data (made if not there)")
    parser.add("--scenes", type=Path, help="scenes with truth (made if not there)")
    parser.add("--refit", action="store_true", help="learn the ensemble anew")
    parser.add("--out", type=Path, default=OUT, help="folder for the results")
    tell(parser.parse_args(arguments), run)
    return 0


def tell(given: argparse.Namespace, run: Callable[[argparse.Namespace], dict[str, Any]]) -> None:
    """Run, keep the numbers in metrics.json, and print them but for the rows."""
    with locked(given.out), warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="strain:")
        given.out.mkdir(parents=True, exist_ok=True)
        numbers = run(given)
        write_json(given.out / "metrics.json", numbers)
    told = {name: value for name, value in numbers.items() if name != "rows"}
    print(json.dumps(told) if given.json else json.dumps(told, indent=2))


if __name__ == "__main__":
    sys.exit(exit_status(main))
