"""Waves, bars, cracks that run: what a motion must keep, and how fast it is."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from scipy.optimize import brentq

from tests.known_problems import statics
from tests.known_problems.statics import LEARNED, THIRD, Outcome, UnitScale, material, plane
from warp_peri import runtime
from warp_peri.certificates import critical_time_step
from warp_peri.errors import InputError
from warp_peri.fracture.body import box_nodes, rectangle_nodes
from warp_peri.fracture.materials import BrittleMaterial
from warp_peri.fracture.problems import Cracked
from warp_peri.materials.lps import LPSMaterial
from warp_peri.mpi import gather, partition
from warp_peri.mpi.processes import own_mpiexec
from warp_peri.points.points import Points
from warp_peri.problems import Dirichlet, simulate
from warp_peri.solvers.verlet import inertia

DENSITY = 1000.0
"""kg/m³."""
SHARE = 0.1
"""Of the longest step."""


def frequency(time: np.ndarray, u: np.ndarray) -> float:
    """Angular frequency of what swings about zero, by the times at which it passes there."""
    before = np.flatnonzero(np.sign(u[1:]) != np.sign(u[:-1]))
    part = u[before] / (u[before] - u[before + 1])
    zeros = time[before] + part * (time[before + 1] - time[before])
    return float(np.pi * (len(zeros) - 1) / (zeros[-1] - zeros[0]))


def wave(name: str, s: UnitScale, length: int, *, local: bool = False) -> Outcome:
    """Frequency of a standing wave over that of the symbol, or of c_L k; its length in spacings."""
    law = material(name, THIRD, 1.0, s)
    points = Points.sheet((max(24, length), 10), s.length, units=s.units)
    points = points if isinstance(law, LPSMaterial) else replace(points, axis=0.0)
    k = 2 * np.pi / (length * s.length)
    stencil = law.stencil(s.length) if isinstance(law, LPSMaterial) else law.stencil
    D = stencil.symbol(np.array([[k * s.length, 0.0]]))[0, 0, 0]
    C = statics.GRAPHENE.tensor if name == LEARNED else THIRD
    D = s.stiffness * C[0, 0, 0, 0] * k**2 if local else D
    omega = float(np.sqrt(D / inertia(DENSITY, s.units)))
    step = SHARE * critical_time_step(law, spacing=s.length, density=DENSITY)
    u = 1e-6 * s.length * np.sin(k * points.x) * [1.0, 0.0]
    node = int(np.argmax(u[:, 0]))
    steps = int(3 * 2 * np.pi / omega / step)
    how: dict[str, Any] = {"density": DENSITY, "step": step, "steps": steps, "record": [node]}
    run = simulate(law, Dirichlet(points, None, u), **how)
    swing = run["u"][:, 0, 0] / s.length
    return Outcome(frequency(run.time, swing) / omega)


def bar(name: str, s: UnitScale, *, twist: bool = False) -> Outcome:
    """Frequency of a free bar over that of the theory, stretched along x, or twisted about z."""
    h = s.length
    sides, nu = ((22, 22, 88), 0.25) if twist else ((60, 8), 1 / 3)
    C = THIRD if not twist else statics.solid(1.0, nu)
    law, far = material(name, C, 1.0, s), max(sides)
    law = replace(law, horizon=2 * h) if twist else law
    x = box_nodes(list(sides), 1.0)
    if twist:
        shape = np.sin(np.pi * x[:, 2] / far)[:, None]
        u = 1e-6 * shape * np.stack([-x[:, 1], x[:, 0], 0 * x[:, 0]], axis=1)
        speed = np.sqrt(C[0, 1, 0, 1] * 0.140577 * 6)
    else:
        shape, slope = (f(np.pi * x[:, 0] / far) for f in (np.sin, np.cos))
        u = 1e-6 * np.stack([shape, -nu * np.pi / far * slope * x[:, 1]], axis=1)
        speed = 1.0
    omega = np.pi / (far * h) * speed * np.sqrt(s.stiffness / inertia(DENSITY, s.units))
    return swung(law, x, u, omega, int(np.argmax(np.abs(u).max(axis=1))), s)


def rayleigh(name: str, s: UnitScale) -> Outcome:
    """Speed of a wave of 50 spacings at a free edge over Rayleigh's, its order from 25 on."""
    counts = 25, 35, 50
    found = [edge_wave(name, s, count) for count in counts]
    off = [abs(one.value - 1) for one in found]
    return replace(found[-1], order=-statics.order(counts, off))


