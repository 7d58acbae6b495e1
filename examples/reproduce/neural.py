"""Jafarzadeh et al. (2024), computed: errors of the shipped networks and of other materials.

    python examples/reproduce/neural.py graphene leaflet      (default: every table)
    python examples/reproduce/neural.py train hgo_3 --epochs 300

The first prints tables as Markdown; docs/record/neural.json has what came out. The second trains a
network of the printed widths from a fresh start, or from where a stopped training left off.
"""

import lzma
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import spsolve

import warp_peri as wp
from examples.exact import relative_error
from examples.prose import Table, print_tables, printed
from tools import hyperelastic_energies as energies
from tools.hyperelastic_elements import Elements, NotSolved, finite_elements
from tools.hyperelastic_energies import Energy, Family
from tools.make_hgo import DISK_RADIUS, HORIZON, NODES, SPACING, SQUARES, make_hgo
from tools.make_leaflet import make_leaflet
from tools.options import Options, check_new
from warp_peri import Dataset, InputError, Points, Samples, hyperelastic
from warp_peri.errors import exit_status
from warp_peri.materials.hyperelastic.energies import NEAREST, half_family
from warp_peri.neural import EquilibriumSolver, NeuralOperator, TrainingSettings, evaluate, train
from warp_peri.points.arguments import Count

WEIGHTS, DATA = ROOT / "examples" / "neural_weights", ROOT / "data"
EXPERIMENTS = ("graphene", "hgo_3", "hgo_4", "hgo_5", "leaflet")
"""Names of trainings; of the sheet by the horizon in spacings."""
SETS = ("train", "val", "test", "disks")
LEVELS, LEARNED, CHOSEN, EVERY, REACH = 20, 100, 20, 10, 5
"""Frames of each of the leaflet's protocols; frames to learn from and to choose by; one in so many
that materials other than networks are fitted on; spacings of its horizon."""
MATRIX = (hyperelastic.EnergyTerm("neo_hookean"), hyperelastic.EnergyTerm("volumetric"))
SHEET = (*MATRIX, hyperelastic.EnergyTerm("plane_stress"), hyperelastic.EnergyTerm("mooney"))
BONDS = (MATRIX[0], hyperelastic.EnergyTerm("fibre_power", exponent=2.0))
"""Energies of bonds: s − ½ ln(1 + 2 s) and ⟨s⟩²/2, times 2 and 4."""

Sets = dict[str, Samples]


# Data


def sets_of(name: str, *, mirror: bool = False, jobs: int = -1, folder: Path = DATA) -> Sets:
    """The samples of an experiment, made where they are not there yet."""
    if name == "graphene":
        data: Dataset = wp.load(folder / "graphene_0K.h5")
        return {"train": data["train"], "val": data["val"], "disks": data["test"]}
    if name == "leaflet":
        return leaflet(folder / "leaflet", jobs)
    return hgo(folder / "hgo", int(name[-1]), mirror, jobs)


def hgo(folder: Path, reach: int, mirror: bool, jobs: int) -> Sets:
    """Squares and disks of an anisotropic sheet, for a horizon of so many spacings.

    Without the mirror rule equations hold at the nodes whose surroundings are data: 81 in squares
    of 21, 25 and 29 nodes a side for 3, 4 and 5 spacings; disks shrink. With it the squares have
    21, and equations hold at all inner nodes.
    """
    square = "square" if mirror else next(name for name, n in SQUARES.items() if n == reach)
    made = make_hgo(folder, square=square, jobs=jobs, progress=False)
    disks = made.pop("disks")
    radius = DISK_RADIUS + 2 * (HORIZON - reach) * SPACING
    inner: np.ndarray = np.hypot(*disks.x.T) <= radius + 1e-9
    squares = {k: mirrored(s, reach) if mirror else s for k, s in made.items()}
    return squares | {"disks": replace(disks, points=replace(disks.points, interior=inner))}


