"""Where methods fail: fifteen failures provoked and measured, what is said, and what helps.

Draws docs/where_it_fails.png and writes docs/record/stability.json; the page is where_it_fails.md.
"""

import sys
import warnings
from dataclasses import asdict, dataclass, replace
from functools import cache
from itertools import product
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from tqdm import tqdm

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

import warp_peri as wp
from examples.exact import plate_with_hole, relative_error
from examples.figures import Panel, draw_panels
from examples.prose import said_by, write_record
from examples.reproduce.slides import curl_and_pressure, lattice
from tools.options import Options
from warp_peri.errors import exit_status
from warp_peri.fitting.regression import sample_weights
from warp_peri.materials.lps import LPSParameters
from warp_peri.materials.lps_law import LPSFound, Products, optimum
from warp_peri.methods import GaussNewton, StabilityConditions
from warp_peri.points.families import family_weights
from warp_peri.points.outlines import Circle, box, mesh_outline
from warp_peri.solvers.verlet import INERTIA

DATA = ROOT / "data" / "graphene_0K.h5"
FREE = GaussNewton(moduli=None)
LAM, MU = 0.3, 0.8  # of solids made up here [TPa], whose nodes lie 1 Å apart


@dataclass(frozen=True)
class Case(Panel):
    """What the library says, and curves of errors, or of stiffness that fails below zero."""

    said: str

    @property
    def remedy(self) -> tuple[float, float]:
        """The failure at its worst, and the other curve there, or the only one at its best."""
        failing, *helped = (np.asarray(y, float) for y in self.curves.values())
        worst = failing.argmin() if failing.min() < 0 else failing.argmax()
        return float(failing[worst]), float(helped[0][worst] if helped else failing.min())


@cache
def learned(degree: int = 10, horizon: float = 20.0) -> wp.LPSMaterial:
    """Of graphene, nodes 5 Å apart, with the default conditions."""
    return wp.fit(wp.load(DATA)["train"], wp.LPS(horizon, wp.Bernstein(degree), FREE)).material


def solid(lam=LAM, alpha=1.0, horizon=3.0, h=1.0) -> wp.LPSMaterial:
    """K = r^(−α), which is stable on every lattice."""
    return wp.LPSMaterial(lam, MU, alpha, np.ones(1), horizon, certified_on=(h,))


def square(number: int, horizon: float, shift: float = 0.0, h: float = 1.0) -> wp.Points:
    """number × number unknown nodes and their collar, at random up to `shift` spacings away."""
    points = lattice(number, horizon + shift * h, number * h)
    away = shift * h * np.random.default_rng(1).uniform(-1, 1, points.x.shape)
    return replace(points, x=points.x + away, spacing=0.0 if shift else h)


def waves(material: Any, points: wp.Points, number: int, strain: float = 0.1) -> wp.Samples:
    """Random plane waves, 8 to 24 Å long, and the loads that hold them in a material."""
    random = np.random.default_rng(0)
    phase, turn, length = random.uniform((0, 0, 8), (6.3, 6.3, 24), (number, 3)).T
    k, a = (length**n * (np.cos(v), np.sin(v)) for n, v in ((-1, turn), (1, phase)))
    u = strain * np.cos(2 * np.pi * points.x @ k + phase).T[:, :, None] * a.T[:, None] / 2 / np.pi
    b = np.zeros_like(u)
    b[:, points.interior] = material.on(points)(u)
    return wp.Samples(points, u, b)


def unconditioned(train: wp.Samples, horizon: float, degree: int) -> wp.LPSMaterial:
    """The least residual of kernels of a degree: one round, before any condition is cut in."""
    products, none = Products(train, horizon), StabilityConditions(zeta=1e-6)
    start = LPSFound(LPSParameters(-0.2, 0.7, 1.0, np.ones(degree + 1)))
    block = products.rows(sample_weights([train], normalise=False)[0])
    law = [products.classes], start, none, GaussNewton(moduli=None, rounds=1)
    return wp.LPSMaterial(**vars(optimum([block], *law).solid), horizon=horizon)


def no_conditions(horizons: tuple[float, ...] = (15.0, 20.0, 22.5)) -> Case:
    train = wp.load(DATA)["train"]
    free = [unconditioned(train, horizon, 15) for horizon in horizons]
    fits = {"none": free, "default": [learned(15, horizon) for horizon in horizons]}
    y = {n: [wp.certify(m, spacing=5.0).symbol_min for m in row] for n, row in fits.items()}
    said = said_by(lambda: wp.solve(free[-1], wp.Dirichlet(train, train.loads, train.u)))
    return Case("no conditions", horizons, "horizon [Å]", "softest wave [TPa]", y, said)


