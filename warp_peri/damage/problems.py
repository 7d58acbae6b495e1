"""Problems of bodies with cracks: at rest, in motion, pulled until they come apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from warp_peri.contract import offered
from warp_peri.damage.cut_solid import CutSolid
from warp_peri.damage.lattice_body import lattice_body
from warp_peri.damage.march import CrackRun
from warp_peri.damage.motion import BreakingBody
from warp_peri.dynamics.motion import Motion
from warp_peri.errors import InputError
from warp_peri.points.points import Points
from warp_peri.statics.settings import Direct, refuse_solver
from warp_peri.statics.solution import Solution

MARCHING = ("no_fail", "grip", "ramp")
STARTING = ("v", "count_cracks")


@dataclass(frozen=True, eq=False)
class Cracked:
    """A body on a lattice with free edges and cracks, held where nodes are not interior (C11).

    Attributes:
        points: a lattice; where it ends, the body ends. Displacement is given off the interior.
        b: body force density [stress/length], shape [N, 2]; None for no load.
        u: displacement [length], shape [N, 2], read where it is given; zero by default. Of a motion
            it is that of the start.
        cracks: polylines [length], shape [P, 2] each, that cut bonds.
        free: components that are not given, shape [N, 2] bool, where a node is held in part;
            by default both of the interior.
    """

    points: Points
    b: ArrayLike | None = None
    u: ArrayLike | None = None
    cracks: Sequence[ArrayLike] = ()
    free: np.ndarray | None = None

    @property
    def held(self) -> np.ndarray:
        """Components that are given, shape [N, 2] bool; InputError for a mask of another shape."""
        shape = (len(self.points.x), 2)
        if self.free is None:
            return np.repeat(~self.points.interior[:, None], 2, axis=1)
        free = np.asarray(self.free)
        if free.shape != shape or free.dtype != bool:
            raise InputError(f"free: expected shape {list(shape)} of bool, got {list(free.shape)}")
        return ~free

    def solved(self, material: Any, solver: Any, options: dict[str, Any]) -> Solution:
        """The body at rest; the details of the solution are a CutSolid."""
        refuse_solver(solver, (Direct,), "a body with cracks")
        if options:
            raise InputError(f"solve: a body with cracks takes no {', '.join(options)}")
        model = offered(material, "linear", "solve", "a solid with a linear part for a Cracked")
        body = lattice_body(self.points.x, self.points.spacing, model.horizon)
        cut = CutSolid(model, body, self.held, cracks=self.cracks)
        given = np.zeros_like(body.x) if self.u is None else np.asarray(self.u, dtype=float)
        load = None if self.b is None else np.asarray(self.b, dtype=float)
        u = cut.solve(given, load)
        return Solution(u, self.points, cut, load, "lu", details=cut, measured=cut.left)

    def moved(self, material: Any, options: dict[str, Any]) -> Motion:
        """Bonds that break in motion, of a BrittleSolid: the options are those of CrackRun.

        Args:
            material: with a density and a criterion.
            options: `step`, `steps`, `progress`; `every`, `regions`, `sections`, `checkpoint`,
                `checkpoint_every`, `series`, `allow_unstable` (CrackRun); `no_fail`, `grip`,
                `ramp` (BreakingBody); `v`, `count_cracks` (BreakingBody.start).

        The histories are the ledger's, and of regions and sections by their names. The details are
        the BreakingBody, its state at the end and what was recorded.
        """
        model = offered(material, "linear", "move", "a BrittleSolid for a Cracked")
        body = lattice_body(self.points.x, self.points.spacing, model.horizon)
        step, steps = options.pop("step"), options.pop("steps")
        progress = bool(options.pop("progress", False))
        how = {name: options.pop(name) for name in MARCHING if name in options}
        begin = {name: options.pop(name) for name in STARTING if name in options}
        moving = BreakingBody(material, body, load=self.b, held=self.held, **how)
        run = CrackRun(moving, step, **options)
        start = moving.start(u=self.u, cracks=self.cracks, **begin)
        state = run.march(start, steps, progress=progress)
        return Motion(
            run.history.column("time"),
            moving.displacement(state).copy(),
            moving.velocity(state).copy(),
            run.history.by_name(),
            (moving, state, run.history),
        )