def mirrored(samples: Samples, reach: int) -> Samples:
    """The square with a ring of u(v) = 2 u(b) − u(m), where all inner nodes carry equations.

    The rule is right where the second normal derivative of u vanishes at the edge, which a body
    force there contradicts.
    """
    ring = 2 * reach - 1  # nodes of the edge carry no equations
    steps = np.rint(samples.x / SPACING).astype(int)
    u, b = (np.zeros((len(samples), NODES, NODES, 2)) for _ in range(2))
    u[:, steps[:, 0], steps[:, 1]], b[:, steps[:, 0], steps[:, 1]] = samples.u, samples.loads
    place = np.argwhere(np.ones((NODES + 2 * ring,) * 2, bool)) - ring
    edge = np.clip(place, 0, NODES - 1)
    image = 2 * edge - place
    outside = (place != edge).any(axis=1)[None, :, None]
    there = u[:, image[:, 0], image[:, 1]]
    wide = np.where(outside, 2 * u[:, edge[:, 0], edge[:, 1]] - there, there)
    loads = np.where(outside, 0.0, b[:, image[:, 0], image[:, 1]])
    interior: np.ndarray = np.all((place > 0) & (place < NODES - 1), axis=1)
    points = Points(SPACING * place, interior, SPACING, units=samples.points.units)
    return Samples(points, wide, loads)


def leaflet(folder: Path, jobs: int) -> Sets:
    """Frames of seven protocols: 100 to learn from, 20 to choose by, 20 held out; 13 × 13 nodes.

    The frames of the last fifth of a load are as likely in each set as others: a draw of seed 0.
    """
    made = make_leaflet(folder, levels=LEVELS, jobs=jobs, progress=False)
    points = made["train"].points
    steps = np.rint((points.x - points.x.min(axis=0)) / points.spacing).astype(int)
    last = steps.max() + 1 - 2 * REACH
    deep: np.ndarray = np.all((steps >= 2 * REACH) & (steps < last), axis=1)
    points = replace(points, interior=deep)
    u = np.concatenate([made["train"].u, made["test"].u])
    arrays = {
        key: np.concatenate([made["train"].arrays[key], made["test"].arrays[key]])
        for key in ("protocol", "level")
    }
    order = np.random.default_rng(0).permutation(len(u))
    parts = np.split(order, [LEARNED, LEARNED + CHOSEN])
    return {
        name: Samples(points, u[n], arrays={key: part[n] for key, part in arrays.items()})
        for name, part in zip(("train", "val", "test"), parts)
        for n in (np.sort(part),)
    }


# Networks


def weights_of(name: str) -> NeuralOperator:
    """The shipped network of an experiment, whose file is compressed."""
    with TemporaryDirectory() as folder:
        file = Path(folder) / f"{name}.json"
        file.write_bytes(lzma.decompress((WEIGHTS / f"{name}.json.xz").read_bytes()))
        material: NeuralOperator = wp.load(file)
    return material.float() if material.anisotropic else material.double()


def fresh(name: str, units: Any, seed: int = 0) -> tuple[NeuralOperator, TrainingSettings]:
    """A network of the printed widths with random weights, and how it is trained.

    Strain, rate, batch and epochs are not printed.
    """
    wide: dict[str, Any] = {"units": units, "seed": seed}
    wide |= {"influence": (256, 512), "state": (512, 512)}
    if name == "graphene":
        return NeuralOperator(20.0, **wide, strain=0.5), TrainingSettings(epochs=330, batch=2)
    if name == "leaflet":
        small = wide | {"influence": (32, 64), "state": (64, 64)}
        fibres: dict[str, Any] = {"anisotropic": True, "proportional": True, "strain": 2.0}
        operator = NeuralOperator(REACH * SPACING, **small, **fibres)
        return operator, TrainingSettings(epochs=30, rate=2e-3, batch=5)
    operator = NeuralOperator(int(name[-1]) * SPACING, **wide, anisotropic=True, strain=2.0)
    return operator, TrainingSettings(epochs=150, batch=10)