def steep_kernel() -> Case:
    alphas = (0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 2.9, 2.999)
    laws = [wp.crystals.crystal_from_lps(solid(alpha=alpha), 1.0) for alpha in alphas]
    off = [abs(law.elastic_tensor()[2, 2] / MU - 1) for law in laws]
    y, said = {"δ = 3h": 100 * np.round(off, 9)}, said_by(lambda: solid(alpha=3.0))
    return Case("a steep kernel", alphas, "exponent α", "error in shear [%]", y, said)


def other_lattice() -> Case:
    length = np.geomspace(15, 200, 25)
    k = 2 * np.pi / np.stack([length, np.full(25, np.inf)], axis=1)
    moved = wp.transfers.on_lattice(learned(), spacing=2.5)
    laws = (learned(), 5.0), (learned(), 2.5), (moved, 2.5)
    own, *there = (np.linalg.eigvalsh(model.stencil(h).symbol(h * k)) for model, h in laws)
    off = [100 * np.abs(found / own - 1).max(axis=1) for found in there]
    y, fine = dict(zip(("same kernel", "on_lattice"), off)), square(4, 20.0, h=2.5)
    said = said_by(lambda: learned().on(fine, allow_uncertified=True))
    return Case("another lattice", length, "wavelength [Å]", "error on 2.5 Å [%]", y, said)


def short_horizon() -> Case:
    ratios, x = np.linspace(1, 4, 31), wp.fracture.rectangle_nodes(9, 9, 1.0)
    r = np.hypot(*x.T)
    families = [x[(r > 0) & (r < ratio + 1e-9)] for ratio in ratios]
    y = {"lattice": [family_weights(xi, ratio)[1] for xi, ratio in zip(families, ratios)]}
    said = said_by(lambda: solid(horizon=1.9).stencil(1.0))
    return Case("a short horizon", ratios, "horizon / spacing", "misfit of weights", y, said)


def nearly_incompressible() -> Case:
    y: dict[str, list[float]] = {"scattered": [], "lattice": []}
    h, ratios = np.pi / 16, np.logspace(0, 5, 6)
    for ratio, name in product(ratios, y):
        points = square(16, 3 * h, 0.2 * (name == "scattered"), h)
        u, b = curl_and_pressure(points.x, ratio)
        model, inside = solid(ratio * MU, horizon=3 * h, h=h), points.interior
        found = wp.solve(model, wp.Dirichlet(points, MU * b, u), allow_uncertified=True).u
        y[name].append(100 * relative_error(found[inside], u[inside]))
    said = said_by(lambda: solid(1e5 * MU).on(square(6, 3.0, 0.2), allow_uncertified=True))
    return Case("λ far above μ", ratios, "λ/μ", "error of u [%]", y, said)


def scattered_points() -> Case:
    shifts = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6)
    clouds = [square(12, 3.0, shift) for shift in shifts]
    moved = [wp.transfers.onto_lattice(wp.Samples(p, p.x[None]), spacing=1.0) for p in clouds]
    nodes = [samples.points for samples in moved]
    rows = {"as they lie": clouds, "onto_lattice": nodes}
    eigen = wp.certificates.check_solvability
    y = {n: [eigen(solid(), p).symmetric_min for p in row] for n, row in rows.items()}
    said = said_by(lambda: solid().on(clouds[-1]))
    return Case("scattered points", shifts, "shift / spacing", "least eigenvalue", y, said)


def small_holes(radii: tuple[float, ...] = (20.0, 50.0)) -> Case:
    def exact(x: np.ndarray) -> np.ndarray:
        return plate_with_hole(x, radius, 0.005, moduli)[0]

    x, off = wp.fracture.rectangle_nodes(280.0, 280.0, 5.0), []
    moduli = SimpleNamespace(**wp.crystals.crystal_from_lps(learned(), 5.0).moduli())
    for radius in radii:
        hole = np.hypot(*x.T) < radius
        inside, u = (np.abs(x) < 100).all(axis=1) & ~hole, np.zeros_like(x)
        u[~hole] = exact(x[~hole])
        cut = wp.Dirichlet(wp.Points(x, inside, 5.0, outside=hole), 0 * x, u)
        mesh = mesh_outline(box(200, 200), [Circle(radius, size=4.0)], size=8.0)
        body = wp.Body(mesh, dict.fromkeys(("left", "right", "top", "bottom"), exact))
        found = wp.solve(learned(), cut, allow_uncertified=True).u[inside]
        pairs = (found, u[inside]), (wp.solve(learned(), body).u, exact(mesh.x))
        off.append([100 * relative_error(*pair) for pair in pairs])
    y, said = dict(zip(("cut bonds", "Body"), zip(*off))), said_by(lambda: wp.solve(learned(), cut))
    return Case("free edges and holes", radii, "radius of the hole [Å]", "error of u [%]", y, said)


