"""Dressed solids: graphene from fields and from phonons, bodies with edges and cracks, crystals.

python examples/dressed.py           numbers, and a picture in runs/dressed
python examples/dressed.py --json    one object on stdout
python examples/dressed.py --all     every crystal, and a free ball of each
"""

import json
import sys
import time
import warnings
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

import numpy as np

import warp_peri as wp
from examples.crystals import Unseen
from examples.figures import panels
from examples.nonlinear import add_files, strained_file
from examples.studies.dressed_bodies import STRIP, faces, free_ball, plate, squeezed_law, without
from examples.train_graphene import SMOOTHING_RADIUS, make_data
from tools import crystals, graphene_phonons
from tools.crystal_ball import ball
from tools.graphene import DISK_RADIUS
from tools.options import Options
from warp_peri.core.elastic import plane_isotropic
from warp_peri.dressed import DressedSolid, FiniteStrain, from_phonons, grown, torn
from warp_peri.errors import exit_status
from warp_peri.methods import Smoothing
from warp_peri.micromodulus import from_phonons as tensors_from_phonons
from warp_peri.structures.phonons import wave_loads

SETS = {"train": "train", "val": "val", "disks": "test"}
LAWS = {
    "bonds 12": ("bonds", 12, False),
    "bonds 20": ("bonds", 20, False),
    "bonds 8, two functions": ("bonds", 8, True),
    "elements 8": ("elements", 8, False),
}
EDGE = 0.3
"""How far the disk reaches beyond its outermost atoms [Å]."""
CRACK = 30.0
"""Half its length [Å]."""
EVENTS = 6
"""Of a crack that grows."""
TURN = np.deg2rad(10)
"""Of a strained sheet as a whole."""


def errors(solid: Any, data: wp.Dataset) -> dict[str, dict[str, float]]:
    """E_res and E_u [%] by set."""
    found = {name: wp.evaluate(solid, data[key]) for name, key in SETS.items()}
    return {kind: {n: 100 * e[kind] for n, e in found.items()} for kind in ("E_res", "E_u")}


def row(solid: DressedSolid, data: wp.Dataset) -> dict[str, Any]:
    """What is told of one law."""
    proof = solid.certificate
    return errors(solid, data) | {
        "numbers": solid.provenance["fit"]["numbers"],
        "moduli": solid.moduli(),
        "certificate": {"proven": proof.proven, "sampled": proof.sampled} if proof else None,
    }


def sheets(data: wp.Dataset) -> tuple[dict[str, Any], dict[str, DressedSolid]]:
    """Laws of graphene from fields, from phonons, and their bases; moduli of the atoms, held."""
    atoms = graphene_phonons.force_constants()
    table: dict[str, Any] = {"from fields": {}, "phonons": {}, "base alone": {}}
    laws = {}
    for name, (base, neighbours, two) in LAWS.items():
        alone = from_phonons(
            atoms, 5.0, base, neighbours, symmetry="isotropic", split=False, two_functions=two
        )
        law = wp.Dressed(base, neighbours, moduli=alone.elastic, two_functions=two)
        laws[name] = wp.fit(data["train"], law).material
        table["from fields"][name] = row(laws[name], data)
        table["phonons"][name] = row(alone, data)
        if name in ("bonds 12", "elements 8"):  # the others have the base of bonds 12
            table["base alone"][base] = errors(without(alone), data)
    for bonds, horizon in ((12, 10.0), (20, 12.5)):
        tensors = tensors_from_phonons(atoms, 5.0, horizon, symmetry="isotropic")
        table["phonons"][f"tensors on {bonds} bonds"] = errors(tensors, data)
    for name, moduli in {"long waves": "long waves", "third order": Smoothing(10.0, 0.2)}.items():
        found = wp.fit(data["train"], wp.Dressed("bonds", 12, moduli=moduli)).material
        table["from fields"][f"bonds 12, moduli from {name}"] = row(found, data)
    return table, laws


