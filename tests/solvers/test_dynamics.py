"""Explicit dynamics: the proven time step, stability on either side of it, the energy kept."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from tests.known_problems.statics import THIRD, UnitScale, material
from tests.support import approx, assert_refused, near, parametrize, refused, sup, warned
from tests.support.problems import OTHER, ell, kernel, lattice, noise, periodic
from warp_peri.certificates import critical_time_step
from warp_peri.files.atomic import locked, write_vtu
from warp_peri.materials.lps_operator import LPSOperator
from warp_peri.problems import Dirichlet, simulate
from warp_peri.solvers.verlet import INERTIA, Inert, inertia, march, step

DENSITY = 2147.0


def moved(model, points, u, v, b=None, **options):
    return simulate(model, Dirichlet(points, b, u), v=v, density=DENSITY, **options)


@parametrize(("name", "spacing"), [("1/r", 1.0), ("steep", 5.0)])
def test_stable_just_below_and_unstable_just_above(name, spacing):
    model = kernel(name, 2.5 * spacing, spacing, lam=-0.2)
    points = periodic((48, 48), spacing)[0]  # holds the stiffest wave to a part in a thousand
    critical = critical_time_step(model, spacing=spacing, density=DENSITY)
    u, rest, steps = noise(points), 0 * points.x, 250
    below = moved(model, points, u, rest, step=0.99 * critical, steps=steps)
    assert sup(below.u) < 30 * sup(u)
    assert below.drift < 1e-12
    body = Inert(model.on(points), points.interior, DENSITY, 0.0, u)
    above = body.state(u, rest[points.interior])
    for _ in range(steps):
        above = step(body, above, 1.01 * critical)
    assert sup(above.u) > 1e20 * sup(u)
    with refused(f"step: expected at most {critical:.6g} ps"):
        moved(model, points, u, rest, step=1.01 * critical, steps=steps)


def test_energy_is_that_of_the_definition_and_a_density_an_inertia_in_any_units():
    assert inertia(1000.0, OTHER) == approx(1.0)  # GPa ps²/nm²
    assert inertia(1000.0, ("m", "Pa")) == approx(1e27)  # Pa ps²/m²
    model, points = kernel("1/r", 2.0), lattice(4, 2.0)
    inside = points.interior
    L = LPSOperator(model, points).matrix()
    A, C = L[:, np.repeat(inside, 2)], L[:, np.repeat(~inside, 2)]
    u, v, b = (noise(points, seed=seed) for seed in range(3))
    step = 0.002
    motion = moved(model, points, u, v, b, step=step, steps=1)
    start, load = u[inside].ravel(), b[inside].ravel() - C @ u[~inside].ravel()
    half = v[inside].ravel() + step / (2 * INERTIA * DENSITY) * (load - A @ start)
    end = start + step * half
    energy = INERTIA * DENSITY / 2 * half @ half + start @ (A @ end) / 2 - load @ (start + end) / 2
    assert motion.energy[0] == approx(energy / inside.sum(), rel=1e-12)
    assert motion.u[inside].ravel() == approx(end, rel=1e-12, abs=0)
    assert motion.time == approx([step / 2])  # of energies and records


def test_to_move_as_a_whole_changes_no_energy():
    """A thousand times as far as a crystal swings, with a load or without."""
    law = material("crystal", THIRD, 1.0, UnitScale())
    points = replace(periodic((8, 8))[0], units=law.units, axis=0.0)
    step = 0.9 * critical_time_step(law, spacing=1.0, density=DENSITY)
    v = 10 * (1 + 0.01 * noise(points)) / (300 * step)
    load = 1e-3 * law.elastic_tensor().max() * noise(points)
    for b in (None, load - load.mean(0)):
        how = {"density": DENSITY, "step": step, "steps": 300, "every": 10, "v": v}
        run = simulate(law, Dirichlet(points, b, 0.01 * noise(points)), **how)
        assert np.abs(run.u.mean(0)).min() > 5
        assert run.drift < 1e-12


def test_waves_go_on_from_a_checkpoint_with_the_same_bits_and_go_to_paraview(tmp_path, monkeypatch):
    """With a collar and a load, whose energy is kept; a disk full behind the first record."""
    model, points = kernel("positive", 2.5, lam=-0.2), lattice(ell(), 2.5)
    u, v, b = (noise(points, seed=seed) for seed in range(3))
    dt = 0.9 * critical_time_step(model, spacing=points.spacing, density=DENSITY)
    start = {"u": u, "v": v, "density": DENSITY, "step": dt, "every": 3}
    run = lambda law=model, **how: march(law.on(points), b, **start | how)
    files = {"checkpoint": tmp_path / "run.h5", "checkpoint_every": 1, "series": tmp_path / "s"}
    with monkeypatch.context() as patch, refused("s: cannot be written .No space left"):
        fill = lambda *all: write_vtu(*all) or Path("/dev/full").write_text("x")
        patch.setattr("warp_peri.solvers.motion.write_vtu", fill)
        run(**files, steps=10)
    run(**files, steps=10)
    resumed = run(replace(model, D=2 * model.D), **files, steps=25, signal=np.ones(26))
    straight = run(steps=25)
    assert straight.drift < 1e-12
    collar = ~points.interior
    near(straight.u[collar], u[collar], 0)
    assert not straight.v[collar].any()
    for name in ("u", "v", "energy"):
        assert getattr(resumed, name).tobytes() == getattr(straight, name).tobytes()
    assert (tmp_path / "s" / "motion.pvd").read_text().count("timestep=") == len(straight.time)
    run(**files | {"series": None}, steps=28)
    with warned("no records after step 25 until 28"):
        run(**files, steps=31)
    (tmp_path / "motion.pvd").write_text("mine")
    with locked(files["checkpoint"]), refused("run.h5: another job is writing here"):
        run(**files, steps=30)
    with locked(tmp_path / "s" / "motion.pvd"), refused("s/motion.pvd: another job is writing"):
        run(**files, steps=30)
    assert_refused({
        "of another .* program": lambda: run(steps=4, series=tmp_path),
        "s/motion.pvd: .* of another motion": lambda: run(u=2 * u, steps=4, series=tmp_path / "s"),
        "u: expected a displacement, zeros": lambda: Dirichlet(points, b, None),
        "of more steps": lambda: run(steps=4, series=files["series"]),
        "at least the 31 taken before, got 20": lambda: run(**files | {"series": None}, steps=20),
    })  # fmt: skip