def short_waves() -> Case:
    train, law = wp.load(DATA)["train"], wp.Crystal(15.0, "4mm")
    length = 2 * np.pi / train.arrays["wave_number"]
    some, long = np.argsort(length)[::3], train[np.flatnonzero(length > 45)]
    tried, sets = train[some], {"waves > 45 Å": long, "all waves": train}
    off = {n: wp.evaluate(wp.fit(data, law).material, tried) for n, data in sets.items()}
    y = {name: 100 * np.array(errors["E_u_samples"]) for name, errors in off.items()}
    members = wp.fit(long, wp.prediction.Ensemble(law), progress=False).material
    answer: Any = wp.predict(members, wp.Dirichlet(tried, tried.loads[0], tried.u[0]), None)
    return Case("waves of no load", length[some], "wavelength [Å]", "error of u [%]", y, answer.why)


def single_precision() -> Case:
    points, shifts = square(24, 6.0), np.logspace(-2, 6, 9)
    law = wp.crystals.crystal_from_lps(solid(), 1.0)
    u, force = waves(law, points, 1, 1e-3).u[0], law.on(points)
    laws = {"float32": law.on(points, dtype=np.float32), "float64": force}
    y = {n: [100 * relative_error(of(u + s), force(u)) for s in shifts] for n, of in laws.items()}
    said = said_by(lambda: wp.solve(laws["float32"], wp.Dirichlet(points, None, u)))
    return Case("single precision", shifts, "rigid shift [Å]", "error of force [%]", y, said)


def long_steps() -> Case:
    points, shares, growth = wp.Points.sheet((24, 24), 1.0), (0.9, 0.95, 0.99, 1.01, 1.03), []
    operator, first = solid().on(points), np.random.default_rng(0).normal(size=points.x.shape)
    longest = wp.certificates.critical_time_step(solid(), spacing=1.0, density=1e3)
    for share in shares:
        u, v = first, 0 * first
        for _ in range(200):  # leapfrog
            v = v - (share * longest) ** 2 * operator(u) / (1e3 * INERTIA)
            u = u + v
        growth.append(np.abs(u).max() / np.abs(first).max())
    start, how = wp.Dirichlet(points, None, first), {"density": 1e3, "steps": 1}
    said = said_by(lambda: wp.simulate(solid(), start, step=1.03 * longest, **how))
    y = {"leapfrog": growth}
    return Case("a step too long", shares, "step / (2/ω)", "growth in 200 steps", y, said)


def noisy_data(levels: tuple[float, ...] = (1.0, 2.0, 4.0)) -> Case:
    points, off, law = square(13, 2.5), [], wp.LPS(2.5, wp.Bernstein(3), FREE)
    clean = waves(solid(horizon=2.5), points, 60)
    for level in levels:
        drawn = np.random.default_rng(round(level)).normal(size=(2, *clean.u.shape))
        noise, again = level / 100 * clean.u.std() * drawn
        train, alone = replace(clean, u=clean.u + noise), wp.Samples(points, again, 0 * again)
        fits = wp.fit(train, law), wp.fit(train, law, noise=alone)
        off.append([100 * abs(fit.material.lam / LAM - 1) for fit in fits])
    y, said = dict(zip(("residual", "corrected"), zip(*off))), fits[0].loss.reason
    return Case("noise in the data", levels, "noise [%]", "error of λ [%]", y, said)


def large_strains() -> Case:
    def svk(E: Any, lam: float, mu: float) -> Any:
        return lam / 2 * E.diagonal(dim1=-2, dim2=-1).sum(-1) ** 2 + mu * (E * E).sum((-1, -2))

    truth, points = wp.DensityMaterial.of(svk, 1.0, {"lam": LAM, "mu": MU}), square(14, 3.0)
    strains, linear = (1, 2, 4, 8, 12), wp.LPS(3.0, wp.Bernstein(3), FREE)
    sets = [waves(truth, points, 6, strain / 100) for strain in strains]
    laws = {"linear": linear, "Density": wp.Density(svk, 1.5, {"lam": 0.1, "mu": 1.0})}
    fits = {name: wp.fit(sets[1], law).material for name, law in laws.items()}
    y = {n: [100 * wp.evaluate(m, one)["E_u"] for one in sets] for n, m in fits.items()}
    said = said_by(lambda: wp.evaluate(fits["linear"], sets[-1]))
    return Case("strains beyond the data", strains, "strain [%]", "error of u [%]", y, said)