def trained(name: str, out: Path, epochs: int | None, sets: Sets) -> NeuralOperator:
    """The network of an experiment after so many epochs, in out/NAME.json; can be stopped."""
    material, training = fresh(name, sets["train"].points.units)
    training = replace(training, epochs=epochs or training.epochs)
    checkpoint = out / f"{name}.ckpt"
    history = train(material, sets["train"], sets["val"], training, checkpoint=checkpoint)
    material.provenance = {"epochs": history.epochs, "seconds": round(history.seconds)}
    wp.save(out / f"{name}.json", material)
    return material


def errors_of(material: NeuralOperator, sets: Sets, *, solve: bool = True) -> dict[str, Any]:
    """Errors of the load and of displacement by kind and set; "converged" is a share."""
    found: dict[str, dict[str, Any]] = {}
    for name, samples in sets.items():
        errors = evaluate(material, samples, solve=solve, progress=False)
        for key in ("E_res", "E_res_abs", "E_u", "converged"):
            if key in errors:
                found.setdefault(key, {})[name] = errors[key]
    return found


# Other materials


def dictionary(samples: Samples, reach: int) -> hyperelastic.HyperelasticMaterial:
    """A sheet energy model of nodes, corners of cells and bonds, coefficients of any sign."""
    nodes = (*SHEET, *hyperelastic.fibre_fan(8))
    terms = [*nodes]
    for n in (1, -1):  # both diagonals of a cell, and of two by two
        terms += [replace(term, corner=True, step=(1, n)) for term in nodes]
        terms += [replace(term, corner=True, step=(2, 2 * n)) for term in SHEET]
    for step in map(tuple, half_family(reach).tolist()):
        terms += [replace(term, step=step) for term in BONDS]
    model = hyperelastic.Hyperelastic(float(reach), NEAREST, tuple(terms))
    return wp.fit(samples, model).material


def frames_dictionary(samples: Samples) -> hyperelastic.HyperelasticMaterial:
    """A sheet energy model from displacement alone, with fibres in eight directions."""
    terms = (*SHEET, *hyperelastic.fibre_fan(8, (2.0, 3.0, 4.0, 6.0)))
    rose = hyperelastic.Hyperelastic(3.0, NEAREST, terms)
    return wp.fit(samples, rose, most_steps=8).material


def sheet_errors(
    solid: hyperelastic.HyperelasticMaterial, sets: Sets
) -> dict[str, dict[str, float]]:
    """E_res, where there are loads, and E_u by set."""
    found: dict[str, dict[str, float]] = {}
    for name, samples in sets.items():
        errors = wp.evaluate(solid, samples)
        for key in ("E_res", "E_u"):
            if key in errors:
                found.setdefault(key, {})[name] = float(errors[key])
    return found


class Window:
    """Bilinear elements on the interior of the frames and one ring of nodes around it."""

    def __init__(self, frames: Samples) -> None:
        skfem = finite_elements()
        steps = np.rint((frames.x - frames.x.min(axis=0)) / frames.spacing).astype(int)
        inner = steps[frames.interior]
        low, high = inner.min(axis=0), inner.max(axis=0)
        if len(inner) != np.prod(high - low + 1):
            raise InputError("frames: the rivals' elements need a rectangle of interior nodes")
        lines = [frames.spacing * np.arange(a - 1, b + 2) for a, b in zip(low, high)]
        self.mesh = Elements(skfem.MeshQuad.init_tensor(*lines), skfem.ElementQuad1(), order=3)
        number = {tuple(step): n for n, step in enumerate(steps.tolist())}
        places = np.rint(self.mesh.x / frames.spacing).astype(int).tolist()
        self.nodes = np.array([number[tuple(place)] for place in places])
        self.free = frames.interior[self.nodes]
        fixed = np.flatnonzero(~self.free)
        self.fixed = np.sort(np.concatenate([2 * fixed, 2 * fixed + 1]))

    def solve(
        self, energy: Energy, u: np.ndarray, near: np.ndarray | None = None
    ) -> np.ndarray | None:
        """Displacement of the interior from that of the ring, [I, 2]; None where not found.

        The search begins at the displacement `near` of the interior, at that of u where none is.
        """
        given = u[self.nodes].ravel()
        nothing = np.zeros_like(given)
        start = u[self.nodes]
        if near is not None:
            start[self.free] = near
        for steps in (1, 8):
            try:
                field = self.mesh.solve(
                    energy, nothing, self.fixed, given[self.fixed],
                    start=start.ravel() if steps == 1 else None, steps=steps, tolerance=1e-8,
                )  # fmt: skip
            except (NotSolved, RuntimeError):  # or a singular matrix
                continue
            return field.reshape(-1, 2)[self.free]
        return None

    def errors(self, energy: Energy, frames: Samples) -> np.ndarray:
        """Relative errors of displacement, NaN where not solved, shape [S]."""
        errors = []
        for u in frames.u:
            solved, target = self.solve(energy, u), u[self.nodes][self.free]
            gap = np.nan if solved is None else np.linalg.norm(solved - target)
            errors.append(gap / np.linalg.norm(target))
        return np.array(errors)


