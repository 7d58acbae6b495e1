"""The channel and its runs: records, checkpoints, files for ParaView."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from warp_peri.contract import taken
from warp_peri.dynamics.motion import Motion
from warp_peri.errors import InputError
from warp_peri.files.archive import read_arrays
from warp_peri.files.atomic import whole_file, write_text
from warp_peri.flow.channel import REACH, SKIN, Particles
from warp_peri.flow.closure import Stress, check_time_step, in_cells, key_of
from warp_peri.points.arrays import fingerprint


@dataclass(frozen=True)
class ChannelFlow:
    """What is printed for the channel, unless said.

    Args:
        De: relaxation time over t0.
        Re: Reynolds number.
        sound: artificial speed of sound Cs.
        force: body force along x.
        across: particles from wall to wall.
        length: of the period along x, in widths.
        smoothing: length of the bell, in spacings.
        solvent: its viscosity β over that of the polymer (Oldroyd-B and the like).

    Raises InputError for numbers that are not positive or not finite, fewer than 10 particles
    across or no whole number of them, or a period shorter than twice the reach.
    """

    De: float
    Re: float = 1e-2
    sound: float = 10.0
    force: float = 12.0
    across: int = 30
    length: float = 0.6
    smoothing: float = 1.5
    solvent: float = 0.0

    def __post_init__(self) -> None:
        numbers = (self.De, self.Re, self.sound, self.length, self.smoothing)
        positive = all(math.isfinite(n) and n > 0 for n in numbers) and self.solvent >= 0
        finite = math.isfinite(self.solvent) and math.isfinite(self.force)
        if not (positive and finite and self.across >= 10 and self.across == int(self.across)):
            raise InputError(
                f"channel: expected numbers above 0 and 10 particles across, got {self}"
            )
        reach = (REACH * self.smoothing + SKIN) / self.across
        if not 2 * reach < self.length:
            raise InputError(f"channel: expected a period above {2 * reach:.3g}, got {self.length}")

    def moved(self, material: Any, options: dict[str, Any]) -> Motion:
        """From rest, of a law, of dumbbells or of what `in_cells` takes.

        The options are those of run_channel: `until`, `dt`, `every`, `checkpoint`, `progress`. The
        histories, by particle, are x and u [T, N, 2], stress [T, N, 4] and density [T, N]; the
        details are a ChannelRecord.
        """
        (how,) = taken(options, "move", run_channel)
        run = run_channel(self, in_cells(material, self.De, Particles(self).fluid), **how)
        history = {"u": run.v, "x": run.x, "stress": run.sigma, "density": run.rho}
        return Motion(run.t, run.v[-1], None, history, run)

    @property
    def spacing(self) -> float:
        """Between particles at the start."""
        return 1 / self.across

    @property
    def longest_step(self) -> float:
        """Δt beyond which sound, shear waves or the solvent's diffusion outrun a spacing."""
        wave = self.sound**2 / self.Re + 2 / (self.De * self.Re)
        diffusion = 4 * self.solvent / (self.Re * self.spacing**2)
        return 1 / (math.sqrt(wave) / self.spacing + diffusion)


@dataclass(frozen=True)
class ChannelRecord:
    """What the fluid's particles did.

    Args:
        t: times [T].
        x: positions [T, N, 2].
        v: velocities [T, N, 2].
        sigma: stress of the polymer [T, N, 4].
        rho: densities [T, N].
    """

    t: np.ndarray
    x: np.ndarray
    v: np.ndarray
    sigma: np.ndarray
    rho: np.ndarray

    def centre(self) -> np.ndarray:
        """Mean u of the particles next to the middle, at all times."""
        gap = np.abs(self.x[:, :, 1] - 0.5)
        near = gap < gap.min(axis=1, keepdims=True) + 1e-3
        return np.asarray((self.v[:, :, 0] * near).sum(axis=1) / near.sum(axis=1))

    def profile(self, bins: int) -> tuple[np.ndarray, np.ndarray]:
        """Heights of equal bins [bins], and the mean u of the particles in them [T, bins].

        NaN where there are none. Raises InputError for fewer bins than one.
        """
        if bins < 1:
            raise InputError(f"bins: expected 1 or more, got {bins}")
        heights = (np.arange(bins) + 0.5) / bins
        place = np.clip((self.x[:, :, 1] * bins).astype(int), 0, bins - 1)
        count = np.array([np.bincount(row, minlength=bins) for row in place])
        total = [np.bincount(row, v[:, 0], bins) for row, v in zip(place, self.v)]
        return heights, np.array(total) / np.where(count, count, np.nan)

    def save_csv(self, path: str | os.PathLike[str], bins: int = 30) -> None:
        """A line a time: t, then the mean u in bins from wall to wall, nan in empty ones."""
        heights, u = self.profile(bins)
        head = "# time in t0 = L/U; u in U at y = " + ",".join(f"{y:.6g}" for y in heights)
        rows = [",".join(f"{x:.12g}" for x in (t, *now)) for t, now in zip(self.t, u)]
        write_text(path, "\n".join([head, *rows]) + "\n")

    def save_vtu(self, folder: str | os.PathLike[str]) -> list[Path]:
        """One file a time, flow_0000.vtu and so on. Raises InputError without meshio."""
        try:
            import meshio
        except ImportError:
            raise InputError("meshio is not installed: pip install 'warp_peri[export]'") from None
        paths = []
        for n, (x, v, s, rho) in enumerate(zip(self.x, self.v, self.sigma, self.rho)):
            points = np.column_stack([x, np.zeros(len(x))])
            cells = [("vertex", np.arange(len(x))[:, None])]
            data = {"velocity": np.column_stack([v, np.zeros(len(x))]), "density": rho}
            data |= {f"stress_{name}": s[:, i] for i, name in enumerate(("xx", "xy", "yy", "zz"))}
            paths.append(Path(folder) / f"flow_{n:04d}.vtu")
            with whole_file(paths[-1]) as temporary:
                meshio.Mesh(points, cells, point_data=data).write(temporary)
        return paths