def broken_kernel() -> Case:
    solids = {"learned": learned(), "positive": wp.fracture.with_positive_kernel(learned(), 20.0)}
    x, missing = wp.fracture.rectangle_nodes(150.0, 150.0, 5.0), (0.0, 2.0, 5.0, 10.0)
    inside, draw = (np.abs(x) < 35).all(axis=1), np.random.default_rng(0).random(len(x))
    y: dict[str, list[float]] = {"learned": [], "positive": []}
    for share, name in product(missing, solids):
        gone = (np.hypot(*x.T) < 30) & (100 * draw < share)
        points = wp.Points(x, inside & ~gone, 5.0, outside=gone)
        y[name].append(wp.certificates.check_solvability(solids[name], points).symmetric_min)
    said = said_by(lambda: wp.fracture.BrittleMaterial(learned(), 2147.0, critical_stretch=0.1))
    return Case("a broken kernel", missing, "missing nodes [%]", "least eigenvalue", y, said)


def unstated_axis() -> Case:
    steps, turned = np.array([[1, 0], [0, 1], [1, 1], [1, -1]]), wp.crystals.transfer_to_lattice
    springs = np.einsum("n,ni,nj->nij", [0.5, 0.5, 0.1, 0.1], steps, steps)
    crystal = wp.crystals.CrystalMaterial(1.0, steps, springs, symmetry="4mm").certified()
    angles, points, off = (0.0, 10.0, 20.0, 30.0, 45.0), square(16, 3.0), []
    for angle in angles:
        stated = replace(points, axis=angle)
        data = waves(turned(crystal, 1.0, rotation=angle, horizon=3.0), stated, 6)
        same = turned(crystal, 1.0, rotation=angle, horizon=2.5)
        laws = (crystal, replace(data, points=points)), (same, data)
        off.append([100 * wp.evaluate(law, samples)["E_u"] for law, samples in laws])
    y, said = dict(zip(("unstated", "transferred"), zip(*off))), said_by(lambda: crystal.on(stated))
    return Case("an axis nobody stated", angles, "angle [°]", "error of u [%]", y, said)


def critical_stretch(ratios: tuple[float, ...] = (-0.3, 3.0)) -> Case:
    x = wp.fracture.rectangle_nodes(12.0, 10.0, 1.0)
    solids, spent = [solid(ratio * MU) for ratio in ratios], wp.fracture.apparent_toughness
    large, small = (np.array([spent(one, 1.0, cells=n) for one in solids]) for n in (12, 9))
    y = {"formula": 100 * abs(large - 1), "calibrated": 100 * abs(large / small - 1)}
    pulled = wp.Cracked(wp.Points(x, np.ones(len(x), bool), 1.0), u=0.02 * x)
    brittle = wp.fracture.BrittleMaterial(solid(), 1e3, critical_stretch=0.01)
    said = said_by(lambda: wp.simulate(brittle, pulled, step=1e-4, steps=1))
    return Case("a stretch by formula", ratios, "λ/μ", "error of toughness [%]", y, said)


CASES = (
    no_conditions, steep_kernel, other_lattice, short_horizon, nearly_incompressible,
    scattered_points, noisy_data, small_holes, unstated_axis, short_waves, large_strains,
    single_precision, long_steps, broken_kernel, critical_stretch,
)  # fmt: skip


def main() -> None:
    given = Options(__doc__, str(ROOT / "docs")).parse_args()
    with warnings.catch_warnings(action="ignore"):
        cases = {case.__name__: case() for case in tqdm(CASES)}
    for name, case in cases.items():
        print(f"{name}: {case.remedy[0]:.3g}, then {case.remedy[1]:.3g}\n  {case.said}")
    draw_panels([*cases.values()], given.out / "where_it_fails.png")
    record = {name: asdict(case) | {"remedy": case.remedy} for name, case in cases.items()}
    path = given.out / "record" / "stability.json"
    write_record(path, "python examples/stability.py", cases=record)


if __name__ == "__main__":
    sys.exit(exit_status(main))