def two_families(x: np.ndarray) -> Energy:
    families = [Family(x[2] + sign * x[3], abs(x[0]), abs(x[1])) for sign in (1, -1)]
    return energies.plane_stress_hgo(1.0, families)


def invariants(x: np.ndarray) -> Energy:
    fibres = [Family(x[4], abs(x[2]), abs(x[3]))]
    return energies.invariant_based(1.0, abs(x[0]), abs(x[1]) + 1e-3, fibres)


def structure(x: np.ndarray) -> Energy:
    return energies.plane_stress_hgo(1.0, energies.ensemble(x[0], x[1], abs(x[2]), abs(x[3])))


ANYWHERE = np.random.default_rng(0).uniform((-1, -1, 0, -1, -1.5), (1, 1, 2.5, 1.5, 1.5), (10, 5))
"""More starts of the invariant-based sheet, whose fits end in different places."""
RIVALS: dict[str, tuple[Callable[[np.ndarray], Energy], Sequence[Sequence[float]]]] = {
    "neo-Hookean": (lambda x: energies.plane_stress_hgo(1.0), [[]]),
    "Fung": (
        lambda x: energies.fung(x.tolist()),
        [[1.0, 1.0, 0.3, 0.5, -0.2, -0.2], [1.0, 1.0, 0.3, 0.5, 0.2, 0.2]],
    ),
    "HGO, two fibre directions": (two_families, [[1.0, 1.0, -0.6, 0.5], [1.0, 1.0, 0.6, 0.5]]),
    "invariant-based": (
        invariants,
        [[0.5, 0.5, 1.5, 1.0, -0.7], [0.5, 0.5, 1.5, 1.0, 0.7], *ANYWHERE],
    ),
    "structure-informed": (structure, [[-0.7, 0.4, 2.0, 1.0], [0.7, 0.4, 2.0, 1.0]]),
}
"""Energies by their numbers, and where the fits begin; the best of a rival's starts counts."""


def fit(
    window: Window,
    make: Callable[[np.ndarray], Energy],
    start: np.ndarray,
    frames: Samples,
    *,
    most_steps: int = 12,
) -> tuple[np.ndarray, float]:
    """Levenberg and Marquardt with differences: numbers and root mean square of the errors."""

    truth = [u[window.nodes][window.free] for u in frames.u]
    size = np.array([np.linalg.norm(u) for u in truth])[:, None, None]

    def fields(x: np.ndarray, near: np.ndarray | None) -> np.ndarray | None:
        solved = []
        for n, u in enumerate(frames.u):
            field = window.solve(make(x), u, None if near is None else near[n])
            if field is None:
                return None
            solved.append(field)
        return np.array(solved)

    def gaps(fields: np.ndarray) -> np.ndarray:
        return ((fields - truth) / size).ravel()

    x, now, damping = start, fields(start, None), 1e-3
    if now is None:
        return x, np.inf
    left = gaps(now)
    for _ in range(most_steps if len(x) else 0):
        columns = []
        for n in range(len(x)):
            step = 1e-3 * max(abs(x[n]), 0.1)
            moved = fields(x + step * np.eye(len(x))[n], now)
            columns.append(np.zeros_like(left) if moved is None else (gaps(moved) - left) / step)
        J = np.stack(columns, axis=1)
        square = J.T @ J
        better = None
        while damping < 1e4:
            move = np.linalg.solve(square + damping * np.diag(np.diag(square) + 1e-12), -J.T @ left)
            better = fields(x + move, now)
            if better is not None and gaps(better) @ gaps(better) < left @ left:
                break
            better, damping = None, 10 * damping
        if better is None:
            break
        gain = 1 - (gaps(better) @ gaps(better)) / (left @ left)
        x, now, left, damping = x + move, better, gaps(better), damping / 10
        if gain < 1e-3:
            break
    return x, float(np.sqrt(left @ left / len(frames.u)))