def finite_strain(data: wp.Dataset, larger: wp.Dataset) -> dict[str, Any]:
    """E_u [%] of the objective law at 2, 4 and 6 %; the ratio of E_res of turned fields to that of
    straight ones; force against differences of the energy."""
    truth: dict[str, float] = larger.provenance["truth"]
    found: dict[str, Any] = {}
    C = plane_isotropic(truth["lambda"], truth["mu"])
    for name, moduli in {"held": C, "from fields": Smoothing(10.0, 0.2)}.items():
        law = wp.fit(data["train"], FiniteStrain(moduli)).material
        tables = {}
        with warnings.catch_warnings():  # beyond the proven strain: as asked
            warnings.simplefilter("ignore", UserWarning)
            for key in ("val", "test", "val_4", "test_4", "val_6", "test_6"):
                samples = data[key] if key in data.sets else larger[key]
                tables[key] = wp.evaluate(law, samples)
        found[name] = {
            "E_u": {key: 100 * table["E_u"] for key, table in tables.items()},
            "largest_gradient": {key: table["largest_gradient"] for key, table in tables.items()},
            "constants": {key: getattr(law, key) for key in ("lam", "mu", "t3", "tq2", "q3")},
            "filters": [law.along, law.across, law.share],
            "proven_strain": law.strain,
        }
    samples = data["val"]
    body, (x, u, b) = law.on(samples), (samples.x, samples.u, samples.loads)
    c, s = np.cos(TURN), np.sin(TURN)
    R = np.array([[c, -s], [s, c]])

    def left(u: np.ndarray, b: np.ndarray) -> np.ndarray:
        force = body(u) - body.load(b)
        return np.linalg.norm(force, axis=(1, 2)) / np.linalg.norm(body.load(b), axis=(1, 2))

    turned = left((x + u) @ R.T - x, b @ R.T) / left(u, b)
    along = np.random.default_rng(0).normal(size=x.shape) * samples.interior[:, None]
    slopes = [body.energy(u[0] + step * along) for step in (-2e-3, -1e-3, 1e-3, 2e-3)]
    slope = np.dot([1, -8, 8, -1], slopes) / 12e-3
    own = samples.spacing**2 * np.vdot(body(u[0]), along[samples.interior])
    found["turned"] = {"ratio": float(turned.mean()), "off": float(np.abs(turned - 1).max())}
    found["energy"] = float(abs(slope / own - 1))
    return found


def free(solid: DressedSolid) -> dict[str, float]:
    """E_u [%] of a free disk of atoms under smooth loads, less its rigid motion."""
    seen, known = graphene_phonons.free_disk(solid.spacing)

    def inside(x: np.ndarray) -> np.ndarray:
        return np.linalg.norm(x, axis=1) < DISK_RADIUS + EDGE

    x = seen.x[known]
    turn = np.stack([-x[:, 1], x[:, 0]], axis=1).ravel()
    rigid = np.stack([np.tile([1.0, 0], len(x)), np.tile([0, 1.0], len(x)), turn], axis=1)

    def still(u: np.ndarray) -> np.ndarray:
        flat = u[:, known].reshape(len(u), -1).T
        return flat - rigid @ np.linalg.lstsq(rigid, flat)[0]

    found = {}
    for name, law in {"dressed": solid, "elements": without(solid)}.items():
        body = law.on(seen.points, edges=inside)
        u = wp.solve(body, wp.Dirichlet(seen.points, seen.b, seen.u)).u
        wrong, whole = (np.linalg.norm(still(v), axis=0) for v in (u - seen.u, seen.u))
        found[name] = float(100 * (wrong / whole).mean())
    return found


def breaking(solid: DressedSolid, bodies: int = 30) -> dict[str, float]:
    """Least eigenvalue of free sheets broken at random, and what a turn costs, over the largest."""
    line = solid.spacing * np.arange(14)
    x = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    near = np.abs(x[:, None] - x).max(axis=2) < 1.1 * solid.spacing
    pairs = np.argwhere(np.triu(near, 1))
    least, turned = [], []
    for seed in range(bodies):
        rng = np.random.default_rng(seed)
        kept = rng.random(len(pairs)) < rng.uniform(0, 0.7)
        maps = {name: rng.random(len(x)) ** 4 for name in solid.parts.names}
        points = wp.Points(x, np.ones(len(x), bool), solid.spacing)
        body = solid.on(points, edges=True, maps=maps, broken=pairs[kept])
        L = body.L.toarray()
        turn = np.stack([-x[:, 1], x[:, 0]], axis=1)
        least.append(np.linalg.eigvalsh(L)[0] / np.abs(L).max())
        turned.append(np.abs(body(turn)).max() / np.abs(L).max() / np.abs(x).max())
    found = {"bodies": bodies, "least": float(min(least)), "rotation": float(max(turned))}
    return found | crack_of_the_base(solid)