def edge_wave(name: str, s: UnitScale, length: int) -> Outcome:
    """Frequency of a standing wave at the edge y = 0 of a block over that of Rayleigh's equation.

    Its ends are too far to be felt at the middle before it has swung; its length is in spacings.
    """
    C = plane(1.0, 0.3 if name == "LPS" else 1 / 3).tensor
    law, ratio = material(name, C, 1.0, s), C[0, 1, 0, 1] / C[0, 0, 0, 0]
    x = box_nodes([n * length // 5 for n in (16, 10)], 1.0)
    x[:, 1] -= x[:, 1].max() + 1 / 2

    def equation(c: float) -> float:  # of the speed over that of shear waves
        return float((2 - c**2) ** 2 - 4 * np.sqrt((1 - c**2) * (1 - ratio * c**2)))

    c, k = brentq(equation, 0.5, 0.999), 2 * np.pi / length
    p, q = k * np.sqrt(1 - ratio * c**2), k * np.sqrt(1 - c**2)
    pull, shear = np.exp(p * x[:, 1]), 2 / (k**2 + q**2) * np.exp(q * x[:, 1])
    along, up = k * (p * q * shear - pull), p * (pull - k**2 * shear)
    u = 1e-6 * np.stack([along * np.sin(k * x[:, 0]), up * np.cos(k * x[:, 0])], axis=1)
    omega = k / s.length * c * np.sqrt(s.stiffness * C[0, 1, 0, 1] / inertia(DENSITY, s.units))
    node = int(np.argmin(np.hypot(x[:, 0] - 0.25, x[:, 1])))
    return swung(law, x, u, omega, node, s, 0.85)


def swung(
    law: Any, x: np.ndarray, u: np.ndarray, omega: float, node: int, s: UnitScale, part: float = 1.1
) -> Outcome:
    """Frequency over ω at a node of a free body that begins at u, in a part of a period."""
    h, axis = s.length, int(np.argmax(np.abs(u[node])))
    points = Points(h * x, np.ones(len(x), bool), h, units=s.units)
    body = Cracked(points, corrected=True).waves(law)
    heavy = inertia(DENSITY, s.units)
    longest = 0.9 * float(2 * np.sqrt(heavy / body.max_symbol_eigenvalue()))
    count = int(2 * np.pi / omega / longest) + 1  # a period, which no last digit of it moves
    step, steps = 2 * np.pi / omega / count, int(part * count)
    problem = Dirichlet(body.points, None, h * u)
    run = simulate(body, problem, density=DENSITY, step=step, steps=steps, record=[node])
    swing = run["u"][:, 0, axis]
    return Outcome(frequency(run.time, swing) / omega)


def kept(name: str, s: UnitScale) -> Outcome:
    """Drift of energy and momentum, the larger one, in 100 000 steps of a period."""
    law, n = material(name, THIRD, 1.0, s), 10
    points = Points.sheet((n, n), s.length, units=s.units)
    u, v = 1e-6 * s.length * np.random.default_rng(0).normal(size=(2, n * n, 2))
    step = 0.9 * critical_time_step(law, spacing=s.length, density=DENSITY)
    how: dict[str, Any] = {"density": DENSITY, "step": step, "steps": 100_000, "every": 100}
    v = (v - v.mean(axis=0) + 1e-7 * s.length) / step
    run = simulate(law, Dirichlet(points, None, u), v=v, **how)
    lost = np.linalg.norm((run.v - v).sum(axis=0)) / np.linalg.norm(v, axis=1).sum()
    return Outcome(max(float(lost), run.drift))


def glass_plate(
    name: str, s: UnitScale, h: float, E: float, rho: float, toughness: float, pull: float
) -> tuple[BrittleMaterial, Cracked, np.ndarray]:
    """Glass, a plate of 100 by 40 mm that is cut to its middle and pulled, and its nodes [m]."""
    law = material(name, plane(E, GLASS[name]).tensor, h, s)
    glass = BrittleMaterial(law, rho, toughness=toughness * s.length * s.stiffness)
    x = rectangle_nodes(0.1, 0.04, h)
    rim = np.abs(x[:, 1]) > 0.02 - h
    b = pull * np.where(rim, np.sign(x[:, 1]) / h, 0.0)[:, None] * [0, 1]
    points = Points(s.length * x, np.ones(len(x), bool), s.length * h, units=s.units)
    crack = s.length * np.array([(-0.051, 0.0), (0.0, 0.0)])
    return glass, Cracked(points, b * s.stiffness / s.length, cracks=[crack]), x


GLASS = {"LPS": 0.22, "bond-based": 1 / 3}
"""ν of glass."""


def crack_speed(name: str, s: UnitScale, cells: int) -> float:
    """Speed over Rayleigh's of a crack in pulled glass, 10 to 30 mm after its start, or NaN."""
    nu, E, h = GLASS[name], 64e3, 0.1 / cells
    glass, plate, x = glass_plate(name, s, h, E, 2450.0, 3.8e-6, 1.0)
    rim = np.abs(x[:, 1]) > 0.02 - h
    step = 0.4 * glass.longest_step(s.length * h)

    def tip(damage: np.ndarray) -> float:
        return float(x[damage > 0.3, 0].max(initial=0.0))

    told: dict[str, Any] = {"every": cells // 20, "no_fail": rim, "watch": {"tip": tip}}
    run = simulate(glass, plate, step=step, steps=4 * cells, **told)
    runs = (run["tip"] > 0.01) & (run["tip"] < 0.03)
    far = run["tip"].max() >= 0.03
    fast = np.polyfit(run.time[runs], run["tip"][runs] * s.length, 1)[0] if far else np.nan
    shear = np.sqrt(s.stiffness * E / 2 / (1 + nu) / glass.inertia)
    return float(fast * (1 + nu) / (0.862 + 1.14 * nu) / shear)


def faster(name: str, s: UnitScale, *, finer: bool = False) -> Outcome:
    """By how much a crack in a pulled glass plate outruns Rayleigh's wave, at three spacings.

    Or, finer, the difference of its speeds at the two finest, over the last.
    """
    speeds = np.array([crack_speed(name, s, cells) for cells in (100, 140, 200)])
    told = ", ".join(f"{speed:.3f}" for speed in speeds)
    note = f"it runs at {told} of Rayleigh's speed at spacings of 1, 0.71 and 0.5 mm"
    value = abs(speeds[1] / speeds[2] - 1) if finer else np.maximum(0, speeds - 1).max()
    return Outcome(float(value), note=note)


def branches(name: str, s: UnitScale, cells: int = 200) -> Outcome:
    """Cracks that pass 10 mm before the right edge of a glass plate under a pull of 12 MPa."""
    h = 0.1 / cells
    glass, plate, x = glass_plate(name, s, h, 72e3, 2440.0, 1.35e-4, 12.0)
    step = 0.8 * glass.longest_step(s.length * h)
    steps = int(45e6 / np.sqrt(s.stiffness) / step)
    rim = np.abs(x[:, 1]) > 0.02 - 3 * h
    damage = simulate(glass, plate, step=step, steps=steps, every=steps, no_fail=rim).details.damage

    def cracks(place: float) -> int:
        y = np.sort(x[(np.abs(x[:, 0] - place) < h) & (damage > 0.35), 1])
        return len(y[:1]) + int(np.count_nonzero(np.diff(y) > 1.5e-3))

    split = next((at for at in np.unique(x[:, 0]) if at > 0 and cracks(at) > 1), np.nan)
    note = f"it branches {1e3 * split + 50:.0f} mm from the left"
    return Outcome(float(cracks(0.04)), note=note)


def hit(name: str, s: UnitScale, cells: int = 200) -> Outcome:
    """Angle [degrees] of the cracks of Kalthoff and Winkler's plate to its notches.

    100 by 200 mm with notches of 50 mm, in plane stress, are hit between them at 33 m/s; steel on
    steel moves at half of that. At six spacings the lattice turns a crack by a degree at most.
    """
    nu, h = {"LPS": 0.3, "bond-based": 1 / 3}[name], 0.1 / cells
    law = material(name, plane(190e3, nu).tensor, h, s)
    law = replace(law, horizon=6 * h * s.length)
    steel = BrittleMaterial(law, 8000.0, toughness=0.02213 * s.length * s.stiffness)
    x = rectangle_nodes(0.1, 0.2, h)
    struck = (x[:, 0] < -0.05 + h) & (np.abs(x[:, 1]) < 0.025)
    fast = 16.5e-12 * s.length * np.sqrt(s.stiffness)  # per ps; the strain is that of metres
    v, free = struck[:, None] * np.array([fast, 0.0]), ~(struck[:, None] & [True, False])
    points = Points(s.length * x, np.ones(len(x), bool), s.length * h, units=s.units)
    notches = [s.length * np.array([(-0.051, y), (0.0, y)]) for y in (-0.025, 0.025)]
    plate = Cracked(points, u=0 * x, cracks=notches, free=free)
    step = 0.8 * steel.longest_step(s.length * h)
    steps = int(85e6 / np.sqrt(s.stiffness) / step)
    run = simulate(steel, plate, step=step, steps=steps, every=steps, v=v, grip=v, no_fail=struck)
    damage, rises = run.details.damage, list[float]()
    for side in (1, -1):
        up = side * x[:, 1] - 0.025
        grown = (damage > 0.35) & (np.hypot(x[:, 0], up) > 6 * h) & (up > 0) & (x[:, 0] > 0)
        if up[grown].max(initial=0.0) < 0.025:
            raise InputError("hit: expected cracks from both notches")
        rises.append(float(np.arctan(1 / np.polyfit(up[grown], x[grown, 0], 1)[0])))
    return Outcome(float(np.degrees(np.mean(rises))))


def torn(name: str, s: UnitScale) -> tuple[np.ndarray, np.ndarray]:
    """Displacement and shares of broken bonds of a plate that is torn, on the ranks there are."""
    law = material(name, THIRD, 1.0, s)
    solid_, x = BrittleMaterial(law, 1e3, critical_stretch=0.01), rectangle_nodes(60.0, 60.0, 1.0)
    points: Any = Points(s.length * x, np.ones(len(x), bool), s.length, units=s.units)
    points = partition(points) if runtime.ranks_started() else points
    step = 0.4 * solid_.longest_step(s.length)
    uneven = 1 + 0.01 * (np.rint(2 * np.abs(points.x[:, ::-1]) / s.length) % 7)
    run = simulate(
        solid_, Cracked(points), step=step, steps=30, v=0.0005 * points.x * uneven / step
    )
    if runtime.ranks_started():
        return gather(points, run.u), gather(points, run.details.damage)
    return run.u, run.details.damage


def threads(name: str, s: UnitScale, *, ranks: bool = False) -> Outcome:
    """Share of numbers that differ between a plate torn on one thread, or rank, and on two."""
    before, found = runtime.get_num_threads(), list[Any]()
    try:
        for count in (1, 2):
            runtime.set_num_threads(1 if ranks else count)
            found.append(on_ranks(count, name, s) if ranks else torn(name, s))
    finally:
        runtime.set_num_threads(before)
    (one, broken), (other, _) = found
    if not 0 < broken.mean() < 1:
        raise InputError(f"threads: expected a plate that breaks, {broken.mean():.0%} of it did")
    return Outcome(float(np.mean(one != other)))


ON_A_RANK = """\
import sys, numpy
from warp_peri.mpi import is_root
from tests.known_problems.motion import UnitScale, torn
u, damage = torn(sys.argv[1], UnitScale(sys.argv[2], float(sys.argv[3])))
if is_root():
    numpy.savez(sys.argv[4], u=u, damage=damage)
"""


def on_ranks(count: int, name: str, s: UnitScale) -> tuple[np.ndarray, np.ndarray]:
    """As torn, by a job of so many ranks. Raises InputError for one that fails."""
    with TemporaryDirectory() as folder:
        words = [name, s.unit, repr(s.stiffness), f"{folder}/found.npz"]
        job = [own_mpiexec(), "-n", str(count), sys.executable, "-c", ON_A_RANK, *words]
        try:
            subprocess.run(job, check=True, capture_output=True, text=True)
        except (OSError, subprocess.CalledProcessError) as error:
            said = getattr(error, "stderr", None) or str(error)
            raise InputError(f"ranks: the job failed: {said.strip()[-300:]}") from None
        with np.load(words[-1]) as kept_:
            return kept_["u"], kept_["damage"]