def interpolated_errors(test: Samples) -> np.ndarray:
    """Errors [S] of the biharmonic interpolation of the collar: no number and no material.

    It reads displacement and slope on the rim of the interior, as a nonlocal solid does. What does
    not beat it has shown nothing about the material.
    """
    steps = np.rint((test.x - test.x.min(axis=0)) / test.spacing).astype(int)
    size = steps.max(axis=0) + 1
    second = [sp.diags([1.0, -2.0, 1.0], [-1, 0, 1], (n, n)) for n in size]
    laplacian = sp.kronsum(second[1], second[0], format="csr")
    nodes = steps @ [size[1], 1]
    inner, collar = nodes[test.interior], nodes[~test.interior]
    rows = (laplacian @ laplacian)[inner]
    errors = []
    for u in test.u:
        filled = spsolve(rows[:, inner].tocsc(), -(rows[:, collar] @ u[~test.interior]))
        target = u[test.interior]
        errors.append(np.linalg.norm(filled - target) / np.linalg.norm(target))
    return np.array(errors)


def element_errors(name: str, sets: Sets) -> dict[str, float]:
    """E_u by set of a named energy in elements, fitted to all frames, as printed."""
    make, starts = RIVALS[name]
    every, window = sets["train"], Window(sets["train"])
    few = Samples(every.points, every.u[::EVERY])
    numbers, _ = min((fit(window, make, np.array(x), few) for x in starts), key=lambda f: f[1])
    frames = Samples(every.points, np.concatenate([samples.u for samples in sets.values()]))
    numbers, _ = fit(window, make, numbers, frames, most_steps=1)
    return {
        part: float(np.nanmean(window.errors(make(numbers), samples)))
        for part, samples in sets.items()
    }


# Tables


def percent(errors: Mapping[str, float], sets: Sequence[str]) -> str:
    """Errors of some sets in %, two digits."""
    return " / ".join(f"{100 * errors[name]:.2f}" if name in errors else "–" for name in sets)


def graphene() -> Table:
    """Figure 5: errors of graphene's network [%], and ‖Lu − b‖ on the disks [GPa/Å]."""
    network = errors_of(weights_of("graphene"), sets_of("graphene"))
    told = percent(network["E_res"], SETS[:2]), percent(network["E_u"], ("val", "disks"))
    load = f"{1e3 * network['E_res_abs']['disks']:.3g}"
    rows = [*printed("neural", "graphene"), ["network", *told, load]]
    return ["", "E_res train / val", "E_u val / disks", "‖Lu − b‖ disks"], rows


def one_disk() -> Table:
    """Figures 4 and 10: the first disk of graphene and of the sheet, errors of u and b [%]."""
    rows = []
    for name in ("graphene", "hgo_3"):
        disks, material = sets_of(name)["disks"], weights_of(name)
        u, b, placed = disks.u[0], disks.loads[0], material.on(disks.points)
        inside = disks.interior
        found, _ = EquilibriumSolver(placed).solve(b[inside], u, 1e-6)
        pairs = (found[inside], u[inside]), (np.asarray(placed(u)), b[inside])
        rows.append([name, *(f"{100 * relative_error(*pair):.2f}" for pair in pairs)])
    return ["disk", "u", "b"], rows