def cracked_sheet(soft: float = 0.0) -> tuple[np.ndarray, wp.Points, np.ndarray]:
    """A square with a crack, held on two sides, and where it is soft by so much at the most."""
    line = 5.0 * np.arange(-14.5, 15)
    x = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    points = wp.Points(x, np.abs(x[:, 1]) < line[-2] + 1, 5.0)
    return x, points, 1 - soft * np.exp(-((x - [35, 35]) ** 2).sum(axis=1) / 400)


def crack_of_the_base(solid: DressedSolid) -> dict[str, float]:
    """How far a pulled, cracked sheet is from its base alone: in energy, in G u, and in how far
    its faces open and its strain ahead of the tip, over those of the base."""
    x, points, _ = cracked_sheet()
    crack = torn(points, [[(-CRACK, 0), (CRACK, 0)]])
    bodies = [law.on(points, edges=True, broken=crack) for law in (solid, without(solid))]
    pull = wp.Dirichlet(points, 0 * x, 0.02 * x * [0, 1])
    u, v = (wp.solve(body, pull).u for body in bodies)
    over, under = (np.flatnonzero((np.abs(x[:, 0]) < 3) & (x[:, 1] == y)) for y in (2.5, -2.5))
    ahead = [np.flatnonzero((x[:, 0] == CRACK + 2.5) & (x[:, 1] == y))[0] for y in (2.5, -2.5)]
    opened = [float((w[over] - w[under])[:, 1].mean()) for w in (u, v)]
    strain = [float((w[ahead[0]] - w[ahead[1]])[1]) for w in (u, v)]
    energy = [float(body.energy(w)) for body, w in zip(bodies, (u, v))]
    edge = wp.Cracked(points, u=x * [0, 1], cracks=[[(-CRACK, 0), (CRACK, 0)]])
    before, after = (wp.move(solid.plain, edge, events=n) for n in (EVENTS, EVENTS + 1))
    longer = solid.on(points, edges=True, broken=grown(points, before))
    w = wp.solve(longer, wp.Dirichlet(points, 0 * x, x * [0, 1])).u
    return {
        "energy": abs(energy[0] / energy[1] - 1),
        "energy of a grown crack over its ledger": abs(longer.energy(w) / after["energy"][-1] - 1),
        "base displacement": float(np.abs(bodies[0].base_displacement(u) - v).max() / v.max()),
        "opening": opened[0] / opened[1],
        "strain ahead": strain[0] / strain[1],
    }


def crystal(name: str, with_ball: bool) -> dict[str, Any]:
    """A split law of a crystal from phonons, on waves it never saw and in a ball of atoms [%]:
    inside it by the law of the crystal as the ball's surface squeezes it ("ball"), and by that at
    rest; and the whole ball, free."""
    atoms = crystals.force_constants(name)
    a = crystals.spacing_of(np.diag(atoms.cell), crystals.RECIPES[name])
    seen = ball(name, atoms, a) if with_ball else None
    unseen = Unseen(
        wave_loads(atoms, a, longest=18.0, shortest=4.0, loads=10, seed=2),
        wave_loads(atoms, a, longest=4.0, shortest=2.7, loads=5, seed=3),
        seen,
        None,
    )
    law = from_phonons(atoms, a, symmetry=atoms.group())
    proof = law.certificate
    there = law if seen is None else squeezed_law(name, seen)
    table = unseen.judge(law.symbol, law.crystal, there.crystal)
    rest = unseen.judge(without(law).symbol, without(law).crystal, without(there).crystal)
    whole = {} if seen is None else {"free_ball": free_ball(there, seen, len(atoms.positions))}
    return whole | {
        "E_u": table["E_u"],
        "E_res": table["E_res"],
        "elements": rest["E_u"],
        "numbers": law.provenance["fit"]["numbers"],
        "moduli": law.moduli("GPa"),
        "certificate": {"proven": 1e3 * proof.proven, "sampled": 1e3 * proof.sampled}
        if proof
        else None,
    }