def run_channel(
    flow: ChannelFlow,
    stress: Stress,
    *,
    until: float,
    dt: float,
    every: int = 10,
    checkpoint: str | os.PathLike[str] | None = None,
    progress: bool = False,
) -> ChannelRecord:
    """Run from rest.

    Args:
        flow: the channel.
        stress: what its particles, `Particles(flow).fluid` of them, are made of; at rest.
        until: time at the end [t0].
        dt: time step [t0].
        every: steps between two records.
        checkpoint: file written at every tenth record, and with the last record when a run fails; a
            run that finds its own goes on from it.
        progress: whether to show a bar.

    Raises InputError for a time step beyond `flow.longest_step`, a run shorter than one record, a
    checkpoint of another run, and as Particles.step does.
    """
    _check(flow, until, dt, every)
    particles, steps = Particles(flow), round(until / dt)
    key = "" if checkpoint is None else fingerprint(flow, dt, every, key_of(stress))
    kept: dict[str, list[Any]] = {name: [] for name in ("t", "x", "v", "sigma", "rho")}
    first = 0
    if checkpoint is not None and Path(checkpoint).exists():
        first, kept = _resume(checkpoint, key, particles, stress)

    def state(done: int) -> dict[str, Any]:
        content = {name: np.array(rows) for name, rows in kept.items()}
        content |= {f"particles_{k}": v for k, v in particles.state().items()}
        return content | {"stress": stress.state(), "done": np.array(done), "key": np.array(key)}

    good = state(first) if checkpoint is not None else {}
    bar = tqdm(range(first, steps), disable=not progress, desc="channel", initial=first)
    try:
        for n in bar:
            particles.step(stress, dt)
            if (n + 1) % every:
                continue
            row = (particles.t, particles.x, particles.v, particles.sigma, particles.rho)
            for name, value in zip(kept, row):
                kept[name].append(np.array(value))
            if checkpoint is None:
                continue
            good = state(n + 1)
            if (n + 1) % (10 * every) == 0 or n + 1 == steps:
                _write(checkpoint, good)
    except InputError:
        if checkpoint is not None:
            _write(checkpoint, good)
        raise
    asked = steps // every  # a checkpoint may have gone further
    return ChannelRecord(*(np.array(rows[:asked]) for rows in kept.values()))


def _check(flow: ChannelFlow, until: float, dt: float, every: int) -> None:
    check_time_step(dt, flow.longest_step)
    if every < 1 or not until >= every * dt * (1 - 1e-9) or until == np.inf:
        raise InputError(
            f"run: expected every ≥ 1 and until of so many steps of {dt:g} or more, got {every} "
            f"and {until}"
        )


def _write(path: str | os.PathLike[str], content: dict[str, Any]) -> None:
    with whole_file(path) as temporary, open(temporary, "wb") as file:
        np.savez(file, **content)


def _resume(
    path: str | os.PathLike[str], key: str, particles: Particles, stress: Stress
) -> tuple[int, dict[str, list[Any]]]:
    try:
        content = read_arrays(path)
        kept_key, done = str(content["key"]), int(content["done"])
    except (OSError, KeyError, ValueError) as error:
        raise InputError(f"{path}: not a checkpoint of a channel ({error})") from None
    if kept_key != key:
        raise InputError(f"{path}: the checkpoint of another channel, fluid or time step")
    head = "particles_"
    particles.restore({k[len(head) :]: v for k, v in content.items() if k.startswith(head)})
    stress.restore(content["stress"])
    return done, {name: list(content[name]) for name in ("t", "x", "v", "sigma", "rho")}