def gradients() -> Table:
    """Figure 7: size of the displacement gradient over all nodes of all squares."""
    squares = [s for name, s in sets_of("hgo_3").items() if name != "disks"]
    u = np.concatenate([samples.u for samples in squares])
    side = round(len(u[0]) ** 0.5)
    parts = np.gradient(u.reshape(-1, side, side, 2), SPACING, axis=(1, 2))
    sizes = np.sqrt(sum((part**2).sum(axis=-1) for part in parts)).ravel()
    cells = [f"{size:.2f}" for size in np.quantile(sizes, (0.5, 0.95, 1.0))]
    return ["median", "95 % of all nodes below", "largest"], [cells]


def mirror() -> Table:
    """Figure 8: E_res [%] of a network that learned from squares with a mirrored collar."""
    sets = sets_of("hgo_3", mirror=True)
    operator, _ = fresh("hgo_3", sets["train"].points.units)
    train(operator, sets["train"], sets["val"], TrainingSettings(epochs=150, batch=5, cells=24))
    errors = errors_of(operator, sets, solve=False)["E_res"]
    return ["train / val / test squares", "disks"], [
        [percent(errors, SETS[:3]), percent(errors, SETS[3:])]
    ]


def sheet() -> Table:
    """Figure 11: errors on squares and disks [%] at three horizons δ/Δx."""
    rows = []
    for name in EXPERIMENTS[1:4]:
        sets = sets_of(name)
        solid = dictionary(sets["train"], int(name[-1]))
        rows += [row for row in printed("neural", "sheet") if row[0] == name[-1]]
        for kind, errors in (
            ("network", errors_of(weights_of(name), sets)),
            ("sheet energy model", sheet_errors(solid, sets)),
        ):
            cells = [name[-1], kind]
            for key in ("E_res", "E_u"):
                cells += [percent(errors[key], SETS[:3]), percent(errors[key], SETS[3:])]
            rows.append(cells)
    return ["δ/Δx", "", "E_res squares", "E_res disks", "E_u squares", "E_u disks"], rows


def epochs() -> Table:
    """How the shipped networks were trained."""
    rows = []
    for name in EXPERIMENTS:
        law = weights_of(name)
        made = law.provenance
        pace = made["seconds"] / made["epochs"]
        rows.append([name, f"{law.numbers()}", f"{made['epochs']}", f"{pace:.1f}"])
    return ["", "parameters", "epochs", "seconds an epoch"], rows


def leaflet_errors() -> Table:
    """Table 2: E_u [%] on training, validation and held-out frames of the leaflet."""
    sets, known = sets_of("leaflet"), SETS[:3]
    few = Samples(sets["train"].points, sets["train"].u[::EVERY])
    rows = printed("neural", "leaflet")
    nothing = {part: float(np.mean(interpolated_errors(s))) for part, s in sets.items()}
    rows.append(["no material", percent(nothing, known)])
    rows += [[name, percent(element_errors(name, sets), known)] for name in RIVALS]
    solid = sheet_errors(frames_dictionary(few), sets)
    rows.append(["sheet energy model", percent(solid["E_u"], known)])
    rows.append(["network", percent(errors_of(weights_of("leaflet"), sets)["E_u"], known)])
    return ["", "train / val / test"], rows


TABLES = (graphene, one_disk, gradients, mirror, sheet, epochs, leaflet_errors)


def main() -> None:
    if sys.argv[1:2] != ["train"]:
        print_tables(__doc__, TABLES)
        return
    options = {"epochs": (int, "in all; default: as the shipped weights", Count)}
    parser = Options(__doc__, "neural", options=options)
    parser.add_argument("experiment", choices=EXPERIMENTS)
    given = parser.parse_args(sys.argv[2:])
    check_new(given.out, f"{given.experiment}.json")
    name, sets = given.experiment, sets_of(given.experiment)
    material = trained(name, given.out, given.epochs, sets)
    print({key: percent(e, SETS) for key, e in errors_of(material, sets, solve=False).items()})


if __name__ == "__main__":
    sys.exit(exit_status(main))