def cost(solid: DressedSolid, side: int = 1000) -> float:
    """Nanoseconds a node of L u by rows on one thread, the best of five."""
    wp.launch.set_threads(1)
    operator = solid.on(wp.Points.sheet((side, side), solid.spacing))
    planes = np.random.default_rng(0).normal(size=(1, 2, *operator.nodes.wide))
    times = []
    for _ in range(6):
        begin = time.perf_counter()
        operator.pull(planes)
        times.append(time.perf_counter() - begin)
    return min(times[1:]) / side**2 * 1e9


def picture(numbers: dict[str, Any], solid: DressedSolid, path: Path) -> None:
    """Errors of base and dressed laws, and a cracked sheet that is soft in a patch."""
    figure, (left, right) = panels(9.5, 4, count=2)
    names = {"base alone": "bonds", "phonons": "bonds 12", "from fields": "bonds 12"}
    labels = "base alone, K = 1/r", "dressed, from phonons", "dressed, from loads"
    for n, (kind, name) in enumerate(names.items()):
        values = [*numbers[kind][name]["E_u"].values()]
        left.semilogy(range(3), values, "o", color=f"C{n}", label=labels[n])
    left.legend(frameon=False)
    left.set(xticks=range(3), xlim=(-0.3, 2.3), ylabel="error of displacement [%]")
    left.set_xticklabels(["training loads", "held-out loads", "free disks"])
    left.set_yticks([0.5, 1, 2, 5, 10], labels=["0.5", "1", "2", "5", "10"])
    left.minorticks_off()
    left.set_title("Dressing makes a plain base accurate")
    x, points, soft = cracked_sheet(0.8)
    crack = torn(points, [[(-CRACK, 0), (CRACK, 0)]])
    body = solid.on(points, edges=True, maps={"bulk": soft, "shear": soft}, broken=crack)
    u = wp.solve(body, wp.Dirichlet(points, 0 * x, 0.02 * x * [0, 1])).u
    shown = right.scatter(*(x + 3 * u).T, c=soft, s=12, cmap="viridis")
    figure.colorbar(shown, label="modulus over that of the whole sheet")
    right.set(aspect="equal", xlabel="x [Å]", ylabel="y [Å]")
    for side in (-1, 1):
        for place in (-50, 0, 50):
            right.annotate("", (place, side * 100), (place, side * 86),
                           arrowprops={"arrowstyle": "->", "color": "C3"})  # fmt: skip
    right.set(ylim=(-110, 110), title="It bears cracks and soft patches")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)


def main(arguments: list[str] | None = None) -> None:
    parser = Options(__doc__)
    parser.add("--all", action="store_true", help="every crystal, with free balls")
    add_files(parser, ROOT / "runs" / "dressed")
    given = parser.parse_args(arguments)
    data = wp.load(given.data or make_data(-1, SMOOTHING_RADIUS))
    numbers, laws = sheets(data)
    best = numbers["from fields"]["bonds 12"]
    numbers |= {key: best[key] for key in ("E_res", "E_u")}
    numbers["breaking"] = breaking(laws["bonds 12"])
    numbers["breaking"]["beside atoms"] = faces()
    numbers["free"] = {"disk": free(laws["elements 8"]), "hole": plate(), "strip": plate(STRIP)}
    numbers["finite_strain"] = finite_strain(data, wp.load(strained_file(given)))
    names = ("Cu", "Al", "W", "Si") if given.all else ("Cu",)
    numbers["split"] = {name: crystal(name, given.all) for name in names}
    numbers["nanoseconds"] = {name: cost(law) for name, law in laws.items()}
    picture(numbers, laws["bonds 12"], given.out / "dressed.png")
    wp.save(given.out / "graphene.json", laws["bonds 12"])
    print(json.dumps(numbers, indent=None if given.json else 1))


if __name__ == "__main__":
    sys.exit(exit_status(main))
